//! The same states from phase to phase.

use kalfit::FitRecord;
use maud::{Markup, html};

use crate::html::chart::PageCharts;
use crate::html::forest::{self, ForestGroup, ForestRow};
use crate::html::phase::{StateFigure, forest_row};
use crate::words::clean;

/// States that several phases have, side by side; nothing where there are none.
pub(super) fn section(record: &FitRecord, charts: &mut PageCharts) -> Option<Markup> {
    let mut names: Vec<&String> = Vec::new();
    for phase in &record.phases {
        names.extend(phase.states.iter().filter(|state| !names.contains(state)).collect::<Vec<_>>());
        if names.len() > MOST_STATES {
            break;
        }
    }
    let mut groups: Vec<ForestGroup> = Vec::new();
    for kind in [StateFigure::Mean, StateFigure::StdDev] {
        groups.extend(names.iter().filter_map(|state| group(record, kind, state)));
    }
    let caption = "What each phase adds to the errors of the same state: its own uncertain start, without what it inherits. \
                   Intervals that do not overlap: the phases differ.";
    let chart = forest::forest("From phase to phase", caption, groups, charts)?;
    Some(html! { h3 { "From phase to phase" } (chart) })
}

/// More states than this are not looked for in other phases.
const MOST_STATES: usize = 100;

fn group(record: &FitRecord, kind: StateFigure, state: &String) -> Option<ForestGroup> {
    let mut unit = String::new();
    let mut rows: Vec<ForestRow> = Vec::new();
    for phase in &record.phases {
        let Some(i) = phase.states.iter().position(|name| name == state) else { continue };
        unit = phase.units.get(i).cloned().flatten().unwrap_or_default();
        rows.extend(forest_row(phase, kind, i).map(|row| ForestRow { name: clean(&phase.name), ..row }));
    }
    let unit = if unit.is_empty() { String::new() } else { format!(" [{}]", clean(&unit)) };
    (rows.len() > 1).then(|| ForestGroup { label: format!("{} of {}{unit}", kind.name(), clean(state)), rows })
}
