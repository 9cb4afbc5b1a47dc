//! The estimates with their errors, whether they can be trusted, what to do next.

use kalfit::FitRecord;
use kalfit::record::{ModelCheckRecord, PhaseRecord};
use maud::{Markup, PreEscaped, html};

use crate::html::section::PageSection;
use crate::number::hundredths;
use crate::page::{PageLayout, coded};
use crate::summary::{self, headline, parameters, phases, places, states};
use crate::words::clean;

pub(super) fn section(record: &FitRecord) -> Option<PageSection> {
    let page = PageLayout::html();
    let mut cards = vec![
        ("tests", record.data.tests.to_string()),
        ("steps", record.data.steps.to_string()),
        ("observations", record.data.observations.to_string()),
        ("free parameters", record.free_parameters.to_string()),
        (headline::likelihood_name(record), hundredths(record.log_likelihood)),
    ];
    cards.extend(record.aic.map(|x| ("AIC", hundredths(x))));
    cards.extend(record.bic.map(|x| ("BIC", hundredths(x))));
    let checked = ModelCheckRecord::of(record);
    let body = html! {
        @if !record.converged { (verdict(record, &checked)) }
        (PreEscaped(estimates(record, &page)))
        @if record.converged { (verdict(record, &checked)) }
        (PreEscaped(summary::advice::section(record, &page)))
        dl.cards { @for (name, value) in &cards { div { dt { (name) } dd { (value) } } } }
        @for sentence in phases::combined(record) { p { (sentence) } }
        @if let Some(sentence) = places::counted(record) { p { (coded(&sentence)) } }
        @if record.log_likelihood_kind == "estimates" { p { (headline::OF_ESTIMATES) } }
        (PreEscaped(summary::notes(record, &page)))
    };
    PageSection::new("overview", "Overview", body)
}

/// Convergence and model check, in a box.
fn verdict(record: &FitRecord, checked: &ModelCheckRecord) -> Markup {
    let class = match (record.converged, checked.is_doubtful()) {
        (true, false) => "verdict good",
        (true, true) => "verdict fair",
        (false, _) => "verdict bad",
    };
    html! {
        div class=(class) {
            p { (headline::verdict(record)) }
            @if let Some(sentence) = headline::model_check(record, checked) { p { (sentence) } }
        }
        @if !record.converged { p { (headline::shortfall(record)) } }
    }
}

/// Means, spreads and free parameters with their errors; intervals and charts have sections of their own.
fn estimates(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let several = record.phases.len() > 1;
    let table = |phase: &PhaseRecord| {
        let title =
            |what: &str| if several { format!("Phase {}: {what}", clean(&phase.name)) } else { what.to_owned() };
        states::section(record, phase, &title, page)
    };
    let phases: String = record.phases.iter().map(table).collect();
    let free = record.parameters.iter().any(|parameter| !parameter.fixed);
    phases + &if free { parameters::section(record, page) } else { String::new() }
}
