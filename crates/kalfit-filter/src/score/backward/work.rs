//! Stored results of the forward pass, and the segments in which the backward pass goes through a record.

use crate::reduce::{Design, DesignStep, MomentPath, SteadyStateMonitor};
use crate::score::backward::adjoint::Adjoint;
use crate::score::backward::filtered::FilteredMoments;
use crate::score::backward::input::BackwardInput;
use crate::score::backward::sink::{MeasurementAdjoint, TransitionAdjoint};
use crate::score::segments::ForwardStretch;

/// Lengths by which records are cut into segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SegmentLengths {
    /// Number of steps from one stored state of the forward filter to the next.
    pub(super) block: usize,
    /// Largest number of equal steps that are not made a separate segment.
    pub(super) few: usize,
    /// The limit in place of `few` after [`MAX_SHORT_STRETCHES`] segments of equal steps, as each segment stores a
    /// state of the filter.
    pub(super) short: usize,
}

/// Number of segments of equal steps, counted from the start of a record, up to which the limit [`SegmentLengths::few`]
/// applies.
pub(super) const MAX_SHORT_STRETCHES: usize = 64;

impl Default for SegmentLengths {
    fn default() -> SegmentLengths {
        SegmentLengths { block: 256, few: MomentPath::MOST_WITHOUT_PATH, short: 64 }
    }
}

/// Stored results of the forward pass, and work space.
#[derive(Debug, Default)]
pub struct BackwardWork {
    pub(super) cut: SegmentLengths,
    pub(super) e: KnownInnovations,
    pub(super) parts: Vec<Segment>,
    /// States of the forward filter at the start of each segment, as [`FilteredMoments::save`] writes them; within
    /// segments of equal steps, x̄ alone at the start of each block.
    pub(super) marks: Vec<f64>,
    /// States of the forward filter within one segment, before each transition (`left`) and before each measurement
    /// (`before`).
    pub(super) left: Vec<f64>,
    pub(super) before: Vec<f64>,
    /// The forward pass over each stretch that is cut into segments; `None` with data of zero.
    pub(super) cut_stretches: Vec<Option<ForwardStretch>>,
    pub(super) now: FilteredMoments,
    pub(super) adjoint: Adjoint,
    pub(super) monitor: SteadyStateMonitor,
    pub(super) variance: Vec<f64>,
    pub(super) measured: MeasurementAdjoint,
    pub(super) moved: TransitionAdjoint,
}

/// ē of the scalar measurements of a test, known from the first one to the last one that the forward pass has reached.
#[derive(Debug, Default)]
pub(super) struct KnownInnovations {
    values: Vec<f64>,
    known: usize,
}

impl KnownInnovations {
    /// All of these innovations.
    pub(super) fn all(values: Vec<f64>) -> KnownInnovations {
        KnownInnovations { known: values.len(), values }
    }

    /// Forgets all innovations, and makes room for `rows`. Memory of zeros is not touched where no innovation is
    /// written, as in segments.
    pub(super) fn clear(&mut self, rows: usize) {
        self.known = 0;
        if self.values.len() < rows {
            self.values = vec![0.0; rows];
        }
    }

    /// Number of known innovations.
    pub(super) fn known(&self) -> usize {
        self.known
    }

    /// Room for the innovations of the next `count` measurements, which are known from now on.
    pub(super) fn next(&mut self, count: usize) -> &mut [f64] {
        self.known += count;
        &mut self.values[self.known - count..self.known]
    }

    /// The known innovations.
    pub(super) fn values(&self) -> &[f64] {
        &self.values[..self.known]
    }
}

impl BackwardWork {
    /// With `unfrozen`, N and ρ are updated at every step, for comparison.
    pub(crate) fn set_unfrozen(&mut self, unfrozen: bool) {
        self.monitor.off = unfrozen;
    }
}

/// Consecutive steps that the backward pass handles together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    pub(super) kind: SegmentKind,
    /// Indices of the first step, and of the first step after the segment.
    pub(super) steps: (usize, usize),
    /// Index of the stretch of the first step (`stretch`), and index of the first step in this stretch (`skip`).
    pub(super) stretch: usize,
    pub(super) skip: usize,
    /// Index of the first known input.
    pub(super) input: usize,
    /// Index into `marks` of the filter's state before the segment.
    pub(super) mark: usize,
}

/// How the backward pass goes through a segment.
#[derive(Debug, Clone, Copy)]
pub(super) enum SegmentKind {
    /// Step by step.
    Steps,
    /// As a whole stretch of equal steps, whose adjoints are summed.
    Equal(SegmentPass),
    /// As a whole stretch that the design pass has cut into segments, whose adjoints are summed.
    Cut,
}

impl Segment {
    /// The steps of the segment, in order.
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

/// A function for the backward pass over a segment.
pub(super) type SegmentPass = fn(&BackwardInput<'_>, &Segment, &mut BackwardWork);
