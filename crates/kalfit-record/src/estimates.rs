//! The covariance of all estimates in a record: later uses of a fit compute errors from it.

use std::collections::HashMap;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use kalfit_infer::{Estimand, EstimateCovariance, Estimated, Knowledge, MeanAndVarianceLaw};
use kalfit_model::Labels;
use kalfit_model::{PhasedModel, Slots};

use crate::cut::BlockCut;
use crate::{FitRecord, ParameterRecord, SquareRecord};

/// The covariance of all estimates, except fixed numbers and those on bounds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EstimatesRecord {
    /// Name of each row and column: `mean[a]`, `regression[a, column]`, `covariance[a, b]`, `tau`, `tau[level]`. Where
    /// there are several phases, and for levels of groups, the name of the phase or level comes first, as in `coast:
    /// mean[a]`.
    pub names: Vec<String>,
    /// Covariance of the estimates.
    pub covariance: SquareRecord,
    /// Estimates that the data do not determine.
    pub open: Vec<String>,
    /// Variances and noise levels that were estimated as zero.
    pub at_zero: Vec<String>,
    /// Laws of means and covariances with few tests, under the restricted likelihood; absent where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub few_tests: Option<FewTestsLawRecord>,
}

/// Laws of means and covariances with few tests, from which degrees of freedom of predictions follow.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FewTestsLawRecord {
    /// Name of each variance, covariance and free parameter.
    pub names: Vec<String>,
    /// Value of each.
    pub values: Vec<f64>,
    /// Power of each that is a variance: 1 for variances and covariances, 2 for standard deviations; 0 for what is none.
    pub powers: Vec<f64>,
    /// Covariance of the estimates of these, for singular Σ too.
    pub covariance: SquareRecord,
    /// Name of each mean and regression coefficient.
    pub means: Vec<String>,
    /// Covariance of the estimates of the means, with the errors by `df_method`.
    pub mean_covariance: SquareRecord,
    /// Covariance of the estimates of the means at known covariances and parameters.
    pub mean_covariance_plain: SquareRecord,
    /// Derivatives of `mean_covariance_plain` with respect to each of `names`.
    pub mean_slopes: Vec<SquareRecord>,
}

/// Names of the elements of μ, of the regression coefficients, and of the elements of Σ.
fn names(model: &PhasedModel) -> Vec<(Estimated, String)> {
    let mut all = Vec::new();
    for cut in BlockCut::blocks(model) {
        let prefix = match cut.level {
            None if model.is_single() => String::new(),
            _ => format!("{}: ", cut.name()),
        };
        let (states, first) = (cut.states(), cut.elements.start);
        if cut.level.is_none() {
            let means = states.iter().enumerate();
            all.extend(means.map(|(i, name)| (Estimated::Mean(first + i), format!("{prefix}mean[{name}]"))));
            let own = &cut.phase.model;
            let regressions = cut.regressions.clone().zip(&own.mean.regression);
            all.extend(regressions.map(|(c, regression)| {
                let (state, column) = (&states[regression.element], &own.columns[regression.column].name);
                (Estimated::Coefficient(c), format!("{prefix}regression[{state}, {column}]"))
            }));
        }
        for (i, second) in states.iter().enumerate() {
            for (j, one) in states[..=i].iter().enumerate() {
                let name = format!("{prefix}covariance[{one}, {second}]");
                all.push((Estimated::Covariance(first + i, first + j), name));
            }
        }
    }
    all
}

/// Name of a parameter, `tau`, or of its value at a level, `tau[level]`.
fn parameter_name(name: &str, level: Option<&str>) -> String {
    level.map_or(name.to_owned(), |level| format!("{name}[{level}]"))
}

impl EstimatesRecord {
    /// Names of the estimates that are zero and that no law of few tests gives an error.
    pub fn exact_zeros(&self) -> Vec<String> {
        let has_law = |name: &&String| self.few_tests.as_ref().is_some_and(|law| law.names.contains(name));
        self.at_zero.iter().filter(|name| !has_law(name)).cloned().collect()
    }

    /// Free values of `found` are in the order of the slots; `labels`: texts of the levels of the free values.
    pub(super) fn new(
        model: &PhasedModel,
        found: &EstimateCovariance,
        few_tests: Option<MeanAndVarianceLaw>,
        values: Option<(&Slots, &Labels)>,
    ) -> EstimatesRecord {
        let of: HashMap<Estimated, String> = names(model).into_iter().collect();
        let name = |one: &Estimated| match one {
            Estimated::Value(slot) => {
                let (slots, labels) = values.expect("free values have slots");
                let slot = slots.slots()[*slot];
                let level = slot.level.map(|level| labels.text(level));
                parameter_name(&model.shared().parameters[slot.parameter].name, level)
            }
            other => of[other].clone(),
        };
        EstimatesRecord {
            names: found.quantities.iter().map(name).collect(),
            covariance: (&found.covariance).into(),
            open: found.open.iter().map(name).collect(),
            at_zero: found.at_zero.iter().map(name).collect(),
            few_tests: few_tests.map(|law| FewTestsLawRecord::new(&law, &name)),
        }
    }
}

impl FewTestsLawRecord {
    fn new(law: &MeanAndVarianceLaw, name: &dyn Fn(&Estimated) -> String) -> FewTestsLawRecord {
        let means = 0..law.mean_covariance.nrows();
        let kept: Vec<usize> = means.filter(|&k| law.mean_covariance[(k, k)] > 0.0).collect();
        let of_means = |matrix: &DMatrix<f64>| (&matrix.select_rows(&kept).select_columns(&kept)).into();
        let mean = |&k: &usize| name(&k.checked_sub(law.means).map_or(Estimated::Mean(k), Estimated::Coefficient));
        FewTestsLawRecord {
            names: law.quantities.iter().map(name).collect(),
            values: law.values.clone(),
            powers: law.powers.clone(),
            covariance: (&law.covariance).into(),
            means: kept.iter().map(mean).collect(),
            mean_covariance: of_means(&law.mean_covariance),
            mean_covariance_plain: of_means(&law.mean_covariance_plain),
            mean_slopes: law.mean_slopes.iter().map(of_means).collect(),
        }
    }

    /// The law for a model with p elements of μ and r coefficients; `None` where names or sizes do not fit.
    fn law(&self, of: &HashMap<String, Estimand>, (p, r): (usize, usize)) -> Option<MeanAndVarianceLaw<Estimand>> {
        let place = |name: &String| match of.get(name)? {
            Estimand::Population(Estimated::Mean(i)) if *i < p => Some(*i),
            Estimand::Population(Estimated::Coefficient(c)) if *c < r => Some(p + c),
            _ => None,
        };
        let places: Vec<usize> = self.means.iter().map(place).collect::<Option<_>>()?;
        let of_means = |record: &SquareRecord| {
            if record.size() != places.len() {
                return None;
            }
            let mut matrix = DMatrix::zeros(p + r, p + r);
            for (i, &row) in places.iter().enumerate() {
                places.iter().enumerate().for_each(|(k, &column)| matrix[(row, column)] = record[i][k]);
            }
            Some(matrix)
        };
        let count = self.names.len();
        let lengths = [self.values.len(), self.powers.len(), self.mean_slopes.len(), self.covariance.size()];
        let is_whole = lengths.iter().all(|length| *length == count);
        let covariance = is_whole.then(|| DMatrix::from_fn(count, count, |a, b| self.covariance[a][b]))?;
        Some(MeanAndVarianceLaw {
            means: p,
            quantities: self.names.iter().map(|name| of.get(name).cloned()).collect::<Option<_>>()?,
            values: self.values.clone(),
            powers: self.powers.clone(),
            covariance,
            mean_covariance: of_means(&self.mean_covariance)?,
            mean_covariance_plain: of_means(&self.mean_covariance_plain)?,
            mean_slopes: self.mean_slopes.iter().map(of_means).collect::<Option<_>>()?,
        })
    }
}

impl FitRecord {
    /// Errors of the estimates, for a model with the same states and parameters; `None` where the record contains no
    /// errors, or errors of estimates with different names.
    pub fn knowledge(&self, model: &PhasedModel) -> Option<Knowledge> {
        let record = self.estimates.as_ref()?;
        let size = record.names.len();
        if record.covariance.size() != size {
            return None;
        }
        let mut of: HashMap<String, Estimand> =
            names(model).into_iter().map(|(one, name)| (name, Estimand::Population(one))).collect();
        for ParameterRecord { name, level, .. } in &self.parameters {
            let parameter = model.shared().parameters.iter().position(|parameter| parameter.name == *name);
            if let Some(parameter) = parameter {
                let known = Estimand::Parameter { parameter, level: level.clone() };
                of.insert(parameter_name(name, level.as_deref()), known);
            }
        }
        let all = |names: &[String]| names.iter().map(|name| of.get(name).cloned()).collect::<Option<Vec<Estimand>>>();
        let covariance = DMatrix::from_fn(size, size, |i, k| record.covariance[i][k]);
        let [quantities, open, at_zero] = [&record.names, &record.open, &record.at_zero].map(|names| all(names));
        let is_restricted = self.criterion == "reml";
        let tests = self.levels.first().map_or(self.data.tests, |level| level.groups) as f64;
        let (quantities, open, at_zero) = (quantities?, open?, at_zero?);
        let width = (model.dimension(), model.phases.iter().map(|phase| phase.model.mean.regression.len()).sum());
        let few_tests = record.few_tests.as_ref().and_then(|law| law.law(&of, width));
        Some(Knowledge { quantities, covariance, open, at_zero, tests, is_restricted, few_tests })
    }
}
