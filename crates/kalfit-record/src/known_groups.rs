//! The groups that a fit knows, where groups cross: laws of the initial states of new tests of known units on known or new
//! levels of factors.

use std::collections::HashMap;

use nalgebra::DMatrix;

use crate::group_levels::UnitRecord;
use crate::{FitRecord, SquareRecord};
use kalfit_apply::predict::{Initial, KnownEffect};
use kalfit_model::{GroupLevel, PhasedModel, Population};

/// The innermost groups and the levels of crossed factors that a fit knows, by name.
#[derive(Debug)]
pub struct KnownGroups {
    /// By the name of the level, then by the names of the group, the outermost first.
    groups: HashMap<String, HashMap<Vec<String>, KnownGroup>>,
    /// Whether the fit holds covariances; what is left out then is zero.
    has_covariances: bool,
}

#[derive(Debug)]
struct KnownGroup {
    /// Deviation of the mean of its tests from μ.
    mean: Vec<f64>,
    covariance: DMatrix<f64>,
    /// Derivatives of `mean`; `None` where the record has none.
    follows: Option<DMatrix<f64>>,
    /// Covariances with effects, by factor and level.
    with_effects: HashMap<(String, String), DMatrix<f64>>,
}

/// A group that a test meets.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MetGroup {
    /// Index of its level in the model.
    pub level: usize,
    /// Index of its slot, where a test has several members of a factor.
    pub slot: Option<usize>,
    /// Its names, the outermost first.
    pub id: Vec<String>,
}

/// Why the law of a test is not known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum UnknownGroup {
    /// The unit is not among those of the fit.
    Unit,
    /// The fit does not hold how a group and a level are correlated, or how they follow the mean.
    Together,
}

impl FitRecord {
    /// The innermost groups and the levels of factors that the fit knows; those of other shapes than the model's are left
    /// out.
    pub fn known_groups(&self, model: &PhasedModel, population: &Population) -> KnownGroups {
        let (p, width) = (model.dimension(), model.dimension() + population.coefficients.len());
        let square = |own: &SquareRecord| (own.size() == p).then(|| DMatrix::from_fn(p, p, |i, k| own[i][k]));
        let known = |unit: &UnitRecord| {
            let valid = |rows: &&Vec<Vec<f64>>| rows.len() == p && rows.iter().all(|row| row.len() == width);
            let deviation =
                |rows: &Vec<Vec<f64>>| DMatrix::from_fn(p, width, |i, c| rows[i][c] - f64::from(u8::from(i == c)));
            let entry = |one: &crate::EffectCovarianceRecord| {
                let valid = one.covariance.len() == p && one.covariance.iter().all(|row| row.len() == p);
                let covariance = valid.then(|| DMatrix::from_fn(p, p, |i, k| one.covariance[i][k]))?;
                Some(((one.level.clone(), one.id.clone()), covariance))
            };
            Some(KnownGroup {
                mean: (unit.mean.len() == p)
                    .then(|| unit.mean.iter().zip(&population.mean).map(|(m, mu)| m - mu).collect())?,
                covariance: square(&unit.covariance)?,
                follows: unit.follows.as_ref().filter(valid).map(deviation),
                with_effects: unit.with_effects.iter().filter_map(entry).collect(),
            })
        };
        let kept =
            |level: &GroupLevel| level.crossed || model.nested().last().is_some_and(|own| own.name == level.name);
        let of_level = |level: &GroupLevel| {
            let own = self.groups.iter().filter(|unit| unit.level == level.name);
            (level.name.clone(), own.filter_map(|unit| Some((unit.id.clone(), known(unit)?))).collect())
        };
        let has_covariances = self.groups.iter().any(|unit| !unit.with_effects.is_empty());
        KnownGroups { groups: model.levels.iter().filter(|level| kept(level)).map(of_level).collect(), has_covariances }
    }
}

impl KnownGroups {
    /// Names of the known groups of a level.
    pub fn names(&self, level: &str) -> impl Iterator<Item = &Vec<String>> {
        self.groups.get(level).into_iter().flat_map(HashMap::keys)
    }

    /// The law of the initial state of a new test that meets these groups; levels of factors that the fit does not know
    /// are new.
    ///
    /// # Errors
    /// A unit that the fit does not know; covariances that it does not hold.
    pub fn law(
        &self,
        (model, population): (&PhasedModel, &Population),
        met: &[MetGroup],
    ) -> Result<Initial, UnknownGroup> {
        let (mut known, mut new, mut found) = (Vec::new(), Vec::new(), Vec::new());
        for group in met {
            let level = &model.levels[group.level];
            let selection = group.slot.map(|slot| level.members[slot].selection.clone());
            let of_fit = self.groups.get(&level.name).and_then(|groups| groups.get(&group.id));
            let Some(one) = of_fit else {
                if !level.crossed {
                    return Err(UnknownGroup::Unit);
                }
                new.push((model.levels.len() - group.level, selection));
                continue;
            };
            let follows = one.follows.clone().ok_or(UnknownGroup::Together)?;
            known.push(KnownEffect { selection, mean: one.mean.clone(), follows });
            found.push(((level.name.clone(), group.id.concat()), one));
        }
        let covariance = |a: usize, b: usize| {
            let ((first, one), (second, other)) = (&found[a], &found[b]);
            match a == b {
                true => Some(one.covariance.clone()),
                false => {
                    let back = || other.with_effects.get(first).map(DMatrix::transpose);
                    // of groups that share no test, not even over others, nothing is left out
                    let none = || self.has_covariances.then(|| DMatrix::zeros(one.mean.len(), one.mean.len()));
                    one.with_effects.get(second).cloned().or_else(back).or_else(none)
                }
            }
        };
        let pairs = (0..found.len()).flat_map(|a| (0..found.len()).map(move |b| (a, b)));
        let all: HashMap<(usize, usize), DMatrix<f64>> = pairs
            .map(|(a, b)| Some(((a, b), covariance(a, b)?)))
            .collect::<Option<_>>()
            .ok_or(UnknownGroup::Together)?;
        Ok(Initial::of_known(model, population, (&known, &|a, b| all[&(a, b)].clone()), &new))
    }
}
