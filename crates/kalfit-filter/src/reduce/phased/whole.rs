//! From the phases of tests, each reduced separately, to reductions of whole tests.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use crate::reduce::Terminal;
use crate::reduce::digest::Digest;
use crate::reduce::error::{ReduceError, finite, refuse};
use crate::reduce::part::{PhaseReducer, ReducedPhase};
use crate::reduce::phased::PhasedReducer;
use crate::reduce::stack::{StackPhase, StackShape, Stacked, shape};
use crate::reduce::subject::WHOLE;
use kalfit_model::Path;
use kalfit_model::Reduction;
use kalfit_model::{Chain, ChainPhase, Link};
use kalfit_model::{Inherited, PhasedTest};

/// The phases of a test and the links between them.
struct Linked<'a> {
    parts: Vec<ReducedPhase<'a>>,
    /// g of the link that leads to each phase; `None` for the first phase.
    means: Vec<Option<DVector<f64>>>,
    /// Digest of the designs of all phases and of T of each link.
    design: u128,
}

impl<'a> Linked<'a> {
    fn new(parts: Vec<ReducedPhase<'a>>) -> Linked<'a> {
        let means = (0..parts.len()).map(|at| link_mean(&parts, at)).collect();
        let design = digest(&parts);
        Linked { parts, means, design }
    }

    /// The quantities on which stacking depends, phase by phase.
    fn phases(&self, reducers: &[PhaseReducer]) -> Vec<StackPhase<'_>> {
        let mut phases = Vec::with_capacity(self.parts.len());
        let mut before: Option<&ReducedPhase<'_>> = None;
        for ((part, mean), reducer) in self.parts.iter().zip(&self.means).zip(reducers) {
            let link = before.map(|before| {
                let Terminal { sensitivity, root, .. } = before.last();
                [sensitivity, root, &part.inherits().transition]
            });
            let Reduction { factor, data, constant, .. } = &*part.reduction;
            let (own, constant, mean) = (reducer.own, *constant, mean.as_ref());
            phases.push(StackPhase { own, factor, data, constant, link, mean });
            before = Some(part);
        }
        phases
    }
}

impl PhasedReducer {
    /// The reduction of all phases of a test together.
    pub(super) fn whole(
        &self,
        test: &PhasedTest,
        parts: Result<Vec<ReducedPhase<'_>>, ReduceError>,
    ) -> Result<Reduction, ReduceError> {
        let all = self.reduce_wholes(std::slice::from_ref(test), vec![parts]);
        all.into_iter().next().expect("one test, one reduction")
    }

    /// The reductions of all phases of tests together; tests of one shape are stacked in lanes.
    pub(super) fn reduce_wholes(
        &self,
        tests: &[PhasedTest],
        parts: Vec<Result<Vec<ReducedPhase<'_>>, ReduceError>>,
    ) -> Vec<Result<Reduction, ReduceError>> {
        if self.phases.len() == 1 {
            let only = |(test, parts): (&PhasedTest, Result<Vec<ReducedPhase<'_>>, ReduceError>)| {
                let only = parts?.into_iter().next().expect("a test has a phase");
                Ok(Reduction { test: test.id.to_string(), chain: None, ..only.reduction.into_owned() })
            };
            return tests.iter().zip(parts).map(only).collect();
        }
        let linked: Vec<Result<Linked<'_>, ReduceError>> =
            parts.into_iter().map(|parts| parts.map(Linked::new)).collect();
        let stacked = self.stacked(&linked);
        let whole = |((test, linked), stacked): ((&PhasedTest, Result<Linked<'_>, ReduceError>), Option<Stacked>)| {
            self.together(test, linked?, stacked.expect("sound tests are stacked"))
        };
        tests.iter().zip(linked).zip(stacked).map(whole).collect()
    }

    /// The stacked phases of each test; `None` for tests in error.
    fn stacked(&self, linked: &[Result<Linked<'_>, ReduceError>]) -> Vec<Option<Stacked>> {
        let mut stacked: Vec<Option<Stacked>> = linked.iter().map(|_| None).collect();
        let phases: Vec<Vec<StackPhase<'_>>> = linked
            .iter()
            .map(|linked| linked.as_ref().map_or(Vec::new(), |linked| linked.phases(&self.phases)))
            .collect();
        let mut same_shape: BTreeMap<StackShape, Vec<usize>> = BTreeMap::new();
        for (number, linked) in linked.iter().enumerate() {
            if linked.is_ok() {
                same_shape.entry(shape(&phases[number])).or_default().push(number);
            }
        }
        for numbers in same_shape.values() {
            let same_shape: Vec<&[StackPhase<'_>]> = numbers.iter().map(|&number| &*phases[number]).collect();
            for (&number, own) in numbers.iter().zip(Stacked::all(&same_shape)) {
                stacked[number] = Some(own);
            }
        }
        stacked
    }

    /// The reduction of a whole test, from the stacked phases of the test.
    fn together(&self, test: &PhasedTest, linked: Linked<'_>, stacked: Stacked) -> Result<Reduction, ReduceError> {
        let Stacked { factor, links, constant, data } = stacked;
        let Linked { parts, means, design } = linked;
        for numbers in [&[constant], &*data, &*factor] {
            finite(numbers).map_err(|kind| refuse(Some(&test.id), WHOLE, kind))?;
        }
        let mut reduction = Reduction {
            test: test.id.to_string(),
            constant,
            residual: None,
            data,
            factor,
            covariates: parts.iter().flat_map(|part| part.reduction.covariates.iter().copied()).collect(),
            steps: parts.iter().map(|part| part.reduction.steps).sum(),
            observations: parts.iter().map(|part| part.reduction.observations).sum(),
            path: path(&parts),
            design,
            chain: None,
            exact: None,
        };
        // Phases that the test lacks come last, without information.
        reduction.data.resize(self.dimension, 0.0);
        reduction.factor.resize(self.dimension * (self.dimension + 1) / 2, 0.0);
        reduction.covariates.resize(self.regressions, 0.0);
        reduction.chain = Some(Box::new(self.chain(parts, means, links)));
        Ok(reduction)
    }

    fn chain(
        &self,
        parts: Vec<ReducedPhase<'_>>,
        means: Vec<Option<DVector<f64>>>,
        links: Vec<(DMatrix<f64>, DMatrix<f64>)>,
    ) -> Chain {
        let links = std::iter::once(None).chain(links.into_iter().map(Some));
        let phase = |(((part, mean), link), phase): (((ReducedPhase<'_>, _), _), &PhaseReducer)| {
            let link = Option::zip(mean, link);
            let link = link.map(|(mean, (sensitivity, root))| Link { mean, sensitivity, root });
            let Reduction { constant, data, factor, path, .. } = part.reduction.into_owned();
            ChainPhase { own: phase.own, constant, data, factor, path, link }
        };
        Chain { phases: parts.into_iter().zip(means).zip(links).zip(&self.phases).map(phase).collect() }
    }
}

/// g = T x̂_K + t of the link to phase `at`.
fn link_mean(parts: &[ReducedPhase<'_>], at: usize) -> Option<DVector<f64>> {
    let mean = &parts[at.checked_sub(1)?].last().mean;
    let Inherited { transition, input } = parts[at].inherits();
    Some(transition * mean + input)
}

/// Digest of the designs of all phases and of T of each link.
fn digest(parts: &[ReducedPhase<'_>]) -> u128 {
    let mut digest = Digest::new();
    for part in parts {
        digest.wide(part.reduction.design);
        if let Some(inherited) = &part.inherited {
            digest.count(inherited.transition.nrows());
            digest.numbers(inherited.transition.as_slice());
        }
    }
    digest.finish()
}

fn path(parts: &[ReducedPhase<'_>]) -> Path {
    let square_root = parts.iter().any(|part| part.reduction.path == Path::SquareRoot);
    if square_root { Path::SquareRoot } else { Path::Information }
}
