//! The report of a fit: one HTML page that needs nothing but itself, on screen and on paper.
//!
//! Everything in it comes from the record. What the summary says in words is said in the same words here; around them stand
//! tables of all that is bounded, and charts. Names come from files that nobody vouched for: they reach the page through
//! maud's escaping or as JSON data, never as markup.

mod across;
mod chart;
mod compare;
mod constraints;
mod data;
mod estimates;
mod forest;
mod grouping;
mod groups;
mod identifiability;
mod influence;
mod innovations;
mod levels;
mod math;
mod model;
mod outlying;
mod overview;
mod parameters;
mod phase;
mod posteriors;
mod provenance;
mod section;
mod shell;
mod solver;
mod tests;

use kalfit::FitRecord;
use kalfit::record::RatioRecord;

use crate::html::chart::Charts;
use crate::html::section::Section;

/// The report of a fit, a whole HTML document. It depends on the record alone and copes with any record.
pub fn html(record: &FitRecord) -> String {
    page(record, None)
}

/// The same with a comparison with a hypothesis that was tested within the model.
pub fn html_with_test(record: &FitRecord, test: &RatioRecord) -> String {
    page(record, Some(test))
}

fn page(record: &FitRecord, test: Option<&RatioRecord>) -> String {
    let mut charts = Charts::default();
    let sections = [
        overview::section(record),
        model::section(record),
        data::section(record, &mut charts),
        estimates::section(record, &mut charts),
        levels::section(record, &mut charts),
        parameters::section(record, &mut charts),
        identifiability::section(record),
        tests::section(record, &mut charts),
        influence::section(record, &mut charts),
        innovations::section(record, &mut charts),
        groups::section(record),
        constraints::section(record, &mut charts),
        test.and_then(|test| compare::section(record, test, &mut charts)),
        solver::section(record, &mut charts),
        provenance::section(record),
    ];
    let sections: Vec<Section> = sections.into_iter().flatten().collect();
    shell::document(record, &sections, &charts)
}
