//! Can the result be trusted, and what is it in a few figures.

use kalfit::FitRecord;
use maud::{PreEscaped, html};

use crate::html::Section;
use crate::number::hundredths;
use crate::page::Page;
use crate::summary::{self, headline, phases};

pub(super) fn section(record: &FitRecord) -> Option<Section> {
    let page = Page::html();
    let mut cards = vec![
        ("tests", record.data.tests.to_string()),
        ("steps", record.data.steps.to_string()),
        ("observations", record.data.observations.to_string()),
        ("free quantities", record.free_parameters.to_string()),
        ("log-likelihood", hundredths(record.log_likelihood)),
    ];
    cards.extend(record.aic.map(|x| ("AIC", hundredths(x))));
    cards.extend(record.bic.map(|x| ("BIC", hundredths(x))));
    let class = if record.converged { "verdict good" } else { "verdict bad" };
    let body = html! {
        p class=(class) { (headline::verdict(record)) }
        @if !record.converged { p { (headline::shortfall(record)) } }
        dl.cards { @for (name, value) in &cards { div { dt { (name) } dd { (value) } } } }
        @for sentence in phases::combined(record) { p { (sentence) } }
        p { (headline::likelihood(record)) }
        @if record.log_likelihood_kind == "estimates" { p { (headline::OF_ESTIMATES) } }
        (PreEscaped(summary::notes(record, &page)))
    };
    Section::new("overview", "Overview", body)
}
