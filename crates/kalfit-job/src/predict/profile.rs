//! Limits of predicted means by profile likelihood: the fit is made once more, from the data that it was made from.

use kalfit::model::{Level, Value};
use kalfit::predict::{Bounds, Predictor};
use kalfit::{Alpha, Ensemble, EnsembleError, FitRecord, PhasedTest};
use kalfit_data::DataReading;
use kalfit_spec::Spec;

use super::units::UnitLaws;
use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{PredictJob, PredictedUnits};
use crate::refused::by_predict;
use crate::truth::Truth;
use crate::work::JobWork;
use crate::{dynamic, memory, model, tests};

/// A profile takes some ten fits: of no more values than this.
const MOST: usize = 500;
/// The fit that is made once more ends within this part of its log-likelihood.
const SAME: f64 = 1e-6;

/// The data of a fit.
pub(super) struct ProfileData {
    spec: Spec,
    pub(super) given: CommandInputs,
    log_likelihood: f64,
}

/// No limits, why, and what to do.
fn none<T>(why: impl Into<String>, hint: &'static str) -> Result<T, Failure> {
    Err(Failure::NoProfile { why: why.into(), hint })
}

impl ProfileData {
    /// Opens the data, if there are any.
    pub(super) fn open(job: &PredictJob, truth: &Truth) -> Result<Option<ProfileData>, Failure> {
        if job.profile.is_empty() {
            return Ok(None);
        }
        let Some(record) = &truth.record else {
            return none(
                "the parameters come from a model file, and were not estimated",
                "give the results of `kalfit fit` with `--from`",
            );
        };
        if job.units == PredictedUnits::Known {
            return none("the tests are of known units", "leave `--units known` or `--profile` out");
        }
        if record.criterion != "ml" {
            return none(
                "the restricted likelihood has no profile of a mean",
                "fit without `--criterion reml`, or leave `--profile` out: the limits then follow from standard errors",
            );
        }
        if !truth.changed.is_empty() {
            return none("`--set` changed parameters that were estimated", "leave `--set` or `--profile` out");
        }
        let mut spec = model::load(&job.model, &job.profile)?;
        memory::suffices(&spec)?;
        let shared = spec.model.shared();
        if let Some(parameter) = shared.parameters.iter().find(|parameter| parameter.per.is_some()) {
            let why = format!("parameter `{}` has a value for each level of a column", parameter.name);
            return none(why, "leave `--profile` out: the limits then follow from standard errors");
        }
        start_at(&mut spec, record);
        let given = CommandInputs::open(&mut spec, &job.profile)?;
        Ok(Some(ProfileData { spec, given, log_likelihood: record.log_likelihood }))
    }

    /// The limits of all means, in the order in which they are predicted.
    pub(super) fn limits(
        &self,
        (predictor, designs, units, reading): (&Predictor, &[PhasedTest], &UnitLaws, &DataReading),
        job: &PredictJob,
        work: &mut JobWork<'_>,
    ) -> Result<Vec<Option<[f64; 2]>>, Failure> {
        let UnitLaws::New(initial) = units else { unreachable!("known units were refused") };
        let own = predictor.predict(designs, &vec![initial; designs.len()]);
        let own = own.map_err(|error| by_predict(error, Some(reading)))?;
        let values: usize = own.iter().flatten().flat_map(|phase| &phase.steps).map(|step| step.values.len()).sum();
        if values > MOST {
            let why =
                format!("the design has {values} states and outputs in all rows, and at most {MOST} are possible");
            return none(why, "give fewer rows in `--design`");
        }
        let (tests, data) = tests::read(&self.spec, &self.given, work)?;
        let ensemble = Ensemble::of_tests(&self.spec.model, data.labels.clone(), tests);
        let means = |alpha: &Alpha| predictor.means(designs, initial, &plain(alpha)?).ok();
        work.say(|| "limits by profile likelihood".to_owned());
        let found = ensemble.mean_limits(&means, Bounds::new(job.limits).quantile(), work);
        let found = found.map_err(|error| match error {
            EnsembleError::Dynamic(error) => dynamic::failure(*error, &data),
            EnsembleError::Fit(error) => Failure::Fit(error),
            EnsembleError::Reduce(error) => Failure::Reduce { error: *error, reading: Some(Box::new(data.clone())) },
            error => Failure::NoProfile { why: error.to_string(), hint: "leave `--profile` out" },
        })?;
        work.go_on()?;
        let off = found.log_likelihood - self.log_likelihood;
        if off.abs() > SAME * self.log_likelihood.abs().max(1.0) {
            let why = format!(
                "the log-likelihood of these data is {} at its maximum, and `{}` has {}",
                found.log_likelihood,
                job.from.name(),
                self.log_likelihood
            );
            return none(why, "give the data, and all the data, that the fit was made from");
        }
        if !found.converged {
            return none("the fit did not converge", "see what `kalfit fit` says of it");
        }
        Ok(found.limits)
    }
}

/// Lets the search begin where the fit ended.
fn start_at(spec: &mut Spec, record: &FitRecord) {
    for model in spec.model.models_mut() {
        for parameter in &mut model.parameters {
            let found = record.parameters.iter().find(|own| own.name == parameter.name);
            if let (Value::Free { start }, Some(found)) = (&mut parameter.value, found) {
                *start = Some(found.estimate);
            }
        }
    }
}

/// α of common values alone, which stand in the model of the designs as they do in that of the data.
fn plain(alpha: &Alpha) -> Option<Alpha> {
    alpha.values.iter().all(|level| matches!(level, Level::Common(_))).then(|| alpha.clone())
}
