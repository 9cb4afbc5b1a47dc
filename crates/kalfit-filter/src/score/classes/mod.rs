//! Scores of tests that differ in their measured values only.
//!
//! A score is quadratic in the data, and the chain rule is linear in the adjoints. The part that depends on no data is
//! therefore computed once for all tests, with data of zero, and the chain rule is written once as a list of factors.
//! Each test then needs only the passes over the data of the test, in lanes: x̄ forward, u and r backward.
//!
//! ```text
//! alike tests ─┬─ one of them, data zero ── backward ── pullback ──> the design's part of dℓ/dα
//!              ├─ one of them ── pullback, adjoint by adjoint ──> factors
//!              └─ their data, in lanes ── u, r ── factors ──> the data's part
//! ```

mod classed;
mod data_backward;
mod equal;

use rayon::prelude::*;

use crate::reduce::{Design, Fault, Gains, ReduceError, Workspace};
use crate::score::backward::{AdjointsWanted, BackwardInput, BackwardWork, TerminalAdjoint};
use crate::score::moments::Moments;
use crate::score::pullback::{Adjoints, Gradient, add};
use crate::score::{PullbackSink, Scorer};
use data_backward::{ClassShared, DataBackward};

pub(crate) use classed::classes_of;
pub(crate) use data_backward::ClassMember;

/// Largest number of values that are stored per test for the steps that are passed one by one.
const MAX_STORED_NUMBERS: usize = 1 << 16;
/// Largest number of entries of all stored matrices P together.
const MAX_COVARIANCE_NUMBERS: usize = 1 << 20;
/// Largest number of measurements of a test of a class, as all innovations are stored for each lane.
const MAX_ROWS: usize = 1 << 23;
/// Number of tests that one thread processes at a time; for long tests, one thread processes as many tests as there are
/// lanes.
const TESTS_PER_TASK: usize = 256;

impl Scorer<'_> {
    /// dℓ_j/dα of the tests of a class. `shared`: moments of ξ, and adjoints of the last state from later phases, both
    /// of which differ between the tests only in x̂ and r. `None` where one pass would save nothing, or where the tests
    /// must be scored one by one.
    pub(crate) fn score_class(
        &self,
        tests: &[ClassMember<'_>],
        shared: (&Moments, Option<&TerminalAdjoint>),
        (work, backward, adjoints): (&mut Workspace, &mut BackwardWork, &mut Adjoints<'_>),
    ) -> Result<Option<Vec<Gradient>>, ReduceError> {
        let wanted = self.wanted();
        backward.set_unfrozen(self.reducer.is_unfrozen());
        let first = tests[0].test;
        let found: Result<_, Box<Fault>> = self.reducer.with_segmented_gains(first, work, |gains, work| {
            let cells = self.reducer.preparer().measured_cells(first, work)?;
            let zero_data = ZeroData::new(work, shared);
            let input = zero_data.input((&work.design, gains), wanted);
            if !input.sums_suffice(&mut PullbackSink { adjoints, test: first, work }) {
                return Ok(None);
            }
            input.cut(backward, &mut PullbackSink { adjoints, test: first, work });
            let representative_steps: Vec<usize> = backward.representative_steps().collect();
            let pays_off =
                adjoints.adjoint_count(work) * representative_steps.len() <= tests.len() * work.design.steps();
            if !pays_off || !is_within_limits(&work.design, &representative_steps, wanted) {
                return Ok(None);
            }
            let response = adjoints.response((first, work), representative_steps.into_iter())?;
            input.forward(backward, &mut PullbackSink { adjoints, test: first, work });
            let segments = input.segments(backward);
            let shared = ClassShared {
                design: &work.design,
                gains,
                start: &work.data.start,
                inputs: &work.data.inputs,
                cells: &cells,
                record: &segments,
                wanted,
                response: &response,
            };
            let design = || {
                let done = input.back(backward, &mut PullbackSink { adjoints, test: first, work });
                adjoints.finish_after(done, first, work)
            };
            let (design, data) = rayon::join(design, || data_parts(&shared, tests));
            Ok(total_scores(data, &design?))
        })?;
        // one by one, the error will be reported for the test that has it
        Ok(found.unwrap_or(None))
    }
}

/// Whether the numbers that the pass stores are within the limits.
fn is_within_limits(design: &Design, representative_steps: &[usize], wanted: AdjointsWanted) -> bool {
    let rows: usize = representative_steps.iter().map(|&k| design.step(k).rows.len()).sum();
    let many = usize::from(wanted.motion) * representative_steps.len() + usize::from(wanted.equation) * rows;
    let (n, r) = (design.frame.n, design.frame.r);
    design.rows() <= MAX_ROWS && rows + many * n <= MAX_STORED_NUMBERS && many * r * r <= MAX_COVARIANCE_NUMBERS
}

/// Input of the backward pass with all data zero.
struct ZeroData {
    start: Vec<f64>,
    inputs: Vec<f64>,
    values: Vec<f64>,
    moments: Moments,
    ending: Option<TerminalAdjoint>,
}

impl ZeroData {
    fn new(work: &Workspace, (moments, ending): (&Moments, Option<&TerminalAdjoint>)) -> ZeroData {
        let zeros = |like: &[f64]| vec![0.0; like.len()];
        ZeroData {
            start: zeros(&work.data.start),
            inputs: zeros(&work.data.inputs),
            values: zeros(&work.data.values),
            moments: Moments { mean: zeros(&moments.mean), ..moments.clone() },
            ending: ending.map(|ending| TerminalAdjoint { r: zeros(&ending.r), ..ending.clone() }),
        }
    }

    fn input<'a>(&'a self, (design, gains): (&'a Design, &'a Gains), wanted: AdjointsWanted) -> BackwardInput<'a> {
        let ZeroData { start, inputs, values, moments, ending } = self;
        BackwardInput {
            design,
            gains,
            start,
            inputs,
            values,
            zero_data: true,
            moments,
            ending: ending.as_ref(),
            wanted,
        }
    }
}

/// The data-dependent part of the score of each test.
fn data_parts(shared: &ClassShared<'_>, tests: &[ClassMember<'_>]) -> Vec<Gradient> {
    let slots = &shared.response.slots;
    let share = |tests: &[ClassMember<'_>]| {
        let found = shared.gains.lanes_of_tests().run(DataBackward { shared, tests });
        let own = |number: usize| found[number * slots.len()..][..slots.len()].iter().copied();
        (0..tests.len()).map(|number| slots.iter().copied().zip(own(number)).collect()).collect::<Vec<Gradient>>()
    };
    let lanes = shared.gains.lanes_of_tests().lanes();
    let many = if shared.design.rows() < classed::MIN_LONG_ROWS { TESTS_PER_TASK } else { lanes };
    match tests.len() <= many {
        true => share(tests),
        false => tests.par_chunks(many).flat_map_iter(share).collect(),
    }
}

/// The score of each test: the data-dependent part `data` plus the part `design`, which all tests share. `None` where a
/// score is not finite.
fn total_scores(mut data: Vec<Gradient>, design: &Gradient) -> Option<Vec<Gradient>> {
    data.iter_mut().for_each(|own| add(own, design));
    data.iter().flatten().all(|(_, x)| x.is_finite()).then_some(data)
}
