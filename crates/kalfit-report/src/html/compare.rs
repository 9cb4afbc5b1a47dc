//! The fit beside the a-priori model that was tested within it.

use kalfit::FitRecord;
use kalfit::record::RatioRecord;
use maud::{Markup, PreEscaped, html};

use crate::html::chart::PageCharts;
use crate::html::forest::{self, ForestGroup, ForestRow};
use crate::html::phase::StateFigure;
use crate::html::section::PageSection;
use crate::number::{DIGITS, plain};
use crate::page::PageLayout;
use crate::ratio;
use crate::table::{ColumnSide, TextColumn};
use crate::words::clean;

/// Rows of the table.
const MOST_ROWS: usize = 200;

pub(super) fn section(record: &FitRecord, test: &RatioRecord, charts: &mut PageCharts) -> Option<PageSection> {
    let page = PageLayout::html();
    let rows = rows(record, test);
    let other =
        test.model_digest.is_some() && record.model_digest.is_some() && test.model_digest != record.model_digest;
    let body = html! {
        @if other { p.verdict.bad { "The test was made with another version of the model than this fit." } }
        (PreEscaped(ratio::sections(test, &page)))
        (PreEscaped(table(&rows, &page)))
        (chart(rows, charts).unwrap_or_default())
    };
    PageSection::new("comparison", "Comparison with the a-priori model", body)
}

/// One figure on both sides.
struct ComparedFigure {
    label: &'static str,
    unit: String,
    row: ForestRow,
    hypothesis: f64,
}

/// Means and standard deviations, by the names of the states.
fn rows(record: &FitRecord, test: &RatioRecord) -> Vec<ComparedFigure> {
    let several = record.phases.len() > 1;
    let mut pairs = Vec::new();
    for phase in &record.phases {
        for (i, state) in phase.states.iter().enumerate() {
            let full = if several { format!("{}.{state}", phase.name) } else { state.clone() };
            let Some(place) = test.null.states.iter().position(|name| *name == full) else { continue };
            let variance = test.null.covariance.get(place).and_then(|row| row.get(place)).copied();
            let sides = [
                (StateFigure::Mean, "mean", test.null.mean.get(place).copied()),
                (StateFigure::StdDev, "standard deviation", variance.map(|v| v.max(0.0).sqrt())),
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
                let row = ForestRow { name: clean(&full), estimate, ends, words, reference: Some(hypothesis) };
                let unit = phase.units.get(i).cloned().flatten().unwrap_or_default();
                pairs.push(ComparedFigure { label, unit, row, hypothesis });
            }
        }
    }
    pairs
}

fn table(rows: &[ComparedFigure], page: &PageLayout<'_>) -> String {
    let rows = &rows[..rows.len().min(MOST_ROWS)];
    if rows.is_empty() {
        return String::new();
    }
    let column = |of: &dyn Fn(&ComparedFigure) -> String| rows.iter().map(of).collect();
    let columns = [
        TextColumn::new("of", ColumnSide::Left, column(&|pair| pair.row.name.clone())),
        TextColumn::new("what", ColumnSide::Left, column(&|pair| pair.label.to_owned())),
        TextColumn::new("a-priori model", ColumnSide::Right, column(&|pair| plain(pair.hypothesis, DIGITS))),
        TextColumn::new(
            "this fit",
            ColumnSide::Left,
            column(&|pair| pair.row.words.split("; hypothesis").next().unwrap_or_default().to_owned()),
        ),
    ];
    page.section("Side by side", &page.table(&columns))
}

fn chart(rows: Vec<ComparedFigure>, charts: &mut PageCharts) -> Option<Markup> {
    let mut groups: Vec<ForestGroup> = Vec::new();
    for ComparedFigure { label, unit, row, .. } in rows {
        let label = if unit.is_empty() { label.to_owned() } else { format!("{label} [{}]", clean(&unit)) };
        match groups.iter_mut().find(|group| group.label == label) {
            Some(group) => group.rows.push(row),
            None => groups.push(ForestGroup { label, rows: vec![row] }),
        }
    }
    let caption = "The fit with its 95 % intervals, and the a-priori model as diamonds: a diamond outside its interval is where \
                   the data contradict it.";
    forest::forest("Fit and a-priori model", caption, groups, charts)
}
