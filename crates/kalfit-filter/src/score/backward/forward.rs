//! A record cut into segments, and the forward pass over them.

use crate::reduce::DesignStep;
use crate::score::backward::filtered::FilteredMoments;
use crate::score::backward::input::BackwardInput;
use crate::score::backward::sink::Sink;
use crate::score::backward::work::{BackwardWork, KnownInnovations, MAX_SHORT_STRETCHES, Segment, SegmentKind};
use crate::score::backward::{equal, equal_backward};

impl BackwardInput<'_> {
    /// Length n + r² + n × columns of a stored state of the filter.
    pub(super) fn stride(&self) -> usize {
        let frame = &self.design.frame;
        frame.n + frame.r * frame.r + frame.n * self.moments.columns
    }

    /// Cuts the record into segments and runs the filter at ξ = x̂ under the gains of the design; stores the
    /// innovations, and the state of the filter at the start of each segment.
    pub(crate) fn forward<S: Sink>(&self, work: &mut BackwardWork, sink: &mut S) {
        self.cut(work, sink);
        work.e.clear(self.values.len());
        work.marks.clear();
        work.cut_stretches.clear();
        self.begin(&mut work.now);
        for at in 0..work.parts.len() {
            work.parts[at].mark = work.marks.len();
            if self.needs_covariance() {
                work.now.save(&mut work.marks);
            }
            let segment = work.parts[at];
            match segment.kind {
                SegmentKind::Steps => self.forward_steps(&segment, work),
                SegmentKind::Equal(_) => equal::forward(self, &segment, work),
                SegmentKind::Cut => self.forward_cut(&segment, work),
            }
        }
    }

    /// Cuts the record into segments.
    pub(crate) fn cut<S: Sink>(&self, work: &mut BackwardWork, sink: &mut S) {
        let (parts, cut, driven) = (&mut work.parts, work.cut, self.design.frame.driven.len());
        parts.clear();
        let (mut step, mut input, mut equal_segments) = (0, 0, 0);
        for (at, stretch) in self.design.stretches().enumerate() {
            let inputs = if stretch.transition.is_some() { driven } else { 0 };
            let steps = (step, step + stretch.count);
            let most_single_steps = if equal_segments < MAX_SHORT_STRETCHES { cut.few } else { cut.few.max(cut.short) };
            let long = stretch.count > most_single_steps;
            let summed = || equal_backward::kernel(self, &stretch).filter(|_| sink.accepts_sums(steps.0..steps.1));
            let segment_of = |kind, steps, skip, input| Segment { kind, steps, stretch: at, skip, input, mark: 0 };
            if self.gains.segmented(&stretch.rows).is_some() {
                parts.push(segment_of(SegmentKind::Cut, steps, 0, input));
            } else if let Some(pass) = long.then(summed).flatten() {
                equal_segments += 1;
                parts.push(segment_of(SegmentKind::Equal(pass), steps, 0, input));
            } else {
                let mut skip = 0;
                while skip < stretch.count {
                    let open = parts.last_mut().filter(|last| {
                        matches!(last.kind, SegmentKind::Steps) && last.steps.1 - last.steps.0 < cut.block
                    });
                    let start = step + skip;
                    let segment = match open {
                        Some(segment) => segment,
                        None => {
                            parts.push(segment_of(SegmentKind::Steps, (start, start), skip, input + skip * inputs));
                            parts.last_mut().expect("one was pushed")
                        }
                    };
                    let take = (stretch.count - skip).min(cut.block - (segment.steps.1 - segment.steps.0));
                    segment.steps.1 += take;
                    skip += take;
                }
            }
            step += stretch.count;
            input += stretch.count * inputs;
        }
    }

    /// Runs the filter over the steps of a segment, one by one, and stores the states that the backward pass reads.
    pub(super) fn forward_steps(&self, segment: &Segment, work: &mut BackwardWork) {
        let BackwardWork { e, left, before, now, .. } = work;
        left.clear();
        before.clear();
        self.each_position(segment.steps(self.design), segment.input, (now, e), |at, _, now| match at {
            FilterPosition::BeforeTransition if self.wanted.motion => now.save(left),
            FilterPosition::BeforeMeasurement if self.wanted.equation => now.save(before),
            _ => {}
        });
    }

    /// Runs the filter `now` over `steps` and calls `visit` at each position. `input`: index of the first known input;
    /// `e`: the innovations known so far, to which the missing innovations are appended.
    pub(super) fn each_position<'s>(
        &self,
        steps: impl Iterator<Item = DesignStep<'s>>,
        mut input: usize,
        (now, e): (&mut FilteredMoments, &mut KnownInnovations),
        mut visit: impl FnMut(FilterPosition, &DesignStep<'s>, &FilteredMoments),
    ) {
        let driven = self.design.frame.driven.len();
        for step in steps {
            if let Some(transition) = step.transition {
                visit(FilterPosition::BeforeTransition, &step, now);
                now.advance(transition.view(), &self.inputs[input..input + driven], &self.posterior());
                input += driven;
            }
            visit(FilterPosition::AfterTransition, &step, now);
            for (line, row) in step.lines.clone().zip(step.rows.clone()) {
                visit(FilterPosition::BeforeMeasurement, &step, now);
                self.measure(now, (line, row), e);
            }
            visit(FilterPosition::AfterMeasurements, &step, now);
        }
    }
}

/// Position of the forward filter in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FilterPosition {
    /// Before the transition of the step.
    BeforeTransition,
    /// After the transition.
    AfterTransition,
    /// Before one of the measurements of the step.
    BeforeMeasurement,
    /// After all measurements.
    AfterMeasurements,
}
