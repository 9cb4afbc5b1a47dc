//! Comparisons of numbers with what is expected. A number that is not finite is near to nothing.

use std::fmt::Display;

use nalgebra::DMatrix;

/// The error |found - expected| as a part of `bound`, or what is wrong if it is larger than that.
pub fn error(found: f64, expected: f64, bound: f64) -> Result<f64, String> {
    let error = (found - expected).abs();
    if error <= bound && error.is_finite() {
        Ok(if error > 0.0 { error / bound } else { 0.0 })
    } else {
        Err(format!("found {found:.15e}, expected {expected:.15e}: error {error:.2e}, tolerance {bound:.2e}"))
    }
}

/// Panics unless |found - expected| ≤ tolerance.
#[track_caller]
pub fn absolute(what: impl Display, found: f64, expected: f64, tolerance: f64) {
    if let Err(message) = error(found, expected, tolerance) {
        panic!("{what}: {message}");
    }
}

/// Panics unless |found - expected| ≤ tolerance |expected|.
#[track_caller]
pub fn relative(what: impl Display, found: f64, expected: f64, tolerance: f64) {
    absolute(what, found, expected, tolerance * expected.abs());
}

/// Panics unless |found - expected| ≤ tolerance (1 + |expected|).
#[track_caller]
pub fn mixed(what: impl Display, found: f64, expected: f64, tolerance: f64) {
    absolute(what, found, expected, tolerance * (1.0 + expected.abs()));
}

/// Panics unless each number is found to tolerance × max(1, |largest expected|).
#[track_caller]
pub fn slices(what: impl Display, found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len(), "{what}: count of numbers");
    let bound = tolerance * largest(expected).max(1.0);
    for (k, (found, expected)) in found.iter().zip(expected).enumerate() {
        absolute(format_args!("{what}, number {k}"), *found, *expected, bound);
    }
}

/// Panics unless the shapes are equal and each element is found to tolerance × (1 + |largest expected|).
#[track_caller]
pub fn matrices(what: impl Display, found: &DMatrix<f64>, expected: &DMatrix<f64>, tolerance: f64) {
    assert_eq!(found.shape(), expected.shape(), "{what}: shape");
    let bound = tolerance * (1.0 + largest(expected.as_slice()));
    for i in 0..found.nrows() {
        for k in 0..found.ncols() {
            absolute(format_args!("{what}, ({i}, {k})"), found[(i, k)], expected[(i, k)], bound);
        }
    }
}

/// The largest absolute value; zero if there are no numbers.
pub fn largest(numbers: &[f64]) -> f64 {
    numbers.iter().fold(0.0, |most: f64, x| most.max(x.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_told_in_units_of_its_bound() {
        assert_eq!(error(1.5, 1.0, 2.0), Ok(0.25));
        assert_eq!(error(1.0, 1.0, 0.0), Ok(0.0));
        let message = error(1.5, 1.0, 0.25).expect_err("it is twice the bound");
        assert!(message.ends_with("error 5.00e-1, tolerance 2.50e-1"), "{message}");
        for (found, expected) in
            [(f64::NAN, 1.0), (1.0, f64::NAN), (f64::INFINITY, f64::INFINITY), (f64::INFINITY, 1.0)]
        {
            assert!(error(found, expected, 1.0).is_err(), "{found} against {expected}");
        }
    }

    #[test]
    fn each_tolerance_has_its_unit() {
        relative("2 %", -102.0, -100.0, 0.020_001);
        mixed("2 % of 101", -102.0, -100.0, 0.019_803);
        slices("2 % of 100", &[0.0, 102.0], &[2.0, 100.0], 0.020_001);
        matrices("one", &DMatrix::from_element(2, 1, 1.0), &DMatrix::from_element(2, 1, 1.0), 0.0);
    }

    #[test]
    #[should_panic(expected = "slope: found 1.02")]
    fn what_is_further_off_is_refused() {
        relative("slope", -1.02e2, -100.0, 0.02);
        relative("slope", 1.02, 1.0, 0.019_999);
    }

    #[test]
    #[should_panic(expected = "all, number 1: found 0")]
    fn each_number_counts() {
        slices("all", &[1.0, 0.0], &[1.0, 0.5], 0.4);
    }
}
