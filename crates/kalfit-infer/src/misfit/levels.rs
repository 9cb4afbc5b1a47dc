//! Units of tests that share effects of levels, and the whitening of what tests of one unit have in common.

use std::collections::BTreeMap;
use std::ops::Range;

use kalfit_algebra::symmetric::{eigen, from_eigen};
use kalfit_model::{Grouping, PhasedTest};
use nalgebra::DMatrix;

use crate::misfit::columns::UnitColumns;

/// Tests that share no effect with other tests: those of one group of the outermost level, or one test without levels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Unit {
    /// Indices of the tests; the tests of each group of each level stand together.
    pub(super) tests: Vec<usize>,
}

impl Unit {
    /// Number of rows of all tests.
    pub(super) fn rows(&self, tests: &[PhasedTest]) -> usize {
        self.tests.iter().map(|&test| tests[test].row_count()).sum()
    }
}

/// The units of some tests, in the order of their first tests.
pub(super) fn units(tests: &[PhasedTest], grouping: Option<&Grouping>) -> Vec<Unit> {
    let Some(grouping) = grouping else {
        return (0..tests.len()).map(|test| Unit { tests: vec![test] }).collect();
    };
    // a group is known by its first test, since numbers of groups follow the order of the data
    let mut first: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (test, one) in tests.iter().enumerate() {
        for (level, group) in path(grouping, &one.id).into_iter().enumerate() {
            first.entry((level, group)).or_insert(test);
        }
    }
    let mut by_path: BTreeMap<Vec<usize>, Vec<usize>> = BTreeMap::new();
    for (test, one) in tests.iter().enumerate() {
        let groups = path(grouping, &one.id).into_iter().enumerate();
        by_path.entry(groups.map(|place| first[&place]).collect()).or_default().push(test);
    }
    let mut units: Vec<(Option<usize>, Unit)> = Vec::new();
    for (path, tests) in by_path {
        let outermost = path.first().copied();
        match units.last_mut() {
            Some((last, unit)) if *last == outermost => unit.tests.extend(tests),
            _ => units.push((outermost, Unit { tests })),
        }
    }
    units.into_iter().map(|(_, unit)| unit).collect()
}

/// Indices of the groups of a test, the outermost first.
fn path(grouping: &Grouping, id: &str) -> Vec<usize> {
    let Some(number) = grouping.number(id) else { return Vec::new() };
    (0..grouping.depth()).rev().map(|level| grouping.group_of(number, level)).collect()
}

/// Multiplies the columns of a unit, which are white within tests, by (I + HΣH')^(-1/2) for the groups of each level, from
/// the innermost on, with the columns H of the states: afterwards the residuals are white in the law of the whole model.
/// The symmetric root does not depend on the order of the tests.
pub(super) fn whiten(
    unit: &mut UnitColumns,
    grouping: Option<&Grouping>,
    roots: &[DMatrix<f64>],
    states: Range<usize>,
) {
    let Some(grouping) = grouping else { return };
    for (level, root) in roots.iter().enumerate() {
        for tests in spans(unit, grouping, level) {
            let rows = unit.tests[tests.start].1.start..unit.tests[tests.end - 1].1.end;
            let mut block = unit.values.rows_range_mut(rows);
            let effects = block.columns_range(states.clone()) * root; // HF
            let (lambda, vectors) = eigen(&(effects.transpose() * &effects));
            let shrinkage = lambda.iter().map(|&lambda| shrinkage(lambda.max(0.0)));
            let weights = &effects * from_eigen(&vectors, shrinkage);
            let shared = effects.transpose() * &block;
            block -= weights * shared;
        }
    }
}

/// (1 - (1 + λ)^(-1/2)) / λ.
fn shrinkage(lambda: f64) -> f64 {
    let root = (1.0 + lambda).sqrt();
    1.0 / (root * (1.0 + root))
}

/// Positions of the tests of each group of a level among the tests of a unit.
pub(super) fn spans(unit: &UnitColumns, grouping: &Grouping, level: usize) -> Vec<Range<usize>> {
    let mut all: Vec<(Option<usize>, Range<usize>)> = Vec::new();
    for (at, (id, _)) in unit.tests.iter().enumerate() {
        let group = grouping.number(id).map(|number| grouping.group_of(number, level));
        match all.last_mut() {
            Some((last, before)) if *last == group => before.end = at + 1,
            _ => all.push((group, at..at + 1)),
        }
    }
    all.into_iter().map(|(_, tests)| tests).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shrinkage_whitens() {
        for lambda in [0.0, 1e-9, 0.3, 5.0, 1e8] {
            let left = (1.0 - lambda * shrinkage(lambda)).powi(2) * (1.0 + lambda);
            assert!((left - 1.0).abs() < 1e-7, "{lambda}: {left}");
        }
    }
}
