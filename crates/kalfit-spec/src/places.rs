//! Places in the model file that messages about data and results point to.

use std::collections::BTreeMap;

use crate::error::Span;
use crate::levels::GroupColumns;
use crate::names::{NameContext, ParameterRole};

/// Where things stand in the file, and what parameters are used as.
#[derive(Debug, Clone, Default)]
pub(crate) struct SpecPlaces {
    pub(crate) columns: BTreeMap<String, Span>,
    pub(crate) parameters: BTreeMap<String, Span>,
    /// Columns of groups, where `[data]` names them.
    pub(crate) levels: BTreeMap<String, Span>,
    pub(crate) phases: Vec<PhasePlaces>,
    pub(crate) roles: Vec<ParameterRole>,
}

#[derive(Debug, Clone)]
pub(crate) struct PhasePlaces {
    pub(crate) name: String,
    pub(crate) key: Option<Span>,
    pub(crate) states: BTreeMap<String, Span>,
    pub(crate) measurements: BTreeMap<String, Span>,
    pub(crate) carry: BTreeMap<String, Span>,
    pub(crate) filter: Option<Span>,
}

impl SpecPlaces {
    pub(crate) fn of<'g>(
        context: &NameContext<'_>,
        phases: Vec<PhasePlaces>,
        levels: impl Iterator<Item = &'g GroupColumns>,
    ) -> SpecPlaces {
        SpecPlaces {
            columns: context.column_spans.clone(),
            parameters: context.parameters.spans(),
            levels: levels.flat_map(GroupColumns::spans).collect(),
            phases,
            roles: context.roles.iter().map(|role| role.unwrap_or(ParameterRole::Coefficient)).collect(),
        }
    }

    pub(crate) fn phase(&self, name: &str) -> Option<&PhasePlaces> {
        self.phases.iter().find(|phase| phase.name == name)
    }
}
