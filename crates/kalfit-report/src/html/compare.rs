//! The fit beside the a-priori model that was tested within it.

use kalfit::FitRecord;
use kalfit::record::RatioRecord;
use maud::{Markup, PreEscaped, html};

use crate::html::chart::Charts;
use crate::html::forest::{self, Group, Row};
use crate::html::phase::Kind;
use crate::html::section::Section;
use crate::number::{DIGITS, plain};
use crate::page::Page;
use crate::ratio;
use crate::table::{Column, Side};
use crate::words::clean;

/// Rows of the table.
const MOST_ROWS: usize = 200;

pub(super) fn section(record: &FitRecord, test: &RatioRecord, charts: &mut Charts) -> Option<Section> {
    let page = Page::html();
    let rows = rows(record, test);
    let other =
        test.model_digest.is_some() && record.model_digest.is_some() && test.model_digest != record.model_digest;
    let body = html! {
        @if other { p.verdict.bad { "The test was made with another version of the model than this fit." } }
        (PreEscaped(ratio::sections(test, &page)))
        (PreEscaped(table(&rows, &page)))
        (chart(rows, charts).unwrap_or_default())
    };
    Section::new("comparison", "Comparison with the a-priori model", body)
}

/// One figure on both sides.
struct Pair {
    label: &'static str,
    unit: String,
    row: Row,
    hypothesis: f64,
}

/// Means and standard deviations, by the names of the states.
fn rows(record: &FitRecord, test: &RatioRecord) -> Vec<Pair> {
    let several = record.phases.len() > 1;
    let mut pairs = Vec::new();
    for phase in &record.phases {
        for (i, state) in phase.states.iter().enumerate() {
            let full = if several { format!("{}.{state}", phase.name) } else { state.clone() };
            let Some(place) = test.null.states.iter().position(|name| *name == full) else { continue };
            let variance = test.null.covariance.get(place).and_then(|row| row.get(place)).copied();
            let sides = [
                (Kind::Mean, "mean", test.null.mean.get(place).copied()),
                (Kind::StdDev, "standard deviation", variance.map(|v| v.max(0.0).sqrt())),
            ];
            for (kind, label, hypothesis) in sides {
                let (Some(hypothesis), Some(estimate)) = (hypothesis, kind.estimate(phase, i)) else { continue };
                let (shown, beside) = kind.cells(phase, i);
                let words = format!(
                    "{}; hypothesis {}",
                    forest::words(&shown, &beside, &kind.interval(phase, i)),
                    forest::bare(hypothesis)
                );
                let ends = if kind.fixed(phase, i) { None } else { kind.ends(phase, i) };
                let row = Row { name: clean(&full), estimate, ends, words, reference: Some(hypothesis) };
                let unit = phase.units.get(i).cloned().flatten().unwrap_or_default();
                pairs.push(Pair { label, unit, row, hypothesis });
            }
        }
    }
    pairs
}

fn table(rows: &[Pair], page: &Page<'_>) -> String {
    let rows = &rows[..rows.len().min(MOST_ROWS)];
    if rows.is_empty() {
        return String::new();
    }
    let column = |of: &dyn Fn(&Pair) -> String| rows.iter().map(of).collect();
    let columns = [
        Column::new("of", Side::Left, column(&|pair| pair.row.name.clone())),
        Column::new("what", Side::Left, column(&|pair| pair.label.to_owned())),
        Column::new("a-priori model", Side::Right, column(&|pair| plain(pair.hypothesis, DIGITS))),
        Column::new(
            "this fit",
            Side::Left,
            column(&|pair| pair.row.words.split("; hypothesis").next().unwrap_or_default().to_owned()),
        ),
    ];
    page.section("Side by side", &page.table(&columns))
}

fn chart(rows: Vec<Pair>, charts: &mut Charts) -> Option<Markup> {
    let mut groups: Vec<Group> = Vec::new();
    for Pair { label, unit, row, .. } in rows {
        let label = if unit.is_empty() { label.to_owned() } else { format!("{label} [{}]", clean(&unit)) };
        match groups.iter_mut().find(|group| group.label == label) {
            Some(group) => group.rows.push(row),
            None => groups.push(Group { label, rows: vec![row] }),
        }
    }
    let caption = "The fit with its 95 % intervals, and the a-priori model as diamonds: a diamond outside its interval is where \
                   the data contradict it.";
    forest::forest("Fit and a-priori model", caption, groups, charts)
}
