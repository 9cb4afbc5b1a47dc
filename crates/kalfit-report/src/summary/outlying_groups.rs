//! Groups of tests that do not look like the others.

use kalfit::FitRecord;
use kalfit::record::{SEARCH_LEVEL, UnitRecord};

use crate::figures;
use crate::number::probability;
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::clean;

/// Groups of the table.
const MOST_ROWS: usize = 5;

pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let mut tested: Vec<(f64, &UnitRecord)> =
        record.groups.iter().filter_map(|g| g.p_value.filter(|p| p.is_finite()).map(|p| (p, g))).collect();
    tested.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.id.cmp(&b.1.id)));
    let Some(&(least, nearest)) = tested.first() else { return String::new() };
    let all = tested.len();
    let corrected = |p: f64| (p * all as f64).min(1.0);
    let outliers: Vec<(f64, &UnitRecord)> = tested.into_iter().filter(|&(p, _)| corrected(p) < SEARCH_LEVEL).collect();
    if outliers.is_empty() {
        let (which, then) = match all {
            1 => ("its p-value".to_owned(), String::new()),
            _ => (
                format!("the smallest of {all} p-values"),
                format!(", or {} after Bonferroni correction", probability(corrected(least))),
            ),
        };
        let (level, id) = (clean(&nearest.level), clean(&nearest.id.join("/")));
        let sentence = format!("No group is an outlier: {which} is {} ({level} {id}){then}.", probability(least));
        return page.section("Outlying groups", &page.items(&[sentence]));
    }
    let rows = &outliers[..outliers.len().min(page.rows(MOST_ROWS))];
    let groups = || rows.iter().map(|&(_, group)| group);
    let columns = [
        figures::column(UnitRecord::level, groups()),
        TextColumn::new("group", ColumnSide::Left, groups().map(|group| clean(&group.id.join("/"))).collect()),
        figures::column(UnitRecord::tests, groups()),
        figures::column(UnitRecord::distance, groups()),
        figures::column(UnitRecord::degrees_of_freedom, groups()),
        figures::column(UnitRecord::p_value, groups()),
        TextColumn::new(
            &format!("times {all}"),
            ColumnSide::Right,
            rows.iter().map(|&(p, _)| probability(corrected(p))).collect(),
        ),
    ];
    let are = if outliers.len() == 1 { "This group is an outlier" } else { "These groups are outliers" };
    let sentence = format!("{are} at the 5 % level, after Bonferroni correction for {all} groups.");
    page.section("Outlying groups", &(page.table(&columns) + &page.items(&[sentence])))
}
