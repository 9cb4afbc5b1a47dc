//! One pass over the classes: ℓ(μ, Σ) and its derivatives (theory §3), the sums that every solver lives on.
#![expect(non_snake_case, reason = "W is the letter of the theory")]

use std::ops::Range;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::estimate::chained::{Detail, Packed};
use crate::estimate::classes::{Class, Classes};
use crate::estimate::lanes::{ChainPass, ChainTotals, Totals};
use crate::estimate::products::{Crosses, Products};
use crate::estimate::reml::Restricted;
use crate::estimate::terms::{Point, Regressors, Terms};
use crate::estimate::together::each;
use crate::linalg::elements::Elements;
use crate::linalg::symmetric::{pair, pairs};

/// Classes summed by one task. Fixed, so that sums have the same bits for any number of threads.
const CHUNK: usize = 128;

/// Most tasks that tests in phases are summed by: each needs much room for second derivatives.
const CHAIN_TASKS: usize = 16;

/// Which derivatives a pass computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Order {
    /// ℓ and the first derivatives: all that EM needs. The information on the mean only within phases.
    First,
    /// And all of the information on the mean.
    Mean,
    /// And the observed information.
    Second,
    /// And the expected information of Σ.
    Expected,
}

/// Sums over tests. The mean coordinates are the p elements of μ, then the regression coefficients.
#[derive(Debug, Clone)]
pub(crate) struct Sums {
    /// ℓ.
    pub(crate) value: f64,
    /// ∂ℓ/∂(mean coordinates): Σ E'r.
    pub(crate) mean_score: DVector<f64>,
    /// Σ E'WE.
    pub(crate) mean_information: DMatrix<f64>,
    /// Σ r r', zero between phases.
    pub(crate) outer: DMatrix<f64>,
    /// Σ W, zero between phases.
    pub(crate) weight: DMatrix<f64>,
    /// What the restricted likelihood adds, already part of `value`.
    pub(crate) restricted: Option<Restricted>,
    /// Σ X'W ⊗ WX, pairs of free mean coordinates × elements; nothing under maximum likelihood.
    spread: DMatrix<f64>,
    /// Σ W ⊗ (r r' - ½W); under the restricted likelihood Σ W ⊗ (r r' - ½W + W X V X'W).
    curvature: Products,
    /// Σ W ⊗ r for each mean coordinate.
    cross: Crosses,
    /// Σ W ⊗ W.
    expected: Products,
    /// The elements of Σ.
    pub(crate) elements: Elements,
}

impl Sums {
    fn zero(elements: &Elements, regressors: usize, order: Order, flat: Option<&FlatMean<'_>>) -> Sums {
        let p = elements.states();
        let (m, s) = (p + regressors, elements.count());
        Sums {
            value: 0.0,
            mean_score: DVector::zeros(m),
            mean_information: DMatrix::zeros(m, m),
            outer: DMatrix::zeros(p, p),
            weight: DMatrix::zeros(p, p),
            restricted: None,
            spread: flat.map_or_else(|| DMatrix::zeros(0, 0), |f| DMatrix::zeros(pairs(f.jacobian.ncols()), s)),
            curvature: Products::zero(elements, order >= Order::Second),
            cross: Crosses::zero(elements, m, order >= Order::Second),
            expected: Products::zero(elements, order >= Order::Expected),
            elements: elements.clone(),
        }
    }

    /// Nothing is left to be added.
    fn settled(mut self) -> Sums {
        self.curvature.settle();
        self.cross.settle();
        self.expected.settle();
        self
    }

    fn add(mut self, other: &Sums) -> Sums {
        self.value += other.value;
        self.mean_score += &other.mean_score;
        self.mean_information += &other.mean_information;
        self.outer += &other.outer;
        self.weight += &other.weight;
        self.spread += &other.spread;
        self.curvature.plus(&other.curvature);
        self.cross.plus(&other.cross);
        self.expected.plus(&other.expected);
        self
    }

    /// Adds what tests say that are worked on side by side, their constants apart.
    fn take(&mut self, totals: &Totals) {
        self.value -= 0.5 * (totals.log_det + totals.quadratic);
        self.mean_score.iter_mut().zip(&totals.r).for_each(|(sum, r)| *sum += r);
        for (at, (a, b)) in self.elements.all().enumerate() {
            for (a, b) in if a == b { vec![(a, b)] } else { vec![(a, b), (b, a)] } {
                self.weight[(a, b)] += totals.W[at];
                self.mean_information[(a, b)] += totals.W[at];
                self.outer[(a, b)] += totals.outer[at];
            }
        }
        self.curvature.take(&totals.curvature);
        self.cross.take(&totals.cross);
        self.expected.take(&totals.expected);
    }

    /// Adds what tests in phases say that are worked on side by side; classes that need more care are left, and returned.
    fn take_chains<'a>(&mut self, classes: &'a Classes, point: &Point, order: Order) -> Vec<&'a Class> {
        let isa = classes.blocks.isa();
        let of = |blocks: &[Arc<Packed>]| {
            let elements = &classes.elements;
            isa.run(ChainPass { blocks, classes: &classes.classes, point, regressors: &[], elements, order, isa })
        };
        let each = classes.chains.len().div_ceil(CHAIN_TASKS).max(CHUNK / isa.lanes());
        let all: Vec<ChainTotals> = classes.chains.par_chunks(each).map(of).collect();
        all.iter().for_each(|totals| self.take_chain(totals));
        all.iter().flat_map(|totals| &totals.refused).map(|&k| &classes.classes[k]).collect()
    }

    fn take_chain(&mut self, totals: &ChainTotals) {
        self.value += totals.value;
        self.mean_score.iter_mut().zip(&totals.r).for_each(|(sum, r)| *sum += r);
        let ranges = self.elements.blocks();
        for (k, own) in ranges.iter().enumerate() {
            for (i, other) in ranges[..=k].iter().enumerate() {
                let places = own.clone().flat_map(|a| other.clone().map(move |b| (a, b)));
                for ((a, b), w) in places.zip(&totals.W[pair(k, i)]) {
                    self.mean_information[(a, b)] += w;
                    if k == i {
                        self.weight[(a, b)] += w;
                    } else {
                        self.mean_information[(b, a)] += w;
                    }
                }
            }
            for a in 0..own.len() {
                for b in 0..own.len() {
                    let (row, column) = (a.max(b), a.min(b));
                    self.outer[(own.start + a, own.start + b)] += totals.outer[k][row * own.len() + column];
                }
            }
        }
        self.curvature.take_pairs(&totals.curvature);
        self.cross.take_phases(&totals.cross);
        self.expected.take_pairs(&totals.expected);
    }

    /// Σ X'W ⊗ WX.
    pub(crate) fn spread(&self) -> &DMatrix<f64> {
        &self.spread
    }

    /// With what the restricted likelihood adds.
    pub(crate) fn restrict(mut self, restricted: Restricted) -> Sums {
        self.value += restricted.value;
        self.restricted = Some(restricted);
        self
    }

    /// What places near by may take from this one.
    pub(crate) fn near(&self) -> Option<&DMatrix<f64>> {
        self.restricted.as_ref().map(|r| &r.covariance)
    }

    /// Σ r r', to which under the restricted likelihood the uncertainty of the mean adds Σ W X V X'W.
    pub(crate) fn moment(&self) -> DMatrix<f64> {
        match &self.restricted {
            Some(restricted) => &self.outer + &restricted.score * 2.0,
            None => self.outer.clone(),
        }
    }

    /// G = ∂ℓ/∂Σ = ½ Σ (r r' - W), (5), with what the restricted likelihood adds: the value changes by tr(G dΣ).
    pub(crate) fn score(&self) -> DMatrix<f64> {
        (self.moment() - &self.weight) * 0.5
    }

    /// G once the mean coordinates have moved by `shift`: r_j becomes r_j - W_j E_j shift. Exact in one phase without regressors;
    /// with them their part of the shift is left out. Needs [`Order::Expected`].
    pub(crate) fn score_after(&self, regressors: &Regressors, shift: &DVector<f64>) -> DMatrix<f64> {
        let p = self.outer.nrows();
        debug_assert!(self.elements.is_single(), "between phases the sums do not tell");
        debug_assert_eq!(shift.len(), p + regressors.len(), "mean coordinates");
        let mut outer = self.moment();
        for a in 0..p {
            for b in 0..p {
                for k in 0..p {
                    // Σ W_ak r_b and its mirror
                    outer[(a, b)] -= shift[k] * (self.cross.get(a, (k, b)) + self.cross.get(b, (k, a)));
                    for l in 0..p {
                        outer[(a, b)] += shift[k] * shift[l] * self.expected.get((a, k), (b, l));
                    }
                }
            }
        }
        (outer - &self.weight) * 0.5
    }

    /// -∂²ℓ/∂σ_kl ∂σ_ab, elements × elements; an off-diagonal element moves both of its places.
    pub(crate) fn observed_information(&self) -> DMatrix<f64> {
        let elements = &self.elements;
        let own = elements.over(|k, l, a, b| self.curvature.get((l, a), (b, k)));
        match &self.restricted {
            Some(restricted) => own - &restricted.curvature,
            None => own,
        }
    }

    /// ½ Σ tr(W D W E), elements × elements.
    pub(crate) fn expected_information(&self) -> DMatrix<f64> {
        let elements = &self.elements;
        elements.over(|k, l, a, b| 0.5 * self.expected.get((l, a), (b, k)))
    }

    /// -∂²ℓ/∂(mean coordinate) ∂σ_kl = Σ E'(W_{·k} r_l + W_{·l} r_k), mean coordinates × elements.
    pub(crate) fn cross_information(&self) -> DMatrix<f64> {
        let elements = &self.elements;
        let mut cross = DMatrix::zeros(self.mean_score.len(), elements.count());
        for m in 0..self.mean_score.len() {
            for (s, (k, l)) in elements.all().enumerate() {
                let once = self.cross.get(m, (k, l));
                cross[(m, s)] = if k == l { once } else { once + self.cross.get(m, (l, k)) };
            }
        }
        cross
    }
}

/// What the restricted likelihood needs of every class: X = E × jacobian, the mean by its free coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FlatMean<'a> {
    /// d(mean coordinates) / d(free mean coordinates).
    pub(crate) jacobian: &'a DMatrix<f64>,
    /// V, the covariance of the free mean coordinates.
    pub(crate) covariance: Option<&'a DMatrix<f64>>,
}

/// What a pass adds up.
#[derive(Debug, Clone, Copy)]
struct Wanted<'a> {
    elements: &'a Elements,
    regressors: &'a Regressors,
    order: Order,
    flat: Option<&'a FlatMean<'a>>,
}

impl Wanted<'_> {
    fn zero(&self) -> Sums {
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
    // what the restricted likelihood and regressions add is summed test by test
    let side_by_side = flat.is_none() && regressors.is_empty();
    let others: Vec<&Class> = match side_by_side {
        true => classes.beside.iter().map(|&k| &classes.classes[k]).collect(),
        false => classes.classes.iter().collect(),
    };
    let of_chunk = |chunk: &[&Class]| {
        let mut sums = wanted.zero();
        each(chunk, regressors, point, wanted.detail(), &mut |k, terms| terms.add_to(&mut sums, chunk[k], wanted));
        sums.settled()
    };
    let one_by_one = |others: &[&Class]| {
        let chunks: Vec<Sums> = others.par_chunks(CHUNK).map(of_chunk).collect();
        chunks.iter().fold(wanted.zero(), Sums::add)
    };
    let mut sums = one_by_one(&others);
    if side_by_side {
        sums.value += classes.blocks.constant();
        classes.blocks.totals(point, order).iter().for_each(|totals| sums.take(totals));
        let refused = sums.take_chains(classes, point, order);
        if !refused.is_empty() {
            sums = sums.add(&one_by_one(&refused));
        }
    }
    sums
}

/// What one class says by itself.
pub(crate) fn of_class(classes: &Classes, class: &Class, regressors: &Regressors, point: &Point, order: Order) -> Sums {
    let wanted = wanted(&classes.elements, regressors, order, None);
    let mut sums = wanted.zero();
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
    fn add_to(&self, sums: &mut Sums, class: &Class, wanted: Wanted<'_>) {
        let (p, n) = (self.r.len(), class.count);
        sums.value += self.value(class);
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

    fn add_regressor(&self, sums: &mut Sums, class: &Class, regressors: &Regressors, at: (usize, usize)) {
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
        class: &Class,
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

    fn add_second(&self, sums: &mut Sums, class: &Class, wanted: Wanted<'_>, uncertainty: Option<&DMatrix<f64>>) {
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
