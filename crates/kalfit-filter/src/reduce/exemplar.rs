//! Replicates → reductions: one replicate is evaluated and gives the gains for the data passes of all replicates, which
//! run in lanes.

use rayon::prelude::*;

use crate::reduce::chunk_size::chunk_size;
use crate::reduce::class::DesignClass;
use crate::reduce::measured_cells::MeasuredCells;
use crate::reduce::prepare::Workspace;
use crate::reduce::reduced_tests::ReducedTests;
use crate::reduce::reducer::{Reducer, ReductionHeader};
use kalfit_model::Test;

/// Largest number of scalar measurements of a test that is reduced in lanes: values and innovations are in memory for
/// every lane.
pub(crate) const MAX_ROWS_IN_LANES: usize = 1 << 22;

/// Total number of rows of a set of replicates up to which one thread reduces the set.
const MAX_SERIAL_ROWS: usize = 1 << 15;

/// What all replicates of a test share.
#[derive(Debug)]
struct DesignExemplar {
    class: DesignClass,
    digest: u128,
    steps: usize,
    cells: MeasuredCells,
    start: Vec<f64>,
    inputs: Vec<f64>,
}

impl Reducer {
    /// Reduces a set of replicates. `set`: indices of the replicates in `tests`.
    pub(super) fn reduce_replicates(
        &self,
        (tests, set): (&[&Test], &[usize]),
        work: &mut Workspace,
        found: &mut ReducedTests,
    ) {
        let first = tests[set[0]];
        let exemplar = DesignExemplar::of(self, first, work);
        let some = |work: &mut Workspace, numbers: &[usize], found: &mut ReducedTests| {
            let exceptional = match &exemplar {
                Some(exemplar) => exemplar.reduce(self, (tests, numbers), work, found),
                None => numbers.to_vec(),
            };
            exceptional.into_iter().for_each(|number| found.note(number, self.reduce_to_end(tests[number], work)));
        };
        let rows = set.len() * first.rows();
        let size = match &exemplar {
            Some(_) if rows <= MAX_SERIAL_ROWS => set.len(),
            Some(exemplar) => chunk_size(set.len(), rows).next_multiple_of(exemplar.lanes()),
            None => chunk_size(set.len(), rows),
        };
        if set.len() <= size {
            return some(work, set, found);
        }
        let reduce_chunk = |work: &mut Workspace, numbers: &[usize]| {
            let mut found = ReducedTests::default();
            some(work, numbers, &mut found);
            found
        };
        let parts = set.par_chunks(size).map_init(|| self.workspace(), reduce_chunk).collect();
        found.take(parts, found.numbers.len() + set.len());
    }
}

impl DesignExemplar {
    /// The exemplar of a test; `None` if the replicates of the test must be reduced one by one.
    fn of(reducer: &Reducer, test: &Test, work: &mut Workspace) -> Option<DesignExemplar> {
        reducer.preparer().prepare(test, work).ok()?;
        if !(1..=MAX_ROWS_IN_LANES).contains(&work.design.rows()) {
            return None;
        }
        let digest = work.design.digest();
        let class = reducer.class(digest, work, false);
        class.gains().as_ref().ok().filter(|gains| gains.rotations.is_none())?;
        Some(DesignExemplar {
            class,
            digest,
            steps: work.design.steps(),
            cells: reducer.preparer().measured_cells(test, work).ok()?,
            start: work.data.start.clone(),
            inputs: work.data.inputs.clone(),
        })
    }

    /// Number of replicates that are reduced together.
    fn lanes(&self) -> usize {
        self.class.gains().as_ref().map_or(1, |gains| gains.lanes_of_tests().lanes())
    }

    /// Reduces the replicates with indices `numbers`. Returns the indices of the replicates that must be reduced one by
    /// one.
    fn reduce(
        &self,
        reducer: &Reducer,
        (tests, numbers): (&[&Test], &[usize]),
        work: &mut Workspace,
        found: &mut ReducedTests,
    ) -> Vec<usize> {
        let DesignExemplar { class, cells, start, inputs, .. } = self;
        let gains = class.gains().as_ref().expect("exemplars have gains");
        work.block.set_width(gains.lanes_of_tests());
        let (lanes, mut exceptional) = (work.block.lanes(), Vec::new());
        work.block.reshape(start.len(), inputs.len(), cells.len());
        (0..lanes).for_each(|lane| work.block.begin(lane, start, inputs));
        let mut values = Vec::with_capacity(lanes);
        for some in numbers.chunks(lanes) {
            values.clear();
            values.extend(some.iter().map(|&number| tests[number].all_numbers()));
            work.block.put_values(&values, cells);
            work.block.run(class.design(), gains, &mut work.scratch);
            for (lane, &number) in some.iter().enumerate() {
                let outcome = work.block.outcome(lane, (gains.active, gains.log_determinant), &work.scratch);
                // a missing or infinite value makes the outcome not finite
                if !outcome.is_finite() || reducer.preparer().covariates_of(tests[number], work).is_err() {
                    exceptional.push(number);
                    continue;
                }
                let header = ReductionHeader::new(gains, &work.covariates, (self.steps, self.digest));
                found.reductions.put(reducer.counted_reduction(tests[number], &outcome, header));
                found.numbers.push(number);
                found.terminals.extend(reducer.ending(class, work.block.last(lane, &work.scratch)));
            }
        }
        exceptional
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::Reductions;
    use kalfit_model::Source;
    use kalfit_model::build::{constant, gauss_markov, measurement, name};
    use kalfit_model::{Alpha, Model};

    /// Record of 3000 rows with a gap and a missing value; every third record has half of the rows.
    fn record(number: usize) -> Test {
        let mut test = Test::new(format!("t{number}"), 2, 0);
        for row in (0..if number % 3 == 2 { 1500 } else { 3000 }).filter(|row| *row != 700) {
            let noise = ((number * 7919 + row * 104_729) % 1000) as f64 / 500.0 - 1.0;
            let z = if row == 1100 { f64::NAN } else { 40.0 + (row as f64 / 300.0 + number as f64).sin() + noise };
            test.push(&[z, 0.1 * row as f64], &[], Source::default());
        }
        test
    }

    #[test]
    fn records_that_are_alike_are_reduced_side_by_side_as_one_by_one() {
        let model = Model::builder("")
            .time("t")
            .state(constant("a"))
            .state(gauss_markov("d", 5.0, 1.0))
            .state(gauss_markov("e", 0.2, 0.5))
            .measurement(measurement("z", name("a") + name("d") + name("e"), 0.3))
            .build()
            .expect("a model");
        let model = &model.phases[0].model;
        let columns: Vec<&str> = model.columns.iter().map(|column| column.name.as_str()).collect();
        assert_eq!(columns, ["z", "t"], "the order of the cells of a row");
        let mut tests: Vec<Test> = (0..13).map(record).collect();
        let reducer = Reducer::new(model, &Alpha::default()).expect("sound");
        let one = |test: &Test| reducer.reduce(std::slice::from_ref(test)).expect("sound");
        let alone = Reductions::joined(tests.iter().map(one).collect());
        let together = reducer.reduce(&tests).expect("sound");
        assert_eq!(reducer.work().design_runs, 2, "of thirteen records");
        assert_eq!(together, alone, "to the bit");
        tests.reverse();
        let backwards = reducer.reduce(&tests).expect("sound");
        assert!(backwards.iter().rev().eq(&together), "their order changes no bit");
    }
}
