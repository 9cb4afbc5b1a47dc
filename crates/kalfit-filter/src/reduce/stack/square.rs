//! Square upper triangular arrays, of one test or of tests in lanes.

use kalfit_lanes::Lanes;

/// A square upper triangular array, row-major, followed by a column of data.
pub(super) struct StackArray<T> {
    pub(super) width: usize,
    /// Length of a row: the width plus the column of data.
    pub(super) stride: usize,
    pub(super) entries: Vec<T>,
}

impl<T: Lanes> StackArray<T> {
    /// An array of zeros in reused memory.
    #[inline(always)]
    pub(super) fn zeros(width: usize, mut memory: Vec<T>) -> StackArray<T> {
        let stride = width + 1;
        memory.clear();
        memory.resize(width * stride, T::splat(0.0));
        StackArray { width, stride, entries: memory }
    }

    /// Writes a packed factor, `size` × `size`, at (at, at).
    #[inline(always)]
    pub(super) fn put_packed(&mut self, at: usize, factor: &[T], size: usize) {
        for k in 0..size {
            for i in 0..=k {
                self.entries[(at + i) * self.stride + at + k] = factor[i + k * (k + 1) / 2];
            }
        }
    }

    /// Writes `data` to the last column, from row `at` on.
    #[inline(always)]
    pub(super) fn put_data(&mut self, at: usize, data: &[T]) {
        for (i, &x) in data.iter().enumerate() {
            self.entries[(at + i) * self.stride + self.width] = x;
        }
    }

    /// Copies the rows and columns from `first` on, with the data of the rows, to the last rows and columns of `to`,
    /// which begin at (at, at).
    #[inline(always)]
    pub(super) fn copy_from(&self, first: usize, to: &mut StackArray<T>, at: usize) {
        let size = self.stride - first;
        for i in 0..self.width - first {
            let row = &self.entries[(first + i) * self.stride + first..][..size];
            to.entries[(at + i) * to.stride + at..][..size].copy_from_slice(row);
        }
    }

    #[inline(always)]
    pub(super) fn row(&self, i: usize) -> &[T] {
        &self.entries[i * self.stride..][..self.width]
    }

    /// The data of a row.
    #[inline(always)]
    pub(super) fn data(&self, i: usize) -> T {
        self.entries[i * self.stride + self.width]
    }

    /// The upper triangle, packed by columns, followed by the data.
    #[inline(always)]
    pub(super) fn packed(&self) -> Vec<T> {
        let mut packed = Vec::with_capacity(self.width * (self.width + 3) / 2);
        for k in 0..self.stride {
            for i in 0..(k + 1).min(self.width) {
                packed.push(self.entries[i * self.stride + k]);
            }
        }
        packed
    }

    /// True when in every lane each diagonal entry is at least 2 × `part` times the norm of the column, and the squared
    /// norm is between 1e-280 and 1e280.
    #[inline(always)]
    pub(super) fn is_regular(&self, part: f64) -> bool {
        let (least, most, part) = (T::splat(1e-280), T::splat(1e280), T::splat(4.0 * part * part));
        let mut is_regular = true;
        for k in 0..self.width {
            let mut square = T::splat(0.0);
            for i in 0..=k {
                let x = self.entries[i * self.stride + k];
                square = x.fma(x, square);
            }
            let diagonal = self.entries[k * self.stride + k];
            is_regular &= least.at_most(square) && square.at_most(most) && (part * square).at_most(diagonal * diagonal);
        }
        is_regular
    }
}
