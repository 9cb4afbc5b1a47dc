//! The sums of a pass, and the derivatives of ℓ that are computed from them (theory §3).

use nalgebra::{DMatrix, DVector};

use crate::lanes::ClassSums;
use crate::order::FlatMean;
use crate::order::Order;
use crate::point::Regressors;
use crate::products::{Crosses, ProductBlocks, Products, add_times};
use crate::reml::RemlTerm;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::folded::Folded;
use kalfit_algebra::symmetric::{pair, pairs};

/// Sums over tests. The mean coordinates are the p elements of μ, then the regression coefficients.
#[derive(Debug, Clone)]
pub struct Sums {
    /// ℓ, or ℓ_R where `restricted` is present.
    pub value: f64,
    /// Σ (d - Rμ)'(I + RΣR')⁻¹(d - Rμ).
    pub(crate) quadratic: f64,
    /// ∂ℓ/∂(mean coordinates): Σ E'r.
    pub mean_score: DVector<f64>,
    /// Information on the mean coordinates: Σ E'WE.
    pub mean_information: DMatrix<f64>,
    /// Σ r r', zero between phases.
    pub(crate) outer: DMatrix<f64>,
    /// Σ W, zero between phases.
    pub(crate) weight: DMatrix<f64>,
    /// The term of the restricted likelihood, already part of `value`.
    pub(crate) restricted: Option<RemlTerm>,
    /// Σ X'W ⊗ WX, pairs of free mean coordinates × elements; empty under maximum likelihood.
    pub(super) spread: DMatrix<f64>,
    /// Σ W ⊗ (r r' - ½W); under the restricted likelihood Σ W ⊗ (r r' - ½W + W X V X'W).
    pub(super) curvature: Products,
    /// Σ W ⊗ r for each mean coordinate.
    pub(super) cross: Crosses,
    /// Σ W ⊗ W.
    pub(super) expected: Products,
    /// Second derivatives of tests in groups, which are no sums over tests.
    pub(super) group_derivatives: Option<GroupDerivatives>,
    /// ½ Σ tr(W D W E) at the end of a search, in place of the products `expected`.
    folded_expected: Option<Folded>,
    /// The elements of Σ.
    pub(crate) elements: Elements,
}

/// Second derivatives of tests in groups.
#[derive(Debug, Clone)]
pub(crate) struct GroupDerivatives {
    /// -∂²ℓ by two elements.
    pub(super) observed: DMatrix<f64>,
    /// -∂²ℓ by a mean coordinate and an element.
    pub(super) cross: DMatrix<f64>,
    /// Expected value of `observed`.
    pub(super) expected: DMatrix<f64>,
}

impl Sums {
    pub(super) fn zero(elements: &Elements, regressors: usize, order: Order, flat: Option<&FlatMean<'_>>) -> Sums {
        let p = elements.states();
        let (m, s) = (p + regressors, elements.count());
        Sums {
            value: 0.0,
            quadratic: 0.0,
            mean_score: DVector::zeros(m),
            mean_information: DMatrix::zeros(m, m),
            outer: DMatrix::zeros(p, p),
            weight: DMatrix::zeros(p, p),
            restricted: None,
            spread: flat.map_or_else(|| DMatrix::zeros(0, 0), |f| DMatrix::zeros(pairs(f.jacobian.ncols()), s)),
            curvature: Products::zero(elements, order >= Order::Second),
            cross: Crosses::zero(elements, m, order >= Order::Second),
            expected: Products::zero(elements, order >= Order::Expected),
            group_derivatives: None,
            folded_expected: None,
            elements: elements.clone(),
        }
    }

    /// Adds sign × the sums of other tests. Products that `other` does not hold are unchanged.
    pub(super) fn plus_times(mut self, sign: f64, other: &Sums) -> Sums {
        self.value += sign * other.value;
        self.quadratic += sign * other.quadratic;
        self.mean_score.axpy(sign, &other.mean_score, 1.0);
        let matrices = [
            (&mut self.mean_information, &other.mean_information),
            (&mut self.outer, &other.outer),
            (&mut self.weight, &other.weight),
            (&mut self.spread, &other.spread),
        ];
        matrices.into_iter().for_each(|(own, other)| add_times(own, sign, other));
        self.curvature.blocks.add(sign, &other.curvature.blocks);
        self.cross.blocks.add(sign, &other.cross.blocks);
        self.expected.blocks.add(sign, &other.expected.blocks);
        self
    }

    /// Adds the totals of classes, without their constants.
    pub(super) fn take(&mut self, totals: ClassSums) {
        self.value += totals.value;
        self.quadratic += totals.quadratic;
        self.mean_score.iter_mut().zip(&totals.score).for_each(|(sum, x)| *sum += x);
        let (m, p, ranges) = (self.mean_score.len(), self.outer.nrows(), self.elements.blocks());
        for (k, own) in ranges.iter().enumerate() {
            for (i, other) in ranges[..=k].iter().enumerate() {
                let row = |a: usize| other.clone().take_while(move |&b| b <= a).map(move |b| (a, b));
                for (at, w) in own.clone().flat_map(row).zip(&totals.weight[pair(k, i)]) {
                    add_symmetric(&mut self.mean_information, at, *w);
                    if k == i {
                        add_symmetric(&mut self.weight, at, *w);
                    }
                }
                if k == i {
                    let places = own.clone().flat_map(row).zip(&totals.outer[k]);
                    places.for_each(|(at, x)| add_symmetric(&mut self.outer, at, *x));
                }
            }
        }
        for (c, row) in totals.regression.chunks_exact(m.max(1)).enumerate() {
            for (b, x) in row.iter().enumerate() {
                self.mean_information[(p + c, b)] += x;
                if b < p {
                    self.mean_information[(b, p + c)] += x;
                }
            }
        }
        // each list is freed before the next matrix grows
        self.curvature.blocks.take(totals.curvature);
        self.cross.blocks.take(totals.cross);
        self.expected.blocks.take(totals.expected);
        self.take_spread(&totals.spread);
    }

    /// Adds Σ X'W ⊗ WX from Σ WX ⊗ WX of each phase, pq × pq by rows.
    fn take_spread(&mut self, sums: &[Vec<f64>]) {
        let ranges = self.elements.blocks();
        for (s, (k, l)) in self.elements.all().enumerate() {
            let f = self.elements.block_of(k);
            let (p, k, l) = (ranges[f].len(), k - ranges[f].start, l - ranges[f].start);
            let sums = sums.get(f).map_or(&[][..], Vec::as_slice);
            let q = sums.len().isqrt() / p;
            let both = |(k, c): (usize, usize), (l, d): (usize, usize)| sums[(k * q + c) * p * q + l * q + d];
            for c in 0..q {
                for d in 0..=c {
                    self.spread[(pair(c, d), s)] += 0.5 * (both((k, c), (l, d)) + both((l, c), (k, d)));
                }
            }
        }
    }

    /// Σ (d - Rμ)'(I + RΣR')⁻¹(d - Rμ) of all tests together.
    pub fn quadratic(&self) -> f64 {
        self.quadratic
    }

    /// Σ X'W ⊗ WX.
    pub(crate) fn spread(&self) -> &DMatrix<f64> {
        &self.spread
    }

    /// Adds the term of the restricted likelihood.
    pub(crate) fn restrict(mut self, restricted: RemlTerm) -> Sums {
        self.value += restricted.value;
        self.restricted = Some(restricted);
        self.spread = DMatrix::zeros(0, 0);
        self
    }

    /// The covariance of the free mean coordinates, if known: evaluations at nearby points may reuse that matrix.
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
    pub fn score(&self) -> DMatrix<f64> {
        (self.moment() - &self.weight) * 0.5
    }

    /// G after the mean coordinates have moved by `shift`: r_j becomes r_j - W_j E_j shift. Exact in one phase without
    /// regressors; with regressors, the shift of the regression coefficients is ignored. Needs [`Order::Expected`].
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

    /// -∂²ℓ/∂σ_kl ∂σ_ab, elements × elements; an off-diagonal element changes both entries of Σ. The matrix is moved
    /// out of the sums: with many states each such matrix takes most of the available memory.
    pub(crate) fn observed_information(&mut self) -> DMatrix<f64> {
        let curvature = std::mem::replace(&mut self.curvature, Products::zero(&self.elements, false));
        let own = match &mut self.group_derivatives {
            Some(group_derivatives) => std::mem::replace(&mut group_derivatives.observed, DMatrix::zeros(0, 0)),
            None => self.elements.over(|k, l, a, b| curvature.get((l, a), (b, k))),
        };
        match &mut self.restricted {
            Some(restricted) => own - std::mem::replace(&mut restricted.curvature, DMatrix::zeros(0, 0)),
            None => own,
        }
    }

    /// ½ Σ tr(W D W E), elements × elements.
    pub fn expected_information(&self) -> DMatrix<f64> {
        match (&self.folded_expected, &self.group_derivatives) {
            (Some(expected), _) => expected.unfolded(),
            (None, Some(group_derivatives)) => group_derivatives.expected.clone(),
            (None, None) => self.elements.over(self.expected_term()),
        }
    }

    /// Expected information on (mean coordinates, elements of Σ), block diagonal.
    pub fn all_expected_information(&self) -> DMatrix<f64> {
        let (m, s) = (self.mean_score.len(), self.elements.count());
        let mut information = DMatrix::zeros(m + s, m + s);
        information.view_mut((0, 0), (m, m)).copy_from(&self.mean_information);
        information.view_mut((m, m), (s, s)).copy_from(&self.expected_information());
        information
    }

    fn expected_term(&self) -> impl Fn(usize, usize, usize, usize) -> f64 {
        |k, l, a, b| 0.5 * self.expected.get((l, a), (b, k))
    }

    /// The sums without the products of the expected information.
    pub(super) fn without_expected(self) -> Sums {
        Sums { expected: Products::zero(&self.elements, false), ..self }
    }

    /// The sums with the expected information computed, in half the memory of the products `expected`.
    pub(super) fn with_folded_expected(mut self) -> Sums {
        if self.folded_expected.is_none() {
            self.folded_expected = Some(match &mut self.group_derivatives {
                Some(group_derivatives) => {
                    Folded::of(std::mem::replace(&mut group_derivatives.expected, DMatrix::zeros(0, 0)))
                }
                None => self.elements.folded_over(self.expected_term()),
            });
        }
        self.without_expected()
    }

    /// The sums for the end of a search: all second derivatives by elements of Σ are dropped, except the expected
    /// information.
    pub(super) fn only_expected(mut self) -> Sums {
        self.curvature = Products::zero(&self.elements, false);
        Sums { group_derivatives: None, ..self.with_folded_expected() }
    }

    /// -∂²ℓ/∂(mean coordinate) ∂σ_kl = Σ E'(W_{·k} r_l + W_{·l} r_k), mean coordinates × elements.
    pub(crate) fn cross_information(&self) -> DMatrix<f64> {
        if let Some(group_derivatives) = &self.group_derivatives {
            return group_derivatives.cross.clone();
        }
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

/// Adds x to the entries (a, b) and (b, a) of a symmetric matrix, once if a = b.
fn add_symmetric(matrix: &mut DMatrix<f64>, (a, b): (usize, usize), x: f64) {
    matrix[(a, b)] += x;
    if a != b {
        matrix[(b, a)] += x;
    }
}

/// Sums as a list of numbers that places send and that can be added up.
impl Sums {
    /// All sums, as a list.
    pub(super) fn numbers(&self) -> Vec<f64> {
        let matrices = [&self.mean_information, &self.outer, &self.weight, &self.spread];
        let group_derivatives =
            self.group_derivatives.iter().flat_map(|own| [&own.observed, &own.cross, &own.expected]);
        let plain = [self.value, self.quadratic].into_iter().chain(self.mean_score.iter().copied());
        let blocks = [&self.curvature.blocks, &self.cross.blocks, &self.expected.blocks];
        let products = blocks.into_iter().flat_map(ProductBlocks::numbers);
        plain.chain(matrices.into_iter().chain(group_derivatives).flatten().copied()).chain(products).collect()
    }

    /// The sums from a list that `numbers` has made, with the shapes of `self`; `None` where the list has another
    /// length.
    pub(super) fn of_numbers(mut self, numbers: &[f64]) -> Option<Sums> {
        let matrices = [&mut self.mean_information, &mut self.outer, &mut self.weight, &mut self.spread];
        let group_derivatives =
            self.group_derivatives.iter_mut().flat_map(|own| [&mut own.observed, &mut own.cross, &mut own.expected]);
        let plain = [&mut self.value, &mut self.quadratic].into_iter().chain(self.mean_score.iter_mut());
        let blocks = [&mut self.curvature.blocks, &mut self.cross.blocks, &mut self.expected.blocks];
        let products = blocks.into_iter().flat_map(ProductBlocks::elements_mut);
        let places = plain
            .chain(matrices.into_iter().chain(group_derivatives).flat_map(|matrix| matrix.iter_mut()))
            .chain(products);
        let mut count = 0;
        places.zip(numbers).for_each(|(place, number)| {
            *place = *number;
            count += 1;
        });
        (count == numbers.len() && count == self.numbers().len()).then_some(self)
    }

    /// Sums whose value is not known.
    pub(super) fn unknown(self) -> Sums {
        Sums { value: f64::NAN, ..self }
    }
}
