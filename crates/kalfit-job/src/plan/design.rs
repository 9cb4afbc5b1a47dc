//! Expected standard errors of one design against the number of tests.

use std::sync::Arc;

use kalfit::estimate::Structure;
use kalfit::model::PhasedModel;
use kalfit::plan::{Arrangement, plan_groups};
use kalfit::record::DataRecord;
use kalfit::record::{PlanProvenance, PlanRecord};
use kalfit::reduce::{GroupingError, PhasedReducer, grouping_of, groups_of};
use kalfit::{Alpha, Grouping, Label, Labels, PhasedTest, Reductions, Test};
use kalfit_data::{Input, TestSink};
use kalfit_spec::Spec;

use crate::evidence::stdin;
use crate::failure::Failure;
use crate::job::{DesignPlan, JobDone, PlanJob, files};
use crate::output::OutputFile;
use crate::refused::{self, SinkRefusal};
use crate::truth::Truth;
use crate::work::{JobWatch, JobWork};

/// Expects standard errors against the number of tests.
pub(super) fn expected(
    job: &PlanJob,
    plan: &DesignPlan,
    (spec, truth): (Spec, Truth),
    watch: &mut dyn JobWatch,
) -> Result<JobDone<PlanRecord>, Failure> {
    let arrangements = arrangements(&spec.model, plan)?;
    let inputs = Input::expand(&plan.design).map_err(|error| Failure::data(error, &spec))?;
    let used = files(&[&job.model.document, &job.from], &inputs);
    let output = OutputFile::results(job.out.as_deref(), &used)?;
    let mut work = JobWork::new(watch);
    let (reductions, grouping) = designs(&spec, &truth.alpha, &inputs, &mut work)?;
    let structure = Structure::of(&spec.model, &truth.alpha, grouping.as_ref());
    let states = spec.model.estimated_names();
    work.go_on()?;
    let found = match arrangements.is_empty() {
        true => kalfit::plan::plan(&reductions, &structure, &truth.population, &plan.tests),
        false => plan_groups(&reductions, &structure, &truth.population, &arrangements),
    };
    let found = found.map_err(|error| Failure::Plan { error: Box::new(error), states })?;
    let provenance = PlanProvenance {
        model_digest: Some(spec.digest.clone()),
        from: job.from.name(),
        design: DataRecord::of(&reductions, inputs.iter().map(Input::name).collect()),
        parameters_taken_as_known: truth.taken.clone(),
    };
    let record = PlanRecord::new(&spec.model, &found, provenance);
    work.go_on()?;
    JobDone::in_json(record, truth.warnings, output.as_ref())
}

/// Every number of groups of each level with every number of tests; none for a model without levels.
fn arrangements(model: &PhasedModel, job: &DesignPlan) -> Result<Vec<Arrangement>, Failure> {
    let names: Vec<&str> = model.levels.iter().map(|level| level.name.as_str()).collect();
    if let Some((found, _)) = job.groups.iter().find(|(name, _)| !names.contains(&name.as_str())) {
        let expected = names.iter().map(|&name| name.to_owned()).collect();
        return Err(Failure::UnknownLevel { found: found.clone(), expected });
    }
    let mut all = vec![Vec::new()];
    for name in &names {
        let level = || (*name).to_owned();
        let given: Vec<&Vec<usize>> =
            job.groups.iter().filter(|(own, _)| own == name).map(|(_, counts)| counts).collect();
        let counts = match given[..] {
            [] => return Err(Failure::NoGroups { level: level() }),
            [counts] => counts,
            _ => return Err(Failure::GroupsTwice { level: level() }),
        };
        let more = |groups: &Vec<usize>| -> Vec<Vec<usize>> {
            counts.iter().map(|&count| groups.iter().copied().chain([count]).collect()).collect()
        };
        all = all.iter().flat_map(more).collect();
    }
    if names.is_empty() {
        return Ok(Vec::new());
    }
    let crossed = model.factors().len();
    let with_tests = |counts: Vec<usize>| {
        let (factors, groups) = (counts[..crossed].to_vec(), counts[crossed..].to_vec());
        job.tests.iter().map(move |&tests| Arrangement { factors: factors.clone(), groups: groups.clone(), tests })
    };
    Ok(all.into_iter().flat_map(with_tests).collect())
}

/// The tests of a design, and the groups that they stand in.
type Designs = (Reductions, Option<Arc<Grouping>>);

/// Reads the design and runs the covariance filters over it: what was measured is not looked at.
fn designs(spec: &Spec, alpha: &Alpha, inputs: &[Input], work: &mut JobWork<'_>) -> Result<Designs, Failure> {
    struct DesignReducer<'a, 'w> {
        model: &'a PhasedModel,
        reducer: PhasedReducer,
        reductions: Reductions,
        /// The names of the groups of each test.
        paths: Vec<Result<Vec<Label>, GroupingError>>,
        work: &'a mut JobWork<'w>,
    }
    impl TestSink for DesignReducer<'_, '_> {
        type Error = SinkRefusal;

        fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), SinkRefusal> {
            SinkRefusal::unless_stopped(self.work)?;
            let split = |test| self.model.split(test, labels).map_err(SinkRefusal::Split);
            let tests = tests.into_iter().map(split).collect::<Result<Vec<_>, _>>()?;
            let path = |test: &PhasedTest| groups_of(self.model, &test.id, &test.phases[0]);
            self.paths.extend(tests.iter().filter(|_| !self.model.levels.is_empty()).map(path));
            self.reductions.append(self.reducer.reduce_designs(&tests).map_err(SinkRefusal::Reduce)?);
            let done = self.reductions.len();
            self.work.say(|| format!("reading: {done} tests"));
            Ok(())
        }

        fn restart(&mut self) {
            (self.reductions, self.paths) = (Reductions::new(), Vec::new());
        }
    }
    let reducer = PhasedReducer::new(&spec.model, alpha).map_err(|error| Failure::Reduce { error, reading: None })?;
    let mut sink =
        DesignReducer { model: &spec.model, reducer, reductions: Reductions::new(), paths: Vec::new(), work };
    kalfit_data::read_from(&spec.model, &spec.layout, inputs, &mut sink, &mut stdin(inputs))
        .map_err(|error| refused::failure(error, spec))?;
    let DesignReducer { reductions, paths, .. } = sink;
    let refused = |error: GroupingError| Failure::Apply(Box::new(error.into()));
    let paths = paths.into_iter().collect::<Result<Vec<_>, _>>().map_err(refused)?;
    let ids: Vec<&str> = reductions.iter().map(|design| design.test).collect();
    let grouping = grouping_of(&spec.model, ids.into_iter().zip(paths)).map(Arc::new);
    Ok((reductions, grouping))
}
