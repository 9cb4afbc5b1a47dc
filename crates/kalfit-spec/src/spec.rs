//! A model file that was read, and where its things stand.

use std::ops::Range;

use kalfit::{Layout, PhasedModel};

use crate::places::SpecPlaces;
use crate::suggest::nearest;

/// A model file that was read.
#[derive(Debug, Clone)]
pub struct Spec {
    /// The model, of one phase or of several. Its invariants hold, whatever the file.
    pub model: PhasedModel,
    /// How rows of the data become tests.
    pub layout: Layout,
    /// `sha256:` and 64 hexadecimal digits: the digest of `text`.
    pub digest: String,
    /// Name of the file, for messages.
    pub name: String,
    /// The model file as it was read.
    pub text: String,
    pub(crate) places: SpecPlaces,
}

impl Spec {
    /// Bytes of the file where a column of the data is used first; `None` when the model does not use it.
    pub fn column_span(&self, column: &str) -> Option<Range<usize>> {
        self.places.columns.get(column).cloned()
    }

    /// Bytes of the file where `[data]` names a level of groups.
    pub fn level_span(&self, level: &str) -> Option<Range<usize>> {
        self.places.levels.get(level).cloned()
    }

    /// "state `bias`", or another name of the model that was perhaps meant by this one.
    pub fn nearest_name(&self, name: &str) -> Option<String> {
        let phases = || self.model.phases.iter().map(|phase| &phase.model);
        let states: Vec<&str> = phases().flat_map(|model| &model.states).map(|state| state.name.as_str()).collect();
        let parameters: Vec<&str> = self.model.shared().parameters.iter().map(|one| one.name.as_str()).collect();
        let near = nearest(name, states.iter().chain(&parameters).copied())?;
        let kind = if states.contains(&near) { "state" } else { "parameter" };
        Some(format!("{kind} `{near}`"))
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
