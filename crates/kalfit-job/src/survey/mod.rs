//! What rows show before any model is fitted to them, and what a reader of the results should know: times that are no times, values
//! that are missing, clipped, rounded or copied.

mod absent;
mod noise;
mod steps;
mod times;
mod twins;
mod values;

use kalfit::model::{Alpha, Phase, Scope};
use kalfit::{Evidence, PhasedModel, PhasedTest, Test};

use self::absent::AbsentValues;
use self::noise::least;
use self::times::TimeSurvey;
use self::twins::TwinRows;
use self::values::ValueSurvey;

/// The rows of all tests so far, as far as notes need them.
pub(crate) struct DataSurvey<'m> {
    model: &'m PhasedModel,
    /// Parameters where noise is least.
    least: Alpha,
    /// Of each phase.
    phases: Vec<PhaseSurvey<'m>>,
    absent: AbsentValues,
    tests: usize,
}

/// The rows of one phase.
struct PhaseSurvey<'m> {
    phase: &'m Phase,
    times: TimeSurvey<'m>,
    twins: TwinRows,
    /// Of each measurement.
    values: Vec<ValueSurvey>,
    /// Rows of the test that have a value, and measurements of the row: kept for their memory.
    measured_rows: Vec<usize>,
    measured: Vec<usize>,
}

impl<'m> DataSurvey<'m> {
    /// Without rows.
    pub(crate) fn of(model: &'m PhasedModel) -> DataSurvey<'m> {
        let phases = model.phases.iter().map(PhaseSurvey::of).collect();
        DataSurvey { model, least: least(model.shared()), phases, absent: AbsentValues::default(), tests: 0 }
    }

    /// With the rows of these tests.
    pub(crate) fn among(model: &'m PhasedModel, tests: &[PhasedTest]) -> DataSurvey<'m> {
        let mut found = DataSurvey::of(model);
        tests.iter().for_each(|test| found.add(test));
        found
    }

    /// It has seen no test.
    pub(crate) fn is_empty(&self) -> bool {
        self.tests == 0
    }

    /// Adds the rows of a test.
    pub(crate) fn add(&mut self, test: &PhasedTest) {
        self.tests += 1;
        let (mut rows, mut values) = (0, 0);
        let mut by_rows = true;
        for (survey, evidence) in self.phases.iter_mut().zip(&test.phases) {
            match evidence {
                Evidence::Rows(of) => {
                    rows += of.rows();
                    values += survey.add(of, &self.least);
                }
                Evidence::Estimates(_) | Evidence::Reduced(_) => by_rows = false,
            }
        }
        self.absent.add(test.id.as_str(), rows, by_rows.then_some(values));
    }

    /// Sentences without a full stop, the gravest first.
    pub(crate) fn notes(&self) -> Vec<String> {
        if self.is_empty() {
            return Vec::new();
        }
        let measured = |survey: &PhaseSurvey<'_>| survey.values.iter().map(|v| v.count()).collect::<Vec<_>>();
        let counts: Vec<Vec<usize>> = self.phases.iter().map(measured).collect();
        let mut notes = self.absent.notes(self.model, &counts);
        for survey in &self.phases {
            notes.extend(survey.notes());
        }
        let mut once: Vec<String> = Vec::new();
        notes.into_iter().for_each(|note| {
            if !once.contains(&note) {
                once.push(note)
            }
        });
        once
    }
}

impl<'m> PhaseSurvey<'m> {
    fn of(phase: &'m Phase) -> PhaseSurvey<'m> {
        let values = phase.model.measurements.iter().map(|_| ValueSurvey::default()).collect();
        let (times, twins) = (TimeSurvey::of(&phase.model), TwinRows::of(&phase.model));
        PhaseSurvey { phase, times, twins, values, measured_rows: Vec::new(), measured: Vec::new() }
    }

    /// Adds the rows of a test; the number of values measured in them.
    fn add(&mut self, rows: &Test, least: &Alpha) -> usize {
        let model = &self.phase.model;
        let before: usize = self.values.iter().map(ValueSurvey::count).sum();
        self.measured_rows.clear();
        self.times.begin();
        self.values.iter_mut().for_each(ValueSurvey::begin);
        for row in 0..rows.rows() {
            let (numbers, texts) = (rows.numbers(row), rows.texts(row));
            let step = self.times.row(numbers);
            let scope = Scope { numbers, texts, step, alpha: least };
            self.measured.clear();
            for (m, (survey, measurement)) in self.values.iter_mut().zip(&model.measurements).enumerate() {
                let value = numbers[measurement.column];
                let is_read = measurement.filter.as_ref().is_none_or(|f| f.evaluate(&scope).is_ok_and(|x| x != 0.0));
                if is_read && !value.is_nan() {
                    survey.push(value, || measurement.noise_variance.evaluate(&scope).unwrap_or(0.0));
                    self.measured.push(m);
                }
            }
            self.times.measured(&self.measured);
            if !self.measured.is_empty() {
                self.measured_rows.push(row);
            }
        }
        self.times.end();
        self.twins.add(rows, &self.measured_rows);
        self.values.iter_mut().for_each(|survey| survey.end(rows.id.as_str()));
        self.values.iter().map(ValueSurvey::count).sum::<usize>() - before
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = self.times.notes();
        notes.extend(self.twins.note());
        for (survey, measurement) in self.values.iter().zip(&self.phase.model.measurements) {
            notes.extend(survey.notes(measurement, &self.phase.model.columns[measurement.column].name));
        }
        notes
    }
}

/// "a, b and c", or "a, b, c and 5 more".
fn listed(names: &[String]) -> String {
    const MOST: usize = 8;
    let more = names.len().saturating_sub(MOST);
    let shown: Vec<String> = names.iter().take(MOST).map(|name| format!("`{name}`")).collect();
    match shown.as_slice() {
        _ if more > 0 => format!("{} and {more} more", shown.join(", ")),
        [others @ .., last] if !others.is_empty() => format!("{} and {last}", others.join(", ")),
        _ => shown.concat(),
    }
}
