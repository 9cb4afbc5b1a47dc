//! Tests → reductions, many at a time: replicates share lanes and one design, and tests without replicates share lanes
//! with tests of one shape.

use kalfit_lanes::Isa;
use rayon::prelude::*;

use crate::reduce::Reductions;
use crate::reduce::batches::batch_workspace::BatchWorkspace;
use crate::reduce::chunk_size::chunk_size;
use crate::reduce::error::ReduceError;
use crate::reduce::prepare::{Skeleton, Workspace};
use crate::reduce::reduced_tests::ReducedTests;
use crate::reduce::reducer::Reducer;
use crate::reduce::replicates::Replicates;
use kalfit_model::Test;

/// Number of chunks of tests per round. The reductions of a round join the result at the end of the round, so that few
/// reductions are ever in memory twice.
const CHUNKS_PER_ROUND: usize = 128;
/// Number of lists of sets of replicates per round.
const LISTS_PER_ROUND: usize = 32;

/// Number of tests per lane that are collected and sorted by shape before they are reduced: enough to fill lanes with
/// similar tests, few enough to take little memory.
const TESTS_PER_LANE: usize = 4;
/// Total number of steps at which the collected tests are reduced, however few tests have been collected.
const MAX_COLLECTED_STEPS: usize = 1 << 18;

/// Reduces tests without replicates, in batches of tests of one shape.
#[derive(Debug)]
struct BatchReducer<'a> {
    reducer: &'a Reducer,
    work: Workspace,
    /// Skeletons of the collected tests.
    own: Vec<Skeleton>,
    unused_skeletons: Vec<Skeleton>,
    batch_work: BatchWorkspace,
}

impl Reducer {
    /// The reductions of the tests, in the order of the tests; if several tests are in error, the error of the first
    /// one.
    pub fn reduce(&self, tests: &[Test]) -> Result<Reductions, ReduceError> {
        self.reduce_all(&tests.iter().collect::<Vec<_>>())
    }

    /// [`Reducer::reduce`] of tests given by reference.
    pub(crate) fn reduce_all(&self, tests: &[&Test]) -> Result<Reductions, ReduceError> {
        self.reduce_each(tests, &self.replicates(tests)).ordered()
    }

    /// The sets of replicates among tests.
    pub(crate) fn replicates(&self, tests: &[&Test]) -> Replicates {
        Replicates::of(self.preparer().cell_mask.as_ref(), tests)
    }

    /// Reductions and errors of the tests in `replicates`.
    pub(crate) fn reduce_each(&self, tests: &[&Test], replicates: &Replicates) -> ReducedTests {
        let (mut all, many, alone) = (ReducedTests::default(), replicates.len(), &replicates.alone);
        let size = chunk_size(alone.len(), alone.iter().map(|&number| tests[number].rows()).sum());
        for round_indices in alone.chunks(CHUNKS_PER_ROUND * size) {
            let own = |batch: &mut BatchReducer<'_>, numbers: &[usize]| batch.reduce(tests, numbers);
            all.take(round_indices.par_chunks(size).map_init(|| BatchReducer::new(self), own).collect(), many);
        }
        for lists in replicates.lists().chunks(LISTS_PER_ROUND) {
            let set = |(mut work, mut found): (Workspace, ReducedTests), set: &&[usize]| {
                self.reduce_replicates((tests, set), &mut work, &mut found);
                (work, found)
            };
            let list = |sets: &Vec<&[usize]>| {
                let parts = sets.par_iter().fold(|| (self.workspace(), ReducedTests::default()), set);
                let mut found = ReducedTests::default();
                found.take(parts.map(|(_, found)| found).collect(), sets.iter().map(|set| set.len()).sum());
                found.sorted()
            };
            all.take(lists.par_iter().map(list).collect(), many);
        }
        all
    }
}

impl<'a> BatchReducer<'a> {
    fn new(reducer: &'a Reducer) -> BatchReducer<'a> {
        let (work, batch_work) = (reducer.workspace(), BatchWorkspace::new(Isa::best(), reducer));
        BatchReducer { reducer, work, own: Vec::new(), unused_skeletons: Vec::new(), batch_work }
    }

    /// Reductions and errors of the tests with indices `numbers`; in the order of the tests if no last states are
    /// wanted.
    fn reduce(&mut self, tests: &[&Test], numbers: &[usize]) -> ReducedTests {
        let mut found = ReducedTests::default();
        for &number in numbers {
            let mut own = self.unused_skeletons.pop().unwrap_or_default();
            if self.reducer.preparer().skeleton(tests[number], number, &mut self.work, &mut own) {
                self.own.push(own);
                let steps: usize = self.own.iter().map(Skeleton::len).sum();
                if self.own.len() == TESTS_PER_LANE * Isa::best().lanes() || steps >= MAX_COLLECTED_STEPS {
                    self.reduce_collected(tests, &mut found);
                }
            } else {
                self.unused_skeletons.push(own);
                found.exceptional.push(number);
            }
        }
        self.reduce_collected(tests, &mut found);
        for number in std::mem::take(&mut found.exceptional) {
            found.note(number, self.reducer.reduce_to_end(tests[number], &mut self.work));
        }
        found.sorted()
    }

    /// Reduces the collected tests, in lanes.
    fn reduce_collected(&mut self, tests: &[&Test], found: &mut ReducedTests) {
        let BatchReducer { reducer, work, own, batch_work, .. } = self;
        batch_work.reduce(reducer, (tests, own), &mut work.scratch, found);
        self.own.retain(|own| own.len() < MAX_COLLECTED_STEPS / TESTS_PER_LANE);
        self.unused_skeletons.append(&mut self.own);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_fixtures::by_hand::Lcg;
    use kalfit_model::Path;
    use kalfit_model::Reduction;
    use kalfit_model::Source;
    use kalfit_model::build::{Formula, constant, gauss_markov, measurement, name};
    use kalfit_model::{Alpha, Model};

    /// Regressions of several lengths: some share a design, some repeat a row, some lack a value.
    fn tests() -> Vec<Test> {
        let one = |j: usize| {
            let mut test = Test::new(format!("t{j:03}"), 2, 0);
            for row in 0..if j % 5 == 4 { 4 } else { 9 } {
                let seed = if j.is_multiple_of(7) { 3 } else { j };
                let at = |row: usize| ((97 * seed + 13 * row) as f64).sin();
                let x = at(if j % 11 == 1 && row == 4 { 3 } else { row });
                let y = if j % 13 == 2 && row == 2 { f64::NAN } else { ((31 * j + 7 * row) as f64).cos() };
                test.push(&[y, x], &[], Source::default());
            }
            test
        };
        (0..200).map(one).collect()
    }

    #[test]
    fn regressions_together_are_what_they_are_by_themselves() {
        let y = measurement("y", name("a") + name("b") * name("x"), 0.5);
        let model =
            Model::builder("").state(constant("a")).state(constant("b")).measurement(y).build().expect("a model");
        let model = &model.phases[0].model;
        let columns: Vec<&str> = model.columns.iter().map(|column| column.name.as_str()).collect();
        assert_eq!(columns, ["y", "x"], "the order of the cells of a row");
        let reducer = || Reducer::new(model, &Alpha::default()).expect("sound");
        let all = tests();
        let together = reducer().reduce(&all).expect("sound");
        for (test, found) in all.iter().zip(&together) {
            let alone = reducer().reduce(std::slice::from_ref(test)).expect("sound");
            assert_eq!(found, alone.get(0), "{}", test.id);
        }
    }

    /// Record of `equal` equal steps, then `own` steps of different lengths.
    fn mixed(id: &str, equal: usize, own: usize, seed: f64) -> Test {
        let (mut test, mut time) = (Test::new(id, 2, 0), 0.0);
        for row in 0..equal + own {
            time += if row < equal { 0.5 } else { 0.3 + 0.2 * (row as f64).sin().abs() };
            test.push(&[(seed * row as f64).cos(), time], &[], Source::default());
        }
        test
    }

    #[test]
    fn records_with_some_equal_steps_are_what_they_are_beside_a_replicate() {
        let y = measurement("y", name("a") + name("d"), 0.5);
        let model = Model::builder("").time("t").state(constant("a")).state(gauss_markov("d", 3.0, 0.7));
        let model = model.measurement(y).build().expect("a model");
        let model = &model.phases[0].model;
        let columns: Vec<&str> = model.columns.iter().map(|column| column.name.as_str()).collect();
        assert_eq!(columns, ["y", "t"], "the order of the cells of a row");
        let reducer = || Reducer::new(model, &Alpha::default()).expect("sound");
        // in some cases most steps are in a long stretch, in others not
        for (equal, own) in [(100, 150), (150, 100), (1500, 1600), (64, 10), (70, 69), (70, 70)] {
            let tests = [mixed("a", equal, own, 0.7), mixed("b", equal, own, 1.3)];
            let together = reducer().reduce(&tests).expect("sound");
            for (test, found) in tests.iter().zip(&together) {
                let alone = reducer().reduce(std::slice::from_ref(test)).expect("sound");
                assert_eq!(found, alone.get(0), "{equal} equal steps and {own} others, test {}", test.id);
            }
        }
    }

    /// Random model of two constants and `processes` Gauss-Markov processes, all scales over many decades.
    fn drawn(processes: usize, random: &mut impl FnMut() -> f64) -> Model {
        let mut decades = |from: f64, to: f64| 10f64.powf(from + (to - from) * random());
        let mut equation = name("a") + name("b") * name("x");
        let mut model = Model::builder("").time("t").state(constant("a")).state(constant("b"));
        for process in &["d", "e", "f"][..processes] {
            model = model.state(gauss_markov(*process, decades(-1.0, 7.0), decades(-5.0, 2.0)));
            equation = equation + Formula::from(decades(-1.0, 0.0) - 0.4) * name(*process);
        }
        let second = name("d") + Formula::from(decades(-1.0, 0.0)) * name("b");
        model = model.measurement(measurement("y", equation, decades(-9.0, 0.0)));
        model = model.measurement(measurement("w", second, decades(-9.0, 0.0)));
        model.build().expect("a model").phases[0].model.clone()
    }

    #[test]
    fn covariances_say_what_square_roots_say_whatever_the_noise() {
        let mut seed = Lcg(5);
        let mut random = || 0.5 + seed.next();
        let norm = |numbers: &[f64]| numbers.iter().map(|x| x * x).sum::<f64>().sqrt();
        let distance =
            |found: &[f64], other: &[f64]| norm(&found.iter().zip(other).map(|(a, b)| a - b).collect::<Vec<f64>>());
        let mut many = [0; 4];
        for round in 0..600 {
            let processes = 1 + round % 3;
            let model = drawn(processes, &mut random);
            let (mut test, mut time) = (Test::new("t", model.columns.len(), 0), 0.0);
            for _ in 0..30 {
                time += 0.2 + random();
                let cell = |name: &str| if name == "t" { time } else { 4.0 * random() - 2.0 };
                let row: Vec<f64> = model.columns.iter().map(|column| &*column.name).map(cell).collect();
                test.push(&row, &[], Source::default());
            }
            let reducer = Reducer::new(&model, &Alpha::default()).expect("sound");
            let found: Reduction = reducer.reduce(std::slice::from_ref(&test)).expect("sound").get(0).into();
            if found.path == Path::SquareRoot {
                continue;
            }
            many[processes] += 1;
            let (root, _) = reducer.reduce_by_root(&test, &mut reducer.workspace()).expect("sound");
            assert_eq!(root.path, Path::SquareRoot);
            // d is a projection of all innovations, in units of their standard deviations
            let all = norm(&root.data) + root.residual.expect("it was made of measurements").sqrt();
            let errors = [
                distance(&found.factor, &root.factor) / norm(&root.factor),
                distance(&found.data, &root.data) / all,
                (found.constant - root.constant).abs() / (1.0 + root.constant.abs()),
            ];
            assert!(errors.iter().all(|&x| x < 1e-9), "{processes} processes, round {round}: {found:?} for {root:?}");
        }
        let [_, one, two, three] = many;
        assert_eq!(one, 200, "one process never calls for square-root arrays");
        assert!(two > 50 && three > 50, "{two} and {three} of 200 by covariances");
    }
}
