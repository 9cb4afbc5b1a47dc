//! Can the result be trusted, and what is it in a few figures.

use kalfit::FitRecord;
use kalfit::record::ModelCheckRecord;
use maud::{PreEscaped, html};

use crate::html::section::Section;
use crate::number::hundredths;
use crate::page::Page;
use crate::summary::{self, headline, phases, places};

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
    let checked = ModelCheckRecord::of(record);
    let class = match (record.converged, checked.is_doubtful()) {
        (true, false) => "verdict good",
        (true, true) => "verdict fair",
        (false, _) => "verdict bad",
    };
    let body = html! {
        div class=(class) {
            p { (headline::verdict(record)) }
            @if let Some(sentence) = headline::model_check(record, &checked) { p { (sentence) } }
        }
        @if !record.converged { p { (headline::shortfall(record)) } }
        dl.cards { @for (name, value) in &cards { div { dt { (name) } dd { (value) } } } }
        @for sentence in phases::combined(record) { p { (sentence) } }
        @if let Some(sentence) = places::counted(record) { p { (sentence) } }
        p { (headline::likelihood(record)) }
        @if record.log_likelihood_kind == "estimates" { p { (headline::OF_ESTIMATES) } }
        (PreEscaped(summary::notes(record, &page)))
    };
    Section::new("overview", "Overview", body)
}
