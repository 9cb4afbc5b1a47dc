//! Estimates of a fit, looked up by name.

use crate::face::fit::Fit;
use kalfit_infer::{Interval, Posterior};
use kalfit_record::{ParameterRecord, PhaseRecord, VectorRecord};

/// An estimated number with a standard error and an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// The estimate.
    pub estimate: f64,
    /// Standard error of the estimate; `None` where the number is fixed, not identified, or on the boundary.
    pub std_error: Option<f64>,
    /// 95 % interval of the number; `None` where the number is fixed or not identified.
    pub interval95: Interval,
}

/// Nothing in the fit has this name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the fit has no {what} `{name}`; it has {}", known.join(", "))]
pub struct UnknownName {
    /// Kind of the quantity that was requested.
    pub what: &'static str,
    /// The unknown name.
    pub name: String,
    /// The names that the fit has.
    pub known: Vec<String>,
}

impl Fit {
    /// The mean of a state over the tests. States of models in phases are named `phase.state`.
    ///
    /// # Errors
    /// There is no such estimated state.
    pub fn mean(&self, state: &str) -> Result<Figure, UnknownName> {
        let (phase, i) = self.find(state)?;
        let (estimate, mean) = (phase.mean.estimate[i], &phase.mean);
        Ok(Figure { estimate, std_error: mean.std_error[i], interval95: mean.interval95[i] })
    }

    /// The standard deviation of a state from test to test.
    ///
    /// # Errors
    /// There is no such estimated state.
    pub fn std_dev(&self, state: &str) -> Result<Figure, UnknownName> {
        let (phase, i) = self.find(state)?;
        let VectorRecord { estimate, std_error, interval95 } = &phase.std_dev;
        Ok(Figure { estimate: estimate[i], std_error: std_error[i], interval95: interval95[i] })
    }

    /// The correlation of two states of one phase; `None` where one of the states does not vary, or where the states
    /// are of different phases.
    ///
    /// # Errors
    /// There are no such estimated states.
    pub fn correlation(&self, first: &str, second: &str) -> Result<Option<Figure>, UnknownName> {
        let ((phase, i), (other, j)) = (self.find(first)?, self.find(second)?);
        let matrix = &phase.correlation;
        let figure =
            |estimate| Figure { estimate, std_error: matrix.std_error[i][j], interval95: matrix.interval95[i][j] };
        Ok(matrix.estimate[i][j].filter(|_| phase.name == other.name).map(figure))
    }

    /// A dynamic parameter, common to all tests.
    ///
    /// # Errors
    /// There is no such parameter, or it has levels.
    pub fn parameter(&self, name: &str) -> Result<Figure, UnknownName> {
        self.one_parameter(name, None)
    }

    /// A dynamic parameter at a level.
    ///
    /// # Errors
    /// There is no such parameter, or it does not have this level.
    pub fn parameter_at(&self, name: &str, level: &str) -> Result<Figure, UnknownName> {
        self.one_parameter(name, Some(level))
    }

    fn one_parameter(&self, name: &str, level: Option<&str>) -> Result<Figure, UnknownName> {
        let full_name =
            |name: &str, level: Option<&str>| level.map_or(name.to_owned(), |level| format!("{name}[{level}]"));
        let all = &self.record.parameters;
        let found = all.iter().find(|p| p.name == name && p.level.as_deref() == level);
        let unknown = || UnknownName {
            what: "parameter",
            name: full_name(name, level),
            known: all.iter().map(|p| full_name(&p.name, p.level.as_deref())).collect(),
        };
        let ParameterRecord { estimate, std_error, interval95, .. } = found.ok_or_else(unknown)?;
        Ok(Figure { estimate: *estimate, std_error: *std_error, interval95: *interval95 })
    }

    /// Posterior of the initial states of one test, given the population.
    ///
    /// # Errors
    /// There is no such test.
    pub fn posterior(&self, test: &str) -> Result<Posterior<'_>, UnknownName> {
        let index = self.reductions.iter().position(|reduction| reduction.test == test);
        index.map(|i| self.inference.posteriors.get(i)).ok_or_else(|| UnknownName {
            what: "test",
            name: test.to_owned(),
            known: self.reductions.iter().map(|reduction| reduction.test.to_owned()).collect(),
        })
    }

    fn find(&self, state: &str) -> Result<(&PhaseRecord, usize), UnknownName> {
        let known = self.model.estimated_names();
        match known.iter().position(|name| name == state) {
            Some(place) => {
                let ranges = self.model.ranges();
                let phase = ranges.iter().position(|range| range.contains(&place)).expect("a state is of some phase");
                Ok((&self.record.phases[phase], place - ranges[phase].start))
            }
            None => Err(UnknownName { what: "estimated state", name: state.to_owned(), known }),
        }
    }
}
