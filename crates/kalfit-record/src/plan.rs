//! A plan as a record: plan.json. Unknown figures are null, never NaN.

use serde::{Deserialize, Serialize};

use crate::DataRecord;
use crate::best_plan::BestPlanRecord;
use kalfit_apply::plan::Quantity;
use kalfit_apply::plan::{Arrangement, Figure, Plan, Planned, PlannedFigure, Reason};
use kalfit_model::{Model, Phase, PhasedModel};

/// Expected standard errors against the number of tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanRecord {
    /// Always `kalfit-plan/1`.
    pub schema: String,
    /// Version that made it.
    pub kalfit_version: String,
    /// Title of the model.
    pub title: String,
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// What the population was taken from, as named by the user.
    pub from: String,
    /// Counts of the design.
    pub design: DataRecord,
    /// Always `expected`: the kind of information the standard errors come from.
    pub information: String,
    /// Dynamic parameters that the model leaves free. They are taken as known at the population's values.
    pub parameters_taken_as_known: Vec<String>,
    /// The numbers of tests.
    pub tests: Vec<usize>,
    /// Arrangement in groups for each number of tests, where the model has levels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub arrangements: Vec<ArrangementRecord>,
    /// All quantities, in the order of [`Plan::quantities`]; of the best plan among candidates, then the free parameters.
    pub quantities: Vec<PlannedRecord>,
    /// The best plan among candidates, where one was sought.
    #[serde(flatten, default, skip_serializing_if = "Option::is_none")]
    pub best: Option<BestPlanRecord>,
}

/// Tests in groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArrangementRecord {
    /// Name of each crossed factor, and number of its levels; then of each level, the outermost first, and number of its
    /// groups in each group of the level above.
    pub groups: Vec<(String, usize)>,
    /// Number of crossed factors among them.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub crossed: usize,
    /// Number of tests in each group of the innermost level.
    pub tests: usize,
}

/// One quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedRecord {
    /// `mean`, `regression`, `std_dev`, `correlation`, `covariance`, `parameter`, `output` or `limit`.
    pub quantity: String,
    /// Name of the phase; `main` when there is only one.
    pub phase: String,
    /// Level of groups whose covariance it belongs to; null for the covariance of the tests.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub level: Option<String>,
    /// State of the quantity, or its two states.
    pub states: Vec<String>,
    /// Column of a regression coefficient.
    pub column: Option<String>,
    /// Unit label of the state, for a mean or a standard deviation.
    pub unit: Option<String>,
    /// Value of the quantity in the population.
    pub value: Option<f64>,
    /// Standard error of the quantity at each number of tests.
    pub std_error: Vec<Option<f64>>,
    /// Each standard error over the size of the value.
    #[serde(default)]
    pub relative_std_error: Vec<Option<f64>>,
    /// Why the standard errors are null: `fixed`, `unidentified` or `boundary`.
    pub reason: Option<String>,
    /// Name of a free parameter, or of a value of the mission: `output(range, 3)`, `limit(range, 3)`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter: Option<String>,
    /// Standard error before any test of the best plan is made; absent where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_error_before: Option<f64>,
    /// Degrees of freedom of a mean or coefficient after the best plan, where the model has no levels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub df: Option<f64>,
    /// The candidate of which one more unit of cost after the best plan makes the quantity better known than of any other.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub informed_by: Option<String>,
}

impl PlannedRecord {
    /// The quantity as `--for` names it: `mean(bias)`, `sd(unit.bias)`, `corr(bias, scale)`, `coefficient(bias, T)`, `tau`.
    pub fn name(&self, with_phase: bool) -> String {
        let prefix = match &self.level {
            Some(level) => format!("{level}."),
            None if with_phase => format!("{}.", self.phase),
            None => String::new(),
        };
        let states: Vec<String> = self.states.iter().map(|state| format!("{prefix}{state}")).collect();
        let states = states.join(", ");
        match (self.quantity.as_str(), &self.column, &self.parameter) {
            (_, _, Some(parameter)) => parameter.clone(),
            ("regression", Some(column), _) => format!("coefficient({states}, {column})"),
            ("std_dev", ..) => format!("sd({states})"),
            ("correlation", ..) => format!("corr({states})"),
            ("covariance", ..) => format!("cov({states})"),
            (kind, ..) => format!("{kind}({states})"),
        }
    }
}

/// Facts about a plan that the core does not know.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanProvenance {
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// What the population was taken from, as named by the user.
    pub from: String,
    /// Counts of the design.
    pub design: DataRecord,
    /// Free parameters that were given the population's values.
    pub parameters_taken_as_known: Vec<String>,
}

impl PlanRecord {
    /// The record of a plan. Panics when the plan is of a model with fewer states or regressions.
    pub fn new(model: &PhasedModel, plan: &Plan, provenance: PlanProvenance) -> PlanRecord {
        let all = plan.quantities.iter().filter(|planned| exists(model, planned.quantity));
        let quantities = all.map(|planned| record(model, planned, plan.tests.len())).collect();
        PlanRecord {
            arrangements: plan.arrangements.iter().map(|one| ArrangementRecord::new(model, one)).collect(),
            ..PlanRecord::of_tests(model, plan.tests.clone(), quantities, provenance)
        }
    }

    /// The record of the best plan among candidates; `names`: of figures that the model does not name.
    pub fn of_best(
        (model, names): (&PhasedModel, &PlanNames),
        figures: &[PlannedFigure],
        best: BestPlanRecord,
        provenance: PlanProvenance,
    ) -> PlanRecord {
        let of_figure = |one: &PlannedFigure| PlannedRecord {
            informed_by: one.informed_by.map(|k| best.candidates[k].name.clone()),
            ..PlannedRecord::of_figure((model, names), one)
        };
        let quantities = figures.iter().map(of_figure).collect();
        let tests = vec![best.candidates.iter().map(|one| one.tests).sum()];
        PlanRecord { best: Some(best), ..PlanRecord::of_tests(model, tests, quantities, provenance) }
    }

    fn of_tests(
        model: &PhasedModel,
        tests: Vec<usize>,
        quantities: Vec<PlannedRecord>,
        provenance: PlanProvenance,
    ) -> PlanRecord {
        PlanRecord {
            schema: "kalfit-plan/1".to_owned(),
            kalfit_version: env!("CARGO_PKG_VERSION").to_owned(),
            title: model.shared().title.clone(),
            model_digest: provenance.model_digest,
            from: provenance.from,
            design: provenance.design,
            information: "expected".to_owned(),
            parameters_taken_as_known: provenance.parameters_taken_as_known,
            tests,
            arrangements: Vec::new(),
            quantities,
            best: None,
        }
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks by reference")]
fn is_zero(count: &usize) -> bool {
    *count == 0
}

impl ArrangementRecord {
    fn new(model: &PhasedModel, arrangement: &Arrangement) -> ArrangementRecord {
        let names = model.levels.iter().map(|level| level.name.clone());
        let counts = arrangement.factors.iter().chain(&arrangement.groups).copied();
        ArrangementRecord {
            groups: names.zip(counts).collect(),
            crossed: arrangement.factors.len(),
            tests: arrangement.tests,
        }
    }
}

/// Names of figures of a plan that the model does not name.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlanNames {
    /// The free values of α, by slot.
    pub parameters: Vec<String>,
    /// The values of the mission: `range, 3` for output `range` at row 3.
    pub mission: Vec<String>,
}

impl PlannedRecord {
    /// The record of a figure of the best plan. Panics where it is of another model.
    pub fn of_figure((model, names): (&PhasedModel, &PlanNames), figure: &PlannedFigure) -> PlannedRecord {
        let (kind, name) = match figure.figure {
            Figure::Quantity(_) => ("", String::new()),
            Figure::Value(slot) => ("parameter", names.parameters[slot].clone()),
            Figure::Output(at) => ("output", format!("output({})", names.mission[at])),
            Figure::Limit(at) => ("limit", format!("limit({})", names.mission[at])),
        };
        let std_error = vec![figure.after];
        let size = figure.value.map(f64::abs).filter(|size| *size > 0.0);
        let relative = vec![figure.after.zip(size).map(|(error, size)| error / size)];
        let named = match figure.figure {
            Figure::Quantity(quantity) => {
                record(model, &Planned { quantity, value: figure.value, std_errors: Err(Reason::Unidentified) }, 1)
            }
            Figure::Value(_) | Figure::Output(_) | Figure::Limit(_) => PlannedRecord {
                quantity: kind.to_owned(),
                phase: model.phases[0].name.clone(),
                level: None,
                states: Vec::new(),
                column: None,
                unit: None,
                value: figure.value,
                std_error: Vec::new(),
                relative_std_error: Vec::new(),
                reason: None,
                parameter: Some(name),
                std_error_before: None,
                df: None,
                informed_by: None,
            },
        };
        let reason = figure.after.is_none().then(|| "unidentified".to_owned());
        PlannedRecord {
            std_error,
            relative_std_error: relative,
            reason,
            std_error_before: figure.before,
            df: figure.df,
            ..named
        }
    }
}

/// Level of groups of an element of Σ, and the corresponding element in the block of the tests themselves.
fn split_level(model: &PhasedModel, quantity: Quantity) -> (Option<String>, Quantity) {
    let p = model.dimension();
    let level = |i: usize| {
        let inner = (i / p).checked_sub(1).filter(|_| !model.levels.is_empty())?;
        model.levels.iter().rev().nth(inner).map(|level| level.name.clone())
    };
    match quantity {
        Quantity::StdDev(i) if i >= p => (level(i), Quantity::StdDev(i % p)),
        Quantity::Correlation(i, j) if i >= p => (level(i), Quantity::Correlation(i % p, j % p)),
        Quantity::Covariance(i, j) if i >= p => (level(i), Quantity::Covariance(i % p, j % p)),
        other => (None, other),
    }
}

/// Whether a quantity of a level is of effects that exist.
fn exists(model: &PhasedModel, quantity: Quantity) -> bool {
    let (level, of) = split_level(model, quantity);
    let Some(level) = model.levels.iter().find(|own| Some(&own.name) == level.as_ref()) else { return true };
    match of {
        Quantity::StdDev(i) => level.has_effect(i),
        Quantity::Correlation(i, j) | Quantity::Covariance(i, j) => level.has_effect(i) && level.has_effect(j),
        Quantity::Mean(_) | Quantity::Coefficient(_) => true,
    }
}

/// The phase that contains number `place` of all phases together, and the number within that phase.
fn find(model: &PhasedModel, place: usize, many: fn(&Model) -> usize) -> (&Phase, usize) {
    let mut remaining = place;
    for phase in &model.phases {
        match remaining.checked_sub(many(&phase.model)) {
            None => return (phase, remaining),
            Some(beyond) => remaining = beyond,
        }
    }
    panic!("the plan is of another model: it has a quantity {place}, beyond all phases")
}

fn record(model: &PhasedModel, planned: &Planned, many: usize) -> PlannedRecord {
    let regressions = |model: &Model| model.mean.regression.len();
    let (level, of) = split_level(model, planned.quantity);
    let named = model.levels.iter().find(|own| Some(&own.name) == level.as_ref());
    let effects = named.map(|level| level.effect_names(&model.shared().estimated_names()));
    let (phase, own) = match of {
        Quantity::Mean(i) | Quantity::StdDev(i) => find(model, i, Model::dimension),
        Quantity::Correlation(i, _) | Quantity::Covariance(i, _) => find(model, i, Model::dimension),
        Quantity::Coefficient(c) => find(model, c, regressions),
    };
    let model = &phase.model;
    let state = |element: usize| &model.states[model.estimated[element]];
    let name = |element: usize| match &effects {
        Some(effects) => effects[element].clone(),
        None => state(element).name.clone(),
    };
    // both states of a pair are of the same phase
    let pair = |i: usize, j: usize| vec![name(own + j - i), name(own)];
    let (quantity, states, unit) = match of {
        Quantity::Mean(_) => ("mean", vec![name(own)], state(own).unit.clone()),
        Quantity::Coefficient(_) => ("regression", vec![name(model.mean.regression[own].element)], None),
        Quantity::StdDev(_) => ("std_dev", vec![name(own)], state(own).unit.clone()),
        Quantity::Correlation(i, j) => ("correlation", pair(i, j), None),
        Quantity::Covariance(i, j) => ("covariance", pair(i, j), None),
    };
    let column = match planned.quantity {
        Quantity::Coefficient(_) => Some(model.columns[model.mean.regression[own].column].name.clone()),
        _ => None,
    };
    let reason = planned.std_errors.as_ref().err().map(|reason| match reason {
        Reason::Fixed => "fixed",
        Reason::Unidentified => "unidentified",
        Reason::Boundary => "boundary",
    });
    let std_error: Vec<Option<f64>> = match &planned.std_errors {
        Ok(errors) => errors.iter().map(|&error| Some(error).filter(|e| e.is_finite())).collect(),
        Err(_) => vec![None; many],
    };
    let size = planned.value.map(f64::abs).filter(|size| *size > 0.0);
    PlannedRecord {
        quantity: quantity.to_owned(),
        phase: phase.name.clone(),
        level,
        states,
        column,
        unit,
        value: planned.value,
        relative_std_error: std_error.iter().map(|error| error.zip(size).map(|(error, size)| error / size)).collect(),
        std_error,
        reason: reason.map(str::to_owned),
        parameter: None,
        std_error_before: None,
        df: None,
        informed_by: None,
    }
}
