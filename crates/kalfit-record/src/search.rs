//! The record of the search for α.

use kalfit_search::{DynamicFit, slot_name};
use serde::{Deserialize, Serialize};

use crate::DynamicParts;

/// How the dynamic parameters were found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SearchRecord {
    /// Runs of the filters, stage by stage.
    pub stages: Vec<StageRecord>,
    /// Number of starts that were searched from.
    pub starts: usize,
    /// Noise levels that returned from zero on the way to the maximum.
    pub returned_from_zero: Vec<String>,
    /// Start or change of which the search found the maximum: `the first start`, or what was changed at the best end
    /// before, such as `two processes exchanged`.
    pub found_by: String,
}

/// Runs of the filters in a stage of the search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// `starts`: searches from the starts; `exploration`: searches for other maxima; `certificate`: searches repeated
    /// from the best end.
    pub name: String,
    /// Forward runs over all tests.
    pub filter_runs: usize,
    /// Backward runs over all tests.
    pub backward_runs: usize,
}

impl SearchRecord {
    /// The record of a fit; `None` without free parameters.
    pub(super) fn of(parts: &DynamicParts<'_>) -> Option<SearchRecord> {
        let DynamicFit { search, slots, .. } = parts.fit;
        let stage = |runs: &kalfit_search::StageRuns| StageRecord {
            name: runs.stage.to_string(),
            filter_runs: runs.filter_runs,
            backward_runs: runs.backward_runs,
        };
        let name = |&s: &usize| slot_name(parts.model.shared(), parts.labels, slots, s).replace('`', "");
        (!slots.is_empty()).then(|| SearchRecord {
            stages: search.stages.iter().map(stage).collect(),
            starts: search.starts,
            returned_from_zero: search.returned_from_zero.iter().map(name).collect(),
            found_by: search.found_by.to_string(),
        })
    }
}
