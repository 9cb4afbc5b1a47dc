//! Sums of ℓ and its derivatives over units.

use kalfit_lanes::Lanes;
use nalgebra::DMatrix;

use crate::levels::batch_data::BatchData;
use crate::levels::tangents::{NodeTangent, Scratch, SigmaElement};
use crate::levels::walk::{LevelLaws, PassResults};
use crate::order::Order;
use kalfit_algebra::rows::Rows;
use kalfit_algebra::symmetric::{pair, pairs};

/// Sums over units. Mean coordinates are the p elements of μ, then the regression coefficients.
#[derive(Debug, Clone)]
pub(super) struct UnitSums<T = f64> {
    /// ℓ without the constants.
    pub(super) value: T,
    pub(super) quadratic: T,
    /// ∂ℓ by the mean coordinates, a column.
    pub(super) score: Rows<T>,
    pub(super) information: Rows<T>,
    /// Σ rr' of each level.
    pub(super) outer: Vec<Rows<T>>,
    /// Σ W̄ of each level.
    pub(super) weight: Vec<Rows<T>>,
    /// For the restricted likelihood: Σ ½ (r_c r_d' + r_d r_c'), pairs c, d of free mean coordinates × elements of the
    /// Σ.
    pub(super) spread: Rows<T>,
    /// -∂²ℓ by two elements of the Σ.
    pub(super) observed: Rows<T>,
    /// -∂²ℓ by a mean coordinate and an element of the Σ.
    pub(super) cross: Rows<T>,
    /// Expected information on two elements of the Σ.
    pub(super) expected: Rows<T>,
}

/// Selection and sizes of the sums that are computed.
#[derive(Clone, Copy)]
pub(super) struct SumSelection<'a> {
    pub(super) order: Order,
    /// Number of states.
    pub(super) states: usize,
    /// Number of levels, including the level of the tests.
    pub(super) levels: usize,
    /// Number of mean coordinates.
    pub(super) coordinates: usize,
    /// Free mean coordinates, for the restricted likelihood: d(μ, coefficients) / d(free mean coordinates), and the
    /// covariance of the free mean coordinates where known.
    pub(super) flat: Option<(&'a DMatrix<f64>, Option<&'a DMatrix<f64>>)>,
}

impl<T: Lanes> UnitSums<T> {
    #[inline(always)]
    pub(super) fn zero(selection: SumSelection<'_>) -> UnitSums<T> {
        let SumSelection { states: p, levels, coordinates, .. } = selection;
        let elements = levels * pairs(p);
        let second = if selection.order >= Order::Average { elements } else { 0 };
        let free = selection.flat.map_or(0, |(jacobian, _)| pairs(jacobian.ncols()));
        let mut totals = UnitSums {
            value: T::splat(0.0),
            quadratic: T::splat(0.0),
            score: Rows::zeros(coordinates, 1),
            information: Rows::zeros(coordinates, coordinates),
            outer: Vec::with_capacity(levels),
            weight: Vec::with_capacity(levels),
            spread: Rows::zeros(free, if free > 0 { elements } else { 0 }),
            observed: Rows::zeros(second, second),
            cross: Rows::zeros(if second > 0 { coordinates } else { 0 }, second),
            expected: Rows::zeros(second, second),
        };
        for _ in 0..levels {
            totals.outer.push(Rows::zeros(p, p));
            totals.weight.push(Rows::zeros(p, p));
        }
        totals
    }

    /// Adds the terms of the units of a batch.
    #[inline(always)]
    pub(super) fn take(&mut self, at: &LevelLaws<'_, T>, batch: &BatchData<'_, T>, selection: SumSelection<'_>) {
        let coordinates = !at.regressors.is_empty() || selection.flat.is_some();
        let results = at.results(batch, coordinates);
        let count = T::splat(results.columns as f64);
        self.value = self.value - T::splat(0.5) * (count * results.log_det + results.quadratic);
        self.quadratic = self.quadratic + results.quadratic;
        for (node, down) in batch.groups.iter().zip(&results.down) {
            self.first(node.level, (&down.r, &down.weight), (&results, selection));
        }
        for down in &results.tests {
            self.first(0, (&down.r, &down.weight), (&results, selection));
        }
        self.mean(at, batch, &results);
        if selection.order >= Order::Second {
            self.second(at, (batch, &results), selection);
        }
    }

    /// Adds rr' and W̄ of a test or group.
    #[inline(always)]
    fn first(
        &mut self,
        level: usize,
        (r, weight): (&Rows<T>, &Rows<T>),
        (results, selection): (&PassResults<T>, SumSelection<'_>),
    ) {
        let count = T::splat(results.columns as f64);
        add(&mut self.weight[level], count, weight);
        add_products(&mut self.outer[level], (r, r), results.before);
        if let Some((jacobian, _)) = selection.flat {
            self.spread(level, &free_columns(r, jacobian), count);
        }
    }

    #[inline(always)]
    fn mean(&mut self, at: &LevelLaws<'_, T>, batch: &BatchData<'_, T>, results: &PassResults<T>) {
        let count = T::splat(results.columns as f64);
        for (member, down) in batch.tests.iter().zip(&results.tests) {
            for (c, (state, x)) in each_coordinate(at, &batch.leaves[member.leaf].covariates).enumerate() {
                let (before, rest) = down.r.row(state).split_at(results.before);
                let score = &mut self.score[(c, 0)];
                for &r in rest {
                    *score = x.fma(r, *score);
                }
                for (sum, &r) in self.information.row_mut(c).iter_mut().zip(before) {
                    *sum = (count * x).fma(r, *sum);
                }
            }
        }
        if results.before == 0 {
            let unit = &results.up[results.up.len() - 1];
            add(&mut self.information, count, &unit.W);
        }
    }

    /// Adds ½ (r_c r_d' + r_d r_c') for each pair of free mean coordinates.
    #[inline(always)]
    pub(super) fn spread(&mut self, level: usize, free: &Rows<T>, count: T) {
        let (p, q) = (free.nrows(), free.ncols());
        let (first, half) = (level * pairs(p), T::splat(0.5) * count);
        for c in 0..q {
            for d in 0..=c {
                for k in 0..p {
                    for l in 0..=k {
                        let both = free[(k, c)] * free[(l, d)] + free[(l, c)] * free[(k, d)];
                        let sum = &mut self.spread[(pair(c, d), first + pair(k, l))];
                        *sum = half.fma(both, *sum);
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn second(
        &mut self,
        at: &LevelLaws<'_, T>,
        (batch, results): (&BatchData<'_, T>, &PassResults<T>),
        selection: SumSelection<'_>,
    ) {
        let p = selection.states;
        let mut scratch = Scratch::new(p, results.before + results.columns);
        let mut along = Rows::zeros(p, p);
        for level in 0..selection.levels {
            for row in 0..p {
                for column in 0..=row {
                    let place = (level * pairs(p) + pair(row, column), &mut along);
                    let element = SigmaElement { level, row, column };
                    self.along(at, (batch, results), (element, place), (&mut scratch, selection));
                }
            }
        }
    }

    /// Adds the derivatives of all scores by an element of a Σ.
    #[inline(always)]
    fn along(
        &mut self,
        at: &LevelLaws<'_, T>,
        (batch, results): (&BatchData<'_, T>, &PassResults<T>),
        (element, (e, sum)): (SigmaElement, (usize, &mut Rows<T>)),
        (scratch, selection): (&mut Scratch<T>, SumSelection<'_>),
    ) {
        element.each_tangent(
            at,
            (batch, results),
            scratch,
            #[inline(always)]
            |moved| {
                self.moved(results, (e, sum), &moved, selection);
                if let Some(test) = moved.test {
                    let covariates = &batch.leaves[batch.tests[test].leaf].covariates;
                    for (c, (state, x)) in each_coordinate(at, covariates).enumerate() {
                        let cross = &mut self.cross[(c, e)];
                        for &r in &moved.r.row(state)[results.before..] {
                            *cross = x.fnma(r, *cross);
                        }
                    }
                }
            },
        );
    }

    /// Adds the derivatives of the scores of a test or group by element e.
    #[inline(always)]
    fn moved(
        &mut self,
        results: &PassResults<T>,
        (e, along): (usize, &mut Rows<T>),
        moved: &NodeTangent<'_, T>,
        selection: SumSelection<'_>,
    ) {
        let (p, count) = (selection.states, T::splat(results.columns as f64));
        for i in 0..p {
            along.row_mut(i).fill(T::splat(0.0));
        }
        add_products(along, (moved.r, &moved.of.r), results.before);
        add_products(along, (&moved.of.r, moved.r), results.before);
        if let Some((jacobian, Some(covariance))) = selection.flat {
            let (own, free) = (free_columns(moved.r, jacobian), free_columns(&moved.of.r, jacobian));
            let both = own.times(&numbers(covariance)).times_transpose(&free);
            add(along, count, &both);
            add(along, count, &both.transposed());
        }
        for i in 0..p {
            for k in 0..=i {
                let row = moved.level * pairs(p) + pair(i, k);
                let score_factor = T::splat(if i == k { -0.5 } else { -1.0 });
                let weight = count * moved.weight[(i, k)];
                self.observed[(row, e)] = score_factor.fma(along[(i, k)] - weight, self.observed[(row, e)]);
                self.expected[(row, e)] = score_factor.fma(weight, self.expected[(row, e)]);
            }
        }
    }

    /// The sums over all lanes.
    #[inline(always)]
    pub(super) fn of_all_lanes(&self) -> UnitSums {
        let mut totals = UnitSums {
            value: self.value.sum(),
            quadratic: self.quadratic.sum(),
            score: over_lanes(&self.score),
            information: over_lanes(&self.information),
            outer: Vec::with_capacity(self.outer.len()),
            weight: Vec::with_capacity(self.weight.len()),
            spread: over_lanes(&self.spread),
            observed: over_lanes(&self.observed),
            cross: over_lanes(&self.cross),
            expected: over_lanes(&self.expected),
        };
        for (outer, weight) in self.outer.iter().zip(&self.weight) {
            totals.outer.push(over_lanes(outer));
            totals.weight.push(over_lanes(weight));
        }
        totals
    }
}

impl UnitSums {
    pub(super) fn and(mut self, other: UnitSums) -> UnitSums {
        let levels = |own: Vec<Rows>, other: &[Rows]| own.into_iter().zip(other).map(|(a, b)| a.plus(b)).collect();
        self.value += other.value;
        self.quadratic += other.quadratic;
        UnitSums {
            score: self.score.plus(&other.score),
            information: self.information.plus(&other.information),
            outer: levels(self.outer, &other.outer),
            weight: levels(self.weight, &other.weight),
            spread: self.spread.plus(&other.spread),
            observed: self.observed.plus(&other.observed),
            cross: self.cross.plus(&other.cross),
            expected: self.expected.plus(&other.expected),
            ..self
        }
    }
}

/// For each mean coordinate the state of a test that the coordinate moves, and d(state) / d(coordinate).
#[inline(always)]
pub(super) fn each_coordinate<T: Lanes>(at: &LevelLaws<'_, T>, covariates: &[T]) -> impl Iterator<Item = (usize, T)> {
    let states = (0..at.mean.len()).map(
        #[inline(always)]
        |i| (i, T::splat(1.0)),
    );
    states.chain(at.regressors.iter().copied().zip(covariates.iter().copied()))
}

/// Columns of r for the free mean coordinates: the first columns of `r`, one for each mean coordinate, times
/// `jacobian`.
#[inline(always)]
pub(super) fn free_columns<T: Lanes>(r: &Rows<T>, jacobian: &DMatrix<f64>) -> Rows<T> {
    r.first_columns(jacobian.nrows()).times(&numbers(jacobian))
}

#[inline(always)]
pub(super) fn numbers<T: Lanes>(matrix: &DMatrix<f64>) -> Rows<T> {
    Rows::from_fn(
        matrix.nrows(),
        matrix.ncols(),
        #[inline(always)]
        |i, k| T::splat(matrix[(i, k)]),
    )
}

/// sum ← sum + AB', over the columns of A and B from `before` on.
#[inline(always)]
pub(super) fn add_products<T: Lanes>(sum: &mut Rows<T>, (a, b): (&Rows<T>, &Rows<T>), before: usize) {
    for i in 0..a.nrows() {
        for k in 0..b.nrows() {
            let mut product = T::splat(0.0);
            for (&x, &y) in a.row(i)[before..].iter().zip(&b.row(k)[before..]) {
                product = x.fma(y, product);
            }
            sum[(i, k)] = sum[(i, k)] + product;
        }
    }
}

#[inline(always)]
pub(super) fn add<T: Lanes>(sum: &mut Rows<T>, scale: T, more: &Rows<T>) {
    for i in 0..more.nrows() {
        for (sum, &x) in sum.row_mut(i).iter_mut().zip(more.row(i)) {
            *sum = scale.fma(x, *sum);
        }
    }
}

#[inline(always)]
fn over_lanes<T: Lanes>(rows: &Rows<T>) -> Rows {
    Rows::from_fn(
        rows.nrows(),
        rows.ncols(),
        #[inline(always)]
        |i, k| rows[(i, k)].sum(),
    )
}
