//! A record as segments, for passes with other data: its steps, and the P of the filter along them.

use crate::reduce::DesignStep;
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
}

/// The segments of a record, and P (r × r) before each transition (`left`) and before each scalar measurement
/// (`before`), if adjoints that need it are wanted. A stretch of equal steps has a single entry, of zeros.
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
            let part = work.parts[at];
            match part.kind {
                SegmentKind::Steps => self.one_by_one(&part, work, &mut segments),
                SegmentKind::Equal(_) => self.together(&part, work, &mut segments),
            }
        }
        segments
    }

    fn one_by_one(&'a self, part: &Segment, work: &mut BackwardWork, segments: &mut RecordSegments<'a>) {
        let RecordSegments { segments, left, before } = segments;
        if self.tracked() {
            work.now.load(&work.marks[part.mark..][..self.stride()], self.sizes());
            let BackwardWork { e, now, .. } = work;
            self.each_position(part.steps(self.design), part.input, (now, e), |at, _, now| match at {
                FilterPosition::Moves if self.wanted.motion => left.extend_from_slice(&now.P),
                FilterPosition::Measures if self.wanted.equation => before.extend_from_slice(&now.P),
                _ => {}
            });
        }
        segments.push(RecordSegment::Steps(part.steps(self.design).collect()));
    }

    fn together(&'a self, part: &Segment, work: &BackwardWork, segments: &mut RecordSegments<'a>) {
        let (stretch, place) = (self.design.stretch(part.stretch), self.design.frame.r.pow(2));
        let RecordSegments { segments, left, before } = segments;
        left.resize(left.len() + usize::from(self.wanted.motion && stretch.transition.is_some()) * place, 0.0);
        before.resize(before.len() + usize::from(self.wanted.equation) * place, 0.0);
        segments.push(RecordSegment::Equal(EqualStretch::new(self, part, work.cut.block)));
    }
}

impl BackwardWork {
    /// Representative steps of a record that was cut into segments: all steps that are handled one by one, and the
    /// first of each stretch of equal steps.
    pub(crate) fn standing(&self) -> impl Iterator<Item = usize> {
        self.parts.iter().flat_map(|part| match part.kind {
            SegmentKind::Steps => part.steps.0..part.steps.1,
            SegmentKind::Equal(_) => part.steps.0..part.steps.0 + 1,
        })
    }
}
