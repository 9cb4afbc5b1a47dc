//! `kalfit reduce`: the filters, once, at known parameters.

use kalfit::reduce::{PhasedReducer, groups_of};
use kalfit::{Evidence, Labels, PhasedModel};
use kalfit_data::WriteError;
use kalfit_data::exchange::{ExchangeEntry, ReductionWriter};

use crate::exchange::{self, ExchangeMaker, ExchangeRefusal, ExchangeSetting, ExchangeSink};
use crate::failure::Failure;
use crate::job::{ExchangeJob, ExchangedTable, JobDone};
use crate::work::JobWatch;

/// Runs the filters once, at known parameters, and writes what they make of the data: all that a fit needs.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn reduce(job: &ExchangeJob, watch: &mut dyn JobWatch) -> Result<JobDone<ExchangedTable>, Failure> {
    exchange::run::<ReductionMaker>(job, watch)
}

/// Makes reductions.
pub(crate) struct ReductionMaker {
    reducer: PhasedReducer,
    model: PhasedModel,
}

impl ExchangeMaker for ReductionMaker {
    type Writer = ReductionWriter<ExchangeSink>;
    const ROW: &'static str = "reduction";
    const OF_ESTIMATES: bool = false;

    fn new(setting: &ExchangeSetting) -> Result<ReductionMaker, Failure> {
        let reducer = PhasedReducer::new(&setting.spec.model, &setting.alpha);
        let reducer = reducer.map_err(|error| Failure::Reduce { error, reading: None })?;
        Ok(ReductionMaker { reducer, model: setting.spec.model.clone() })
    }

    fn open(setting: &ExchangeSetting, sink: ExchangeSink) -> Result<Self::Writer, WriteError> {
        ReductionWriter::new(&setting.spec.model, setting.metadata(), sink)
    }

    fn make(
        &mut self,
        entries: Vec<ExchangeEntry>,
        labels: &Labels,
        writer: &mut Self::Writer,
    ) -> Result<(), ExchangeRefusal> {
        let phases: Vec<(&str, usize, &Evidence)> =
            entries.iter().map(|entry| (entry.test.as_str(), entry.phase, &entry.evidence)).collect();
        let pieces = self.reducer.each_piece(&phases).map_err(ExchangeRefusal::Reduce)?;
        for (ExchangeEntry { test, phase, evidence, .. }, piece) in entries.iter().zip(&pieces) {
            let groups = groups_of(&self.model, test, evidence).map_err(ExchangeRefusal::Grouping)?;
            let groups: Vec<String> = groups.into_iter().map(|name| labels.text(name).to_owned()).collect();
            writer.write(test, *phase, piece, &groups).map_err(ExchangeRefusal::Write)?;
        }
        Ok(())
    }

    fn close(writer: Self::Writer) -> Result<ExchangeSink, WriteError> {
        writer.finish()
    }
}
