//! Result and work space of a design pass.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi")]

use std::ops::Range;
use std::sync::Arc;

use crate::reduce::design::Stretch;
use crate::reduce::gains::{GainSpan, Gains};
use crate::reduce::moment_path::MomentPath;
use crate::reduce::segments::{Prefixes, SegmentedStretch};
use crate::reduce::settling::SteadyStateMonitor;
use crate::reduce::sums::InformationSums;

/// Unfinished result of a design pass: gains, and sums over rows.
#[derive(Debug, Clone)]
pub(crate) struct GainSchedule {
    /// (1/S, K) of measurements; `gains`, `sensitivities`, `pieces` and `paths` become the fields of [`Gains`].
    pub(crate) gains: Vec<f64>,
    pub(crate) sensitivities: Vec<f64>,
    pub(super) pieces: Vec<GainSpan>,
    pub(crate) sums: InformationSums,
    /// (S, number of rows) for rows whose S is not in Π S of `sums`.
    pub(super) many: Vec<(f64, usize)>,
    pub(super) paths: Vec<MomentPath>,
    pub(super) segments: Vec<SegmentedStretch>,
    /// Σ log S over the rows of the segments.
    pub(super) log_determinant: f64,
}

/// Work space of the design pass. P and Ψ are the moments at the last look for a steady state and, after the pass, the
/// moments after the last step, even where P and Ψ no longer changed.
#[derive(Debug, Clone, Default)]
pub(crate) struct GainsWork {
    pub(crate) P: Vec<f64>,
    pub(crate) Psi: Vec<f64>,
    pub(crate) settling: SteadyStateMonitor,
    /// Whether P and Ψ before equal steps are stored.
    pub(crate) keeps_paths: bool,
    /// Whether gains of every row are needed, so that no stretch is cut into segments.
    pub(crate) every_row: bool,
    /// The prefixes of segments at this α.
    pub(crate) prefixes: Arc<Prefixes>,
}

impl GainSchedule {
    /// Adds the piece of a stretch whose gains were stored.
    pub(super) fn note(&mut self, piece: GainSpan, stretch: &Stretch<'_>) {
        let rows: Range<usize> = stretch.rows.clone();
        if rows.is_empty() {
            return;
        }
        let last = self.pieces.last_mut().expect("there is at least one piece");
        if piece.gain_steps < stretch.count {
            if last.gain_steps == 0 {
                self.pieces.pop();
            }
            self.pieces.push(piece);
        } else if last.width == 1 && last.row + last.gain_steps == rows.start {
            last.gain_steps += rows.len();
            last.sensitivity_steps += rows.len();
        } else {
            let steps = rows.len();
            self.pieces.push(GainSpan { width: 1, gain_steps: steps, sensitivity_steps: steps, ..piece });
        }
    }

    /// The finished information form, or `None` where square-root arrays are needed.
    pub(crate) fn finish(self, (r, p): (usize, usize), active: usize) -> Option<Gains> {
        let (factor, log_determinant) = self.sums.root(&self.many)?;
        Some(Gains {
            r,
            p,
            gains: self.gains,
            sensitivities: self.sensitivities,
            pieces: self.pieces,
            factor,
            log_determinant: log_determinant + self.log_determinant,
            active,
            rotations: None,
            end: None,
            paths: self.paths,
            segments: self.segments,
        })
    }
}
