//! One pass over the classes: ℓ(μ, Σ) and its derivatives (theory §3), the sums that every solver lives on.
#![expect(non_snake_case, reason = "W is the letter of the theory")]

use std::ops::Range;
use std::sync::Arc;

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::estimate::chained::{Detail, Packed};
use crate::estimate::class::{Class, ClassRef};
use crate::estimate::classes::Classes;
use crate::estimate::lanes::{ChainPass, ChainTotals};
use crate::estimate::levels;
use crate::estimate::order::{FlatMean, Order, Wanted, most_tasks};
use crate::estimate::point::{Point, Regressors};
use crate::estimate::remote;
use crate::estimate::sums::Sums;
use crate::estimate::terms::Terms;
use crate::estimate::together::each;
use crate::linalg::elements::Elements;
use crate::linalg::symmetric::pair;

/// Classes summed by one task. Fixed, so that sums have the same bits for any number of threads.
const CHUNK: usize = 128;

/// Most tasks that tests in phases are summed by: each needs much room for second derivatives.
const CHAIN_TASKS: usize = 16;

impl Wanted<'_> {
    pub(super) fn zero(&self) -> Sums {
        Sums::zero(self.elements, self.regressors.len(), self.order, self.flat)
    }

    /// W between phases is wanted.
    fn between(&self) -> bool {
        self.order >= Order::Mean
    }

    fn detail(&self) -> Detail {
        if self.between() { Detail::Between } else { Detail::Phases }
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
        return remote::pass(remote, &classes.frame, point, wanted);
    }
    if let Some(units) = &classes.units {
        return levels::pass(units, point, wanted);
    }
    // tests in phases are added up one by one where there are regressions, and under the restricted likelihood
    let simple = flat.is_none() && classes.frame.covariate_scale.is_empty();
    let apart = |number: &usize| classes.listed.get(*number);
    let mut others: Vec<ClassRef<'_>> = classes.beside.iter().map(apart).collect();
    if !simple {
        others.extend(classes.chains.iter().flat_map(|packed| packed.members()).map(apart));
    }
    let mut sums = one_by_one(&others, point, wanted);
    sums.value += classes.blocks.constant() + classes.shared.constant();
    if simple {
        classes.blocks.totals(point, order).into_iter().for_each(|totals| sums.take(totals));
        let refused = add_chains(&mut sums, classes, point, order);
        if !refused.is_empty() {
            sums = sums.add(&one_by_one(&refused, point, wanted));
        }
    } else {
        classes.blocks.whole(point, wanted).into_iter().for_each(|totals| sums.take_whole(totals));
    }
    classes.shared.whole(point, wanted).into_iter().for_each(|totals| sums.take_whole(totals));
    sums
}

/// Adds what tests in phases say that are worked on side by side; classes that need more care are left, and returned.
fn add_chains<'a>(sums: &mut Sums, classes: &'a Classes, point: &Point, order: Order) -> Vec<ClassRef<'a>> {
    let isa = classes.blocks.isa();
    let of = |blocks: &[Arc<Packed>]| {
        let elements = &classes.elements;
        isa.run(ChainPass { blocks, classes: &classes.listed, point, regressors: &[], elements, order, isa })
    };
    let each = classes.chains.len().div_ceil(CHAIN_TASKS).max(CHUNK / isa.lanes());
    let all: Vec<ChainTotals> = classes.chains.par_chunks(each).map(of).collect();
    all.iter().for_each(|totals| sums.take_chain(totals));
    all.iter().flat_map(|totals| &totals.refused).map(|&k| classes.listed.get(k)).collect()
}

/// Sums over classes one by one.
pub(super) fn one_by_one(classes: &[ClassRef<'_>], point: &Point, wanted: Wanted<'_>) -> Sums {
    let of_chunk = |chunk: &[ClassRef<'_>]| {
        let mut sums = wanted.zero();
        let add = &mut |k: usize, terms: &Terms| terms.add_to(&mut sums, chunk[k], wanted);
        each(chunk, wanted.regressors, point, wanted.detail(), add);
        sums.settled()
    };
    let each = CHUNK.max(classes.len().div_ceil(most_tasks(wanted.elements.states())));
    let chunks: Vec<Sums> = classes.par_chunks(each).map(of_chunk).collect();
    chunks.iter().fold(wanted.zero(), Sums::add)
}

/// What one class says by itself.
pub(crate) fn of_class(
    classes: &Classes,
    class: &Class,
    (regressors, flat): (&Regressors, Option<&FlatMean<'_>>),
    point: &Point,
    order: Order,
) -> Sums {
    let wanted = wanted(&classes.elements, regressors, order, flat);
    let (mut sums, class) = (wanted.zero(), class.view());
    let mut terms = Terms::new(point.mean.len());
    terms.evaluate(class, regressors, point, wanted.detail());
    terms.add_to(&mut sums, class, wanted);
    sums.settled()
}

/// Regressions and the restricted likelihood need all of the information on the mean.
fn wanted<'a>(
    elements: &'a Elements,
    regressors: &'a Regressors,
    order: Order,
    flat: Option<&'a FlatMean<'a>>,
) -> Wanted<'a> {
    let least = if regressors.is_empty() && flat.is_none() { Order::First } else { Order::Mean };
    Wanted { elements, regressors, order: order.max(least), flat }
}

/// Adds n W to a column, in some rows.
fn add(column: &mut [f64], n: f64, W: &[f64], rows: Range<usize>) {
    column[rows.clone()].iter_mut().zip(&W[rows]).for_each(|(sum, w)| *sum += n * w);
}

impl Terms {
    fn add_to(&self, sums: &mut Sums, class: ClassRef<'_>, wanted: Wanted<'_>) {
        let (p, n) = (self.r.len(), class.count);
        sums.value += self.value(class);
        sums.quadratic += self.quadratic;
        for a in 0..p {
            sums.mean_score[a] += n * self.r[a];
        }
        let m = sums.mean_information.nrows();
        for block in wanted.elements.blocks() {
            for b in block.clone() {
                let W = &self.W[b * p..][..p]; // symmetric
                let known = if wanted.between() { 0..p } else { block.clone() };
                add(&mut sums.mean_information.as_mut_slice()[b * m..][..p], n, W, known);
                add(&mut sums.weight.as_mut_slice()[b * p..][..p], n, W, block.clone());
                for a in block.clone() {
                    sums.outer[(a, b)] += self.outer[a * p + b];
                }
            }
        }
        let regressors = wanted.regressors;
        for (c, &element) in regressors.iter().enumerate() {
            self.add_regressor(sums, class, regressors, (c, element));
        }
        let uncertainty = wanted.flat.and_then(|flat| self.add_flat(sums, class, wanted, flat));
        if wanted.order >= Order::Second {
            self.add_second(sums, class, wanted, uncertainty.as_ref());
        }
        if wanted.order >= Order::Expected {
            sums.expected.add((n, &self.W), &self.W);
        }
    }

    fn add_regressor(&self, sums: &mut Sums, class: ClassRef<'_>, regressors: &Regressors, at: (usize, usize)) {
        let (p, n, x) = (self.r.len(), class.count, class.covariates[at.0]);
        let row = p + at.0;
        sums.mean_score[row] += n * x * self.r[at.1];
        for a in 0..p {
            let value = n * x * self.W[at.1 * p + a];
            sums.mean_information[(row, a)] += value;
            sums.mean_information[(a, row)] += value;
        }
        for (c, &element) in regressors.iter().enumerate() {
            sums.mean_information[(row, p + c)] += n * x * class.covariates[c] * self.W[at.1 * p + element];
        }
    }

    /// Adds to Σ X'W ⊗ WX, and returns W X V X'W (p × p) where V is known.
    fn add_flat(
        &self,
        sums: &mut Sums,
        class: ClassRef<'_>,
        Wanted { elements, regressors, .. }: Wanted<'_>,
        flat: &FlatMean<'_>,
    ) -> Option<DMatrix<f64>> {
        let p = self.r.len();
        let rows = DMatrix::from_fn(p, p + regressors.len(), |a, m| {
            if m < p { self.W[a * p + m] } else { class.covariates[m - p] * self.W[regressors[m - p] * p + a] }
        });
        let own = rows * flat.jacobian; // WX
        for c in 0..own.ncols() {
            for d in 0..=c {
                for (s, (k, l)) in elements.all().enumerate() {
                    let both = own[(k, c)] * own[(l, d)] + own[(l, c)] * own[(k, d)];
                    sums.spread[(pair(c, d), s)] += 0.5 * class.count * both;
                }
            }
        }
        flat.covariance.map(|covariance| &own * covariance * own.transpose())
    }

    fn add_second(&self, sums: &mut Sums, class: ClassRef<'_>, wanted: Wanted<'_>, uncertainty: Option<&DMatrix<f64>>) {
        let regressors = wanted.regressors;
        let (p, n) = (self.r.len(), class.count);
        let mut inner = self.outer.clone();
        inner.iter_mut().zip(&self.W).for_each(|(m, w)| *m -= 0.5 * n * w);
        if let Some(uncertainty) = uncertainty {
            inner.iter_mut().zip(uncertainty.iter()).for_each(|(m, u)| *m += n * u); // symmetric
        }
        sums.curvature.add((1.0, &self.W), &inner);
        let weight = |a: usize, k: usize| match a.checked_sub(p) {
            None => n * self.W[a * p + k],
            Some(c) => n * class.covariates[c] * self.W[regressors[c] * p + k],
        };
        sums.cross.add(weight, &self.r);
    }
}
