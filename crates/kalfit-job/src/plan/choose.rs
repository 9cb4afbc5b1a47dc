//! The best plan among candidates (theory §15).

use std::path::Path;
use std::sync::Arc;

use kalfit::dynamic::{UnitError, UnitInformation, unit_information};
use kalfit::estimate::{ExpectedError, Structure};
use kalfit::infer::Knowledge;
use kalfit::model::{Level, PhasedModel, Slots, Value};
use kalfit::plan::{
    CandidateInformation, DrawnParameters, Figure, Goal, MissionValue, NoPlan, PlanError, PlannedFigure, Quantity,
    best_plan, drawn, mission,
};
use kalfit::predict::What;
use kalfit::record::{BestPlanRecord, DataRecord, DrawsRecord, PlanNames, PlanProvenance, PlanRecord, PlannedRecord};
use kalfit::reduce::{PhasedReducer, grouping};
use kalfit::{Alpha, Grouping, PhasedTest, Population, Reductions};
use kalfit_data::{DataReading, Datum, Input};
use kalfit_spec::{DesignSpec, Spec};

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{BestPlanRequest, JobDone, PlanJob, SoFar, files};
use crate::output::OutputFile;
use crate::plan::candidates::{self, ReadCandidates};
use crate::plan::error::BestPlanError;
use crate::plan::goal::Figures;
use crate::predict;
use crate::refused::by_predict;
use crate::results::{self, FIT};
use crate::truth::Truth;
use crate::truth::error::TruthError;
use crate::work::{JobWatch, JobWork};
use crate::{dynamic, model, tests};

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
    let kinds = read.kinds(&names, &found.members, request.budget).map_err(refused_plan)?;
    refuse_too_many(&found, request)?;
    let candidates = CandidateInformation::new(found);
    let (scenario, before) = with_so_far(&mut spec, request, (&planned, &slots), candidates, &mut work)?;
    let mission = Mission::read(&spec, request, &mut work)?;
    let scenario = mission.on(scenario, &slots, &truth.alpha)?;
    let plan_names = PlanNames { parameters: parameter_names(&planned, &slots), mission: mission.names(&scenario) };
    let figures = figures(&planned, &plan_names, &scenario.candidates);
    let goal = figures.goal(&request.goal, &scenario).map_err(refused_plan)?;
    let mut scenarios = vec![scenario];
    if let Some(draws) = request.draws {
        let law = truth.knowledge(&spec).filter(|_| truth.record.is_some());
        let law = law.ok_or_else(|| refused_plan(BestPlanError::NoLaw { from: job.from.name() }))?;
        for own in drawn(&law, &slots, &scenarios[0].candidates, draws) {
            work.go_on()?;
            work.say(|| format!("information at draw {} of {}", scenarios.len(), draws.0));
            let found = planned.at(&own, (&read, &slots), &before, &mut work)?;
            let there = |found| mission.on(found, &slots, &own.alpha(&truth.alpha, &slots));
            scenarios.extend(found.map(there).transpose()?);
        }
        if scenarios.len() == 1 {
            return Err(refused_plan(BestPlanError::NoDraws));
        }
    }
    work.say(|| "choosing the best plan".to_owned());
    work.go_on()?;
    let best = best_plan(&scenarios, &kinds, &goal, &figures.all)
        .map_err(|error| refused_plan(in_words(error, &figures, (&goal, request))))?;
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

fn refused_plan(error: BestPlanError) -> Failure {
    Failure::BestPlan(Box::new(error))
}

/// The model with the parameters free that the model file leaves free, but for parameters with a value for each level of a
/// column: a plan has candidates of few levels.
fn freed(spec: &Spec, original: &Spec, truth: &Truth) -> PhasedModel {
    let mut free = spec.model.clone();
    for model in free.models_mut() {
        for (own, original) in model.parameters.iter_mut().zip(&original.model.shared().parameters) {
            if truth.taken.contains(&own.name) && own.per.is_none() {
                own.value = original.value;
            }
        }
    }
    free
}

/// Tests with their reductions and groups.
struct TestsToPlan<'a> {
    tests: &'a [PhasedTest],
    reductions: Reductions,
    grouping: Option<Arc<Grouping>>,
}

impl<'a> TestsToPlan<'a> {
    fn new(
        model: &PhasedModel,
        tests: &'a [PhasedTest],
        reading: &DataReading,
        alpha: &Alpha,
    ) -> Result<TestsToPlan<'a>, Failure> {
        let refused = |error| Failure::Reduce { error, reading: Some(Box::new(reading.clone())) };
        let reducer = PhasedReducer::new(model, alpha).map_err(refused)?;
        let reductions = reducer.reduce_designs(tests).map_err(refused)?;
        let grouping = grouping(model, tests).map_err(|error| dynamic::failure(error.into(), reading))?;
        Ok(TestsToPlan { tests, reductions, grouping: grouping.map(Arc::new) })
    }

    /// The name of each unit: of its test, or of its group of the outermost level.
    fn names(&self, found: &UnitInformation, read: &ReadCandidates) -> Vec<String> {
        let of = |members: &Vec<usize>| {
            let test = &self.tests[members[0]];
            let group = self.grouping.as_deref().and_then(|grouping| {
                let number = grouping.number(test.id.as_str())?;
                let group = &grouping.groups(0)[grouping.group_of(number, 0)];
                Some(read.reading.labels.text(*group.path.first()?).to_owned())
            });
            group.unwrap_or_else(|| test.id.to_string())
        };
        found.members.iter().map(of).collect()
    }
}

/// The parameters that are planned for.
struct Planned<'a> {
    free: &'a PhasedModel,
    population: &'a Population,
    alpha: &'a Alpha,
}

impl Planned<'_> {
    /// The free values that a plan takes into account, and the names of free parameters that it takes as known: those with
    /// values of levels, and those that Σ depends on.
    fn slots(&self, tests: &TestsToPlan<'_>, reading: &DataReading) -> Result<(Slots, Vec<String>), Failure> {
        let all = Slots::in_phases(self.free, &reading.labels, tests.tests);
        let parameters = &self.free.shared().parameters;
        let mut known = Vec::new();
        for slot in all.slots() {
            let mut moved = self.alpha.clone();
            if let Level::Common(value) = &mut moved.values[slot.parameter] {
                *value = if *value == 0.0 { 1e-3 } else { *value * 1.001 };
            }
            let structure = Structure::of(self.free, &moved, tests.grouping.as_ref());
            let off = kalfit::estimate::information_at_population(&tests.reductions, &structure, self.population);
            if matches!(off, Err(ExpectedError::Off { .. })) {
                known.push(slot.parameter);
            }
        }
        let name = |&parameter: &usize| parameters[parameter].name.clone();
        let mut names: Vec<String> = known.iter().map(name).collect();
        let is_free = |parameter: &&kalfit::model::Parameter| matches!(parameter.value, Value::Free { .. });
        names.extend(parameters.iter().filter(|own| own.per.is_some()).filter(is_free).map(|own| own.name.clone()));
        Ok((all.without(&known), names))
    }

    /// The candidates with what is known before.
    fn after(
        &self,
        candidates: CandidateInformation,
        slots: &Slots,
        before: &Before,
        work: &mut JobWork<'_>,
    ) -> Result<CandidateInformation, Failure> {
        Ok(match before {
            Before::Nothing => candidates,
            Before::Tests(tests, reading) => {
                let made = TestsToPlan::new(self.free, tests, reading, self.alpha)?;
                candidates.after_tests(&self.information(&made, (slots, &values(slots, self.alpha)), work)?)
            }
            Before::Fit(knowledge) => candidates.after_fit(knowledge, slots),
        })
    }

    /// The candidates at other parameters; `None` where the model's structure cannot have them.
    fn at(
        &self,
        other: &DrawnParameters,
        (read, slots): (&ReadCandidates, &Slots),
        before: &Before,
        work: &mut JobWork<'_>,
    ) -> Result<Option<CandidateInformation>, Failure> {
        let alpha = other.alpha(self.alpha, slots);
        let planned = Planned { free: self.free, population: &other.population, alpha: &alpha };
        let tests = TestsToPlan::new(self.free, &read.tests, &read.reading, &alpha)?;
        match planned.information(&tests, (slots, &other.values), work) {
            Ok(found) => Ok(Some(planned.after(CandidateInformation::new(found), slots, before, work)?)),
            Err(Failure::Plan { error, .. }) if matches!(*error, PlanError::OffStructure { .. }) => Ok(None),
            Err(failure) => Err(failure),
        }
    }

    fn information(
        &self,
        tests: &TestsToPlan<'_>,
        slots: (&Slots, &[f64]),
        work: &mut JobWork<'_>,
    ) -> Result<UnitInformation, Failure> {
        let structure = Structure::of(self.free, self.alpha, tests.grouping.as_ref());
        let of = (&tests.reductions, &structure, self.population);
        let found = unit_information((self.free, tests.tests), slots, of, work);
        let refused = |error: UnitError| match error {
            UnitError::Expected(error) => {
                Failure::Plan { error: Box::new(PlanError::from(error)), states: self.free.estimated_names() }
            }
            UnitError::Dynamic(error) => Failure::Dynamic(Box::new(error)),
            UnitError::NotByRows => refused_plan(BestPlanError::NotByRows(error.to_string())),
        };
        found.map_err(refused)?.ok_or(Failure::Interrupted)
    }
}

fn values(slots: &Slots, alpha: &Alpha) -> Vec<f64> {
    let of = |slot: &kalfit::model::Slot| match &alpha.values[slot.parameter] {
        Level::Common(value) => *value,
        Level::Each { other, .. } => other.unwrap_or(f64::NAN),
    };
    slots.slots().iter().map(of).collect()
}

/// The test that has not been made, whose values are figures.
struct Mission {
    design: DesignSpec,
    test: Option<PhasedTest>,
}

impl Mission {
    fn read(spec: &Spec, request: &BestPlanRequest, work: &mut JobWork<'_>) -> Result<Mission, Failure> {
        let design = predict::design(spec, request.outputs.as_ref(), false)?;
        if request.mission.is_empty() {
            return Ok(Mission { design, test: None });
        }
        let inputs = Input::expand(&request.mission).map_err(|error| Failure::data(error, &design.spec))?;
        let (mut tests, _) = tests::read(&design.spec, &CommandInputs::rows_of(inputs), work)?;
        match tests.len() {
            1 => Ok(Mission { design, test: tests.pop() }),
            found => Err(refused_plan(BestPlanError::Mission { found })),
        }
    }

    /// The candidates with the values of the mission at their parameters.
    fn on(
        &self,
        candidates: CandidateInformation,
        slots: &Slots,
        alpha: &Alpha,
    ) -> Result<CandidateInformation, Failure> {
        let Some(test) = &self.test else { return Ok(candidates) };
        let design = (&self.design.spec.model, &self.design.outputs[..], alpha);
        let found = mission(design, test, (&candidates.candidates, slots)).map_err(|error| by_predict(error, None))?;
        Ok(candidates.with_mission(found))
    }

    /// `range, 3` for output `range` at row 3, with the phase where there are several.
    fn names(&self, candidates: &CandidateInformation) -> Vec<String> {
        let model = &self.design.spec.model;
        let of = |one: &MissionValue| {
            let phase = &model.phases[one.phase];
            let name = match one.what {
                What::State(state) => &phase.model.states[state].name,
                What::Output(output) => &self.design.outputs[one.phase][output].name,
            };
            let prefix = if model.is_single() { String::new() } else { format!("{}.", phase.name) };
            format!("{prefix}{name}, {}", one.row + 1)
        };
        candidates.mission().iter().map(of).collect()
    }
}

fn parameter_names(planned: &Planned<'_>, slots: &Slots) -> Vec<String> {
    slots.slots().iter().map(|slot| planned.free.shared().parameters[slot.parameter].name.clone()).collect()
}

/// All figures that the model leaves free, with their names.
fn figures(planned: &Planned<'_>, names: &PlanNames, found: &UnitInformation) -> Figures {
    let Population { mean, coefficients, .. } = found.population();
    let elements: Vec<(usize, usize)> = found.elements().collect();
    let off_diagonal = || elements.iter().filter(|(i, j)| i != j);
    let own = planned.free.dimension();
    let means = (0..mean.len().min(own)).map(Quantity::Mean);
    let quantities = means
        .chain((0..coefficients.len()).map(Quantity::Coefficient))
        .chain(elements.iter().filter(|(i, j)| i == j).map(|&(i, _)| Quantity::StdDev(i)))
        .chain(off_diagonal().map(|&(i, j)| Quantity::Correlation(i, j)))
        .chain(elements.iter().map(|&(i, j)| Quantity::Covariance(i, j)));
    let (free, fixed): (Vec<Quantity>, Vec<Quantity>) =
        quantities.partition(|quantity| found.gradient(*quantity).amax() > 0.0);
    let values = (0..names.parameters.len()).map(Figure::Value);
    let of_mission = (0..names.mission.len()).flat_map(|at| [Figure::Output(at), Figure::Limit(at)]);
    let all: Vec<Figure> = free.into_iter().map(Figure::Quantity).chain(values).chain(of_mission).collect();
    let several = !planned.free.is_single();
    let name = |figure: Figure| {
        let bare = PlannedFigure { figure, value: None, before: None, after: None, df: None, informed_by: None };
        PlannedRecord::of_figure((planned.free, names), &bare).name(several)
    };
    let known = planned.free.shared().parameters.iter().map(|own| own.name.clone());
    Figures {
        names: all.iter().map(|figure| name(*figure)).collect(),
        fixed: fixed.into_iter().map(|quantity| name(Figure::Quantity(quantity))).collect(),
        known: known.filter(|name| !names.parameters.contains(name)).collect(),
        all,
    }
}

fn refuse_too_many(found: &UnitInformation, request: &BestPlanRequest) -> Result<(), Failure> {
    let (candidates, values) = (found.units.len(), found.jacobian.nrows());
    let sets = 1 + request.draws.map_or(0, |(count, _)| count);
    let numbers = candidates.saturating_mul(values * values).saturating_mul(sets + 1);
    if numbers > MOST_NUMBERS {
        return Err(refused_plan(BestPlanError::TooMany { candidates, values, sets, numbers }));
    }
    Ok(())
}

/// What is known before any test of the plan.
enum Before {
    Nothing,
    Tests(Vec<PhasedTest>, DataReading),
    Fit(Box<Knowledge>),
}

/// The candidates with what is known before any test of the plan.
fn with_so_far(
    spec: &mut Spec,
    request: &BestPlanRequest,
    (planned, slots): (&Planned<'_>, &Slots),
    candidates: CandidateInformation,
    work: &mut JobWork<'_>,
) -> Result<(CandidateInformation, Before), Failure> {
    let before = match &request.so_far {
        None => Before::Nothing,
        Some(SoFar::Tests(data)) => {
            let (tests, reading) = candidates::read_made(spec, data, work)?;
            Before::Tests(tests, reading)
        }
        Some(SoFar::Fit(document)) => {
            let record: kalfit::FitRecord = results::read(document, FIT).map_err(TruthError::from)?;
            let knowledge = record.knowledge(planned.free);
            let path = document.name();
            let knowledge = knowledge.ok_or_else(|| {
                refused_plan(match record.estimates {
                    Some(_) => BestPlanError::OtherModel { path },
                    None => BestPlanError::NoErrors { path },
                })
            })?;
            Before::Fit(Box::new(knowledge))
        }
    };
    Ok((planned.after(candidates, slots, &before, work)?, before))
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
