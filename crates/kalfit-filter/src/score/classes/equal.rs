//! The data-dependent part of the backward pass over equal steps of one scalar measurement.

use kalfit_lanes::{Lanes, Part};

use crate::reduce::at;
use crate::score::backward::{DataSums, EqualStretch};

/// The backward pass over equal steps, from r after the steps to r before the steps.
pub(super) struct EqualDataBackward<'a, T, const N: usize> {
    pub(super) stretch: &'a EqualStretch<'a>,
    /// x̄ of all states before the steps.
    pub(super) first: &'a [T],
    pub(super) marks: &'a [T],
    /// ē of the tests, in lanes.
    pub(super) e: &'a [f64],
    pub(super) r: &'a mut [T],
}

impl<T: Lanes, const N: usize> Part for EqualDataBackward<'_, T, N> {
    type Output = DataSums<T, N>;

    #[inline(always)]
    fn run(self) -> DataSums<T, N> {
        let EqualDataBackward { stretch, first, marks, e, r: all } = self;
        let step_coefficients = stretch.coefficients::<T, N>(first);
        let mut r = first_numbers(all);
        let (mut sums, mut xs) = (DataSums::zeros(), Vec::new());
        for (number, (from, to)) in stretch.blocks().enumerate().rev() {
            let mut x = first_numbers(&marks[number * N..]);
            let first_steady = stretch.moving().clamp(from, to);
            xs.clear();
            for k in from..to {
                xs.push(x);
                x = step_coefficients.filter.state(&x, &stretch.weight_and_gain(k).1, at(e, k));
            }
            if first_steady < to {
                let gain = stretch.weight_and_gain(first_steady);
                let prior = stretch.variances(first_steady, &gain);
                for k in (first_steady..to).rev() {
                    step_coefficients.back(&mut r, &gain, at(e, k), (&xs[k - from], &prior), &mut sums);
                }
            }
            for k in (from..first_steady).rev() {
                let gain = stretch.weight_and_gain(k);
                let prior = stretch.variances(k, &gain);
                step_coefficients.back(&mut r, &gain, at(e, k), (&xs[k - from], &prior), &mut sums);
            }
        }
        all[..N].copy_from_slice(&r);
        sums
    }
}

/// The first N numbers of a list.
#[inline(always)]
fn first_numbers<T: Lanes, const N: usize>(all: &[T]) -> [T; N] {
    let mut first = [T::splat(0.0); N];
    first.copy_from_slice(&all[..N]);
    first
}
