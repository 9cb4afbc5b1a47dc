//! `kalfit check`: everything but the fit.

use std::sync::Arc;

use kalfit::estimate::Structure;
use kalfit::model::{GroupLevel, Phase, Slots, Value};
use kalfit::record::{
    DataRecord, InformationRecord, LevelCounts, ObservabilityRecord, UnidentifiedRecord, WeakRecord, crossing_notes,
    factor_notes, level_notes, shortage_notes,
};
use kalfit::reduce::grouping;
use kalfit::{Evidence, Grouping, Model, PhasedModel, PhasedTest, Reductions, infer};
use kalfit_data::DataReading;
use kalfit_report::{CheckFindings, CheckRecord, CheckedLevel, CheckedPhase, ParameterCounts, PhaseCounts};
use kalfit_spec::Spec;

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{CheckJob, JobDone, files};
use crate::offset::Multipliers;
use crate::output::OutputFile;
use crate::survey::DataSurvey;
use crate::work::{JobWatch, JobWork};
use crate::{dynamic, memory, model, reductions, simultaneous, tests};

/// Reads all and fits nothing.
///
/// # Errors
/// Bad input.
pub fn check(job: &CheckJob, watch: &mut dyn JobWatch) -> Result<JobDone<CheckRecord>, Failure> {
    let mut work = JobWork::new(watch);
    let mut spec = model::load(&job.model, &job.data)?;
    if !job.data.is_empty() {
        memory::suffices(&spec)?;
    }
    let given = if job.data.is_empty() { None } else { Some(CommandInputs::open(&mut spec, &job.data)?) };
    let inputs = given.as_ref().map_or(&[][..], |given| &given.inputs);
    let output = OutputFile::results(job.out.as_deref(), &files(&[&job.model.document], inputs))?;
    let free = model::has_free(spec.model.shared());
    let (parameters, checked) = match (&given, free) {
        (None, _) => (Vec::new(), CheckFindings::Model),
        (Some(given), false) if spec.model.levels.is_empty() => (Vec::new(), known(&spec, given, &mut work)?),
        (Some(given), _) => started(&spec, given, &mut work)?,
    };
    let record = CheckRecord::new(spec.model.shared().title.clone(), spec.describe(), parameters, checked);
    let mut notes = spec.questions();
    notes.extend(given.into_iter().flat_map(|given| given.notes));
    JobDone::in_json(record, notes, output.as_ref())
}

/// Reads the data and runs the filters: all parameters are known.
fn known(spec: &Spec, given: &CommandInputs, work: &mut JobWork<'_>) -> Result<CheckFindings, Failure> {
    let alpha = model::alpha(spec);
    let nothing = || (no_counts(&spec.model), Multipliers::of(&spec.model), DataSurvey::of(&spec.model));
    let (mut counts, mut multipliers, mut survey) = nothing();
    let reductions = reductions::reduce(spec, &alpha, given, work, &mut |test| match test {
        Some(test) => {
            add(&mut counts, test);
            multipliers.add(test);
            survey.add(test);
        }
        None => (counts, multipliers, survey) = nothing(),
    })?;
    let found =
        infer::examine_at_start(&reductions, &Structure::of(&spec.model, &alpha, None)).map_err(Failure::Fit)?;
    let said = ([survey.notes(), multipliers.notes()].concat(), Vec::new());
    Ok(examined((&spec.model, counts), &found, (&reductions, None), given.names(), said))
}

fn no_counts(model: &PhasedModel) -> Vec<PhaseCounts> {
    let none = |name: &String| PhaseCounts { name: name.clone(), tests: 0, rows: 0, without_rows: 0 };
    model.phases.iter().map(|phase| none(&phase.name)).collect()
}

fn add(counts: &mut [PhaseCounts], test: &PhasedTest) {
    for (count, evidence) in counts.iter_mut().zip(&test.phases) {
        count.tests += 1;
        match evidence {
            Evidence::Rows(rows) => count.rows += rows.rows(),
            Evidence::Estimates(_) | Evidence::Reduced(_) => count.without_rows += 1,
        }
    }
}

/// Reads the data, counts the free values that they have use for, and runs the filters where a fit would begin.
fn started(
    spec: &Spec,
    given: &CommandInputs,
    work: &mut JobWork<'_>,
) -> Result<(Vec<ParameterCounts>, CheckFindings), Failure> {
    let model = spec.model.shared();
    let (tests, reading) = tests::read_with_spans(spec, given, work)?;
    let mut phases = no_counts(&spec.model);
    tests.iter().for_each(|test| add(&mut phases, test));
    let slots = Slots::in_phases(&spec.model, &reading.labels, &tests);
    let counts = LevelCounts::all(model, &reading.labels, &tests);
    let mut notes = DataSurvey::among(&spec.model, &tests).notes();
    notes.extend(level_notes(model, &counts));
    notes.extend(Multipliers::among(&spec.model, &tests).notes());
    notes.extend(simultaneous::note(&tests, &reading.spans));
    let mut parameters = parameters(model, &slots, &counts);
    let starts = starts((&spec.model, &slots), &tests, &reading)?;
    for (slot, &start) in slots.slots().iter().zip(&starts) {
        let name = &model.parameters[slot.parameter].name;
        let own = parameters.iter_mut().find(|counts| counts.name == *name && counts.start.is_none());
        own.into_iter().for_each(|counts| counts.found.push(start));
    }
    let alpha = slots.alpha(model, &starts);
    let reductions = reductions::of(&spec.model, &alpha, &tests, &reading)?;
    let at_start_of = parameters.iter().filter(|p| p.free > 0).map(|p| p.name.clone()).collect();
    let said = (notes, at_start_of);
    let grouping = grouping(&spec.model, &tests).map_err(|error| dynamic::failure(error.into(), &reading))?;
    let grouping = grouping.map(Arc::new);
    let structure = Structure::of(&spec.model, &alpha, grouping.as_ref());
    let found = kalfit::dynamic::examine_with_parameters(
        (&spec.model, &tests),
        (&slots, &starts),
        (&reductions, &structure),
        work,
    );
    work.go_on()?;
    let found = found.map_err(|error| dynamic::failure(error, &reading))?;
    let checked = examined((&spec.model, phases), &found, (&reductions, grouping.as_ref()), given.names(), said);
    Ok((parameters, checked))
}

/// The start values that are given, and a first guess from the data where one is not.
fn starts(
    (model, slots): (&PhasedModel, &Slots),
    tests: &[PhasedTest],
    reading: &DataReading,
) -> Result<Vec<f64>, Failure> {
    let given = |slot: &kalfit::model::Slot| match model.shared().parameters[slot.parameter].value {
        Value::Free { start } => start,
        Value::Fixed(value) => Some(value),
    };
    if let Some(starts) = slots.slots().iter().map(given).collect() {
        return Ok(starts);
    }
    let settings = kalfit::dynamic::Settings::default();
    let found = kalfit::dynamic::start_values(model, &reading.labels, tests, &settings);
    found.map_err(|error| dynamic::failure(error, reading))
}

/// The record of an examination of the reductions.
fn examined(
    (model, counts): (&PhasedModel, Vec<PhaseCounts>),
    found: &infer::Examination,
    (reductions, grouping): (&Reductions, Option<&Arc<Grouping>>),
    files: Vec<String>,
    (mut notes, at_start_of): (Vec<String>, Vec<String>),
) -> CheckFindings {
    let infer::Examination { unidentified, explanations, observability, phases } = found;
    let mut said = crossing_notes(model, unidentified, explanations, observability);
    said.extend(shortage_notes(model, observability));
    said.extend(grouping.map_or(Vec::new(), |grouping| factor_notes(model, grouping, reductions)));
    notes.splice(0..0, said);
    let mut seen = ObservabilityRecord::by_phase(model, observability).into_iter();
    let mut blind = UnidentifiedRecord::by_phase(model, unidentified, explanations).into_iter();
    let mut weak = WeakRecord::by_phase(model, observability).into_iter();
    let mut information = InformationRecord::by_phase(model, phases).into_iter();
    let phase = |(counts, phase): (PhaseCounts, &Phase)| CheckedPhase {
        counts,
        states: phase.model.estimated_names(),
        observability: seen.next().unwrap_or_default(),
        unidentified: blind.next().unwrap_or_default(),
        weak: weak.next().unwrap_or_default(),
        information: information.next().flatten(),
    };
    let phases = counts.into_iter().zip(&model.phases).map(phase).collect();
    let levels = grouping.map_or(Vec::new(), |grouping| levels(model, grouping, blind));
    CheckFindings::Reduced { data: DataRecord::of(reductions, files), phases, levels, notes, at_start_of }
}

/// The crossed factors, then the levels, the outermost first. `blind` gives what is not identified of each, the innermost first.
fn levels(
    model: &PhasedModel,
    grouping: &Grouping,
    mut blind: impl Iterator<Item = Vec<UnidentifiedRecord>>,
) -> Vec<CheckedLevel> {
    let states = model.phases[0].model.estimated_names();
    let inner = |level: usize| match level {
        _ if level >= grouping.nested() => {
            (0..grouping.tests()).flat_map(|test| grouping.groups_of(test, level)).collect::<Vec<_>>()
        }
        0 => (0..grouping.tests()).map(|test| grouping.group_of(test, 0)).collect::<Vec<_>>(),
        _ => grouping.groups(level - 1).iter().filter_map(|group| group.parent).collect(),
    };
    let one = |(level, named): (usize, &GroupLevel)| {
        let mut members = vec![0; grouping.groups(level).len()];
        inner(level).into_iter().for_each(|group| members[group] += 1);
        CheckedLevel {
            name: named.name.clone(),
            crossed: named.crossed,
            groups: members.len(),
            members: level
                .checked_sub(1)
                .filter(|_| !named.crossed)
                .and_then(|inner| model.levels.iter().nth_back(inner))
                .map_or("test".to_owned(), |of| of.name.clone()),
            members_each: (members.iter().copied().min().unwrap_or(0), members.iter().copied().max().unwrap_or(0)),
            states: named.effect_names(&states),
            unidentified: blind.next().unwrap_or_default(),
        }
    };
    let mut levels: Vec<CheckedLevel> = model.levels.iter().rev().enumerate().map(one).collect();
    levels.reverse();
    levels
}

/// The parameters that have free values, or would have with other data.
fn parameters(model: &Model, slots: &Slots, counts: &[LevelCounts]) -> Vec<ParameterCounts> {
    let of = |(index, parameter): (usize, &kalfit::model::Parameter)| {
        let Value::Free { start } = parameter.value else { return None };
        let levels = counts.iter().find(|c| c.parameter == index).map_or(Vec::new(), |c| c.tests.clone());
        let free = slots.slots().iter().filter(|slot| slot.parameter == index).count();
        Some(ParameterCounts {
            name: parameter.name.clone(),
            per: parameter.per.map(|column| model.text_columns[column].name.clone()),
            free,
            fixed: levels.len().saturating_sub(free),
            start,
            found: Vec::new(),
            levels,
        })
    };
    model.parameters.iter().enumerate().filter_map(of).collect()
}
