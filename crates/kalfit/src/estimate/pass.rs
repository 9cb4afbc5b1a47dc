//! One pass over the classes: ℓ(μ, Σ) and its derivatives (theory §3), the sums that every solver lives on.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::estimate::classes::{Class, Classes};
use crate::estimate::reml::Restricted;
use crate::estimate::terms::{Point, Regressors, Terms};
use crate::linalg::elements::Elements;
use crate::linalg::symmetric::{pair, pairs};

/// Classes summed by one task. Fixed, so that sums have the same bits for any number of threads.
const CHUNK: usize = 128;

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
    /// Σ W ⊗ r for each mean coordinate: entry (coordinate, k, l) of E'W_{·k} r_l at (coordinate, place (k, l)).
    cross: DMatrix<f64>,
    /// Σ W ⊗ W.
    expected: Products,
    /// The elements of Σ.
    pub(crate) elements: Elements,
}

/// Sums of A ⊗ B over tests, A and B symmetric, as far as second derivatives by two elements of Σ need them: A_la B_bk with k, l
/// of one phase and a, b of one phase. Within a phase entry (l a, b k) stands at a pair of pairs, between phases at a pair of places
/// of the block.
#[derive(Debug, Clone)]
struct Products {
    /// For phases f ≥ g at f(f+1)/2 + g; none where they are not wanted.
    blocks: Vec<DMatrix<f64>>,
}

impl Products {
    fn zero(elements: &Elements, wanted: bool) -> Products {
        let size = |f: usize| elements.blocks()[f].len();
        let between = |f: usize, g: usize| if f == g { pairs(size(f)) } else { size(f) * size(g) };
        let count = if wanted { elements.blocks().len() } else { 0 };
        let blocks = (0..count).flat_map(|f| (0..=f).map(move |g| (f, g)));
        Products { blocks: blocks.map(|(f, g)| DMatrix::zeros(between(f, g), between(f, g))).collect() }
    }

    fn plus(&mut self, other: &Products) {
        self.blocks.iter_mut().zip(&other.blocks).for_each(|(own, other)| *own += other);
    }

    /// Adds scale × A ⊗ B; both p × p by rows.
    fn add(&mut self, elements: &Elements, (scale, a): (f64, &[f64]), b: &[f64]) {
        let p = elements.states();
        let of_block = |(rows, columns): (&Range<usize>, &Range<usize>), same: bool| -> Vec<usize> {
            let row = |i: usize| columns.clone().filter(move |&k| !same || k <= i).map(move |k| i * p + k);
            rows.clone().flat_map(row).collect()
        };
        let all = elements.blocks().iter().enumerate().flat_map(|(f, one)| {
            elements.blocks()[..=f].iter().enumerate().map(move |(g, other)| (f == g, one, other))
        });
        let mut left: Vec<f64> = Vec::new();
        for (block, (same, one, other)) in self.blocks.iter_mut().zip(all) {
            let places = of_block((one, other), same);
            left.clear();
            left.extend(places.iter().map(|&at| scale * a[at]));
            for (column, &at) in block.as_mut_slice().chunks_exact_mut(left.len().max(1)).zip(&places) {
                let right = b[at];
                column.iter_mut().zip(&left).for_each(|(sum, l)| *sum += l * right);
            }
        }
    }

    /// A_la B_bk, k and l of one phase, a and b of one phase.
    fn get(&self, elements: &Elements, (l, a): (usize, usize), (b, k): (usize, usize)) -> f64 {
        let (f, g) = (elements.block_of(l), elements.block_of(a));
        let within = |i: usize| i - elements.blocks()[elements.block_of(i)].start;
        let (l, a, b, k) = (within(l), within(a), within(b), within(k));
        if f == g {
            return self.blocks[pair(f, f)][(pair(l, a), pair(b, k))];
        }
        let (one, other) = if f > g { ((l, a), (k, b)) } else { ((a, l), (b, k)) };
        let width = elements.blocks()[f.min(g)].len();
        self.blocks[pair(f, g)][(one.0 * width + one.1, other.0 * width + other.1)]
    }
}

impl Sums {
    fn zero(elements: &Elements, regressors: usize, order: Order, flat: Option<&FlatMean<'_>>) -> Sums {
        let size = |n: usize, from: Order| if order >= from { n } else { 0 };
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
            cross: DMatrix::zeros(size(m, Order::Second), size(elements.places(), Order::Second)),
            expected: Products::zero(elements, order >= Order::Expected),
            elements: elements.clone(),
        }
    }

    fn add(mut self, other: &Sums) -> Sums {
        self.value += other.value;
        self.mean_score += &other.mean_score;
        self.mean_information += &other.mean_information;
        self.outer += &other.outer;
        self.weight += &other.weight;
        self.spread += &other.spread;
        self.curvature.plus(&other.curvature);
        self.cross += &other.cross;
        self.expected.plus(&other.expected);
        self
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
        let expected = &self.expected.blocks[0];
        let mut outer = self.moment();
        for a in 0..p {
            for b in 0..p {
                for k in 0..p {
                    // Σ W_ak r_b and its mirror
                    outer[(a, b)] -= shift[k] * (self.cross[(a, k * p + b)] + self.cross[(b, k * p + a)]);
                    for l in 0..p {
                        outer[(a, b)] += shift[k] * shift[l] * expected[(pair(a, k), pair(b, l))];
                    }
                }
            }
        }
        (outer - &self.weight) * 0.5
    }

    /// -∂²ℓ/∂σ_kl ∂σ_ab, elements × elements; an off-diagonal element moves both of its places.
    pub(crate) fn observed_information(&self) -> DMatrix<f64> {
        let elements = &self.elements;
        let own = elements.over(|k, l, a, b| self.curvature.get(elements, (l, a), (b, k)));
        match &self.restricted {
            Some(restricted) => own - &restricted.curvature,
            None => own,
        }
    }

    /// ½ Σ tr(W D W E), elements × elements.
    pub(crate) fn expected_information(&self) -> DMatrix<f64> {
        let elements = &self.elements;
        elements.over(|k, l, a, b| 0.5 * self.expected.get(elements, (l, a), (b, k)))
    }

    /// -∂²ℓ/∂(mean coordinate) ∂σ_kl = Σ E'(W_{·k} r_l + W_{·l} r_k), mean coordinates × elements.
    pub(crate) fn cross_information(&self) -> DMatrix<f64> {
        let elements = &self.elements;
        let mut cross = DMatrix::zeros(self.mean_score.len(), elements.count());
        for m in 0..self.mean_score.len() {
            for (s, (k, l)) in elements.all().enumerate() {
                let once = self.cross[(m, elements.place(k, l))];
                cross[(m, s)] = if k == l { once } else { once + self.cross[(m, elements.place(l, k))] };
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
    let chunks: Vec<Sums> = classes
        .classes
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut sums = wanted.zero();
            let mut terms = Terms::new(classes.dimension());
            for class in chunk {
                terms.evaluate(class, regressors, point, wanted.between());
                terms.add_to(&mut sums, class, wanted);
            }
            sums
        })
        .collect();
    chunks.iter().fold(wanted.zero(), Sums::add)
}

/// What one class says by itself.
pub(crate) fn of_class(classes: &Classes, class: &Class, regressors: &Regressors, point: &Point, order: Order) -> Sums {
    let wanted = wanted(&classes.elements, regressors, order, None);
    let mut sums = wanted.zero();
    let mut terms = Terms::new(point.mean.len());
    terms.evaluate(class, regressors, point, wanted.between());
    terms.add_to(&mut sums, class, wanted);
    sums
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

impl Terms {
    fn add_to(&self, sums: &mut Sums, class: &Class, wanted: Wanted<'_>) {
        let (p, n) = (self.r.len(), class.count);
        sums.value += self.value(class);
        for a in 0..p {
            sums.mean_score[a] += n * self.r[a];
        }
        for block in wanted.elements.blocks() {
            for a in block.clone() {
                for b in block.clone() {
                    sums.mean_information[(a, b)] += n * self.W[a * p + b];
                    sums.weight[(a, b)] += n * self.W[a * p + b];
                    sums.outer[(a, b)] += self.outer[a * p + b];
                }
                if wanted.between() {
                    for b in (0..block.start).chain(block.end..p) {
                        sums.mean_information[(a, b)] += n * self.W[a * p + b];
                    }
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
            sums.expected.add(wanted.elements, (n, &self.W), &self.W);
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
        let Wanted { elements, regressors, .. } = wanted;
        let (p, n) = (self.r.len(), class.count);
        let mut inner = self.outer.clone();
        inner.iter_mut().zip(&self.W).for_each(|(m, w)| *m -= 0.5 * n * w);
        if let Some(uncertainty) = uncertainty {
            inner.iter_mut().zip(uncertainty.iter()).for_each(|(m, u)| *m += n * u); // symmetric
        }
        sums.curvature.add(elements, (1.0, &self.W), &inner);
        for block in elements.blocks() {
            for k in block.clone() {
                for l in block.clone() {
                    let column = elements.place(k, l);
                    for a in 0..p {
                        sums.cross[(a, column)] += n * self.W[a * p + k] * self.r[l];
                    }
                    for (c, &element) in regressors.iter().enumerate() {
                        sums.cross[(p + c, column)] += n * class.covariates[c] * self.W[element * p + k] * self.r[l];
                    }
                }
            }
        }
    }
}
