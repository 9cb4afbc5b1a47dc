//! Folding rows into an upper-triangular square-root array by plane rotations.

use kalfit_lanes::{Lanes, MAX_LANES, Part};

/// Range of a sum of squares that has neither overflowed nor lost digits.
const SAFE_SQUARES: std::ops::RangeInclusive<f64> = 1e-280..=1e280;

/// A plane rotation (c, s) and the resulting length: c a + s b = length ≥ 0, c b - s a = 0, for a ≥ 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation<T = f64> {
    /// Cosine.
    pub c: T,
    /// Sine.
    pub s: T,
    /// √(a² + b²), without overflow.
    pub length: T,
}

impl Rotation {
    /// The rotation that takes (a, b) to (length, 0).
    #[inline(always)]
    pub fn of(a: f64, b: f64) -> Rotation {
        if b == 0.0 && a >= 0.0 {
            return Rotation { c: 1.0, s: 0.0, length: a };
        }
        let square = a * a + b * b;
        let length = if SAFE_SQUARES.contains(&square) { square.sqrt() } else { a.hypot(b) };
        Rotation { c: a / length, s: b / length, length }
    }
}

impl<T: Lanes> Rotation<T> {
    /// (c a + s b, c b - s a).
    #[inline(always)]
    pub fn turn(&self, a: T, b: T) -> (T, T) {
        (self.c * a + self.s * b, self.c * b - self.s * a)
    }
}

/// The rotation of two rows of tests in lanes.
#[derive(Debug, Clone, Copy)]
enum LaneRotation<T> {
    /// No rotation: the element to eliminate is zero in every lane.
    None,
    /// A rotation in every lane.
    All(Rotation<T>),
    /// A rotation in lanes with s ≠ 0, no rotation in lanes with s = 0.
    Some(Rotation<T>),
}

impl<T: Lanes> LaneRotation<T> {
    /// The rotation that takes (a, b) to (length, 0) in each lane; each lane has the bits of [`Rotation::of`].
    #[inline(always)]
    fn of(a: T, b: T) -> LaneRotation<T> {
        let square = a * a + b * b;
        let sound = T::splat(*SAFE_SQUARES.start()).at_most(square) && square.at_most(T::splat(*SAFE_SQUARES.end()));
        if sound && T::splat(SMALLEST_POSITIVE).at_most(b.magnitude()) {
            let length = square.root();
            return LaneRotation::All(Rotation { c: a / length, s: b / length, length });
        }
        let zero = T::splat(0.0);
        if b.magnitude().at_most(zero) && zero.at_most(a) {
            LaneRotation::None
        } else {
            LaneRotation::Some(T::apart(LaneByLane(a, b)))
        }
    }
}

/// Smallest positive `f64`, a subnormal number.
const SMALLEST_POSITIVE: f64 = f64::from_bits(1);

/// [`Rotation::of`] lane by lane.
struct LaneByLane<T>(T, T);

impl<T: Lanes> Part for LaneByLane<T> {
    type Output = Rotation<T>;

    #[inline(always)]
    fn run(self) -> Rotation<T> {
        let (mut c, mut s, mut length) = ([0.0; MAX_LANES], [0.0; MAX_LANES], [0.0; MAX_LANES]);
        for lane in 0..T::COUNT {
            let lane_rotation = Rotation::of(self.0.lane(lane), self.1.lane(lane));
            (c[lane], s[lane], length[lane]) = (lane_rotation.c, lane_rotation.s, lane_rotation.length);
        }
        Rotation { c: T::load(&c), s: T::load(&s), length: T::load(&length) }
    }
}

/// √Σ x², without overflow.
pub fn norm(numbers: &[f64]) -> f64 {
    let square: f64 = numbers.iter().map(|x| x * x).sum();
    if SAFE_SQUARES.contains(&square) { square.sqrt() } else { numbers.iter().fold(0.0, |n: f64, x| n.hypot(*x)) }
}

/// Folds rows into R: afterwards R'R has grown by rows'rows. With a last column of data, [T | e] into [R_J | d], the
/// last diagonal element of R is the residual norm (Bierman 1977, ch. V). The rows are folded one by one, so that rows
/// of very different size cost no digits.
///
/// Shapes: `info` width × width, row-major, upper triangular with a nonnegative diagonal; `rows` m × width, row-major,
/// overwritten.
pub fn fold(info: &mut [f64], rows: &mut [f64], width: usize) {
    fold_rows(info, rows, (width, width));
}

/// Number of rows that are folded at a time.
const ROWS_AT_A_TIME: usize = 8;

/// Folds `rows` into R of `info`; the result has the bits of folding one row after the other. Each row is only one
/// rotation ahead of the next row, so that the processor works on several rotations at once. Rows of `info` and `rows`
/// have `width` elements: the first `pivots` elements belong to the triangle; the other elements are data, which are
/// rotated too, and the residuals of the data remain in `rows`. A test in a lane has the bits of a test without lanes.
#[inline(always)]
pub fn fold_rows<T: Lanes>(info: &mut [T], rows: &mut [T], (pivots, width): (usize, usize)) {
    if pivots == 0 {
        return;
    }
    for rows in rows.chunks_mut(ROWS_AT_A_TIME * width) {
        let count = rows.len() / width;
        let mut rotations = [LaneRotation::None; ROWS_AT_A_TIME];
        for ahead in 0..pivots + count - 1 {
            // row i is rotated with row k = ahead - i of `info`
            let active_rows = (ahead + 1).saturating_sub(pivots)..count.min(ahead + 1);
            for i in active_rows.clone() {
                let k = ahead - i;
                rotations[i] = LaneRotation::of(info[k * width + k], rows[i * width + k]);
            }
            for i in active_rows {
                let (k, turn) = (ahead - i, rotations[i]);
                rotate_row(&mut info[k * width..][..width], &mut rows[i * width..][..width], k, turn);
            }
        }
    }
}

/// Rotates the rows `pivot` and `row` so that element k of `row` becomes zero.
#[inline(always)]
fn rotate_row<T: Lanes>(pivot: &mut [T], row: &mut [T], k: usize, turn: LaneRotation<T>) {
    match turn {
        LaneRotation::None => {}
        LaneRotation::All(rotation) => {
            (pivot[k], row[k]) = (rotation.length, T::splat(0.0));
            for (a, b) in pivot[k + 1..].iter_mut().zip(&mut row[k + 1..]) {
                (*a, *b) = rotation.turn(*a, *b);
            }
        }
        LaneRotation::Some(rotation) => {
            T::apart(RotateSomeLanes { pivot: &mut pivot[k..], row: &mut row[k..], rotation })
        }
    }
}

/// The rotation of two rows in lanes with s ≠ 0; lanes with s = 0 keep all bits, even the signs of zeros.
struct RotateSomeLanes<'a, T> {
    pivot: &'a mut [T],
    row: &'a mut [T],
    rotation: Rotation<T>,
}

impl<T: Lanes> Part for RotateSomeLanes<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [mut a, mut b] = [[0.0; MAX_LANES]; 2];
        let Rotation { c, s, length } = self.rotation;
        for (at, (pivot, row)) in self.pivot.iter_mut().zip(self.row).enumerate() {
            pivot.store(&mut a);
            row.store(&mut b);
            for lane in (0..T::COUNT).filter(|&lane| s.lane(lane) != 0.0) {
                let lane_rotation = Rotation { c: c.lane(lane), s: s.lane(lane), length: length.lane(lane) };
                (a[lane], b[lane]) =
                    if at == 0 { (lane_rotation.length, 0.0) } else { lane_rotation.turn(a[lane], b[lane]) };
            }
            (*pivot, *row) = (T::load(&a), T::load(&b));
        }
    }
}

/// Folds `row` into R of `info`, and passes (k, rotation) of the rotation with each row k of `info` to the given
/// function.
#[inline(always)]
pub fn fold_row(info: &mut [f64], row: &mut [f64], mut on_rotation: impl FnMut(usize, Rotation)) {
    let width = row.len();
    for k in 0..width {
        let pivot = &mut info[k * width..][..width];
        let rotation = Rotation::of(pivot[k], row[k]);
        on_rotation(k, rotation);
        rotate_row(pivot, row, k, if rotation.s == 0.0 { LaneRotation::None } else { LaneRotation::All(rotation) });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folding_adds_the_cross_products_of_the_rows() {
        let mut info = vec![2.0, 1.0, -3.0, 0.0, 0.0, 4.0, 0.0, 0.0, 1.0];
        let rows = [1.0, 2.0, 3.0, -1e3, 0.5, 1e-3, 0.0, 0.0, 7.0];
        let gram = |m: &[f64]| -> Vec<f64> {
            (0..9).map(|ij| m.chunks(3).map(|row| row[ij / 3] * row[ij % 3]).sum()).collect()
        };
        let expected: Vec<f64> = gram(&info).iter().zip(gram(&rows)).map(|(a, b)| a + b).collect();
        fold(&mut info, &mut rows.clone(), 3);
        for (i, (found, expected)) in gram(&info).iter().zip(&expected).enumerate() {
            assert!((found - expected).abs() <= 1e-15 * 1e6, "entry {i}: {found} against {expected}");
        }
        for k in 0..3 {
            assert!(info[k * 4] >= 0.0, "diagonal {k}: {}", info[k * 4]);
        }
    }

    #[test]
    fn rows_abreast_are_folded_to_the_same_bits_as_one_by_one() {
        for (width, count) in [(1, 1), (1, 12), (3, 2), (5, 8), (4, 9), (7, 20), (6, 0)] {
            let wave = |seed: usize, size: usize| -> Vec<f64> {
                (0..size).map(|k| if k % 5 == seed { 0.0 } else { ((seed + 7 * k) as f64).sin() }).collect()
            };
            let (mut info, mut rows) = (vec![0.0; width * width], wave(1, width * count));
            for k in 0..width {
                info[k * width..][k..width].copy_from_slice(&wave(2 * k, width)[k..]);
                info[k * (width + 1)] = (k % 3) as f64;
            }
            let (mut one_by_one, mut others) = (info.clone(), rows.clone());
            for row in others.chunks_exact_mut(width) {
                fold_row(&mut one_by_one, row, |_, _| {});
            }
            fold_rows(&mut info, &mut rows, (width, width));
            let bits = |of: &[f64]| of.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
            assert_eq!((bits(&info), bits(&rows)), (bits(&one_by_one), bits(&others)), "{width} {count}");
        }
    }

    #[test]
    fn lengths_of_any_size_are_found() {
        for size in [1.0, 1e-200, 1e200, 1e-310] {
            let found = [norm(&[3.0 * size, 0.0, -4.0 * size]), Rotation::of(3.0 * size, 4.0 * size).length];
            found.iter().for_each(|found| assert!((found / (5.0 * size) - 1.0).abs() < 1e-9, "{size}: {found}"));
        }
        assert_eq!(norm(&[]), 0.0);
    }

    #[test]
    fn extreme_rows_do_not_overflow() {
        let mut info = vec![0.0; 4];
        fold(&mut info, &mut [3e200, 0.0, 4e200, 0.0, 0.0, 1e-200], 2);
        assert!((info[0] / 5e200 - 1.0).abs() < 1e-15, "{info:?}");
        assert_eq!(info[3], 1e-200);
    }
}
