//! What all work on rows in lanes is made of: y ← y + Σ a x, and sums over the lanes at last.

use kalfit_lanes::Lanes;

/// Rows that are added at once: each number of y is then read and written once for four products.
const TOGETHER: usize = 4;

/// y ← y + a x.
#[inline(always)]
pub(super) fn add_one<T: Lanes>(y: &mut [f64], a: T, x: &[f64]) {
    let mut x = x.chunks_exact(T::COUNT);
    for y in y.chunks_exact_mut(T::COUNT) {
        let Some(x) = x.next() else { return };
        a.fma(T::load(x), T::load(y)).store(y);
    }
}

/// y ← y + a_0 x_0 + a_1 x_1 + a_2 x_2 + a_3 x_3.
#[inline(always)]
fn add_four<T: Lanes>(y: &mut [f64], a: [T; TOGETHER], x: [&[f64]; TOGETHER]) {
    let mut at = 0;
    for y in y.chunks_exact_mut(T::COUNT) {
        let first = a[1].fma(T::load(&x[1][at..]), a[0].fma(T::load(&x[0][at..]), T::load(y)));
        a[3].fma(T::load(&x[3][at..]), a[2].fma(T::load(&x[2][at..]), first)).store(y);
        at += T::COUNT;
    }
}

/// y ← y + Σ_k w_k x_kl x_k over `count` rows x_k, the weight of each its own number l and w_k, if there is one. Row k starts at
/// k × width of what is given.
#[inline(always)]
pub(super) fn add_weighed<T: Lanes>(
    y: &mut [f64],
    count: usize,
    (rows, width, l): (&[f64], usize, usize),
    weights: Option<&[f64]>,
) {
    let (size, step) = (y.len(), width * T::COUNT);
    let mut k = 0;
    while k + TOGETHER <= count {
        let rows = &rows[k * step..];
        let x = [&rows[..size], &rows[step..][..size], &rows[2 * step..][..size], &rows[3 * step..][..size]];
        let mut a = [at::<T>(x[0], l), at(x[1], l), at(x[2], l), at(x[3], l)];
        if let Some(weights) = weights {
            a = [
                a[0] * at(weights, k),
                a[1] * at(weights, k + 1),
                a[2] * at(weights, k + 2),
                a[3] * at(weights, k + 3),
            ];
        }
        add_four(y, a, x);
        k += TOGETHER;
    }
    while k < count {
        let x = &rows[k * step..][..size];
        let mut a = at::<T>(x, l);
        if let Some(weights) = weights {
            a = a * at(weights, k);
        }
        add_one(y, a, x);
        k += 1;
    }
}

/// The number at a place.
#[inline(always)]
pub(super) fn at<T: Lanes>(numbers: &[f64], place: usize) -> T {
    T::load(&numbers[place * T::COUNT..])
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

/// Each number over all lanes.
#[inline(always)]
pub(super) fn sums<T: Lanes>(numbers: &[f64]) -> Vec<f64> {
    let mut all = Vec::with_capacity(numbers.len() / T::COUNT);
    for x in numbers.chunks_exact(T::COUNT) {
        all.push(T::load(x).sum());
    }
    all
}
