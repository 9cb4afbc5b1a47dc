//! The initial state of a test whose unit, or whose levels of crossed factors, are known (theory §16).

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::Initial;
use kalfit_model::{LevelSlots, PhasedModel, Population, Selection};

/// What is known of a group that a test meets: of a unit the deviation of its tests from μ, of a level of a factor its
/// effect.
#[derive(Debug, Clone)]
pub struct KnownEffect {
    /// Which effects act on which states; `None` where each acts on its own.
    pub selection: Option<Arc<Selection>>,
    /// Posterior mean of the effects (p).
    pub mean: Vec<f64>,
    /// d`mean` / d(μ, regression coefficients) (p × (p + coefficients)).
    pub follows: DMatrix<f64>,
}

impl KnownEffect {
    /// EA of effects with these rows.
    fn on_states(&self, effects: &DMatrix<f64>) -> DMatrix<f64> {
        self.selection.as_ref().map_or_else(|| effects.clone(), |selection| selection.on_states(effects))
    }
}

impl Initial {
    /// Initial state of a new test of known groups, ξ = μ + ΣEb + γ: `covariances` gives Cov[b, b' | z] of two of them (p ×
    /// p). `new`: for each group that is not known, the block of Σ of its level and which effects act on which states.
    pub fn of_known(
        model: &PhasedModel,
        population: &Population,
        (known, covariances): (&[KnownEffect], &dyn Fn(usize, usize) -> DMatrix<f64>),
        new: &[(usize, Option<Arc<Selection>>)],
    ) -> Initial {
        let (p, width) = (model.dimension(), model.dimension() + population.coefficients.len());
        let mut mean = DVector::from_column_slice(&population.mean[..p]);
        let mut follows = DMatrix::identity(p, width);
        let mut left = DMatrix::zeros(p, p);
        for (a, effect) in known.iter().enumerate() {
            mean += effect.on_states(&DMatrix::from_column_slice(p, 1, &effect.mean)).column(0);
            follows += effect.on_states(&effect.follows);
            for (b, other) in known.iter().enumerate() {
                // E Cov E', by the transpose of E'(E Cov)'
                left += other.on_states(&effect.on_states(&covariances(a, b)).transpose()).transpose();
            }
        }
        let levels = model.levels.len();
        let mut by_level: Vec<Vec<Arc<Selection>>> = vec![Vec::new(); levels];
        for (block, selection) in new {
            by_level[block - 1].extend(selection.clone());
        }
        let slots = LevelSlots::new(by_level);
        let block = |level: usize| population.covariance.view((level * p, level * p), (p, p)).into_owned();
        let mut blocks: Vec<usize> = new.iter().map(|(block, _)| *block).collect();
        blocks.sort_unstable();
        blocks.dedup();
        let covariance = blocks.iter().fold(block(0), |sum, &level| sum + slots.spread(level, &block(level)));
        Initial {
            mean: mean.as_slice().to_vec(),
            covariance,
            left: Some(left),
            shrinkage: Some(follows.columns(0, p).into_owned()),
            by_coefficients: Some(follows.columns(p, width - p).into_owned()),
            by_estimates: None,
            levels: std::iter::once(0).chain(blocks).collect(),
            slots,
            all_slots: model.slots(),
            group_tests: 1,
        }
    }
}
