//! Long tests that are known to differ in nothing but what was measured: one of them is evaluated, and the data of all pass side by
//! side under its gains.

use std::collections::{BTreeMap, HashMap};

use kalfit_lanes::Isa;
use rayon::prelude::*;

use crate::ensemble::{Test, TestId};
use crate::reduce::batch_reducer::joined;
use crate::reduce::prepare::Workspace;
use crate::reduce::reducer::{Reducer, ReductionHeader};
use crate::reduce::{ReduceError, Reduction, Reductions};

/// Most measurements of tests that are reduced so: they and their innovations stand there for each lane.
const MOST_ROWS: usize = 1 << 23;

/// Which tests of one ensemble are alike: by the id of each, the number of its kind. No two have one id.
#[derive(Debug, Default)]
pub(crate) struct LongDesignClasses(HashMap<TestId, usize>);

impl LongDesignClasses {
    /// Kinds of two tests or more.
    pub(crate) fn new<'a>(kinds: impl Iterator<Item = Vec<&'a TestId>>) -> LongDesignClasses {
        let numbered = kinds.enumerate().flat_map(|(kind, ids)| ids.into_iter().map(move |id| (id.clone(), kind)));
        LongDesignClasses(numbered.collect())
    }

    /// True where no test is like another.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The places of tests that are alike, and of all others.
    fn parted(&self, tests: &[&Test]) -> (Vec<Vec<usize>>, Vec<usize>) {
        let (mut kinds, mut others): (BTreeMap<usize, Vec<usize>>, _) = (BTreeMap::new(), Vec::new());
        for (place, test) in tests.iter().enumerate() {
            match self.0.get(&test.id) {
                Some(&kind) => kinds.entry(kind).or_default().push(place),
                None => others.push(place),
            }
        }
        (kinds.into_values().collect(), others)
    }
}

impl Reducer {
    /// The reductions of tests, those that are alike side by side.
    pub(crate) fn reduce_alike(&self, alike: &LongDesignClasses, tests: &[&Test]) -> Result<Reductions, ReduceError> {
        let (kinds, mut rest) = alike.parted(tests);
        let of = |places: &[usize]| places.iter().map(|&place| tests[place]).collect::<Vec<_>>();
        let side_by_side = |work: &mut Workspace, kind: &Vec<usize>| self.side_by_side(&of(kind), work);
        let found: Vec<Option<Reductions>> = kinds.par_iter().map_init(|| self.workspace(), side_by_side).collect();
        let (mut order, mut parts) = (Vec::with_capacity(tests.len()), Vec::new());
        for (kind, found) in kinds.into_iter().zip(found) {
            match found {
                Some(found) => {
                    order.extend(kind);
                    parts.push(Ok(found));
                }
                None => rest.extend(kind),
            }
        }
        rest.sort_unstable(); // of several tests in error, the first one's is said
        parts.push(self.reduce_each(&of(&rest)));
        order.extend(rest);
        Ok(joined(parts)?.in_order(&order))
    }

    /// Tests that are alike; `None` where they must be looked at one by one.
    fn side_by_side(&self, tests: &[&Test], work: &mut Workspace) -> Option<Reductions> {
        let first = tests[0];
        self.preparer.prepare(first, work).ok()?;
        let (digest, steps) = (work.design.digest(), work.design.steps());
        let class = self.class(digest, work, false);
        let gains = class.gains().as_ref().ok().filter(|gains| gains.turns.is_none())?;
        if work.design.rows() > MOST_ROWS {
            return None;
        }
        let cells = self.preparer.measured_cells(first, work).ok()?;
        let Workspace { design, data, .. } = &*work;
        let lanes = Isa::best().lanes();
        let some = |own: &mut Workspace, tests: &[&Test]| {
            own.block.clear(data.start.len(), data.inputs.len(), cells.len());
            (0..tests.len()).for_each(|lane| own.block.begin(lane, &data.start, &data.inputs));
            let numbers: Vec<&[f64]> = tests.iter().map(|test| test.all_numbers()).collect();
            if own.block.values_of(&numbers, &cells).contains(&false) {
                return None;
            }
            own.block.run(design, gains, &mut own.room);
            let mut reductions = Reductions::new();
            for (lane, test) in tests.iter().enumerate() {
                let outcome = own.block.outcome(lane, (gains.active, gains.log_determinant), &own.room);
                self.preparer.covariates_of(test, own).ok().filter(|()| outcome.is_finite())?;
                let about = ReductionHeader::new(gains, &own.covariates, (steps, digest));
                reductions.push(Reduction::from(self.row(test, &outcome, about)));
            }
            Some(reductions)
        };
        let parts = tests.par_chunks(lanes).map_init(|| self.workspace(), some);
        Some(Reductions::joined(parts.collect::<Option<Vec<_>>>()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::{constant, gauss_markov, measurement, name};
    use crate::ensemble::Source;
    use crate::model::{Alpha, Model};

    /// Records of 3000 rows with a gap and a missing value; every third one of half of them.
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
        let tests: Vec<Test> = (0..13).map(record).collect();
        let kind = |kind: usize| tests.iter().enumerate().filter(move |(number, _)| number % 3 == kind);
        let ids = |kind_of: usize| kind(kind_of).map(|(_, test)| &test.id).collect::<Vec<_>>();
        let mut reducer = Reducer::new(model, &Alpha::default()).expect("sound");
        let alone = reducer.reduce(&tests).expect("sound");
        // two kinds of the same cells, and others by themselves
        reducer.set_equal_designs(std::sync::Arc::new(LongDesignClasses::new([ids(0), ids(1)].into_iter())));
        let together = reducer.reduce(&tests).expect("sound");
        assert_eq!(together.len(), alone.len());
        let close = |a: f64, b: f64| (a - b).abs() <= 1e-12 * (1.0 + b.abs());
        for (found, expected) in together.iter().zip(&alone) {
            assert_eq!((found.test, found.design, found.steps), (expected.test, expected.design, expected.steps));
            assert_eq!(found.factor, expected.factor);
            assert!(
                close(found.constant, expected.constant),
                "{}: {} and {}",
                found.test,
                found.constant,
                expected.constant
            );
            for (a, b) in found.data.iter().zip(expected.data) {
                assert!(close(*a, *b), "{}: {a} and {b}", found.test);
            }
        }
    }
}
