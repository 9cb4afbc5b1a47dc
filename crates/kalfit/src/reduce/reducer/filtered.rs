//! What the filters of tests with designs of their own leave, run side by side.

use crate::reduce::Terminal;
use crate::reduce::data::{Data, Outcome};
use crate::reduce::design::Design;
use crate::reduce::end::{End, placed};
use crate::reduce::gains::Gains;
use crate::reduce::lanes::{Block, Gained, Room};
use crate::reduce::prepare::Workspace;
use crate::reduce::reducer::Reducer;
use crate::reduce::reducer::queue::Own;

/// Tests in lanes, after their filters and data passes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Filtered<'a> {
    reducer: &'a Reducer,
    tests: &'a [Own],
    block: &'a Block,
    gained: &'a Gained,
    room: &'a Room,
}

/// What is known of one of them.
#[derive(Debug)]
pub(crate) struct Filter<'a> {
    pub(crate) outcome: Outcome,
    /// R, packed.
    pub(crate) factor: &'a [f64],
    /// Where it ends, if that is wanted.
    pub(crate) end: Option<End>,
}

impl Reducer {
    /// Runs the filters of tests whose designs have one shape, no more of them than there are lanes, and takes note of their
    /// designs.
    pub(crate) fn filter<'a>(&'a self, tests: &'a [Own], work: &'a mut Workspace) -> Filtered<'a> {
        let all: Vec<(&Design, &Data)> = tests.iter().map(|own| (&own.design, &own.data)).collect();
        filters(&all, work);
        let Workspace { block, room, gained, .. } = work;
        Filtered { reducer: self, tests, block, gained, room }
    }
}

/// Runs the filters of tests whose designs have one shape, at least one and no more of them than there are lanes, in the work space;
/// returns the longest design.
pub(crate) fn filters<'d>(tests: &[(&'d Design, &Data)], work: &mut Workspace) -> &'d Design {
    let Workspace { block, room, gained, .. } = work;
    let (longest, data) = *tests.iter().max_by_key(|(design, _)| design.runs.len()).expect("there is a test");
    block.clear(data.start.len(), data.inputs.len(), data.values.len());
    for (lane, (_, data)) in tests.iter().enumerate() {
        block.begin(lane, &data.start, &data.inputs);
        block.values(lane, data.values.iter().copied());
    }
    let designs: Vec<&Design> = tests.iter().map(|(design, _)| *design).collect();
    block.filter((&designs, longest), gained, room);
    longest
}

impl<'a> Filtered<'a> {
    /// What the filter of a test found; `None` where square-root arrays are called for or something is not finite.
    pub(crate) fn of(&self, lane: usize) -> Option<Filter<'a>> {
        let (reducer, own, gained) = (self.reducer, &self.tests[lane], self.gained);
        let (factor, log_determinant) = gained.found[lane].as_ref()?;
        let rows = own.design.rows();
        let outcome = self.block.outcome(lane, (rows, *log_determinant), self.room);
        let place = (lane, self.block.lanes());
        let end = match reducer.ends {
            true => Some(self.gained.end(place, &reducer.preparer.order.states)?),
            false => None,
        };
        if !outcome.is_finite() {
            return None;
        }
        reducer.ran(own.digest, || {
            let gains = self.gained.gains(place, rows).expect("only sound filters are noted");
            (own.design.clone(), Gains { end: end.clone(), ..gains })
        });
        Some(Filter { outcome, factor, end })
    }

    /// e and 1/S of each measurement of a test.
    pub(crate) fn innovations(&self, lane: usize) -> impl Iterator<Item = (f64, f64)> + use<'a> {
        let weights = self.gained.weights((lane, self.block.lanes()), self.tests[lane].design.rows());
        self.block.innovations(lane, self.room).zip(weights)
    }

    /// The last state of a test, with where its design ends.
    pub(crate) fn terminal(&self, lane: usize, End { sensitivity, root }: End) -> Terminal {
        let mean = placed(&self.reducer.preparer.order.states, self.block.last(lane, self.room));
        Terminal { mean, sensitivity, root }
    }
}
