//! The choice of the tests of an ensemble that are processed together. The choice does not depend on α and is made when
//! first needed.

use std::sync::{Arc, OnceLock};

use crate::reduce::{FilteredPhases, KnownSteps, PhasedBatches, PhasedReducer, ReduceError, Reductions, Replicates};
use crate::score::{PhasedScorer, classes_of};
use kalfit_model::PhasedTest;
use kalfit_model::{PhasedModel, Slots};

/// Classes of tests that are scored together, and batches of tests that are filtered in lanes.
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
        get_or_compute(&self.classes, || classes_of(reducer, tests, &reducer.replicates(tests)))
    }

    /// Gives a reducer the steps of the tests that are known so far.
    pub fn share_steps(&self, reducer: &mut PhasedReducer) {
        let phases = reducer.phases().len();
        reducer.share_steps(self.steps.get_or_init(|| (0..phases).map(|_| Arc::default()).collect()));
    }

    /// Reductions at the α of a reducer made for the slots, and the filtered batches for the scores; `None` in place of
    /// the batches where no score exists.
    pub fn reduce(
        &self,
        (model, slots): (&PhasedModel, &Slots),
        reducer: &mut PhasedReducer,
        tests: &[PhasedTest],
    ) -> Result<(Reductions, Option<FilteredPhases>), ReduceError> {
        if self.batches.get().is_none() && PhasedScorer::new(model, reducer, slots).is_err() {
            // where no score exists, α may decide which rows count, and therefore which tests share a batch
            return Ok((reducer.reduce(tests)?, None));
        }
        let batches = get_or_compute(&self.batches, || {
            let phases = reducer.replicates(tests);
            let Replicates { sets, alone } = get_or_compute(&self.classes, || classes_of(reducer, tests, &phases));
            let shared: Vec<usize> = sets.iter().map(|set| set[0]).collect();
            reducer.batches(tests, phases, (alone, &shared))
        });
        let (reductions, filtered) = reducer.reduce_batches(tests, batches)?;
        Ok((reductions, Some(filtered)))
    }
}

/// The value of a cell, computed on first use.
fn get_or_compute<T>(found: &OnceLock<T>, compute: impl FnOnce() -> T) -> &T {
    if found.get().is_none() {
        // the value is computed outside the lock: the computing thread may take up other work meanwhile
        let _ = found.set(compute());
    }
    found.get().expect("it was found")
}
