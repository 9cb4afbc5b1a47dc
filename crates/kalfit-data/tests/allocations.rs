//! What tests cost in pieces of memory between reader and record: none of its own for any of them.
//!
//! A test binary of its own, since all that it allocates is counted.
#![allow(clippy::unwrap_used, reason = "only a test")]

use std::alloc::System;
use std::fmt::Write as _;

use kalfit::build::{constant, measurement, name};
use kalfit::infer::{Choices, DeletionChoice};
use kalfit::reduce::{PhasedReducer, ReduceError};
use kalfit::{
    Alpha, Fit, FitRecord, Labels, Layout, Model, Options, PhasedModel, PhasedTest, Provenance, Reductions, Test,
    TestKey, fit_reductions,
};
use kalfit_data::{Input, TestSink, read_from};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Pieces for each test that is read: its part of what a group of tests in lanes shares (blocks of lanes, scratch memory), and of
/// tables that grow. Wider lanes share more, so that four lanes need most.
const OF_READ: f64 = 8.0;

/// Pieces for each test that tables which grow share.
const OF_RECORD: f64 = 0.1;

/// Reduces tests as they are read, and forgets them.
struct Reducing<'a> {
    model: &'a PhasedModel,
    reducer: PhasedReducer,
    reductions: Reductions,
}

impl TestSink for Reducing<'_> {
    type Error = ReduceError;

    fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), ReduceError> {
        let tests: Vec<PhasedTest> = tests.into_iter().map(|test| self.model.split(test, labels).unwrap()).collect();
        self.reductions.append(self.reducer.reduce(&tests)?);
        Ok(())
    }

    fn restart(&mut self) {
        self.reductions = Reductions::new();
    }
}

/// So many tests of ten rows, with designs of their own.
fn table(tests: usize) -> String {
    let mut table = "test,x,y\n".to_owned();
    for row in 0..10 * tests {
        let at = row as f64;
        writeln!(table, "unit {},{:.4},{:.4}", row / 10, (7.0 * at).sin(), (3.0 * at).cos()).unwrap();
    }
    table
}

/// How many pieces of memory something takes.
fn allocations<T>(does: impl FnOnce() -> T) -> (T, usize) {
    let region = Region::new(ALLOCATOR);
    let done = does();
    let change = region.change();
    (done, change.allocations + change.reallocations)
}

/// Reads and reduces tests.
fn reductions(model: &PhasedModel, table: &str) -> Reductions {
    let layout = Layout { test: TestKey::Column("test".to_owned()), ..Layout::default() };
    let reducer = PhasedReducer::new(model, &Alpha::default()).unwrap();
    let mut sink = Reducing { model, reducer, reductions: Reductions::new() };
    read_from(model, &layout, &[Input::Stdin], &mut sink, &mut table.as_bytes()).unwrap();
    sink.reductions
}

/// Fits them and records what each test says: how many pieces of memory the reading and the record took.
fn of_tests(model: &PhasedModel, tests: usize) -> [usize; 2] {
    let table = table(tests);
    let (reductions, read) = allocations(|| reductions(model, &table));
    let choices = Choices { deletion: DeletionChoice::None, ..Choices::default() };
    let options = Options { choices, ..Options::default() };
    let fit = fit_reductions(model, reductions, &options).unwrap();
    let Fit { model, alpha, reductions, estimate, inference, .. } = &fit;
    let record = || FitRecord::new(model, alpha, reductions, estimate, inference, Provenance::default());
    let (record, recorded) = allocations(record);
    assert_eq!(record.tests.len(), tests);
    [read, recorded]
}

#[test]
fn a_test_has_no_memory_of_its_own() {
    let level = measurement("y", name("a") + name("b") * name("x"), 0.5);
    let model = Model::builder("").state(constant("a")).state(constant("b")).measurement(level).build().unwrap();
    let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    // of no more than 2 000 tests the record has estimates of their own
    let [some, more] = [3_000, 6_000].map(|tests| threads.install(|| of_tests(&model, tests)));
    let most = [OF_READ, OF_RECORD];
    for (what, (some, more), most) in [("read", (some[0], more[0]), most[0]), ("recorded", (some[1], more[1]), most[1])]
    {
        let each = (more - some) as f64 / 3_000.0;
        let said = format!(
            "{some} allocations for 3 000 tests {what}, {more} for 6 000: {each} for one test more, at most {most}"
        );
        println!("{said}");
        assert!(each < most, "{said}");
    }
}
