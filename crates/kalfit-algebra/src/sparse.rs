//! Sparse matrices by columns, for the derivatives of elements of Σ with respect to coordinates. With p states
//! estimated together there are about p²/2 elements and as many coordinates, and each coordinate affects at most 2p
//! elements, so that a product with such a matrix takes p⁵ steps where a dense one takes p⁶.

use nalgebra::{DMatrix, DMatrixViewMut, DVector};

/// A sparse matrix, stored by the entries of its columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Sparse {
    rows: usize,
    /// Index in `entries` where each column ends.
    ends: Vec<usize>,
    /// (row, value) of all entries, column by column, by ascending row within a column.
    entries: Vec<(usize, f64)>,
}

impl Sparse {
    /// A matrix with `rows` rows and no columns yet.
    pub fn with_height(rows: usize) -> Sparse {
        Sparse { rows, ends: Vec::new(), entries: Vec::new() }
    }

    /// The sparse form of a dense matrix.
    pub fn of(dense: &DMatrix<f64>) -> Sparse {
        let mut sparse = Sparse::with_height(dense.nrows());
        dense.column_iter().for_each(|column| sparse.push(column.iter().copied().enumerate()));
        sparse
    }

    /// Appends a column with the given (row, value) entries, in any order; entries with one row are added up.
    pub fn push(&mut self, entries: impl Iterator<Item = (usize, f64)>) {
        let start = self.entries.len();
        self.entries.extend(entries.filter(|(_, x)| *x != 0.0));
        let own = &mut self.entries[start..];
        if !own.is_sorted_by(|a, b| a.0 < b.0) {
            own.sort_by_key(|(row, _)| *row);
            let mut last = start;
            for at in start + 1..self.entries.len() {
                if self.entries[at].0 == self.entries[last].0 {
                    self.entries[last].1 += self.entries[at].1;
                } else {
                    last += 1;
                    self.entries[last] = self.entries[at];
                }
            }
            self.entries.truncate(last + 1);
        }
        self.ends.push(self.entries.len());
    }

    /// Number of rows.
    pub fn nrows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    pub fn ncols(&self) -> usize {
        self.ends.len()
    }

    /// (row, value) of the entries of column `c`, by ascending row.
    pub fn column(&self, c: usize) -> &[(usize, f64)] {
        let start = if c == 0 { 0 } else { self.ends[c - 1] };
        &self.entries[start..self.ends[c]]
    }

    /// (row, value) of the entries of each column, in the order of the columns.
    pub fn columns(&self) -> impl Iterator<Item = &[(usize, f64)]> {
        (0..self.ncols()).map(|c| self.column(c))
    }

    /// The dense matrix, rows × columns.
    pub fn dense(&self) -> DMatrix<f64> {
        let mut dense = DMatrix::zeros(self.nrows(), self.ncols());
        for (c, entries) in self.columns().enumerate() {
            entries.iter().for_each(|&(row, x)| dense[(row, c)] = x);
        }
        dense
    }

    /// The transposed matrix, columns × rows.
    pub fn transposed(&self) -> Sparse {
        let mut rows = vec![Vec::new(); self.rows];
        for (c, entries) in self.columns().enumerate() {
            entries.iter().for_each(|&(row, x)| rows[row].push((c, x)));
        }
        let mut transposed = Sparse::with_height(self.ncols());
        rows.into_iter().for_each(|entries| transposed.push(entries.into_iter()));
        transposed
    }

    /// Largest absolute entry of each row.
    pub fn row_sizes(&self) -> Vec<f64> {
        let mut sizes = vec![0.0_f64; self.rows];
        self.entries.iter().for_each(|&(row, x)| sizes[row] = sizes[row].max(x.abs()));
        sizes
    }

    /// A x.
    pub fn times(&self, x: &DVector<f64>) -> DVector<f64> {
        let mut out = DVector::zeros(self.rows);
        for (entries, x) in self.columns().zip(x.iter()) {
            entries.iter().for_each(|&(row, a)| out[row] += a * x);
        }
        out
    }

    /// A'g.
    pub fn transposed_times(&self, g: &DVector<f64>) -> DVector<f64> {
        DVector::from_iterator(self.ncols(), self.columns().map(|entries| dot(entries, g.as_slice())))
    }

    /// M A.
    pub fn after(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(m.nrows(), self.ncols());
        let height = m.nrows().max(1);
        for (target, entries) in out.as_mut_slice().chunks_exact_mut(height).zip(self.columns()) {
            for &(row, a) in entries {
                let source = &m.as_slice()[row * height..][..height];
                target.iter_mut().zip(source).for_each(|(target, x)| *target += a * x);
            }
        }
        out
    }

    /// A B.
    pub fn times_columns(&self, other: &Sparse) -> Sparse {
        let mut product = Sparse::with_height(self.rows);
        for entries in other.columns() {
            let terms = entries.iter().flat_map(|&(k, b)| self.column(k).iter().map(move |&(row, a)| (row, a * b)));
            product.push(terms);
        }
        product
    }

    /// A'MA of a symmetric M.
    pub fn congruence(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(self.ncols(), self.ncols());
        self.congruence_into(m, &mut out.as_view_mut());
        out
    }

    /// A'MA of a symmetric M; where A is the identity, M itself.
    pub fn congruence_of(&self, m: DMatrix<f64>) -> DMatrix<f64> {
        if self.is_identity() { m } else { self.congruence(&m) }
    }

    /// Writes A'MA of a symmetric M to `out`.
    pub fn congruence_into(&self, m: &DMatrix<f64>, out: &mut DMatrixViewMut<'_, f64>) {
        if 4 * self.entries.len() > self.nrows() * self.ncols() {
            let dense = self.dense();
            out.copy_from(&(dense.transpose() * m * dense));
            return;
        }
        let n = self.ncols();
        let mut own = vec![0.0; m.nrows()]; // a column of MA
        for k in 0..n {
            own.fill(0.0);
            for &(row, a) in self.column(k) {
                let source = &m.as_slice()[row * own.len()..][..own.len()];
                own.iter_mut().zip(source).for_each(|(target, x)| *target += a * x);
            }
            (0..=k).for_each(|i| out[(i, k)] = dot(self.column(i), &own));
        }
        out.fill_lower_triangle_with_upper_triangle();
    }

    /// Whether the matrix is the identity.
    pub fn is_identity(&self) -> bool {
        self.nrows() == self.ncols()
            && self.columns().enumerate().all(|(c, own)| matches!(own, [(row, 1.0)] if *row == c))
    }
}

/// Σ a_i x_i over the entries (i, a_i).
fn dot(entries: &[(usize, f64)], x: &[f64]) -> f64 {
    entries.iter().map(|&(row, a)| a * x[row]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(rows: usize, columns: usize, every: usize) -> DMatrix<f64> {
        DMatrix::from_fn(
            rows,
            columns,
            |i, k| if (i + 2 * k) % every == 0 { ((3 * i + 7 * k) as f64).sin() } else { 0.0 },
        )
    }

    #[test]
    fn products_are_those_of_dense_matrices() {
        for every in [1, 3, 7] {
            let (a, m) = (wave(9, 5, every), wave(9, 9, 1));
            let (m, b) = (&m + m.transpose(), wave(5, 4, every));
            let (x, g) = (DVector::from_fn(5, |i, _| i as f64 - 1.5), DVector::from_fn(9, |i, _| (i as f64).cos()));
            let sparse = Sparse::of(&a);
            let near = |found: DMatrix<f64>, wanted: DMatrix<f64>| {
                assert!((&found - &wanted).amax() < 1e-14, "{found} {wanted}");
            };
            near(sparse.dense(), a.clone());
            near(sparse.transposed().dense(), a.transpose());
            near(DMatrix::from_columns(&[sparse.times(&x)]), DMatrix::from_columns(&[&a * x]));
            near(DMatrix::from_columns(&[sparse.transposed_times(&g)]), DMatrix::from_columns(&[a.transpose() * g]));
            near(sparse.after(&m), &m * &a);
            near(sparse.times_columns(&Sparse::of(&b)).dense(), &a * &b);
            near(sparse.congruence(&m), a.transpose() * &m * &a);
            let sizes: Vec<f64> = a.row_iter().map(|row| row.amax()).collect();
            assert_eq!(sparse.row_sizes(), sizes);
        }
    }

    #[test]
    fn entries_of_one_place_are_added() {
        let mut sparse = Sparse::with_height(3);
        sparse.push([(2, 1.0), (0, 4.0), (2, 0.5), (1, 0.0)].into_iter());
        assert_eq!(sparse.column(0), [(0, 4.0), (2, 1.5)]);
    }
}
