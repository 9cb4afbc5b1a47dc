//! The best plan among candidates (theory §15).

use std::path::Path;

use kalfit::dynamic::UnitInformation;
use kalfit::model::{PhasedModel, Slots};
use kalfit::plan::{CandidateInformation, Goal, NoPlan, best_plan, drawn};
use kalfit::record::{BestPlanRecord, DataRecord, DrawsRecord, PlanNames, PlanProvenance, PlanRecord};
use kalfit_data::{Datum, Input};
use kalfit_spec::Spec;

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{BestPlanRequest, JobDone, PlanJob, SoFar, files};
use crate::model;
use crate::output::OutputFile;
use crate::plan::candidates::{self, ReadCandidates};
use crate::plan::error::BestPlanError;
use crate::plan::goal::Figures;
use crate::plan::mission::Mission;
use crate::plan::planned::{Before, Planned, TestsToPlan, freed, values, with_so_far};
use crate::truth::Truth;
use crate::work::{JobWatch, JobWork};

/// Largest number of numbers in the information of all candidates: some 800 MB.
const MOST_NUMBERS: usize = 100_000_000;

/// Chooses the best plan.
pub(super) fn choose(
    job: &PlanJob,
    request: &BestPlanRequest,
    (mut spec, truth): (Spec, Truth),
    watch: &mut dyn JobWatch,
) -> Result<JobDone<PlanRecord>, Failure> {
    let given =
        CommandInputs::rows_of(Input::expand(&request.candidates).map_err(|error| Failure::data(error, &spec))?);
    let used = files(&[&job.model.document, &job.from], &given.inputs);
    let output = OutputFile::results(job.out.as_deref(), &used)?;
    let mut work = JobWork::new(watch);
    let read = candidates::read(&spec, request, &given, &mut work)?;
    let free = freed(&spec, &model::read(&job.model.document)?, &truth);
    let planned = Planned { free: &free, population: &truth.population, alpha: &truth.alpha };
    let tests = TestsToPlan::new(&free, &read.tests, &read.reading, &truth.alpha)?;
    work.say(|| format!("information of {} tests", read.tests.len()));
    let (slots, known) = planned.slots(&tests, &read.reading)?;
    let found = planned.information(&tests, (&slots, &values(&slots, &truth.alpha)), &mut work)?;
    let names = tests.names(&found, &read);
    let kinds = read.kinds(&names, &found.members, request.budget)?;
    refuse_too_many(&found, request)?;
    let candidates = CandidateInformation::new(found);
    let (scenario, before) = with_so_far(&mut spec, request, (&planned, &slots), candidates, &mut work)?;
    let mission = Mission::read(&spec, request, &mut work)?;
    let scenario = mission.on(scenario, &slots, &truth.alpha)?;
    let plan_names = PlanNames { parameters: parameter_names(&free, &slots), mission: mission.names(&scenario) };
    let figures = Figures::of_model(&free, &plan_names, &scenario.candidates);
    let goal = figures.goal(&request.goal, &scenario)?;
    let draws = Draws { read: &read, slots: &slots, before: &before, mission: &mission };
    let scenarios = draws.with_others(&planned, scenario, (job, request, &spec, &truth), &mut work)?;
    work.say(|| "choosing the best plan".to_owned());
    work.go_on()?;
    let best = best_plan(&scenarios, &kinds, &goal, &figures.all)
        .map_err(|error| in_words(error, &figures, (&goal, request)))?;
    let draws = request.draws.map(|(_, seed)| DrawsRecord { count: scenarios.len() - 1, seed });
    let named = request.so_far.as_ref().map(SoFar::name);
    let mut record =
        BestPlanRecord::new((&best, request.goal.trim().to_owned(), scenarios.len()), (&names, &kinds), (named, draws));
    record.simulate = simulation(job, &spec, &given);
    let mut taken: Vec<String> = known;
    taken.sort();
    let provenance = PlanProvenance {
        model_digest: Some(spec.digest.clone()),
        from: job.from.name(),
        design: DataRecord::of(&tests.reductions, given.names()),
        parameters_taken_as_known: taken,
    };
    let record = PlanRecord::of_best((&spec.model, &plan_names), &best.figures, record, provenance);
    work.go_on()?;
    let mut notes = truth.warnings;
    let left_out = request.draws.map_or(0, |(count, _)| count + 1 - scenarios.len());
    if left_out > 0 {
        notes.push(format!(
            "{left_out} draws are left out: the model fixes elements of the covariance that they would move"
        ));
    }
    JobDone::in_json(record, notes, output.as_ref())
}

/// What candidates at other parameters are made from.
struct Draws<'a> {
    read: &'a ReadCandidates,
    slots: &'a Slots,
    before: &'a Before,
    mission: &'a Mission,
}

impl Draws<'_> {
    /// The candidates at the parameters that are planned for, then at those that are drawn about them.
    fn with_others(
        &self,
        planned: &Planned<'_>,
        first: CandidateInformation,
        (job, request, spec, truth): (&PlanJob, &BestPlanRequest, &Spec, &Truth),
        work: &mut JobWork<'_>,
    ) -> Result<Vec<CandidateInformation>, Failure> {
        let mut scenarios = vec![first];
        let Some(draws) = request.draws else { return Ok(scenarios) };
        let law = truth.knowledge(spec).filter(|_| truth.record.is_some());
        let law = law.ok_or_else(|| BestPlanError::NoLaw { from: job.from.name() })?;
        for own in drawn(&law, self.slots, &scenarios[0].candidates, draws) {
            work.go_on()?;
            work.say(|| format!("information at draw {} of {}", scenarios.len(), draws.0));
            let found = planned.at(&own, (self.read, self.slots), self.before, work)?;
            let there = |found| self.mission.on(found, self.slots, &own.alpha(planned.alpha, self.slots));
            scenarios.extend(found.map(there).transpose()?);
        }
        if scenarios.len() == 1 {
            return Err(BestPlanError::NoDraws.into());
        }
        Ok(scenarios)
    }
}

/// The command that draws an ensemble of the plan, ready to be typed; `None` where it is in no file, and with levels.
fn simulation(job: &PlanJob, spec: &Spec, given: &CommandInputs) -> Option<String> {
    let out = job.out.as_ref().filter(|out| out.as_os_str() != "-" && spec.model.levels.is_empty())?;
    let (model, from) = (job.model.document.path()?, job.from.path()?);
    let is_plain = |letter: char| letter.is_alphanumeric() || "/._-+=:@%".contains(letter);
    let quoted = |text: String| match text.chars().all(is_plain) && !text.is_empty() {
        true => text,
        false => format!("'{}'", text.replace('\'', "'\\''")),
    };
    let path = |path: &Path| quoted(path.display().to_string());
    let designs: Vec<String> = given.names().into_iter().map(quoted).collect();
    let set: String = job.model.set.iter().map(|set| format!(" --set {}", quoted(set.clone()))).collect();
    let (model, from, out, designs) = (path(model), path(from), path(out), designs.join(" "));
    Some(format!("kalfit simulate {model}{set} --from {from} --design {designs} --plan {out} --seed 1 --out drawn.csv"))
}

impl SoFar {
    /// What the user calls it.
    fn name(&self) -> String {
        match self {
            SoFar::Fit(document) => document.name(),
            SoFar::Tests(data) => {
                let name = |datum: &Datum| match datum {
                    Datum::Named(name) => name.clone(),
                    Datum::Table(table) => table.name().to_owned(),
                };
                data.iter().map(name).collect::<Vec<_>>().join(", ")
            }
        }
    }
}

fn parameter_names(free: &PhasedModel, slots: &Slots) -> Vec<String> {
    slots.slots().iter().map(|slot| free.shared().parameters[slot.parameter].name.clone()).collect()
}

fn refuse_too_many(found: &UnitInformation, request: &BestPlanRequest) -> Result<(), Failure> {
    let (candidates, values) = (found.units.len(), found.jacobian.nrows());
    let sets = 1 + request.draws.map_or(0, |(count, _)| count);
    let numbers = candidates.saturating_mul(values * values).saturating_mul(sets + 1);
    if numbers > MOST_NUMBERS {
        return Err(BestPlanError::TooMany { candidates, values, sets, numbers }.into());
    }
    Ok(())
}

fn in_words(error: NoPlan, figures: &Figures, (goal, request): (&Goal, &BestPlanRequest)) -> BestPlanError {
    let budget = request.budget;
    match error {
        NoPlan::Fixed(figure) => BestPlanError::Fixed { figure: figures.name(figure) },
        NoPlan::Uninformed(all) => BestPlanError::Uninformed {
            figures: all.into_iter().map(|figure| figures.name(figure)).collect(),
            of_all: *goal == Goal::All,
        },
        NoPlan::Budget { cheapest } => BestPlanError::Budget { budget, cheapest },
        NoPlan::Dependent => BestPlanError::Dependent { goal: request.goal.trim().to_owned() },
        NoPlan::NothingFree => BestPlanError::NothingFree { goal: request.goal.trim().to_owned() },
        NoPlan::TooLittle => {
            let what = if *goal == Goal::All { "all that the model leaves free" } else { request.goal.trim() };
            BestPlanError::TooLittle { budget, what: what.to_owned() }
        }
    }
}
