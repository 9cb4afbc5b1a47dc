//! The gains of a design: everything that the data pass needs except the data.
#![expect(non_snake_case, reason = "the letters of the theory: K, T, S, J")]

use std::ops::Range;
use std::sync::Arc;

use crate::reduce::exact_design::ExactDesign;
use crate::reduce::moment_path::MomentPath;
use crate::reduce::segments::SegmentedStretch;
use crate::reduce::segments::strands::MAX_STRANDS;
use crate::reduce::terminal::{Terminal, TerminalRoot, TerminalState};
use kalfit_lanes::{Isa, Width};

/// The result of a design pass: everything that the data pass needs except the data.
#[derive(Debug, Clone)]
pub struct Gains {
    /// r, length of K.
    pub(crate) r: usize,
    /// p, length of T.
    pub(crate) p: usize,
    /// (1/S, K) of scalar measurements, 1 + r numbers each; 1/S = 0 where S = 0. Equal gains of equal steps are stored
    /// once.
    pub(crate) gains: Vec<f64>,
    /// T of scalar measurements, p numbers each. Equal T of equal steps are stored once.
    pub(crate) sensitivities: Vec<f64>,
    /// Spans of rows, with the places of (1/S, K) in `gains` and of T in `sensitivities`; in order of rows, at least
    /// one span.
    pub(crate) pieces: Vec<GainSpan>,
    /// R with J = R'R, packed by columns.
    pub(crate) factor: Vec<f64>,
    /// Σ log S over all scalar measurements.
    pub(crate) log_determinant: f64,
    /// Number of informative scalar measurements, independent exact ones included.
    pub(crate) active: usize,
    /// Rotations to apply to the data, if square-root arrays made the gains.
    pub(crate) rotations: Option<FactorRotations>,
    /// Ψ_K and a root of P_K of the last state; `None` if no last state is wanted.
    pub(crate) end: Option<Arc<TerminalRoot>>,
    /// P and Ψ before equal steps, in order of rows, if a backward pass needs them.
    pub(crate) paths: Vec<MomentPath>,
    /// The stretches that are cut into segments, in order of rows: their rows have no gains of their own.
    pub(crate) segments: Vec<SegmentedStretch>,
}

/// Rows of equal steps, and the places of the gains and sensitivities of these rows. The first steps are stored one by
/// one; all following steps have the values of the last stored step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GainSpan {
    /// The first row.
    pub(crate) row: usize,
    /// Number of rows of each step.
    pub(crate) width: usize,
    /// Index of the first stored (1/S, K), and the number of steps for which (1/S, K) are stored.
    pub(crate) gain: usize,
    pub(crate) gain_steps: usize,
    /// Index of the first stored T, and the number of steps for which T is stored.
    pub(crate) sensitivity: usize,
    pub(crate) sensitivity_steps: usize,
}

impl GainSpan {
    /// The span of the first `rows` rows; each row is a step, and all rows are stored.
    pub(crate) fn all(rows: usize) -> GainSpan {
        GainSpan { row: 0, width: 1, gain: 0, gain_steps: rows, sensitivity: 0, sensitivity_steps: rows }
    }

    /// (Step of a row, position of the row in the step).
    #[inline(always)]
    fn step(&self, row: usize) -> (usize, usize) {
        let number = row - self.row;
        if self.width == 1 { (number, 0) } else { (number / self.width, number % self.width) }
    }

    /// Number of steps from `row` on until S and K no longer change, if each step has one measurement.
    pub(crate) fn steps_to_steady_gains(&self, row: usize) -> usize {
        (self.row + self.gain_steps).saturating_sub(row)
    }

    /// Number of steps from the first row on until S, K and T no longer change.
    pub(crate) fn moving(&self) -> usize {
        self.gain_steps.max(self.sensitivity_steps)
    }
}

/// The rotations that folded [T | ·]/√S into R; the same rotations fold the data.
#[derive(Debug, Clone, Default)]
pub(crate) struct FactorRotations {
    /// (c, s) of the rotation with each row of R, p for each scalar measurement.
    pub(crate) row_rotations: Vec<(f64, f64)>,
    /// The operations that rounded small diagonals of R to zero, in order.
    pub(crate) settle: Vec<RankOperation>,
    /// The exact measurements, whose T are not folded into R.
    pub(crate) exact: ExactDesign,
}

/// An operation on R that is repeated on d.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RankOperation {
    /// Rotate rows `k` and `i` by (c, s).
    Rotate { k: usize, i: usize, c: f64, s: f64 },
    /// Row `i` of R was set to zero: d_i becomes residual.
    Drop { i: usize },
}

impl RankOperation {
    /// Applies the operation to d; the square of a dropped entry is added to the residual sum of squares.
    #[inline]
    pub(crate) fn apply(self, d: &mut [f64], residual: &mut f64) {
        match self {
            RankOperation::Rotate { k, i, c, s } => (d[k], d[i]) = (c * d[k] + s * d[i], c * d[i] - s * d[k]),
            RankOperation::Drop { i } => {
                *residual += d[i] * d[i];
                d[i] = 0.0;
            }
        }
    }
}

impl Gains {
    /// (1/S, K, T) of a scalar measurement; 1/S = 0 where S = 0.
    #[inline]
    pub fn row(&self, row: usize) -> (f64, &[f64], &[f64]) {
        self.of(&self.pieces[self.piece(row)], row)
    }

    /// Index of the piece that contains a row.
    #[inline]
    pub(crate) fn piece(&self, row: usize) -> usize {
        if self.pieces.len() == 1 { 0 } else { self.pieces.partition_point(|piece| piece.row <= row) - 1 }
    }

    /// [`Gains::row`] of a row in this piece.
    #[inline(always)]
    pub(crate) fn of(&self, piece: &GainSpan, row: usize) -> (f64, &[f64], &[f64]) {
        let (weight, K) = self.weighted(piece, row).split_first().expect("it has 1/S");
        (*weight, K, self.sensitivity_row(piece, row))
    }

    /// 1/S, then K, of a row in this piece.
    #[inline(always)]
    pub(crate) fn weighted(&self, piece: &GainSpan, row: usize) -> &[f64] {
        let (step, line) = piece.step(row);
        let gain = piece.gain + step.min(piece.gain_steps - 1) * piece.width + line;
        &self.gains[gain * (1 + self.r)..][..1 + self.r]
    }

    /// T of a row in this piece.
    #[inline(always)]
    pub(crate) fn sensitivity_row(&self, piece: &GainSpan, row: usize) -> &[f64] {
        let (step, line) = piece.step(row);
        let sensitivity = piece.sensitivity + step.min(piece.sensitivity_steps - 1) * piece.width + line;
        &self.sensitivities[sensitivity * self.p..][..self.p]
    }

    /// P and Ψ before the steps of the stretch that begins at `row`; `None` if they were not stored.
    pub(crate) fn path(&self, row: usize) -> Option<&MomentPath> {
        MomentPath::of(&self.paths, row)
    }

    /// The segments of the stretch with these rows; `None` for a stretch that is not cut.
    pub(crate) fn segmented(&self, rows: &Range<usize>) -> Option<&SegmentedStretch> {
        let at = self.segments.binary_search_by_key(&rows.start, |stretch| stretch.rows.start).ok()?;
        Some(&self.segments[at]).filter(|stretch| stretch.rows == *rows)
    }

    /// The width in which tests of this design are filtered: one at a time where the segments of one test fill the
    /// lanes.
    pub(crate) fn lanes_of_tests(&self) -> Width {
        let fills_lanes = self.segments.iter().any(|stretch| stretch.segments() >= MAX_STRANDS);
        if fills_lanes { Isa::best().alone().into() } else { Isa::best().into() }
    }

    /// The last state of a test with this x̂_K, in kernel order; `None` if no last state was wanted.
    pub fn terminal(&self, states: &[usize], x: &[f64]) -> Option<Terminal> {
        Some(TerminalState::new(self.end.clone()?, states, x.iter().copied()).terminal())
    }

    /// Memory in bytes.
    pub(crate) fn bytes(&self) -> usize {
        let rotations = self.rotations.as_ref().map_or(0, |rotations| {
            2 * rotations.row_rotations.len() + 5 * rotations.settle.len() + rotations.exact.len()
        });
        let end = self.end.as_ref().map_or(0, |end| end.bytes());
        let stored_numbers = self.gains.len() + self.sensitivities.len() + 6 * self.pieces.len();
        let paths: usize = self.paths.iter().map(MomentPath::bytes).sum();
        let segments: usize = self.segments.iter().map(SegmentedStretch::bytes).sum();
        let mut prefixes: Vec<_> = self.segments.iter().map(|stretch| &stretch.prefix).collect();
        prefixes.dedup_by(|one, other| Arc::ptr_eq(one, other));
        let prefixes: usize = prefixes.iter().map(|prefix| prefix.bytes()).sum();
        8 * (stored_numbers + self.factor.len() + rotations) + end + paths + segments + prefixes + 200
    }
}
