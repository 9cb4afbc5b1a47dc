//! The segments of a record, for passes over other data: the steps of the record, and P of the filter before them.

use crate::reduce::segments::SegmentedStretch;
use crate::reduce::{DesignStep, Stretch};
use crate::score::backward::equal::EqualStretch;
use crate::score::backward::forward::FilterPosition;
use crate::score::backward::input::BackwardInput;
use crate::score::backward::work::{BackwardWork, Segment, SegmentKind};

/// Consecutive steps that a pass handles as one segment.
#[derive(Debug)]
pub(crate) enum RecordSegment<'a> {
    /// Steps handled one by one.
    Steps(Vec<DesignStep<'a>>),
    /// Equal steps of one scalar measurement each.
    Equal(EqualStretch<'a>),
    /// Equal steps that the design pass has cut into segments.
    Cut(Stretch<'a>, &'a SegmentedStretch),
}

/// The segments of a record, and P (r × r) before each transition (`left`) and before each scalar measurement
/// (`before`), where the wanted adjoints depend on P. A stretch of equal steps has one P, of zeros.
#[derive(Debug, Default)]
pub(crate) struct RecordSegments<'a> {
    pub(crate) segments: Vec<RecordSegment<'a>>,
    pub(crate) left: Vec<f64>,
    pub(crate) before: Vec<f64>,
}

impl<'a> BackwardInput<'a> {
    /// The segments of the record, after the forward pass over it.
    pub(crate) fn segments(&'a self, work: &mut BackwardWork) -> RecordSegments<'a> {
        let mut segments = RecordSegments::default();
        for at in 0..work.parts.len() {
            let segment = work.parts[at];
            match segment.kind {
                SegmentKind::Steps => self.push_steps(&segment, work, &mut segments),
                SegmentKind::Equal(_) => self.push_equal(&segment, work, &mut segments),
                SegmentKind::Cut => self.push_cut(&segment, &mut segments),
            }
        }
        segments
    }

    fn push_steps(&'a self, segment: &Segment, work: &mut BackwardWork, segments: &mut RecordSegments<'a>) {
        let RecordSegments { segments, left, before } = segments;
        if self.needs_covariance() {
            work.now.load(&work.marks[segment.mark..][..self.stride()], self.sizes());
            let BackwardWork { e, now, .. } = work;
            self.each_position(segment.steps(self.design), segment.input, (now, e), |at, _, now| match at {
                FilterPosition::BeforeTransition if self.wanted.motion => left.extend_from_slice(&now.P),
                FilterPosition::BeforeMeasurement if self.wanted.equation => before.extend_from_slice(&now.P),
                _ => {}
            });
        }
        segments.push(RecordSegment::Steps(segment.steps(self.design).collect()));
    }

    fn push_equal(&'a self, segment: &Segment, work: &BackwardWork, segments: &mut RecordSegments<'a>) {
        let (stretch, place) = (self.design.stretch(segment.stretch), self.design.frame.r.pow(2));
        let RecordSegments { segments, left, before } = segments;
        left.resize(left.len() + usize::from(self.wanted.motion && stretch.transition.is_some()) * place, 0.0);
        before.resize(before.len() + usize::from(self.wanted.equation) * place, 0.0);
        segments.push(RecordSegment::Equal(EqualStretch::new(self, segment, work.cut.block)));
    }

    fn push_cut(&'a self, segment: &Segment, segments: &mut RecordSegments<'a>) {
        let (stretch, place) = (self.design.stretch(segment.stretch), self.design.frame.r.pow(2));
        let RecordSegments { segments, left, before } = segments;
        left.resize(left.len() + usize::from(self.wanted.motion && stretch.transition.is_some()) * place, 0.0);
        before.resize(before.len() + usize::from(self.wanted.equation) * place, 0.0);
        segments.push(RecordSegment::Cut(stretch, self.cut_stretch(segment)));
    }
}

impl BackwardWork {
    /// Indices of the representative steps of a record that was cut into segments: all steps that are handled one by
    /// one, and the first of each stretch of equal steps.
    pub(crate) fn representative_steps(&self) -> impl Iterator<Item = usize> {
        self.parts.iter().flat_map(|segment| match segment.kind {
            SegmentKind::Steps => segment.steps.0..segment.steps.1,
            SegmentKind::Equal(_) | SegmentKind::Cut => segment.steps.0..segment.steps.0 + 1,
        })
    }
}
