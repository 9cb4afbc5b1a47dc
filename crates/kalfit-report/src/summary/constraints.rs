//! What each constraint costs.

use kalfit::FitRecord;
use kalfit::record::ConstraintRecord;

use crate::figures;
use crate::number::{plain, probability};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, list};

/// A diagonal Σ of many states has very many; the others are in fit.json.
const MOST_ROWS: usize = 20;
/// Level at which the data are said to speak against a constraint.
const LEVEL: f64 = 0.05;
/// Constraints that a remark names.
const MOST_NAMED: usize = 5;

pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    if record.constraints.is_empty() {
        return String::new();
    }
    let mut rows: Vec<&ConstraintRecord> = record.constraints.iter().collect();
    if rows.len() > page.rows(MOST_ROWS) {
        rows.sort_by(|a, b| a.p_value.unwrap_or(2.0).total_cmp(&b.p_value.unwrap_or(2.0)));
        rows.truncate(page.rows(MOST_ROWS));
    }
    let freed =
        |row: &ConstraintRecord| row.expected_change.map_or_else(|| "-".to_owned(), |c| plain(row.value + c, 3));
    let mut columns =
        vec![TextColumn::new("element", ColumnSide::Left, rows.iter().map(|r| name(record, r)).collect())];
    columns.extend(figures::columns(&ConstraintRecord::FIGURES, rows.iter().copied()));
    if rows.iter().any(|row| p_of_refit(row).is_some()) {
        let p_values = rows.iter().map(|r| p_of_refit(r).map_or_else(|| "-".to_owned(), probability));
        columns.push(TextColumn::new("p of refit", ColumnSide::Right, p_values.collect()));
    }
    columns.push(TextColumn::new("if freed", ColumnSide::Right, rows.iter().map(|r| freed(r)).collect()));
    let body = page.table(&columns) + &page.items(&remarks(record, rows.len()));
    page.section("Constraints (score test of each one separately)", &body)
}

/// p-value of a fit without the constraint: by F for a mean under the restricted likelihood, by the likelihood ratio for
/// all others.
fn p_of_refit(row: &ConstraintRecord) -> Option<f64> {
    row.f_p_value.or(row.likelihood_ratio_p_value)
}

/// The element, with its level of groups, or its phase where there are several.
pub(crate) fn name(record: &FitRecord, row: &ConstraintRecord) -> String {
    match (&row.level, record.phases.len()) {
        (Some(level), _) => format!("{level}: {}", row.element),
        (None, 0 | 1) => row.element.clone(),
        (None, _) => format!("{}: {}", row.phase, row.element),
    }
}

fn remarks(record: &FitRecord, shown: usize) -> Vec<String> {
    let mut remarks = Vec::new();
    if record.constraints.len() > shown {
        remarks.push(format!(
            "These are the {shown} of {} constraints with the smallest p-values.",
            record.constraints.len()
        ));
    }
    let tested = record.constraints.iter().filter(|c| c.p_value.is_some()).count();
    let is_small = |p: f64| p * (tested as f64) < LEVEL;
    let rejected = |c: &&ConstraintRecord| c.p_value.is_some_and(is_small);
    let named = |which: &dyn Fn(&ConstraintRecord) -> bool| -> Vec<String> {
        let all = record.constraints.iter().filter(rejected).filter(|c| which(c));
        all.map(|c| clean(&name(record, c))).collect()
    };
    let against = named(&|c| p_of_refit(c).is_some_and(is_small));
    let unconfirmed = named(&|c| p_of_refit(c).is_some_and(|p| !is_small(p)));
    let by_f = record.constraints.iter().filter(rejected).any(|c| c.f_p_value.is_some());
    let alone = named(&|c| p_of_refit(c).is_none());
    let counted = if tested > 1 { format!(", after Bonferroni correction for {tested} tests") } else { String::new() };
    if !against.is_empty() {
        remarks.push(format!(
            "The data contradict the constraint on {} (5 % level{counted}).",
            list(&against, MOST_NAMED)
        ));
    }
    if !unconfirmed.is_empty() {
        remarks.push(format!(
            "The score test rejects the constraint on {}, but {} does not (5 % level{counted}).",
            list(&unconfirmed, MOST_NAMED),
            if by_f { "the F test of a fit without it" } else { "the likelihood ratio of a fit without it" }
        ));
    }
    if !alone.is_empty() {
        remarks.push(format!(
            "The score test rejects the constraint on {} (5 % level{counted}); no fit without it confirms this.",
            list(&alone, MOST_NAMED)
        ));
    }
    if tested > 0 && against.is_empty() && unconfirmed.is_empty() && alone.is_empty() {
        let which = if tested == 1 { "the constraint" } else { "any of them" };
        remarks.push(format!("The data do not contradict {which} (5 % level{counted})."));
    }
    remarks
}
