//! How the optimum was found, and whether it is one.

use kalfit::FitRecord;
use maud::{Markup, PreEscaped, html};
use serde_json::json;

use crate::html::chart::{PageChart, PageCharts, figures};
use crate::html::section::PageSection;
use crate::number::{hundredths, plain};
use crate::page::PageLayout;
use crate::summary;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count, sentence};

/// Steps that are drawn.
const MOST_STEPS: usize = 1000;
/// Other starts in the table.
const MOST_STARTS: usize = 50;

pub(super) fn section(record: &FitRecord, charts: &mut PageCharts) -> Option<PageSection> {
    let page = PageLayout::html();
    let body = html! {
        p { (sentence(&clean(&record.reason))) }
        (PreEscaped(certificate(record, &page)))
        (chart(record, charts).unwrap_or_default())
        (PreEscaped(starts(record, &page)))
        (PreEscaped(summary::work(record, &page)))
    };
    PageSection::new("solver", "Solver and optimality", body)
}

fn certificate(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let c = &record.certificate;
    let rows = [
        ("mean", "largest score of the mean", c.mean),
        ("covariance", "largest gradient of the free elements of Σ", c.covariance),
        ("null space of Σ", "largest gain from adding a direction to a singular Σ", c.null_space),
        ("dynamic parameters", "largest score of a dynamic parameter", c.parameters),
        ("rounding", "largest effect of rounding errors on mean and covariance", c.rounding),
    ];
    let columns = [
        TextColumn::new("condition", ColumnSide::Left, rows.iter().map(|r| r.0.to_owned()).collect()),
        TextColumn::new("what must be zero", ColumnSide::Left, rows.iter().map(|r| r.1.to_owned()).collect()),
        TextColumn::new("found, in standard errors", ColumnSide::Right, rows.iter().map(|r| plain(r.2, 2)).collect()),
    ];
    page.section("Optimality conditions", &page.table(&columns))
}

fn chart(record: &FitRecord, charts: &mut PageCharts) -> Option<Markup> {
    let trace = &record.solver.trace;
    let best = trace.iter().copied().filter(|x| x.is_finite()).fold(f64::NEG_INFINITY, f64::max);
    if trace.len() < 2 || !best.is_finite() {
        return None;
    }
    let thin = trace.len().div_ceil(MOST_STEPS);
    let steps: Vec<usize> = (0..trace.len()).filter(|i| i.is_multiple_of(thin) || i + 1 == trace.len()).collect();
    let data = json!({
        "steps": steps, "gap": figures(steps.iter().map(|&i| best - trace[i])), "value": figures(steps.iter().map(|&i| trace[i])),
    });
    let caption = "How far the log-likelihood of each step was below the best, on a logarithmic scale. A line that falls faster and \
                   faster has found the optimum; one that flattens out has not. Steps at the best itself are not drawn.";
    let alternative = format!(
        "{}, from {} to {}.",
        count(trace.len(), "step"),
        hundredths(trace[0]),
        hundredths(trace[trace.len() - 1])
    );
    Some(charts.figure(PageChart {
        kind: "trace",
        title: "Path of the solver",
        caption,
        alternative: &alternative,
        data,
    }))
}

fn starts(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let starts = &record.starts[..record.starts.len().min(MOST_STARTS)];
    if starts.is_empty() {
        return String::new();
    }
    let best = record.log_likelihood;
    let columns = [
        TextColumn::new(
            "log-likelihood",
            ColumnSide::Right,
            starts.iter().map(|s| hundredths(s.log_likelihood)).collect(),
        ),
        TextColumn::new(
            "below the result",
            ColumnSide::Right,
            starts.iter().map(|s| plain(best - s.log_likelihood, 3)).collect(),
        ),
        TextColumn::new(
            "converged",
            ColumnSide::Left,
            starts.iter().map(|s| if s.converged { "yes" } else { "no" }.into()).collect(),
        ),
    ];
    page.section("Where other starts ended", &page.table(&columns))
}
