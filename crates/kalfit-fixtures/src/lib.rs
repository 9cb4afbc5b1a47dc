//! Fixtures for the tests of several crates: models built by hand, random numbers, dense laws, slopes by differences,
//! and comparisons of numbers.
//!
//! The crate depends on `kalfit-model` alone, so that the tests of every crate above `kalfit-model` can use the
//! fixtures.

pub mod bench;
pub mod by_hand;
pub mod dense;
pub mod near;

/// The slope of a function at zero, by differences of fourth order with the step `h`.
pub fn slope(function: impl Fn(f64) -> f64, h: f64) -> f64 {
    (8.0 * (function(h) - function(-h)) - (function(2.0 * h) - function(-2.0 * h))) / (12.0 * h)
}
