//! Fits of a model to tests in one call; see [`fit`](crate::fit) and [`fit_matrices`](crate::fit_matrices).

mod ensemble;
mod error;
mod figure;
mod fit;
mod flow;
mod matrices;
mod mean_limits;
mod with_innovations;

pub use ensemble::Ensemble;
pub use error::EnsembleError;
pub use figure::{Figure, UnknownName};
pub use fit::{Fit, Options};
pub use flow::fit;
pub use matrices::{fit_matrices, fit_reductions};
pub use mean_limits::MeanProfiles;

#[cfg(test)]
mod tests;
