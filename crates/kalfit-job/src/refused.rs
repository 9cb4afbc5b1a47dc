//! Why tests were not taken in as they were read, and why what is known of a fit does not go with them.

use kalfit::apply::ApplyError;
use kalfit::predict::PredictError;
use kalfit::record::MixedGroup;
use kalfit::reduce::{ReduceError, SplitError};
use kalfit_data::{DataReading, ReadError};
use kalfit_spec::Spec;

use crate::failure::Failure;
use crate::work::JobWork;

/// Why what takes tests in refused them.
pub(crate) enum SinkRefusal {
    Split(SplitError),
    Reduce(ReduceError),
    Group(MixedGroup),
    /// Nobody waits for them any longer.
    Interrupted,
}

impl SinkRefusal {
    /// Goes on reading, if somebody still waits.
    pub(crate) fn unless_stopped(work: &JobWork<'_>) -> Result<(), SinkRefusal> {
        if work.is_stopped() { Err(SinkRefusal::Interrupted) } else { Ok(()) }
    }

    /// As [`SinkRefusal::unless_stopped`], saying how far the reading is.
    pub(crate) fn unless_stopped_at(work: &mut JobWork<'_>, done: u64, of: Option<u64>) -> Result<(), SinkRefusal> {
        of.into_iter().for_each(|of| work.share("reading", done, of));
        SinkRefusal::unless_stopped(work)
    }
}

/// A reading that ended early.
pub(crate) fn failure(error: ReadError<SinkRefusal>, spec: &Spec) -> Failure {
    match error {
        ReadError::Data(error) => Failure::data(error, spec),
        ReadError::Sink { error: SinkRefusal::Split(error), reading } => Failure::Split { error, reading },
        ReadError::Sink { error: SinkRefusal::Reduce(error), reading } => {
            Failure::Reduce { error, reading: Some(reading) }
        }
        ReadError::Sink { error: SinkRefusal::Group(error), .. } => Failure::MixedGroup(error),
        ReadError::Sink { error: SinkRefusal::Interrupted, .. } => Failure::Interrupted,
    }
}

/// What a model that is applied to tests says of them.
pub(crate) fn by_apply(error: ApplyError, reading: &DataReading) -> Failure {
    match error {
        ApplyError::Reduce(error) => Failure::Reduce { error: *error, reading: Some(Box::new(reading.clone())) },
        ApplyError::Fit(error) => Failure::Fit(error),
        error => Failure::Apply(Box::new(error)),
    }
}

/// What a prediction says of designs.
pub(crate) fn by_predict(error: PredictError, reading: Option<&DataReading>) -> Failure {
    match error {
        PredictError::Reduce(error) => {
            Failure::Reduce { error: *error, reading: reading.map(|reading| Box::new(reading.clone())) }
        }
        error => Failure::Predict(Box::new(error)),
    }
}
