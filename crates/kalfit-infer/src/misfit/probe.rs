//! The model and the tests with a copy of every measured cell, so that a change of what is measured changes no input.

use kalfit_model::{Column, Evidence, PhasedModel, PhasedTest, Test};
use rayon::prelude::*;

/// The model in which the m-th measurement of a phase reads the m-th of additional columns, and the tests with these
/// columns, sorted by id. Tests in which no phase has rows are left out.
pub(super) fn probed(model: &PhasedModel, tests: &[PhasedTest]) -> (PhasedModel, Vec<PhasedTest>) {
    let mut probe = model.clone();
    let more = model.phases.iter().map(|phase| phase.model.measurements.len()).max().unwrap_or(0);
    for own in probe.models_mut() {
        let first = own.columns.len();
        let copies = (0..more).map(|m| Column { name: format!("measured {m}"), used_in: String::new() });
        own.columns.extend(copies);
        own.measurements.iter_mut().enumerate().for_each(|(m, meter)| meter.column = first + m);
    }
    let has_rows = |test: &&PhasedTest| test.phases.iter().all(|evidence| matches!(evidence, Evidence::Rows(_)));
    let mut tests: Vec<PhasedTest> = tests.par_iter().filter(has_rows).map(|test| copied(model, test, more)).collect();
    // sums have the same bits in any order of the tests
    tests.sort_by(|a, b| a.id.as_str().cmp(b.id.as_str()));
    (probe, tests)
}

fn copied(model: &PhasedModel, test: &PhasedTest, more: usize) -> PhasedTest {
    let phases = test.phases.iter().zip(&model.phases).map(|(evidence, phase)| {
        let Evidence::Rows(rows) = evidence else { unreachable!("tests without rows are left out") };
        let copy = |own: &[f64], copies: &mut [f64]| {
            copies.iter_mut().zip(&phase.model.measurements).for_each(|(copy, meter)| *copy = own[meter.column]);
        };
        Evidence::Rows(rows.widened(more, copy))
    });
    PhasedTest { id: test.id.clone(), phases: phases.collect() }
}

/// The rows of each phase of a probed test.
pub(super) fn rows(test: &PhasedTest) -> impl Iterator<Item = &Test> {
    test.phases.iter().filter_map(|evidence| match evidence {
        Evidence::Rows(rows) => Some(rows),
        Evidence::Estimates(_) | Evidence::Reduced(_) => None,
    })
}
