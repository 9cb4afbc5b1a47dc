//! Dynamic parameters as records: one entry for each value, with its errors and its standing.

use serde::{Deserialize, Serialize};

use kalfit_estimate::Stop;
use kalfit_infer::Interval;
use kalfit_model::{Alpha, Level, Model, Parameter, Slot, Value};
use kalfit_model::{Label, Labels};
use kalfit_search::{DynamicFit, ParameterInference, Standing};

/// One dynamic parameter, at one level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterRecord {
    /// Name of the parameter.
    pub name: String,
    /// Column whose levels have a value each; null for a common parameter.
    pub per: Option<String>,
    /// Level of `per` that has this value.
    pub level: Option<String>,
    /// Value of the parameter.
    pub estimate: f64,
    /// Standard error of the value.
    pub std_error: Option<f64>,
    /// 95 % interval, lower and upper end; an end is null where no limit was found.
    pub interval95: Interval,
    /// Whether the value is fixed, not estimated.
    pub fixed: bool,
    /// Whether the value is at a bound.
    pub at_bound: bool,
    /// Unit label.
    #[serde(default)]
    pub unit: Option<String>,
    /// Where the value lies: `inside`, `lower`, `upper`, `unbounded` or `unidentified`; null for a fixed value.
    #[serde(default)]
    pub standing: Option<String>,
    /// The meaning of `standing`, in words; null if the value is inside.
    #[serde(default)]
    pub note: Option<String>,
}

/// Where the search for α from another start ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StartRecord {
    /// log p of all measurements there.
    pub log_likelihood: f64,
    /// The optimality certificate holds there.
    pub converged: bool,
    /// The free values, in the order of the free entries of `parameters`.
    pub values: Vec<f64>,
}

/// Where one of several methods ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodRecord {
    /// `hybrid`, `innovations` or `em`.
    pub method: String,
    /// log p of all measurements.
    pub log_likelihood: f64,
    /// The optimality certificate holds.
    pub converged: bool,
    /// Why the search stopped, in words.
    pub reason: String,
    /// The free values, in the order of the free entries of `parameters`.
    pub values: Vec<f64>,
    /// Iterations of the solver; each uses the reductions of all tests.
    pub iterations: usize,
    /// Runs of the filters over all tests.
    pub filter_passes: usize,
    /// Backward runs over all tests.
    pub score_passes: usize,
    /// Wall time.
    pub seconds: f64,
}

/// Records of the parameters of a model without free parameters; the texts of all levels are literals of the model.
pub(super) fn fixed(model: &Model, alpha: &Alpha) -> Vec<ParameterRecord> {
    all(model, &|label| model.literals[label.index()].clone(), alpha, &|_| None)
}

/// Records of the parameters of a model with free parameters.
pub(super) fn estimated(
    model: &Model,
    labels: &Labels,
    fit: &DynamicFit,
    inferred: &[ParameterInference],
) -> Vec<ParameterRecord> {
    // slots are in the order of the model and of the texts, not of the labels
    let mut places: Vec<(Slot, usize)> = fit.slots.slots().iter().enumerate().map(|(i, slot)| (*slot, i)).collect();
    places.sort_unstable();
    let find = |slot: Slot| {
        let at = places.binary_search_by_key(&slot, |(slot, _)| *slot).ok()?;
        inferred.get(places[at].1)
    };
    all(model, &|label| labels.text(label).to_owned(), &fit.alpha, &find)
}

fn all<'a>(
    model: &Model,
    text: &dyn Fn(Label) -> String,
    alpha: &Alpha,
    find: &dyn Fn(Slot) -> Option<&'a ParameterInference>,
) -> Vec<ParameterRecord> {
    let mut records = Vec::new();
    for (index, (parameter, level)) in model.parameters.iter().zip(&alpha.values).enumerate() {
        match level {
            Level::Common(value) => {
                let found = find(Slot { parameter: index, level: None });
                records.push(record(model, parameter, None, *value, found));
            }
            Level::Each { values, .. } => {
                let mut own: Vec<ParameterRecord> = values
                    .iter()
                    .map(|(&label, &value)| {
                        let found = find(Slot { parameter: index, level: Some(label) });
                        record(model, parameter, Some(text(label)), value, found)
                    })
                    .collect();
                own.sort_by(|a, b| a.level.cmp(&b.level));
                records.append(&mut own);
                if let Value::Fixed(value) = parameter.value {
                    records.push(record(model, parameter, None, value, None));
                }
            }
        }
    }
    records
}

fn record(
    model: &Model,
    parameter: &Parameter,
    level: Option<String>,
    estimate: f64,
    found: Option<&ParameterInference>,
) -> ParameterRecord {
    let standing = found.map(|f| f.standing);
    ParameterRecord {
        name: parameter.name.clone(),
        per: parameter.per.map(|column| model.text_columns[column].name.clone()),
        level,
        estimate,
        std_error: found.and_then(|f| f.std_error).filter(|e| e.is_finite()),
        interval95: found.and_then(|f| finite(f.interval)),
        fixed: found.is_none(),
        at_bound: matches!(standing, Some(Standing::Lower | Standing::Vanishing | Standing::Upper | Standing::Edge)),
        unit: parameter.unit.clone(),
        standing: standing.map(|s| standing_word(s).to_owned()),
        note: standing.and_then(|s| meaning(s, estimate)).map(str::to_owned),
    }
}

/// Replaces ends that are not finite by `None`.
fn finite(interval: Interval) -> Interval {
    let ends = interval?.map(|end| end.filter(|x| x.is_finite()));
    ends.iter().any(Option::is_some).then_some(ends)
}

fn standing_word(standing: Standing) -> &'static str {
    match standing {
        Standing::Inside => "inside",
        Standing::Lower | Standing::Vanishing => "lower",
        Standing::Upper => "upper",
        Standing::Edge => "edge",
        Standing::Unbounded => "unbounded",
        Standing::Idle => "without_effect",
        Standing::Unidentified => "unidentified",
    }
}

/// Meaning of a lower bound of zero that is reached.
pub(super) const ZERO_MEANING: &str = "estimated as zero: the data show no such effect";

/// Meaning of a standing for the value itself, in words.
pub(super) fn meaning(standing: Standing, value: f64) -> Option<&'static str> {
    match standing {
        Standing::Inside => None,
        Standing::Lower if value == 0.0 => Some(ZERO_MEANING),
        Standing::Lower => Some("at its lower bound: the likelihood increases below it"),
        Standing::Vanishing => {
            Some("practically zero: at zero a measurement would be exact, so a slightly larger value was kept")
        }
        Standing::Upper => Some("at its upper bound: the likelihood increases above it"),
        Standing::Edge => {
            Some("at the largest possible covariance: the two noises are estimated as perfectly correlated")
        }
        Standing::Unbounded => Some(
            "too large to be determined: the log-likelihood still increases, ever more slowly. A time constant much longer than the records cannot be distinguished from a random constant or a random walk",
        ),
        Standing::Idle => Some("without effect while a noise level is zero"),
        Standing::Unidentified => {
            Some("not identified: at other values the log-likelihood is as high, so they fit the data as well")
        }
    }
}

impl StartRecord {
    /// Records of the ends of the searches from other starts.
    pub(super) fn all(fit: &DynamicFit) -> Vec<StartRecord> {
        let record = |end: &kalfit_search::OtherEnd| StartRecord {
            log_likelihood: end.log_likelihood,
            converged: end.stop == Stop::Certified,
            values: end.values.clone(),
        };
        fit.others.iter().filter(|end| end.log_likelihood.is_finite()).map(record).collect()
    }
}
