//! Estimation of dynamic parameters α (time constants, noise levels, coefficients) together with μ and Σ: ℓ(α) is the
//! maximum over (μ, Σ) on the reductions at α, and the filters run again only when α moves (the paper's section 2.4,
//! theory §6).
//!
//! ```text
//! ℓ(α) = max over (μ, Σ) of ℓ(μ, Σ | reductions at α)           the paper's Figure 1
//! dℓ/dα = ∂ℓ/∂α at the best (μ, Σ)                              one backward pass over each test, see score
//! ```

mod balance;
mod before_runs;
mod coefficients;
mod colours;
mod coordinates;
mod correlation_bounds;
mod covariances;
mod differences;
mod em;
mod error;
mod exact;
mod exchange;
mod exchangeable;
pub mod explore;
mod fit;
pub mod flat;
mod gradient_function;
mod indirect;
mod joint;
mod matrices;
mod noise_transfer;
mod opening;
#[cfg(test)]
mod phased_tests;
mod places;
mod prefetch;
mod profile_likelihood;
mod quadratic;
mod quasi_newton;
mod record;
mod result;
mod ridge;
mod sample;
mod scale;
mod scales;
mod search;
mod search_state;
mod settings;
mod slot_name;
mod sparsity;
mod standing;
mod start;
#[cfg(test)]
mod tests;
mod tries;
mod unbounded;
mod zero;

pub use before_runs::BeforeRuns;
pub use coordinates::{Coordinate, alike};
pub use covariances::ValueCovariances;
pub use differences::two_sides;
pub use error::DynamicError;
pub use exact::add_exact;
pub use exchangeable::{ExchangeablePair, ordered};
pub use fit::{fit, fit_remote, start_values};
pub use indirect::Around;
pub use matrices::{matrix_derivatives, matrix_gradient};
pub use opening::{SuggestedValues, opening};
pub use profile_likelihood::{ProfileLikelihood, ProfilePoint};
pub use quadratic::{Iterate, ProfileInformation, Quadratic};
pub use record::{Origin, SearchRecord, SearchStage, StageRuns};
pub use result::{DynamicFit, Explored, OtherEnd};
pub use scale::Scale;
pub use search_state::{SearchEnd, SearchState};
pub use settings::{Method, Settings};
pub use slot_name::slot_name;
pub use standing::{Interval, ParameterInference, Standing};
