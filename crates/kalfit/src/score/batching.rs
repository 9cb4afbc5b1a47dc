//! How the tests of an ensemble are worked on together. None of it depends on α: it is found once.

use std::sync::{Arc, OnceLock};

use crate::model::{PhasedModel, Slots};
use crate::reduce::{
    FilteredPhases, KnownSteps, LongDesignClasses, PhasedBatches, PhasedReducer, PhasedTest, ReduceError, Reductions,
};
use crate::score::{PhasedScorer, TestClasses};

/// Which tests are alike, and which are kept side by side.
#[derive(Debug, Default)]
pub(crate) struct Batching {
    classes: OnceLock<TestClasses>,
    blocks: OnceLock<Option<PhasedBatches>>,
    /// Long tests that are alike.
    alike: OnceLock<Arc<LongDesignClasses>>,
    /// Steps of long records, by phase.
    steps: OnceLock<Vec<Arc<KnownSteps>>>,
}

impl Batching {
    /// Which tests are alike.
    pub(crate) fn classes(&self, reducer: &PhasedReducer, tests: &[PhasedTest]) -> &TestClasses {
        if self.classes.get().is_none() {
            // not within the lock: threads that find them may take up other work meanwhile
            let _ = self.classes.set(TestClasses::of(reducer, tests));
        }
        self.classes.get().expect("they were set")
    }

    /// Lets a reducer know what steps the tests have, as far as they were found before.
    pub(crate) fn tell_steps(&self, reducer: &mut PhasedReducer) {
        let phases = reducer.phases().len();
        reducer.knowing(self.steps.get_or_init(|| (0..phases).map(|_| Arc::default()).collect()));
    }

    /// The reductions at the α of a reducer that knows the slots, and what the scores of tests in blocks go back over.
    pub(crate) fn reduce(
        &self,
        (model, slots): (&PhasedModel, &Slots),
        reducer: &mut PhasedReducer,
        tests: &[PhasedTest],
    ) -> Result<(Reductions, Option<FilteredPhases>), ReduceError> {
        let blocks = self.blocks((model, slots), reducer, tests);
        reducer.knowing_alike(self.alike.get_or_init(|| {
            let long = |classes: &TestClasses| classes.long(tests);
            Arc::new(self.classes.get().map(long).unwrap_or_default())
        }));
        match blocks {
            Some(blocks) => {
                let (reductions, filtered) = reducer.reduce_blocks(tests, blocks)?;
                Ok((reductions, Some(filtered)))
            }
            None => Ok((reducer.reduce(tests)?, None)),
        }
    }

    /// Tests with designs of their own, side by side.
    fn blocks(
        &self,
        (model, slots): (&PhasedModel, &Slots),
        reducer: &PhasedReducer,
        tests: &[PhasedTest],
    ) -> Option<&PhasedBatches> {
        if self.blocks.get().is_none() {
            PhasedScorer::new(model, reducer, slots).ok()?; // where there is no score, which rows count may depend on α
            let TestClasses { classes, alone, .. } = self.classes(reducer, tests);
            let shared: Vec<usize> = classes.iter().map(|class| class[0]).collect();
            let _ = self.blocks.set(reducer.blocks(tests, alone, &shared));
        }
        self.blocks.get()?.as_ref()
    }
}
