//! Groups of tests, as the summary has them.

use kalfit::FitRecord;
use maud::{PreEscaped, html};

use crate::html::section::PageSection;
use crate::page::PageLayout;
use crate::summary::groups;

pub(super) fn section(record: &FitRecord) -> Option<PageSection> {
    let body = groups::section(record, &PageLayout::html());
    if body.is_empty() {
        return None;
    }
    let hint = "Mean square: of the group's standardised innovations, expected 1. Distance²: sum of the squared distances of its \
                tests from the population.";
    PageSection::new("groups", "Groups", html! { (PreEscaped(body)) p.hint { (hint) } })
}
