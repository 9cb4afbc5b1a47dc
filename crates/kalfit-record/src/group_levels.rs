//! Levels of groups, and the groups, as records.

use std::collections::HashMap;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::factors::factor_notes;
use crate::figure::figures;
use crate::square::rows;
use crate::{
    BoundaryRecord, CovarianceRecord, DeletionRecord, FigureUnit, FitRecord, MatrixRecord, PhaseRecord, SquareRecord,
    UnidentifiedRecord, VectorRecord,
};
use kalfit_apply::predict::Initial;
use kalfit_filter::reduce::Reductions;
use kalfit_infer::{Estimand, GroupPosterior, Inference};
use kalfit_model::{Grouping, Labels};
use kalfit_model::{PhasedModel, Population, slot_of};

/// The variation between groups of a level, or between tests within the groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LevelRecord {
    /// Name of the level; `tests` for the level of the tests themselves.
    pub name: String,
    /// Column that names the groups; null for the level of the tests.
    pub column: Option<String>,
    /// Columns of a crossed factor by slot, where a test has several of its levels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub slots: Vec<SlotRecord>,
    /// Number of groups; for the level of the tests, their number.
    pub groups: usize,
    /// Estimated states, in the order of every matrix. With slots, the effects, each named as the states it acts on
    /// without the slot, in the place of the first of them.
    pub states: Vec<String>,
    /// Σ of the level.
    pub covariance: CovarianceRecord,
    /// Square roots of its diagonal.
    pub std_dev: VectorRecord,
    /// Correlations.
    pub correlation: MatrixRecord,
    /// Where Σ is on the boundary of the positive semidefinite cone.
    pub boundary: Vec<BoundaryRecord>,
    /// Directions that the data do not determine.
    pub unidentified: Vec<UnidentifiedRecord>,
}

/// A slot of a factor of which a test has several members.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SlotRecord {
    /// Name of the slot, which the names of its states end in.
    pub slot: String,
    /// Column that names the member in the slot.
    pub column: String,
}

/// The variation of a crossed factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FactorRecord {
    /// Its name, column, number of levels (`groups`) and Σ, as of a level of groups.
    #[serde(flatten)]
    pub level: LevelRecord,
    /// The effect of each level on the estimated states, given all tests; absent where results of tests were not asked
    /// for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<EffectRecord>,
}

/// The posterior of the effect of one level of a crossed factor, at the estimated mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EffectRecord {
    /// Name of the level.
    pub id: String,
    /// Number of tests that meet it.
    pub tests: usize,
    /// Posterior mean of the effect on each estimated state.
    pub mean: Vec<f64>,
    /// Posterior standard deviation of each.
    pub std_dev: Vec<f64>,
    /// Posterior covariance.
    pub covariance: SquareRecord,
}

figures! {
    /// Results of one group.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    pub struct UnitRecord {
        /// Name of its level.
        pub level: String = figure { heading: "level" },
        /// Name of the group, after those of the groups that contain it, the outermost first.
        pub id: Vec<String>,
        /// Number of its tests.
        pub tests: usize = figure { heading: "tests" },
        /// log p of all measurements of its tests, by themselves.
        pub log_likelihood: f64 = figure { unit: FigureUnit::LogLikelihood },
        /// Posterior mean, given all tests, of the mean of its members.
        pub mean: Vec<f64>,
        /// Posterior covariance of that mean.
        pub covariance: SquareRecord,
        /// Derivatives of `mean` with respect to μ and the regression coefficients, in their order, state by state;
        /// absent without regressions
        /// where groups differ in every direction.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub follows: Option<Vec<Vec<f64>>>,
        /// Derivatives of `mean` with respect to the quantities of `estimates`, in their order, state by state; zero
        /// for quantities that are no variance or covariance. Only of the innermost level, and absent where they were
        /// not computed.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub by_estimates: Option<Vec<Vec<f64>>>,
        /// Posterior covariance with the effects of levels of crossed factors, of a level only with those before it;
        /// only of the innermost groups and of levels, and absent where these are too many.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        pub with_effects: Vec<EffectCovarianceRecord>,
        /// Standardised squared distance of the group from the population.
        pub distance: Option<f64> = figure { heading: "distance²" },
        /// Degrees of freedom of the distance: rank of the information from its tests.
        pub degrees_of_freedom: usize = figure { heading: "expected" },
        /// χ² p-value of the distance.
        pub p_value: Option<f64> = figure { heading: "p-value", unit: FigureUnit::Probability },
        /// The fit without the group; null if it was not requested or has no certified optimum.
        #[serde(default)]
        pub deletion: Option<DeletionRecord>,
    }
}

/// Posterior covariance with the effect of a level of a crossed factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EffectCovarianceRecord {
    /// Name of the factor.
    pub level: String,
    /// Name of its level.
    pub id: String,
    /// Covariance, a row for each state of the group and a column for each effect.
    pub covariance: Vec<Vec<f64>>,
}

impl LevelRecord {
    pub(super) fn new(name: String, column: Option<String>, groups: usize, block: &PhaseRecord) -> LevelRecord {
        LevelRecord {
            name,
            column,
            slots: Vec::new(),
            groups,
            states: block.states.clone(),
            covariance: block.covariance.clone(),
            std_dev: block.std_dev.clone(),
            correlation: block.correlation.clone(),
            boundary: block.boundary.clone(),
            unidentified: block.unidentified.clone(),
        }
    }
}

impl LevelRecord {
    /// For each slot the effect on each of the estimated states of these names; without slots, each effect acts on its
    /// own state.
    pub fn effects_by_slot(&self, states: &[String]) -> Vec<Vec<Option<usize>>> {
        if self.slots.is_empty() {
            return vec![(0..states.len()).map(Some).collect()];
        }
        let effect = |slot: &SlotRecord, state: &String| {
            let (own, stem) = slot_of(state, self.slots.iter().map(|one| one.slot.as_str()))?;
            self.states.iter().position(|name| own == slot.slot && name == stem)
        };
        self.slots.iter().map(|slot| states.iter().map(|state| effect(slot, state)).collect()).collect()
    }

    /// The effect on state i of these estimated states, in whatever slot.
    pub fn effect_on(&self, states: &[String], i: usize) -> Option<usize> {
        self.effects_by_slot(states).iter().find_map(|slot| *slot.get(i)?)
    }
}

impl UnitRecord {
    /// Derivatives of the mean with respect to each quantity; `None` where the record has none.
    fn slopes(&self, quantities: &[Estimand], p: usize) -> Option<HashMap<Estimand, DVector<f64>>> {
        let rows = self.by_estimates.as_ref()?;
        let is_valid = rows.len() == p && rows.iter().all(|row| row.len() == quantities.len());
        let of = |c: usize| DVector::from_iterator(p, rows.iter().map(|row| row[c]));
        is_valid.then(|| quantities.iter().cloned().enumerate().map(|(c, quantity)| (quantity, of(c))).collect())
    }
}

impl FitRecord {
    /// The crossed factors, then the levels, the outermost first and that of the tests last.
    pub fn all_levels(&self) -> impl Iterator<Item = &LevelRecord> + Clone {
        self.crossed.iter().map(|factor| &factor.level).chain(&self.levels)
    }

    /// Distribution of a new test of each group of the innermost level, by the group's name after the names of the
    /// groups that contain it.
    pub fn unit_laws(&self, model: &PhasedModel, population: &Population) -> HashMap<Vec<String>, Initial> {
        let Some(level) = model.nested().last() else { return HashMap::new() };
        let p = model.dimension();
        let own = self.groups.iter().filter(|unit| unit.level == level.name);
        let quantities = self.knowledge(model).map(|knowledge| knowledge.quantities).unwrap_or_default();
        let valid = own.filter(|unit| unit.mean.len() == p && unit.covariance.size() == p);
        let law = |unit: &UnitRecord| {
            let covariance = DMatrix::from_fn(p, p, |i, k| unit.covariance[i][k]);
            let width = p + population.coefficients.len();
            let valid = |rows: &&Vec<Vec<f64>>| rows.len() == p && rows.iter().all(|row| row.len() == width);
            let follows = unit.follows.as_ref().filter(valid);
            let follows = follows.map(|rows| DMatrix::from_fn(p, width, |i, c| rows[i][c]));
            let initial = Initial::of_group(model, population, (unit.mean.clone(), &covariance), follows);
            Initial { by_estimates: unit.slopes(&quantities, p), group_tests: unit.tests, ..initial }
        };
        valid.map(|unit| (unit.id.clone(), law(unit))).collect()
    }

    /// Adds the groups of each test, by name, and the results of each group.
    pub fn add_levels(
        &mut self,
        (model, labels): (&PhasedModel, &Labels),
        (grouping, reductions): (Option<&Grouping>, &Reductions),
        inference: &Inference,
    ) {
        let Some(grouping) = grouping else { return };
        self.notes.extend(factor_notes(model, grouping, reductions));
        let names = |level: usize, group: usize| -> Vec<String> {
            grouping.groups(level)[group].path.iter().map(|&name| labels.text(name).to_owned()).collect()
        };
        for at in 0..if grouping.nested() > 0 { self.tests.len() } else { 0 } {
            let Some(number) = grouping.number(self.tests.get(at).id) else { continue };
            self.tests.groups.set(at, Some(names(0, grouping.group_of(number, 0))));
        }
        let unit = |level: usize, name: &str, group: usize, found: &GroupPosterior| UnitRecord {
            level: name.to_owned(),
            id: names(level, group),
            tests: found.tests,
            log_likelihood: found.log_likelihood,
            mean: found.mean.clone(),
            covariance: (&found.covariance).into(),
            follows: found.follows.as_ref().map(rows),
            by_estimates: found.by_estimates.as_ref().map(rows),
            with_effects: found
                .with_effects
                .iter()
                .map(|one| EffectCovarianceRecord {
                    level: model.levels[model.levels.len() - 1 - one.level].name.clone(),
                    id: names(one.level, one.group).concat(),
                    covariance: rows(&one.covariance),
                })
                .collect(),
            distance: (found.distance.degrees_of_freedom > 0).then_some(found.distance.squared),
            degrees_of_freedom: found.distance.degrees_of_freedom,
            p_value: found.distance.p_value,
            deletion: inference
                .group_deletions
                .as_ref()
                .and_then(|all| all[level][group].as_ref())
                .map(|found| DeletionRecord::new(model, found)),
        };
        for (at, level) in model.levels.iter().enumerate() {
            let inner = model.levels.len() - 1 - at;
            let Some(found) = inference.groups.get(inner) else { continue };
            if let (true, Some(factor)) = (level.crossed, self.crossed.get_mut(at)) {
                let mean = self.phases.first().map_or(&[][..], |phase| &phase.mean.estimate);
                let effect = |(group, one): (usize, &GroupPosterior)| EffectRecord {
                    id: names(inner, group).concat(),
                    tests: one.tests,
                    mean: one.mean.iter().zip(mean).map(|(with, mean)| with - mean).collect(),
                    std_dev: one.covariance.diagonal().iter().map(|x| x.max(0.0).sqrt()).collect(),
                    covariance: (&one.covariance).into(),
                };
                factor.effects = found.iter().enumerate().map(effect).collect();
            }
            self.groups.extend(found.iter().enumerate().map(|(group, one)| unit(inner, &level.name, group, one)));
        }
    }
}
