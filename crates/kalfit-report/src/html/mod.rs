//! The report of a fit: one HTML page that needs nothing but itself, on screen and on paper.
//!
//! Everything in it comes from the record. What the summary says in words is said in the same words here; around them stand
//! tables of all that is bounded, and charts. Names come from files that nobody vouched for: they reach the page through
//! maud's escaping or as JSON data, never as markup.

mod across;
mod allan;
mod chart;
mod compare;
mod constraints;
mod data;
pub(crate) mod estimates;
pub(crate) mod forest;
mod grouping;
mod groups;
mod identifiability;
mod influence;
mod innovations;
mod levels;
mod math;
mod model;
pub(crate) mod outlying;
mod overview;
pub(crate) mod parameters;
mod phase;
mod posteriors;
mod provenance;
mod records;
mod section;
mod shell;
mod solver;
mod tests;

use kalfit::FitRecord;
use kalfit::record::{AlongRecord, RatioRecord};

use crate::html::chart::PageCharts;
use crate::html::section::PageSection;

/// The report of a fit, a whole HTML document. It depends on the record alone and copes with any record.
pub fn html(record: &FitRecord) -> String {
    page(record, None, None)
}

/// The same with what is known along the records of its tests, which is no part of the record.
pub fn html_along(record: &FitRecord, along: Option<&AlongRecord>) -> String {
    page(record, None, along)
}

/// The same with a comparison with a hypothesis that was tested within the model.
pub fn html_with_test(record: &FitRecord, test: &RatioRecord) -> String {
    page(record, Some(test), None)
}

fn page(record: &FitRecord, test: Option<&RatioRecord>, along: Option<&AlongRecord>) -> String {
    let mut charts = PageCharts::default();
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
        along.and_then(|along| records::section(along, &mut charts)),
        groups::section(record),
        constraints::section(record, &mut charts),
        test.and_then(|test| compare::section(record, test, &mut charts)),
        solver::section(record, &mut charts),
        provenance::section(record),
    ];
    let sections: Vec<PageSection> = sections.into_iter().flatten().collect();
    kalfit::record::undirected(shell::document(record, &sections, &charts))
}
