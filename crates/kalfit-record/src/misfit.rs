//! Misfit that tests have in common, as a record.

use kalfit_infer::misfit::{Misfit, NoMisfit, TermKind, TermTest, UnlikeTest, WrongRow};
use kalfit_model::PhasedModel;
use serde::{Deserialize, Serialize};

use crate::figure::figures;
use crate::{FigureUnit, FitRecord};

/// Misfit that tests have in common, by standardised innovations under the law of the whole model: processes, noises, Σ
/// and the levels of groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MisfitRecord {
    /// Number of tests that were looked at: all, or of very large data some at equal distances.
    pub tests: usize,
    /// Number of innovations.
    pub innovations: usize,
    /// Mean square of the innovations; expected 1 with standard deviation √(2/n) for n innovations.
    pub mean_square: Option<f64>,
    /// Score tests of mean terms that the model lacks, least p-value first.
    pub terms: Vec<MisfitTermRecord>,
    /// Shapiro and Francia's test of normality; null for fewer than 20 innovations.
    pub normality: Option<NormalityRecord>,
    /// Tests that are unlike the other tests of their groups, the least probable first; empty without levels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unlike: Vec<UnlikeRecord>,
    /// Measurements that contradict the others of their test, the least probable first, of tests with a large
    /// innovation.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub wrong_rows: Vec<WrongRowRecord>,
}

/// A test that is unlike the other tests of its groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UnlikeRecord {
    /// Id of the test.
    pub test: String,
    /// Name of the state that deviates most from what the other tests of its groups predict.
    pub state: String,
    /// Deviation of this state in standard deviations.
    pub deviation: f64,
    /// p-value of the largest deviation of all states, as an externally studentised residual.
    pub p_value: f64,
    /// The p-value times the number of tests, at most 1; two tests of a unit alone count once.
    pub adjusted_p_value: f64,
}

figures! {
    /// A measurement that contradicts the other measurements of its test.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    pub struct WrongRowRecord {
        /// Id of the test.
        pub test: String = figure {},
        /// Name of the phase.
        pub phase: String = figure {},
        /// Data file; null for data without a file.
        pub file: Option<String> = figure {},
        /// Row in the file; of a text file the line.
        pub row: usize = figure { heading: "row" },
        /// Time of the step; null where the model has no times.
        pub time: Option<f64> = figure {},
        /// Name of the measurement.
        pub measurement: String = figure {},
        /// Deviation from what all other measurements of the test say, in the unit of the measurement.
        pub deviation: f64 = figure {},
        /// Standard deviation of `deviation` when the model is right.
        pub std_dev: f64 = figure {},
        /// Two-sided p-value of this measurement alone.
        pub p_value: f64 = figure { unit: FigureUnit::Probability },
        /// The p-value times the number of all measurements, at most 1.
        pub adjusted_p_value: f64 = figure { heading: "p, all rows", unit: FigureUnit::Probability },
    }
}

/// The score test of one mean term that the model lacks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MisfitTermRecord {
    /// Name of the phase.
    pub phase: String,
    /// Name of the measurement.
    pub measurement: String,
    /// `levels` for a level of each value or interval of an input, `square` of an input, `change` of an input since the
    /// row before and to the row after, `record` for a level of each part of the record, `steps` for the mean innovation
    /// of each step or time that tests share, `shared` for correlation between tests at the steps or times they share.
    pub term: String,
    /// Name of the input; null for `record`, `steps` and `shared`.
    pub column: Option<String>,
    /// F; for `shared` the mean of n c² over pairs of tests, with c the correlation of their innovations at n common
    /// steps, 1 for independent tests.
    pub statistic: f64,
    /// Degrees of freedom of F; for `shared` the number of pairs and their largest n.
    pub degrees_of_freedom: [usize; 2],
    /// Probability of a statistic as large as this.
    pub p_value: f64,
    /// Least and largest value, row or time of the part of the term that deviates most; null for `square`, `change`
    /// and `shared`.
    pub at: Option<[f64; 2]>,
    /// Deviation of this part, in the unit of the measurement; for `steps` in standard deviations.
    pub deviation: Option<f64>,
    /// Standard deviation of `deviation` when the model is right.
    pub std_dev: Option<f64>,
}

/// The test of whether innovations are normal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NormalityRecord {
    /// Number of innovations that were tested, at most 5000.
    pub count: usize,
    /// W', the squared correlation of the sorted innovations with normal scores.
    pub statistic: f64,
    /// Probability of a W' as small as this, by Royston's (1993) law.
    pub p_value: f64,
}

impl MisfitRecord {
    /// Misfit as a record; `None` where no innovation was looked at. `files`: names of the data files.
    pub fn new(found: &Misfit, model: &PhasedModel, files: &[String]) -> Option<MisfitRecord> {
        if found.count == 0 {
            return None;
        }
        let mut terms: Vec<MisfitTermRecord> = found.terms.iter().map(|term| of_term(term, model)).collect();
        terms.sort_by(|a, b| a.p_value.total_cmp(&b.p_value));
        Some(MisfitRecord {
            tests: found.tests,
            innovations: found.count,
            mean_square: Some(found.nis / found.count as f64).filter(|x| x.is_finite()),
            terms,
            normality: found.normality.map(|normality| NormalityRecord {
                count: normality.count,
                statistic: normality.statistic,
                p_value: normality.p_value,
            }),
            unlike: unlike(found, model),
            wrong_rows: wrong_rows(found, model, files),
        })
    }

    /// p-values of all tests.
    pub(crate) fn p_values(&self) -> impl Iterator<Item = f64> {
        let terms = self.terms.iter().map(|term| term.p_value);
        terms.chain(self.normality.iter().map(|normality| normality.p_value))
    }
}

impl FitRecord {
    /// Sets the misfit that tests have in common, or adds a note that says why it was not looked for.
    pub fn set_misfit(&mut self, found: Result<Misfit, NoMisfit>, model: &PhasedModel) {
        match found {
            Ok(found) => {
                self.misfit = MisfitRecord::new(&found, model, &self.data.files);
                self.set_whitened(&found.by_test);
            }
            Err(why) => self.notes.push(format!("misfit that tests have in common was not looked for: {why}")),
        }
    }
}

impl MisfitTermRecord {
    /// The term in words, without its measurement.
    pub fn words(&self) -> String {
        let column = self.column.as_deref().unwrap_or_default();
        match self.term.as_str() {
            "levels" => format!("the level by `{column}`"),
            "square" => format!("the curvature over `{column}`"),
            "change" => format!("the dependence on `{column}` of the row before or after"),
            "record" => "the level along the record".to_owned(),
            "shared" => "the correlation of tests at common steps".to_owned(),
            _ => "the mean of each step".to_owned(),
        }
    }
}

/// Most tests and rows in the lists of a record.
const MAX_LISTED: usize = 20;

fn unlike(found: &Misfit, model: &PhasedModel) -> Vec<UnlikeRecord> {
    let names = model.estimated_names();
    let all = found.comparisons as f64;
    let record = |one: &UnlikeTest| UnlikeRecord {
        test: one.test.to_string(),
        state: names.get(one.state).cloned().unwrap_or_default(),
        deviation: one.deviation,
        p_value: one.p_value,
        adjusted_p_value: (one.p_value * all).min(1.0),
    };
    let mut records: Vec<UnlikeRecord> = found.unlike.iter().map(record).collect();
    records.sort_by(|a, b| a.p_value.total_cmp(&b.p_value).then_with(|| a.test.cmp(&b.test)));
    records.truncate(MAX_LISTED);
    records
}

fn wrong_rows(found: &Misfit, model: &PhasedModel, files: &[String]) -> Vec<WrongRowRecord> {
    let record = |one: &WrongRow| {
        let phase = &model.phases[one.phase];
        WrongRowRecord {
            test: one.test.to_string(),
            phase: phase.name.clone(),
            measurement: phase.model.measurements[one.measurement].name.clone(),
            file: files.get(one.source.file as usize).cloned(),
            row: usize::try_from(one.source.row).unwrap_or(usize::MAX),
            time: one.time,
            deviation: one.deviation,
            std_dev: one.std_dev,
            p_value: one.p_value,
            adjusted_p_value: (one.p_value * found.count as f64).min(1.0),
        }
    };
    let mut records: Vec<WrongRowRecord> = found.wrong_rows.iter().map(record).collect();
    records.sort_by(|a, b| a.p_value.total_cmp(&b.p_value).then_with(|| a.test.cmp(&b.test)));
    records
}

fn of_term(term: &TermTest, model: &PhasedModel) -> MisfitTermRecord {
    let phase = &model.phases[term.phase];
    let (name, column) = match term.kind {
        TermKind::Levels(column) => ("levels", Some(column)),
        TermKind::Square(column) => ("square", Some(column)),
        TermKind::Change(column) => ("change", Some(column)),
        TermKind::Record => ("record", None),
        TermKind::Steps => ("steps", None),
        TermKind::Shared => ("shared", None),
    };
    let largest = term.largest.filter(|largest| largest.value.is_finite() && largest.std_dev.is_finite());
    let has_place = !matches!(term.kind, TermKind::Square(_) | TermKind::Change(_));
    MisfitTermRecord {
        phase: phase.name.clone(),
        measurement: phase.model.measurements[term.measurement].name.clone(),
        term: name.to_owned(),
        column: column.map(|column| phase.model.columns[column].name.clone()),
        statistic: term.statistic,
        degrees_of_freedom: term.degrees_of_freedom,
        p_value: term.p_value,
        at: largest.filter(|_| has_place).map(|largest| largest.at),
        deviation: largest.map(|largest| largest.value),
        std_dev: largest.map(|largest| largest.std_dev),
    }
}
