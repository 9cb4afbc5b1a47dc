//! Separate parts of a test: covariates, start, and the cells and constants d of measurements.

use crate::reduce::error::ReduceErrorKind;
use crate::reduce::instances::Instance;
use crate::reduce::measured_cells::MeasuredCells;
use crate::reduce::prepare::{Preparer, Workspace};
use crate::reduce::steps::StepSpan;
use crate::reduce::subject::{Fault, ModelAt, Subject};
use kalfit_model::Test;

impl Preparer {
    /// Writes the covariates of a test into the work space: replicates differ only in covariates and measured values.
    pub(crate) fn covariates_of(&self, test: &Test, work: &mut Workspace) -> Result<(), Box<Fault>> {
        work.covariates.clear();
        if self.start.uses.is_empty() {
            return Ok(());
        }
        let at = self.at();
        work.whole.gather(&at, test, 0..test.rows(), (&self.start.uses, true))?;
        self.covariates(&at, work)
    }

    /// Writes the covariates of the test whose cells are in the work space.
    pub(super) fn covariates(&self, at: &ModelAt<'_>, work: &mut Workspace) -> Result<(), Box<Fault>> {
        work.covariates.clear();
        for (r, regression) in self.model.mean.regression.iter().enumerate() {
            work.covariates.push(at.cell(&work.whole.numbers, regression.column, Subject::Regression(r))?);
        }
        Ok(())
    }

    /// Writes a, P0 and covariates of a test into the work space as [`Preparer::prepare`] does; the rest of the work
    /// space is then meaningless. `constants`: one row with the columns that are constant within the test, the only
    /// known ones. The length of the first step is unknown.
    pub(crate) fn open(&self, constants: &Test, work: &mut Workspace) -> Result<(), Box<Fault>> {
        let at = self.at();
        if constants.rows() == 0 {
            return Err(Fault::new(Subject::Test, ReduceErrorKind::NoRows));
        }
        work.design.clear();
        work.data.clear();
        work.whole.gather(&at, constants, 0..1, (&self.start.uses, true))?;
        work.spans.clear();
        work.spans.push(StepSpan { rows: 0..1, count: 1, dt: f64::NAN, moves: true });
        self.covariates(&at, work)?;
        self.write_start(&at, constants, work)
    }

    /// d of each scalar measurement of the test in the work space.
    pub(crate) fn measured_constants(&self, test: &Test, work: &Workspace) -> Result<Vec<f64>, Box<Fault>> {
        let mut constants = Vec::with_capacity(work.instances.len());
        for (k, step) in work.design.each_step().enumerate() {
            let instances = work.instances.of(step.rows);
            self.meters.constants(&self.at(), test, (&instances, work.dt(k)), &mut constants)?;
        }
        Ok(constants)
    }

    /// Cell and d of each scalar measurement of the test in the work space.
    pub(crate) fn measured_cells(&self, test: &Test, work: &Workspace) -> Result<MeasuredCells, Box<Fault>> {
        let width = test.widths().0;
        let cell = |&Instance { meter, row }: &Instance| row * width + self.meters.column(meter);
        let mut cells = MeasuredCells::default();
        if let Some(constants) = self.meters.known_constants() {
            for (entries, count, height) in work.instances.blocks() {
                let own = entries.iter().map(|instance| (cell(instance), constants[instance.meter]));
                cells.push(own, count, height * width);
            }
        } else {
            let constants = self.measured_constants(test, work)?;
            cells.push(work.instances.iter().map(|instance| cell(&instance)).zip(constants), 1, 0);
        }
        Ok(cells)
    }
}
