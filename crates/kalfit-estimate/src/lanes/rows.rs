//! Basic operations on rows in lanes: y ← y + Σ a x, and sums over the lanes.

use kalfit_lanes::Lanes;

/// Number of rows that are added at once: each number of y is then read and written once for four products.
const ROWS_AT_ONCE: usize = 4;

/// y ← y + a x.
#[inline(always)]
pub(super) fn add_one<T: Lanes>(y: &mut [T], a: T, x: &[T]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y = a.fma(*x, *y);
    }
}

/// y ← y + a_0 x_0 + a_1 x_1 + a_2 x_2 + a_3 x_3.
#[inline(always)]
fn add_four<T: Lanes>(y: &mut [T], a: [T; ROWS_AT_ONCE], x: [&[T]; ROWS_AT_ONCE]) {
    let x = [&x[0][..y.len()], &x[1][..y.len()], &x[2][..y.len()], &x[3][..y.len()]];
    for at in 0..y.len() {
        let first = a[1].fma(x[1][at], a[0].fma(x[0][at], y[at]));
        y[at] = a[3].fma(x[3][at], a[2].fma(x[2][at], first));
    }
}

/// y ← y + Σ_k w_k x_kl x_k over `count` rows x_k, with entry l of row k as x_kl, and w_k = 1 unless weights are given.
/// Row k starts at index k × width.
#[inline(always)]
pub(super) fn add_weighed<T: Lanes>(
    y: &mut [T],
    count: usize,
    (rows, width, l): (&[T], usize, usize),
    weights: Option<&[T]>,
) {
    let size = y.len();
    let mut k = 0;
    while k + ROWS_AT_ONCE <= count {
        let rows = &rows[k * width..];
        let x = [&rows[..size], &rows[width..][..size], &rows[2 * width..][..size], &rows[3 * width..][..size]];
        let mut a = [x[0][l], x[1][l], x[2][l], x[3][l]];
        if let Some(weights) = weights {
            a = [a[0] * weights[k], a[1] * weights[k + 1], a[2] * weights[k + 2], a[3] * weights[k + 3]];
        }
        add_four(y, a, x);
        k += ROWS_AT_ONCE;
    }
    while k < count {
        let x = &rows[k * width..][..size];
        let mut a = x[l];
        if let Some(weights) = weights {
            a = a * weights[k];
        }
        add_one(y, a, x);
        k += 1;
    }
}

/// Σ log(mantissa 2^exponent) over the lanes.
#[inline(always)]
pub(super) fn log_det<T: Lanes>(mantissa: T, exponent: T) -> f64 {
    let mut sum = 0.0;
    for lane in 0..T::COUNT {
        sum += mantissa.lane(lane).ln() + exponent.lane(lane) * std::f64::consts::LN_2;
    }
    sum
}
