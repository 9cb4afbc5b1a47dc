//! Division of tests into folds, which are left out in turn.

use std::collections::BTreeMap;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::validate::ValidateError;
use kalfit_filter::reduce::grouping;
use kalfit_model::Labels;
use kalfit_model::PhasedModel;
use kalfit_model::PhasedTest;
use kalfit_record::TestGroups;

/// Assignment of each test to a fold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Folds {
    /// Names of the folds.
    pub names: Vec<String>,
    /// The fold of each test.
    pub of: Vec<usize>,
}

/// Why tests cannot be divided into folds.
#[derive(Debug, thiserror::Error)]
pub enum FoldsError {
    /// There is only one fold, so that no tests remain to fit.
    #[error("there is one fold, expected two or more: {why}")]
    One {
        /// What would give more folds.
        why: &'static str,
    },
    /// The tests of one group are in two folds.
    #[error("tests of {level} `{group}` are in folds `{first}` and `{second}`, expected one fold for all of them")]
    Apart {
        /// Name of the outermost level.
        level: String,
        /// Name of the group.
        group: String,
        /// One of the folds.
        first: String,
        /// Another of the folds.
        second: String,
    },
    /// The groups of the tests cannot be determined.
    #[error(transparent)]
    Validate(Box<ValidateError>),
}

impl Folds {
    /// Draws folds of about equal numbers of tests, or of groups of the outermost level, from a seed; the order of the
    /// tests does not matter.
    ///
    /// # Errors
    /// There are fewer than two tests or groups.
    pub fn drawn(
        model: &PhasedModel,
        labels: &Labels,
        tests: &[PhasedTest],
        (count, seed): (usize, u64),
    ) -> Result<Folds, FoldsError> {
        let pieces = pieces(model, labels, tests)?;
        let mut names: Vec<&String> = pieces.iter().collect();
        names.sort();
        names.dedup();
        let why = if model.levels.is_empty() { "give two tests or more" } else { "give two groups or more" };
        if names.len() < 2 || count < 2 {
            return Err(FoldsError::One { why });
        }
        let count = count.min(names.len());
        names.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
        let fold: BTreeMap<&String, usize> = names.iter().enumerate().map(|(k, name)| (*name, k % count)).collect();
        let of = pieces.iter().map(|name| fold[name]).collect();
        Ok(Folds { names: (1..=count).map(|k| k.to_string()).collect(), of })
    }

    /// Folds by the text of each test in a column: tests with equal texts are one fold.
    ///
    /// # Errors
    /// There is only one text, or the tests of one group have two.
    pub fn by_text(
        model: &PhasedModel,
        labels: &Labels,
        tests: &[PhasedTest],
        groups: &TestGroups,
    ) -> Result<Folds, FoldsError> {
        let texts: BTreeMap<&str, &str> =
            groups.each().iter().map(|(id, text)| (id.as_str(), text.as_deref().unwrap_or_default())).collect();
        let test_texts: Vec<&str> =
            tests.iter().map(|test| texts.get(test.id.as_str()).copied().unwrap_or_default()).collect();
        let mut names = test_texts.clone();
        names.sort_unstable();
        names.dedup();
        if names.len() < 2 {
            return Err(FoldsError::One { why: "name a column with different texts" });
        }
        let of: Vec<usize> = test_texts.iter().map(|text| names.partition_point(|name| name < text)).collect();
        if let Some(level) = model.nested().first() {
            let mut seen: BTreeMap<String, usize> = BTreeMap::new();
            for (group, &fold) in pieces(model, labels, tests)?.into_iter().zip(&of) {
                let first = *seen.entry(group.clone()).or_insert(fold);
                if first != fold {
                    let [first, second] = [first, fold].map(|fold| names[fold].to_owned());
                    return Err(FoldsError::Apart { level: level.name.clone(), group, first, second });
                }
            }
        }
        let named = |name: &str| if name.is_empty() { "(no text)".to_owned() } else { name.to_owned() };
        Ok(Folds { names: names.into_iter().map(named).collect(), of })
    }

    /// Number of folds.
    pub fn count(&self) -> usize {
        self.names.len()
    }

    /// Indices of the tests of a fold, and of the other tests.
    pub fn split(&self, fold: usize) -> (Vec<usize>, Vec<usize>) {
        (0..self.of.len()).partition(|&test| self.of[test] == fold)
    }
}

/// For each test the name of what is left out as a whole: the test, or its group of the outermost nested level.
fn pieces(model: &PhasedModel, labels: &Labels, tests: &[PhasedTest]) -> Result<Vec<String>, FoldsError> {
    let found = grouping(model, tests).map_err(|error| FoldsError::Validate(Box::new(error.into())))?;
    let outermost = found.and_then(|grouping| Some((grouping.nested().checked_sub(1)?, grouping)));
    let Some((level, grouping)) = outermost else { return Ok(tests.iter().map(|test| test.id.to_string()).collect()) };
    let name = |test: &PhasedTest| {
        let number = grouping.number(&test.id).unwrap_or_default();
        let group = &grouping.groups(level)[grouping.group_of(number, level)];
        group.path.iter().map(|&name| labels.text(name)).collect::<Vec<_>>().join("/")
    };
    Ok(tests.iter().map(name).collect())
}
