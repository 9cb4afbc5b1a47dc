//! Values of a measurement: piled up at their ends, on a lattice coarser than the noise, constant in a test.

use std::collections::BTreeMap;

use kalfit::model::Measurement;
use kalfit::record::plain;

use super::listed;

/// Different values that are counted one by one: more are no lattice, and no few.
const MOST_DIFFERENT: usize = 1 << 14;

/// Values that make a pile, at least, and how many times as many as at the values beside it.
const PILE: usize = 5;
const STANDS_OUT: usize = 3;

/// A lattice is looked for among so many pairs of successive values, at least.
const FEWEST_PAIRS: usize = 20;

/// A number in the order of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Ordered(f64);

impl Eq for Ordered {}

impl Ord for Ordered {
    fn cmp(&self, other: &Ordered) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

impl PartialOrd for Ordered {
    fn partial_cmp(&self, other: &Ordered) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// The values of one measurement.
#[derive(Default)]
pub(super) struct ValueSurvey {
    count: usize,
    /// How often each value stands, as long as there are few; none when there are many.
    different: Option<BTreeMap<Ordered, usize>>,
    is_many: bool,
    /// Successive values within tests whose record is not constant: all pairs, and equal ones.
    pairs: (usize, usize),
    low: ValueEnd,
    high: ValueEnd,
    /// Least noise variance of the rows.
    floor: Option<f64>,
    /// Tests of constant records, and how many values each has.
    constant: Vec<(String, usize)>,
    record: TestRecord,
}

/// The record of the test whose rows come.
#[derive(Default)]
struct TestRecord {
    values: usize,
    equal: usize,
    last: f64,
    low: ValueEnd,
    high: ValueEnd,
}

/// The least or the largest value, and how often it stands in records that are not constant.
#[derive(Debug, Clone, Copy, Default)]
struct ValueEnd {
    value: Option<f64>,
    count: usize,
}

impl ValueEnd {
    fn merge(&mut self, other: ValueEnd, is_beyond: fn(f64, f64) -> bool) {
        match (self.value, other.value) {
            (Some(a), Some(b)) if a == b => self.count += other.count,
            (Some(a), Some(b)) if !is_beyond(b, a) => {}
            (_, None) => {}
            _ => *self = other,
        }
    }
}

fn is_below(a: f64, b: f64) -> bool {
    a < b
}

fn is_above(a: f64, b: f64) -> bool {
    a > b
}

impl ValueSurvey {
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// A test begins.
    pub(super) fn begin(&mut self) {
        self.record = TestRecord::default();
    }

    /// The next value of the test, whose noise variance is at least this one.
    pub(super) fn push(&mut self, value: f64, variance: impl FnOnce() -> f64) {
        self.count += 1;
        let floor = self.floor.unwrap_or(f64::INFINITY);
        if floor > 0.0 {
            self.floor = Some(variance().min(floor));
        }
        if !self.is_many {
            let different = self.different.get_or_insert_default();
            *different.entry(Ordered(value + 0.0)).or_default() += 1;
            self.is_many = different.len() > MOST_DIFFERENT;
        }
        let record = &mut self.record;
        record.equal += usize::from(record.values > 0 && record.last == value);
        // a record that starts at zero counts from its own start
        let counted = usize::from(record.values > 0 || value != 0.0);
        let end = ValueEnd { value: Some(value), count: counted };
        record.low.merge(end, is_below);
        record.high.merge(end, is_above);
        record.values += 1;
        record.last = value;
    }

    /// The test ends.
    pub(super) fn end(&mut self, id: &str) {
        let TestRecord { values, equal, low, high, .. } = std::mem::take(&mut self.record);
        if values > 2 && equal + 1 == values {
            self.constant.push((id.to_owned(), values));
        } else if values > 0 {
            self.pairs.0 += values - 1;
            self.pairs.1 += equal;
            self.low.merge(low, is_below);
            self.high.merge(high, is_above);
        }
    }

    pub(super) fn notes(&self, measurement: &Measurement, column: &str) -> Vec<String> {
        let step = self.step();
        let pile = self.pile_note(measurement, column);
        let constant = self.constant_note(column, step);
        let lattice = step.filter(|_| self.is_coarse()).filter(|step| self.lacks_floor(*step));
        let lattice = lattice.map(|step| lattice_note(column, step, self.pairs));
        pile.into_iter().chain(lattice).chain(constant).collect()
    }

    /// Values pile up at an end: more than beside it.
    fn is_pile(&self, end: ValueEnd, inwards: bool) -> bool {
        let (Some(value), Some(different)) = (end.value, &self.different) else { return false };
        const BESIDE: usize = 3;
        let inner = different.iter().filter(|(other, _)| other.0 != value).map(|(_, count)| *count);
        let beside: Vec<usize> =
            if inwards { inner.take(BESIDE).collect() } else { inner.rev().take(BESIDE).collect() };
        let most = beside.iter().copied().max().unwrap_or(0);
        different.len() > 2 * BESIDE && end.count >= PILE && end.count >= STANDS_OUT * most
    }

    fn pile_note(&self, measurement: &Measurement, column: &str) -> Option<String> {
        let (low, high) = (self.low.value?, self.high.value?);
        let (below, above) = (self.is_pile(self.low, true), self.is_pile(self.high, false));
        let name = if is_name(column) { column.to_owned() } else { format!("`{column}`") };
        let number = |x: f64| plain(x, 15);
        let (count, ends, cure) = match (below, above) {
            (true, true) if low == -high => (
                self.low.count + self.high.count,
                format!("{} or {}", number(low), number(high)),
                format!("abs({name}) < {}", number(high)),
            ),
            (true, true) => (
                self.low.count + self.high.count,
                format!("{} or {}", number(low), number(high)),
                format!("{name} > {} and {name} < {}", number(low), number(high)),
            ),
            (true, false) => (self.low.count, number(low), format!("{name} > {}", number(low))),
            (false, true) => (self.high.count, number(high), format!("{name} < {}", number(high))),
            (false, false) => return None,
        };
        let place = if measurement.filter.is_some() { "added to `where` by `and`" } else { "as `where`" };
        Some(format!(
            "{count} of {} values in column `{column}` are exactly {ends}, where it ends: if they are clipped, leave them out, with \
             `{cure}` {place} of measurement `{}`",
            self.count, measurement.name
        ))
    }

    /// The step of which all values are whole multiples, a common offset apart; `None` where they are no lattice.
    fn step(&self) -> Option<f64> {
        let different = self.different.as_ref().filter(|different| different.len() > 2 && !self.is_many)?;
        let values: Vec<f64> = different.keys().map(|value| value.0).collect();
        let least = values.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
        let (first, range) = (values[0], values[values.len() - 1] - values[0]);
        let step = range / (range / least).round();
        let is_on = |value: &f64| {
            let steps = (value - first) / step;
            (steps - steps.round()).abs() < 0.02
        };
        (step.is_finite() && values.iter().all(is_on)).then_some(step)
    }

    /// Half of successive values are equal: noise of half a step would make more of them differ.
    fn is_coarse(&self) -> bool {
        let constant: usize = self.constant.iter().map(|(_, values)| values - 1).sum();
        let (all, equal) = self.pairs;
        all + constant >= FEWEST_PAIRS && 2 * (equal + constant) >= all + constant
    }

    /// Noise may be less than what rounding to such steps gives.
    fn lacks_floor(&self, step: f64) -> bool {
        self.floor.unwrap_or(0.0) < 0.9 * step * step / 12.0
    }

    /// Constant records, more than chance makes of values that are equal as often as elsewhere.
    fn constant_note(&self, column: &str, step: Option<f64>) -> Option<String> {
        let (all, equal) = self.pairs;
        let share = (equal as f64 + 1.0) / (all as f64 + 2.0);
        let tests = self.constant.len() as f64;
        let is_rare = |values: usize| share.powf(values as f64 - 1.0) * (tests + all as f64 / values as f64) < 0.05;
        let found: Vec<String> =
            self.constant.iter().filter(|(_, values)| is_rare(*values)).map(|(id, _)| id.clone()).collect();
        if found.is_empty() || !self.lacks_floor(step.unwrap_or(0.0)) && self.floor.is_some_and(|floor| floor > 0.0) {
            return None;
        }
        let tests = if found.len() == 1 { "test" } else { "tests" };
        let floor = step.map_or("a floor, `lower`".to_owned(), |step| {
            format!(
                "a floor, such as `lower = {}`, one step of {} over sqrt(12)",
                plain(step / 12_f64.sqrt(), 4),
                plain(step, 7)
            )
        });
        Some(format!(
            "column `{column}` is constant in {tests} {}: a noise level that differs between tests goes to zero there, unless it \
             has {floor}",
            listed(&found)
        ))
    }
}

fn lattice_note(column: &str, step: f64, (all, equal): (usize, usize)) -> String {
    let floor = step / 12_f64.sqrt();
    format!(
        "values in column `{column}` move by whole steps of {}, and {equal} of {all} are equal to the one before, so that the noise \
         is smaller than a step: `lower = {}` for its noise level, one step over sqrt(12), or a `variance` with `{}^2 / 12` \
         added, allows for the rounding",
        plain(step, 7),
        plain(floor, 4),
        plain(step, 7)
    )
}

fn is_name(column: &str) -> bool {
    let mut letters = column.chars();
    letters.next().is_some_and(|c| c.is_alphabetic() || c == '_') && letters.all(|c| c.is_alphanumeric() || c == '_')
}
