//! `kalfit reduce`: the filters, once, at known parameters.

use kalfit::reduce::PhasedReducer;
use kalfit::{Evidence, Labels};
use kalfit_data::WriteError;
use kalfit_data::exchange::{Entry, ReductionWriter};

use crate::exchange::{self, Maker, Refused, Setting, Sunk};
use crate::failure::Failure;
use crate::job::{Done, ExchangeJob, Exchanged};
use crate::work::Watch;

/// Runs the filters once, at known parameters, and writes what they make of the data: all that a fit needs.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn reduce(job: &ExchangeJob, watch: &mut dyn Watch) -> Result<Done<Exchanged>, Failure> {
    exchange::run::<Reductions>(job, watch)
}

/// Makes reductions.
pub(crate) struct Reductions(PhasedReducer);

impl Maker for Reductions {
    type Writer = ReductionWriter<Sunk>;
    const ROW: &'static str = "reduction";
    const OF_ESTIMATES: bool = false;

    fn new(setting: &Setting) -> Result<Reductions, Failure> {
        let reducer = PhasedReducer::new(&setting.spec.model, &setting.alpha);
        Ok(Reductions(reducer.map_err(|error| Failure::Reduce { error, reading: None })?))
    }

    fn open(setting: &Setting, sink: Sunk) -> Result<Self::Writer, WriteError> {
        ReductionWriter::new(&setting.spec.model, setting.metadata(), sink)
    }

    fn make(&mut self, entries: Vec<Entry>, _: &Labels, writer: &mut Self::Writer) -> Result<(), Refused> {
        let phases: Vec<(&str, usize, &Evidence)> =
            entries.iter().map(|entry| (entry.test.as_str(), entry.phase, &entry.evidence)).collect();
        let pieces = self.0.each_piece(&phases).map_err(Refused::Reduce)?;
        let mut all = entries.iter().zip(&pieces);
        all.try_for_each(|(entry, piece)| writer.write(&entry.test, entry.phase, piece)).map_err(Refused::Write)
    }

    fn close(writer: Self::Writer) -> Result<Sunk, WriteError> {
        writer.finish()
    }
}
