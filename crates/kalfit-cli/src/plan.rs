//! `kalfit plan`.

use std::path::{Path, PathBuf};

use kalfit::estimate::Structure;
use kalfit::model::PhasedModel;
use kalfit::plan::{PlanProvenance, PlanRecord, plan};
use kalfit::record::DataRecord;
use kalfit::reduce::{PhasedReducer, ReduceError, SplitError};
use kalfit::{Alpha, Labels, Reduction, Test};
use kalfit_data::{Input, ReadError, Sink};
use kalfit_report::plan_summary;
use kalfit_spec::Spec;

use crate::failure::Failure;
use crate::job::{Outcome, PlanJob};
use crate::output::Output;
use crate::progress::Line;
use crate::simulate::used;
use crate::{model, terminal, truth};

pub(crate) fn run(job: &PlanJob) -> Result<Outcome, Failure> {
    let mut spec = model::read(&job.model.path)?;
    let truth = truth::load(&mut spec, &job.from, &job.model.set)?;
    let inputs = Input::expand(&job.design).map_err(|error| Failure::data(error, &spec))?;
    let used = used(&job.model.path, &job.from, &inputs);
    let used: Vec<&Path> = used.iter().map(PathBuf::as_path).collect();
    let output = job.out.as_deref().map(|path| Output::prepare(path, &used)).transpose()?;
    let mut line = Line::new(job.quiet);
    let reductions = designs(&spec, &truth.alpha, &inputs, &mut line)?;
    let structure = Structure::of(&spec.model, &truth.alpha);
    let states = spec.model.estimated_names();
    let found = plan(&reductions, &structure, &truth.population, &job.tests)
        .map_err(|error| Failure::Plan { error: Box::new(error), states })?;
    let provenance = PlanProvenance {
        model_digest: Some(spec.digest.clone()),
        from: job.from.display().to_string(),
        design: DataRecord::of(&reductions, inputs.iter().map(Input::name).collect()),
        parameters_taken_as_known: truth.taken.clone(),
    };
    let record = PlanRecord::new(&spec.model, &found, provenance);
    line.clear();
    if let Some(output) = &output {
        output.write(&record)?;
    }
    if !job.quiet {
        terminal::warn(&truth.warnings);
        terminal::print(&plan_summary(&record, &terminal::style())).map_err(Failure::Stdout)?;
        if let Some(output) = &output {
            terminal::complain(&format!("Wrote {}\n", output.name()));
        }
    }
    Ok(Outcome::Done)
}

/// Reads the design and runs the covariance filters over it: what was measured is not looked at.
fn designs(spec: &Spec, alpha: &Alpha, inputs: &[Input], line: &mut Line) -> Result<Vec<Reduction>, Failure> {
    struct Designing<'a> {
        model: &'a PhasedModel,
        reducer: PhasedReducer,
        reductions: Vec<Reduction>,
        line: &'a mut Line,
    }
    impl Sink for Designing<'_> {
        type Error = Unreadable;

        fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), Unreadable> {
            let split = |test| self.model.split(test, labels).map_err(Unreadable::Split);
            let tests = tests.into_iter().map(split).collect::<Result<Vec<_>, _>>()?;
            self.reductions.extend(self.reducer.reduce_designs(&tests).map_err(Unreadable::Reduce)?);
            let done = self.reductions.len();
            self.line.say(|| format!("reading: {done} tests"));
            Ok(())
        }

        fn restart(&mut self) {
            self.reductions.clear();
        }
    }
    enum Unreadable {
        Split(SplitError),
        Reduce(ReduceError),
    }
    let reducer = PhasedReducer::new(&spec.model, alpha).map_err(|error| Failure::Reduce { error, reading: None })?;
    let mut sink = Designing { model: &spec.model, reducer, reductions: Vec::new(), line };
    kalfit_data::read(&spec.model, &spec.layout, inputs, &mut sink).map_err(|error| match error {
        ReadError::Data(error) => Failure::data(error, spec),
        ReadError::Sink { error: Unreadable::Split(error), reading } => Failure::Split { error, reading },
        ReadError::Sink { error: Unreadable::Reduce(error), reading } => {
            Failure::Reduce { error, reading: Some(reading) }
        }
    })?;
    Ok(sink.reductions)
}
