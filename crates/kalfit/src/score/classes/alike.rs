//! Tests that differ in nothing but what was measured, found once for all values of α.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::reduce::{Evidence, LongDesignClasses, PhasedReducer, PhasedTest};

/// Fewer tests than these are not worth the chain rule put down as factors,
const FEWEST: usize = 16;
/// but two are where they have so many rows, in so many times fewer runs of equal steps.
pub(super) const LONG: usize = 1 << 10;
const EQUAL: usize = 16;

/// The tests of an ensemble by whose class they are in. It depends on the ensemble, not on the order of its tests.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct TestClasses {
    /// Numbers of the tests of each, ascending.
    pub(crate) classes: Vec<Vec<usize>>,
    /// Which of these are of long records in equal steps.
    pub(crate) long: Vec<bool>,
    /// Those in none.
    pub(crate) alone: Vec<usize>,
}

impl TestClasses {
    /// Of tests that differ in nothing but what was measured.
    pub(crate) fn of(reducer: &PhasedReducer, tests: &[PhasedTest]) -> TestClasses {
        let phases = reducer.phases().len();
        let Some(looks) = reducer
            .phases()
            .iter()
            .map(|phase| phase.reducer.preparer().cell_mask.as_ref())
            .collect::<Option<Vec<_>>>()
        else {
            return TestClasses::none(tests.len());
        };
        let hash = |test: &PhasedTest| {
            let of = |at: usize| reducer.rows_of(at, test).map(|rows| looks[at].hash(rows, true));
            (test.phases.len(), (0..phases).map(of).collect::<Vec<Option<u64>>>())
        };
        let hashes: Vec<_> = tests.par_iter().map(hash).collect();
        let mut known: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        hashes.into_iter().enumerate().for_each(|(number, hash)| known.entry(hash).or_default().push(number));
        let likeness = |number: usize| {
            let of = |at: usize| reducer.rows_of(at, &tests[number]).map(|rows| looks[at].design_cells(rows));
            (0..phases).map(of).collect::<Vec<_>>()
        };
        let mut found = TestClasses::default();
        for mut left in known.into_values() {
            // tests of one hash are alike, but for chance
            let long = left.len() > 1 && is_long(reducer, &tests[left[0]]);
            let fewest = if long { 2 } else { FEWEST };
            while left.len() >= fewest {
                let own = likeness(left[0]);
                let (like, rest): (Vec<usize>, Vec<usize>) =
                    left.par_iter().partition(|&&number| likeness(number) == own);
                if like.len() < fewest {
                    found.alone.extend(like)
                } else {
                    found.classes.push(like);
                    found.long.push(long);
                }
                left = rest;
            }
            found.alone.extend(left);
        }
        found.alone.sort_unstable();
        found
    }

    /// Tests of long records that are alike.
    pub(crate) fn long(&self, tests: &[PhasedTest]) -> LongDesignClasses {
        let rows = |&number: &usize| match tests[number].phases.first() {
            Some(Evidence::Rows(rows)) => Some(&rows.id),
            _ => None,
        };
        let ids = |class: &Vec<usize>| class.iter().filter_map(rows).collect();
        LongDesignClasses::new(
            self.classes.iter().zip(&self.long).filter(|(_, long)| **long).map(|(class, _)| ids(class)),
        )
    }

    /// All of so many tests by themselves.
    pub(crate) fn none(tests: usize) -> TestClasses {
        TestClasses { classes: Vec::new(), long: Vec::new(), alone: (0..tests).collect() }
    }
}

/// Whether most of a test are long stretches of equal steps, which other data pass over quickly.
fn is_long(reducer: &PhasedReducer, test: &PhasedTest) -> bool {
    let phases = (0..reducer.phases().len()).filter_map(|at| Some((at, reducer.rows_of(at, test)?)));
    phases.clone().map(|(_, rows)| rows.rows()).sum::<usize>() >= LONG
        && phases.into_iter().all(|(at, rows)| {
            let stretches = reducer.phases()[at].reducer.preparer().stretches(rows);
            stretches.is_some_and(|stretches| EQUAL * stretches <= rows.rows())
        })
}
