//! How the tests of an ensemble are worked on together. None of it depends on α: it is found once.

use std::sync::{Arc, OnceLock};

use crate::reduce::{FilteredPhases, KnownSteps, PhasedBatches, PhasedReducer, ReduceError, Reductions, Replicates};
use crate::score::{PhasedScorer, classes_of};
use kalfit_model::PhasedTest;
use kalfit_model::{PhasedModel, Slots};

/// Which tests are alike, and which are kept side by side.
#[derive(Debug, Default)]
pub struct Batching {
    classes: OnceLock<Replicates>,
    batches: OnceLock<PhasedBatches>,
    /// Steps of long records, by phase.
    steps: OnceLock<Vec<Arc<KnownSteps>>>,
}

impl Batching {
    /// The classes of tests that are scored together.
    pub fn classes(&self, reducer: &PhasedReducer, tests: &[PhasedTest]) -> &Replicates {
        once(&self.classes, || classes_of(reducer, tests, &reducer.replicates(tests)))
    }

    /// Lets a reducer know what steps the tests have, as far as they were found before.
    pub fn share_steps(&self, reducer: &mut PhasedReducer) {
        let phases = reducer.phases().len();
        reducer.share_steps(self.steps.get_or_init(|| (0..phases).map(|_| Arc::default()).collect()));
    }

    /// The reductions at the α of a reducer that knows the slots, and what the scores of tests in batches go back over.
    pub fn reduce(
        &self,
        (model, slots): (&PhasedModel, &Slots),
        reducer: &mut PhasedReducer,
        tests: &[PhasedTest],
    ) -> Result<(Reductions, Option<FilteredPhases>), ReduceError> {
        if self.batches.get().is_none() && PhasedScorer::new(model, reducer, slots).is_err() {
            // where there is no score, which rows count may depend on α
            return Ok((reducer.reduce(tests)?, None));
        }
        let batches = once(&self.batches, || {
            let phases = reducer.replicates(tests);
            let Replicates { sets, alone } = once(&self.classes, || classes_of(reducer, tests, &phases));
            let shared: Vec<usize> = sets.iter().map(|set| set[0]).collect();
            reducer.batches(tests, phases, (alone, &shared))
        });
        let (reductions, filtered) = reducer.reduce_batches(tests, batches)?;
        Ok((reductions, Some(filtered)))
    }
}

/// What is found once.
fn once<T>(found: &OnceLock<T>, find: impl FnOnce() -> T) -> &T {
    if found.get().is_none() {
        // not within the lock: threads that find it may take up other work meanwhile
        let _ = found.set(find());
    }
    found.get().expect("it was found")
}
