//! Which cells of a test decide all but its measured values: where they are the same bit for bit, so is all that is made of them, and
//! nothing needs to be evaluated a second time.

use kalfit_lanes::{Isa, Kernel, Lanes};

use crate::reduce::subject::Uses;
use kalfit_model::{Label, Test};

/// Rows whose cells are looked at together.
const TOGETHER: usize = 8;

/// Where to look. It does not depend on α.
#[derive(Debug, Clone)]
pub(crate) struct CellMask {
    isa: Isa,
    /// All bits of a numeric column that is read, else none; for several rows.
    read: Vec<u64>,
    /// The same of columns that are measured: which of their cells are missing.
    measured: Vec<u64>,
    /// Text columns that are read.
    texts: Vec<usize>,
}

/// What counts of a cell.
#[inline(always)]
fn seen(x: f64, read: u64, measured: u64) -> u64 {
    (x.to_bits() & read) | (if x.is_nan() { measured } else { 0 })
}

impl CellMask {
    /// `columns`: how many numeric ones there are; `uses`: those that coefficients and times are read from.
    pub(crate) fn new(columns: usize, uses: &Uses, measured: impl Iterator<Item = usize>) -> CellMask {
        let mask = |of: &[usize]| {
            let row: Vec<u64> = (0..columns).map(|c| if of.contains(&c) { u64::MAX } else { 0 }).collect();
            row.repeat(TOGETHER)
        };
        let (read, measured) = (mask(&uses.numbers), mask(&measured.collect::<Vec<_>>()));
        CellMask { isa: Isa::best(), read, measured, texts: uses.texts.clone() }
    }

    /// A hash of what counts: of the first rows alone, or of all.
    pub(crate) fn hash(&self, test: &Test, all: bool) -> u64 {
        let rows = if all { test.rows() } else { test.rows().min(TOGETHER) };
        let cells = &test.all_numbers()[..rows * test.widths().0];
        self.texts(test, rows)
            .fold(mix(self.mixed(cells), test.rows() as u64), |hash, text| mix(hash, text.index() as u64))
    }

    /// True when all that counts is the same.
    pub(crate) fn has_same(&self, test: &Test, other: &Test) -> bool {
        (test.rows(), test.widths()) == (other.rows(), other.widths())
            && self.isa.run(SameCells { cells: test.all_numbers(), others: other.all_numbers(), mask: self })
            && self.texts(test, test.rows()).eq(self.texts(other, other.rows()))
    }

    /// The texts that are read in the first rows.
    fn texts(&self, test: &Test, rows: usize) -> impl Iterator<Item = Label> {
        let rows = if self.texts.is_empty() { 0 } else { rows };
        (0..rows).flat_map(move |row| self.texts.iter().map(move |&c| test.texts(row)[c]))
    }

    /// A hash of cells, four side by side.
    fn mixed(&self, cells: &[f64]) -> u64 {
        let mut hashes = [1u64, 2, 3, 4];
        for cells in cells.chunks(self.read.len().max(1)) {
            // there are masks for eight rows, so for whole fours
            for (cells, (read, measured)) in cells.chunks(4).zip(self.read.chunks(4).zip(self.measured.chunks(4))) {
                for (k, x) in cells.iter().enumerate() {
                    hashes[k] = mix(hashes[k], seen(*x, read[k], measured[k]));
                }
            }
        }
        hashes.into_iter().fold(0, mix)
    }
}

/// Compares what counts of cells.
struct SameCells<'a> {
    cells: &'a [f64],
    others: &'a [f64],
    mask: &'a CellMask,
}

impl Kernel for SameCells<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<T: Lanes>(self) -> bool {
        let width = self.mask.read.len().max(1);
        for (cells, others) in self.cells.chunks(width).zip(self.others.chunks(width)) {
            // of one length for the compiler: then the words go into wide registers
            let many = cells.len();
            let (others, read, measured) = (&others[..many], &self.mask.read[..many], &self.mask.measured[..many]);
            let mut differ = 0;
            for k in 0..many {
                differ |= seen(cells[k], read[k], measured[k]) ^ seen(others[k], read[k], measured[k]);
            }
            if differ != 0 {
                return false;
            }
        }
        true
    }
}

#[inline(always)]
pub(super) fn mix(hash: u64, word: u64) -> u64 {
    let product = (hash ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    product ^ (product >> 29)
}
