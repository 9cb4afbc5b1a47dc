//! The column echelon form of a basis.

use nalgebra::DMatrix;

/// A pivot below this fraction of the largest entry of the basis counts as zero.
const RANK_TOLERANCE: f64 = 1e-11;

/// The pivots (pivot row of each column), and a basis (n × rank) of the space spanned by the columns of `basis` (n ×
/// columns); the pivot rows of the result form the identity. Each pivot is the largest remaining entry; the rank is
/// reached where no remaining entry is above the tolerance.
pub fn echelon(mut basis: DMatrix<f64>) -> (Vec<usize>, DMatrix<f64>) {
    let mut pivots: Vec<usize> = Vec::new();
    let floor = RANK_TOLERANCE * basis.amax();
    for c in 0..basis.ncols() {
        let free_rows = (0..basis.nrows()).filter(|i| !pivots.contains(i));
        let candidates = free_rows.flat_map(|i| (c..basis.ncols()).map(move |k| (i, k)));
        let size = |&(i, k): &(usize, usize)| basis[(i, k)].abs();
        let largest = candidates.max_by(|a, b| size(a).total_cmp(&size(b)).then(b.cmp(a)));
        let Some((row, column)) = largest.filter(|at| size(at) > floor) else { break };
        basis.swap_columns(c, column);
        let pivot = basis[(row, c)];
        basis.column_mut(c).unscale_mut(pivot);
        for k in (0..basis.ncols()).filter(|&k| k != c) {
            let part = basis.column(c) * basis[(row, k)];
            basis.set_column(k, &(basis.column(k) - part));
            basis[(row, k)] = 0.0; // exactly zero
        }
        pivots.push(row);
    }
    let rank = pivots.len();
    (pivots, basis.columns(0, rank).clone_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_echelon_form_spans_the_same_space_and_finds_the_rank() {
        let basis = DMatrix::from_row_slice(4, 3, &[1.0, 2.0, 3.0, 0.5, -1.0, -0.5, 0.0, 4.0, 4.0, 2.0, 1.0, 3.0]);
        let (pivots, reduced) = echelon(basis.clone());
        assert_eq!((pivots.len(), reduced.shape()), (2, (4, 2)), "the third column is the sum of the others");
        let again = &reduced * basis.select_rows(&pivots);
        assert!((&again - &basis).amax() < 1e-14, "{again} {basis}");
    }

    #[test]
    fn nothing_spans_nothing() {
        assert_eq!(echelon(DMatrix::zeros(3, 2)).0, Vec::<usize>::new());
        assert_eq!(echelon(DMatrix::zeros(3, 0)).1.shape(), (3, 0));
    }
}
