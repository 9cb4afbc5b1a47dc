//! Singular values by one-sided plane rotations (Hestenes 1958): small singular values lose no digits.

use nalgebra::DMatrix;

/// Largest number of sweeps over all pairs of columns: an iteration that has not converged after so many never will.
const MAX_SWEEPS: usize = 60;

/// A = U Λ V'.
#[derive(Debug, Clone)]
pub(super) struct SingularValues {
    /// U, m × m, orthogonal.
    pub(super) left: DMatrix<f64>,
    /// A'U = VΛ, c × m, with orthogonal columns.
    pub(super) scaled_right: DMatrix<f64>,
    /// Λ, the lengths of the columns of A'U, in descending order.
    pub(super) values: Vec<f64>,
}

impl SingularValues {
    /// The decomposition of A, m × c.
    pub(super) fn of(a: &DMatrix<f64>) -> SingularValues {
        let m = a.nrows();
        let (mut scaled_right, mut left) = (a.transpose(), DMatrix::identity(m, m));
        for _ in 0..MAX_SWEEPS {
            let mut turned = false;
            for i in 0..m {
                for j in i + 1..m {
                    turned |= turn(&mut scaled_right, &mut left, (i, j));
                }
            }
            if !turned {
                break;
            }
        }
        let length: Vec<f64> = (0..m).map(|k| scaled_right.column(k).norm()).collect();
        let mut order: Vec<usize> = (0..m).collect();
        order.sort_by(|&i, &j| length[j].total_cmp(&length[i]));
        SingularValues {
            left: left.select_columns(&order),
            scaled_right: scaled_right.select_columns(&order),
            values: order.iter().map(|&k| length[k]).collect(),
        }
    }

    /// Number of values above `part` times the largest.
    pub(super) fn rank(&self, part: f64) -> usize {
        let floor = self.values.first().map_or(0.0, |largest| part * largest);
        self.values.iter().filter(|value| **value > floor).count()
    }
}

/// Makes columns i and j orthogonal; false where the columns are orthogonal already.
fn turn(scaled_right: &mut DMatrix<f64>, left: &mut DMatrix<f64>, (i, j): (usize, usize)) -> bool {
    let (a, b) = (scaled_right.column(i).norm_squared(), scaled_right.column(j).norm_squared());
    let product = scaled_right.column(i).dot(&scaled_right.column(j));
    if product.abs() <= 2.0 * f64::EPSILON * a.sqrt() * b.sqrt() {
        return false;
    }
    let zeta = (b - a) / (2.0 * product);
    let t = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
    let c = t.hypot(1.0).recip();
    let s = c * t;
    for matrix in [scaled_right, left] {
        for row in 0..matrix.nrows() {
            let (x, y) = (matrix[(row, i)], matrix[(row, j)]);
            (matrix[(row, i)], matrix[(row, j)]) = (c * x - s * y, s * x + c * y);
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn singular_matrices_come_apart_into_orthogonal_directions() {
        // rows: two independent ones, their sum, a tiny one, one of zeros
        let a = DMatrix::from_row_slice(
            5,
            3,
            &[3.0, 1.0, 0.0, 1.0, -2.0, 0.0, 4.0, -1.0, 0.0, 0.0, 0.0, 1e-9, 0.0, 0.0, 0.0],
        );
        let found = SingularValues::of(&a);
        let back = &found.left * found.scaled_right.transpose();
        let (off, turned) =
            ((&back - &a).amax(), (found.left.transpose() * &found.left - DMatrix::identity(5, 5)).amax());
        assert!(off < 1e-15 * 10.0 && turned < 1e-14, "{off:e} {turned:e}");
        assert_eq!((found.rank(1e-10), found.rank(1e-8)), (3, 2), "{:?}", found.values);
        assert!((found.values[2] / 1e-9 - 1.0).abs() < 1e-14, "{:?}", found.values);
    }

    #[test]
    fn nothing_has_no_directions() {
        let found = SingularValues::of(&DMatrix::zeros(0, 0));
        assert_eq!((found.values.len(), found.rank(1e-10)), (0, 0));
        assert_eq!(SingularValues::of(&DMatrix::zeros(3, 2)).rank(1e-10), 0);
        assert_eq!(SingularValues::of(&DMatrix::zeros(3, 0)).rank(1e-10), 0);
    }
}
