//! What tests cost in pieces of memory between reader and reductions: none of its own for any of them.
//!
//! A test binary of its own, since all that it allocates is counted.
#![allow(clippy::unwrap_used, reason = "only a test")]

use std::alloc::System;
use std::fmt::Write as _;

use kalfit::build::{constant, measurement, name};
use kalfit::reduce::{PhasedReducer, ReduceError};
use kalfit::{Alpha, Isa, Labels, Layout, Model, PhasedModel, PhasedTest, Reductions, Test, TestKey};
use kalfit_data::{Input, TestSink, read_from};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Pieces that a group of tests side by side shares, as many tests as there are lanes: blocks of lanes, work space, tables that grow.
const OF_GROUP: f64 = 32.0;

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

/// Reads and reduces tests on one thread: how many pieces of memory that took.
fn allocations(model: &PhasedModel, table: &str, tests: usize) -> usize {
    let layout = Layout { test: TestKey::Column("test".to_owned()), ..Layout::default() };
    let region = Region::new(ALLOCATOR);
    let reducer = PhasedReducer::new(model, &Alpha::default()).unwrap();
    let mut sink = Reducing { model, reducer, reductions: Reductions::new() };
    read_from(model, &layout, &[Input::Stdin], &mut sink, &mut table.as_bytes()).unwrap();
    assert_eq!(sink.reductions.len(), tests);
    let change = region.change();
    change.allocations + change.reallocations
}

#[test]
fn a_test_has_no_memory_of_its_own() {
    let level = measurement("y", name("a") + name("b") * name("x"), 0.5);
    let model = Model::builder("").state(constant("a")).state(constant("b")).measurement(level).build().unwrap();
    let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let [some, more] = [1_000, 2_000].map(|tests| {
        let table = table(tests);
        threads.install(|| allocations(&model, &table, tests))
    });
    let each = (more - some) as f64 / 1_000.0;
    let most = OF_GROUP / Isa::best().lanes() as f64;
    println!("{some} allocations for 1 000 tests, {more} for 2 000: {each} for one test more, at most {most}");
    assert!(each < most, "{some} allocations for 1 000 tests, {more} for 2 000: {each} for one test more, not {most}");
}
