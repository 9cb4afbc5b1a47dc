//! Tables without rules: columns set apart by two spaces, two spaces in front. A column without a heading belongs to the
//! one before it and stands closer.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ColumnConstraint, ContentArrangement, Table, Width};

use maud::html;

use crate::words::clean;

const INDENT: usize = 2;
const GAP: u16 = 2;
/// A name wider than this goes on in the next line of its cell.
const WIDEST_NAME: u16 = 36;

/// Side a column leans to: names left, figures right.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ColumnSide {
    Left,
    Right,
}

/// One column: its heading, its side, its cells.
#[derive(Debug, Clone)]
pub(crate) struct TextColumn {
    heading: String,
    side: ColumnSide,
    cells: Vec<String>,
}

impl TextColumn {
    pub(crate) fn new(heading: &str, side: ColumnSide, cells: Vec<String>) -> TextColumn {
        TextColumn { heading: clean(heading), side, cells: cells.iter().map(|c| clean(c)).collect() }
    }

    fn width(&self) -> usize {
        let widest = self.cells.iter().map(|c| c.chars().count()).max().unwrap_or(0);
        widest.max(self.heading.chars().count()).min(usize::from(WIDEST_NAME)).max(1) + usize::from(GAP)
    }

    /// Its heading needs no second line.
    fn is_brief(&self) -> bool {
        self.heading.chars().count() <= 12
    }

    fn is_empty(&self) -> bool {
        self.cells.iter().all(String::is_empty)
    }
}

/// The columns side by side, each line ended. Columns without any cell filled are left out.
pub(crate) fn table(columns: &[TextColumn], width: usize) -> String {
    let columns: Vec<&TextColumn> = columns.iter().filter(|c| !c.is_empty()).collect();
    let rows = columns.iter().map(|c| c.cells.len()).max().unwrap_or(0);
    let mut table = Table::new();
    table.load_style(NOTHING).set_content_arrangement(ContentArrangement::Dynamic);
    table.set_width(u16::try_from(width.saturating_sub(INDENT)).unwrap_or(u16::MAX));
    table.set_header(columns.iter().map(|c| c.heading.clone()).collect::<Vec<String>>());
    for row in 0..rows {
        table.add_row(columns.iter().map(|c| c.cells.get(row).cloned().unwrap_or_default()).collect::<Vec<String>>());
    }
    for (i, (column, shape)) in columns.iter().zip(table.column_iter_mut()).enumerate() {
        let belongs = columns.get(i + 1).is_some_and(|next| next.heading.is_empty());
        shape.set_padding((0, if belongs { 1 } else { GAP }));
        shape.set_cell_alignment(match column.side {
            ColumnSide::Left => CellAlignment::Left,
            ColumnSide::Right => CellAlignment::Right,
        });
        shape.set_constraint(ColumnConstraint::UpperBoundary(Width::Fixed(WIDEST_NAME + GAP)));
    }
    table.lines().map(|line| format!("{}{}\n", " ".repeat(INDENT), line.trim_end()).replace("  \n", "\n")).collect()
}

/// A table too wide for the page as several, one below the other: `first` leads each, with as many of the others as fit. Rows
/// for which no column of a part has a cell filled are left out of that part.
pub(crate) fn wide_table(first: &TextColumn, others: &[TextColumn], width: usize) -> String {
    let room = width.saturating_sub(INDENT + first.width());
    let mut parts: Vec<Vec<&TextColumn>> = Vec::new();
    let mut used = usize::MAX;
    for column in others.iter().filter(|c| !c.is_empty()) {
        if used.saturating_add(column.width()) > room {
            parts.push(Vec::new());
            used = 0;
        }
        used += column.width();
        parts.last_mut().expect("a part was just opened").push(column);
    }
    let part = |columns: &Vec<&TextColumn>| {
        let rows: Vec<usize> = (0..first.cells.len())
            .filter(|&row| columns.iter().any(|c| c.cells.get(row).is_some_and(|cell| !cell.is_empty())))
            .collect();
        let pick = |c: &TextColumn| TextColumn {
            cells: rows.iter().map(|&row| c.cells.get(row).cloned().unwrap_or_default()).collect(),
            ..c.clone()
        };
        let picked: Vec<TextColumn> = std::iter::once(first).chain(columns.iter().copied()).map(pick).collect();
        table(&picked, width)
    };
    parts.iter().map(part).collect::<Vec<_>>().join("\n")
}

/// The columns as an HTML table that can be sorted by each: one heading for a column and those without a heading after it.
pub(crate) fn html(columns: &[TextColumn], sorted: bool) -> String {
    let columns: Vec<&TextColumn> =
        columns.iter().enumerate().filter(|(i, c)| *i == 0 || !c.is_empty()).map(|(_, c)| c).collect();
    let rows = columns.iter().map(|c| c.cells.len()).max().unwrap_or(0);
    let groups: Vec<&[&TextColumn]> = columns.chunk_by(|_, next| next.heading.is_empty()).collect();
    let side = |column: &TextColumn| if column.side == ColumnSide::Right { "figure" } else { "word" };
    let class = |column: &TextColumn, cell: &str| {
        let long = if cell.chars().count() > LONG { " long" } else { "" };
        let beside = if column.heading.is_empty() { " beside" } else { "" };
        format!("{}{long}{beside}", side(column))
    };
    let sortable = sorted && rows >= LEAST_SORTED;
    html! {
        div.scroll { table data-sortable[sortable] {
            thead { tr {
                @for group in &groups {
                    @if group[0].heading.is_empty() { td {} } @else {
                        th scope="col" class=(class(group[0], &group[0].heading)) data-brief[group[0].is_brief()]
                            colspan=[(group.len() > 1).then_some(group.len())] { (group[0].heading) }
                    }
                }
            } }
            tbody { @for row in 0..rows { tr {
                @for (i, column) in columns.iter().enumerate() {
                    @let cell = column.cells.get(row).map_or("", String::as_str);
                    @if i == 0 { th scope="row" class=(class(column, cell)) { (cell) } }
                    @else { td class=(class(column, cell)) { (cell) } }
                }
            } } }
        } }
    }
    .into_string()
}

/// Longer texts are broken into lines.
const LONG: usize = 36;
/// Shorter tables need no sorting.
const LEAST_SORTED: usize = 3;

#[cfg(test)]
mod tests {
    use super::*;

    fn column(heading: &str, side: ColumnSide, cells: &[&str]) -> TextColumn {
        TextColumn::new(heading, side, cells.iter().map(|&c| c.to_owned()).collect())
    }

    #[test]
    fn names_lean_left_and_figures_right() {
        let names = column("state", ColumnSide::Left, &["a", "slope"]);
        let empty = column("unit", ColumnSide::Left, &["", ""]);
        let figures = column("mean", ColumnSide::Right, &["1.25", "251.4"]);
        insta::assert_snapshot!(table(&[names, empty, figures], 80), @r"
          state   mean
          a       1.25
          slope  251.4
        ");
    }

    #[test]
    fn every_line_fits_however_narrow_the_page() {
        let long = "a_name_that_goes_on_and_on_and_on_without_an_end";
        let names = column("state", ColumnSide::Left, &[long, "b"]);
        let figures: Vec<TextColumn> =
            (0..12).map(|i| column(&format!("c{i}"), ColumnSide::Right, &["1.25 ± 0.1", "2"])).collect();
        for width in 60..120 {
            for line in wide_table(&names, &figures, width).lines() {
                assert!(line.chars().count() <= width, "{} > {width}: {line}", line.chars().count());
            }
        }
    }
}
