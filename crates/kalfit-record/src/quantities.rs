//! All numbers of a fit that describe the population or the motion, in one list for tables.

use serde::{Deserialize, Serialize};

use crate::figure::figures;
use crate::{
    BoundaryRecord, CoefficientLawRecord, CovarianceRecord, FigureUnit, FitRecord, LevelRecord, MatrixRecord,
    ParameterRecord, PhaseRecord, ScaleRecord, UnidentifiedRecord, VectorRecord,
};
use kalfit_infer::Interval;

figures! {
    /// One number of a fit, with its errors and its status.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    pub struct QuantityRecord {
        /// `mean[a]`, `std_dev[a]`, `covariance[a, b]`, `correlation[a, b]`, `regression[a, column]`, `tau`,
        /// `tau[level]`. Where there are several phases, and for levels of groups, the name of the phase or level comes
        /// first, as in `coast: mean[a]`.
        pub name: String = figure {},
        /// `mean`, `mean_scale`, `regression`, `std_dev`, `covariance`, `covariance_scale`, `correlation` or
        /// `parameter`.
        pub kind: String = figure {},
        /// Name of the phase; null for a parameter.
        pub phase: Option<String> = figure {},
        /// Level of groups whose spread it is, `tests` for the level of the tests; for a parameter, the text of
        /// `column` that it belongs to.
        pub level: Option<String> = figure {},
        /// State that the number belongs to.
        pub state: Option<String> = figure {},
        /// The other state of a covariance or a correlation.
        pub other_state: Option<String> = figure {},
        /// The column of a regression, or of the levels of a parameter.
        pub column: Option<String> = figure {},
        /// Unit label of a mean, a standard deviation or a parameter.
        pub unit: Option<String> = figure {},
        /// Estimated or fixed value.
        pub estimate: Option<f64> = figure { unit: FigureUnit::Element },
        /// Standard error of the estimate.
        pub std_error: Option<f64> = figure { unit: FigureUnit::Element },
        /// Lower end of its 95 % interval.
        pub lower: Option<f64> = figure { unit: FigureUnit::Element },
        /// Upper end of its 95 % interval.
        pub upper: Option<f64> = figure { unit: FigureUnit::Element },
        /// Degrees of freedom of a mean or regression coefficient with few tests, under `reml`.
        #[serde(default)]
        pub df: Option<f64> = figure {},
        /// t of a mean or regression coefficient with few tests: estimate over standard error.
        #[serde(default)]
        pub statistic: Option<f64> = figure {},
        /// Two-sided p-value of the hypothesis that this mean or coefficient is zero.
        #[serde(default)]
        pub p_value: Option<f64> = figure {},
        /// `estimated`, `fixed`, `at zero`, `on the boundary`, `not identified`, `undefined`; of a parameter also `at
        /// lower bound`, `at upper bound`, `at the edge`, `unbounded` and `without effect`.
        pub status: String = figure {},
    }
}

impl FitRecord {
    /// Every number that was estimated or fixed: means, regressions, spreads and correlations phase by phase, spreads
    /// and correlations of levels of groups from the outermost level on, and the dynamic parameters.
    pub fn quantities(&self) -> Vec<QuantityRecord> {
        let mut all = Vec::new();
        for phase in &self.phases {
            let prefix = if self.phases.len() > 1 { format!("{}: ", phase.name) } else { String::new() };
            let of =
                QuantityOwner { prefix, phase: &phase.name, level: None, states: &phase.states, units: &phase.units };
            of.means(phase, &mut all);
            if self.levels.is_empty() {
                of.covariance_quantities(&CovarianceForms::from(phase), &mut all);
            }
        }
        let first = self.phases.first().map_or((&[][..], "main"), |phase| (&phase.units[..], phase.name.as_str()));
        for level in self.all_levels() {
            let own = level.column.is_none(); // the spread of the tests is the covariance of the model itself
            let prefix = if own { String::new() } else { format!("{}: ", level.name) };
            let (phase, states) = (first.1, &level.states);
            let of = QuantityOwner { prefix, phase, level: Some(&level.name), states, units: first.0 };
            of.covariance_quantities(&CovarianceForms::from(level), &mut all);
        }
        all.extend(self.parameters.iter().map(parameter));
        all
    }
}

/// The phase or level that numbers belong to.
struct QuantityOwner<'a> {
    /// Beginning of the names of the numbers.
    prefix: String,
    phase: &'a str,
    level: Option<&'a str>,
    states: &'a [String],
    units: &'a [Option<String>],
}

/// Σ as covariances, standard deviations and correlations, with boundaries and directions that are not identified.
struct CovarianceForms<'a> {
    covariance: &'a CovarianceRecord,
    std_dev: &'a VectorRecord,
    correlation: &'a MatrixRecord,
    boundary: &'a [BoundaryRecord],
    unidentified: &'a [UnidentifiedRecord],
}

impl<'a> From<&'a PhaseRecord> for CovarianceForms<'a> {
    fn from(own: &'a PhaseRecord) -> CovarianceForms<'a> {
        let PhaseRecord { covariance, std_dev, correlation, boundary, unidentified, .. } = own;
        CovarianceForms { covariance, std_dev, correlation, boundary, unidentified }
    }
}

impl<'a> From<&'a LevelRecord> for CovarianceForms<'a> {
    fn from(own: &'a LevelRecord) -> CovarianceForms<'a> {
        let LevelRecord { covariance, std_dev, correlation, boundary, unidentified, .. } = own;
        CovarianceForms { covariance, std_dev, correlation, boundary, unidentified }
    }
}

/// A number with standard error and interval.
#[derive(Clone, Copy)]
struct ValueErrors {
    estimate: Option<f64>,
    std_error: Option<f64>,
    interval95: Interval,
}

impl QuantityOwner<'_> {
    fn row(&self, kind: &str, states: &[&str], value: ValueErrors, status: &str) -> QuantityRecord {
        let text = |at: usize| states.get(at).map(|state| (*state).to_owned());
        let [lower, upper] = value.interval95.unwrap_or_default();
        let within = if states.is_empty() { String::new() } else { format!("[{}]", states.join(", ")) };
        QuantityRecord {
            name: format!("{}{kind}{within}", self.prefix),
            kind: kind.to_owned(),
            phase: Some(self.phase.to_owned()),
            level: self.level.map(str::to_owned),
            state: text(0),
            other_state: text(1),
            column: None,
            unit: None,
            estimate: value.estimate,
            std_error: value.std_error,
            lower,
            upper,
            status: status.to_owned(),
            df: None,
            statistic: None,
            p_value: None,
        }
    }

    fn unit(&self, state: usize) -> Option<String> {
        self.units.get(state).cloned().flatten()
    }

    fn means(&self, phase: &PhaseRecord, all: &mut Vec<QuantityRecord>) {
        let mean = &phase.mean;
        for (i, state) in self.states.iter().enumerate() {
            let value = at(&mean.estimate, &mean.std_error, &mean.interval95, i);
            let fixed = mean.fixed.get(i).copied().unwrap_or_default();
            let moved = |element: &str| element == state;
            let status = status(value, fixed, is_open(&phase.unidentified, "mean", &moved));
            let few = &mean.few_tests;
            let of = |list: &Vec<Option<f64>>| list.get(i).copied().flatten();
            let (df, statistic, p_value) = (of(&few.df), of(&few.statistic), of(&few.p_value));
            let row = self.row("mean", &[state], value, status);
            all.push(QuantityRecord { unit: self.unit(i), df, statistic, p_value, ..row });
        }
        for one in &mean.regression {
            let moved = |element: &str| element == format!("{} per {}", one.state, one.column);
            let value =
                ValueErrors { estimate: Some(one.estimate), std_error: one.std_error, interval95: one.interval95 };
            let status = status(value, false, is_open(&phase.unidentified, "mean", &moved));
            let row = self.row("regression", &[&one.state, &one.column], value, status);
            let CoefficientLawRecord { df, statistic, p_value, .. } = one.few_tests;
            let column = Some(one.column.clone());
            all.push(QuantityRecord { other_state: None, column, df, statistic, p_value, ..row });
        }
        self.scale("mean_scale", mean.scale.as_ref(), all);
    }

    fn scale(&self, kind: &str, scale: Option<&ScaleRecord>, all: &mut Vec<QuantityRecord>) {
        let row = |own: &ScaleRecord| {
            let value =
                ValueErrors { estimate: Some(own.estimate), std_error: own.std_error, interval95: own.interval95 };
            self.row(kind, &[], value, "estimated")
        };
        all.extend(scale.map(row));
    }

    /// Standard deviations, covariances and correlations, each once.
    fn covariance_quantities(&self, own: &CovarianceForms<'_>, all: &mut Vec<QuantityRecord>) {
        let CovarianceForms { covariance, std_dev, correlation, .. } = own;
        let fixed = |i: usize, k: usize| cell(&covariance.fixed, i, k).unwrap_or_default();
        for (i, state) in self.states.iter().enumerate() {
            let value = at(&std_dev.estimate, &std_dev.std_error, &std_dev.interval95, i);
            let status = own.status((state, state), value, fixed(i, i));
            all.push(QuantityRecord { unit: self.unit(i), ..self.row("std_dev", &[state], value, status) });
        }
        for (i, state) in self.states.iter().enumerate() {
            for (k, other) in self.states.iter().enumerate().skip(i) {
                let value = ValueErrors {
                    estimate: cell(&covariance.estimate, i, k),
                    std_error: cell(&covariance.std_error, i, k).flatten(),
                    interval95: cell(&covariance.interval95, i, k).flatten(),
                };
                let status = own.status((state, other), value, fixed(i, k));
                all.push(self.row("covariance", &[state, other], value, status));
            }
        }
        for (i, state) in self.states.iter().enumerate() {
            for (k, other) in self.states.iter().enumerate().skip(i + 1) {
                let value = ValueErrors {
                    estimate: cell(&correlation.estimate, i, k).flatten(),
                    std_error: cell(&correlation.std_error, i, k).flatten(),
                    interval95: cell(&correlation.interval95, i, k).flatten(),
                };
                let status = own.status((state, other), value, fixed(i, k));
                all.push(self.row("correlation", &[state, other], value, status));
            }
        }
        self.scale("covariance_scale", covariance.scale.as_ref(), all);
    }
}

impl CovarianceForms<'_> {
    /// Status of an element of Σ.
    fn status(&self, (one, other): (&String, &String), value: ValueErrors, fixed: bool) -> &'static str {
        if value.estimate.is_none() {
            return "undefined";
        }
        if fixed {
            return "fixed";
        }
        let zero = |own: &BoundaryRecord| own.zero_variances.contains(one) || own.zero_variances.contains(other);
        if self.boundary.iter().any(zero) {
            return "at zero";
        }
        let names = [format!("{one}, {other}"), format!("{other}, {one}")];
        let open = is_open(self.unidentified, "covariance", &|element| names.iter().any(|name| name == element));
        let singular =
            |own: &BoundaryRecord| own.states.is_empty() || own.states.contains(one) || own.states.contains(other);
        match status(value, false, open) {
            "estimated" if value.std_error.is_none() && self.boundary.iter().any(singular) => "on the boundary",
            other => other,
        }
    }
}

fn status(value: ValueErrors, fixed: bool, open: bool) -> &'static str {
    match (fixed, open && value.std_error.is_none()) {
        (true, _) => "fixed",
        (false, true) => "not identified",
        (false, false) => "estimated",
    }
}

/// Whether an element takes part in a direction that the data do not determine.
fn is_open(directions: &[UnidentifiedRecord], what: &str, moved: &dyn Fn(&str) -> bool) -> bool {
    let moves = |direction: &UnidentifiedRecord| {
        let mut weights = direction.elements.iter().zip(&direction.direction);
        weights.any(|(element, weight)| *weight != 0.0 && moved(element))
    };
    directions.iter().filter(|direction| direction.what == what).any(moves)
}

/// Entry `i` of three lists.
fn at(estimate: &[f64], std_error: &[Option<f64>], interval95: &[Interval], i: usize) -> ValueErrors {
    ValueErrors {
        estimate: estimate.get(i).copied(),
        std_error: std_error.get(i).copied().flatten(),
        interval95: interval95.get(i).copied().flatten(),
    }
}

/// Entry (i, k) of a matrix; `None` where the matrix has no such entry.
fn cell<T: Copy>(rows: &[Vec<T>], i: usize, k: usize) -> Option<T> {
    rows.get(i)?.get(k).copied()
}

fn parameter(own: &ParameterRecord) -> QuantityRecord {
    let [lower, upper] = own.interval95.unwrap_or_default();
    let status = match own.standing.as_deref() {
        _ if own.fixed => "fixed",
        Some("lower") if own.estimate == 0.0 => "at zero",
        Some("lower") => "at lower bound",
        Some("upper") => "at upper bound",
        Some("edge") => "at the edge",
        Some("unbounded") => "unbounded",
        Some("without_effect") => "without effect",
        Some("unidentified") => "not identified",
        _ => "estimated",
    };
    QuantityRecord {
        name: own.level.as_ref().map_or(own.name.clone(), |level| format!("{}[{level}]", own.name)),
        kind: "parameter".to_owned(),
        phase: None,
        level: own.level.clone(),
        state: None,
        other_state: None,
        column: own.per.clone(),
        unit: own.unit.clone(),
        estimate: Some(own.estimate),
        std_error: own.std_error,
        lower,
        upper,
        status: status.to_owned(),
        df: None,
        statistic: None,
        p_value: None,
    }
}
