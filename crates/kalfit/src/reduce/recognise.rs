//! Tests of a design that was seen before, known by their cells: where all that is read but measured values is the same bit for
//! bit, so is all that is made of it, and nothing needs to be evaluated.

use kalfit_lanes::{Isa, Kernel, Lanes};

use crate::ensemble::{Label, Test};
use crate::reduce::subject::Uses;

/// Rows whose cells are looked at together.
const TOGETHER: usize = 8;

/// Where to look: which cells of a test decide all but its measured values.
#[derive(Debug, Clone)]
pub(crate) struct CellMask {
    isa: Isa,
    /// All bits of a numeric column that is read, else none; for several rows.
    mask: Vec<u64>,
    /// Text columns that are read.
    texts: Vec<usize>,
    /// Measured columns: which of their cells are missing.
    measured: Vec<usize>,
}

/// Cells of a test that others are compared with.
#[derive(Debug, PartialEq)]
pub(crate) struct DesignCells {
    rows: usize,
    /// Bits of all numeric cells, those that are not read left out.
    numbers: Vec<u64>,
    texts: Vec<Label>,
    /// Measured cells that are missing.
    missing: Vec<usize>,
}

impl CellMask {
    /// `columns`: how many numeric ones there are; `uses`: those that coefficients and times are read from.
    pub(crate) fn new(columns: usize, uses: &Uses, measured: impl Iterator<Item = usize>) -> CellMask {
        let row: Vec<u64> = (0..columns).map(|c| if uses.numbers.contains(&c) { u64::MAX } else { 0 }).collect();
        let mut measured: Vec<usize> = measured.collect();
        measured.sort_unstable();
        measured.dedup();
        CellMask { isa: Isa::best(), mask: row.repeat(TOGETHER), texts: uses.texts.clone(), measured }
    }

    /// A hash of what counts: of the first rows alone, or of all.
    pub(crate) fn hash(&self, test: &Test, all: bool) -> u64 {
        let rows = if all { test.rows() } else { test.rows().min(TOGETHER) };
        let mut hash = mix(mixed(&test.all_numbers()[..rows * test.widths().0], &self.mask), test.rows() as u64);
        for row in 0..rows {
            let (numbers, texts) = (test.numbers(row), test.texts(row));
            let missing = self.measured.iter().fold(0u64, |bits, &c| bits << 1 ^ u64::from(numbers[c].is_nan()));
            hash = mix(hash, missing);
            self.texts.iter().for_each(|&c| hash = mix(hash, texts[c].index() as u64));
        }
        hash
    }

    /// The hash as a digest, whose upper half tells what the lower one has not.
    pub(crate) fn digest(&self, test: &Test, all: bool) -> u128 {
        let hash = self.hash(test, all);
        u128::from(hash ^ hash << 32) << 64 | u128::from(hash >> 60)
    }

    /// What others are compared with.
    pub(crate) fn design_cells(&self, test: &Test) -> DesignCells {
        let missing = |row: usize| {
            let numbers = test.numbers(row);
            self.measured.iter().filter(|&&c| numbers[c].is_nan()).map(move |c| row * numbers.len() + c)
        };
        DesignCells {
            rows: test.rows(),
            numbers: test.all_numbers().iter().zip(self.mask.iter().cycle()).map(|(x, m)| x.to_bits() & m).collect(),
            texts: (0..test.rows()).flat_map(|row| self.texts.iter().map(move |&c| test.texts(row)[c])).collect(),
            missing: (0..test.rows()).flat_map(missing).collect(),
        }
    }

    /// True when all that counts is the same bit for bit. (Whether measured values are there where they were is to be seen yet.)
    pub(crate) fn has_cells(&self, test: &Test, known: &DesignCells) -> bool {
        let cells = test.all_numbers();
        if test.rows() != known.rows || cells.len() != known.numbers.len() {
            return false;
        }
        let texts = || (0..test.rows()).flat_map(|row| self.texts.iter().map(move |&c| test.texts(row)[c]));
        self.isa.run(MaskedEqual { cells, known: &known.numbers, mask: &self.mask })
            && known.missing.iter().all(|&cell| cells[cell].is_nan())
            && (self.texts.is_empty() || texts().eq(known.texts.iter().copied()))
    }
}

impl DesignCells {
    /// Bytes it occupies.
    pub(crate) fn bytes(&self) -> usize {
        8 * (self.numbers.len() + self.missing.len()) + 4 * self.texts.len() + 200
    }
}

/// Compares masked cells.
struct MaskedEqual<'a> {
    cells: &'a [f64],
    known: &'a [u64],
    mask: &'a [u64],
}

impl Kernel for MaskedEqual<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<T: Lanes>(self) -> bool {
        let width = self.mask.len().max(1);
        for (cells, known) in self.cells.chunks(width).zip(self.known.chunks(width)) {
            // of one length for the compiler: then the words go into wide registers
            let (known, mask) = (&known[..cells.len()], &self.mask[..cells.len()]);
            let mut differ = 0;
            for k in 0..cells.len() {
                differ |= (cells[k].to_bits() & mask[k]) ^ known[k];
            }
            if differ != 0 {
                return false;
            }
        }
        true
    }
}

/// A hash of masked cells, four side by side.
fn mixed(cells: &[f64], mask: &[u64]) -> u64 {
    let mut hashes = [1u64, 2, 3, 4];
    for cells in cells.chunks(mask.len().max(1)) {
        // there are masks for eight rows, so for whole fours
        for (four, mask) in cells.chunks(4).zip(mask.chunks(4)) {
            for ((hash, x), mask) in hashes.iter_mut().zip(four).zip(mask) {
                *hash = mix(*hash, x.to_bits() & mask);
            }
        }
    }
    hashes.into_iter().fold(0, mix)
}

#[inline(always)]
pub(super) fn mix(hash: u64, word: u64) -> u64 {
    let product = (hash ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    product ^ (product >> 29)
}
