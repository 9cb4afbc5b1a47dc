//! `[states]`: what there is, how it starts, and which of it is estimated.

use kalfit::model::{Expression, Initial, Motion, State};

use crate::error::{Result, Span, SpecError, SpecProblem};
use crate::expression::{self, ExpressionScope, ZERO};
use crate::keys;
use crate::motion::{MotionProcess, deviation, moved, squared};
use crate::names::{NameContext, ParameterRole, check_name};
use crate::table::{TomlField, TomlTable};

/// States of one model; μ, Σ and every filter step grow with its square.
const MAX_STATES: usize = 500;

/// A state whose name is known and whose equations are not read yet.
pub(crate) struct DeclaredState<'d> {
    name: &'d str,
    index: usize,
    section: TomlTable<'d>,
    process: MotionProcess,
    start: Option<TomlField<'d>>,
}

/// Reads the names of all states and makes them known, hidden ones after their owners.
pub(crate) fn declare<'d>(
    context: &mut NameContext<'_>,
    field: Option<&TomlField<'d>>,
) -> Result<Vec<DeclaredState<'d>>> {
    let table = context.phase.table("states");
    let section = field.map(|field| field.section(table.as_str())).transpose()?;
    let found = section.as_ref().map_or(0, TomlTable::len);
    if found == 0 || found > MAX_STATES {
        let problem = SpecProblem::Count { what: "states", found, expected: format!("1 to {MAX_STATES}") };
        let error = SpecError::new(problem).hint("a state is a table in `[states]`, as in `intercept = {}`");
        return Err(field.map_or(error.clone(), |field| error.at(field.key_span.clone())));
    }
    let mut all = Vec::with_capacity(found);
    for field in section.iter().flat_map(TomlTable::fields) {
        check_name("state", field.key, &field.key_span)?;
        if context.parameters.get(field.key).is_some() {
            let problem = SpecProblem::TakenName { name: field.key.to_owned() };
            return Err(SpecError::new(problem).at(field.key_span));
        }
        let place = context.phase.entry("states", "state", field.key);
        let mut section = field.section(place)?.with_keys(keys::STATE)?;
        let process = MotionProcess::of(&mut section)?;
        let index = context.states.add(field.key, field.key_span.clone());
        if process == MotionProcess::GaussMarkov2 {
            context.states.add(&rate_name(field.key), field.key_span.clone());
        }
        all.push(DeclaredState { name: field.key, index, section, process, start: None });
    }
    Ok(all)
}

/// Reads the equations of all states.
pub(crate) fn lower(context: &mut NameContext<'_>, mut declared: Vec<DeclaredState<'_>>) -> Result<Vec<State>> {
    let mut states = Vec::with_capacity(declared.len());
    for one in &mut declared {
        lower_one(context, one, &mut states)?;
    }
    for one in &declared {
        check_stationary(context, one, &states)?;
    }
    for one in declared {
        let (why, hint) = one.process.words();
        one.section.finish(why, Some(hint))?;
    }
    Ok(states)
}

fn lower_one(context: &mut NameContext<'_>, one: &mut DeclaredState<'_>, states: &mut Vec<State>) -> Result<()> {
    let section = &mut one.section;
    let unit = section.take("unit").map(|unit| unit.text().map(str::to_owned)).transpose()?;
    let moved = moved(context, section, one.process, one.index)?;
    one.start = section.take("initial");
    let initial = match &one.start {
        Some(field) => initial(context, field, &section.place)?,
        None if moved.stationary => Initial::Stationary,
        None => Initial::Estimated,
    };
    let estimated = initial == Initial::Estimated;
    let offset = section.take("offset");
    let random = section.take("random");
    if let Some(field) = offset.as_ref().or(random.as_ref())
        && !estimated
    {
        let why = format!("on a state whose start is not estimated ({})", start_words(&initial));
        return Err(field.no_effect(&why));
    }
    let place = format!("offset of {}", section.place);
    let offset = offset.map(|field| expression::scalar(context, &field, ExpressionScope::start(&place))).transpose()?;
    let random = random.map_or(Ok(true), |field| field.truth())?;
    let hidden = moved.hidden.map(|rate| State {
        name: context.states.name(one.index + 1).to_owned(),
        unit: None,
        motion: rate.motion,
        initial: match initial {
            Initial::Stationary => Initial::Stationary,
            _ => Initial::Known { mean: ZERO, variance: rate.variance },
        },
        offset: None,
        random: true,
    });
    states.push(State { name: one.name.to_owned(), unit, motion: moved.motion, initial, offset, random });
    states.extend(hidden);
    Ok(())
}

fn initial(context: &mut NameContext<'_>, field: &TomlField<'_>, place: &str) -> Result<Initial> {
    if !field.is_table() {
        if field.as_text().is_none() {
            return Err(field.wrong_type("`\"estimated\"`, `\"stationary\"` or `{ mean = …, sigma = … }`"));
        }
        return Ok(match field.word(&["estimated", "stationary"])? {
            0 => Initial::Estimated,
            _ => Initial::Stationary,
        });
    }
    let mut section = field.section(format!("`initial` of {place}"))?.with_keys(keys::START)?;
    let (mean, sigma) = match (section.take("mean"), section.take("sigma")) {
        (Some(mean), Some(sigma)) => (mean, sigma),
        (None, _) => return Err(section.missing("mean").hint("write `mean = 0` when the known mean is 0")),
        (_, None) => {
            let hint = "write `sigma = 0` when the start is known exactly, \
                        `initial = \"estimated\"` when its spread is to be found";
            return Err(section.missing("sigma").hint(hint));
        }
    };
    let mean_place = mean.what();
    let mean = expression::scalar(context, &mean, ExpressionScope::start(&mean_place))?;
    let sigma_place = sigma.what();
    let deviation = deviation(context, &sigma, ExpressionScope::start(&sigma_place), ParameterRole::StandardDeviation)?;
    Ok(Initial::Known { mean, variance: squared(context, deviation, &sigma.span)? })
}

/// How a state starts, in words.
pub(crate) fn start_words(initial: &Initial) -> &'static str {
    match initial {
        Initial::Estimated => "estimated",
        Initial::Stationary => "stationary",
        Initial::Known { .. } => "known",
    }
}

/// A stationary distribution must exist, and belong to the stationary states alone.
fn check_stationary(context: &NameContext<'_>, one: &DeclaredState<'_>, states: &[State]) -> Result<()> {
    let state = &states[one.index];
    if state.initial != Initial::Stationary {
        return Ok(());
    }
    let wrong = |why: String| {
        let span: Span = one.start.as_ref().map_or(context.states.span(one.index), |field| field.span.clone());
        Err(SpecError::new(SpecProblem::NoStationaryLaw { name: one.name.to_owned(), why }).at(span))
    };
    match one.process {
        MotionProcess::Constant => return wrong("a constant keeps the value it starts with".to_owned()),
        MotionProcess::RandomWalk => return wrong("the variance of a random walk grows without bound".to_owned()),
        MotionProcess::Integral => return wrong("an integral keeps all that it started with".to_owned()),
        _ => {}
    }
    let (Motion::Continuous { derivative: linear, .. } | Motion::Discrete { next: linear, .. }) = &state.motion else {
        return Ok(());
    };
    let other = linear.terms.iter().find(|(other, _)| states[*other].initial != Initial::Stationary);
    match other {
        None => Ok(()),
        Some((other, _)) => {
            let start = start_words(&states[*other].initial);
            wrong(format!("it moves with state `{}`, whose start is {start}", context.states.name(*other)))
        }
    }
}

/// The hidden rate of a state, when it has one; it follows its owner.
pub(crate) fn rate_of(states: &[State], state: usize) -> Option<usize> {
    let rate = rate_name(&states[state].name);
    states.get(state + 1).filter(|next| next.name == rate).map(|_| state + 1)
}

/// No name in an expression, so it names nothing else.
fn rate_name(owner: &str) -> String {
    format!("{owner} (rate)")
}

/// States that are estimated, in file order.
pub(crate) fn estimated(states: &[State]) -> Vec<usize> {
    (0..states.len()).filter(|&i| states[i].initial == Initial::Estimated).collect()
}

/// The driving noise of a state: its variance, and what kind it is; none for a constant.
pub(crate) fn noise(state: &State) -> Option<(&Expression, &'static str)> {
    match &state.motion {
        Motion::Constant => None,
        Motion::Continuous { noise_variance, .. } => Some((noise_variance, "per unit of time")),
        Motion::Discrete { noise_variance, .. } => Some((noise_variance, "per step")),
    }
}
