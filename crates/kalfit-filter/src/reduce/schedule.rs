//! What a design pass leaves, and its work space.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi")]

use std::ops::Range;

use crate::reduce::design::Stretch;
use crate::reduce::gains::{GainSpan, Gains};
use crate::reduce::moment_path::MomentPath;
use crate::reduce::settling::SteadyStateMonitor;
use crate::reduce::sums::InformationSums;

/// What a design pass leaves.
#[derive(Debug, Clone)]
pub(crate) struct GainSchedule {
    /// As in [`Gains`].
    pub(crate) gains: Vec<f64>,
    pub(crate) sensitivities: Vec<f64>,
    pub(super) pieces: Vec<GainSpan>,
    pub(crate) sums: InformationSums,
    /// Rows that Π S lacks: (S, how many).
    pub(super) many: Vec<(f64, usize)>,
    pub(super) paths: Vec<MomentPath>,
}

/// Work space of the design pass: P and Ψ, when they were last looked at; afterwards those of the last step, of steps that changed
/// nothing any more too.
#[derive(Debug, Clone, Default)]
pub(crate) struct GainsWork {
    pub(crate) P: Vec<f64>,
    pub(crate) Psi: Vec<f64>,
    pub(crate) settling: SteadyStateMonitor,
    /// P and Ψ before equal steps are wanted.
    pub(crate) keeps_paths: bool,
}

impl GainSchedule {
    /// Notes what is kept of a stretch.
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

    /// The finished information form, or `None` where square-root arrays are called for.
    pub(crate) fn finish(self, (r, p): (usize, usize), active: usize) -> Option<Gains> {
        let (factor, log_determinant) = self.sums.root(&self.many)?;
        Some(Gains {
            r,
            p,
            gains: self.gains,
            sensitivities: self.sensitivities,
            pieces: self.pieces,
            factor,
            log_determinant,
            active,
            turns: None,
            end: None,
            paths: self.paths,
        })
    }
}
