//! The cells of a test that determine everything but the measured values: tests with equal bits in these cells share
//! one evaluation of design, start and inputs.

use kalfit_lanes::{Isa, Kernel, Lanes};

use crate::reduce::subject::Uses;
use kalfit_model::{Label, Test};

/// Number of rows whose cells are hashed or compared together.
const ROWS_AT_ONCE: usize = 8;

/// A mask of the cells that determine a design. It does not depend on α.
#[derive(Debug, Clone)]
pub(crate) struct CellMask {
    isa: Isa,
    /// All ones for a numeric column that is read, else zero; repeated for `ROWS_AT_ONCE` rows.
    read: Vec<u64>,
    /// All ones for a measured column, in which only whether a cell is missing counts, else zero; repeated for
    /// `ROWS_AT_ONCE` rows.
    measured: Vec<u64>,
    /// Indices of the text columns that are read.
    texts: Vec<usize>,
}

/// The bits of a cell that count: all bits if the cell is read; for a measured cell, only whether the cell is missing.
#[inline(always)]
fn counted_bits(x: f64, read: u64, measured: u64) -> u64 {
    (x.to_bits() & read) | (if x.is_nan() { measured } else { 0 })
}

impl CellMask {
    /// `columns`: number of numeric columns; `uses`: columns that coefficients and times are read from.
    pub(crate) fn new(columns: usize, uses: &Uses, measured: impl Iterator<Item = usize>) -> CellMask {
        let mask = |included: &[usize]| {
            let row: Vec<u64> = (0..columns).map(|c| if included.contains(&c) { u64::MAX } else { 0 }).collect();
            row.repeat(ROWS_AT_ONCE)
        };
        let (read, measured) = (mask(&uses.numbers), mask(&measured.collect::<Vec<_>>()));
        CellMask { isa: Isa::best(), read, measured, texts: uses.texts.clone() }
    }

    /// Hash of the cells that count, either in all rows or in the first `ROWS_AT_ONCE` rows.
    pub(crate) fn hash(&self, test: &Test, all_rows: bool) -> u64 {
        let rows = if all_rows { test.rows() } else { test.rows().min(ROWS_AT_ONCE) };
        let cells = &test.all_numbers()[..rows * test.widths().0];
        self.texts(test, rows).fold(mix_word(self.hash_cells(cells), test.rows() as u64), |hash, text| {
            mix_word(hash, text.index() as u64)
        })
    }

    /// True if two tests agree in all cells that count.
    pub(crate) fn agrees_on(&self, test: &Test, other: &Test) -> bool {
        (test.rows(), test.widths()) == (other.rows(), other.widths())
            && self.isa.run(SameCells { cells: test.all_numbers(), other_cells: other.all_numbers(), mask: self })
            && self.texts(test, test.rows()).eq(self.texts(other, other.rows()))
    }

    /// Texts that are read, in the first `rows` rows.
    fn texts(&self, test: &Test, rows: usize) -> impl Iterator<Item = Label> {
        let rows = if self.texts.is_empty() { 0 } else { rows };
        (0..rows).flat_map(move |row| self.texts.iter().map(move |&c| test.texts(row)[c]))
    }

    /// Hash of cells, by four hashes in parallel.
    fn hash_cells(&self, cells: &[f64]) -> u64 {
        let mut hashes = [1u64, 2, 3, 4];
        for cells in cells.chunks(self.read.len().max(1)) {
            // the masks cover eight rows, so that the length of a mask is a multiple of four
            for (cells, (read, measured)) in cells.chunks(4).zip(self.read.chunks(4).zip(self.measured.chunks(4))) {
                for (k, x) in cells.iter().enumerate() {
                    hashes[k] = mix_word(hashes[k], counted_bits(*x, read[k], measured[k]));
                }
            }
        }
        hashes.into_iter().fold(0, mix_word)
    }
}

/// Compares the cells of two tests under a mask.
struct SameCells<'a> {
    cells: &'a [f64],
    other_cells: &'a [f64],
    mask: &'a CellMask,
}

impl Kernel for SameCells<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<T: Lanes>(self) -> bool {
        let width = self.mask.read.len().max(1);
        for (cells, other_cells) in self.cells.chunks(width).zip(self.other_cells.chunks(width)) {
            // slices of equal length let the compiler use wide registers
            let cell_count = cells.len();
            let (other_cells, read, measured) =
                (&other_cells[..cell_count], &self.mask.read[..cell_count], &self.mask.measured[..cell_count]);
            let mut differ = 0;
            for k in 0..cell_count {
                differ |=
                    counted_bits(cells[k], read[k], measured[k]) ^ counted_bits(other_cells[k], read[k], measured[k]);
            }
            if differ != 0 {
                return false;
            }
        }
        true
    }
}

#[inline(always)]
pub(super) fn mix_word(hash: u64, word: u64) -> u64 {
    let product = (hash ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    product ^ (product >> 29)
}
