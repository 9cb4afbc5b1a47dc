//! From the text of a model file to the model.

use kalfit::model::roles;
use kalfit::predict::Output;
use kalfit::{Layout, Model, PhasedModel};
use toml::de::DeTable;

use crate::error::{Result, SpecError, SpecProblem};
use crate::keys;
use crate::levels::GroupKind;
use crate::names::NameContext;
use crate::phase::{ReadPhase, ReadPurpose, SharedTables, phase};
use crate::phases::PhaseSource;
use crate::places::SpecPlaces;
use crate::spec::Spec;
use crate::table::TomlTable;
use crate::{data, digest, filter, levels, outputs, parameters, phases};

/// Largest model file, in bytes.
pub(crate) const MAX_BYTES: u64 = 4 * 1024 * 1024;
/// Columns, texts and levels of a model, times its phases.
const MAX_SHARED: usize = 1_000_000;

/// What the tables of a model file say.
pub(crate) struct BuiltSpec {
    pub(crate) model: PhasedModel,
    pub(crate) layout: Layout,
    pub(crate) places: SpecPlaces,
    /// Those of each phase, where it was read for designs.
    pub(crate) outputs: Vec<Vec<Output>>,
}

/// Reads a whole model file.
pub(crate) fn spec(name: &str, text: &str) -> Result<Spec> {
    let found = text.len() as u64;
    if found > MAX_BYTES {
        return Err(SpecError::new(SpecProblem::TooLarge { found, limit: MAX_BYTES }));
    }
    let table = DeTable::parse(text).map_err(|error| not_toml(&error, text))?;
    let root = TomlTable::open("the model file", table.span(), table.get_ref()).with_keys(keys::ROOT)?;
    let BuiltSpec { model, layout, places, .. } = model(text, root, ReadPurpose::Tests)?;
    Ok(Spec { model, layout, digest: digest::of_text(text), name: name.to_owned(), text: text.to_owned(), places })
}

/// Reads what the tables of a model file say.
pub(crate) fn model(text: &str, mut root: TomlTable<'_>, purpose: ReadPurpose<'_, '_>) -> Result<BuiltSpec> {
    let title = root.take("title").map_or(Ok(""), |title| title.text())?.to_owned();
    let mut context = NameContext::new(text);
    context.reads = purpose.reads();
    let slotted = levels::slotted(root.peek("crossed").as_ref());
    let mut data = data::read(&mut context, root.take("data"), &slotted)?;
    let declared = parameters::read(&mut context, root.take("parameters"))?;
    let sources = phases::open(&mut root)?;
    data.check_phases(&sources)?;
    let mut read: Vec<ReadPhase<'_>> = Vec::with_capacity(sources.len());
    for source in &sources {
        let one = phase(&mut context, &mut data, source, read.last_mut(), purpose)?;
        read.push(one);
        source.count("states of all phases together", read.iter().map(|phase| phase.states.len()).sum())?;
        source.count("measurements of all phases together", read.iter().map(|one| one.measurements.len()).sum())?;
    }
    let population = (read[0].states.as_slice(), read[0].estimated.as_slice());
    let mut levels = Vec::new();
    if context.reads.levels {
        // the factors come first
        let kinds = [(data.crossed.as_ref(), GroupKind::Crossed), (data.levels.as_ref(), GroupKind::Levels)];
        for of in kinds {
            levels.extend(levels::read(&mut context, of, root.take(of.1.key()), population)?);
        }
    }
    if let ReadPurpose::Designs { outputs: Some(outputs), .. } = purpose {
        outputs::check(outputs, &sources, &read.iter().map(|phase| &phase.named).collect::<Vec<_>>())?;
    }
    check_shared(&context, &declared, &sources)?;
    let as_given = declared.iter().map(|one| one.parameter.clone()).collect();
    let shared = SharedTables { title, parameters: as_given, group: data.group };
    let models: Vec<Model> = read.iter().map(|phase| phase.model(&context, &shared)).collect();
    let phases = read.iter().zip(models).map(|(phase, model)| phase.finish(model)).collect();
    let mut model = PhasedModel { phases, column: data.phase, levels };
    let parameters = parameters::finish(&mut context, declared, &roles(&model))?;
    model.models_mut().for_each(|phase| phase.parameters.clone_from(&parameters));
    if context.reads.measurements {
        data.check(model.phases.iter().map(|phase| &phase.model).zip(read.iter().map(|phase| &phase.start)))?;
        check_filters(&context, &read, &model)?;
    }
    let places =
        SpecPlaces::of(&context, read.iter().map(ReadPhase::places).collect(), data.levels.iter().chain(&data.crossed));
    let outputs = read.into_iter().map(|phase| phase.outputs).collect();
    Ok(BuiltSpec { model, layout: data.layout, places, outputs })
}

/// Columns, texts and levels stand in every phase's model: refuses files of which that makes too much.
fn check_shared(
    context: &NameContext<'_>,
    declared: &[parameters::DeclaredParameter],
    sources: &[PhaseSource<'_>],
) -> Result<()> {
    let levels: usize = declared.iter().map(|one| one.parameter.fixed_levels.len()).sum();
    let names = context.columns.len() + context.text_columns.len() + context.literals.texts.len() + levels;
    let found = names * sources.len();
    match &sources[0].span {
        Some(span) if sources.len() > 1 && found > MAX_SHARED => {
            let (what, expected) = ("columns and texts (each counted in every phase)", format!("at most {MAX_SHARED}"));
            Err(SpecError::new(SpecProblem::Count { what, found, expected }).at(span.clone()))
        }
        _ => Ok(()),
    }
}

/// Filters can be checked when all uses of parameters are known; one table may serve several phases.
fn check_filters(context: &NameContext<'_>, read: &[ReadPhase<'_>], model: &PhasedModel) -> Result<()> {
    let models = || model.phases.iter().map(|phase| &phase.model);
    let used: Vec<Vec<bool>> = models().map(filter::used).collect();
    for (phase, (model, own)) in read.iter().zip(models().zip(&used)) {
        let Some(filter) = &phase.filter else { continue };
        let mut served = vec![false; model.parameters.len()];
        let same = |other: &ReadPhase<'_>| other.filter.as_ref().is_some_and(|other| other.span == filter.span);
        for (_, used) in read.iter().zip(&used).filter(|(other, _)| same(other)) {
            served.iter_mut().zip(used).for_each(|(served, used)| *served |= used);
        }
        filter.check(context, model, own, &served).map_err(|error| phase.source.explain("filter", error))?;
    }
    Ok(())
}

pub(crate) fn not_toml(error: &toml::de::Error, text: &str) -> SpecError {
    let what = error.message().lines().next().unwrap_or_default().trim_end_matches('.').to_owned();
    let wrong = SpecError::new(SpecProblem::Toml { what });
    match error.span() {
        Some(span) => wrong.at(span.start.min(text.len())..span.end.min(text.len())),
        None => wrong,
    }
}
