//! The effects of the groups of crossed factors, as columns of the border that have a law of their own (theory §16).

use std::sync::Arc;

use nalgebra::DMatrix;

use kalfit_model::{Grouping, Selection};

/// The effects b of all groups of all crossed factors, p for each group: ξ_j = E_j b + …
#[derive(Debug, Clone)]
pub(super) struct CrossedEffects {
    grouping: Arc<Grouping>,
    /// Number of states of a test.
    states: usize,
    /// First effect of each factor, and the number of all effects.
    starts: Vec<usize>,
}

impl CrossedEffects {
    /// The effects on tests of `states` states each; `None` where no groups cross.
    pub(super) fn of(grouping: &Arc<Grouping>, states: usize) -> Option<CrossedEffects> {
        if !grouping.is_crossed() {
            return None;
        }
        let mut starts = vec![0];
        for level in grouping.nested()..grouping.depth() {
            starts.push(starts[starts.len() - 1] + states * grouping.groups(level).len());
        }
        Some(CrossedEffects { grouping: Arc::clone(grouping), states, starts })
    }

    /// M, the number of effects.
    pub(super) fn len(&self) -> usize {
        self.starts[self.starts.len() - 1]
    }

    /// The block of Σ of the first factor: that of the tests and those of the nested levels precede it.
    pub(super) fn first_block(&self) -> usize {
        1 + self.grouping.nested()
    }

    /// First effect of each group of the factor with this block of Σ; `None` where the block is of no factor.
    pub(super) fn blocks_of(&self, block: usize) -> Option<Arc<[usize]>> {
        let factor = block.checked_sub(self.first_block())?;
        Some(self.starts_of_groups(factor).collect())
    }

    fn starts_of_groups(&self, factor: usize) -> impl Iterator<Item = usize> {
        (self.starts[factor]..self.starts[factor + 1]).step_by(self.states.max(1))
    }

    /// E of test `id`: pairs of a state and of an effect on it; `None` for a test that was not grouped.
    pub(super) fn met_by(&self, id: &str) -> Option<Vec<(usize, usize)>> {
        let number = self.grouping.number(id)?;
        let all = Selection::all(self.states);
        let mut met = Vec::new();
        for (factor, start) in self.starts[..self.starts.len() - 1].iter().enumerate() {
            for member in self.grouping.members(number, self.grouping.nested() + factor) {
                let first = start + member.group * self.states;
                let selection = member.selection.map_or(&all, Arc::as_ref);
                met.extend(selection.pairs().iter().map(|&(state, effect)| (state, first + effect)));
            }
        }
        Some(met)
    }

    /// F of the covariance of all effects, block by block, from F of the Σ of each factor, p × its columns.
    pub(super) fn root(&self, of_factors: &[DMatrix<f64>]) -> DMatrix<f64> {
        let blocks: Vec<(usize, &DMatrix<f64>)> = of_factors
            .iter()
            .enumerate()
            .flat_map(|(factor, root)| self.starts_of_groups(factor).map(move |start| (start, root)))
            .collect();
        let mut all = DMatrix::zeros(self.len(), blocks.iter().map(|(_, root)| root.ncols()).sum());
        let mut column = 0;
        for (start, root) in blocks {
            all.view_mut((start, column), root.shape()).copy_from(root);
            column += root.ncols();
        }
        all
    }
}
