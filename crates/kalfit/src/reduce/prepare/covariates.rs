//! The covariates of a test.

use crate::ensemble::Test;
use crate::reduce::prepare::{Preparer, Workspace};
use crate::reduce::subject::{Fault, ModelAt, Subject};

impl Preparer {
    /// The covariates of a test into the work space: of tests that look alike, they alone differ beside the measured values.
    pub(crate) fn covariates_of(&self, test: &Test, work: &mut Workspace) -> Result<(), Box<Fault>> {
        work.covariates.clear();
        if self.start.uses.is_empty() {
            return Ok(());
        }
        let at = self.at();
        work.whole.gather(&at, test, 0..test.rows(), (&self.start.uses, true))?;
        self.covariates(&at, work)
    }

    /// Those of the test whose cells are in the work space.
    pub(super) fn covariates(&self, at: &ModelAt<'_>, work: &mut Workspace) -> Result<(), Box<Fault>> {
        work.covariates.clear();
        for (r, regression) in self.model.mean.regression.iter().enumerate() {
            work.covariates.push(at.cell(&work.whole.numbers, regression.column, Subject::Regression(r))?);
        }
        Ok(())
    }
}
