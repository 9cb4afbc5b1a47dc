//! Tests → reductions, many at a time: tests of a design that is known are recognised, and their data passes are one.

use std::sync::Arc;

use kalfit_lanes::Isa;
use rayon::prelude::*;

use crate::ensemble::Test;
use crate::reduce::blocks::batch_workspace::BatchWorkspace;
use crate::reduce::blocks::reduced::{ReducedTests, ToEnd};
use crate::reduce::class::DesignClass;
use crate::reduce::error::ReduceError;
use crate::reduce::lanes::DataBlock;
use crate::reduce::prepare::{Skeleton, Workspace};
use crate::reduce::recognise::DesignCells;
use crate::reduce::reducer::{DesignExemplar, Reducer, ReductionHeader};
use crate::reduce::shared::StoreEntry;
use crate::reduce::{Reduction, Reductions};

/// Most classes whose blocks are filled at the same time.
const OPEN: usize = 32;

/// Tests that are looked at together: so many shares for each thread, but neither more tests than these, nor, while their rows are
/// few, fewer.
const SHARES: usize = 4;
const MOST: usize = 512;
const FEWEST: usize = 32;
const FEW_ROWS: usize = 8192;

/// Batches that are reduced before what they say goes where all is: there is never much of it twice.
const BATCHES: usize = 256;

/// Tests with designs of their own that are put in order together, for each lane: they fill lanes with their like, and need no room of
/// their own for long.
const TOGETHER: usize = 4;

/// How many of so many tests, with so many rows in all, are looked at together.
pub(crate) fn share(tests: usize, rows: usize) -> usize {
    let fewest = (FEW_ROWS * tests / rows.max(1)).clamp(1, FEWEST);
    (tests / (SHARES * rayon::current_num_threads())).clamp(fewest, MOST)
}

/// The reductions of all batches, in order, or the first error.
pub(crate) fn joined(batches: Vec<Result<Reductions, ReduceError>>) -> Result<Reductions, ReduceError> {
    Ok(Reductions::joined(batches.into_iter().collect::<Result<_, _>>()?))
}

/// Reduces batches of tests.
#[derive(Debug)]
pub(crate) struct BatchReducer<'a> {
    reducer: &'a Reducer,
    work: Workspace,
    groups: Vec<PendingBatch>,
    /// The group that took the last test.
    latest: usize,
    /// The group that makes room for another, when there are as many as there may be.
    oldest: usize,
    /// Tests with designs of their own, and room for them.
    own: Vec<Skeleton>,
    spare: Vec<Skeleton>,
    beside: BatchWorkspace,
    /// Reductions as they come. Odd ones, with which something is wrong or that call for square-root arrays, come last, each by itself.
    found: ReducedTests,
    /// What is wrong with tests, by their numbers.
    faults: Vec<(usize, ReduceError)>,
}

/// Tests of a known design, gathered in a block.
#[derive(Debug)]
struct PendingBatch {
    known: Arc<StoreEntry<DesignCells, DesignExemplar>>,
    block: DataBlock,
    /// Number and covariates of the test in each lane.
    seats: Vec<(usize, Vec<f64>)>,
}

impl Reducer {
    /// [`Reducer::reduce`], of tests that stand anywhere.
    pub(crate) fn reduce_all(&self, tests: &[&Test]) -> Result<Reductions, ReduceError> {
        match self.alike() {
            Some(alike) => self.reduce_alike(alike, tests),
            None => self.reduce_each(tests),
        }
    }

    /// The same, each test by itself.
    pub(super) fn reduce_each(&self, tests: &[&Test]) -> Result<Reductions, ReduceError> {
        let share = share(tests.len(), tests.iter().map(|test| test.rows()).sum());
        let mut all = Reductions::new();
        for some in tests.chunks(BATCHES * share) {
            let batches =
                some.par_chunks(share).map_init(|| BatchReducer::new(self), |batch, tests| batch.reduce(tests));
            all.take(batches.collect::<Vec<_>>().into_iter().collect::<Result<_, _>>()?, tests.len());
        }
        Ok(all)
    }
}

impl<'a> BatchReducer<'a> {
    pub(crate) fn new(reducer: &'a Reducer) -> BatchReducer<'a> {
        let work = reducer.workspace();
        BatchReducer {
            reducer,
            work,
            groups: Vec::new(),
            latest: 0,
            oldest: 0,
            own: Vec::new(),
            spare: Vec::new(),
            beside: BatchWorkspace::new(Isa::best(), reducer),
            found: ReducedTests::default(),
            faults: Vec::new(),
        }
    }

    /// The reductions of tests, in their order; of several tests in error, the first one's error.
    fn reduce(&mut self, tests: &[&Test]) -> Result<Reductions, ReduceError> {
        self.look(tests);
        if let Some((_, error)) = self.faults.drain(..).min_by_key(|(number, _)| *number) {
            return Err(error);
        }
        let ReducedTests { reductions, numbers, .. } = &mut self.found;
        debug_assert_eq!(numbers.len(), tests.len(), "every test was looked at");
        Ok(std::mem::take(reductions).in_order(numbers))
    }

    /// Reduces tests.
    fn look(&mut self, tests: &[&Test]) {
        self.found = ReducedTests::default();
        self.faults.clear();
        for (number, test) in tests.iter().enumerate() {
            let digest = match self.recognise(tests, test) {
                Ok(()) if self.seat(tests, number) => continue,
                Ok(()) => None,
                Err(digest) => digest,
            };
            self.evaluate(tests, number, digest);
        }
        (0..self.groups.len()).for_each(|group| self.flush(tests, group));
        self.side_by_side(tests);
        for number in std::mem::take(&mut self.found.odd) {
            let found = self.reducer.one(tests[number], &mut self.work);
            self.note_alone(number, found);
        }
    }

    /// The reduction of each test, and where it ends.
    pub(crate) fn reduce_to_end(&mut self, tests: &[&Test]) -> Vec<ToEnd> {
        self.look(tests);
        let mut all = std::mem::take(&mut self.found).by_number(tests.len());
        self.faults.drain(..).for_each(|(number, error)| all[number] = Some(Err(error)));
        all.into_iter().map(|found| found.expect("every test was looked at")).collect()
    }

    /// Makes the group of the test's design the latest one; else the digest that it is to be known by, if any.
    fn recognise(&mut self, tests: &[&Test], test: &Test) -> Result<(), Option<u128>> {
        let looks = self.reducer.preparer().cell_mask.as_ref().ok_or(None)?;
        if self.groups.get(self.latest).is_some_and(|group| looks.has_cells(test, &group.known.key)) {
            return Ok(());
        }
        // tests with designs of their own mostly differ from the first rows on
        if !self.reducer.known().is_noted(looks.digest(test, false)) {
            return Err(None);
        }
        let digest = looks.digest(test, true);
        let known = self.reducer.known().find(digest).map_err(|seen| seen.then_some(digest))?;
        if !looks.has_cells(test, &known.key) {
            return Err(None);
        }
        let open = self.groups.iter().position(|group| Arc::ptr_eq(&group.known, &known));
        self.latest = open.unwrap_or_else(|| self.open(tests, known));
        Ok(())
    }

    /// A new group.
    fn open(&mut self, tests: &[&Test], known: Arc<StoreEntry<DesignCells, DesignExemplar>>) -> usize {
        let group = PendingBatch::new(known);
        if self.groups.len() < OPEN {
            self.groups.push(group);
            return self.groups.len() - 1;
        }
        let at = self.oldest;
        self.oldest = (at + 1) % OPEN;
        self.flush(tests, at);
        self.groups[at] = group;
        at
    }

    /// Gives a test the next lane of the latest group; false where it must be looked at by itself.
    fn seat(&mut self, tests: &[&Test], number: usize) -> bool {
        let (test, group) = (tests[number], &mut self.groups[self.latest]);
        let covariates = self.reducer.preparer().covariates_of(test, &mut self.work);
        if covariates.is_err() || !group.take(test) {
            return false;
        }
        group.seats.push((number, self.work.covariates.clone()));
        if group.seats.len() == group.block.lanes() {
            self.flush(tests, self.latest);
        }
        true
    }

    /// Reduces the tests of a group.
    fn flush(&mut self, tests: &[&Test], group: usize) {
        let PendingBatch { known, block, seats } = &mut self.groups[group];
        if seats.is_empty() {
            return;
        }
        let known = known.value();
        let gains = known.class.gains().as_ref().expect("known designs have gains");
        block.run(known.class.design(), gains, &mut self.work.room);
        for (lane, (number, covariates)) in seats.drain(..).enumerate() {
            let outcome = block.outcome(lane, (gains.active, gains.log_determinant), &self.work.room);
            if outcome.is_finite() {
                let about = ReductionHeader::new(gains, &covariates, (known.steps, known.digest));
                self.found.reductions.put(self.reducer.row(tests[number], &outcome, about));
                self.found.numbers.push(number);
                self.found.terminals.extend(self.reducer.ending(&known.class, block.last(lane, &self.work.room)));
            } else {
                self.found.odd.push(number);
            }
        }
    }

    /// Evaluates a test, or puts it beside others. Others are recognised by it, if it has a digest.
    fn evaluate(&mut self, tests: &[&Test], number: usize, digest: Option<u128>) {
        let (test, reducer) = (tests[number], self.reducer);
        if digest.is_none() {
            let mut own = self.spare.pop().unwrap_or_default();
            if reducer.preparer().skeleton(test, number, &mut self.work, &mut own) {
                self.own.push(own);
                if self.own.len() == TOGETHER * Isa::best().lanes() {
                    self.side_by_side(tests);
                }
                return;
            }
            self.spare.push(own);
        }
        let found = reducer.one(test, &mut self.work);
        if let (Some(digest), Ok((_, class))) = (digest, &found) {
            reducer.add_exemplar(test, class, digest, &self.work);
        }
        self.note_alone(number, found);
    }

    /// Reduces tests with designs of their own.
    fn side_by_side(&mut self, tests: &[&Test]) {
        let BatchReducer { reducer, work, own, beside, found, .. } = self;
        beside.reduce(reducer, (tests, own), &mut work.room, found);
        self.spare.append(&mut self.own);
    }

    /// Takes what was found of the test in the work space.
    fn note_alone(&mut self, number: usize, found: Result<(Reduction, DesignClass), ReduceError>) {
        match found {
            Ok((reduction, class)) => {
                self.found.reductions.push(reduction);
                self.found.numbers.push(number);
                self.found.terminals.extend(self.reducer.ending(&class, self.work.pass.x.iter().copied()));
            }
            Err(error) => self.faults.push((number, error)),
        }
    }
}

impl PendingBatch {
    fn new(known: Arc<StoreEntry<DesignCells, DesignExemplar>>) -> PendingBatch {
        let (mut block, own) = (DataBlock::new(Isa::best()), known.value());
        block.clear(own.start.len(), own.inputs.len(), own.cells.len());
        (0..block.lanes()).for_each(|lane| block.begin(lane, &own.start, &own.inputs));
        PendingBatch { known, block, seats: Vec::new() }
    }

    /// Puts the values of a test into the next lane; false where one is missing or infinite.
    fn take(&mut self, test: &Test) -> bool {
        let cells = test.all_numbers();
        self.block.values(self.seats.len(), self.known.value().cells.iter().map(|&(cell, d)| cells[cell] - d))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::{Formula, constant, gauss_markov, measurement, name};
    use crate::ensemble::Source;
    use crate::model::by_hand::Lcg;
    use crate::model::{Alpha, Model};
    use crate::reduce::Path;

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

    /// Constants and as many Gauss-Markov processes as asked for, all scales over many decades.
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
        let apart =
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
            let mut reducer = Reducer::new(&model, &Alpha::default()).expect("sound");
            let found: Reduction = reducer.reduce(std::slice::from_ref(&test)).expect("sound").get(0).into();
            if found.path == Path::SquareRoot {
                continue;
            }
            many[processes] += 1;
            let (root, _) = reducer.reduce_by_root(&test, &mut reducer.workspace()).expect("sound");
            assert_eq!(root.path, Path::SquareRoot);
            // d is a projection of all innovations, in units of their deviations
            let all = norm(&root.data) + root.residual.expect("it was made of measurements").sqrt();
            let errors = [
                apart(&found.factor, &root.factor) / norm(&root.factor),
                apart(&found.data, &root.data) / all,
                (found.constant - root.constant).abs() / (1.0 + root.constant.abs()),
            ];
            assert!(errors.iter().all(|&x| x < 1e-9), "{processes} processes, round {round}: {found:?} for {root:?}");
        }
        let [_, one, two, three] = many;
        assert_eq!(one, 200, "one process never calls for square-root arrays");
        assert!(two > 50 && three > 50, "{two} and {three} of 200 by covariances");
    }
}
