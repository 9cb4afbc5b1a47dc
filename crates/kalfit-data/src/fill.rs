//! Rows into blocks, column by column.

use std::ops::Range;

use kalfit::Label;

use crate::block::RowBlock;
use crate::error::DataError;
use crate::moment::Moment;
use crate::numbering::RowNumbering;
use crate::wanted::{WantedColumn, WantedColumns};

/// A row that is wrong, and what is wrong with it.
pub(crate) type BadRow = (usize, DataError);

/// Rows of which every wanted column, by its number, is read by itself.
pub(crate) trait ColumnwiseRows {
    /// Number of rows.
    fn rows(&self) -> usize;

    /// Puts the numbers of a column, row after row, NaN where missing.
    fn numbers(&self, column: usize, put: impl FnMut(f64)) -> Result<(), BadRow>;

    /// Puts the times of a column, row after row.
    fn times(&self, column: usize, put: impl FnMut(Moment)) -> Result<(), BadRow>;

    /// The text in a row, written to `scratch` unless it is one already; `None` when it is missing.
    fn text<'t>(&'t self, column: usize, row: usize, scratch: &'t mut String) -> Result<Option<&'t str>, DataError>;

    /// The first row after this one that may have another text.
    fn change(&self, column: usize, row: usize) -> usize;

    /// The error of a row without the id of its test.
    fn without_id(&self, column: usize, row: usize) -> DataError;
}

/// The first row of a range with another value than its first one; the end when there is none.
pub(crate) fn change<T: PartialEq>(rows: Range<usize>, value: impl Fn(usize) -> T) -> usize {
    let first = value(rows.start);
    (rows.start + 1..rows.end).find(|&row| value(row) != first).unwrap_or(rows.end)
}

/// Fills a block.
pub(crate) struct BlockFiller<'a> {
    wanted: &'a WantedColumns,
    block: RowBlock,
}

/// The first of all errors: by its row, then by the column.
#[derive(Default)]
struct FirstError(Option<((usize, usize), DataError)>);

impl FirstError {
    fn note(&mut self, column: usize, read: Result<(), BadRow>) {
        let Err((row, error)) = read else { return };
        if self.0.as_ref().is_none_or(|(first, _)| (row, column) < *first) {
            self.0 = Some(((row, column), error));
        }
    }

    /// The rows before the error.
    fn sound(&self, rows: usize) -> usize {
        self.0.as_ref().map_or(rows, |((row, _), _)| *row)
    }

    /// The rows that may still have an error before this one.
    fn open(&self, rows: usize) -> usize {
        rows.min(self.sound(rows) + 1)
    }
}

impl<'a> BlockFiller<'a> {
    /// A block of about so many rows, none yet.
    pub(crate) fn new(wanted: &'a WantedColumns, rows: usize) -> BlockFiller<'a> {
        let numbers = Vec::with_capacity(wanted.numbers * rows);
        let texts = Vec::with_capacity(wanted.texts * rows);
        let clock = wanted.time().map_or_else(Vec::new, |column| column.numbers.clone());
        BlockFiller { wanted, block: RowBlock { numbers, texts, width: wanted.numbers, clock, ..RowBlock::default() } }
    }

    /// Appends rows, up to the first that is wrong.
    ///
    /// # Errors
    /// What is wrong with it, first by the order of the wanted columns.
    pub(crate) fn fill(&mut self, columns: &impl ColumnwiseRows) -> Result<(), BadRow> {
        let (wanted, rows) = (self.wanted, columns.rows());
        self.block.numbers.resize((self.block.rows + rows) * wanted.numbers, f64::NAN);
        self.block.texts.resize((self.block.rows + rows) * wanted.texts, Label::MISSING);
        let mut first = FirstError::default();
        for (at, column) in wanted.columns.iter().enumerate() {
            if column.is_number() {
                first.note(at, self.numbers(columns, (at, column)));
            }
            if column.is_time {
                let mut row = self.block.rows;
                let put = |time| {
                    self.block.push_time(row, time);
                    row += 1;
                };
                first.note(at, columns.times(at, put));
            }
        }
        match wanted.ids[..] {
            [] => {}
            [at] => first.note(at, self.ids(columns, at, first.open(rows))),
            _ => {
                if let Err((at, bad)) = self.joined_ids(columns, first.open(rows)) {
                    first.note(at, Err(bad));
                }
            }
        }
        if let Err((at, bad)) = self.labels(columns, first.open(rows)) {
            first.note(at, Err(bad));
        }
        self.block.rows += first.sound(rows);
        first.0.map_or(Ok(()), |((row, _), error)| Err((row, error)))
    }

    /// The block of the sound rows, which have these numbers in the file, and what is wrong with the row after them.
    pub(crate) fn finish(self, numbering: RowNumbering, end: Option<DataError>) -> RowBlock {
        let mut block = RowBlock { numbering, end, ..self.block };
        block.numbers.truncate(block.rows * self.wanted.numbers);
        block.texts.truncate(block.rows * self.wanted.texts);
        block.moments.truncate(block.rows);
        block.ids.truncate(block.rows);
        block
    }

    fn numbers(&mut self, columns: &impl ColumnwiseRows, (at, column): (usize, &WantedColumn)) -> Result<(), BadRow> {
        let width = self.wanted.numbers;
        let mut rows = self.block.numbers[self.block.rows * width..].chunks_exact_mut(width);
        columns.numbers(at, |value| {
            let Some(row) = rows.next() else { return };
            column.numbers.iter().for_each(|&cell| row[cell] = value);
        })
    }

    fn ids(&mut self, columns: &impl ColumnwiseRows, at: usize, rows: usize) -> Result<(), BadRow> {
        let (mut row, mut scratch) = (0, String::new());
        while row < rows {
            let id = columns.text(at, row, &mut scratch).map_err(|error| (row, error))?;
            let id = id.ok_or_else(|| (row, columns.without_id(at, row)))?;
            self.block.ids.push(self.block.rows + row, id, &self.wanted.hasher);
            row = columns.change(at, row);
        }
        Ok(())
    }

    /// Ids of several columns: their texts with `/` between.
    fn joined_ids(&mut self, columns: &impl ColumnwiseRows, rows: usize) -> Result<(), (usize, BadRow)> {
        // of each column: the row up to which its text stands, so that no row is looked through twice
        let mut parts: Vec<(usize, usize)> = self.wanted.ids.iter().map(|&at| (at, 0)).collect();
        let (mut row, mut scratch, mut id) = (0, String::new(), String::new());
        while row < rows {
            id.clear();
            for (at, change) in &mut parts {
                let text = columns.text(*at, row, &mut scratch).map_err(|error| (*at, (row, error)))?;
                let text = text.ok_or_else(|| (*at, (row, columns.without_id(*at, row))))?;
                if row == *change {
                    *change = columns.change(*at, row);
                }
                if !id.is_empty() {
                    id.push('/');
                }
                id.push_str(text);
            }
            self.block.ids.push(self.block.rows + row, &id, &self.wanted.hasher);
            row = parts.iter().map(|(_, change)| *change).min().unwrap_or(rows);
        }
        Ok(())
    }

    /// Texts go row by row: labels are numbered in the order of their first appearance.
    fn labels(&mut self, columns: &impl ColumnwiseRows, rows: usize) -> Result<(), (usize, BadRow)> {
        let texts = self.wanted.columns.iter().enumerate().filter(|(_, column)| !column.texts.is_empty());
        // of each column: its label, and the row up to which it stands
        let mut texts: Vec<_> = texts.map(|(at, column)| (at, &column.texts, Label::MISSING, 0)).collect();
        let mut scratch = String::new();
        let rows = if texts.is_empty() { 0 } else { rows };
        for row in 0..rows {
            let first = (self.block.rows + row) * self.wanted.texts;
            for (at, cells, label, change) in &mut texts {
                if row == *change {
                    let text = columns.text(*at, row, &mut scratch).map_err(|error| (*at, (row, error)))?;
                    *label = text.map_or(Label::MISSING, |text| self.label(text, *label));
                    *change = columns.change(*at, row);
                }
                cells.iter().for_each(|&cell| self.block.texts[first + cell] = *label);
            }
        }
        Ok(())
    }

    /// The label of a text, which is looked up only when it is not the last one's.
    fn label(&mut self, text: &str, last: Label) -> Label {
        let labels = &mut self.block.labels;
        if labels.text(last) == text { last } else { labels.intern(text) }
    }
}

#[cfg(test)]
mod tests {
    use std::hash::RandomState;

    use kalfit::Labels;

    use super::*;
    use crate::cell::MissingTexts;

    /// Cells of text, column by column: one of ids, one of numbers, two of labels. A cell `bad` is wrong.
    struct TextSheet([[&'static str; 5]; 4]);

    impl ColumnwiseRows for TextSheet {
        fn rows(&self) -> usize {
            5
        }

        fn numbers(&self, column: usize, put: impl FnMut(f64)) -> Result<(), BadRow> {
            let read = |(row, text): (usize, &&str)| text.parse().map_err(|_| (row, error(column, row)));
            self.0[column].iter().enumerate().map(read).collect::<Result<Vec<f64>, _>>()?.into_iter().for_each(put);
            Ok(())
        }

        fn times(&self, _: usize, _: impl FnMut(Moment)) -> Result<(), BadRow> {
            Ok(())
        }

        fn text<'t>(&'t self, column: usize, row: usize, _: &'t mut String) -> Result<Option<&'t str>, DataError> {
            let text = self.0[column][row];
            if text == "bad" { Err(error(column, row)) } else { Ok(Some(text).filter(|text| *text != "NA")) }
        }

        fn change(&self, column: usize, row: usize) -> usize {
            change(row..5, |row| self.0[column][row])
        }

        fn without_id(&self, column: usize, row: usize) -> DataError {
            error(column, row)
        }
    }

    fn error(column: usize, row: usize) -> DataError {
        DataError::Empty { file: format!("row {row}, column {column}") }
    }

    fn wanted() -> WantedColumns {
        let column = |is_test, numbers: &[usize], texts: &[usize]| WantedColumn {
            name: String::new(),
            used_in: String::new(),
            numbers: numbers.to_vec(),
            texts: texts.to_vec(),
            is_test,
            is_group: false,
            is_time: false,
        };
        let columns =
            vec![column(true, &[], &[]), column(false, &[0], &[]), column(false, &[], &[0]), column(false, &[], &[1])];
        WantedColumns {
            columns,
            numbers: 1,
            texts: 2,
            ids: vec![0],
            groups: Vec::new(),
            tokens: MissingTexts::default(),
            comment: None,
            hasher: RandomState::new(),
        }
    }

    const SOUND: [[&str; 5]; 4] = [
        ["a", "a", "b", "", "b"],
        ["2", "3", "7", "8", "9"],
        ["same", "same", "same", "same", "same"],
        ["x", "y", "x", "x", "NA"],
    ];

    #[test]
    fn a_block_has_the_rows_that_were_filled() {
        let wanted = wanted();
        let mut filler = BlockFiller::new(&wanted, 10);
        assert!(filler.fill(&TextSheet(SOUND)).is_ok() && filler.fill(&TextSheet(SOUND)).is_ok());
        let mut block = filler.finish(RowNumbering::from(2), None);
        let run = |run: usize| (block.run(run).0, block.run(run).1.map(|(id, _)| id));
        let runs: Vec<_> = (0..block.runs()).map(run).collect();
        let (a, b, none) = (Some("a"), Some("b"), Some(""));
        assert_eq!(runs[..4], [(0..2, a), (2..3, b), (3..4, none), (4..5, b)]);
        assert_eq!(runs[4..], [(5..7, a), (7..8, b), (8..9, none), (9..10, b)]);
        assert_eq!(block.numbers, [2.0, 3.0, 7.0, 8.0, 9.0, 2.0, 3.0, 7.0, 8.0, 9.0]);
        let mut labels = Labels::new(&["y".to_owned()]);
        block.relabel(&mut labels);
        let texts: Vec<&str> = block.texts[10..].iter().map(|label| labels.text(*label)).collect();
        assert_eq!(texts, ["same", "x", "same", "y", "same", "x", "same", "x", "same", ""]);
        assert_eq!(labels.texts(), ["y", "same", "x"]);
    }

    #[test]
    fn ids_of_several_columns_are_joined() {
        let wanted = WantedColumns { ids: vec![2, 0], ..wanted() };
        let mut sheet = SOUND;
        sheet[0][3] = "b";
        let mut filler = BlockFiller::new(&wanted, 5);
        assert!(filler.fill(&TextSheet(sheet)).is_ok());
        let block = filler.finish(RowNumbering::from(2), None);
        let run = |run: usize| (block.run(run).0, block.run(run).1.map(|(id, _)| id));
        let runs: Vec<_> = (0..block.runs()).map(run).collect();
        assert_eq!(runs, [(0..2, Some("same/a")), (2..5, Some("same/b"))]);
        for (at, text) in [(2, "NA"), (0, "bad")] {
            sheet[at][3] = text;
            let mut filler = BlockFiller::new(&wanted, 5);
            let (row, found) = filler.fill(&TextSheet(sheet)).expect_err("a cell is wrong");
            assert_eq!((row, found.to_string()), (3, error(at, 3).to_string()));
            sheet = SOUND;
        }
    }

    #[test]
    fn the_first_error_is_that_of_the_first_row_and_of_its_first_column() {
        for (bad, expected) in [
            (&[(4, 0), (3, 3), (3, 1)][..], (3, 1)),
            (&[(2, 3), (2, 2), (3, 0)], (2, 2)),
            (&[(1, 3), (2, 1)], (1, 3)),
            (&[(0, 0), (0, 1)], (0, 0)),
        ] {
            let mut sheet = SOUND;
            bad.iter().for_each(|&(row, column)| sheet[column][row] = "bad");
            let wanted = wanted();
            let mut filler = BlockFiller::new(&wanted, 5);
            let (row, found) = filler.fill(&TextSheet(sheet)).expect_err("a cell is wrong");
            assert_eq!((row, found.to_string()), (expected.0, error(expected.1, expected.0).to_string()));
            let block = filler.finish(RowNumbering::from(1), None);
            let rows = if block.runs() == 0 { 0 } else { block.run(block.runs() - 1).0.end };
            assert_eq!((block.rows, block.numbers.len(), block.texts.len(), rows), (row, row, 2 * row, row));
        }
    }
}
