//! Uses of a known (α, μ, Σ): posteriors of new tests, predictions, matrices of filters, plans and Allan variances.

pub mod allan;
pub mod apply;
pub mod export;
pub mod plan;
pub mod predict;
