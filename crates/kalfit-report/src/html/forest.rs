//! Forest plots: estimates with their intervals, those of comparable size on one axis.

use kalfit::record::Interval;
use maud::Markup;
use serde_json::{Value, json};

use crate::html::chart::{PageChart, PageCharts, figure};
use crate::number::plain;

/// Rows of one chart.
const MOST_ROWS: usize = 60;
/// Axes of one chart.
const MOST_PANELS: usize = 12;
/// On one axis the range is no more than so many times the shortest interval.
const SPREAD: f64 = 40.0;

/// One estimate.
pub(crate) struct ForestRow {
    pub(crate) name: String,
    pub(crate) estimate: f64,
    pub(crate) ends: Interval,
    /// The estimate in words.
    pub(crate) words: String,
    /// What it is compared with.
    pub(super) reference: Option<f64>,
}

/// Estimates of one kind and unit.
pub(crate) struct ForestGroup {
    /// `mean [deg/h]`.
    pub(crate) label: String,
    pub(super) rows: Vec<ForestRow>,
}

/// Estimates on one axis.
pub(crate) struct ForestPanel {
    pub(crate) label: String,
    pub(crate) rows: Vec<ForestRow>,
    low: f64,
    high: f64,
    shortest: f64,
}

/// The chart; nothing without rows.
pub(super) fn forest(title: &str, caption: &str, groups: Vec<ForestGroup>, charts: &mut PageCharts) -> Option<Markup> {
    let all: usize = groups.iter().map(|group| group.rows.len()).sum();
    let panels = panels(groups);
    if panels.is_empty() {
        return None;
    }
    let shown: usize = panels.iter().map(|panel| panel.rows.len()).sum();
    let words: Vec<String> = panels
        .iter()
        .flat_map(|panel| panel.rows.iter().map(|row| format!("{} of {}: {}", panel.label, row.name, row.words)))
        .collect();
    let caption = match all - shown {
        0 => caption.to_owned(),
        n => format!("{caption} The first {shown} are drawn; {n} more are in the table or in fit.json."),
    };
    let data = json!({ "panels": panels.iter().map(ForestPanel::data).collect::<Vec<Value>>() });
    Some(charts.figure(PageChart { kind: "forest", title, caption: &caption, alternative: &words.join("; "), data }))
}

impl ForestPanel {
    fn data(&self) -> Value {
        let row = |row: &ForestRow| {
            let end = |i: usize| row.ends.and_then(|ends| ends[i]).map_or(Value::Null, figure);
            json!({
                "name": row.name, "estimate": figure(row.estimate), "low": end(0), "high": end(1), "words": row.words,
                "reference": row.reference.map_or(Value::Null, figure),
            })
        };
        json!({ "label": self.label, "rows": self.rows.iter().map(row).collect::<Vec<Value>>() })
    }
}

/// Axes for all groups: several for one whose estimates would not all be seen on one.
pub(crate) fn panels(groups: Vec<ForestGroup>) -> Vec<ForestPanel> {
    let mut panels: Vec<ForestPanel> = Vec::new();
    let mut room = MOST_ROWS;
    for group in groups {
        let first = panels.len();
        for row in group.rows.into_iter().filter(|row| row.estimate.is_finite()).take(room) {
            room -= 1;
            let (low, high) = extent(&row);
            let full = panels.len() >= MOST_PANELS;
            let fits = panels[first..].iter().position(|panel| full || panel.takes(low, high));
            match fits {
                Some(place) => panels[first + place].add(row, low, high),
                None if full => room += 1, // no axis is left for this kind
                None => panels.push(ForestPanel {
                    label: group.label.clone(),
                    rows: vec![row],
                    low,
                    high,
                    shortest: if high > low { high - low } else { f64::INFINITY },
                }),
            }
        }
    }
    panels
}

impl ForestPanel {
    fn takes(&self, low: f64, high: f64) -> bool {
        let shortest = if high > low { self.shortest.min(high - low) } else { self.shortest };
        let range = self.high.max(high) - self.low.min(low);
        range <= SPREAD * shortest || !shortest.is_finite()
    }

    fn add(&mut self, row: ForestRow, low: f64, high: f64) {
        (self.low, self.high) = (self.low.min(low), self.high.max(high));
        if high > low {
            self.shortest = self.shortest.min(high - low);
        }
        self.rows.push(row);
    }
}

/// From the lower to the upper end, as far as they are known.
fn extent(row: &ForestRow) -> (f64, f64) {
    let ends = row.ends.unwrap_or([None, None]);
    let end = |i: usize| ends[i].filter(|x: &f64| x.is_finite()).unwrap_or(row.estimate);
    (end(0).min(row.estimate), end(1).max(row.estimate))
}

/// An estimate with its interval in words.
pub(super) fn words(estimate: &str, beside: &str, interval: &str) -> String {
    let interval = if interval.is_empty() { String::new() } else { format!(" (95 %: {interval})") };
    format!("{estimate} {beside}{interval}").trim().to_owned()
}

/// An estimate of which no more is known than its value.
pub(super) fn bare(estimate: f64) -> String {
    plain(estimate, 4)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(estimate: f64, half: f64) -> ForestRow {
        let ends = Some([Some(estimate - half), Some(estimate + half)]);
        ForestRow { name: "r".into(), estimate, ends, words: String::new(), reference: None }
    }

    fn sizes(rows: Vec<ForestRow>) -> Vec<usize> {
        panels(vec![ForestGroup { label: "g".into(), rows }]).iter().map(|panel| panel.rows.len()).collect()
    }

    #[test]
    fn what_cannot_be_seen_on_one_axis_gets_two() {
        assert_eq!(sizes(vec![row(251.0, 13.0), row(10.0, 3.0)]), [1, 1]);
        assert_eq!(sizes(vec![row(0.0035, 0.002), row(0.0001, 0.003), row(-0.0006, 0.002)]), [3]);
        assert_eq!(sizes(vec![row(1.0, 0.0), row(1e9, 0.0)]), [2], "without intervals anything goes");
    }

    #[test]
    fn charts_stay_bounded() {
        let many = |n: usize| (0..n).map(|k| row(10f64.powi((k % 300) as i32), 0.1)).collect();
        let panels = panels(vec![
            ForestGroup { label: "a".into(), rows: many(5000) },
            ForestGroup { label: "b".into(), rows: many(50) },
        ]);
        assert!(panels.len() <= MOST_PANELS, "{}", panels.len());
        assert!(panels.iter().map(|panel| panel.rows.len()).sum::<usize>() <= MOST_ROWS);
    }
}
