//! Groups of tests in the charts: a colour and a shape for each, the same in every chart.

use std::collections::BTreeMap;

use kalfit::FitRecord;
use kalfit::record::TestRecord;
use serde_json::{Value, json};

use crate::words::clean;

/// Groups with a colour of their own; where there are more, those with the fewest tests share one.
const MOST_GROUPS: usize = 6;

/// The groups of the tests, those with a colour of their own first.
pub(super) struct ColoredGroups {
    column: String,
    /// Names as they are in the record, by place.
    places: BTreeMap<String, usize>,
    /// Names in the legend.
    names: Vec<String>,
}

impl ColoredGroups {
    /// `None` where tests are not grouped, or stand in one group.
    pub(super) fn of(record: &FitRecord) -> Option<ColoredGroups> {
        let column = record.group_column.as_ref()?;
        let mut sizes: BTreeMap<&str, usize> = BTreeMap::new();
        record.tests.iter().filter_map(|test| test.group).for_each(|group| *sizes.entry(group).or_default() += 1);
        if sizes.len() < 2 {
            return None;
        }
        let mut own: Vec<&str> = sizes.keys().copied().collect();
        let all = own.len();
        if all > MOST_GROUPS {
            own.sort_by_key(|group| usize::MAX - sizes[group]); // stable: those of equal size by name
            own.truncate(MOST_GROUPS - 1);
            own.sort_unstable();
        }
        let mut names: Vec<String> = own.iter().map(|group| clean(group)).collect();
        if all > own.len() {
            names.push(format!("{} others", all - own.len()));
        }
        let places = own.iter().enumerate().map(|(place, group)| ((*group).to_owned(), place)).collect();
        Some(ColoredGroups { column: clean(column), places, names })
    }

    /// What the script wants of a test.
    pub(super) fn place(&self, test: TestRecord<'_>) -> Value {
        let place = |group: &String| self.places.get(group).copied().unwrap_or(MOST_GROUPS - 1);
        test.group.map_or(Value::Null, |group| json!(place(group)))
    }

    /// Adds to the data of a chart the names of the groups.
    pub(super) fn tell(grouping: Option<&ColoredGroups>, data: &mut Value) {
        if let Some(own) = grouping {
            data["groups"] = json!({ "column": own.column, "names": own.names });
        }
    }

    /// For the caption.
    pub(super) fn caption(grouping: Option<&ColoredGroups>) -> String {
        grouping.map_or_else(String::new, |own| format!(" Colours and shapes: tests by {}.", own.column))
    }
}

/// Where a test stands, for the script; null where tests are not grouped.
pub(super) fn place(grouping: Option<&ColoredGroups>, test: TestRecord<'_>) -> Value {
    grouping.map_or(Value::Null, |own| own.place(test))
}
