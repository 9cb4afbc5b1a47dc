//! Times of rows: dates that are read as numbers, steps of unequal length, several values at one time.

use kalfit::Model;
use kalfit::model::Motion;

use super::steps::RowSteps;

/// A date, by its number of eight digits, and its days since the year 0.
type DatedNumber = (f64, i64);

/// Times of the rows of a phase.
pub(super) struct TimeSurvey<'m> {
    model: &'m Model,
    column: Option<usize>,
    /// Time of the row before.
    last: Option<f64>,
    steps: RowSteps<'m>,
    /// All times so far are dates of eight digits.
    dates: bool,
    /// A step between two dates that is not the number of days between them.
    leap: Option<(DatedNumber, DatedNumber)>,
    /// Values of each measurement at the time of the row.
    at_time: Vec<usize>,
    /// Most values of each at one time of a test.
    most: Vec<usize>,
    /// Times with values of any measurement, and those with several of one.
    times: (usize, usize),
}

impl<'m> TimeSurvey<'m> {
    pub(super) fn of(model: &'m Model) -> TimeSurvey<'m> {
        TimeSurvey {
            model,
            column: model.clock.time,
            last: None,
            steps: RowSteps::of(model),
            dates: true,
            leap: None,
            at_time: vec![0; model.measurements.len()],
            most: vec![0; model.measurements.len()],
            times: (0, 0),
        }
    }

    /// A test begins.
    pub(super) fn begin(&mut self) {
        self.last = None;
    }

    /// The next row: the time since the row before, zero at the first one.
    pub(super) fn row(&mut self, numbers: &[f64]) -> f64 {
        let Some(now) = self.column.map(|column| numbers[column]) else { return f64::NAN };
        let step = self.last.map_or(0.0, |last| now - last);
        if step != 0.0 || self.last.is_none() {
            self.close();
        }
        if step > 0.0 {
            self.steps.push(step);
        }
        self.date(now);
        self.last = Some(now);
        step
    }

    fn date(&mut self, now: f64) {
        if !self.dates {
            return;
        }
        let Some(day) = day(now) else {
            self.dates = false;
            return;
        };
        let before = self.last.and_then(|last| Some((last, self::day(last)?)));
        let leap = before.filter(|(last, before)| now - last != (day - before) as f64);
        self.leap = self.leap.or(leap.map(|before| (before, (now, day))));
    }

    /// These are measured in the row.
    pub(super) fn measured(&mut self, measured: &[usize]) {
        measured.iter().for_each(|m| self.at_time[*m] += 1);
    }

    /// A test ends.
    pub(super) fn end(&mut self) {
        self.close();
    }

    /// No more rows of this time.
    fn close(&mut self) {
        if self.column.is_some() && self.at_time.iter().any(|count| *count > 0) {
            self.times.0 += 1;
            self.times.1 += usize::from(self.at_time.iter().any(|count| *count > 1));
            self.most.iter_mut().zip(&self.at_time).for_each(|(most, count)| *most = (*most).max(*count));
        }
        self.at_time.fill(0);
    }

    pub(super) fn notes(&self) -> Vec<String> {
        let Some(column) = self.column.map(|column| self.model.columns[column].name.as_str()) else {
            return Vec::new();
        };
        let dates = self.dates_note(column).into_iter();
        dates.chain(self.steps.notes(column)).chain(self.several_note(column)).collect()
    }

    fn dates_note(&self, column: &str) -> Option<String> {
        let ((first, before), (second, after)) = self.leap.filter(|_| self.dates)?;
        let (step, days) = (second - first, after - before);
        let days = if days == 1 { "1 day".to_owned() } else { format!("{days} days") };
        let (year, month, date) = parts(first);
        Some(format!(
            "all times in column `{column}` are whole numbers of eight digits that are dates, and they are taken as numbers: from \
             {first} to {second} is a step of {step}, but {days} in the calendar. Write dates as in ISO 8601, \
             `{year:04}-{month:02}-{date:02}`: these are read as dates, in `time_unit`"
        ))
    }

    fn several_note(&self, column: &str) -> Option<String> {
        let moving = self.model.states.iter().find(|state| state.motion != Motion::Constant)?;
        let (m, most) = self.most.iter().enumerate().max_by_key(|(_, most)| **most).filter(|(_, most)| **most > 1)?;
        let (all, several) = self.times;
        Some(format!(
            "measurement `{}` has several values at one time of a test, up to {most}, at {several} of {all} times in column `{column}`: \
             rows of one time are one step, so that these values share the state `{}`. If they are records of their own, let `test` \
             tell them apart, and name what they have in common in `levels`",
            self.model.measurements[m].name, moving.name
        ))
    }
}

/// Year, month and day of the month that the eight digits of a number would be.
fn parts(number: f64) -> (i64, i64, i64) {
    let number = number as i64;
    (number / 10_000, number / 100 % 100, number % 100)
}

/// Days since the year 0 of a date that is written as a number of eight digits; `None` of other numbers.
fn day(number: f64) -> Option<i64> {
    if !(10_000_000.0..1e8).contains(&number) || number.fract() != 0.0 {
        return None;
    }
    let (year, month, date) = parts(number);
    let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let lengths = [31, if leap { 29 } else { 28 }, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let length = *lengths.get(usize::try_from(month - 1).ok()?)?;
    let before: i64 = lengths[..usize::try_from(month - 1).ok()?].iter().sum();
    let years = 365 * year + (year - 1) / 4 - (year - 1) / 100 + (year - 1) / 400;
    (1..=length).contains(&date).then_some(years + before + date)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_digits_are_a_date_where_the_calendar_has_it() {
        let days = |a: f64, b: f64| day(b).unwrap_or(0) - day(a).unwrap_or(0);
        assert_eq!(days(20_211_130.0, 20_211_201.0), 1);
        assert_eq!(days(20_211_231.0, 20_220_101.0), 1);
        assert_eq!(days(20_240_228.0, 20_240_301.0), 2);
        assert_eq!(days(19_000_228.0, 19_000_301.0), 1);
        assert_eq!(days(19_700_101.0, 20_240_101.0), 19_723);
        for number in [20_210_229.0, 20_211_301.0, 20_210_100.0, 20_210_101.5, 2_021_010.0, f64::NAN] {
            assert_eq!(day(number), None, "{number}");
        }
    }
}
