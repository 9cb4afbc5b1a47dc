//! Places in the model file that messages about data and results point to.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::Spec;
use crate::error::Span;
use crate::names::{Context, Role};
use crate::phase::Read;

/// Where things stand in the file, and what parameters are used as.
#[derive(Debug, Clone, Default)]
pub(crate) struct Places {
    pub(crate) columns: BTreeMap<String, Span>,
    parameters: BTreeMap<String, Span>,
    phases: Vec<PhasePlaces>,
    pub(crate) roles: Vec<Role>,
}

#[derive(Debug, Clone)]
struct PhasePlaces {
    name: String,
    key: Option<Span>,
    states: BTreeMap<String, Span>,
    measurements: BTreeMap<String, Span>,
    carry: BTreeMap<String, Span>,
    filter: Option<Span>,
}

impl Places {
    pub(crate) fn of(context: &Context<'_>, read: &[Read<'_>]) -> Places {
        let phase = |phase: &Read<'_>| PhasePlaces {
            name: phase.source.name.to_owned(),
            key: phase.source.span.clone(),
            states: phase.named.spans(),
            measurements: phase.measured.spans(),
            carry: phase.inherited.spans.clone(),
            filter: phase.filter.as_ref().map(|filter| filter.span.clone()),
        };
        Places {
            columns: context.column_spans.clone(),
            parameters: context.parameters.spans(),
            phases: read.iter().map(phase).collect(),
            roles: context.roles.iter().map(|role| role.unwrap_or(Role::Coefficient)).collect(),
        }
    }

    fn phase(&self, name: &str) -> Option<&PhasePlaces> {
        self.phases.iter().find(|phase| phase.name == name)
    }
}

impl Spec {
    /// Bytes of the file where a column of the data is used first; `None` when the model does not use it.
    pub fn column_span(&self, column: &str) -> Option<Range<usize>> {
        self.places.columns.get(column).cloned()
    }

    /// Bytes of the file where a parameter is declared.
    pub fn parameter_span(&self, parameter: &str) -> Option<Range<usize>> {
        self.places.parameters.get(parameter).cloned()
    }

    /// Bytes of the file where a state is declared, in the first phase that has it; of its owner for a hidden state.
    pub fn state_span(&self, state: &str) -> Option<Range<usize>> {
        self.places.phases.iter().find_map(|phase| phase.states.get(state).cloned())
    }

    /// Bytes of the file where a measurement is declared, in the first phase that has it.
    pub fn measurement_span(&self, measurement: &str) -> Option<Range<usize>> {
        self.places.phases.iter().find_map(|phase| phase.measurements.get(measurement).cloned())
    }

    /// Bytes of the file where a phase is named; `None` in a file without phases.
    pub fn phase_span(&self, phase: &str) -> Option<Range<usize>> {
        self.places.phase(phase)?.key.clone()
    }

    /// Bytes of the file where a state of a phase is declared; of its owner for a hidden state.
    pub fn state_span_in(&self, phase: &str, state: &str) -> Option<Range<usize>> {
        self.places.phase(phase)?.states.get(state).cloned()
    }

    /// Bytes of the file where a measurement of a phase is declared.
    pub fn measurement_span_in(&self, phase: &str, measurement: &str) -> Option<Range<usize>> {
        self.places.phase(phase)?.measurements.get(measurement).cloned()
    }

    /// Bytes of the file where it is said what a state of a phase inherits.
    pub fn carry_span(&self, phase: &str, state: &str) -> Option<Range<usize>> {
        self.places.phase(phase)?.carry.get(state).cloned()
    }

    /// Bytes of the file where the filter of a phase is declared.
    pub fn filter_span(&self, phase: &str) -> Option<Range<usize>> {
        self.places.phase(phase)?.filter.clone()
    }
}
