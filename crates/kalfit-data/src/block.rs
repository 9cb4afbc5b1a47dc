//! Rows of a table, decoded, on their way into tests.

use std::ops::Range;

use kalfit::{Label, Labels};

use crate::error::DataError;
use crate::moment::Moment;

/// Rows that stand one after the other in a table: the cells that the model and the layout name. Blocks are made by many
/// threads and taken in by one, in the order of the table.
#[derive(Debug, Default)]
pub(crate) struct Block {
    /// Number of rows.
    pub(crate) rows: usize,
    /// Numeric cells, row after row, NaN where missing; those of the time column are filled in when the first row of their test
    /// is known.
    pub(crate) numbers: Vec<f64>,
    /// Text cells, row after row: labels of `labels`, and of the whole reading after [`Block::relabel`].
    pub(crate) texts: Vec<Label>,
    /// Texts, in order of first appearance.
    labels: Labels,
    /// Times, with a time column.
    pub(crate) times: Vec<Moment>,
    ids: Ids,
    /// (row of the block, its number in the file as a person counts): the first of rows whose numbers follow each other.
    numbered: Vec<(usize, u64)>,
    /// What is wrong with the row after the last one.
    pub(crate) end: Option<DataError>,
}

/// Ids of tests: the first of rows of one test that follow each other, and where its id ends in `text`.
#[derive(Debug, Default)]
struct Ids {
    text: String,
    runs: Vec<(usize, usize)>,
}

/// Fills a block row by row: the cells of a row are set, and then it is complete.
pub(crate) struct Filler {
    block: Block,
    /// Cells of the row that is being filled.
    numbers: Vec<f64>,
    texts: Vec<Label>,
    time: Option<Moment>,
    /// Label of the text last seen in each column: texts are looked up only when they change.
    last: Vec<Option<Label>>,
}

impl Block {
    /// A block of no rows that ends with an error.
    pub(crate) fn failed(error: DataError) -> Block {
        Block { end: Some(error), ..Block::default() }
    }

    /// Turns the labels of the block into those of the whole reading.
    pub(crate) fn relabel(&mut self, labels: &mut Labels) {
        let known: Vec<Label> = self.labels.texts().iter().map(|text| labels.intern(text)).collect();
        let of = |label: Label| if label.is_missing() { label } else { known[label.index()] };
        self.texts.iter_mut().for_each(|label| *label = of(*label));
    }

    /// Number of runs of rows of one test.
    pub(crate) fn runs(&self) -> usize {
        if self.ids.runs.is_empty() { usize::from(self.rows > 0) } else { self.ids.runs.len() }
    }

    /// A run of rows of one test, and its id; `None` where no column holds ids.
    pub(crate) fn run(&self, run: usize) -> (Range<usize>, Option<&str>) {
        let Some(&(first, end)) = self.ids.runs.get(run) else { return (0..self.rows, None) };
        let start = if run == 0 { 0 } else { self.ids.runs[run - 1].1 };
        let next = self.ids.runs.get(run + 1).map_or(self.rows, |(next, _)| *next);
        (first..next, Some(&self.ids.text[start..end]))
    }

    /// Number of a row in its file.
    pub(crate) fn number(&self, row: usize) -> u64 {
        let run = self.numbered.partition_point(|(first, _)| *first <= row) - 1;
        let (first, number) = self.numbered[run];
        number + (row - first) as u64
    }

    /// Parts of a range of rows whose numbers follow each other: rows, and the number of the first.
    pub(crate) fn numbered(&self, rows: Range<usize>) -> impl Iterator<Item = (Range<usize>, u64)> + use<'_> {
        let first = self.numbered.partition_point(|(first, _)| *first <= rows.start).saturating_sub(1);
        (first..self.numbered.len()).map_while(move |run| {
            let (start, number) = self.numbered[run];
            let end = self.numbered.get(run + 1).map_or(self.rows, |(next, _)| *next);
            let part = start.max(rows.start)..end.min(rows.end);
            (part.start < part.end).then(|| (part.clone(), number + (part.start - start) as u64))
        })
    }
}

impl Filler {
    /// A block of about so many rows, of so many numeric and text cells each.
    pub(crate) fn new((numbers, texts): (usize, usize), columns: usize, rows: usize) -> Filler {
        let block = Block {
            numbers: Vec::with_capacity(numbers * rows),
            texts: Vec::with_capacity(texts * rows),
            ..Block::default()
        };
        Filler {
            block,
            numbers: vec![f64::NAN; numbers],
            texts: vec![Label::MISSING; texts],
            time: None,
            last: vec![None; columns],
        }
    }

    pub(crate) fn number(&mut self, cell: usize, value: f64) {
        self.numbers[cell] = value;
    }

    pub(crate) fn time(&mut self, time: Moment) {
        self.time = Some(time);
    }

    /// Sets text cells that one column fills.
    pub(crate) fn text(&mut self, column: usize, cells: &[usize], text: Option<&str>) {
        if cells.is_empty() {
            return;
        }
        let label = match text {
            None => Label::MISSING,
            Some(text) => {
                let last = self.last[column].filter(|last| self.block.labels.text(*last) == text);
                let label = last.unwrap_or_else(|| self.block.labels.intern(text));
                self.last[column] = Some(label);
                label
            }
        };
        cells.iter().for_each(|&cell| self.texts[cell] = label);
    }

    /// Sets the id of the row's test.
    pub(crate) fn id(&mut self, id: &str) {
        if self.is_id(id.as_bytes()) {
            return;
        }
        let Ids { text, runs } = &mut self.block.ids;
        text.push_str(id);
        runs.push((self.block.rows, text.len()));
    }

    /// True when the id of the last row is this one.
    pub(crate) fn is_id(&self, id: &[u8]) -> bool {
        let Ids { text, runs } = &self.block.ids;
        let Some(&(_, end)) = runs.last() else { return false };
        let start = runs.len().checked_sub(2).map_or(0, |before| runs[before].1);
        &text.as_bytes()[start..end] == id
    }

    /// Ends the row, which has this number in its file.
    pub(crate) fn end_row(&mut self, number: u64) {
        let block = &mut self.block;
        block.numbers.extend_from_slice(&self.numbers);
        block.texts.extend_from_slice(&self.texts);
        block.times.extend(self.time);
        let follows = block.numbered.last().is_some_and(|(first, n)| n + (block.rows - first) as u64 == number);
        if !follows {
            block.numbered.push((block.rows, number));
        }
        block.rows += 1;
    }

    /// The block of the complete rows. With an error, the row that was begun is left out.
    pub(crate) fn finish(self, end: Option<DataError>) -> Block {
        let mut block = self.block;
        if block.ids.runs.last().is_some_and(|(first, _)| *first >= block.rows) {
            block.ids.runs.pop();
        }
        Block { end, ..block }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_remembers_ids_numbers_and_texts_of_its_rows() {
        let mut filler = Filler::new((1, 2), 2, 4);
        for (number, id, text) in [(2, "a", "x"), (3, "a", "y"), (7, "b", "x"), (8, "", "x"), (9, "b", "")] {
            filler.number(0, number as f64);
            filler.text(0, &[0], Some("same"));
            filler.text(1, &[1], Some(text).filter(|text| !text.is_empty()));
            filler.id(id);
            filler.end_row(number);
        }
        filler.id("of a row that is not complete");
        let mut block = filler.finish(None);
        let runs: Vec<_> = (0..block.runs()).map(|run| block.run(run)).collect();
        assert_eq!(runs, [(0..2, Some("a")), (2..3, Some("b")), (3..4, Some("")), (4..5, Some("b"))]);
        assert_eq!((0..5).map(|row| block.number(row)).collect::<Vec<_>>(), [2, 3, 7, 8, 9]);
        assert_eq!(block.numbered(1..4).collect::<Vec<_>>(), [(1..2, 3), (2..4, 7)]);
        assert_eq!(block.numbered(4..5).collect::<Vec<_>>(), [(4..5, 9)]);
        let mut labels = Labels::new(&["y".to_owned()]);
        block.relabel(&mut labels);
        let texts: Vec<&str> = block.texts.iter().map(|label| labels.text(*label)).collect();
        assert_eq!(texts, ["same", "x", "same", "y", "same", "x", "same", "x", "same", ""]);
        assert_eq!(labels.texts(), ["y", "same", "x"]);
    }
}
