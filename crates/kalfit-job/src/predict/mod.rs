//! What tests that nobody has made will give: `kalfit predict`.

mod profile;
mod table;
mod units;

use kalfit::predict::{Bounds, Initial, MeanLimits, Output, Predictor};
use kalfit::record::{PredictedRecord, PredictedSource};
use kalfit::{Grouping, PhasedTest};
use kalfit_data::{DataReading, Input};
use kalfit_spec::{BesideError, DesignSpec, Spec};

use self::profile::ProfileData;
use self::table::{columns, write_phase};
use self::units::UnitLaws;
use crate::document::Document;
use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{JobDone, PredictJob, PredictedModel, PredictedUnits, files};
use crate::output::PendingFile;
use crate::refused::by_predict;
use crate::table::{OutputTable, OutputTableWriter};
use crate::work::{JobWatch, JobWork};
use crate::{model, tests, truth};

/// Predictions of this many rows, or of one test, are held at a time.
const BATCH_ROWS: usize = 50_000;

/// Predicts states and outputs of designs.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn predict(job: &PredictJob, watch: &mut dyn JobWatch) -> Result<JobDone<PredictedModel>, Failure> {
    let (spec, truth) = truth::load(&job.model, &job.from)?;
    let units = UnitLaws::new(job, &spec, &truth)?;
    let DesignSpec { spec: design, outputs } = designed(job, &spec)?;
    let inputs = Input::expand(&job.design).map_err(|error| Failure::data(error, &design))?;
    let documents: Vec<_> = [&job.model.document, &job.from].into_iter().chain(&job.outputs).collect();
    let mut read = files(&documents, &inputs);
    let profiles = ProfileData::open(job, &truth)?;
    read.extend(profiles.iter().flat_map(|profiles| files(&[], &profiles.given.inputs)));
    let table = OutputTable::prepare(&job.out, &read)?;
    let knowledge = truth.knowledge(&spec);
    let mut work = JobWork::new(watch);
    let (tests, reading) = tests::read(&design, &CommandInputs::rows_of(inputs), &mut work)?;
    let values = (&model::alpha(&design), truth.population.coefficients.as_slice());
    let estimation = knowledge.is_some();
    let predictor =
        Predictor::new(&design.model, &outputs, values, knowledge).map_err(|error| by_predict(error, None))?;
    let source = PredictedSource {
        name: job.from.name(),
        fitted: truth.fitted,
        changed: truth.changed,
        known_units: job.units == PredictedUnits::Known,
        estimation,
        profile: profiles.is_some(),
        covariance_errors: units.have_covariance_errors(),
    };
    let mut warnings = truth.warnings;
    let grouping = units.grouping(&design, &tests)?;
    warnings.extend(units.new_levels(&tests, grouping.as_ref(), &reading.labels));
    let profiles = profiles.map(|profiles| profiles.limits((&predictor, &tests, &units, &reading), job, &mut work));
    let record = PredictedRecord::new(&design.model, source, job.limits);
    let mut task = PredictionTask {
        bounds: Bounds::new(job.limits),
        design: &design,
        outputs: &outputs,
        predictor: &predictor,
        units: &units,
        grouping,
        reading: &reading,
        profiles: profiles.transpose()?,
        estimation,
        record,
    };
    let pending = match &table {
        Some(table) => {
            let rows = |writer: &mut OutputTableWriter<'_>| task.each(&tests, &mut work, Some((table, writer)));
            Some(table.write(&columns(), rows)?)
        }
        None => {
            task.each(&tests, &mut work, None)?;
            None
        }
    };
    let record = task.record;
    let back = pending.map_or(Ok(None), PendingFile::finish)?;
    let written = table.iter().filter_map(|table| table.target.name()).collect();
    Ok(JobDone::new(PredictedModel { record, table: back }, warnings, written))
}

/// The model for designs, at the values that were taken; `levels`: whether the designs are of known groups.
pub(crate) fn design(spec: &Spec, outputs: Option<&Document>, levels: bool) -> Result<DesignSpec, Failure> {
    let text = outputs.map(model::text).transpose()?;
    let of_outputs = |error| {
        let name = outputs.map_or_else(String::new, Document::name);
        Failure::model(error, &name, text.clone())
    };
    let mut found = spec.design(text.as_deref(), levels).map_err(|error| match error {
        BesideError::File(error) => of_outputs(error),
        BesideError::Model(error) => Failure::model(error, &spec.name, Some(spec.text.clone())),
    })?;
    found.spec.take_values(spec);
    Ok(found)
}

/// The model for designs; of two outputs of a phase in one unit the sum is a third.
fn designed(job: &PredictJob, spec: &Spec) -> Result<DesignSpec, Failure> {
    let mut found = design(spec, job.outputs.as_ref(), job.units == PredictedUnits::Known)?;
    for outputs in &mut found.outputs {
        if let [first, second] = &outputs[..]
            && first.unit == second.unit
        {
            let sum = Output::sum(first, second);
            outputs.push(sum);
        }
    }
    Ok(found)
}

/// All that predictions depend on.
struct PredictionTask<'a> {
    bounds: Bounds,
    design: &'a Spec,
    outputs: &'a [Vec<Output>],
    predictor: &'a Predictor,
    units: &'a UnitLaws,
    grouping: Option<Grouping>,
    reading: &'a DataReading,
    /// Limits of all means by profile likelihood, in their order.
    profiles: Option<Vec<Option<[f64; 2]>>>,
    /// What the estimates leave open is known.
    estimation: bool,
    record: PredictedRecord,
}

impl PredictionTask<'_> {
    /// Predicts batch by batch.
    fn each(
        &mut self,
        tests: &[PhasedTest],
        work: &mut JobWork<'_>,
        mut to: Option<(&OutputTable, &mut OutputTableWriter<'_>)>,
    ) -> Result<(), Failure> {
        let known = self.estimation;
        let mut limits = self.profiles.take().map(Vec::into_iter);
        let mut done = 0;
        while done < tests.len() {
            let next = tests::batch(tests, done, BATCH_ROWS);
            work.go_on()?;
            let own = &tests[done..next];
            let initial = own.iter().map(|test| self.units.initial(test, self.grouping.as_ref(), &self.reading.labels));
            let laws = initial.collect::<Result<Vec<_>, _>>()?;
            let initial: Vec<&Initial> = laws.iter().map(AsRef::as_ref).collect();
            let mut found =
                self.predictor.predict(own, &initial).map_err(|error| by_predict(error, Some(self.reading)))?;
            if let Some(limits) = &mut limits {
                let steps = found.iter_mut().flatten().flat_map(|phase| &mut phase.steps);
                let values = steps.flat_map(|step| &mut step.values);
                values.zip(limits).for_each(|(value, own)| {
                    let is_open = known && value.estimation.is_none(); // on what the data do not determine
                    value.limits = MeanLimits::Profile(own.filter(|_| !is_open));
                });
            }
            for (test, phases) in own.iter().zip(&found) {
                self.record.add((&self.design.model, self.outputs, &self.bounds), &test.id, phases);
                if let Some((table, writer)) = &mut to {
                    for phase in phases {
                        write_phase((&self.design.model, self.outputs, &self.bounds), &test.id, phase, writer)
                            .map_err(table.failed())?;
                    }
                }
            }
            done = next;
            work.share("predicting", done as u64, tests.len() as u64);
            work.say(|| format!("predicting: {done} of {} tests", tests.len()));
        }
        Ok(())
    }
}
