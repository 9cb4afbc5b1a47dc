//! The gains of a design: everything that the data pass needs but the data.
#![expect(non_snake_case, reason = "the letters of the theory: K, T, S, J")]

use std::sync::Arc;

use crate::reduce::exact_design::ExactDesign;
use crate::reduce::moment_path::MomentPath;
use crate::reduce::terminal::{Terminal, TerminalRoot, TerminalState};

/// A finished design pass: everything but the data.
#[derive(Debug, Clone)]
pub struct Gains {
    /// r, length of K.
    pub(crate) r: usize,
    /// p, length of T.
    pub(crate) p: usize,
    /// 1/S, K (r) of scalar measurements; 1/S = 0 for one that says nothing. Where they repeat, they are kept once.
    pub(crate) gains: Vec<f64>,
    /// T (p) of scalar measurements, likewise.
    pub(crate) sensitivities: Vec<f64>,
    /// Which are kept, in order of rows; at least one piece.
    pub(crate) pieces: Vec<GainSpan>,
    /// R with J = R'R, packed by columns.
    pub(crate) factor: Vec<f64>,
    /// Σ log S.
    pub(crate) log_determinant: f64,
    /// Number of measurements that say something.
    pub(crate) active: usize,
    /// How the data are folded, when square-root arrays made it.
    pub(crate) turns: Option<FactorRotations>,
    /// The last state, where a phase follows.
    pub(crate) end: Option<Arc<TerminalRoot>>,
    /// P and Ψ before equal steps, in order of rows, where a way back wants them.
    pub(crate) paths: Vec<MomentPath>,
}

/// Rows of equal steps and what is kept of them: of the first steps each, and the last one kept stands for all that follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GainSpan {
    /// The first row.
    pub(crate) row: usize,
    /// Rows of each step.
    pub(crate) width: usize,
    /// First kept 1/S, K, and of how many steps there are any.
    pub(crate) gain: usize,
    pub(crate) gain_steps: usize,
    /// First kept T, and of how many steps there are any.
    pub(crate) sensitivity: usize,
    pub(crate) sensitivity_steps: usize,
}

impl GainSpan {
    /// The first `rows` rows, all of them kept, each a step to itself.
    pub(crate) fn all(rows: usize) -> GainSpan {
        GainSpan { row: 0, width: 1, gain: 0, gain_steps: rows, sensitivity: 0, sensitivity_steps: rows }
    }

    /// The step of a row, and its line there.
    #[inline(always)]
    fn step(&self, row: usize) -> (usize, usize) {
        let number = row - self.row;
        if self.width == 1 { (number, 0) } else { (number / self.width, number % self.width) }
    }

    /// Steps from a row on after which S and K do not change any more; steps of one measurement.
    pub(crate) fn moving_gains(&self, row: usize) -> usize {
        (self.row + self.gain_steps).saturating_sub(row)
    }

    /// Steps after which nothing changes any more.
    pub(crate) fn moving(&self) -> usize {
        self.gain_steps.max(self.sensitivity_steps)
    }
}

/// The rotations that took [T | ·]/√S into R: the data take them too.
#[derive(Debug, Clone, Default)]
pub(crate) struct FactorRotations {
    /// (c, s) with each row of R, for each scalar measurement.
    pub(crate) folds: Vec<(f64, f64)>,
    /// What rounded small diagonals of R to zero, in order.
    pub(crate) settle: Vec<RankOperation>,
    /// What is measured exactly, beside R.
    pub(crate) exact: ExactDesign,
}

/// One operation on d.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RankOperation {
    /// Rotate rows `k` and `i` by (c, s).
    Turn { k: usize, i: usize, c: f64, s: f64 },
    /// Row `i` of R is zero now: what is left of d_i is residual.
    Drop { i: usize },
}

impl RankOperation {
    /// Does it to d; what is left of a dropped entry joins the residual sum of squares.
    #[inline]
    pub(crate) fn apply(self, d: &mut [f64], residual: &mut f64) {
        match self {
            RankOperation::Turn { k, i, c, s } => (d[k], d[i]) = (c * d[k] + s * d[i], c * d[i] - s * d[k]),
            RankOperation::Drop { i } => {
                *residual += d[i] * d[i];
                d[i] = 0.0;
            }
        }
    }
}

impl Gains {
    /// (1/S, K, T) of a scalar measurement; 1/S = 0 for one that says nothing.
    #[inline]
    pub fn row(&self, row: usize) -> (f64, &[f64], &[f64]) {
        self.of(&self.pieces[self.piece(row)], row)
    }

    /// Number of the piece that has a row.
    #[inline]
    pub(crate) fn piece(&self, row: usize) -> usize {
        if self.pieces.len() == 1 { 0 } else { self.pieces.partition_point(|piece| piece.row <= row) - 1 }
    }

    /// [`Gains::row`] of a row in this piece.
    #[inline(always)]
    pub(crate) fn of(&self, piece: &GainSpan, row: usize) -> (f64, &[f64], &[f64]) {
        let (weight, K) = self.weighted(piece, row).split_first().expect("it has 1/S");
        (*weight, K, self.sensitive(piece, row))
    }

    /// 1/S and K of a row in this piece, one after the other.
    #[inline(always)]
    pub(crate) fn weighted(&self, piece: &GainSpan, row: usize) -> &[f64] {
        let (step, line) = piece.step(row);
        let gain = piece.gain + step.min(piece.gain_steps - 1) * piece.width + line;
        &self.gains[gain * (1 + self.r)..][..1 + self.r]
    }

    /// T of a row in this piece.
    #[inline(always)]
    pub(crate) fn sensitive(&self, piece: &GainSpan, row: usize) -> &[f64] {
        let (step, line) = piece.step(row);
        let sensitivity = piece.sensitivity + step.min(piece.sensitivity_steps - 1) * piece.width + line;
        &self.sensitivities[sensitivity * self.p..][..self.p]
    }

    /// P and Ψ before the steps of the stretch with this first row, if they are kept.
    pub(crate) fn path(&self, row: usize) -> Option<&MomentPath> {
        MomentPath::of(&self.paths, row)
    }

    /// Where a test with this x̂_K, in the kernels' order, ends; `None` where no phase follows.
    pub fn terminal(&self, states: &[usize], x: &[f64]) -> Option<Terminal> {
        Some(TerminalState::new(self.end.clone()?, states, x.iter().copied()).terminal())
    }

    /// Bytes it occupies.
    pub(crate) fn bytes(&self) -> usize {
        let turns =
            self.turns.as_ref().map_or(0, |turns| 2 * turns.folds.len() + 5 * turns.settle.len() + turns.exact.len());
        let end = self.end.as_ref().map_or(0, |end| end.bytes());
        let kept = self.gains.len() + self.sensitivities.len() + 6 * self.pieces.len();
        let paths: usize = self.paths.iter().map(MomentPath::bytes).sum();
        8 * (kept + self.factor.len() + turns) + end + paths + 200
    }
}
