//! Whose tests are predicted: of new units, or of units that a fit knows.

use std::borrow::Cow;
use std::collections::{BTreeSet, HashMap};

use kalfit::predict::Initial;
use kalfit::record::{KnownGroups, MetGroup, UnknownGroup};
use kalfit::reduce::grouping;
use kalfit::{Grouping, Labels, PhasedModel, PhasedTest, Population};
use kalfit_spec::Spec;

use crate::failure::{Failure, UnknownUnit};
use crate::job::{PredictJob, PredictedUnits};
use crate::truth::Truth;

/// The laws of initial states.
pub(super) enum UnitLaws {
    /// All tests are of new units.
    New(Initial),
    /// Of units by name.
    Known {
        units: HashMap<Vec<String>, Initial>,
        /// Name of the innermost level.
        level: String,
        path: String,
    },
    /// Of known units on known or new levels of factors.
    Crossed { known: KnownGroups, model: Box<PhasedModel>, population: Population, path: String },
}

impl UnitLaws {
    pub(super) fn new(job: &PredictJob, spec: &Spec, truth: &Truth) -> Result<UnitLaws, Failure> {
        if job.units == PredictedUnits::New {
            return Ok(UnitLaws::New(Initial::new(&spec.model, &truth.population)));
        }
        let (model, population, path) = (&spec.model, &truth.population, job.from.name());
        if model.levels.is_empty() {
            return Err(Failure::NoUnits { why: "the model has no levels of groups" });
        }
        let record = truth.record.as_ref().ok_or(Failure::NoUnits { why: "a model file knows no units" })?;
        match model.nested().last().filter(|_| model.factors().is_empty()) {
            Some(level) => {
                Ok(UnitLaws::Known { units: record.unit_laws(model, population), level: level.name.clone(), path })
            }
            None => {
                if record.groups.is_empty() {
                    let why = "the results were written without what is known of each unit and level";
                    return Err(Failure::NoUnits { why });
                }
                let (known, population) = (record.known_groups(model, population), population.clone());
                Ok(UnitLaws::Crossed { known, model: Box::new(model.clone()), population, path })
            }
        }
    }

    /// Whether the laws of known units say how their means follow the estimated covariances.
    pub(super) fn have_covariance_errors(&self) -> Option<bool> {
        match self {
            UnitLaws::New(_) => None,
            UnitLaws::Known { units, .. } => Some(units.values().all(|unit| unit.by_estimates.is_some())),
            UnitLaws::Crossed { .. } => Some(false),
        }
    }

    /// The groups of tests, where they count.
    pub(super) fn grouping(&self, design: &Spec, tests: &[PhasedTest]) -> Result<Option<Grouping>, Failure> {
        match self {
            UnitLaws::New(_) => Ok(None),
            UnitLaws::Known { .. } | UnitLaws::Crossed { .. } => {
                let found = grouping(&design.model, tests);
                found.map_err(|error| Failure::Apply(Box::new(error.into())))
            }
        }
    }

    /// A warning of levels of factors that the fit does not know.
    pub(super) fn new_levels(
        &self,
        tests: &[PhasedTest],
        grouping: Option<&Grouping>,
        labels: &Labels,
    ) -> Option<String> {
        let (UnitLaws::Crossed { known, model, path, .. }, Some(grouping)) = (self, grouping) else { return None };
        let numbers = tests.iter().filter_map(|test| grouping.number(&test.id));
        let all = numbers.flat_map(|number| met(model, (grouping, number), labels));
        let new: BTreeSet<String> = all
            .filter(|group| {
                let level = &model.levels[group.level];
                level.crossed && known.names(&level.name).all(|id| *id != group.id)
            })
            .map(|group| format!("{} `{}`", model.levels[group.level].name, group.id.join("/")))
            .collect();
        let listed: Vec<&str> = new.iter().take(MOST).map(String::as_str).collect();
        let more = new.len().saturating_sub(MOST);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        (!new.is_empty())
            .then(|| format!("`{path}` does not know {}{more}: they are taken as new levels", listed.join(", ")))
    }

    /// The law of a test's initial state.
    pub(super) fn initial(
        &self,
        test: &PhasedTest,
        grouping: Option<&Grouping>,
        labels: &Labels,
    ) -> Result<Cow<'_, Initial>, Failure> {
        let place = grouping.and_then(|grouping| Some((grouping, grouping.number(&test.id)?)));
        match self {
            UnitLaws::New(initial) => Ok(Cow::Borrowed(initial)),
            UnitLaws::Known { units, level, path } => {
                let name = place.map_or(Vec::new(), |(all, number)| names((all, 0, all.group_of(number, 0)), labels));
                let found = units.get(&name).map(Cow::Borrowed);
                found.ok_or_else(|| unknown(test, (level, path), &name.join("/"), units.keys()))
            }
            UnitLaws::Crossed { known, model, population, path } => {
                let met = place.map_or(Vec::new(), |(all, number)| met(model, (all, number), labels));
                let found = known.law((model, population), &met);
                found.map(Cow::Owned).map_err(|why| match why {
                    UnknownGroup::Unit => {
                        let own = met.iter().find(|group| !model.levels[group.level].crossed);
                        let level = &model.levels[own.map_or(0, |group| group.level)].name;
                        let id = own.map_or(String::new(), |group| group.id.join("/"));
                        unknown(test, (level, path), &id, known.names(level))
                    }
                    UnknownGroup::Together => {
                        Failure::UnknownTogether { test: test.id.to_string(), path: path.clone() }
                    }
                })
            }
        }
    }
}

/// The names of a group of a level, the outermost first.
fn names((grouping, level, group): (&Grouping, usize, usize), labels: &Labels) -> Vec<String> {
    grouping.groups(level)[group].path.iter().map(|&name| labels.text(name).to_owned()).collect()
}

/// The innermost group and the levels of factors that a test meets.
fn met(model: &PhasedModel, (grouping, number): (&Grouping, usize), labels: &Labels) -> Vec<MetGroup> {
    let mut met = Vec::new();
    for (at, level) in model.levels.iter().enumerate() {
        let inner = model.levels.len() - 1 - at;
        if !level.crossed && inner > 0 {
            continue;
        }
        for member in grouping.members(number, inner) {
            let slot = level.members.iter().position(|own| member.selection == Some(&own.selection));
            met.push(MetGroup { level: at, slot, id: names((grouping, inner, member.group), labels) });
        }
    }
    met
}

fn unknown<'n>(
    test: &PhasedTest,
    (level, path): (&str, &str),
    unit: &str,
    known: impl Iterator<Item = &'n Vec<String>>,
) -> Failure {
    let mut known: Vec<String> = known.map(|unit| format!("`{}`", unit.join("/"))).collect();
    known.sort();
    let more = known.len().saturating_sub(MOST);
    let listed = known[..known.len().min(MOST)].join(", ");
    let known = match (known.len(), more) {
        (0, _) => "it was written without what is known of each unit".to_owned(),
        (_, 0) => format!("it knows {listed}"),
        _ => format!("it knows {listed} and {more} more"),
    };
    let (test, unit) = (test.id.to_string(), unit.to_owned());
    let (level, path) = (level.to_owned(), path.to_owned());
    Failure::UnknownUnit(Box::new(UnknownUnit { test, level, unit, path, known }))
}

/// No more names than this in a message.
const MOST: usize = 10;
