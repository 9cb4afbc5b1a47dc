//! Allan's variance of a measured rate: of a model, and of records.
//!
//! At the averaging time T = mδ Allan's variance is ½E[(ȳ_2 - ȳ_1)²], with ȳ_i the means of two neighbouring spans of m
//! values. A constant drops out; white noise of variance R gives R/m, a random walk of variance q per unit of time
//! qT/3, a Gauss-Markov state of standard deviation σ and time constant τ (σ²τ²/T²)(2T/τ - 3 + 4e^{-T/τ} - e^{-2T/τ})
//! (theory §12, both in the limit of short steps).

mod model;
mod records;
#[cfg(test)]
mod tests;

pub use model::variance;
pub use records::{Estimate, estimate, median_step, stretches};

/// Numbers of values in a span: 1, 2, 5, 10, 20, 50 and so on, up to `most`.
pub fn spans(most: usize) -> Vec<usize> {
    let decades = std::iter::successors(Some(1_usize), |decade| decade.checked_mul(10));
    let all = decades.flat_map(|decade| [1, 2, 5].map(|factor| decade.saturating_mul(factor)));
    all.take_while(|&m| m <= most).collect()
}
