//! Rows of a test as steps, and the cells that belong to a step or to the test as a whole.

use std::ops::Range;

use crate::reduce::error::{Cell, ReduceErrorKind};
use crate::reduce::subject::{Fault, ModelAt, Subject, Uses};
use kalfit_model::{Label, Test};

/// Successive steps of a test with the same length and the same number of rows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StepSpan {
    /// Rows of all steps, the same number for each step.
    pub(crate) rows: Range<usize>,
    /// Number of steps.
    pub(crate) count: usize,
    /// Length of each step. The first step of a test begins at the time of x_0; the length is NaN where that time is
    /// unknown.
    pub(crate) dt: f64,
    /// Whether a transition leads to each step.
    pub(crate) moves: bool,
}

impl StepSpan {
    /// Number of rows of each step.
    pub(crate) fn height(&self) -> usize {
        self.rows.len() / self.count
    }

    /// The rows of step `number` of the span, counted from 0.
    pub(crate) fn step(&self, number: usize) -> Range<usize> {
        let first = self.rows.start + number * self.height();
        first..first + self.height()
    }

    fn is_followed_by(&self, rows: &Range<usize>) -> bool {
        self.rows.end == rows.start && self.height() == rows.len()
    }
}

/// Largest error of a step's length due to rounded times, as a fraction of max(|start|, |end|) of the step.
const TIME_ROUNDING: f64 = 2.0 * f64::EPSILON;
/// Largest rounding error, as a fraction of a step's length, at which unequal lengths may count as equal.
const MOST_RELATIVE_ROUNDING: f64 = 1e-3;
/// Least mean length of steps, in units in the last place of the times, that is accurate enough to be used.
const LEAST_STEP_UNITS: f64 = 16.0;

/// Steps that are equal to within the rounding of the times: one length is within the bounds of all steps.
#[derive(Debug, Clone, Copy)]
struct Uniform {
    /// Time at which the first step begins.
    start: f64,
    last: f64,
    /// Length of the first step.
    dt: f64,
    /// Whether all lengths equal `dt`, bit for bit.
    exact: bool,
    least: f64,
    most: f64,
    count: usize,
    /// Index of the first step's span in the list of spans.
    span: usize,
}

impl Uniform {
    fn new(start: f64, time: f64, span: usize) -> Uniform {
        let dt = time - start;
        let slack = slack(start, time);
        Uniform { start, last: time, dt, exact: true, least: dt - slack, most: dt + slack, count: 1, span }
    }

    /// Adds the step that ends at `time`, if the length can be the common length; returns whether the step was added.
    fn take(&mut self, time: f64) -> bool {
        let (dt, slack) = (time - self.last, slack(self.last, time));
        let (least, most) = (self.least.max(dt - slack), self.most.min(dt + slack));
        if least > most || dt.is_nan() {
            return false;
        }
        self.exact &= dt == self.dt;
        (self.least, self.most, self.last) = (least, most, time);
        self.count += 1;
        true
    }

    /// The common length of the steps: the mean length, so that the steps add up to the whole time.
    fn length(&self) -> f64 {
        if self.exact { self.dt } else { (self.last - self.start) / self.count as f64 }
    }
}

/// Bound on the error of a step's length due to rounded times; 0 where the bound is no small fraction of the length.
fn slack(start: f64, end: f64) -> f64 {
    let slack = TIME_ROUNDING * start.abs().max(end.abs());
    if slack <= MOST_RELATIVE_ROUNDING * (end - start) { slack } else { 0.0 }
}

/// Writes the steps of a test to `out`; `initial` is the time of x_0.
///
/// Times are written as decimals or computed as sums, so steps of one length differ in the last digits: lengths that
/// could be equal are made equal, and all other lengths stay as they are.
pub(crate) fn spans(
    at: &ModelAt<'_>,
    test: &Test,
    initial: Option<f64>,
    out: &mut Vec<StepSpan>,
) -> Result<(), Box<Fault>> {
    out.clear();
    let clock = &at.model.clock;
    let Some(column) = clock.time else {
        out.push(StepSpan { rows: 0..1, count: 1, dt: 0.0, moves: clock.step_first });
        if test.rows() > 1 {
            out.push(StepSpan { rows: 1..test.rows(), count: test.rows() - 1, dt: 0.0, moves: true });
        }
        return Ok(());
    };
    let mut next = time(at, test, column, 0)?;
    out.push(first_span(clock.step_first, initial, next)?);
    let mut uniform: Option<Uniform> = None;
    let (start, mut steps) = (next, 0);
    let (mut row, mut previous) = (0, f64::NAN);
    while row < test.rows() {
        let (first, now) = (row, next);
        row += 1;
        while row < test.rows() && next == now {
            next = time(at, test, column, row)?;
            row += usize::from(next == now);
        }
        if first == 0 {
            out[0].rows = 0..row;
        } else {
            append(first..row, (previous, now), &mut uniform, out);
            steps += 1;
        }
        if row < test.rows() && next < now {
            let kind = ReduceErrorKind::TimeBackwards { previous: now, time: next };
            return Err(Fault::new(Subject::Time, kind).on(row));
        }
        previous = now;
    }
    set_common_length(uniform, out);
    check_resolution(start, previous, steps)
}

/// Checks that doubles from `start` to `end` resolve `steps` steps: mean length ≥ [`LEAST_STEP_UNITS`] × ε ×
/// max(|start|, |end|).
fn check_resolution(start: f64, end: f64, steps: usize) -> Result<(), Box<Fault>> {
    let (step, grid) = ((end - start) / steps as f64, f64::EPSILON * start.abs().max(end.abs()));
    if steps == 0 || step >= LEAST_STEP_UNITS * grid {
        return Ok(());
    }
    Err(Fault::new(Subject::Time, ReduceErrorKind::TimesTooLarge { time: end, grid, step }).on(0))
}

/// Appends a step from one time to another.
fn append(rows: Range<usize>, (start, end): (f64, f64), uniform: &mut Option<Uniform>, out: &mut Vec<StepSpan>) {
    if !uniform.as_mut().is_some_and(|steps| steps.take(end)) {
        set_common_length(uniform.replace(Uniform::new(start, end, out.len())), out);
    } else if let Some(span) = out.last_mut().filter(|span| span.is_followed_by(&rows)) {
        span.rows.end = rows.end;
        span.count += 1;
        return;
    }
    out.push(StepSpan { rows, count: 1, dt: f64::NAN, moves: true });
}

/// Sets the length of equal steps to the common length.
fn set_common_length(uniform: Option<Uniform>, out: &mut [StepSpan]) {
    if let Some(uniform) = uniform {
        out[uniform.span..].iter_mut().for_each(|span| span.dt = uniform.length());
    }
}

fn first_span(step_first: bool, initial: Option<f64>, time: f64) -> Result<StepSpan, Box<Fault>> {
    let dt = match initial {
        Some(initial) if initial > time => {
            let kind = ReduceErrorKind::InitialTimeAfterStart { initial, first: time };
            return Err(Fault::new(Subject::InitialTime, kind).on(0));
        }
        Some(initial) => time - initial,
        None if step_first => f64::NAN,
        None => 0.0,
    };
    Ok(StepSpan { rows: 0..1, count: 1, dt, moves: step_first || dt > 0.0 })
}

fn time(at: &ModelAt<'_>, test: &Test, column: usize, row: usize) -> Result<f64, Box<Fault>> {
    at.cell(test.numbers(row), column, Subject::Time).map_err(|fault| fault.on(row))
}

/// Cells gathered from several rows.
#[derive(Debug, Clone, Default)]
pub struct GatheredCells {
    pub(crate) numbers: Vec<f64>,
    pub(crate) texts: Vec<Label>,
}

impl GatheredCells {
    /// Gathers for each used column the first cell of `rows` that is not missing. Two cells that differ are an error:
    /// the column varies within the test if `whole`, else rows of one step disagree.
    pub(crate) fn gather(
        &mut self,
        at: &ModelAt<'_>,
        test: &Test,
        rows: Range<usize>,
        (uses, whole): (&Uses, bool),
    ) -> Result<(), Box<Fault>> {
        self.numbers.clear();
        self.numbers.resize(at.model.columns.len(), f64::NAN);
        self.texts.clear();
        self.texts.resize(at.model.text_columns.len(), Label::MISSING);
        let mut conflict: Option<(usize, String, Cell, Cell)> = None;
        let mut differ = |row: usize, name: &str, first: Cell, second: Cell| {
            if conflict.as_ref().is_none_or(|(before, ..)| row < *before) {
                conflict = Some((row, name.to_owned(), first, second));
            }
        };
        for &column in &uses.numbers {
            let known = &mut self.numbers[column];
            for row in rows.clone() {
                let cell = test.numbers(row)[column];
                if known.is_nan() {
                    *known = cell;
                } else if !cell.is_nan() && cell != *known {
                    differ(row, &at.model.columns[column].name, Cell::Number(*known), Cell::Number(cell));
                    break;
                }
            }
        }
        for &column in &uses.texts {
            let known = &mut self.texts[column];
            for row in rows.clone() {
                let cell = test.texts(row)[column];
                if known.is_missing() {
                    *known = cell;
                } else if !cell.is_missing() && cell != *known {
                    differ(row, &at.model.text_columns[column].name, Cell::Text(*known), Cell::Text(cell));
                    break;
                }
            }
        }
        let Some((row, column, first, second)) = conflict else { return Ok(()) };
        let (subject, kind) = if whole {
            (Subject::Test, ReduceErrorKind::Varies { column, first, second })
        } else {
            (Subject::Transition, ReduceErrorKind::StepConflict { column, first, second })
        };
        Err(Fault::new(subject, kind).on(row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lengths(times: &[f64]) -> Vec<(usize, f64)> {
        let mut out = vec![StepSpan { rows: 0..1, count: 1, dt: 0.0, moves: false }];
        let mut uniform = None;
        for (k, pair) in times.windows(2).enumerate() {
            append(k + 1..k + 2, (pair[0], pair[1]), &mut uniform, &mut out);
        }
        set_common_length(uniform, &mut out);
        out[1..].iter().map(|span| (span.count, span.dt)).collect()
    }

    #[test]
    fn decimal_and_added_up_times_of_equal_steps_are_one_run_that_does_not_drift() {
        for (start, dt) in [(0.0, 0.01), (1e4, 0.1), (1.7e9, 0.5), (0.0, 1.0 / 3.0)] {
            let written: Vec<f64> = (0..100_000).map(|k| start + f64::from(k) * dt).collect();
            let mut added = vec![start];
            (0..100_000).for_each(|k| added.push(added[k] + dt));
            for times in [written, added] {
                let (found, whole) = (lengths(&times), times[times.len() - 1] - times[0]);
                assert_eq!(found.len(), 1, "steps of {dt} from {start}: {} runs", found.len());
                let (count, length) = found[0];
                let off = (count as f64 * length - whole).abs() / whole;
                assert!(off < 4e-16, "{count} steps of {length} against {whole}: {off:e}");
            }
        }
    }

    #[test]
    fn times_that_do_not_tell_their_steps_are_refused() {
        // nanoseconds since 1970: doubles of that size are 256 apart
        assert!(check_resolution(1.7e18, 1.7e18 + 119e9, 119).is_ok(), "steps of a second");
        let (start, end): (f64, f64) = (1.7e18, 1.7e18 + 12e3);
        let refused = check_resolution(start, end, 47).expect_err("steps of 100 ns");
        let kind = ReduceErrorKind::TimesTooLarge { time: end, grid: end * f64::EPSILON, step: (end - start) / 47.0 };
        assert_eq!(format!("{refused:?}"), format!("{:?}", Fault::new(Subject::Time, kind).on(0)));
        assert!(check_resolution(1e18, 1e18, 0).is_ok(), "one step has no length");
    }

    #[test]
    fn irregular_times_are_left_as_they_are() {
        // one digit in 1e12 is more than rounding; so is one tick between times in whole ticks
        let times = [0.0, 1.0, 2.000_000_000_01, 3.0, 4.0, 5.5];
        let exact: Vec<(usize, f64)> =
            vec![(1, 1.0), (1, 2.000_000_000_01 - 1.0), (1, 3.0 - 2.000_000_000_01), (1, 1.0), (1, 1.5)];
        assert_eq!(lengths(&times), exact);
        let ticks = [1e17, 1e17 + 16.0, 1e17 + 48.0, 1e17 + 80.0, 1e17 + 96.0];
        assert_eq!(lengths(&ticks), [(1, 16.0), (2, 32.0), (1, 16.0)]);
    }
}
