//! Folding rows into an upper-triangular square-root array by plane rotations.

/// Squares in between neither overflow nor lose digits.
const SQUARES: std::ops::Range<f64> = 1e-280..1e280;

/// A rotation (c, s) and the length it leaves: c a + s b = length ≥ 0, c b - s a = 0, for a ≥ 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation {
    /// Cosine.
    pub c: f64,
    /// Sine.
    pub s: f64,
    /// √(a² + b²), without overflow.
    pub length: f64,
}

impl Rotation {
    /// The rotation that takes (a, b) to (length, 0).
    #[inline(always)]
    pub fn of(a: f64, b: f64) -> Rotation {
        if b == 0.0 && a >= 0.0 {
            return Rotation { c: 1.0, s: 0.0, length: a };
        }
        let square = a * a + b * b;
        let length = if SQUARES.contains(&square) { square.sqrt() } else { a.hypot(b) };
        Rotation { c: a / length, s: b / length, length }
    }

    /// (c a + s b, c b - s a).
    #[inline(always)]
    pub fn turn(&self, a: f64, b: f64) -> (f64, f64) {
        (self.c * a + self.s * b, self.c * b - self.s * a)
    }
}

/// √Σ x², without overflow.
pub fn norm(numbers: &[f64]) -> f64 {
    let square: f64 = numbers.iter().map(|x| x * x).sum();
    if SQUARES.contains(&square) { square.sqrt() } else { numbers.iter().fold(0.0, |n: f64, x| n.hypot(*x)) }
}

/// Folds rows into R: afterwards R'R has grown by rows'rows. With a last column of data, [T | e] into [R_J | d], the
/// last diagonal of R keeps the residual norm (Bierman 1977, ch. V). Row by row, so rows of very different size do no harm.
///
/// Shapes: `info` width × width, row-major, upper triangular with a diagonal that is not negative; `rows` m × width,
/// row-major, overwritten.
pub fn fold(info: &mut [f64], rows: &mut [f64], width: usize) {
    for row in rows.chunks_exact_mut(width) {
        fold_row(info, row, |_, _| {});
    }
}

/// Folds one row, calling `note(k, rotation)` for each rotation with row k of `info`.
#[inline(always)]
pub fn fold_row(info: &mut [f64], row: &mut [f64], mut note: impl FnMut(usize, Rotation)) {
    let width = row.len();
    for k in 0..width {
        let pivot = &mut info[k * width..][..width];
        let rotation = Rotation::of(pivot[k], row[k]);
        note(k, rotation);
        if rotation.s == 0.0 {
            continue;
        }
        (pivot[k], row[k]) = (rotation.length, 0.0);
        for (a, b) in pivot[k + 1..].iter_mut().zip(&mut row[k + 1..]) {
            (*a, *b) = rotation.turn(*a, *b);
        }
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
