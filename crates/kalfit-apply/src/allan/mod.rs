//! Allan's variance of a measured rate, by a model and by records.
//!
//! At the averaging time T = mδ Allan's variance is ½E[(ȳ_2 - ȳ_1)²], with ȳ_i the means of two neighbouring spans of m
//! values. Allan's variance is (theory §12; the last two in the limit of short steps δ):
//!
//! - 0 for a constant,
//! - R/m for white noise of variance R,
//! - qT/3 for a random walk of variance q per unit of time,
//! - (σ²τ²/T²)(2T/τ - 3 + 4e^{-T/τ} - e^{-2T/τ}) for a Gauss-Markov state of standard deviation σ and time constant τ.

mod model;
mod records;
#[cfg(test)]
mod tests;

pub use model::variance;
pub use records::{Estimate, estimate, median_step, stretches};

/// Lengths m of spans, in values: 1, 2, 5, 10, 20, 50 and so on, up to `most`.
pub fn spans(most: usize) -> Vec<usize> {
    let decades = std::iter::successors(Some(1_usize), |decade| decade.checked_mul(10));
    let all = decades.flat_map(|decade| [1, 2, 5].map(|factor| decade.saturating_mul(factor)));
    all.take_while(|&m| m <= most).collect()
}
