//! The best plan: how many of each kind of test to make within a budget (theory §15).
//!
//! ```text
//! M(n) = I₀ + Σ n_k F_k,   Σ c_k n_k ≤ budget,   0 ≤ n_k ≤ m_k        maximise log φ(M)
//! φ(M(n'))/φ(M(n)) ≤ U = ⟨G, I₀⟩ + max over n' of Σ n'_k ⟨G, F_k⟩,    G = ∂log φ/∂M                    (15.4)
//! ```
//!
//! [`relax`] solves the problem with any numbers n_k ≥ 0 and certifies the solution by U. [`in_whole_numbers`] finds the
//! best plan in whole numbers by branch and bound, with the relaxed solution of each branch as its bound.

mod bound;
mod criterion;
mod exchange;
mod newton;
mod problem;
mod relaxed;
#[cfg(test)]
mod tests;
mod whole;

pub use criterion::Criterion;
pub use problem::{Kinds, MOST_TESTS, PlanProblem, Scenario};
pub use relaxed::{Relaxed, relax};
pub use whole::{WholePlan, in_whole_numbers};
