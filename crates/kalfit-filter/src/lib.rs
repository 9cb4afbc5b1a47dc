//! The Kalman filter: a test becomes a reduction, and with the law of ξ a reduction becomes the score of α.
//!
//! ```text
//! Model at α + Test ── reduce ──> Reduction                      (c, y, J): all that the test says about ξ
//! Reduction + InitialLaw ── score ──> dℓ/dα                      one backward pass a test (theory §6)
//! Model at (α, μ, Σ) + Test ── innovations ──> z-scores          does the model describe the test (theory §9)
//! Model at (α, μ, Σ) ── simulate ──> Test                        tests drawn from the model
//! ```

pub mod innovations;
pub mod reduce;
pub mod score;
pub mod simulate;
