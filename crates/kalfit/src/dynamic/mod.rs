//! Dynamic parameters α (time constants, noise levels, coefficients) together with μ and Σ: ℓ(α) = maximum over (μ, Σ) of the
//! reductions at α, and the filters run again only when α moves (the paper's section 2.4, theory §6).
//!
//! ```text
//! ℓ(α) = max over (μ, Σ) of ℓ(μ, Σ | reductions at α)           the paper's Figure 1
//! dℓ/dα = ∂ℓ/∂α at the best (μ, Σ)                              one backward pass over each test, see score
//! ```

mod balance;
mod before_runs;
mod branches;
mod colours;
mod coordinates;
mod covariances;
mod crossed;
mod differences;
mod edges;
mod em;
mod error;
mod exact;
mod exchange;
mod expected;
mod explore;
mod fit;
mod flat;
mod foresight;
mod glide;
mod gradient_function;
mod indirect;
mod inference;
mod interval;
mod joint;
mod law;
mod matrices;
mod mean_limits;
mod mixed;
mod opening;
mod outer;
#[cfg(test)]
mod phased_tests;
mod places;
mod profile;
mod profile_likelihood;
mod quadratic;
mod ratio;
mod result;
mod ridge;
mod sample;
mod sandwich;
mod scale;
mod scales;
mod search;
mod search_state;
mod settings;
mod slot_name;
mod standing;
mod start;
mod stepwise;
#[cfg(test)]
mod tests;
mod touching;
mod tries;
mod twins;
mod unbounded;
mod zero;

pub(crate) use coordinates::Coordinate;
pub use error::DynamicError;
pub(crate) use exact::add_exact;
pub(crate) use fit::fit_remote;
pub use fit::{fit, start_values};
pub(crate) use indirect::Around;
pub use inference::infer;
pub(crate) use interval::MOST_PROFILED;
pub use mean_limits::{MeansAt, mean_limits};
pub(crate) use opening::{SuggestedValues, opening};
pub use ratio::{DynamicRatioError, dynamic_bootstrap, dynamic_bootstrap_while, dynamic_ratio, started};
pub use result::{DynamicFit, Explored, OtherEnd};
pub(crate) use scale::Scale;
pub use settings::{Method, Settings};
pub use standing::{ParameterInference, Standing};
