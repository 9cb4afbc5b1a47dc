//! Evaluation of classes one by one.

use std::ops::Range;

use crate::chained::{ChainDetail, ChainStore, ChainTerms, Root};
use crate::class::ClassRef;
use crate::lanes::any::ClassWorkspace;
use crate::lanes::layout::ClassLayout;
use crate::lanes::whole::BlockContribution;
use crate::point::{Point, Regressors};

/// Evaluates classes one by one at a point.
#[derive(Debug)]
pub(crate) struct ClassEvaluator<'a> {
    point: &'a Point,
    regressors: &'a Regressors,
    root: Root<'a>,
    workspace: ClassWorkspace<f64>,
    /// A class as a block of one lane.
    block: Vec<f64>,
}

impl<'a> ClassEvaluator<'a> {
    pub(crate) fn new(point: &'a Point, regressors: &'a Regressors) -> ClassEvaluator<'a> {
        let root = Root::of(&point.root);
        let workspace = ClassWorkspace::new(&point.mean, root.lower(), 1);
        ClassEvaluator { point, regressors, root, workspace, block: Vec::new() }
    }

    /// Likelihood terms of a class that is stored phase by phase.
    pub(crate) fn in_phases(&self, class: ClassRef<'_>, chain: &ChainStore, detail: ChainDetail) -> ChainTerms {
        chain.chained().at(&self.point.mean_of(class, self.regressors), &self.root, detail)
    }

    /// Likelihood terms of a class that is not stored phase by phase; `phases` has the range of the states of each
    /// phase.
    pub(crate) fn whole<'b>(
        &'b mut self,
        class: ClassRef<'_>,
        phases: &'b [Range<usize>],
    ) -> BlockContribution<'b, f64> {
        let p = self.point.mean.len();
        let exact = class.mean.len() - p;
        let several = !class.scatter.is_empty();
        let layout = ClassLayout { p, exact, covariates: class.covariates.len(), several };
        self.block.clear();
        self.block.resize(layout.size(), 0.0);
        layout.put(class, (&mut self.block, 0, 1));
        self.workspace.resize(exact, 1 + class.scatter.len() / layout.rows().max(1));
        self.workspace.move_mean(class.covariates, self.point, self.regressors);
        let evaluate = if class.square_root { ClassWorkspace::evaluate_by_qr } else { ClassWorkspace::evaluate };
        let det = evaluate(&mut self.workspace, &self.block, 1.0);
        BlockContribution { workspace: &self.workspace, det, count: Some(class.count), phases }
    }
}
