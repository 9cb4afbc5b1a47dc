//! Tests → reductions, many at a time: tests of a design that is known are recognised, and their data passes are one.

use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use kalfit_lanes::Isa;
use rayon::prelude::*;

use crate::ensemble::Test;
use crate::reduce::class::{Class, class_bytes};
use crate::reduce::design::Design;
use crate::reduce::ending::Ending;
use crate::reduce::error::ReduceError;
use crate::reduce::gains::Gains;
use crate::reduce::lanes::{Block, is_short};
use crate::reduce::prepare::Workspace;
use crate::reduce::reducer::filtered::Filter;
use crate::reduce::reducer::known::Known;
use crate::reduce::reducer::queue::Queue;
use crate::reduce::reducer::straight::Straight;
use crate::reduce::reducer::{About, Reducer};
use crate::reduce::subject::Fault;
use crate::reduce::{Path, Reduction, Reductions};

/// Most classes whose blocks are filled at the same time.
const OPEN: usize = 32;

/// Tests that are looked at together: so many shares for each thread, but neither more tests than these, nor, while their rows are
/// few, fewer.
const SHARES: usize = 4;
const MOST: usize = 512;
const FEWEST: usize = 32;
const FEW_ROWS: usize = 8192;

/// How many of so many tests, with so many rows in all, are looked at together.
pub(crate) fn share(tests: usize, rows: usize) -> usize {
    let fewest = (FEW_ROWS * tests / rows.max(1)).clamp(1, FEWEST);
    (tests / (SHARES * rayon::current_num_threads())).clamp(fewest, MOST)
}

/// The reductions of all batches, in order, or the first error.
pub(crate) fn joined(batches: Vec<Result<Reductions, ReduceError>>) -> Result<Reductions, ReduceError> {
    Ok(Reductions::joined(batches.into_iter().collect::<Result<_, _>>()?))
}

/// What else was found in all batches, in order, or the first error.
pub(crate) fn all_sound<T>(batches: Vec<Vec<Result<T, ReduceError>>>) -> Result<Vec<T>, ReduceError> {
    let mut all = Vec::with_capacity(batches.iter().map(Vec::len).sum());
    for found in batches.into_iter().flatten() {
        all.push(found?);
    }
    Ok(all)
}

/// Reduces batches of tests.
#[derive(Debug)]
pub(crate) struct Batch<'a> {
    reducer: &'a Reducer,
    work: Workspace,
    groups: Vec<Group>,
    /// The group that took the last test.
    latest: usize,
    /// The group that makes room for another, when there are as many as there may be.
    oldest: usize,
    queue: Queue,
    /// Tests without dynamics, of the length of the last one that was evaluated.
    straight: Option<Straight>,
    /// Tests that something is wrong with, or that call for square-root arrays: their turn comes last, each by itself.
    odd: Vec<usize>,
    /// Reductions as they come, and the number of the test of each.
    found: Reductions,
    numbers: Vec<usize>,
    /// What is wrong with tests, by their numbers.
    faults: Vec<(usize, ReduceError)>,
    /// Where the tests end; empty where that is not wanted.
    endings: Vec<Ending<'static>>,
}

/// Tests of a known design, gathered in a block.
#[derive(Debug)]
struct Group {
    known: Arc<Known>,
    block: Block,
    /// Number and covariates of the test in each lane.
    seats: Vec<(usize, Vec<f64>)>,
}

impl Reducer {
    /// [`Reducer::reduce`], of tests that stand anywhere.
    pub(crate) fn reduce_all(&self, tests: &[&Test]) -> Result<Reductions, ReduceError> {
        let rows = tests.iter().map(|test| test.rows()).sum();
        let batches = tests
            .par_chunks(share(tests.len(), rows))
            .map_init(|| Batch::new(self), |batch, tests| batch.reduce(tests))
            .collect();
        joined(batches)
    }

    /// A fault of a test, with names.
    pub(crate) fn named(&self, fault: Fault, test: &Test) -> ReduceError {
        fault.name(&self.preparer.model, Some(test))
    }

    /// True when the filter of this design, which nobody has run yet, is one for lanes.
    pub(crate) fn goes_aside(&self, digest: u128, design: &Design) -> bool {
        is_short(design) && !self.classes.has(digest, |known| known.same(design))
    }

    /// Takes note of a design whose filter was run elsewhere. `made` puts together what it left, if it is wanted.
    pub(crate) fn ran(&self, digest: u128, made: impl FnOnce() -> (Design, Gains)) {
        let made = || {
            let (design, gains) = made();
            (design, Ok(gains))
        };
        // threads that meet one design at the same time count once: the work told of does not depend on threads
        let first = self.classes.offer((digest, self.eager), made, class_bytes);
        self.design_runs.fetch_add(u64::from(first), Ordering::Relaxed);
    }

    /// Recognises others by a test, as it is in the work space.
    pub(crate) fn learn(&self, test: &Test, class: &Class, hash: u64, work: &Workspace) {
        if let Some(known) = Known::new(&self.preparer, test, class, work) {
            let bytes = known.bytes();
            self.known.keep(hash, Arc::new(known), bytes);
        }
    }
}

impl<'a> Batch<'a> {
    pub(crate) fn new(reducer: &'a Reducer) -> Batch<'a> {
        let work = reducer.workspace();
        Batch {
            reducer,
            work,
            groups: Vec::new(),
            latest: 0,
            oldest: 0,
            queue: Queue::default(),
            straight: None,
            odd: Vec::new(),
            found: Reductions::new(),
            numbers: Vec::new(),
            faults: Vec::new(),
            endings: Vec::new(),
        }
    }

    /// The reductions of tests, in their order; of several tests in error, the first one's error.
    fn reduce(&mut self, tests: &[&Test]) -> Result<Reductions, ReduceError> {
        self.look(tests);
        if let Some((_, error)) = self.faults.drain(..).min_by_key(|(number, _)| *number) {
            return Err(error);
        }
        debug_assert_eq!(self.numbers.len(), tests.len(), "every test was looked at");
        let mut places = vec![0; tests.len()];
        self.numbers.iter().enumerate().for_each(|(place, &number)| places[number] = place);
        Ok(std::mem::take(&mut self.found).in_order(&places))
    }

    /// Reduces tests.
    fn look(&mut self, tests: &[&Test]) {
        self.found = Reductions::new();
        self.numbers.clear();
        self.faults.clear();
        self.endings.clear();
        self.endings.resize_with(if self.reducer.ends { tests.len() } else { 0 }, || Ending::None);
        for (number, test) in tests.iter().enumerate() {
            let hash = match self.recognise(tests, test) {
                Ok(()) if self.seat(tests, number) => continue,
                Ok(()) => None,
                Err(hash) => hash,
            };
            self.evaluate(tests, number, hash);
        }
        (0..self.groups.len()).for_each(|group| self.flush(tests, group));
        while let Some(line) = self.queue.any() {
            self.filter(tests, line);
        }
        self.filter_straight(tests);
        for number in std::mem::take(&mut self.odd) {
            let found = self.reducer.one(tests[number], &mut self.work);
            self.note_alone(number, found);
        }
    }

    /// The reduction of each test, and where it ends.
    pub(crate) fn reduce_to_end(&mut self, tests: &[&Test]) -> Vec<Result<(Reduction, Ending<'static>), ReduceError>> {
        self.look(tests);
        self.endings.resize_with(tests.len(), || Ending::None);
        let mut all: Vec<Option<Result<_, ReduceError>>> = tests.iter().map(|_| None).collect();
        for (&number, row) in self.numbers.iter().zip(&self.found) {
            let ending = std::mem::replace(&mut self.endings[number], Ending::None);
            all[number] = Some(Ok((row.into(), ending)));
        }
        self.faults.drain(..).for_each(|(number, error)| all[number] = Some(Err(error)));
        all.into_iter().map(|found| found.expect("every test was looked at")).collect()
    }

    /// Makes the group of the test's design the latest one; else the hash that it is to be known by, if any.
    fn recognise(&mut self, tests: &[&Test], test: &Test) -> Result<(), Option<u64>> {
        let looks = self.reducer.preparer().looks.as_ref().ok_or(None)?;
        if self.groups.get(self.latest).is_some_and(|group| looks.alike(test, &group.known.likeness)) {
            return Ok(());
        }
        // tests with designs of their own mostly differ from the first rows on
        if !self.reducer.known.is_noted(looks.hash(test, false)) {
            return Err(None);
        }
        let hash = looks.hash(test, true);
        let known = self.reducer.known.find(hash).map_err(|seen| seen.then_some(hash))?;
        if !looks.alike(test, &known.likeness) {
            return Err(None);
        }
        let open = self.groups.iter().position(|group| Arc::ptr_eq(&group.known, &known));
        self.latest = open.unwrap_or_else(|| self.open(tests, known));
        Ok(())
    }

    /// A new group.
    fn open(&mut self, tests: &[&Test], known: Arc<Known>) -> usize {
        let group = Group::new(known);
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
        let Group { known, block, seats } = &mut self.groups[group];
        if seats.is_empty() {
            return;
        }
        let gains = known.class.gains().as_ref().expect("known designs have gains");
        block.run(known.class.design(), gains, &mut self.work.room);
        for (lane, (number, covariates)) in seats.drain(..).enumerate() {
            let outcome = block.outcome(lane, (gains.active, gains.log_determinant), &self.work.room);
            if outcome.is_finite() {
                let about = About::new(gains, &covariates, (known.steps, known.digest));
                self.found.put(self.reducer.row(tests[number], &outcome, about));
                self.numbers.push(number);
                if let Some(ending) = self.endings.get_mut(number) {
                    *ending = self.reducer.ending(&known.class, block.last(lane, &self.work.room));
                }
            } else {
                self.odd.push(number);
            }
        }
    }

    /// Evaluates a test. Others are recognised by it, if it has a hash.
    fn evaluate(&mut self, tests: &[&Test], number: usize, hash: Option<u64>) {
        let (test, reducer) = (tests[number], self.reducer);
        if hash.is_none() && self.go_straight(tests, number) {
            return;
        }
        if let Err(fault) = reducer.preparer().prepare(test, &mut self.work) {
            self.faults.push((number, reducer.named(*fault, test)));
            return;
        }
        let digest = self.work.design.digest();
        if let Some(line) = self.queue.line_with(digest) {
            self.filter(tests, line);
        }
        if hash.is_none() && reducer.goes_aside(digest, &self.work.design) {
            self.follow_straight(tests, test);
            if let Some(full) = self.queue.push(number, digest, &mut self.work) {
                self.filter(tests, full);
            }
            return;
        }
        let found = reducer.prepared(test, digest, &mut self.work);
        if let (Some(hash), Ok((_, class))) = (hash, &found) {
            reducer.learn(test, class, hash, &self.work);
        }
        self.note_alone(number, found.map_err(|fault| reducer.named(*fault, test)));
    }

    /// Evaluates a test without dynamics straight into a lane; false where it is to be evaluated as others.
    fn go_straight(&mut self, tests: &[&Test], number: usize) -> bool {
        let (test, reducer) = (tests[number], self.reducer);
        let Some(straight) = self.straight.as_mut().filter(|straight| straight.is_of(test.rows())) else {
            return false;
        };
        let Some(digest) = straight.evaluate(reducer.preparer(), test) else { return false };
        let waits = straight.has(digest) || self.queue.line_with(digest).is_some();
        if waits || !reducer.goes_aside(digest, straight.design()) {
            self.filter_straight(tests); // its design is known then
            return false;
        }
        if straight.seat(number, digest) {
            self.filter_straight(tests);
        }
        true
    }

    /// Lets tests of the length of this one, which is in the work space, go straight into lanes where they may.
    fn follow_straight(&mut self, tests: &[&Test], test: &Test) {
        let known = self.straight.as_ref().is_some_and(|straight| straight.is_of(test.rows()));
        if known || self.reducer.ends {
            return;
        }
        if let Some(straight) = Straight::like(self.reducer.preparer(), test, &self.work) {
            self.filter_straight(tests);
            self.straight = Some(straight);
        }
    }

    /// Runs the filters of tests that went straight into lanes.
    fn filter_straight(&mut self, tests: &[&Test]) {
        let Batch { reducer, work, straight, found, numbers, odd, .. } = self;
        let Some(straight) = straight else { return };
        straight.filter((reducer, work), |number, filtered| match filtered {
            Some((outcome, about)) => {
                found.put(reducer.row(tests[number], outcome, about));
                numbers.push(number);
            }
            None => odd.push(number),
        });
    }

    /// Takes what was found of the test in the work space.
    fn note_alone(&mut self, number: usize, found: Result<(Reduction, Class), ReduceError>) {
        if let (Ok((_, class)), Some(ending)) = (&found, self.endings.get_mut(number)) {
            *ending = self.reducer.ending(class, self.work.pass.x.iter().copied());
        }
        match found {
            Ok((reduction, _)) => {
                self.found.push(reduction);
                self.numbers.push(number);
            }
            Err(error) => self.faults.push((number, error)),
        }
    }

    /// Runs the filters of tests with designs of their own.
    fn filter(&mut self, tests: &[&Test], line: usize) {
        let reducer = self.reducer;
        let waiting = self.queue.take(line);
        let filtered = reducer.filter(&waiting, &mut self.work);
        for (lane, own) in waiting.iter().enumerate() {
            let Some(Filter { outcome, factor, end }) = filtered.of(lane) else {
                self.odd.push(own.number);
                continue;
            };
            if let Some(end) = end {
                self.endings[own.number] = Ending::Known(Cow::Owned(filtered.terminal(lane, end)));
            }
            let about = About {
                factor,
                covariates: &own.covariates,
                steps: own.design.steps(),
                observations: own.design.rows(),
                path: Path::Information,
                digest: own.digest,
            };
            self.found.put(reducer.row(tests[own.number], &outcome, about));
            self.numbers.push(own.number);
        }
        self.queue.give_back(waiting);
    }
}

impl Group {
    fn new(known: Arc<Known>) -> Group {
        let mut block = Block::new(Isa::best());
        block.clear(known.start.len(), known.inputs.len(), known.cells.len());
        (0..block.lanes()).for_each(|lane| block.begin(lane, &known.start, &known.inputs));
        Group { known, block, seats: Vec::new() }
    }

    /// Puts the values of a test into the next lane; false where one is missing or infinite.
    fn take(&mut self, test: &Test) -> bool {
        let cells = test.all_numbers();
        self.block.values(self.seats.len(), self.known.cells.iter().map(|&(cell, d)| cells[cell] - d))
    }
}
