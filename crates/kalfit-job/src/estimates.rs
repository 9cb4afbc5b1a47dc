//! `kalfit estimates`: the filters of the model as they are, optimal or not, and what they make of each phase.

use kalfit::reduce::{Estimates, FilterRunner};
use kalfit::{Evidence, Labels, PhasedModel, Test};
use kalfit_data::WriteError;
use kalfit_data::exchange::{EstimatesWriter, ExchangeEntry};

use crate::exchange::{self, ExchangeMaker, ExchangeRefusal, ExchangeSetting, ExchangeSink};
use crate::failure::Failure;
use crate::job::{ExchangeJob, ExchangedTable, JobDone};
use crate::work::JobWatch;

/// Runs the `[filter]` of each phase and writes its estimates with the errors they make.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn estimates(job: &ExchangeJob, watch: &mut dyn JobWatch) -> Result<JobDone<ExchangedTable>, Failure> {
    exchange::run::<EstimateMaker>(job, watch)
}

/// Makes estimates: the runner of each phase that has a filter.
pub(crate) struct EstimateMaker(Vec<Result<FilterRunner, String>>);

impl ExchangeMaker for EstimateMaker {
    type Writer = EstimatesWriter<ExchangeSink>;
    const ROW: &'static str = "estimate";
    const OF_ESTIMATES: bool = true;

    fn refuse(model: &PhasedModel) -> Result<(), WriteError> {
        if model.levels.is_empty() { Ok(()) } else { Err(WriteError::Levels) }
    }

    fn new(setting: &ExchangeSetting) -> Result<EstimateMaker, Failure> {
        let runner = |phase: &kalfit::model::Phase| match &phase.filter {
            None => Ok(Err(phase.name.clone())),
            Some(_) => FilterRunner::new(phase, &setting.alpha).map(Ok),
        };
        let runners: Result<_, _> = setting.spec.model.phases.iter().map(runner).collect();
        Ok(EstimateMaker(runners.map_err(|error| Failure::Reduce { error, reading: None })?))
    }

    fn open(setting: &ExchangeSetting, sink: ExchangeSink) -> Result<Self::Writer, WriteError> {
        EstimatesWriter::new(&setting.spec.model, setting.metadata(), sink)
    }

    fn make(
        &mut self,
        entries: Vec<ExchangeEntry>,
        labels: &Labels,
        writer: &mut Self::Writer,
    ) -> Result<(), ExchangeRefusal> {
        let mut rows: Vec<Vec<Test>> = self.0.iter().map(|_| Vec::new()).collect();
        for ExchangeEntry { test, phase, evidence, at } in entries {
            match (evidence, &self.0[phase]) {
                (Evidence::Rows(test), Ok(_)) => rows[phase].push(test),
                (Evidence::Rows(_), Err(name)) => return Err(ExchangeRefusal::NoFilter { phase: name.clone(), at }),
                (Evidence::Estimates(known), _) => {
                    writer.write(&test, phase, &known, labels).map_err(ExchangeRefusal::Write)?;
                }
                (Evidence::Reduced(_), _) => return Err(ExchangeRefusal::Reduced { at }),
            }
        }
        for (phase, (tests, runner)) in rows.iter().zip(&self.0).enumerate() {
            let Ok(runner) = runner else { continue };
            let made: Vec<Estimates> = runner.run_all(tests).map_err(ExchangeRefusal::Reduce)?;
            for (test, estimates) in tests.iter().zip(&made) {
                writer.write(&test.id, phase, estimates, labels).map_err(ExchangeRefusal::Write)?;
            }
        }
        Ok(())
    }

    fn close(writer: Self::Writer) -> Result<ExchangeSink, WriteError> {
        writer.finish()
    }
}
