//! What the answer would be without each test.

use kalfit::FitRecord;
use kalfit::record::{DeletionRecord, displacement_limit};
use maud::{Markup, PreEscaped, html};
use serde_json::{Value, json};

use crate::html::chart::{PageChart, PageCharts, figure};
use crate::html::section::PageSection;
use crate::number::plain;
use crate::page::PageLayout;
use crate::summary::influence;
use crate::words::{clean, count};

/// Tests that are drawn, those that pull most.
const MOST_BARS: usize = 60;
/// Means whose shifts can be chosen.
const MOST_STATES: usize = 20;

pub(super) fn section(record: &FitRecord, charts: &mut PageCharts) -> Option<PageSection> {
    let deleted = influence::deleted(record);
    let body = if deleted.is_empty() {
        html! { p { "The fit was not repeated without each test: this was not asked for, or would have taken long. Ask for it with \
        " code { "--deletion all" } "." } }
    } else {
        html! { (PreEscaped(influence::section(record, &PageLayout::html()))) (chart(record, &deleted, charts)) }
    };
    if record.tests.len() < 2 { None } else { PageSection::new("influence", "Influence", body) }
}

fn chart(record: &FitRecord, deleted: &[(&str, &DeletionRecord)], charts: &mut PageCharts) -> Markup {
    let shown = &deleted[..deleted.len().min(MOST_BARS)];
    let means = means(record);
    let test = |(test, deletion): &(&str, &DeletionRecord)| {
        let shift = |m: &FreeMean<'_>| m.shift(deletion).map_or(Value::Null, figure);
        json!({
            "id": clean(test), "displacement": figure(deletion.displacement),
            "shifts": means.iter().map(shift).collect::<Vec<Value>>(),
        })
    };
    let limit = displacement_limit(record.free_parameters);
    let data = json!({
        "tests": shown.iter().map(test).collect::<Vec<Value>>(), "limit": figure(limit),
        "means": means.iter().map(|m| m.name.clone()).collect::<Vec<_>>(),
    });
    let said = match deleted.len() - shown.len() {
        0 => String::new(),
        n => format!(" {} with less influence are not shown.", count(n, "test")),
    };
    let caption = format!(
        "How far the estimates move when a test is left out: all together (Cook's displacement, twice the loss of log-likelihood; \
         beyond the dashed line they leave the 50 % confidence region), or the mean of one state, in standard errors. If a bar is much \
         longer than the others, check the data of that test.{said}"
    );
    let alternative = format!(
        "{}; the largest displacement is {}, without test {}.",
        count(shown.len(), "test"),
        plain(shown[0].1.displacement, 3),
        clean(shown[0].0)
    );
    charts.figure(PageChart {
        kind: "influence",
        title: "Without each test",
        caption: &caption,
        alternative: &alternative,
        data,
    })
}

/// A free mean.
struct FreeMean<'a> {
    name: String,
    phase: &'a str,
    element: usize,
    estimate: f64,
    std_error: f64,
}

impl FreeMean<'_> {
    /// From the fit to the fit without the test, in standard errors.
    fn shift(&self, deletion: &DeletionRecord) -> Option<f64> {
        let phase = deletion.phases.iter().find(|phase| phase.name == self.phase)?;
        Some((phase.mean.get(self.element)? - self.estimate) / self.std_error)
    }
}

fn means(record: &FitRecord) -> Vec<FreeMean<'_>> {
    let several = record.phases.len() > 1;
    let places = record.phases.iter().flat_map(|phase| (0..phase.states.len()).map(move |i| (phase, i)));
    let mean = |(phase, element): (&'_ kalfit::record::PhaseRecord, usize)| {
        let std_error = phase.mean.std_error.get(element).copied().flatten().filter(|e| *e > 0.0)?;
        let state = clean(&phase.states[element]);
        let name = if several { format!("{}: {state}", clean(&phase.name)) } else { state };
        Some((name, element, *phase.mean.estimate.get(element)?, std_error))
    };
    let known = places.filter_map(|(phase, i)| {
        let (name, element, estimate, std_error) = mean((phase, i))?;
        Some(FreeMean { name, phase: &phase.name, element, estimate, std_error })
    });
    known.take(MOST_STATES).collect()
}
