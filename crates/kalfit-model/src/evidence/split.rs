//! Splitting of the rows of a test by phase.

use std::ops::Range;

use crate::ensemble::{Label, Labels, Source, Test};
use crate::evidence::{Evidence, PhasedTest};
use crate::model::PhasedModel;

/// Why the rows of a test cannot be split into phases.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SplitError {
    /// The cell of the phase column is empty in a row.
    #[error("test `{test}`, row {}: the cell of phase column `{column}` is empty, expected {}", at.row, phases.join(", "))]
    MissingCell {
        /// Id of the test.
        test: String,
        /// The row.
        at: Source,
        /// Name of the phase column.
        column: String,
        /// Names of the phases.
        phases: Vec<String>,
    },
    /// A row names a phase that the model does not have.
    #[error("test `{test}`, row {}: found phase `{found}` in column `{column}`, expected {}", at.row, phases.join(", "))]
    UnknownPhase {
        /// Id of the test.
        test: String,
        /// The row.
        at: Source,
        /// Name of the phase column.
        column: String,
        /// Text of the cell.
        found: String,
        /// Names of the phases.
        phases: Vec<String>,
    },
    /// A test has rows of a phase but no rows of an earlier phase.
    #[error("test `{test}`, row {}: phase `{later}` follows phase `{missing}`, of which the test has no row", at.row)]
    MissingPhase {
        /// Id of the test.
        test: String,
        /// First row of the later phase.
        at: Source,
        /// Name of the phase that is missing.
        missing: String,
        /// Name of the phase after the missing phase.
        later: String,
    },
}

impl SplitError {
    /// Id of the test.
    pub fn test(&self) -> &str {
        match self {
            SplitError::MissingCell { test, .. }
            | SplitError::UnknownPhase { test, .. }
            | SplitError::MissingPhase { test, .. } => test,
        }
    }

    /// The row that the error is about.
    pub fn at(&self) -> Source {
        match self {
            SplitError::MissingCell { at, .. }
            | SplitError::UnknownPhase { at, .. }
            | SplitError::MissingPhase { at, .. } => *at,
        }
    }

    /// How to correct the data or the model.
    pub fn hint(&self) -> &'static str {
        match self {
            SplitError::MissingCell { .. } => "every row belongs to one phase: write its name",
            SplitError::UnknownPhase { .. } => "add the phase to the model, or leave its rows out",
            SplitError::MissingPhase { .. } => {
                "later phases may be missing, earlier ones not: a row with empty cells is a phase in which nothing was measured"
            }
        }
    }
}

impl PhasedModel {
    /// The rows of a test by phase, in the order of the model; rows of one phase stay in the order of the test and need
    /// not be contiguous there. The test may lack the last phases. Without a phase column the whole test is the only
    /// phase.
    ///
    /// # Errors
    /// A row without a phase, a row of an unknown phase, or a phase without rows before a phase with rows.
    pub fn split(&self, test: Test, labels: &Labels) -> Result<PhasedTest, SplitError> {
        if self.column.is_none() {
            return Ok(test.into());
        }
        let id = test.id.clone();
        let mut phases = self.rows_by_phase(test, labels)?;
        let last = phases.iter().rposition(|phase| phase.rows() > 0).unwrap_or(0);
        if let Some(missing) = phases[..last].iter().rposition(|phase| phase.rows() == 0) {
            let later = missing + 1;
            return Err(SplitError::MissingPhase {
                test: id.to_string(),
                at: phases[later].source(0),
                missing: self.phases[missing].name.clone(),
                later: self.phases[later].name.clone(),
            });
        }
        phases.truncate(last + 1);
        Ok(PhasedTest { id, phases: phases.into_iter().map(Evidence::Rows).collect() })
    }

    /// The rows of a test by phase, in the order of the model, with an empty test for each phase without rows: other
    /// evidence of such a phase may exist. Without a phase column the whole test is the first phase.
    ///
    /// # Errors
    /// A row without a phase, or a row of an unknown phase.
    pub fn rows_by_phase(&self, test: Test, labels: &Labels) -> Result<Vec<Test>, SplitError> {
        let empty = || self.phases.iter().skip(1).map(|_| test.first(0)).collect::<Vec<Test>>();
        let Some(column) = self.column else {
            let mut phases = empty();
            phases.insert(0, test);
            return Ok(phases);
        };
        let runs = self.runs_of_phases(&test, column, labels)?;
        let mut phases = empty();
        if runs.iter().all(|&(phase, _)| phase == 0) {
            phases.insert(0, test);
            return Ok(phases);
        }
        phases.insert(0, test.first(0));
        for (phase, rows) in runs {
            phases[phase].push_from(&test, rows);
        }
        Ok(phases)
    }

    /// (index of the phase, rows) of each run of successive rows of one phase.
    fn runs_of_phases(
        &self,
        test: &Test,
        column: usize,
        labels: &Labels,
    ) -> Result<Vec<(usize, Range<usize>)>, SplitError> {
        let mut runs: Vec<(usize, Range<usize>)> = Vec::with_capacity(self.phases.len());
        for row in 0..test.rows() {
            match runs.last_mut() {
                Some((_, run)) if test.texts(run.start)[column] == test.texts(row)[column] => run.end = row + 1,
                _ => runs.push((self.phase_of(test, row, column, labels)?, row..row + 1)),
            }
        }
        Ok(runs)
    }

    /// Index of the phase of a row.
    fn phase_of(&self, test: &Test, row: usize, column: usize, labels: &Labels) -> Result<usize, SplitError> {
        let cell = test.texts(row)[column];
        let of = |label: usize| Label::literal(label) == cell;
        if let Some(phase) = self.phases.iter().position(|phase| phase.label.is_some_and(of)) {
            return Ok(phase);
        }
        let (id, at, column) = (test.id.to_string(), test.source(row), self.shared().text_columns[column].name.clone());
        let phases = self.phases.iter().map(|phase| format!("`{}`", phase.name)).collect();
        Err(if cell.is_missing() {
            SplitError::MissingCell { test: id, at, column, phases }
        } else {
            SplitError::UnknownPhase { test: id, at, column, found: labels.text(cell).to_owned(), phases }
        })
    }
}
