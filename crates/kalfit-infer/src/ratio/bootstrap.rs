//! The parametric bootstrap of a likelihood ratio: ensembles drawn from the hypothesis, both models fitted to each.
//!
//! The information of a test about ξ is d = Rξ + e, e ~ N(0, I) on the rows of R that are not zero. So new ensembles
//! are drawn exactly as reductions, without any filter. The constants of the reductions do not change the ratio.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::ratio::nested::regressions;
use kalfit_algebra::symmetric;
use kalfit_estimate::{Estimate, FinalState, Silent, Stop, fit, fit_from};
use kalfit_filter::reduce::{ReductionRef, Reductions};
use kalfit_model::Population;
use kalfit_model::unpack;

/// Number of ensembles to draw, and the seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bootstrap {
    /// Number of ensembles.
    pub replicates: usize,
    /// Seed of ChaCha8; replicate b draws from stream b, for any number of threads.
    pub seed: u64,
}

/// Result of the bootstrap.
#[derive(Debug, Clone, PartialEq)]
pub struct BootstrapResult {
    /// Statistics of the replicates whose two fits were certified, in the order of the replicates.
    pub statistics: Vec<f64>,
    /// Number of replicates with a fit that was not certified.
    pub failed: usize,
    /// (1 + replicates at or above the statistic) / (1 + replicates).
    pub p_value: f64,
    /// Standard error of the p-value, which comes from a sample of replicates.
    pub std_error: f64,
}

/// Draws ensembles from the hypothesis, and computes the likelihood-ratio statistic of each ensemble. `statistic` is
/// the statistic of the data; `reductions` are the reductions of the alternative's fit.
pub fn bootstrap(
    null: &Estimate,
    alternative: &Estimate,
    reductions: &Reductions,
    statistic: f64,
    bootstrap: Bootstrap,
) -> BootstrapResult {
    bootstrap_while(null, alternative, reductions, (statistic, bootstrap), &mut |_| true).expect("nobody stops it")
}

/// Function that is called every few replicates with the number of finished replicates, and returns whether to go on.
pub type GoesOn<'a> = &'a mut dyn FnMut(usize) -> bool;

/// Result of the bootstrap as from [`bootstrap`], but `None` as soon as `goes_on` returns false.
pub fn bootstrap_while(
    null: &Estimate,
    alternative: &Estimate,
    reductions: &Reductions,
    (statistic, bootstrap): (f64, Bootstrap),
    goes_on: GoesOn<'_>,
) -> Option<BootstrapResult> {
    let regression_indices =
        regressions(&null.state.structure(), &alternative.state.structure()).expect("nesting was checked");
    let draw = Draw::new(null, reductions, &regression_indices);
    let compute_replicate = |b: usize| {
        let mut random = ChaCha8Rng::seed_from_u64(bootstrap.seed);
        random.set_stream(b as u64);
        ratio(null, alternative, &draw.ensemble(&mut random), &regression_indices)
    };
    let found = replicates(bootstrap.replicates, compute_replicate, goes_on)?;
    Some(BootstrapResult::of(&found, statistic))
}

/// Computes replicates in parallel, in chunks. Replicate b depends only on b, so the results do not depend on the size
/// of the chunks.
pub(crate) fn replicates<T: Send>(
    count: usize,
    compute_replicate: impl Fn(usize) -> T + Sync + Send,
    goes_on: GoesOn<'_>,
) -> Option<Vec<T>> {
    let chunk = 8 * rayon::current_num_threads();
    let mut found = Vec::new();
    while found.len() < count {
        if !goes_on(found.len()) {
            return None;
        }
        let next = found.len()..count.min(found.len() + chunk);
        found.par_extend(next.into_par_iter().map(&compute_replicate));
    }
    Some(found)
}

impl BootstrapResult {
    /// Compares the statistics of replicates, `None` where a fit failed, with the statistic of the data.
    pub(crate) fn of(found: &[Option<f64>], statistic: f64) -> BootstrapResult {
        let statistics: Vec<f64> = found.iter().copied().flatten().collect();
        // replicates within rounding of the statistic count as equal to it: ties are common where both are zero
        let reached = statistics.iter().filter(|s| **s >= statistic - 1e-9 * statistic.max(1.0)).count();
        let n = statistics.len() as f64;
        let p_value = (1.0 + reached as f64) / (1.0 + n);
        let std_error = (p_value * (1.0 - p_value) / (1.0 + n)).sqrt();
        BootstrapResult { failed: found.len() - statistics.len(), statistics, p_value, std_error }
    }
}

/// The statistic of one ensemble; `None` when a fit is not certified.
fn ratio(
    null: &Estimate,
    alternative: &Estimate,
    reductions: &Reductions,
    regression_indices: &[usize],
) -> Option<f64> {
    let truth = Population::from(null);
    let narrow = certified(&null.state, &select_covariates(reductions, regression_indices), &truth)?;
    let as_model_values = |state: &Estimate| as_model_values(state, regression_indices, alternative.coefficients.len());
    let wide = certified(&alternative.state, reductions, &as_model_values(null))?;
    let found = 2.0 * (wide.log_likelihood - narrow.log_likelihood);
    if found >= -1e-7 {
        return Some(found.max(0.0));
    }
    let wide = certified(&alternative.state, reductions, &as_model_values(&narrow))?;
    let found = 2.0 * (wide.log_likelihood - narrow.log_likelihood);
    (found >= -1e-7).then(|| found.max(0.0))
}

/// The estimate of the hypothesis as values of the model; regressions that the hypothesis does not have get
/// coefficients of zero.
pub(super) fn as_model_values(null: &Estimate, regression_indices: &[usize], coefficients: usize) -> Population {
    let mut all = vec![0.0; coefficients];
    regression_indices.iter().zip(&null.coefficients).for_each(|(&at, value)| all[at] = *value);
    Population { coefficients: all, ..Population::from(null) }
}

/// The reductions with only the covariates at `regression_indices`.
pub(super) fn select_covariates(reductions: &Reductions, regression_indices: &[usize]) -> Reductions {
    reductions.clone().with_covariates(regression_indices)
}

/// A certified fit from the true values or, when that fails, from a start computed from the data.
pub(super) fn certified(state: &FinalState, reductions: &Reductions, start: &Population) -> Option<Estimate> {
    let (structure, settings) = (state.structure(), &state.settings);
    let from_truth = fit_from(reductions, &structure, start, settings, &mut Silent).ok();
    from_truth
        .filter(|e| e.stop == Stop::Certified)
        .or_else(|| fit(reductions, &structure, settings, &mut Silent).ok().filter(|e| e.stop == Stop::Certified))
}

/// Draws new data for the tests of `reductions`.
pub(super) struct Draw<'a> {
    reductions: &'a Reductions,
    /// Indices of the tests in the order of the tests' ids, so that draws do not depend on the order of the tests.
    order: Vec<usize>,
    null: &'a Estimate,
    /// Index of each regression of the hypothesis among the covariates of the reductions.
    regression_indices: &'a [usize],
    /// F with Σ = FF' of the per-test effects, then of each level of groups from the innermost on.
    roots: Vec<DMatrix<f64>>,
}

impl<'a> Draw<'a> {
    pub(super) fn new(null: &'a Estimate, reductions: &'a Reductions, regression_indices: &'a [usize]) -> Draw<'a> {
        let mut order: Vec<usize> = (0..reductions.len()).collect();
        order.sort_by(|&a, &b| reductions.get(a).test.cmp(reductions.get(b).test));
        let levels = null.grouping().map_or(1, |grouping| grouping.depth() + 1);
        let p = null.covariance.nrows() / levels;
        let root = |l: usize| symmetric::square_root(&null.covariance.view((l * p, l * p), (p, p)).into_owned());
        Draw { reductions, order, null, regression_indices, roots: (0..levels).map(root).collect() }
    }

    /// New data for every test.
    pub(super) fn ensemble(&self, random: &mut ChaCha8Rng) -> Reductions {
        let mut drawn = self.reductions.select(&self.order);
        let mut groups: BTreeMap<(usize, usize), DVector<f64>> = BTreeMap::new();
        for number in 0..drawn.len() {
            let group_effects = self.group_effects(drawn.id(number), &mut groups, random);
            let template = drawn.get(number);
            let xi = self.xi(template, group_effects, random);
            let data = self.data(template, &xi, random);
            let test = drawn.get_mut(number);
            (*test.constant, *test.residual) = (0.0, None);
            test.data.copy_from_slice(data.as_slice());
            if let Some(exact) = test.exact {
                exact.values = (exact.matrix(xi.len()) * xi).as_slice().to_vec();
            }
        }
        drawn
    }

    /// Sum of the effects of a test's groups; effects of groups that are not in `groups` yet are drawn.
    fn group_effects(
        &self,
        test: &str,
        groups: &mut BTreeMap<(usize, usize), DVector<f64>>,
        random: &mut ChaCha8Rng,
    ) -> DVector<f64> {
        let mut sum = DVector::zeros(self.roots[0].nrows());
        let Some((grouping, number)) = self.null.grouping().and_then(|all| Some((all, all.number(test)?))) else {
            return sum;
        };
        for (level, root) in self.roots[1..].iter().enumerate() {
            for member in grouping.members(number, level) {
                let own = groups.entry((level, member.group));
                let effects = &*own.or_insert_with(|| root * normal(root.ncols(), random));
                member.add_effects(effects.as_slice(), sum.as_mut_slice());
            }
        }
        sum
    }

    /// Draws ξ of a test; `group_effects` is the sum of the effects of the test's groups.
    fn xi(&self, template: ReductionRef<'_>, group_effects: DVector<f64>, random: &mut ChaCha8Rng) -> DVector<f64> {
        let (p, root) = (self.roots[0].nrows(), &self.roots[0]);
        let mut xi =
            DVector::from_column_slice(&self.null.mean[..p]) + group_effects + root * normal(root.ncols(), random);
        for (c, &element) in self.null.state.problem.mean.regressors.iter().enumerate() {
            xi[element] += template.covariates[self.regression_indices[c]] * self.null.coefficients[c];
        }
        xi
    }

    /// Draws d of a test, given ξ.
    fn data(&self, template: ReductionRef<'_>, xi: &DVector<f64>, random: &mut ChaCha8Rng) -> DVector<f64> {
        let p = xi.len();
        let factor = unpack(template.factor, p);
        let noise = normal(p, random);
        let informed = |i: usize| (i..p).any(|k| factor[(i, k)] != 0.0);
        &factor * xi + DVector::from_fn(p, |i, _| if informed(i) { noise[i] } else { 0.0 })
    }
}

fn normal(n: usize, random: &mut ChaCha8Rng) -> DVector<f64> {
    DVector::from_fn(n, |_, _| StandardNormal.sample(random))
}
