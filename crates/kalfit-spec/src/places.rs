//! Places in the model file that messages about data and results point to.

use std::collections::BTreeMap;

use crate::error::Span;
use crate::levels::GroupColumns;
use crate::names::{Context, Role};

/// Where things stand in the file, and what parameters are used as.
#[derive(Debug, Clone, Default)]
pub(crate) struct Places {
    pub(crate) columns: BTreeMap<String, Span>,
    pub(crate) parameters: BTreeMap<String, Span>,
    /// Columns of groups, where `[data]` names them.
    pub(crate) levels: BTreeMap<String, Span>,
    pub(crate) phases: Vec<PhasePlaces>,
    pub(crate) roles: Vec<Role>,
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

impl Places {
    pub(crate) fn of(context: &Context<'_>, phases: Vec<PhasePlaces>, levels: Option<&GroupColumns>) -> Places {
        Places {
            columns: context.column_spans.clone(),
            parameters: context.parameters.spans(),
            levels: levels.map_or_else(BTreeMap::new, GroupColumns::spans),
            phases,
            roles: context.roles.iter().map(|role| role.unwrap_or(Role::Coefficient)).collect(),
        }
    }

    pub(crate) fn phase(&self, name: &str) -> Option<&PhasePlaces> {
        self.phases.iter().find(|phase| phase.name == name)
    }
}
