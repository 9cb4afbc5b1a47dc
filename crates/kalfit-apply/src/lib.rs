//! What is done with a known (α, μ, Σ): posteriors of new tests, predictions, matrices for a filter, plans, Allan variances.

pub mod allan;
pub mod apply;
pub mod export;
pub mod plan;
pub mod predict;
