//! Splits results of all phases into phases, and results of tests in groups into levels.

use std::ops::Range;

use nalgebra::DMatrix;

use kalfit_filter::reduce::ReductionRef;
use kalfit_model::{CovarianceStructure, GroupLevel, Phase, PhasedModel, Regression};

/// One block of Σ, of a phase or a level, with the ranges of the block's elements and regressions in the lists over all
/// blocks.
#[derive(Debug, Clone)]
pub(super) struct BlockCut<'a> {
    /// The phase; for a level of groups, the only phase of the model.
    pub(super) phase: &'a Phase,
    /// The level of groups, if the block is one.
    pub(super) level: Option<&'a GroupLevel>,
    /// Index of the block among the blocks of Σ.
    pub(super) index: usize,
    /// Range of the block's elements among the elements of all blocks.
    pub(super) elements: Range<usize>,
    /// Range of the block's regressions among the regressions of all phases.
    pub(super) regressions: Range<usize>,
}

impl<'a> BlockCut<'a> {
    /// All phases of a model, in order.
    pub(super) fn all(model: &'a PhasedModel) -> Vec<BlockCut<'a>> {
        let mut end = 0;
        let cut = |(index, (phase, elements)): (usize, (&'a Phase, Range<usize>))| {
            let start = end;
            end += phase.model.mean.regression.len();
            BlockCut { phase, level: None, index, elements, regressions: start..end }
        };
        model.phases.iter().zip(model.ranges()).enumerate().map(cut).collect()
    }

    /// All blocks of Σ: all phases, or the only phase and then the levels of groups, the innermost first.
    pub(super) fn blocks(model: &'a PhasedModel) -> Vec<BlockCut<'a>> {
        let mut all = BlockCut::all(model);
        let (p, end) = (model.dimension(), all.last().map_or(0, |cut| cut.regressions.end));
        let level = |(l, level): (usize, &'a GroupLevel)| BlockCut {
            phase: &model.phases[0],
            level: Some(level),
            index: l + 1,
            elements: (l + 1) * p..(l + 2) * p,
            regressions: end..end,
        };
        all.extend(model.levels.iter().rev().enumerate().map(level));
        all
    }

    /// Name of the phase or level.
    pub(super) fn name(&self) -> &'a str {
        self.level.map_or(&self.phase.name, |level| &level.name)
    }

    /// Structure of the block's Σ.
    pub(super) fn structure(&self) -> &'a CovarianceStructure {
        self.level.map_or(&self.phase.model.covariance, |level| &level.covariance)
    }

    /// Names of the block's states, without the name of the phase.
    pub(super) fn states(&self) -> Vec<String> {
        let names = self.phase.model.estimated_names();
        self.level.map_or(names.clone(), |level| level.effect_names(&names))
    }

    /// The block's part of a list with one entry per element.
    pub(super) fn list<T: Clone>(&self, all: &[T]) -> Vec<T> {
        all[self.elements.clone()].to_vec()
    }

    /// The block's part of a square matrix, given as a list of rows.
    pub(super) fn square<T: Clone>(&self, all: &[Vec<T>]) -> Vec<Vec<T>> {
        all[self.elements.clone()].iter().map(|row| self.list(row)).collect()
    }

    /// The block's part of a matrix, by rows.
    pub(super) fn block(&self, all: &DMatrix<f64>) -> Vec<Vec<f64>> {
        let of = |i: usize| self.elements.clone().map(|k| all[(i, k)]).collect();
        self.elements.clone().map(of).collect()
    }

    /// Index within the block of an element, given by index over all blocks; `None` if the element is in another block.
    pub(super) fn element(&self, global_index: usize) -> Option<usize> {
        self.elements.contains(&global_index).then(|| global_index - self.elements.start)
    }
}

/// Regressions of all phases, with elements numbered over all phases.
pub(super) fn regressions(model: &PhasedModel) -> Vec<Regression> {
    let of = |cut: BlockCut<'_>| -> Vec<Regression> {
        let start = cut.elements.start;
        let moved = |r: &Regression| Regression { element: start + r.element, column: r.column };
        cut.phase.model.mean.regression.iter().map(moved).collect()
    };
    BlockCut::all(model).into_iter().flat_map(of).collect()
}

/// Number of phases of a model that a test has.
pub(super) fn phases_of(reduction: ReductionRef<'_>, model: &PhasedModel) -> usize {
    let all = model.phases.len();
    reduction.chain.as_ref().map_or(all, |chain| chain.phases.len().min(all))
}
