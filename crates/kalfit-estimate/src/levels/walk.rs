//! Upward and downward pass through the groups of units: from the tests to the units and back.
#![expect(non_snake_case, reason = "R, U, W, V are the letters of the theory")]

use kalfit_lanes::{Lanes, MAX_LANES, Part};

use crate::levels::batch_data::BatchData;
use crate::levels::design::Leaf;
use crate::levels::units::Units;
use crate::point::{Point, Regressors};
use kalfit_algebra::factors::{Factors, Rotations};
use kalfit_algebra::rows::Rows;

/// An entry below this fraction of the norm of its column counts as rounding.
pub(super) const RANK_TOLERANCE: f64 = 1e-10;

/// Σ of each level and the mean, at a point.
pub(super) struct LevelLaws<'a, T = f64> {
    pub(super) regressors: &'a Regressors,
    /// μ, the sum of the means of all levels.
    pub(super) mean: Vec<T>,
    coefficients: Vec<T>,
    /// F' of each level with Σ = FF', tests first.
    pub(super) roots: Vec<Rows<T>>,
    pub(super) sigmas: Vec<Rows<T>>,
    /// Factor on d of the designs.
    unit: T,
}

/// Matrices of a reduction with the effect of its level integrated out.
pub(super) struct Integrated<T> {
    /// U, upper triangular, with U'U = I + RΣR'.
    pub(super) upper: Rows<T>,
    /// B = U⁻ᵀR.
    pub(super) half: Rows<T>,
    /// W = B'B.
    pub(super) W: Rows<T>,
    /// log|I + RΣR'|.
    pub(super) log_det: T,
}

/// Upward result of a group: information of the group's tests on the mean of the enclosing group.
pub(super) struct Up<T> {
    pub(super) W: Rows<T>,
    /// s, p × columns: one column for each mean coordinate, if requested, then one for each column of the batch data.
    pub(super) s: Rows<T>,
    /// [R | d] of the members' joint information on the group's mean; d has the columns of s.
    said: Rows<T>,
    /// Squared residuals of each column from joining the direct members, without the residuals from within inner
    /// groups.
    left: Vec<T>,
    /// Sum of log|I + RΣR'| over the direct members.
    log_det: T,
}

/// Downward result of a test or a group.
pub(super) struct Down<T> {
    /// r, with the columns of [`Up::s`].
    pub(super) r: Rows<T>,
    /// W̄, p × p.
    pub(super) weight: Rows<T>,
}

/// Posterior of the mean of the members of a group.
pub(super) struct GroupMean<T> {
    /// Posterior mean minus prior mean, with the columns of [`Down::r`].
    pub(super) mean: Rows<T>,
    /// V, the posterior covariance, p × p.
    pub(super) covariance: Rows<T>,
}

/// Results of the upward and downward pass through some units at a point.
pub(super) struct PassResults<T> {
    /// Number of columns of d, s and r that precede the columns of the units: one for each mean coordinate if
    /// requested, else none.
    pub(super) before: usize,
    /// Number of units, one in each column.
    pub(super) columns: usize,
    /// Sum of log|I + RΣR'| over all tests and groups of one unit.
    pub(super) log_det: T,
    /// Squared residuals, summed over all units.
    pub(super) quadratic: T,
    /// Matrices of the tests of each leaf.
    pub(super) leaves: Vec<Integrated<T>>,
    /// Upward result of each group.
    pub(super) up: Vec<Up<T>>,
    /// Downward result of each group.
    pub(super) down: Vec<Down<T>>,
    /// Posterior of the mean of the members of each group.
    pub(super) means: Vec<GroupMean<T>>,
    /// s of each test.
    pub(super) said: Vec<Rows<T>>,
    /// Downward result of each test.
    pub(super) tests: Vec<Down<T>>,
    /// WV of each test, with V of the mean of the test's group.
    pub(super) known: Vec<Rows<T>>,
}

impl<'a, T: Lanes> LevelLaws<'a, T> {
    #[inline(always)]
    pub(super) fn new(units: &Units, point: &Point, regressors: &'a Regressors) -> LevelLaws<'a, T> {
        let (p, levels) = (units.states, units.levels());
        let mut at = LevelLaws {
            regressors,
            mean: Vec::with_capacity(p),
            coefficients: Vec::with_capacity(regressors.len()),
            roots: Vec::with_capacity(levels),
            sigmas: Vec::with_capacity(levels),
            unit: T::splat(units.unit),
        };
        for i in 0..p {
            let mut mean = 0.0;
            for l in 0..levels {
                mean += point.mean[l * p + i];
            }
            at.mean.push(T::splat(mean));
        }
        for c in 0..regressors.len() {
            at.coefficients.push(T::splat(point.coefficients[c]));
        }
        for l in 0..levels {
            let mut root = Rows::zeros(p, p);
            for i in 0..p {
                for k in 0..p {
                    root[(k, i)] = T::splat(point.root[(l * p + i, l * p + k)]);
                }
            }
            at.sigmas.push(root.transpose_times(&root));
            at.roots.push(root);
        }
        at
    }

    /// μ plus the effects of the regressions, for the tests of a leaf.
    #[inline(always)]
    pub(super) fn mean_of(&self, leaf: &Leaf<T>) -> Vec<T> {
        let mut mean = self.mean.clone();
        for (c, &element) in self.regressors.iter().enumerate() {
            mean[element] = leaf.covariates[c].fma(self.coefficients[c], mean[element]);
        }
        mean
    }

    /// Columns of one test: `before` columns with R times the effect of each mean coordinate on ξ, then d - Rμ in each
    /// unit.
    #[inline(always)]
    pub(super) fn data(&self, (leaf, data): (&Leaf<T>, &Rows<T>), before: usize) -> Rows<T> {
        let (p, mean) = (self.mean.len(), self.mean_of(leaf));
        let mut all = Rows::zeros(p, before + data.ncols());
        for i in 0..p {
            let factor = leaf.factor.row(i);
            let mut moved = T::splat(0.0);
            for k in i..p {
                moved = factor[k].fma(mean[k], moved);
            }
            let (first, rest) = all.row_mut(i).split_at_mut(before);
            for (c, x) in first.iter_mut().enumerate() {
                *x = match c.checked_sub(p) {
                    None => factor[c],
                    Some(c) => leaf.covariates[c] * factor[self.regressors[c]],
                };
            }
            for (to, &d) in rest.iter_mut().zip(data.row(i)) {
                *to = self.unit * d - moved;
            }
        }
        all
    }

    /// Passes up and down through some units, with the effects of the mean coordinates if `coordinates`.
    #[inline(always)]
    pub(super) fn results(&self, batch: &BatchData<'_, T>, coordinates: bool) -> PassResults<T> {
        let before = if coordinates { self.mean.len() + self.regressors.len() } else { 0 };
        let (groups, tests) = (batch.groups.len(), batch.tests.len());
        let mut results = PassResults {
            before,
            columns: batch.columns,
            log_det: T::splat(0.0),
            quadratic: T::splat(0.0),
            leaves: Vec::with_capacity(batch.leaves.len()),
            up: Vec::with_capacity(groups),
            down: Vec::with_capacity(groups),
            means: Vec::with_capacity(groups),
            said: Vec::with_capacity(tests),
            tests: Vec::with_capacity(tests),
            known: Vec::with_capacity(tests),
        };
        for leaf in &batch.leaves {
            results.leaves.push(Integrated::of(&leaf.factor, &self.roots[0]));
        }
        self.up(batch, &mut results);
        self.down(batch, &mut results);
        results
    }

    /// Upward pass, from the tests to the units.
    #[inline(always)]
    fn up(&self, batch: &BatchData<'_, T>, results: &mut PassResults<T>) {
        let p = self.mean.len();
        let width = p + results.before + batch.columns;
        let mut gathered = Vec::with_capacity(batch.groups.len());
        for _ in batch.groups {
            gathered.push(Gathered::none(p, width));
        }
        for (member, data) in batch.tests.iter().zip(&batch.data) {
            let solved = &results.leaves[member.leaf];
            let own = self.data((&batch.leaves[member.leaf], data), results.before);
            let left = Rows::solved_transposed(&solved.upper, own);
            results.said.push(solved.half.transpose_times(&left));
            gathered[member.group].take(solved, &left);
        }
        for (at, node) in batch.groups.iter().enumerate() {
            let own = std::mem::replace(&mut gathered[at], Gathered::none(0, 0));
            let solved = Integrated::of(&own.upper.first_columns(p), &self.roots[node.level]);
            let left = Rows::solved_transposed(&solved.upper, own.upper.last_columns(width - p));
            let s = solved.half.transpose_times(&left);
            results.log_det = results.log_det + own.log_det;
            results.quadratic = results.quadratic + sum_of(&own.left[results.before..]);
            if node.parent == at {
                results.log_det = results.log_det + solved.log_det;
                results.quadratic = results.quadratic + sum_of(&squares(&left)[results.before..]);
            } else {
                gathered[node.parent].take(&solved, &left);
            }
            results.up.push(Up { W: solved.W, s, said: own.upper, left: own.left, log_det: own.log_det });
        }
    }

    /// Downward pass, from the units to the tests.
    #[inline(always)]
    fn down(&self, batch: &BatchData<'_, T>, results: &mut PassResults<T>) {
        // the last group is the unit, so groups are visited from the last one on
        for (at, node) in batch.groups.iter().enumerate().rev() {
            let (up, last) = (&results.up[at], batch.groups.len() - 1);
            let above = if node.parent == at { None } else { Some(&results.means[last - node.parent]) };
            let own = Down::of((&up.W, up.s.clone()), above);
            let mean = GroupMean::of((&up.W, &own.r), &self.sigmas[node.level], above);
            results.means.push(mean);
            results.down.push(own);
        }
        results.means.reverse();
        results.down.reverse();
        for (member, s) in batch.tests.iter().zip(&results.said) {
            let (W, mean) = (&results.leaves[member.leaf].W, &results.means[member.group]);
            let known = W.times(&mean.covariance);
            let r = s.clone().less(&W.times(&mean.mean));
            results.tests.push(Down { r, weight: W.clone().less(&known.times(W)) });
            results.known.push(known);
        }
    }
}

impl LevelLaws<'_> {
    /// Effect of a mean coordinate on a state of the tests of a leaf: dξ_state / d(coordinate).
    pub(super) fn effect(&self, leaf: &Leaf, state: usize, coordinate: usize) -> f64 {
        match coordinate.checked_sub(self.mean.len()) {
            None => f64::from(u8::from(coordinate == state)),
            Some(c) if self.regressors[c] == state => leaf.covariates[c],
            Some(_) => 0.0,
        }
    }
}

impl PassResults<f64> {
    /// Sum of log|I + RΣR'| over all tests and inner groups of a group, without the group itself, and the squared
    /// residuals of each column from joining these tests and groups.
    pub(super) fn within(&self, batch: &BatchData<'_, f64>, group: usize) -> (f64, Vec<f64>) {
        let inner = (0..batch.groups.len()).filter(|&own| batch.is_within(own, group));
        let mut sum = (0.0, vec![0.0; self.before + self.columns]);
        for up in inner.map(|own| &self.up[own]) {
            sum.0 += up.log_det;
            sum.1.iter_mut().zip(&up.left).for_each(|(sum, x)| *sum += x);
        }
        sum
    }
}

impl Up<f64> {
    /// Squared residuals of each column and log|I + RΣR'| of the group without the rest of the unit; `root`: F' of the
    /// prior covariance FF' of the group's mean.
    pub(super) fn without_unit(&self, root: &Rows) -> (Vec<f64>, f64) {
        let p = self.said.nrows();
        let solved = Integrated::of(&self.said.first_columns(p), root);
        let left = Rows::solved_transposed(&solved.upper, self.said.last_columns(self.said.ncols() - p));
        (squares(&left), solved.log_det)
    }

    /// Rank of R. Rounding errors, which folding leaves where several tests inform one direction, do not count.
    pub(super) fn rank(&self) -> usize {
        let p = self.said.nrows();
        let size = |k: usize| (0..=k).map(|i| self.said[(i, k)].powi(2)).sum::<f64>().sqrt();
        let sizes: Vec<f64> = (0..p).map(size).collect();
        (0..p).filter(|&i| (i..p).any(|k| self.said[(i, k)].abs() > RANK_TOLERANCE * sizes[k])).count()
    }
}

/// Joint information of the members of a group.
struct Gathered<T> {
    /// [R | d], R upper triangular.
    upper: Rows<T>,
    /// Squared residuals of each column.
    left: Vec<T>,
    log_det: T,
}

impl<T: Lanes> Gathered<T> {
    #[inline(always)]
    fn none(p: usize, width: usize) -> Gathered<T> {
        let zero = T::splat(0.0);
        Gathered { upper: Rows::zeros(p, width), left: vec![zero; width - p], log_det: zero }
    }

    /// Folds in the information of a member.
    #[inline(always)]
    fn take(&mut self, solved: &Integrated<T>, data: &Rows<T>) {
        let p = self.upper.nrows();
        let rest = Rotations::absorb(&mut self.upper, solved.half.joined_columns(data), p);
        for i in 0..p {
            for (sum, &x) in self.left.iter_mut().zip(&rest.row(i)[p..]) {
                *sum = x.fma(x, *sum);
            }
        }
        self.log_det = self.log_det + solved.log_det;
    }
}

#[inline(always)]
fn sum_of<T: Lanes>(of: &[T]) -> T {
    let mut sum = T::splat(0.0);
    for &x in of {
        sum = sum + x;
    }
    sum
}

/// Sum of squares of each column.
#[inline(always)]
fn squares<T: Lanes>(left: &Rows<T>) -> Vec<T> {
    let mut sums = vec![T::splat(0.0); left.ncols()];
    for i in 0..left.nrows() {
        for (sum, &x) in sums.iter_mut().zip(left.row(i)) {
            *sum = x.fma(x, *sum);
        }
    }
    sums
}

impl<T: Lanes> Integrated<T> {
    /// Integrates out the effect of a level, from R and F'.
    #[inline(always)]
    pub(super) fn of(factor: &Rows<T>, root: &Rows<T>) -> Integrated<T> {
        let upper = Rotations::identity_plus(&root.times_transpose(factor));
        let log_det = T::apart(LogDet(&upper));
        let half = Rows::solved_transposed(&upper, factor.clone());
        Integrated { W: half.transpose_times(&half), half, upper, log_det }
    }
}

/// log|U'U| in each lane.
struct LogDet<'a, T>(&'a Rows<T>);

impl<T: Lanes> Part for LogDet<'_, T> {
    type Output = T;

    #[inline(always)]
    fn run(self) -> T {
        let mut sums = [0.0; MAX_LANES];
        for i in 0..self.0.nrows() {
            let mut diagonal = [1.0; MAX_LANES];
            self.0[(i, i)].store(&mut diagonal);
            for lane in 0..T::COUNT {
                sums[lane] += 2.0 * diagonal[lane].ln();
            }
        }
        T::load(&sums)
    }
}

impl<T: Lanes> Down<T> {
    #[inline(always)]
    fn of((W, s): (&Rows<T>, Rows<T>), above: Option<&GroupMean<T>>) -> Down<T> {
        match above {
            None => Down { r: s, weight: W.clone() },
            Some(above) => {
                Down { r: s.less(&W.times(&above.mean)), weight: W.clone().less(&W.times(&above.covariance).times(W)) }
            }
        }
    }
}

impl<T: Lanes> GroupMean<T> {
    #[inline(always)]
    pub(super) fn of((W, r): (&Rows<T>, &Rows<T>), sigma: &Rows<T>, above: Option<&GroupMean<T>>) -> GroupMean<T> {
        let (own, known) = (sigma.times(r), sigma.times(W));
        let left = sigma.clone().less(&known.times(sigma));
        match above {
            None => GroupMean { mean: own, covariance: left },
            Some(above) => {
                let rest = Rows::identity(known.nrows()).less(&known);
                let inherited = rest.times(&above.covariance).times_transpose(&rest);
                GroupMean { mean: own.plus(&above.mean), covariance: left.plus(&inherited) }
            }
        }
    }
}
