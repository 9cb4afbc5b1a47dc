//! Tests that decide the answer: what happens to it without them.

use kalfit::FitRecord;
use kalfit::record::{DeletionRecord, displacement_limit};

use crate::figures;
use crate::number::plain;
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::clean;

const MOST_ROWS: usize = 5;

pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let deleted = deleted(record);
    let Some(&(first, most)) = deleted.first() else { return String::new() };
    let heading = "Influence of single tests";
    let limit = displacement_limit(record.free_parameters);
    let influential: Vec<_> = deleted.iter().take_while(|(_, d)| d.displacement > limit).collect();
    if influential.is_empty() {
        let sentence = format!(
            "No single test is influential. Test {} moves the estimates most: its Cook's displacement is {}, and {} is the edge \
             of the 50 % confidence region.",
            clean(first),
            plain(most.displacement, 2),
            plain(limit, 2)
        );
        return page.section(heading, &page.items(&[sentence]));
    }
    let rows = &influential[..influential.len().min(page.rows(MOST_ROWS))];
    let deletions = || rows.iter().map(|(_, deletion)| *deletion);
    let columns = [
        TextColumn::new("test", ColumnSide::Left, rows.iter().map(|(test, _)| (*test).to_owned()).collect()),
        figures::column(DeletionRecord::displacement, deletions()),
        figures::column(DeletionRecord::p_value, deletions()),
    ];
    let which = match (rows.len(), influential.len() - rows.len()) {
        (1, _) => "this test".to_owned(),
        (_, 0) => "any one of these tests".to_owned(),
        (_, n) => format!("any one of these tests (and of {n} more)"),
    };
    let sentences = [
        format!("Leaving {which} out moves the estimates outside the 50 % confidence region of the full fit."),
        figures::sentences(&[DeletionRecord::displacement, DeletionRecord::p_value]),
    ];
    page.section(heading, &(page.table(&columns) + &page.items(&sentences)))
}

/// Tests that were left out in turn, those that move the estimates most first.
pub(crate) fn deleted(record: &FitRecord) -> Vec<(&str, &DeletionRecord)> {
    let mut deleted: Vec<(&str, &DeletionRecord)> =
        record.tests.iter().filter_map(|t| t.deletion.map(|d| (t.id, d))).collect();
    deleted.retain(|(_, d)| d.displacement.is_finite());
    deleted.sort_by(|a, b| b.1.displacement.total_cmp(&a.1.displacement).then_with(|| a.0.cmp(b.0)));
    deleted
}

/// Tests without which the estimates leave the 50 % confidence region.
pub(super) fn influential(record: &FitRecord) -> Vec<&str> {
    let limit = displacement_limit(record.free_parameters);
    deleted(record).into_iter().take_while(|(_, d)| d.displacement > limit).map(|(test, _)| test).collect()
}
