//! Figures of groups of tests: those with one text in the column that reports are grouped by.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::figure::figures;
use crate::{FigureUnit, FitRecord, TestRecord};
use kalfit_model::Model;
use kalfit_model::{Evidence, PhasedTest};
use kalfit_model::{Label, Labels};

figures! {
    /// The tests of one group together.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    pub struct GroupRecord {
        /// Text of the group in the column; null for tests whose cells are empty.
        pub group: Option<String> = figure {},
        /// Number of tests.
        pub tests: usize = figure { heading: "tests" },
        /// Number of scalar measurements.
        pub observations: usize = figure {},
        /// log p of its measurements: the sum of its tests'.
        pub log_likelihood: f64 = figure { unit: FigureUnit::LogLikelihood },
        /// Number of innovations, n.
        pub innovations: usize = figure {},
        /// Mean square of the innovations, each in units of its variance; expected 1 with standard deviation √(2/n).
        /// Null without innovations.
        pub innovations_mean_square: Option<f64> = figure {},
        /// Two-sided p-value of the mean square, by χ² with n degrees of freedom.
        pub innovations_p_value: Option<f64> = figure { heading: "p-value", unit: FigureUnit::Probability },
        /// Sum of the distances of its tests from the population.
        pub distance: Option<f64> = figure { heading: "distance²" },
        /// Degrees of freedom of the sum.
        pub degrees_of_freedom: usize = figure { heading: "expected" },
        /// χ² p-value of so large a sum; null in models with levels, whose tests share effects.
        pub p_value: Option<f64> = figure { heading: "p-value", unit: FigureUnit::Probability },
    }
}

/// Do the groups differ: μ and Σ of each group by itself against those of all tests, by likelihood ratio at the fitted
/// dynamic parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GroupTestRecord {
    /// Number of groups.
    pub groups: usize,
    /// Sum of the log-likelihoods of separate fits of the groups.
    pub log_likelihood: f64,
    /// Twice the excess of that sum over the log-likelihood of all tests together.
    pub statistic: f64,
    /// Free quantities of μ and Σ, for each group but one.
    pub degrees_of_freedom: usize,
    /// χ² p-value; an upper bound where an estimate is on the boundary.
    pub p_value: f64,
    /// Whether a group's Σ is singular, so that the p-value is an upper bound.
    pub on_boundary: bool,
}

/// A test with two texts in the column of groups.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "test `{test}` has `{first}` and `{second}` in column `{column}`, expected one text in all its rows, because tests are grouped by \
     this column"
)]
pub struct MixedGroup {
    /// Id of the test.
    pub test: String,
    /// Name of the column.
    pub column: String,
    /// One text in the column.
    pub first: String,
    /// Another text in the column.
    pub second: String,
}

/// Collects the group of each test as tests are read.
#[derive(Debug, Clone, Default)]
pub struct TestGroups {
    column: usize,
    name: String,
    of: Vec<(String, Option<String>)>,
}

impl TestGroups {
    /// `None` for a model that names no column to group by.
    pub fn new(model: &Model) -> Option<TestGroups> {
        let column = model.group?;
        Some(TestGroups { column, name: model.text_columns[column].name.clone(), of: Vec::new() })
    }

    /// Takes the groups of more tests.
    ///
    /// # Errors
    /// A test with two groups.
    pub fn take(&mut self, tests: &[PhasedTest], labels: &Labels) -> Result<(), MixedGroup> {
        for test in tests {
            let rows = test.phases.iter().filter_map(Evidence::cells);
            let cells = rows.flat_map(|rows| (0..rows.rows()).map(|row| rows.texts(row)[self.column]));
            let mut group: Option<Label> = None;
            for cell in cells.filter(|cell| !cell.is_missing()) {
                if let Some(first) = group.filter(|first| *first != cell) {
                    return Err(MixedGroup {
                        test: test.id.to_string(),
                        column: self.name.clone(),
                        first: labels.text(first).to_owned(),
                        second: labels.text(cell).to_owned(),
                    });
                }
                group = Some(cell);
            }
            self.of.push((test.id.to_string(), group.map(|label| labels.text(label).to_owned())));
        }
        Ok(())
    }

    /// Forgets all tests.
    pub fn clear(&mut self) {
        self.of.clear();
    }

    /// The group of each test, in the order of reading.
    pub fn each(&self) -> &[(String, Option<String>)] {
        &self.of
    }
}

impl FitRecord {
    /// Sets the group of each test.
    pub fn add_groups(&mut self, groups: &TestGroups) {
        let of: BTreeMap<&str, &Option<String>> = groups.of.iter().map(|(id, group)| (id.as_str(), group)).collect();
        self.group_column = Some(groups.name.clone());
        for number in 0..self.tests.len() {
            let group = of.get(self.tests.get(number).id).and_then(|group| (*group).clone());
            self.tests.group.set(number, group);
        }
    }

    /// Computes the figures of groups from the present figures of the tests; does nothing without groups.
    pub fn add_by_group(&mut self) {
        if self.group_column.is_none() {
            return;
        }
        let mut numbers: BTreeMap<Option<&String>, Vec<usize>> = BTreeMap::new();
        for (number, test) in self.tests.iter().enumerate() {
            numbers.entry(test.group).or_default().push(number);
        }
        let of = |(group, numbers): (Option<&String>, Vec<usize>)| {
            GroupRecord::of(!self.levels.is_empty(), group, numbers.iter().map(|&number| self.tests.get(number)))
        };
        self.by_group = numbers.into_iter().map(of).collect();
    }
}

impl GroupRecord {
    /// `in_levels`: the tests share effects of levels, so that their distances are not independent.
    fn of<'a>(
        in_levels: bool,
        group: Option<&String>,
        tests: impl ExactSizeIterator<Item = TestRecord<'a>> + Clone,
    ) -> GroupRecord {
        let figures = || tests.clone().filter_map(|test| test.innovations);
        let innovations: usize = figures().map(|figures| figures.count).sum();
        let nis: f64 = figures().filter_map(|figures| figures.whitened_nis.or(figures.nis)).sum();
        let distances = || tests.clone().filter_map(|test| Some((test.distance?, test.degrees_of_freedom)));
        let (distance, degrees_of_freedom) = distances().fold((0.0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
        let law = |degrees: usize| ChiSquared::new(degrees as f64).ok().filter(|_| degrees > 0);
        GroupRecord {
            group: group.cloned(),
            tests: tests.len(),
            observations: tests.clone().map(|test| test.observations).sum(),
            log_likelihood: tests.map(|test| test.log_likelihood).sum(),
            innovations,
            innovations_mean_square: (innovations > 0).then(|| nis / innovations as f64),
            innovations_p_value: law(innovations).map(|chi| (2.0 * chi.sf(nis).min(chi.cdf(nis))).min(1.0)),
            distance: (degrees_of_freedom > 0).then_some(distance),
            degrees_of_freedom,
            p_value: law(degrees_of_freedom).filter(|_| !in_levels).map(|chi| chi.sf(distance)),
        }
    }
}
