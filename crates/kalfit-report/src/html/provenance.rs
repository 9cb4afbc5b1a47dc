//! What was made from what, by what.

use kalfit::FitRecord;
use maud::html;

use crate::html::section::PageSection;
use crate::number::seconds;
use crate::words::{clean, list};

/// Files that are named.
const MOST_FILES: usize = 50;

pub(super) fn section(record: &FitRecord) -> Option<PageSection> {
    let solver = &record.solver;
    let files: Vec<String> = record.data.files.iter().map(|file| clean(file)).collect();
    let digest = record.model_digest.as_ref().map_or_else(|| "not known".to_owned(), |digest| clean(digest));
    let rows = [
        ("made by", format!("kalfit {}", clean(&record.kalfit_version))),
        ("results", clean(&record.schema)),
        ("model file", digest),
        ("data", if files.is_empty() { "not named".to_owned() } else { list(&files, MOST_FILES) }),
        ("criterion", clean(&record.criterion)),
        ("method, solver, phases", [&solver.method, &solver.solver, &solver.phases].map(|s| clean(s)).join(", ")),
        ("standard errors, intervals", format!("{}, {}", clean(&record.std_errors), clean(&record.intervals))),
        ("time", seconds(solver.seconds)),
    ];
    let body = html! { dl.facts { @for (name, value) in &rows { div { dt { (name) } dd { (value) } } } } };
    PageSection::new("provenance", "Provenance", body)
}
