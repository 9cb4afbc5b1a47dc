//! The search for a fit by sums: it yields the next questions, or the fit.

use std::sync::Arc;

use crate::dynamic;
use crate::shards::error::ShardError;
use kalfit_estimate as estimate;
use kalfit_estimate::{Combination, Criterion, FitError, Progress, Stage, Step, Structure};
use kalfit_filter::reduce::{Reductions, grouping};
use kalfit_infer::{Choices, DeletionChoice, DfChoice, IntervalKind, StdErrors, TestsChoice, infer_while};
use kalfit_model::Labels;
use kalfit_model::remote::{Answer, Answers, Asked, Question, Remote};
use kalfit_model::{PhasedModel, Slots, Value};
use kalfit_record::{DynamicParts, FitRecord, Provenance};
use kalfit_search::{Coordinate, Method, Settings, SuggestedValues};

/// Note on the record of every fit by sums.
const BY_SUMS: &str = "computed from sums over tests, which stayed at their places: there are no results of single tests, and designs are counted place by place";

/// Options of a fit by sums.
#[derive(Debug, Clone, Default)]
pub struct Asks {
    /// Settings of the search for μ and Σ.
    pub settings: estimate::Settings,
    /// Basis of the standard errors: the observed information or, with all parameters known, the expected information.
    pub std_errors: StdErrors,
    /// Kind of intervals; only Wald's are supported.
    pub intervals: IntervalKind,
}

/// The next questions of a fit, or the result of the fit.
#[derive(Debug)]
pub enum Next {
    /// Questions to which the fit needs the answers, summed over all places.
    Asks(Vec<Asked>),
    /// The fit has ended with this record.
    Ends(Box<FitRecord>),
}

/// The questions that every place is to answer first.
///
/// # Errors
/// A model that cannot be fitted by sums.
pub fn first(model: &PhasedModel, settings: &estimate::Settings) -> Result<Vec<Asked>, ShardError> {
    refuse_model(model, settings)?;
    let slots = slots(model);
    let question = if slots.is_empty() { Question::Survey } else { Question::Opening };
    Ok(vec![Asked { values: vec![0.0; slots.len()], question }])
}

/// Continues a fit with the sums over all places that are known so far.
///
/// # Errors
/// A model or an option that a fit by sums does not support, or any error of a fit of all tests in one place.
pub fn go_on(
    model: &PhasedModel,
    asks: &Asks,
    known: Vec<(Asked, Answer)>,
    provenance: Provenance,
    progress: &mut dyn Progress,
) -> Result<Next, ShardError> {
    let slots = slots(model);
    refuse_choices(asks, &slots)?;
    let opening = first(model, &asks.settings)?;
    let Some((_, opening_sum)) = known.iter().find(|(asked, _)| *asked == opening[0]) else {
        return Ok(Next::Asks(opening));
    };
    let opening_sum = opening_sum.clone().unwrap_or_default();
    if opening_sum.first().is_none_or(|tests| *tests < 1.0) {
        return Err(ShardError::NoTests);
    }
    let answers = Arc::new(Answers::new(known));
    let mut stopping = StopWhenWaiting { answers: answers.clone(), progress };
    let choices = Choices {
        std_errors: asks.std_errors,
        intervals: IntervalKind::Wald,
        df: DfChoice::None,
        deletion: DeletionChoice::None,
        tests: TestsChoice::None,
    };
    let found = match slots.is_empty() {
        true => fit_known_alpha(model, (asks, choices), (&answers, &slots), provenance, &mut stopping),
        false => fit_free_alpha(model, (asks, choices), (&answers, &slots, &opening_sum), provenance, &mut stopping),
    };
    let wanted = answers.wanted();
    if !wanted.is_empty() {
        return Ok(Next::Asks(wanted)); // a result found without these answers is meaningless
    }
    let mut record = found?;
    record.notes.push(BY_SUMS.to_owned());
    Ok(Next::Ends(Box::new(record)))
}

fn fit_known_alpha(
    model: &PhasedModel,
    (asks, choices): (&Asks, Choices),
    (answers, slots): (&Arc<Answers>, &Slots),
    provenance: Provenance,
    progress: &mut dyn Progress,
) -> Result<FitRecord, ShardError> {
    let alpha = slots.alpha(model.shared(), &[]);
    let reductions = Reductions::elsewhere(Remote { values: Vec::new(), answers: answers.clone() });
    let grouping = grouping(model, &[])?.map(Arc::new); // the tests are in other places
    let structure = Structure::of(model, &alpha, grouping.as_ref());
    let estimate = estimate::fit(&reductions, &structure, &asks.settings, progress).map_err(failed)?;
    let inference = infer_while(model, (&estimate, &reductions), choices, progress);
    Ok(FitRecord::new(model, &alpha, &reductions, &estimate, &inference, provenance))
}

fn fit_free_alpha(
    model: &PhasedModel,
    (asks, choices): (&Asks, Choices),
    (answers, slots, opening_sum): (&Arc<Answers>, &Slots, &[f64]),
    provenance: Provenance,
    progress: &mut dyn Progress,
) -> Result<FitRecord, ShardError> {
    let opening = SuggestedValues::of(opening_sum, &Coordinate::of(model, slots));
    let SuggestedValues { start, units, .. } =
        opening.ok_or(ShardError::Question { what: "the number of free values" })?;
    // α, μ and Σ move together, so that a step needs only one sum
    let settings = Settings { method: Method::Innovations, inner: asks.settings.clone(), ..Settings::default() };
    let fit = dynamic::fit_remote(model, (slots, &settings), (answers, start, units), progress).map_err(Box::new)?;
    let labels = &Labels::new(&model.shared().literals);
    let (inference, parameters) = dynamic::infer(model, (labels, &[]), &fit, choices, progress).map_err(Box::new)?;
    let parts = DynamicParts { model, labels, fit: &fit, inference: &inference, parameters: &parameters };
    Ok(FitRecord::dynamic(&parts, provenance))
}

fn failed(error: FitError) -> ShardError {
    ShardError::Dynamic(Box::new(error.into()))
}

/// Slots of the free values, all of which are common to all tests.
fn slots(model: &PhasedModel) -> Slots {
    Slots::in_phases(model, &Labels::new(&model.shared().literals), &[])
}

/// Refuses models that cannot be fitted by sums.
pub(super) fn refuse_model(model: &PhasedModel, settings: &estimate::Settings) -> Result<(), ShardError> {
    let free = |value: Value| matches!(value, Value::Free { .. });
    let parameters = &model.shared().parameters;
    if let Some(per_level) = parameters.iter().find(|p| p.per.is_some() && free(p.value)) {
        return Err(ShardError::PerLevel { parameter: per_level.name.clone() });
    }
    if settings.phases == Combination::Marginal && !model.is_single() {
        return Err(ShardError::Marginal);
    }
    let Some(parameter) = parameters.iter().find(|p| free(p.value)).map(|p| p.name.clone()) else { return Ok(()) };
    let crossed = |phase: &kalfit_model::Phase| {
        !phase.model.noise_covariance.is_empty() || !phase.model.process_noise_covariance.is_empty()
    };
    if model.phases.iter().any(crossed) {
        return Err(ShardError::NoiseCovariance { parameter });
    }
    match settings.criterion {
        Criterion::Reml => Err(ShardError::Restricted { parameter }),
        Criterion::Ml => Ok(()),
    }
}

/// Refuses options that a fit by sums does not support.
fn refuse_choices(asks: &Asks, slots: &Slots) -> Result<(), ShardError> {
    match asks.std_errors {
        StdErrors::Sandwich => Err(ShardError::StdErrors { found: "sandwich" }),
        StdErrors::Expected if !slots.is_empty() => {
            Err(ShardError::StdErrors { found: "expected information beside free parameters" })
        }
        _ if matches!(asks.intervals, IntervalKind::Profile | IntervalKind::Bootstrap) => Err(ShardError::Profiles),
        _ => Ok(()),
    }
}

/// A progress that stops the search once it needs an answer that is not known.
struct StopWhenWaiting<'a> {
    answers: Arc<Answers>,
    progress: &'a mut dyn Progress,
}

impl Progress for StopWhenWaiting<'_> {
    fn step(&mut self, step: Step) {
        if !self.answers.is_waiting() {
            self.progress.step(step);
        }
    }

    fn stage(&mut self, stage: Stage<'_>) {
        self.progress.stage(stage);
    }

    fn stops(&self) -> bool {
        self.answers.is_waiting() || self.progress.stops()
    }
}
