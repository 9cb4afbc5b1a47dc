//! Which directions of the states enter at which phase (theory §7): the ranks of the information, phase by phase.

use nalgebra::DMatrix;

use crate::direction::{ZERO_EIGENVALUE, in_units, simplest};
use kalfit_algebra::symmetric;
use kalfit_estimate::{ChainStore, ChainedClass, Problem};
use kalfit_filter::reduce::Reductions;

/// Number of classes of tests whose information is added before the rank is computed again.
const CLASSES_PER_RANK_CHECK: usize = 64;

/// Information that a phase adds on the initial states.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseObservability {
    /// Rank of the information of this phase alone on all states that enter the phase: new and inherited states.
    pub own_rank: usize,
    /// Rank of the information of this and all earlier phases together on the states of all these phases.
    pub rank_so_far: usize,
    /// Combinations of the states of this and earlier phases that are known from this phase on: each a unit vector of
    /// weights of all states of the model, in the user's units. There are as many as `rank_so_far` increases in this
    /// phase.
    pub entered: Vec<Vec<f64>>,
}

/// Observability of each phase; empty where tests are not stored phase by phase. Classes are added only until a rank is
/// full.
pub(crate) fn phases(problem: &Problem, reductions: &Reductions) -> Vec<PhaseObservability> {
    let elements = &problem.covariance.elements;
    let count = elements.blocks().len();
    if elements.is_single() {
        return vec![single(problem)];
    }
    if problem.classes.units.is_some() || problem.classes.remote.is_some() {
        return Vec::new(); // blocks are levels of groups, not phases; or tests are remote
    }
    let classes = problem.classes.by_phase(reductions);
    let chains: Option<Vec<&ChainStore>> = (0..classes.listed.len()).map(|k| classes.listed.get(k).chain).collect();
    let Some(chains) = chains else { return Vec::new() };
    let chains: Vec<(&ChainStore, Vec<usize>)> =
        chains.into_iter().map(|chain_store| (chain_store, chain_store.entering())).collect();
    let mut found: Vec<PhaseObservability> = Vec::with_capacity(count);
    let mut earlier_range = DMatrix::zeros(elements.states(), 0);
    for f in 0..count {
        let with_phase = chains.iter().filter(|(_, entering)| entering.len() > f);
        let entering = with_phase.clone().next().map_or(0, |(_, entering)| entering[f]);
        let with_phase: Vec<&ChainStore> = with_phase.map(|(chain_store, _)| *chain_store).collect();
        let states = elements.blocks()[f].end;
        let so_far = summed_information(&with_phase, states, elements.states(), &|chain| {
            chain.information(f + 1, elements.states())
        });
        let own = summed_information(&with_phase, entering, entering, &|chain| chain.own_information(f));
        let range = range(&so_far);
        found.push(PhaseObservability {
            own_rank: rank(&own),
            rank_so_far: range.ncols(),
            entered: entered(&range, &earlier_range, &problem.classes.frame.scale),
        });
        earlier_range = range;
    }
    found
}

fn single(problem: &Problem) -> PhaseObservability {
    let information = &problem.classes.information;
    let range = range(information);
    let nothing = DMatrix::zeros(information.nrows(), 0);
    PhaseObservability {
        own_rank: range.ncols(),
        rank_so_far: range.ncols(),
        entered: entered(&range, &nothing, &problem.classes.frame.scale),
    }
}

/// Sum of the information over the chains, `size` × `size`; further chains are not added once the rank is `highest`.
fn summed_information(
    chains: &[&ChainStore],
    highest: usize,
    size: usize,
    of: &dyn Fn(&ChainedClass) -> DMatrix<f64>,
) -> DMatrix<f64> {
    let mut sum = DMatrix::zeros(size, size);
    for chunk in chains.chunks(CLASSES_PER_RANK_CHECK) {
        chunk.iter().for_each(|chain| sum += of(&chain.chained()));
        if rank(&sum) >= highest {
            break;
        }
    }
    sum
}

fn rank(information: &DMatrix<f64>) -> usize {
    symmetric::scaled_eigen(information).1.iter().filter(|v| **v > ZERO_EIGENVALUE).count()
}

/// An orthonormal basis of the range of the information.
fn range(information: &DMatrix<f64>) -> DMatrix<f64> {
    symmetric::range(information, |value| value > ZERO_EIGENVALUE)
}

/// Directions of `range` that are not in the range `before`, as weights in the user's units.
fn entered(range: &DMatrix<f64>, earlier_range: &DMatrix<f64>, scale: &[f64]) -> Vec<Vec<f64>> {
    let new = range.ncols().saturating_sub(earlier_range.ncols());
    if new == 0 {
        return Vec::new();
    }
    let remainder = range - earlier_range * (earlier_range.transpose() * range);
    let decomposed = remainder.svd(true, false);
    let vectors = decomposed.u.expect("asked for");
    let mut order: Vec<usize> = (0..vectors.ncols()).collect();
    order.sort_by(|&a, &b| decomposed.singular_values[b].total_cmp(&decomposed.singular_values[a]));
    let simple = simplest(vectors.select_columns(&order[..new]));
    let units: Vec<f64> = scale.iter().map(|s| s.recip()).collect();
    simple.column_iter().map(|weights| in_units(&weights.into_owned(), units.iter())).collect()
}
