//! Joins a phase with the rows of all later phases, for one test or for tests in lanes.
#![expect(non_snake_case, reason = "the letters of the theory: G, C, A the rows on σ")]

use kalfit_lanes::{Lanes, MAX_LANES, interleaved};
use nalgebra::DMatrix;

use crate::reduce::stack::phase::StackPhase;
use crate::reduce::stack::square::StackArray;
use kalfit_algebra::fold::fold_rows;

/// One phase of tests whose phases have the same sizes, with one test in each lane.
pub(super) struct JoinedPhase<T> {
    /// p, the number of elements of the phase's ξ.
    pub(super) own: usize,
    /// R, packed by columns.
    factor: Vec<T>,
    /// Link that leads to the phase; `None` for the first phase.
    pub(super) link: Option<PhaseLink<T>>,
    /// d, q numbers; `mean`: g of the link that leads to the phase, q numbers.
    data: Vec<T>,
    mean: Vec<T>,
}

/// The link that leads to a phase, matrices by columns.
pub(super) struct PhaseLink<T> {
    /// G, q × the number of entering coordinates of the phase before.
    pub(super) G: Matrix<T>,
    /// C, q × at most q columns.
    pub(super) C: Matrix<T>,
}

/// A matrix by columns.
pub(super) struct Matrix<T> {
    rows: usize,
    columns: usize,
    entries: Vec<T>,
}

/// Memory that is reused from one join to the next.
pub(super) struct JoinWorkspace<T> {
    array: Vec<T>,
    rows: Vec<T>,
}

impl<T> Default for JoinWorkspace<T> {
    fn default() -> JoinWorkspace<T> {
        JoinWorkspace { array: Vec::new(), rows: Vec::new() }
    }
}

/// One list for each test, from numbers in lanes.
#[inline(always)]
pub(super) fn per_test<T: Lanes>(numbers: &[T], tests: usize) -> Vec<Vec<f64>> {
    let mut all = Vec::with_capacity(tests);
    for _ in 0..tests {
        all.push(Vec::with_capacity(numbers.len()));
    }
    let mut one = [0.0; MAX_LANES];
    for x in numbers {
        x.store(&mut one);
        for (own, x) in all.iter_mut().zip(one) {
            own.push(x);
        }
    }
    all
}

impl<T: Lanes> JoinedPhase<T> {
    /// Phase `at` of tests whose phases have the same sizes; at least one test, at most one test per lane.
    #[inline(always)]
    pub(super) fn new(tests: &[&[StackPhase<'_>]], at: usize) -> JoinedPhase<T> {
        let (count, first) = (tests.len(), &tests[0][at]);
        let mut link = None;
        if let Some(like) = first.link {
            let sensitivity = Matrix::new(like[0], count, |lane| link_of(&tests[lane][at])[0].as_slice());
            let root = Matrix::new(like[1], count, |lane| link_of(&tests[lane][at])[1].as_slice());
            let transition = Matrix::new(like[2], count, |lane| link_of(&tests[lane][at])[2].as_slice());
            link = Some(PhaseLink { G: transition.times(&sensitivity), C: transition.times(&root).narrowed() });
        }
        let mean = interleaved(count, |lane| tests[lane][at].mean.map_or(&[][..], |mean| mean.as_slice()));
        let data = interleaved(count, |lane| tests[lane][at].data);
        let factor = interleaved(count, |lane| tests[lane][at].factor);
        JoinedPhase { own: first.own, factor, link, data, mean }
    }

    /// The rows of the last phase, as an array in `memory`.
    #[inline(always)]
    pub(super) fn last(&self, memory: Vec<T>) -> StackArray<T> {
        let mut array = StackArray::zeros(self.data.len(), memory);
        array.put_packed(0, &self.factor, self.data.len());
        array.put_data(0, &self.data);
        array
    }

    /// Joins the phase with `later`, the rows of all later phases, of which `next` is the first. Returns the rows on
    /// (σ_i, ξ_{i+1}, …) and the diagonal of the rows of u. The squares of the remaining data are added to `residual`.
    #[inline(always)]
    pub(super) fn join(
        &self,
        next: &JoinedPhase<T>,
        later: StackArray<T>,
        residual: &mut T,
        room: &mut JoinWorkspace<T>,
    ) -> (StackArray<T>, Vec<T>) {
        let PhaseLink { G, C } = next.link.as_ref().expect("a later phase has a link");
        let (u, entering_count, q, own) = (C.columns, G.columns, next.data.len(), next.own);
        let size = u + entering_count + own + later.width - q;
        let mut array = StackArray::zeros(size, std::mem::take(&mut room.array));
        for k in 0..u {
            array.entries[k * (array.stride + 1)] = T::splat(1.0);
        }
        array.put_packed(u, &self.factor, entering_count);
        array.put_data(u, &self.data);
        later.copy_from(q, &mut array, u + entering_count + own);
        let rows = &mut room.rows;
        rows.clear();
        rows.resize(q * array.stride, T::splat(0.0));
        for (i, row) in rows.chunks_exact_mut(array.stride.max(1)).enumerate() {
            let (A, B) = later.row(i).split_at(q);
            for c in 0..u {
                row[c] = dot(&A[i..], &C.column(c)[i..]);
            }
            for c in 0..entering_count {
                row[u + c] = dot(&A[i..], &G.column(c)[i..]);
            }
            let rest = &mut row[u + entering_count..];
            rest[..own].copy_from_slice(&A[..own]);
            rest[own..][..B.len()].copy_from_slice(B);
            row[array.width] = later.data(i) - dot(&A[i..], &next.mean[i..]);
        }
        fold_rows(&mut array.entries, rows, (array.width, array.stride));
        for row in rows.chunks_exact(array.stride) {
            *residual = *residual + row[array.width] * row[array.width];
        }
        let mut diagonal = Vec::with_capacity(u);
        for k in 0..u {
            diagonal.push(array.row(k)[k]);
        }
        let mut rest = StackArray::zeros(array.width - u, later.entries);
        array.copy_from(u, &mut rest, 0);
        room.array = array.entries;
        (rest, diagonal)
    }
}

fn link_of<'a>(phase: &StackPhase<'a>) -> [&'a DMatrix<f64>; 3] {
    phase.link.expect("all tests have this link")
}

/// Σ ab.
#[inline(always)]
fn dot<T: Lanes>(a: &[T], b: &[T]) -> T {
    let mut sum = T::splat(0.0);
    for (&a, &b) in a.iter().zip(b) {
        sum = sum + a * b;
    }
    sum
}

impl<T: Lanes> Matrix<T> {
    #[inline(always)]
    fn new<'a>(like: &DMatrix<f64>, tests: usize, entries: impl Fn(usize) -> &'a [f64]) -> Matrix<T> {
        Matrix { rows: like.nrows(), columns: like.ncols(), entries: interleaved(tests, entries) }
    }

    #[inline(always)]
    fn column(&self, c: usize) -> &[T] {
        &self.entries[c * self.rows..][..self.rows]
    }

    #[inline(always)]
    fn times(&self, other: &Matrix<T>) -> Matrix<T> {
        let mut entries = vec![T::splat(0.0); self.rows * other.columns];
        for c in 0..other.columns {
            let product = &mut entries[c * self.rows..][..self.rows];
            for (k, &x) in other.column(c).iter().enumerate() {
                for (product, &own) in product.iter_mut().zip(self.column(k)) {
                    *product = *product + own * x;
                }
            }
        }
        Matrix { rows: self.rows, columns: other.columns, entries }
    }

    /// A root of AA' with no more columns than rows.
    #[inline(always)]
    fn narrowed(self) -> Matrix<T> {
        let q = self.rows;
        if self.columns <= q {
            return self;
        }
        let (mut U, mut rows) = (vec![T::splat(0.0); q * q], self.entries); // A' by rows is A by columns
        fold_rows(&mut U, &mut rows, (q, q));
        Matrix { rows: q, columns: q, entries: U } // U' by columns is U by rows
    }

    /// The matrix of each test.
    #[inline(always)]
    pub(super) fn per_test(&self, tests: usize) -> Vec<DMatrix<f64>> {
        let mut all = Vec::with_capacity(tests);
        for entries in per_test(&self.entries, tests) {
            all.push(DMatrix::from_vec(self.rows, self.columns, entries));
        }
        all
    }
}
