//! One pass over the classes: ℓ(μ, Σ) and its derivatives (theory §3), the sums that every solver uses.

use std::sync::Arc;

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::chained::{ChainDetail, Packed};
use crate::class::{Class, ClassRef};
use crate::classes::Classes;
use crate::lanes::{Accumulator, ChainContribution, ChainKernel, ChainSums, ClassEvaluator, ClassSums};
use crate::levels;
use crate::order::Order;
use crate::order::{FlatMean, SumsWanted, max_tasks};
use crate::point::{Point, Regressors};
use crate::remote;
use crate::sums::{GroupDerivatives, Sums};
use kalfit_algebra::elements::Elements;

/// Number of classes that one task sums: fixed, so that sums have the same bits for any number of threads.
const CLASSES_PER_TASK: usize = 128;

/// Maximum number of tasks that tests in phases are split into: each task needs much memory for second derivatives.
const MAX_CHAIN_TASKS: usize = 16;

impl SumsWanted<'_> {
    pub(super) fn zero(&self) -> Sums {
        Sums::zero(self.elements, self.regressors.len(), self.order, self.flat)
    }

    /// Zero sums for tests in groups, whose second derivatives are in separate matrices.
    pub(super) fn zero_in_groups(self) -> Sums {
        let mut zero = SumsWanted { order: self.order.min(Order::Mean), ..self }.zero();
        let second = if self.order >= Order::Average { self.elements.count() } else { 0 };
        let of = |rows: usize| DMatrix::zeros(if second > 0 { rows } else { 0 }, second);
        let coordinates = zero.mean_score.len();
        zero.group_derivatives =
            Some(GroupDerivatives { observed: of(second), cross: of(coordinates), expected: of(second) });
        zero
    }

    /// Whether W between phases is requested.
    pub(super) fn between(&self) -> bool {
        self.order >= Order::Mean
    }

    pub(super) fn detail(&self) -> ChainDetail {
        if self.between() { ChainDetail::Between } else { ChainDetail::Phases }
    }
}

/// ℓ and its derivatives at a point.
pub(crate) fn pass(
    classes: &Classes,
    regressors: &Regressors,
    point: &Point,
    order: Order,
    flat: Option<&FlatMean<'_>>,
) -> Sums {
    let wanted = wanted(&classes.elements, regressors, order, flat);
    if let Some(remote) = &classes.remote {
        return remote::pass((remote, classes), point, wanted);
    }
    if let Some(units) = &classes.units {
        return levels::pass(units, point, wanted);
    }
    let single_classes: Vec<ClassRef<'_>> =
        classes.unbatched.iter().map(|&number| classes.listed.get(number)).collect();
    let mut sums = one_by_one(&single_classes, point, wanted);
    sums.value += classes.blocks.constant() + classes.shared.constant();
    classes.blocks.totals(point, wanted).into_iter().for_each(|totals| sums.take(totals));
    classes.shared.totals(point, wanted).into_iter().for_each(|totals| sums.take(totals));
    let needs_rotations = add_chains(&mut sums, classes, point, wanted);
    if needs_rotations.is_empty() { sums } else { sums.plus_times(1.0, &one_by_one(&needs_rotations, point, wanted)) }
}

/// The finite value sent in place of ℓ = -∞, so that sums can be added up.
const SENT_MINUS_INFINITY: f64 = -1e300;

/// A pass whose sums are sent to a search on another machine. Such a search also requests the information on the mean
/// at Σ = 0, where ℓ = -∞ if a test measures something exactly.
pub(super) fn pass_for_remote(
    classes: &Classes,
    regressors: &Regressors,
    point: &Point,
    order: Order,
    flat: Option<&FlatMean<'_>>,
) -> Sums {
    if order != Order::Mean || point.root.amax() > 0.0 || !classes.has_exact() {
        return pass(classes, regressors, point, order, flat);
    }
    let wanted = wanted(&classes.elements, regressors, order, flat);
    let mut sums = wanted.zero();
    (sums.value, sums.mean_information) = (SENT_MINUS_INFINITY, classes.mean_information(regressors));
    sums
}

/// Adds the sums of tests in phases that are evaluated in lanes; returns the classes that need rotations.
fn add_chains<'a>(sums: &mut Sums, classes: &'a Classes, point: &Point, wanted: SumsWanted<'_>) -> Vec<ClassRef<'a>> {
    let isa = classes.blocks.isa();
    let of = |blocks: &[Arc<Packed>]| isa.run(ChainKernel { blocks, classes: &classes.listed, point, wanted });
    let classes_per_task = classes.chains.len().div_ceil(MAX_CHAIN_TASKS).max(CLASSES_PER_TASK / isa.lanes());
    let chain_sums: Vec<ChainSums> = classes.chains.par_chunks(classes_per_task).map(of).collect();
    let mut failed_classes = Vec::new();
    for ChainSums { totals, constant, needs_rotations } in chain_sums {
        sums.value += constant;
        sums.take(totals);
        failed_classes.extend(needs_rotations.into_iter().map(|number| classes.listed.get(number)));
    }
    failed_classes
}

/// Sums over classes that are evaluated one by one.
pub(super) fn one_by_one(classes: &[ClassRef<'_>], point: &Point, wanted: SumsWanted<'_>) -> Sums {
    let of_chunk = |chunk: &[ClassRef<'_>]| {
        let (mut sums, mut at) = (Accumulator::new(wanted), ClassEvaluator::new(point, wanted.regressors));
        for &class in chunk {
            if let Some(chain) = class.chain {
                let evaluated = &at.in_phases(class, chain, wanted.detail());
                sums.add(&ChainContribution { evaluated, count: class.count }, class.covariates);
            } else {
                sums.add(&at.whole(class, wanted.elements.blocks()), class.covariates);
            }
        }
        (chunk.iter().map(|class| class.constant).sum(), sums.totals())
    };
    let classes_per_task = CLASSES_PER_TASK.max(classes.len().div_ceil(max_tasks(wanted.elements.states())));
    let chunks: Vec<(f64, ClassSums)> = classes.par_chunks(classes_per_task).map(of_chunk).collect();
    let mut sums = wanted.zero();
    for (constant, totals) in chunks {
        sums.value += constant;
        sums.take(totals);
    }
    sums
}

/// Sums over one class.
pub(crate) fn of_class(
    classes: &Classes,
    class: &Class,
    (regressors, flat): (&Regressors, Option<&FlatMean<'_>>),
    point: &Point,
    order: Order,
) -> Sums {
    one_by_one(&[class.view()], point, wanted(&classes.elements, regressors, order, flat))
}

/// The sums that a pass computes for `order`; with regressions or under the restricted likelihood, at least the sums of
/// [`Order::Mean`].
fn wanted<'a>(
    elements: &'a Elements,
    regressors: &'a Regressors,
    order: Order,
    flat: Option<&'a FlatMean<'a>>,
) -> SumsWanted<'a> {
    let least = if regressors.is_empty() && flat.is_none() { Order::First } else { Order::Mean };
    SumsWanted { elements, regressors, order: order.max(least), flat }
}
