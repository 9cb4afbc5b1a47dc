//! The design of an ensemble: tests that give times, inputs and missing values, and the ids of the drawn tests.

use std::collections::BTreeSet;

use crate::reduce::grouping;
use crate::simulate::SimulateError;
use kalfit_model::PhasedModel;
use kalfit_model::PhasedTest;
use kalfit_model::{Grouping, Member};

/// The design of an ensemble: n ≥ 1 tests with distinct ids. Test j of the ensemble has the times, inputs and missing
/// values of test j mod n of the design.
#[derive(Debug, Clone)]
pub struct Designs {
    tests: Vec<PhasedTest>,
    round_mark: String,
    grouping: Option<Grouping>,
}

/// A group of a drawn test.
pub(super) struct DrawnGroup<'a> {
    /// No two groups of the ensemble, in whatever rounds, have one number.
    pub(super) number: u64,
    /// The group among those of its level.
    pub(super) member: Member<'a>,
}

impl Designs {
    /// The design that consists of `tests`.
    ///
    /// # Errors
    /// No tests, or two tests with the same id.
    pub fn new(tests: Vec<PhasedTest>) -> Result<Designs, SimulateError> {
        if tests.is_empty() {
            return Err(SimulateError::NoTests);
        }
        let mut ids = BTreeSet::new();
        if let Some(duplicate) = tests.iter().find(|test| !ids.insert(test.id.as_str())) {
            return Err(SimulateError::DuplicateTest { id: duplicate.id.to_string() });
        }
        let mut round_mark = "#".to_owned();
        while ids.iter().any(|id| id.trim_end_matches(|c: char| c.is_ascii_digit()).ends_with(&round_mark)) {
            round_mark.push('#');
        }
        Ok(Designs { tests, round_mark, grouping: None })
    }

    /// The design that consists of `tests`, for a model. With levels, each test is in the groups that the rows of the
    /// test name, and each round through the design has new groups of the same names. Without levels, the design is
    /// that of [`Designs::new`].
    ///
    /// # Errors
    /// As [`Designs::new`]; also a test whose groups are not known.
    pub fn of(model: &PhasedModel, tests: Vec<PhasedTest>) -> Result<Designs, SimulateError> {
        let grouping = grouping(model, &tests)?;
        Ok(Designs { grouping, ..Designs::new(tests)? })
    }

    /// The groups of test `index` at each level, the innermost first. `None` where the groups are not known.
    pub(super) fn groups<'a>(&'a self, index: u64) -> Option<Vec<Vec<DrawnGroup<'a>>>> {
        let grouping = self.grouping.as_ref()?;
        let (round, all) = (index / self.tests.len() as u64, (0..grouping.depth()).map(|l| grouping.groups(l).len()));
        let level_starts: Vec<usize> = all.scan(0, |end, count| Some(std::mem::replace(end, *end + count))).collect();
        let total: usize = (0..grouping.depth()).map(|l| grouping.groups(l).len()).sum();
        let number = grouping.number(&self.design(index).id)?;
        let of_level = |(level, first): (usize, usize)| {
            let number_of = |group: usize| round * total as u64 + (first + group) as u64;
            let members = grouping.members(number, level);
            members.map(|member| DrawnGroup { number: number_of(member.group), member }).collect()
        };
        Some(level_starts.into_iter().enumerate().map(of_level).collect())
    }

    /// The tests of the design.
    pub fn tests(&self) -> &[PhasedTest] {
        &self.tests
    }

    /// The test of the design that gives times, inputs and missing values of test `index` of an ensemble.
    pub fn design(&self, index: u64) -> &PhasedTest {
        let n = self.tests.len() as u64;
        &self.tests[usize::try_from(index % n).expect("a remainder is below the number of tests")]
    }

    /// Id of test `index` of an ensemble: in the first round the id of the test of the design, in the second round
    /// `id#2`. Where an id of the design ends in `#` and digits, `#` is repeated, so that no two ids are equal.
    pub fn id(&self, index: u64) -> String {
        let design = self.design(index);
        match index / self.tests.len() as u64 {
            0 => design.id.to_string(),
            round => format!("{}{}{}", design.id, self.round_mark, round + 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::Test;

    fn designs(ids: &[&str]) -> Result<Designs, SimulateError> {
        Designs::new(ids.iter().map(|id| Test::new(*id, 0, 0).into()).collect())
    }

    #[test]
    fn ids_of_an_ensemble_differ_whatever_the_ids_of_the_design() {
        for ids in [&["a", "b"][..], &["a", "a#2"], &["a", "a#", "a##2", "#3"], &["007", "7", ""]] {
            let designs = designs(ids).expect("ids differ");
            let all: BTreeSet<String> = (0..40).map(|index| designs.id(index)).collect();
            assert_eq!(all.len(), 40, "{ids:?} become {all:?}");
        }
        let plain = designs(&["a", "b"]).expect("ids differ");
        let first: Vec<String> = (0..5).map(|index| plain.id(index)).collect();
        assert_eq!(first, ["a", "b", "a#2", "b#2", "a#3"]);
    }

    #[test]
    fn a_design_needs_tests_with_ids_of_their_own() {
        assert_eq!(designs(&[]).err(), Some(SimulateError::NoTests));
        assert_eq!(designs(&["a", "b", "a"]).err(), Some(SimulateError::DuplicateTest { id: "a".to_owned() }));
    }
}
