//! What is remembered of the forward pass, and the parts in which it is gone back through.

use crate::reduce::{Design, DesignStep, MomentPath, SteadyStateMonitor};
use crate::score::backward::adjoint::Adjoint;
use crate::score::backward::filtered::FilteredMoments;
use crate::score::backward::input::BackwardInput;
use crate::score::backward::sink::{MeasurementAdjoint, TransitionAdjoint};

/// How long records are cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SegmentLengths {
    /// Steps from one kept state of the forward filter to the next.
    pub(super) block: usize,
    /// So many equal steps are not worth a kernel of their own,
    pub(super) few: usize,
    /// nor so many after the first [`MOST_SHORT_STRETCHES`]: the state of the filter is kept each time.
    pub(super) short: usize,
}

/// So many stretches, the first ones, are gone back through by themselves though they are short.
pub(super) const MOST_SHORT_STRETCHES: usize = 64;

impl Default for SegmentLengths {
    fn default() -> SegmentLengths {
        SegmentLengths { block: 256, few: MomentPath::FEW, short: 64 }
    }
}

/// What is remembered of the forward pass, and work space.
#[derive(Debug, Clone, Default)]
pub struct BackwardWork {
    pub(super) cut: SegmentLengths,
    /// ē of each scalar measurement.
    pub(super) e: Vec<f64>,
    pub(super) parts: Vec<Segment>,
    /// States of the forward filter, as [`FilteredMoments::save`] keeps them, where parts begin; x̄ alone within long ones.
    pub(super) marks: Vec<f64>,
    /// Those of one part, before each transition and before each measurement.
    pub(super) left: Vec<f64>,
    pub(super) before: Vec<f64>,
    pub(super) now: FilteredMoments,
    pub(super) adjoint: Adjoint,
    pub(super) settling: SteadyStateMonitor,
    pub(super) variance: Vec<f64>,
    pub(super) measured: MeasurementAdjoint,
    pub(super) moved: TransitionAdjoint,
}

impl BackwardWork {
    /// N and ρ are renewed at every step: to compare with.
    pub(crate) fn set_unfrozen(&mut self, unfrozen: bool) {
        self.settling.off = unfrozen;
    }
}

/// Steps that are gone back through together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    pub(super) kind: SegmentKind,
    /// Numbers of the first step, and of the first one after.
    pub(super) steps: (usize, usize),
    /// The stretch that the first step is of, and its number there.
    pub(super) stretch: usize,
    pub(super) skip: usize,
    /// First known input.
    pub(super) input: usize,
    /// Where the state of the forward filter before it is kept.
    pub(super) mark: usize,
}

/// How.
#[derive(Debug, Clone, Copy)]
pub(super) enum SegmentKind {
    /// One by one.
    Steps,
    /// A whole stretch of equal ones, summed.
    Equal(SegmentPass),
}

impl Segment {
    /// Its steps, in order.
    pub(super) fn steps<'a>(&self, design: &'a Design) -> std::vec::IntoIter<DesignStep<'a>> {
        let (mut stretch, mut skip) = (self.stretch, self.skip);
        let mut steps = Vec::with_capacity(self.steps.1 - self.steps.0);
        while steps.len() < self.steps.1 - self.steps.0 {
            let left = self.steps.1 - self.steps.0 - steps.len();
            steps.extend(design.stretch(stretch).steps().skip(skip).take(left));
            (stretch, skip) = (stretch + 1, 0);
        }
        steps.into_iter()
    }
}

/// The way back over a part.
pub(super) type SegmentPass = fn(&BackwardInput<'_>, &Segment, &mut BackwardWork);
