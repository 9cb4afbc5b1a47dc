//! One phase: from its tables to its model.

use kalfit::Model;
use kalfit::model::{Clock, CovarianceStructure, MeanStructure, Measurement, Parameter, Phase, State};
use kalfit::predict::Output;

use crate::carry::{InheritedStates, PhaseBefore};
use crate::data::{DataSpec, FirstStep};
use crate::elements::NamedElements;
use crate::error::{Result, SpecError};
use crate::names::{NameContext, NameIndex, OptionalTables};
use crate::noise::CovarianceEntries;
use crate::phases::PhaseSource;
use crate::places::PhasePlaces;
use crate::table::{TomlField, TomlTable};
use crate::{carry, covariance, filter, mean, measurements, noise, outputs, states};

/// What a model is read for.
#[derive(Clone, Copy)]
pub(crate) enum ReadPurpose<'a, 'd> {
    /// Tests that were made.
    Tests,
    /// Designs of tests: measurements, filters and groups of reports are passed over.
    Designs {
        /// The outputs, in a table by name.
        outputs: Option<&'a TomlTable<'d>>,
        /// Levels of groups are read too.
        levels: bool,
    },
}

impl ReadPurpose<'_, '_> {
    pub(crate) fn reads(self) -> OptionalTables {
        match self {
            ReadPurpose::Tests => OptionalTables { measurements: true, levels: true },
            ReadPurpose::Designs { levels, .. } => OptionalTables { measurements: false, levels },
        }
    }
}

/// One phase as it was read.
pub(crate) struct ReadPhase<'s> {
    pub(crate) source: &'s PhaseSource<'s>,
    label: Option<usize>,
    /// Names and places of the states.
    pub(crate) named: NameIndex,
    pub(crate) states: Vec<State>,
    process_noise_covariance: CovarianceEntries,
    pub(crate) measurements: Vec<Measurement>,
    /// Names and places of the measurements.
    pub(crate) measured: NameIndex,
    noise_covariance: CovarianceEntries,
    clock: Clock,
    pub(crate) start: FirstStep,
    pub(crate) inherited: InheritedStates,
    /// The estimated states in the order of μ and Σ.
    pub(crate) estimated: Vec<usize>,
    mean: MeanStructure,
    covariance: CovarianceStructure,
    pub(crate) filter: Option<filter::DeclaredFilter>,
    /// What stands for the measurements in designs.
    pub(crate) outputs: Vec<Output>,
}

/// What all phases have in common, beside what their expressions named.
pub(crate) struct SharedTables {
    pub(crate) title: String,
    pub(crate) parameters: Vec<Parameter>,
    pub(crate) group: Option<usize>,
}

/// Reads the tables of one phase.
pub(crate) fn phase<'s>(
    context: &mut NameContext<'_>,
    data: &mut DataSpec,
    source: &'s PhaseSource<'s>,
    before: Option<&mut ReadPhase<'_>>,
    purpose: ReadPurpose<'_, '_>,
) -> Result<ReadPhase<'s>> {
    context.phase = source.within();
    context.states = NameIndex::default();
    let label = data.phase.map(|_| context.literals.add(source.name));
    let (clock, start) = data.clock(context, source)?;
    let mut states = source.read("states", |field| {
        let named = states::declare(context, field.as_ref())?;
        states::lower(context, named)
    })?;
    let inherited = inherited(context, source, &mut states, before)?;
    let process_noise_covariance =
        source.read("process_noise_covariance", |field| noise::between_states(context, field, &states))?;
    let ObservedStates { measurements, measured, noise_covariance, filter, outputs } = match purpose {
        ReadPurpose::Tests => observed(context, source, &states)?,
        ReadPurpose::Designs { outputs, .. } => {
            let outputs = outputs.map(|outputs| outputs::outputs(context, outputs, source)).transpose()?;
            ObservedStates { outputs: outputs.unwrap_or_default(), ..ObservedStates::default() }
        }
    };
    let (estimated, mean, covariance) = population(context, source, &states)?;
    let named = std::mem::take(&mut context.states);
    Ok(ReadPhase {
        source,
        label,
        named,
        states,
        process_noise_covariance,
        measurements,
        measured,
        noise_covariance,
        clock,
        start,
        inherited,
        estimated,
        mean,
        covariance,
        filter,
        outputs,
    })
}

/// What is observed of the states of a phase.
#[derive(Default)]
struct ObservedStates {
    measurements: Vec<Measurement>,
    measured: NameIndex,
    noise_covariance: CovarianceEntries,
    filter: Option<filter::DeclaredFilter>,
    outputs: Vec<Output>,
}

fn observed(context: &mut NameContext<'_>, source: &PhaseSource<'_>, states: &[State]) -> Result<ObservedStates> {
    let (measurements, measured) = source.read("measurements", |field| measurements::read(context, field.as_ref()))?;
    let noise_covariance = source
        .read("noise_covariance", |field| noise::between_measurements(context, field, &measurements, &measured))?;
    let filter = source.read("filter", |field| field.map(|field| filter::read(context, &field, states)).transpose())?;
    Ok(ObservedStates { measurements, measured, noise_covariance, filter, outputs: Vec::new() })
}

fn inherited(
    context: &mut NameContext<'_>,
    source: &PhaseSource<'_>,
    states: &mut [State],
    before: Option<&mut ReadPhase<'_>>,
) -> Result<InheritedStates> {
    let (Some(field), Some(before)) = (source.own("carry"), before) else { return Ok(InheritedStates::default()) };
    let before = PhaseBefore { name: before.source.name, index: &mut before.named, states: &before.states };
    carry::read(context, &field, states, before)
}

type PopulationStructure = (Vec<usize>, MeanStructure, CovarianceStructure);

/// The order of the estimated states, and the structures of their mean and covariance.
fn population(
    context: &mut NameContext<'_>,
    source: &PhaseSource<'_>,
    states: &[State],
) -> Result<PopulationStructure> {
    let field = source.table("covariance");
    let (section, estimated) = source.read("covariance", |_| covariance::open(context, field.as_ref(), states))?;
    let elements = NamedElements::new(states, &estimated);
    let mean = source.read("mean", |field| mean::read(context, field.as_ref(), &estimated, &elements))?;
    let covariance = source.read("covariance", |_| covariance::read(context, section, &elements))?;
    Ok((estimated, mean, covariance))
}

impl PhaseSource<'_> {
    /// Reads one of its tables.
    fn read<T>(&self, key: &str, read: impl FnOnce(Option<TomlField<'_>>) -> Result<T>) -> Result<T> {
        read(self.table(key)).map_err(|error: SpecError| self.explain(key, error))
    }
}

impl ReadPhase<'_> {
    /// Its model, with all that phases have in common.
    pub(crate) fn model(&self, context: &NameContext<'_>, shared: &SharedTables) -> Model {
        Model {
            title: shared.title.clone(),
            columns: context.columns.clone(),
            text_columns: context.text_columns.clone(),
            literals: context.literals.texts.clone(),
            parameters: shared.parameters.clone(),
            states: self.states.clone(),
            process_noise_covariance: self.process_noise_covariance.clone(),
            measurements: self.measurements.clone(),
            noise_covariance: self.noise_covariance.clone(),
            clock: self.clock.clone(),
            group: shared.group,
            estimated: self.estimated.clone(),
            mean: self.mean.clone(),
            covariance: self.covariance.clone(),
        }
    }

    /// Where its things stand.
    pub(crate) fn places(&self) -> PhasePlaces {
        PhasePlaces {
            name: self.source.name.to_owned(),
            key: self.source.span.clone(),
            states: self.named.spans(),
            measurements: self.measured.spans(),
            carry: self.inherited.spans.clone(),
            filter: self.filter.as_ref().map(|filter| filter.span.clone()),
        }
    }

    /// The phase of this model.
    pub(crate) fn finish(&self, model: Model) -> Phase {
        Phase {
            name: self.source.name.to_owned(),
            label: self.label,
            model,
            carry: self.inherited.carry.clone(),
            filter: self.filter.as_ref().map(|declared| declared.filter.clone()),
        }
    }
}
