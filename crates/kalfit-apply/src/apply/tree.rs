//! Weights in sums of squared distances of tests and groups: the derivatives of the expectation of a sum with respect
//! to Σ of each level, and the increase of the expectation by errors of the means.
//!
//! ```text
//! node: likelihood N(y; Jm, J) of the mean m of the node's members; J of a test is J of the reduction,
//!     J of a group is the sum of W = (I + JΣ)⁻¹J over the members
//! distance of a node: D = y'My about the population, M = (J + JΣ₊J)⁺, Σ₊ the sum of Σ over the node's level
//!     and all outer levels: weight JMJ of each Σ in the sum
//! member c of a node: s_c = B_c y_c, B_c = I - W_cΣ_c: weight W_cMW_c of Σ_c at the member's level,
//!     and B_c'MB_c is M for the members of c
//! all distances of a unit, however they are split: weight Σ_c W_c - W_cV_uW_c, V_u the posterior covariance of m
//! ```

use nalgebra::DMatrix;
use rayon::prelude::*;

use kalfit_algebra::symmetric;
use kalfit_filter::reduce::{ReductionRef, Reductions};
use kalfit_model::Grouping;
use kalfit_model::Population;
use kalfit_model::unpack;

/// A test, or a group of tests.
pub(super) struct TreeNode {
    /// Information J, p × p.
    pub(super) information: DMatrix<f64>,
    /// W = (I + JΣ)⁻¹J with Σ of the node's level, p × p.
    weight: DMatrix<f64>,
    /// Derivatives of y with respect to the estimated means, p × means; for a test, J times the effect of the means.
    mean_slope: DMatrix<f64>,
}

/// Tests and groups as nodes: the tests first, then the groups of each level, the innermost level first.
pub(super) struct TestTree {
    /// Σ of each level, p × p; the level of the tests first.
    sigmas: Vec<DMatrix<f64>>,
    pub(super) nodes: Vec<Vec<TreeNode>>,
    /// For each level but the last, the index of each node's parent among the nodes of the next level.
    parents: Vec<Vec<usize>>,
}

/// Weights of Σ and of the means in one sum of squares.
#[derive(Clone)]
pub(super) struct Weights {
    /// Derivative with respect to Σ of each level, p × p.
    pub(super) of_level: Vec<DMatrix<f64>>,
    /// Weight of the estimated means, means × means: E[D] increases by tr(`of_means` · covariance of the means).
    pub(super) of_means: DMatrix<f64>,
}

/// Derivatives of a test's mean with respect to the estimated means, p × means.
pub(super) type Effect<'a> = dyn Fn(ReductionRef<'_>) -> DMatrix<f64> + Sync + 'a;

/// Standard deviation assumed for an exact measurement, as a fraction of the standard deviation over the population.
const EXACT_DEVIATION_RATIO: f64 = 1e-3;

/// R with an additional row for each exact measurement, (p + exact measurements) × p.
fn root_with_exact(reduction: ReductionRef<'_>, sigma: &DMatrix<f64>) -> DMatrix<f64> {
    let p = sigma.nrows();
    let root = unpack(reduction.factor, p);
    let Some(exact) = reduction.exact else { return root };
    let mut all = root.insert_rows(p, exact.values.len(), 0.0);
    for (i, row) in exact.matrix(p).row_iter().enumerate() {
        let deviation = (row * sigma * row.transpose())[(0, 0)].sqrt();
        if deviation > 0.0 {
            all.set_row(p + i, &(row / (EXACT_DEVIATION_RATIO * deviation)));
        }
    }
    all
}

impl TestTree {
    pub(super) fn new(
        (reductions, p): (&Reductions, usize),
        population: &Population,
        grouping: Option<&Grouping>,
        effect: &Effect<'_>,
    ) -> TestTree {
        let depth = grouping.map_or(0, Grouping::depth);
        let sigma = |level: usize| population.covariance.view((level * p, level * p), (p, p)).into_owned();
        let sigmas: Vec<DMatrix<f64>> = (0..=depth).map(sigma).collect();
        let test = |reduction: ReductionRef<'_>| {
            // the first block of Σ is of the tests; the blocks of the levels of groups follow
            let root = root_with_exact(reduction, &sigmas[0]);
            let information = root.transpose() * &root;
            let mean_slope = &information * effect(reduction);
            TreeNode { weight: weight(&root, &sigmas[0]), information, mean_slope }
        };
        let mut nodes: Vec<Vec<TreeNode>> = vec![reductions.par_iter().map(test).collect()];
        let mut parents = Vec::new();
        for level in 0..depth {
            let grouping = grouping.expect("there are levels");
            let groups = grouping.groups(level);
            let parent: Vec<usize> = match level {
                0 => (0..reductions.len())
                    .map(|test| {
                        let number = grouping.number(reductions.id(test)).expect("it was grouped");
                        grouping.group_of(number, 0)
                    })
                    .collect(),
                _ => grouping.groups(level - 1).iter().map(|group| group.parent.expect("it is inner")).collect(),
            };
            let means = nodes[level].first().map_or(0, |node| node.mean_slope.ncols());
            let zero = || (DMatrix::zeros(p, p), DMatrix::zeros(p, means));
            let mut sums: Vec<(DMatrix<f64>, DMatrix<f64>)> = groups.iter().map(|_| zero()).collect();
            for (node, &parent) in nodes[level].iter().zip(&parent) {
                sums[parent].0 += &node.weight;
                sums[parent].1 += &node.mean_slope - &node.weight * (&sigmas[level] * &node.mean_slope);
            }
            let group = |(information, mean_slope): (DMatrix<f64>, DMatrix<f64>)| {
                let root = symmetric::square_root(&information).transpose();
                TreeNode { weight: weight(&root, &sigmas[level + 1]), information, mean_slope }
            };
            nodes.push(sums.into_iter().map(group).collect());
            parents.push(parent);
        }
        TestTree { sigmas, nodes, parents }
    }

    pub(super) fn depth(&self) -> usize {
        self.sigmas.len() - 1
    }

    /// Σ₊, p × p: the sum of Σ over `level` and all outer levels.
    pub(super) fn outer_sigma(&self, level: usize) -> DMatrix<f64> {
        self.sigmas[level..].iter().sum()
    }

    fn zero_weights(&self) -> Weights {
        let (p, means) = (self.sigmas[0].nrows(), self.nodes[0].first().map_or(0, |node| node.mean_slope.ncols()));
        Weights { of_level: vec![DMatrix::zeros(p, p); self.sigmas.len()], of_means: DMatrix::zeros(means, means) }
    }

    /// Weights of Σ and the means in the distance of one test, given Σ₊ of level 0.
    pub(super) fn test(&self, number: usize, outer_sigma: &DMatrix<f64>) -> Weights {
        self.distance(&self.nodes[0][number], 0, outer_sigma).0
    }

    /// Weights in the distance of each group of a level from the population.
    pub(super) fn groups(&self, level: usize) -> Vec<Weights> {
        let outer_sigma = self.outer_sigma(level);
        let top: Vec<(Weights, DMatrix<f64>)> =
            self.nodes[level].par_iter().map(|node| self.distance(node, level, &outer_sigma)).collect();
        let (mut weights, mut inner): (Vec<Weights>, Vec<DMatrix<f64>>) = top.into_iter().unzip();
        // the node of `level` that each node of the level below is in (`above`), and M of that node's parent (`inner`)
        let mut above: Vec<usize> = (0..weights.len()).collect();
        for below in (0..level).rev() {
            let parents = &self.parents[below];
            let transformed: Vec<(DMatrix<f64>, DMatrix<f64>)> = self.nodes[below]
                .par_iter()
                .zip(parents)
                .map(|(node, &parent)| {
                    let m = &inner[parent];
                    let own = DMatrix::identity(m.nrows(), m.ncols()) - &node.weight * &self.sigmas[below];
                    (&node.weight * m * &node.weight, own.transpose() * m * own)
                })
                .collect();
            above = parents.iter().map(|&parent| above[parent]).collect();
            for ((own, _), &top) in transformed.iter().zip(&above) {
                weights[top].of_level[below] += own;
            }
            inner = transformed.into_iter().map(|(_, m)| m).collect();
        }
        weights
    }

    /// Weights in the distance of one node, nonzero for `level` and all outer levels; and M of the node, p × p.
    fn distance(&self, node: &TreeNode, level: usize, outer_sigma: &DMatrix<f64>) -> (Weights, DMatrix<f64>) {
        let j = &node.information;
        let m = scaled_inverse(&(j + j * outer_sigma * j));
        let own = j * &m * j;
        let mut weights = self.zero_weights();
        weights.of_level[level..].iter_mut().for_each(|of| of.clone_from(&own));
        weights.of_means = node.mean_slope.transpose() * &m * &node.mean_slope;
        (weights, m)
    }

    /// Weights in the sum of all distances: of the outermost groups from the population, and of tests within the
    /// outermost groups. Weights of the means are zero, because errors of the means increase the distances of the
    /// outermost groups only. `posteriors`: V, the posterior covariance of m, of each group of each level, the
    /// innermost level first.
    pub(super) fn all(&self, posteriors: &[Vec<&DMatrix<f64>>]) -> Weights {
        let mut all = self.zero_weights();
        for (level, nodes) in self.nodes.iter().enumerate() {
            for (at, node) in nodes.iter().enumerate() {
                all.of_level[level] += &node.weight;
                if level < self.depth() {
                    all.of_level[level] -= &node.weight * posteriors[level][self.parents[level][at]] * &node.weight;
                }
            }
        }
        all
    }

    /// For each node of a level, the difference of log |J⁻¹ + Σ₊|, the log determinant of the covariance in the
    /// distance, between the trees at a higher and at a lower value of a parameter. `self` is at the value between the
    /// two.
    pub(super) fn log_det_differences(&self, level: usize, [low, high]: [&TestTree; 2]) -> Vec<f64> {
        let outer_sigma = self.outer_sigma(level);
        let one = |at: usize| {
            let [low, high] = [low, high].map(|tree| &tree.nodes[level][at].information);
            log_det_plus_identity(high, &outer_sigma)
                - log_det_plus_identity(low, &outer_sigma)
                - self.log_det_information_change(level, at, low, high)
        };
        (0..self.nodes[level].len()).into_par_iter().map(one).collect()
    }

    /// Difference of the log determinant of the joint covariance of all tests' estimates between the trees at a higher
    /// and at a lower value of a parameter.
    pub(super) fn joint_log_det_difference(&self, [low, high]: [&TestTree; 2]) -> f64 {
        let mut sum = 0.0;
        for (level, sigma) in self.sigmas.iter().enumerate() {
            for (at, [low, high]) in (0..self.nodes[level].len()).map(|at| (at, [low, high])) {
                let [low, high] = [low, high].map(|tree| &tree.nodes[level][at].information);
                sum += log_det_plus_identity(high, sigma) - log_det_plus_identity(low, sigma);
                if level == 0 {
                    sum -= self.log_det_information_change(level, at, low, high);
                }
            }
        }
        sum
    }

    /// Difference of log |J| on the range of J, which no parameter changes, to first order: tr J⁺ΔJ.
    pub(super) fn log_det_information_change(
        &self,
        level: usize,
        at: usize,
        low: &DMatrix<f64>,
        high: &DMatrix<f64>,
    ) -> f64 {
        scaled_inverse(&self.nodes[level][at].information).dot(&(high - low))
    }
}

impl Weights {
    /// Weights in the sum of several sums of squares.
    ///
    /// # Panics
    /// If `all` is empty.
    pub(super) fn sum<'a>(mut all: impl Iterator<Item = &'a Weights>) -> Weights {
        let mut sum = all.next().expect("there are tests").clone();
        all.for_each(|one| sum.add(one, 1.0));
        sum
    }

    pub(super) fn add(&mut self, other: &Weights, sign: f64) {
        self.of_level.iter_mut().zip(&other.of_level).for_each(|(own, other)| *own += other * sign);
        self.of_means += &other.of_means * sign;
    }
}

/// W = R'(I + RΣR')⁻¹R for J = R'R.
fn weight(root: &DMatrix<f64>, sigma: &DMatrix<f64>) -> DMatrix<f64> {
    let inner = DMatrix::identity(root.nrows(), root.nrows()) + root * sigma * root.transpose();
    let half = inner.cholesky().map(|own| own.l()).and_then(|l| l.solve_lower_triangular(root));
    half.map_or_else(|| DMatrix::zeros(sigma.nrows(), sigma.nrows()), |half| half.transpose() * half)
}

/// Pseudo-inverse of a symmetric matrix, computed after scaling so that small entries lose no digits to large entries.
fn scaled_inverse(a: &DMatrix<f64>) -> DMatrix<f64> {
    let size = symmetric::sizes(a);
    let inverse: Vec<f64> = size.iter().map(|x| x.recip()).collect();
    let unit = symmetric::scaled(&inverse, |i, k| a[(i, k)]);
    let found = symmetric::pseudo_inverse(&unit);
    symmetric::scaled(&inverse, |i, k| found[(i, k)])
}

/// log |I + JΣ|.
fn log_det_plus_identity(information: &DMatrix<f64>, sigma: &DMatrix<f64>) -> f64 {
    let root = symmetric::square_root(sigma);
    let inner = DMatrix::identity(sigma.nrows(), sigma.nrows()) + root.transpose() * information * &root;
    inner.cholesky().map_or(0.0, |own| 2.0 * own.l().diagonal().iter().map(|x| x.ln()).sum::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::Label;
    use kalfit_model::Path;
    use kalfit_model::Reduction;

    /// Number of tests of each unit, lot by lot.
    const UNITS: [&[usize]; 2] = [&[2, 3], &[1, 2, 2]];
    const P: usize = 2;
    const LEVELS: usize = 3;

    /// R of a test, different from test to test.
    fn root(number: usize) -> DMatrix<f64> {
        let k = number as f64;
        DMatrix::from_row_slice(P, P, &[1.0 + 0.3 * (k % 3.0), 0.4 - 0.2 * (k % 4.0), 0.0, 0.7 + 0.1 * (k % 5.0)])
    }

    fn sigma(level: usize) -> DMatrix<f64> {
        DMatrix::from_row_slice(
            P,
            P,
            [[0.5, 0.1, 0.1, 0.8], [1.4, -0.3, -0.3, 0.6], [0.9, 0.2, 0.2, 0.4]][level].as_slice(),
        )
    }

    /// Reductions of tests of units of lots, and the grouping of the tests.
    fn ensemble() -> (Reductions, Grouping) {
        let (mut reductions, mut paths) = (Reductions::new(), Vec::new());
        for (lot, units) in UNITS.iter().enumerate() {
            for (unit, &tests) in units.iter().enumerate() {
                for test in 0..tests {
                    let (number, r) = (paths.len(), root(paths.len()));
                    let id = format!("{lot}/{unit}/{test}");
                    reductions.push(Reduction {
                        test: id.clone(),
                        constant: 0.0,
                        residual: None,
                        data: vec![0.0; P],
                        factor: vec![r[(0, 0)], r[(0, 1)], r[(1, 1)]],
                        covariates: vec![],
                        steps: 1,
                        observations: 2,
                        path: Path::Information,
                        design: number as u128,
                        chain: None,
                        exact: None,
                    });
                    paths.push((id, vec![Label::literal(lot), Label::literal(10 * lot + unit)]));
                }
            }
        }
        let grouping = Grouping::from_paths(2, paths.iter().map(|(id, path)| (id.as_str(), path.clone())));
        (reductions, grouping)
    }

    /// Covariance of the estimate of a unit's m from the unit's tests, without Σ of the units, by inverses.
    fn of_unit(tests: std::ops::Range<usize>, sigmas: &[DMatrix<f64>]) -> DMatrix<f64> {
        let inverse = |a: DMatrix<f64>| a.try_inverse().expect("positive");
        let one = |test: usize| inverse(inverse(root(test).transpose() * root(test)) + &sigmas[0]);
        inverse(tests.map(one).sum())
    }

    /// Sums over lots of two log determinants: of the covariance of the lot's estimate, and of the joint covariance of
    /// the lot's tests.
    fn log_dets(sigmas: &[DMatrix<f64>]) -> [f64; 2] {
        let inverse = |a: DMatrix<f64>| a.try_inverse().expect("positive");
        let (mut first, mut lots, mut all) = (0, 0.0, 0.0);
        for units in UNITS {
            let tests: usize = units.iter().sum();
            let unit_of: Vec<usize> = units.iter().enumerate().flat_map(|(unit, &of)| vec![unit; of]).collect();
            let mut whole = DMatrix::zeros(P * tests, P * tests);
            for a in 0..tests {
                for b in 0..tests {
                    let mut block = sigmas[2].clone();
                    if unit_of[a] == unit_of[b] {
                        block += &sigmas[1];
                    }
                    if a == b {
                        block += &sigmas[0] + inverse(root(first + a).transpose() * root(first + a));
                    }
                    whole.view_mut((P * a, P * b), (P, P)).copy_from(&block);
                }
            }
            all += whole.determinant().ln();
            let mut sum = DMatrix::zeros(P, P);
            for &own in units {
                sum += inverse(of_unit(first..first + own, sigmas) + &sigmas[1]);
                first += own;
            }
            lots += (inverse(sum) + &sigmas[2]).determinant().ln();
        }
        [lots, all]
    }

    #[test]
    fn weights_are_derivatives_of_dense_determinants() {
        let (reductions, grouping) = ensemble();
        let sigmas: Vec<DMatrix<f64>> = (0..LEVELS).map(sigma).collect();
        let mut covariance = DMatrix::zeros(P * LEVELS, P * LEVELS);
        for (level, own) in sigmas.iter().enumerate() {
            covariance.view_mut((P * level, P * level), (P, P)).copy_from(own);
        }
        let population = Population { mean: vec![0.0; P * LEVELS], coefficients: vec![], covariance };
        let tree = TestTree::new((&reductions, P), &population, Some(&grouping), &|_| DMatrix::zeros(P, 0));
        // V of a lot is (Σ⁻¹ + J)⁻¹; V of a unit is (Σ⁻¹ + J)⁻¹ plus a part by V of the lot
        let lots: Vec<DMatrix<f64>> =
            tree.nodes[2].iter().map(|node| posterior(&node.information, &sigmas[2])).collect();
        let of_unit = |(unit, node): (usize, &TreeNode)| {
            let lot = &lots[tree.parents[1][unit]];
            let own = posterior(&node.information, &sigmas[1]);
            let left = &own * sigmas[1].clone().try_inverse().expect("positive");
            &own + &left * lot * left.transpose()
        };
        let units: Vec<DMatrix<f64>> = tree.nodes[1].iter().enumerate().map(of_unit).collect();
        let all = tree.all(&[units.iter().collect(), lots.iter().collect()]);
        let of_lots = Weights::sum(tree.groups(2).iter());
        for level in 0..LEVELS {
            for (i, j) in [(0, 0), (1, 0), (1, 1)] {
                let side = |step: f64| {
                    let mut moved = sigmas.clone();
                    moved[level][(i, j)] += step;
                    if i != j {
                        moved[level][(j, i)] += step;
                    }
                    log_dets(&moved)
                };
                let (low, high) = (side(-1e-5), side(1e-5));
                let both = if i == j { 1.0 } else { 2.0 };
                for (what, weights, k) in [("lots", &of_lots, 0), ("all", &all, 1)] {
                    let (found, expected) = (both * weights.of_level[level][(i, j)], (high[k] - low[k]) / 2e-5);
                    let same = (found - expected).abs() < 1e-7 * (1.0 + expected.abs());
                    assert!(same, "{what} by {i}, {j} of level {level}: {found} against {expected}");
                }
            }
        }
    }

    /// Posterior covariance (Σ⁻¹ + J)⁻¹.
    fn posterior(information: &DMatrix<f64>, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        (sigma.clone().try_inverse().expect("positive") + information).try_inverse().expect("positive")
    }
}
