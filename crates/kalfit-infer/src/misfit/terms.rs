//! The mean terms that are tested: functions of inputs and steps alone, not of states.

use std::collections::BTreeSet;

use kalfit_model::{Expression, Model, PhasedModel, PhasedTest, Test};

use crate::misfit::probe::rows;

/// Most values of an input that each have a level of their own.
const MAX_VALUES: usize = 12;
/// Number of bins of an input with more values.
const BINS: usize = 8;
/// Most inputs of a measurement.
const MAX_INPUTS: usize = 6;

/// Which mean term.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TermKind {
    /// A level of each value, or of each of some intervals, of the numeric column with this index.
    Levels(usize),
    /// The square of the column with this index.
    Square(usize),
    /// The changes of the column with this index since the row before and to the row after: an input that is early or late.
    Change(usize),
    /// A level of each part of the record: the rows of all tests in parts by their number in the record.
    Record,
    /// The mean innovation of each step, or of each time, that tests share.
    Steps,
    /// Correlation between tests at the steps, or times, that they share.
    Shared,
}

/// A mean term of one measurement.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Term {
    pub(super) phase: usize,
    pub(super) measurement: usize,
    pub(super) kind: TermKind,
    /// Lower limits of the levels but the first.
    limits: Vec<f64>,
    /// Range of the values of each column.
    pub(super) ranges: Vec<[f64; 2]>,
    /// Centre of a square, and what a value is divided by.
    centre: f64,
    size: f64,
}

/// The terms for every measurement. `probe`: the model of the tests.
pub(super) fn candidates(probe: &PhasedModel, model: &PhasedModel, tests: &[PhasedTest]) -> Vec<Term> {
    let mut all = Vec::new();
    for (phase, (own, original)) in probe.phases.iter().zip(&model.phases).enumerate() {
        let inputs = inputs(&original.model);
        for (measurement, meter) in own.model.measurements.iter().enumerate() {
            let seen = |of: &dyn Fn(&[f64], usize) -> f64| values(tests, phase, meter.column, of);
            let own = |kind, values: &[f64]| Term::of((phase, measurement), kind, values);
            for &column in inputs.iter().take(MAX_INPUTS) {
                let values = seen(&|numbers, _| numbers[column]);
                all.extend(own(TermKind::Levels(column), &values));
                all.extend(own(TermKind::Square(column), &values));
                if varies_within(tests, phase, column) {
                    all.extend(own(TermKind::Change(column), &values));
                }
            }
            all.extend(own(TermKind::Record, &seen(&|_, row| row as f64)));
        }
    }
    all
}

impl Term {
    /// `None` where the values do not allow the term.
    fn of((phase, measurement): (usize, usize), kind: TermKind, values: &[f64]) -> Option<Term> {
        let mut sorted: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let runs = sorted.chunk_by(|a, b| a == b);
        // more tell no more than that they are many
        let distinct: Vec<f64> = runs.take(MAX_VALUES + 1).map(|run| run[0]).collect();
        let (&least, last) = (distinct.first()?, *sorted.last()?);
        let largest = sorted[sorted.partition_point(|x| *x < last)];
        let size = (largest - least).abs();
        let few = distinct.len() <= MAX_VALUES;
        let limits = match kind {
            // with few rows the steps have a test of their own
            TermKind::Record if few => return None,
            TermKind::Levels(_) | TermKind::Record => limits(&sorted, &distinct, few),
            TermKind::Square(_) if distinct.len() < 3 => return None,
            TermKind::Square(_) | TermKind::Change(_) | TermKind::Steps | TermKind::Shared => Vec::new(),
        };
        if size <= 0.0 || !size.is_finite() {
            return None;
        }
        let centre = least + 0.5 * size;
        if let TermKind::Change(_) = kind {
            let ranges = vec![[least, largest]; 2];
            return Some(Term { phase, measurement, kind, limits, ranges, centre, size });
        }
        let mut ranges = vec![[f64::INFINITY, f64::NEG_INFINITY]; limits.len() + 1];
        let term = Term { phase, measurement, kind, limits, ranges: Vec::new(), centre, size };
        for &x in &sorted {
            let range = &mut ranges[term.level(x)];
            *range = [range[0].min(x), range[1].max(x)];
        }
        Some(Term { ranges, ..term })
    }

    /// Number of columns of the term.
    pub(super) fn width(&self) -> usize {
        self.ranges.len()
    }

    fn level(&self, x: f64) -> usize {
        self.limits.partition_point(|limit| *limit <= x)
    }

    /// Value of a column of the term in a row of a test.
    pub(super) fn value(&self, column: usize, row: usize, test: &Test) -> f64 {
        let share = |x: f64| (x - self.centre) / self.size;
        let now = test.numbers(row);
        let value = match self.kind {
            TermKind::Levels(input) => f64::from(u8::from(self.level(now[input]) == column)),
            TermKind::Record => f64::from(u8::from(self.level(row as f64) == column)),
            TermKind::Square(input) => share(now[input]).powi(2),
            TermKind::Change(input) => {
                let pair =
                    if column == 0 { row.checked_sub(1).map(|before| [before, row]) } else { Some([row, row + 1]) };
                let pair = pair.filter(|[_, later]| *later < test.rows());
                pair.map_or(0.0, |pair| {
                    let [earlier, later] = pair.map(|row| test.numbers(row)[input]);
                    share(later) - share(earlier)
                })
            }
            TermKind::Steps | TermKind::Shared => 0.0,
        };
        if value.is_finite() { value } else { 0.0 }
    }
}

/// Lower limits of all levels but the first.
fn limits(sorted: &[f64], distinct: &[f64], few: bool) -> Vec<f64> {
    if few {
        return distinct[1..].to_vec();
    }
    let mut limits: Vec<f64> = (1..BINS).map(|bin| sorted[bin * sorted.len() / BINS]).collect();
    limits.dedup();
    limits.retain(|limit| *limit > sorted[0]);
    limits
}

/// The numeric columns that coefficients of a model read, without those that are measured.
fn inputs(model: &Model) -> Vec<usize> {
    let mut found = BTreeSet::new();
    for (_, expression) in model.expressions() {
        expression.any(&mut |part| {
            if let Expression::Column(column) = part {
                found.insert(*column);
            }
            false
        });
    }
    found.extend(model.mean.regression.iter().map(|regression| regression.column));
    model.measurements.iter().for_each(|meter| {
        found.remove(&meter.column);
    });
    if let Some(time) = model.clock.time {
        found.remove(&time);
    }
    found.into_iter().collect()
}

/// Values of a function of (cells of the row, number of the row) in the rows of a phase that have the measurement.
fn values(tests: &[PhasedTest], phase: usize, measured: usize, of: &dyn Fn(&[f64], usize) -> f64) -> Vec<f64> {
    let rows = tests.iter().filter_map(|test| rows(test).nth(phase));
    let cells = rows.flat_map(|rows| (0..rows.rows()).map(move |row| (rows.numbers(row), row)));
    let mut found = Vec::with_capacity(tests.iter().map(PhasedTest::row_count).sum());
    found.extend(cells.filter(|(numbers, _)| !numbers[measured].is_nan()).map(|(numbers, row)| of(numbers, row)));
    found
}

fn varies_within(tests: &[PhasedTest], phase: usize, column: usize) -> bool {
    tests.iter().filter_map(|test| rows(test).nth(phase)).any(|rows| {
        (1..rows.rows()).any(|row| rows.numbers(row)[column].to_bits() != rows.numbers(0)[column].to_bits())
    })
}
