//! Groups of tests: are their innovations and their tests what the model says, and do they differ?

use kalfit::FitRecord;
use kalfit::record::{GroupRecord, GroupTestRecord};

use crate::figures;
use crate::number::{FigurePrecision, plain, probability};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count};

const MOST_ROWS: usize = 20;

pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let column = record.group_column.as_deref().map(clean).unwrap_or_default();
    let differ: Vec<String> = record.group_test.iter().map(differ).collect();
    if record.by_group.is_empty() {
        return page.section(&format!("Groups by {column}"), &page.items(&differ));
    }
    let rows = &record.by_group[..record.by_group.len().min(page.rows(MOST_ROWS))];
    let mut sentences: Vec<String> = match record.by_group.len() - rows.len() {
        0 => Vec::new(),
        n => vec![format!("And {} more, in fit.json.", count(n, "group"))],
    };
    sentences.extend(differ);
    page.section(&format!("Groups by {column}"), &(page.table(&columns(rows, &column)) + &page.items(&sentences)))
}

fn columns(rows: &[GroupRecord], column: &str) -> Vec<TextColumn> {
    let each = |of: &dyn Fn(&GroupRecord) -> Option<String>| -> Vec<String> {
        rows.iter().map(|group| of(group).unwrap_or_else(|| "-".to_owned())).collect()
    };
    let mut columns = vec![
        TextColumn::new(
            column,
            ColumnSide::Left,
            each(&|g| Some(g.group.as_deref().map_or_else(|| "(none)".to_owned(), clean))),
        ),
        figures::column(GroupRecord::tests, rows),
    ];
    if rows.iter().any(|group| group.innovations > 0) {
        let square = |g: &GroupRecord| {
            let (square, spread) = (g.innovations_mean_square?, (2.0 / g.innovations.max(1) as f64).sqrt());
            Some(FigurePrecision::of(square, Some(spread)).show(square))
        };
        columns.push(TextColumn::new("mean square", ColumnSide::Right, each(&square)));
        columns.push(figures::column(GroupRecord::innovations_p_value, rows));
    }
    let of_distance = [GroupRecord::distance, GroupRecord::degrees_of_freedom, GroupRecord::p_value];
    columns.extend(figures::columns(&of_distance, rows));
    columns
}

/// Whether groups differ, in one sentence.
fn differ(test: &GroupTestRecord) -> String {
    let bound = if test.on_boundary { " at most" } else { "" };
    let verdict = if test.p_value < 0.05 { "The groups differ" } else { "No difference between the groups was found" };
    format!(
        "{verdict}: p = {}{bound} (likelihood-ratio test of a mean and covariance for each of the {} groups against common ones: {} \
         with {} degrees of freedom).",
        probability(test.p_value),
        test.groups,
        plain(test.statistic, 3),
        test.degrees_of_freedom
    )
}
