//! What the data tell and what they leave open.

use kalfit::FitRecord;
use maud::{PreEscaped, html};

use crate::html::section::PageSection;
use crate::page::PageLayout;
use crate::summary::{doubts, observability, phases, places};
use crate::words::clean;

pub(super) fn section(record: &FitRecord) -> Option<PageSection> {
    let page = PageLayout::html();
    let several = record.phases.len() > 1;
    let observed: Vec<_> = record.phases.iter().map(|p| (p.name.as_str(), p.information.as_ref())).collect();
    let mut parts: Vec<String> = Vec::new();
    for phase in &record.phases {
        let tests = phase.tests.unwrap_or(record.data.tests);
        let title = |what: &str| match several {
            true => format!("Phase {}: {}{}", clean(&phase.name), what[..1].to_lowercase(), &what[1..]),
            false => what.to_owned(),
        };
        parts.push(match doubts::section(record, phase, &title, &page) {
            none if none.is_empty() && !phase.states.is_empty() => page.section(
                &title("What the data cannot determine"),
                &page.items(&[format!(
                    "The data identify all free elements, and the covariance{} is regular.",
                    places::within(record)
                )]),
            ),
            some => some,
        });
        let seen = observability::overview(&phase.observability, tests, &page);
        parts.push(page.section(&title("Which tests determine which states"), &seen));
    }
    parts.push(phases::information(&observed, true, &page));
    PageSection::new("identifiability", "Identifiability", html! { (PreEscaped(parts.concat())) })
}
