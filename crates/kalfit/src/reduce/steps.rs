//! Rows of a test as steps, and the cells that belong to a step or to the test as a whole.

use std::ops::Range;

use crate::ensemble::{Label, Test};
use crate::reduce::error::{Cell, ReduceErrorKind};
use crate::reduce::subject::{At, Fault, Subject, Uses};

/// One step of a test.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Span {
    /// Its rows.
    pub(crate) rows: Range<usize>,
    /// Time since the step before, at the first step since x_0; not a number when that is not known.
    pub(crate) dt: f64,
    /// A transition leads to it.
    pub(crate) moves: bool,
}

/// The steps of a test; `initial` is the time of x_0.
pub(crate) fn spans(at: &At<'_>, test: &Test, initial: Option<f64>, out: &mut Vec<Span>) -> Result<(), Box<Fault>> {
    out.clear();
    let clock = &at.model.clock;
    let Some(column) = clock.time else {
        let span = |row| Span { rows: row..row + 1, dt: 0.0, moves: row > 0 || clock.step_first };
        out.extend((0..test.rows()).map(span));
        return Ok(());
    };
    let mut previous = f64::NAN;
    for row in 0..test.rows() {
        let time = time(at, test, column, row)?;
        match out.last_mut() {
            Some(span) if time == previous => span.rows.end = row + 1,
            Some(_) if time < previous => {
                let kind = ReduceErrorKind::TimeBackwards { previous, time };
                return Err(Fault::new(Subject::Time, kind).on(row));
            }
            Some(_) => out.push(Span { rows: row..row + 1, dt: time - previous, moves: true }),
            None => out.push(first_span(clock.step_first, initial, time)?),
        }
        previous = time;
    }
    Ok(())
}

fn first_span(step_first: bool, initial: Option<f64>, time: f64) -> Result<Span, Box<Fault>> {
    let dt = match initial {
        Some(initial) if initial > time => {
            let kind = ReduceErrorKind::InitialTimeAfterStart { initial, first: time };
            return Err(Fault::new(Subject::InitialTime, kind).on(0));
        }
        Some(initial) => time - initial,
        None if step_first => f64::NAN,
        None => 0.0,
    };
    Ok(Span { rows: 0..1, dt, moves: step_first || dt > 0.0 })
}

fn time(at: &At<'_>, test: &Test, column: usize, row: usize) -> Result<f64, Box<Fault>> {
    let value = test.numbers(row)[column];
    if value.is_finite() {
        return Ok(value);
    }
    let column = at.model.columns[column].name.clone();
    let kind = if value.is_nan() {
        ReduceErrorKind::MissingCell { column }
    } else {
        ReduceErrorKind::InfiniteCell { column, value }
    };
    Err(Fault::new(Subject::Time, kind).on(row))
}

/// Cells gathered from several rows.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cells {
    pub(crate) numbers: Vec<f64>,
    pub(crate) texts: Vec<Label>,
}

impl Cells {
    /// For each used column the first cell of `rows` that is not missing. Two that differ are an error: they vary within the
    /// test when `whole`, else rows of one step disagree.
    pub(crate) fn gather(
        &mut self,
        at: &At<'_>,
        test: &Test,
        rows: Range<usize>,
        (uses, whole): (&Uses, bool),
    ) -> Result<(), Box<Fault>> {
        self.numbers.clear();
        self.numbers.resize(at.model.columns.len(), f64::NAN);
        self.texts.clear();
        self.texts.resize(at.model.text_columns.len(), Label::MISSING);
        let differ = |column: String, first: Cell, second: Cell, row: usize| {
            let (subject, kind) = if whole {
                (Subject::Test, ReduceErrorKind::Varies { column, first, second })
            } else {
                (Subject::Transition, ReduceErrorKind::StepConflict { column, first, second })
            };
            Err(Fault::new(subject, kind).on(row))
        };
        for row in rows {
            for &column in &uses.numbers {
                let (known, cell) = (self.numbers[column], test.numbers(row)[column]);
                if known.is_nan() {
                    self.numbers[column] = cell;
                } else if !cell.is_nan() && cell != known {
                    let name = at.model.columns[column].name.clone();
                    return differ(name, Cell::Number(known), Cell::Number(cell), row);
                }
            }
            for &column in &uses.texts {
                let (known, cell) = (self.texts[column], test.texts(row)[column]);
                if known.is_missing() {
                    self.texts[column] = cell;
                } else if !cell.is_missing() && cell != known {
                    let name = at.model.text_columns[column].name.clone();
                    return differ(name, Cell::Text(known), Cell::Text(cell), row);
                }
            }
        }
        Ok(())
    }
}
