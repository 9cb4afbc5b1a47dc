//! What the tests of several crates share: models put together by hand, random numbers, slopes by differences.
//!
//! The crate stands on `kalfit-model` alone, so that every crate above may use it in its tests.

pub mod bench;
pub mod by_hand;

/// The slope of a function at zero, by differences of fourth order with the step `h`.
pub fn slope(at: impl Fn(f64) -> f64, h: f64) -> f64 {
    (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h)
}
