//! Which effects of a group act on the states of a test.

use std::sync::Arc;

use nalgebra::DMatrix;

/// The places of the ones in E, by which the effects b of a group enter ξ of a test as Eb (theory §16): pairs (state,
/// effect), ascending.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Selection(Vec<(usize, usize)>);

impl Selection {
    /// The selection of these pairs (state, effect).
    pub fn new(mut pairs: Vec<(usize, usize)>) -> Selection {
        pairs.sort_unstable();
        Selection(pairs)
    }

    /// Each of `states` effects acts on its own state.
    pub fn all(states: usize) -> Selection {
        Selection((0..states).map(|state| (state, state)).collect())
    }

    /// The pairs (state, effect).
    pub fn pairs(&self) -> &[(usize, usize)] {
        &self.0
    }

    /// EA, for an A with a row for each effect, as many as there are states.
    pub fn on_states(&self, effects: &DMatrix<f64>) -> DMatrix<f64> {
        let mut all = DMatrix::zeros(effects.nrows(), effects.ncols());
        for &(state, effect) in &self.0 {
            let mut row = all.row_mut(state);
            row += effects.row(effect);
        }
        all
    }
}

/// How the effects of each level enter a test: for each block of Σ, that of the tests first, E of each slot; none where
/// each effect acts on its own state.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LevelSlots(Vec<Vec<Arc<Selection>>>);

impl LevelSlots {
    /// The slots of the levels above the tests, the innermost first.
    pub fn new(levels: impl IntoIterator<Item = Vec<Arc<Selection>>>) -> LevelSlots {
        LevelSlots(std::iter::once(Vec::new()).chain(levels).collect())
    }

    /// E'h of each slot of a level, for a sensitivity h of the states.
    pub fn of_effects(&self, level: usize, sensitivity: &[f64]) -> Vec<Vec<f64>> {
        let slots = self.0.get(level).map_or(&[][..], Vec::as_slice);
        let of = |slot: &Arc<Selection>| {
            let mut effects = vec![0.0; sensitivity.len()];
            slot.pairs().iter().for_each(|&(state, effect)| effects[effect] += sensitivity[state]);
            effects
        };
        if slots.is_empty() { vec![sensitivity.to_vec()] } else { slots.iter().map(of).collect() }
    }

    /// EF of each slot of a level, side by side, for an F with a row for each effect.
    pub fn of_states(&self, level: usize, effects: &DMatrix<f64>) -> DMatrix<f64> {
        let slots = self.0.get(level).map_or(&[][..], Vec::as_slice);
        if slots.is_empty() {
            return effects.clone();
        }
        let width = effects.ncols();
        let mut all = DMatrix::zeros(effects.nrows(), width * slots.len());
        for (s, slot) in slots.iter().enumerate() {
            all.columns_mut(s * width, width).copy_from(&slot.on_states(effects));
        }
        all
    }

    /// ΣEΣE' over the slots of a level: the covariance of the effects of different groups on a test.
    pub fn spread(&self, level: usize, covariance: &DMatrix<f64>) -> DMatrix<f64> {
        let slots = self.0.get(level).map_or(&[][..], Vec::as_slice);
        if slots.is_empty() {
            return covariance.clone();
        }
        let both = |slot: &Arc<Selection>| slot.on_states(&slot.on_states(covariance).transpose());
        slots.iter().map(both).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effects_enter_by_slots() {
        // one effect, in slot A on the first state, in slot B on the third
        let [a, b] = [0, 2].map(|state| Arc::new(Selection::new(vec![(state, 0)])));
        let slots = LevelSlots::new([vec![a, b]]);
        let covariance = DMatrix::from_fn(3, 3, |i, k| if i == 0 && k == 0 { 4.0 } else { 0.0 });
        assert_eq!(slots.spread(1, &covariance).diagonal().as_slice(), [4.0, 0.0, 4.0]);
        assert_eq!(slots.spread(1, &covariance).sum(), 8.0, "different groups are independent");
        let root = slots.of_states(1, &covariance.map(f64::sqrt));
        assert_eq!(&root * root.transpose(), slots.spread(1, &covariance));
        assert_eq!(slots.of_effects(1, &[5.0, 6.0, 7.0]), [[5.0, 0.0, 0.0], [7.0, 0.0, 0.0]]);
        assert_eq!(slots.of_effects(0, &[5.0, 6.0, 7.0]), [[5.0, 6.0, 7.0]]);
    }
}
