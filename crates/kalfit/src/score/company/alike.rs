//! Tests that differ in nothing but what was measured, found once for all values of α.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::reduce::{PhasedReducer, PhasedTest};

/// Fewer tests than these are not worth a company.
const FEWEST: usize = 16;

/// The tests of an ensemble by whose company they are in. It depends on the ensemble, not on the order of its tests.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Companies {
    /// Numbers of the tests of each, ascending.
    pub(crate) companies: Vec<Vec<usize>>,
    /// Those in none.
    pub(crate) alone: Vec<usize>,
}

impl Companies {
    /// Of tests that differ in nothing but what was measured.
    pub(crate) fn of(reducer: &PhasedReducer, tests: &[PhasedTest]) -> Companies {
        let phases = reducer.phases().len();
        let Some(looks) =
            reducer.phases().iter().map(|phase| phase.reducer.preparer().looks.as_ref()).collect::<Option<Vec<_>>>()
        else {
            return Companies::none(tests.len());
        };
        let hash = |test: &PhasedTest| {
            let of = |at: usize| reducer.rows_of(at, test).map(|rows| looks[at].hash(rows, true));
            (test.phases.len(), (0..phases).map(of).collect::<Vec<Option<u64>>>())
        };
        let hashes: Vec<_> = tests.par_iter().map(hash).collect();
        let mut known: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        hashes.into_iter().enumerate().for_each(|(number, hash)| known.entry(hash).or_default().push(number));
        let likeness = |number: usize| {
            let of = |at: usize| reducer.rows_of(at, &tests[number]).map(|rows| looks[at].likeness(rows));
            (0..phases).map(of).collect::<Vec<_>>()
        };
        let mut found = Companies::default();
        for mut left in known.into_values() {
            // tests of one hash are alike, but for chance
            while left.len() >= FEWEST {
                let own = likeness(left[0]);
                let (like, rest): (Vec<usize>, Vec<usize>) =
                    left.par_iter().partition(|&&number| likeness(number) == own);
                if like.len() < FEWEST {
                    found.alone.extend(like)
                } else {
                    found.companies.push(like)
                }
                left = rest;
            }
            found.alone.extend(left);
        }
        found.alone.sort_unstable();
        found
    }

    /// All of so many tests by themselves.
    pub(crate) fn none(tests: usize) -> Companies {
        Companies { companies: Vec::new(), alone: (0..tests).collect() }
    }
}
