//! `[data]`: what tells tests apart, and where steps and times come from.

use kalfit::model::{Clock, Expression, Model, Motion};
use kalfit::{Layout, TestKey};

use crate::error::{Result, Span, SpecError, SpecProblem};
use crate::keys;
use crate::levels::{self, GroupColumns, GroupKind};
use crate::names::NameContext;
use crate::phases::PhaseSource;
use crate::suggest::suggest;
use crate::table::{TomlField, TomlTable};

const PLACE: &str = "`[data]`";

/// What `[data]` says.
#[derive(Debug, Default)]
pub(crate) struct DataSpec {
    pub(crate) layout: Layout,
    pub(crate) clock: Clock,
    pub(crate) group: Option<usize>,
    /// The columns of the groups that tests stand in.
    pub(crate) levels: Option<GroupColumns>,
    /// The columns of crossed factors.
    pub(crate) crossed: Option<GroupColumns>,
    /// The text column that tells the phase of a row.
    pub(crate) phase: Option<usize>,
    phase_key: Option<Span>,
    start: FirstStep,
    previous_inputs: Option<Span>,
    span: Span,
}

/// What was said of the first step.
#[derive(Debug, Default)]
pub(crate) struct FirstStep {
    initial_time: Option<Span>,
    step_first: Option<Span>,
    /// Any of it, as it was written.
    said: Option<(&'static str, Span)>,
}

/// Reads `[data]`; without it all rows are one test.
/// `slotted`: factors of several levels in one test, which are no columns.
pub(crate) fn read(
    context: &mut NameContext<'_>,
    field: Option<TomlField<'_>>,
    slotted: &[(&str, Span)],
) -> Result<DataSpec> {
    let Some(field) = field else {
        let mut data = DataSpec::default();
        data.factors(context, None, slotted)?;
        return Ok(data);
    };
    let mut section = field.section(PLACE)?.with_keys(keys::DATA)?;
    let mut data = DataSpec { span: section.span.clone(), ..DataSpec::default() };
    if let Some(test) = section.take("test") {
        data.layout.test = test_key(context, &test)?;
    }
    let (levels, crossed) = (section.take("levels"), section.take("crossed"));
    // a reader that needs no columns of levels still meets the keys that go with them
    context.grouped = levels.is_some();
    if let Some(levels) = levels.filter(|_| context.reads.levels) {
        let columns = levels::columns(context, (&levels, GroupKind::Levels), &data.layout.test, &[])?;
        data.layout.levels = columns.names().map(str::to_owned).collect();
        data.levels = Some(columns);
    }
    data.factors(context, crossed.as_ref(), slotted)?;
    if let Some(missing) = section.take("missing") {
        data.layout.missing = missing.texts()?.into_iter().map(|(text, _)| text.to_owned()).collect();
    }
    if let Some(comment) = section.take("comment") {
        data.layout.comment = Some(comment_mark(&comment)?);
    }
    if let Some(group) = section.take("group").filter(|_| context.reads.measurements) {
        data.group = Some(context.text_column(group.text()?, group.span.clone(), "`group` in `[data]`"));
    }
    if let Some(phase) = section.take("phase") {
        data.phase = Some(context.text_column(phase.text()?, phase.span.clone(), "`phase` in `[data]`"));
        data.phase_key = Some(phase.key_span);
    }
    read_clock(context, &mut section, &mut data)?;
    section.finish("here", None)?;
    Ok(data)
}

fn test_key(context: &mut NameContext<'_>, field: &TomlField<'_>) -> Result<TestKey> {
    let text = field.text()?;
    if text == "@file" {
        return Ok(TestKey::File);
    }
    if text == "@row" {
        return Ok(TestKey::Row);
    }
    if text.starts_with('@') {
        let problem = SpecProblem::UnknownWord {
            what: "test".to_owned(),
            place: PLACE.to_owned(),
            found: text.to_owned(),
            expected: "`@file`, `@row` or the name of a column".to_owned(),
        };
        return Err(SpecError::new(problem).at(field.span.clone()).maybe_hint(suggest(text, ["@file", "@row"])));
    }
    context.see_column(text, field.span.clone());
    Ok(TestKey::Column(text.to_owned()))
}

/// What lines of comments begin with.
fn comment_mark(field: &TomlField<'_>) -> Result<String> {
    const LONGEST: usize = 20;
    let text = field.text()?;
    let begins_a_row = |c: char| c.is_control() || c.is_whitespace() || c.is_alphanumeric() || "\",;+-.".contains(c);
    if text.len() > LONGEST || text.chars().next().is_none_or(begins_a_row) || text.contains(char::is_control) {
        let problem = SpecProblem::UnknownWord {
            what: "comment".to_owned(),
            place: PLACE.to_owned(),
            found: text.to_owned(),
            expected: "a mark that no row begins with, such as `#` or `//`".to_owned(),
        };
        return Err(SpecError::new(problem).at(field.span.clone()));
    }
    Ok(text.to_owned())
}

fn read_clock(context: &mut NameContext<'_>, section: &mut TomlTable<'_>, data: &mut DataSpec) -> Result<()> {
    let clock = &mut data.clock;
    if let Some(time) = section.take("time") {
        clock.time = Some(context.column(time.text()?, time.span.clone(), "`time` in `[data]`"));
    }
    context.time = clock.time.is_some();
    if let Some(unit) = section.take("time_unit") {
        if clock.time.is_none() {
            return Err(without_time(&unit));
        }
        clock.unit = Some(unit.text()?.to_owned());
    }
    data.start = start(context, &mut |key| section.take(key), clock)?;
    if let Some(inputs) = section.take("inputs") {
        clock.previous_inputs = inputs.word(&["previous", "current"])? == 0;
        data.previous_inputs = clock.previous_inputs.then_some(inputs.key_span);
    }
    Ok(())
}

/// Reads where x_0 is.
fn start<'d>(
    context: &mut NameContext<'_>,
    take: &mut dyn FnMut(&str) -> Option<TomlField<'d>>,
    clock: &mut Clock,
) -> Result<FirstStep> {
    let mut start = FirstStep::default();
    if let Some(initial) = take("initial_time") {
        if clock.time.is_none() {
            return Err(without_time(&initial));
        }
        clock.initial_time = Some(initial_time(context, &initial)?);
        start.said = Some(("initial_time", initial.key_span.clone()));
        start.initial_time = Some(initial.key_span);
    }
    if let Some(first) = take("step_first") {
        clock.step_first = first.truth()?;
        if clock.step_first && clock.initial_time.is_some() {
            return Err(first
                .no_effect("beside `initial_time`")
                .hint("with `initial_time` a step from x_0 precedes the first row anyway"));
        }
        start.said = Some(("step_first", first.key_span.clone()));
        start.step_first = clock.step_first.then_some(first.key_span);
    }
    Ok(start)
}

fn without_time(field: &TomlField<'_>) -> SpecError {
    field.no_effect("without `time`").hint("`time` names the column with the time of each row")
}

fn initial_time(context: &mut NameContext<'_>, field: &TomlField<'_>) -> Result<Expression> {
    let expected = "a number or the name of a column";
    let Some(text) = field.as_text() else { return Ok(Expression::Number(field.number_or(expected)?)) };
    if text.trim().parse::<f64>().is_ok() {
        return Err(field.wrong_type(expected).hint(format!("write the number without quotes: {}", text.trim())));
    }
    let place = format!("`initial_time` in {}", field.place);
    let column = context.column(text, field.span.clone(), &place);
    Ok(Expression::Column(column))
}

impl DataSpec {
    /// The crossed factors: those that are columns, and those with slots.
    fn factors(
        &mut self,
        context: &mut NameContext<'_>,
        listed: Option<&TomlField<'_>>,
        slotted: &[(&str, Span)],
    ) -> Result<()> {
        if listed.is_none() && slotted.is_empty() {
            return Ok(());
        }
        context.grouped = true;
        if self.layout.test == TestKey::Single {
            self.layout.test = TestKey::Row; // one test cannot meet several levels of a factor
        }
        if !context.reads.levels {
            return Ok(());
        }
        let columns = |field| levels::columns(context, (field, GroupKind::Crossed), &self.layout.test, slotted);
        let all = GroupColumns::with_slotted(listed.map(columns).transpose()?, slotted);
        if let Some(all) = &all {
            all.refuse_shared(self.levels.as_ref())?;
            self.layout.crossed = all.columns().map(str::to_owned).collect();
        }
        self.crossed = all;
        Ok(())
    }

    /// The clock of a phase: a phase of the file says itself where its x_0 is.
    pub(crate) fn clock(
        &mut self,
        context: &mut NameContext<'_>,
        source: &PhaseSource<'_>,
    ) -> Result<(Clock, FirstStep)> {
        if source.span.is_none() {
            return Ok((self.clock.clone(), std::mem::take(&mut self.start)));
        }
        let mut clock = self.clock.clone();
        let start = start(context, &mut |key| source.own(key), &mut clock)?;
        Ok((clock, start))
    }

    /// Refuses a column of phases without phases, several phases without one, a first step that belongs to phases, and what does
    /// not go with groups of tests.
    pub(crate) fn check_phases(&self, phases: &[PhaseSource<'_>]) -> Result<()> {
        self.levels.iter().chain(&self.crossed).try_for_each(|columns| columns.refuse_beside(phases))?;
        let second = phases.get(1).and_then(|phase| phase.span.clone());
        if let (None, Some(second)) = (self.phase, second) {
            let problem = SpecProblem::MissingKey { key: "phase".to_owned(), place: PLACE.to_owned() };
            let span = if self.span.is_empty() { second } else { self.span.clone() };
            return Err(SpecError::new(problem)
                .at(span)
                .hint("with several phases, `phase` names the column that holds the phase of each row"));
        }
        match (phases[0].span.is_some(), &self.phase_key, &self.start.said) {
            (false, Some(span), _) => Err(idle("phase", "without `[phases]`", span)),
            (true, _, Some((key, span))) => {
                let hint = format!("write `{key}` in `[phases.NAME]`: each phase has its own x_0");
                Err(idle(key, "beside `[phases]`", span).hint(hint))
            }
            _ => Ok(()),
        }
    }

    /// Refuses what has no effect on these phases, and steps of unknown length.
    pub(crate) fn check<'m>(&self, phases: impl Iterator<Item = (&'m Model, &'m FirstStep)> + Clone) -> Result<()> {
        for (model, start) in phases.clone() {
            start.check(model)?;
        }
        match &self.previous_inputs {
            Some(span) if !phases.clone().any(|(model, _)| moves_with_rows(model)) => {
                Err(idle("inputs", "when no motion uses a column", span))
            }
            _ => Ok(()),
        }
    }
}

impl FirstStep {
    fn check(&self, model: &Model) -> Result<()> {
        let moves = model.states.iter().any(|state| state.motion != Motion::Constant);
        let uses_step = uses(model, &mut |part| matches!(part, Expression::Step));
        if let Some(span) = &self.step_first {
            if !moves {
                return Err(idle("step_first", "when no state moves", span));
            }
            let needs_length = model.states.iter().find(|state| needs_length(&state.motion));
            if let Some(state) = needs_length {
                let what = format!("the motion of state `{}`", state.name);
                return Err(SpecError::new(SpecProblem::FirstStepWithoutLength { what })
                    .at(span.clone())
                    .hint("`initial_time` says when the first step begins"));
            }
        }
        match &self.initial_time {
            Some(span) if !moves && !uses_step => Err(idle("initial_time", "when no state moves", span)),
            _ => Ok(()),
        }
    }
}

/// A motion depends on the row.
fn moves_with_rows(model: &Model) -> bool {
    let mut from_row = |part: &Expression| match part {
        Expression::Column(_) | Expression::TextEquals { .. } => true,
        Expression::Parameter(index) => model.parameters[*index].per.is_some(),
        _ => false,
    };
    let mut motion = model.expressions().into_iter().filter(|(site, _)| site.is_of_motion());
    motion.any(|(_, expression)| expression.any(&mut from_row))
}

fn idle(key: &str, why: &str, span: &Span) -> SpecError {
    SpecError::new(SpecProblem::NoEffect { key: key.to_owned(), why: why.to_owned() }).at(span.clone())
}

fn needs_length(motion: &Motion) -> bool {
    match motion {
        Motion::Constant => false,
        Motion::Continuous { .. } => true,
        Motion::Discrete { next, noise_variance } => {
            let mut all = next.expressions().chain([noise_variance]);
            all.any(|expression| expression.any(&mut |part| matches!(part, Expression::Step)))
        }
    }
}

/// True when `test` holds for a part of a motion, a measurement or a noise: of what a filter is made of.
pub(crate) fn uses(model: &Model, test: &mut dyn FnMut(&Expression) -> bool) -> bool {
    let mut all = model.expressions().into_iter().filter(|(site, _)| site.is_of_filter());
    all.any(|(_, expression)| expression.any(test))
}
