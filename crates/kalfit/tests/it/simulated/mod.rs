//! Random ensembles of reductions, and naive dense algebra to compare with.
#![allow(dead_code, reason = "each test crate uses its own part of it")]

pub(crate) mod structures;

use kalfit::estimate::{self, Criterion, Estimate, Settings, Silent, Solver, Structure};
use kalfit::model::{Alpha, CovarianceStructure, FixedElement, MeanStructure};
use kalfit::reduce::{Path, Reduction, ReductionRef, Reductions};
use kalfit_fixtures::dense::unpacked;
use nalgebra::{DMatrix, DVector};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// What a random ensemble is like.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Recipe {
    pub(crate) p: usize,
    pub(crate) tests: usize,
    /// Rank of the true Σ.
    pub(crate) rank: usize,
    /// Rows of R that are not zero, at most.
    pub(crate) observed: usize,
    /// Size of R: information per test is its square.
    pub(crate) strength: f64,
    /// Number of distinct designs.
    pub(crate) designs: usize,
    pub(crate) regressors: usize,
    /// The structures of [`structures`] are not far from the truth: means 1, 2, 3, …, variances of one.
    pub(crate) mild: bool,
}

pub(crate) fn normal(rng: &mut impl Rng) -> f64 {
    rng.sample(StandardNormal)
}

pub(crate) fn ensemble(recipe: Recipe, seed: u64) -> Reductions {
    let Recipe { p, tests, rank, observed, strength, designs, regressors, mild } = recipe;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mu = DVector::from_fn(p, |_, _| 3.0 * normal(&mut rng));
    let root = DMatrix::from_fn(p, rank, |_, _| normal(&mut rng));
    let (mu, root) = if mild { (DVector::from_fn(p, |i, _| 1.0 + i as f64), unit_variances(root)) } else { (mu, root) };
    let factors: Vec<DMatrix<f64>> = (0..designs)
        .map(|_| {
            let m = rng.random_range(1..=observed);
            let rows = DMatrix::from_fn(m.max(p), p, |i, _| if i < m { strength * normal(&mut rng) } else { 0.0 });
            rows.qr().r()
        })
        .collect();
    (0..tests)
        .map(|j| {
            let r = &factors[j % designs];
            let x: Vec<f64> = (0..regressors).map(|_| normal(&mut rng)).collect();
            let mut xi = &mu + &root * DVector::from_fn(rank, |_, _| normal(&mut rng));
            x.iter().enumerate().for_each(|(c, v)| xi[c] += 0.7 * v);
            let noise = DVector::from_fn(p, |i, _| if r.row(i).norm() > 0.0 { normal(&mut rng) } else { 0.0 });
            let d = r * xi + noise;
            let sign = |i: usize| if r[(i, i)] < 0.0 { -1.0 } else { 1.0 };
            Reduction {
                test: format!("t{j:05}"),
                constant: normal(&mut rng),
                residual: None,
                data: (0..p).map(|i| sign(i) * d[i]).collect(),
                factor: (0..p).flat_map(|k| (0..=k).map(move |i| (i, k))).map(|(i, k)| sign(i) * r[(i, k)]).collect(),
                covariates: x,
                steps: 1,
                observations: 1,
                path: if seed.is_multiple_of(3) { Path::SquareRoot } else { Path::Information },
                design: (j % designs) as u128,
                chain: None,
                exact: None,
            }
        })
        .collect()
}

/// The same tests, each of them changed.
pub(crate) fn changed(data: &Reductions, mut change: impl FnMut(usize, &mut Reduction)) -> Reductions {
    let one = |(j, test): (usize, ReductionRef<'_>)| {
        let mut test = Reduction::from(test);
        change(j, &mut test);
        test
    };
    data.iter().enumerate().map(one).collect()
}

/// Of full rank: correlations of 0.3. Otherwise: the rows scaled.
fn unit_variances(mut root: DMatrix<f64>) -> DMatrix<f64> {
    let (p, rank) = root.shape();
    if rank == p {
        let sigma = DMatrix::from_fn(p, p, |i, j| if i == j { 1.0 } else { 0.3 });
        return sigma.cholesky().expect("positive definite").unpack();
    }
    root.row_iter_mut().for_each(|mut row| {
        let norm = row.norm();
        row.unscale_mut(norm);
    });
    root
}

/// What is assumed, and what is maximised.
#[derive(Debug, Clone)]
pub(crate) struct Assumed {
    pub(crate) mean: MeanStructure,
    pub(crate) covariance: CovarianceStructure,
    pub(crate) criterion: Criterion,
}

impl Assumed {
    pub(crate) fn ml(mean: MeanStructure, covariance: CovarianceStructure) -> Assumed {
        Assumed { mean, covariance, criterion: Criterion::Ml }
    }

    pub(crate) fn reml(mean: MeanStructure, covariance: CovarianceStructure) -> Assumed {
        Assumed { mean, covariance, criterion: Criterion::Reml }
    }
}

pub(crate) fn fit(data: &Reductions, assumed: &Assumed, solver: Solver) -> Estimate {
    try_fit(data, assumed, solver).expect("a legal problem")
}

pub(crate) fn try_fit(data: &Reductions, assumed: &Assumed, solver: Solver) -> Result<Estimate, estimate::FitError> {
    let alpha = Alpha::default();
    let structure = Structure::single(&assumed.mean, &assumed.covariance, &alpha);
    let tolerance = if solver == Solver::Em { 1e-4 } else { 1e-8 };
    let settings = Settings { tolerance, criterion: assumed.criterion, ..Settings::of(solver) };
    estimate::fit(data, &structure, &settings, &mut Silent)
}

pub(crate) fn fixed(elements: &[(usize, usize, f64)]) -> CovarianceStructure {
    let fixed = elements.iter().map(|&(i, j, value)| FixedElement { i, j, value }).collect();
    CovarianceStructure { fixed, ..CovarianceStructure::full() }
}

/// The log-likelihoods of stacked plain matrices: no reductions, no classes, no roots.
pub(crate) struct Dense {
    /// ℓ at β.
    pub(crate) log_likelihood: f64,
    /// ℓ_R: ℓ at the β of generalised least squares, less ½ log|X'V⁻¹X|, plus ½ q log 2π.
    pub(crate) restricted: f64,
    /// β of generalised least squares.
    pub(crate) beta: DVector<f64>,
    /// (X'V⁻¹X)⁻¹.
    pub(crate) covariance: DMatrix<f64>,
}

/// At Σ, with β (of the structure's basis, then the regression coefficients) where ℓ is wanted.
pub(crate) fn dense(data: &Reductions, mean: &MeanStructure, beta: &DVector<f64>, sigma: &DMatrix<f64>) -> Dense {
    let p = sigma.nrows();
    let (m0, b) = mean.basis();
    let m0 = DVector::from_vec(m0);
    let q = b.ncols() + mean.regression.len();
    let (mut information, mut score) = (DMatrix::zeros(q, q), DVector::zeros(q));
    let mut parts = Vec::new();
    for reduction in data {
        let r = unpacked(reduction.factor, p);
        let mut x = DMatrix::zeros(p, q);
        x.view_mut((0, 0), b.shape()).copy_from(&b);
        for (c, regression) in mean.regression.iter().enumerate() {
            x[(regression.element, b.ncols() + c)] = reduction.covariates[c];
        }
        let x = &r * x;
        let s =
            (DMatrix::identity(p, p) + &r * sigma * r.transpose()).cholesky().expect("I + RΣR' is positive definite");
        let e = DVector::from_column_slice(reduction.data) - &r * &m0;
        information += x.transpose() * s.solve(&x);
        score += x.transpose() * s.solve(&e);
        parts.push((reduction.constant - s.l().diagonal().map(f64::ln).sum(), x, e, s));
    }
    let at = |beta: &DVector<f64>| {
        let of = |(constant, x, e, s): &(f64, DMatrix<f64>, DVector<f64>, nalgebra::Cholesky<f64, nalgebra::Dyn>)| {
            let left = e - x * beta;
            constant - 0.5 * left.dot(&s.solve(&left))
        };
        parts.iter().map(of).sum::<f64>()
    };
    let log_likelihood = at(beta);
    let Some(factor) = information.cholesky() else {
        let nothing = (DVector::zeros(q), DMatrix::zeros(q, q));
        return Dense { log_likelihood, restricted: f64::NAN, beta: nothing.0, covariance: nothing.1 };
    };
    let best = factor.solve(&score);
    let log_det = 2.0 * factor.l().diagonal().map(f64::ln).sum();
    let restricted = at(&best) - 0.5 * log_det + 0.5 * q as f64 * std::f64::consts::TAU.ln();
    Dense { log_likelihood, restricted, beta: best, covariance: factor.inverse() }
}

/// β of an estimate: the means that are free, then the regression coefficients.
pub(crate) fn beta(estimate: &Estimate, mean: &MeanStructure) -> DVector<f64> {
    let (m0, b) = mean.basis();
    let free = DVector::from_column_slice(&estimate.mean) - DVector::from_vec(m0);
    let own = (b.transpose() * &b).cholesky().expect("independent columns").solve(&(b.transpose() * free));
    DVector::from_iterator(own.len() + estimate.coefficients.len(), own.iter().chain(&estimate.coefficients).copied())
}

/// The simplex method of Nelder and Mead, restarted: slow, crude, and without a derivative.
pub(crate) fn simplex(start: &[f64], f: &dyn Fn(&[f64]) -> f64) -> (Vec<f64>, f64) {
    let n = start.len();
    let mut best = (start.to_vec(), f(start));
    for restart in 0..4 {
        let size = 0.5 / 4.0_f64.powi(restart);
        let corner = |k: usize| {
            let mut x = best.0.clone();
            if k > 0 {
                x[k - 1] += size;
            }
            (x.clone(), f(&x))
        };
        let mut corners: Vec<(Vec<f64>, f64)> = (0..=n).map(corner).collect();
        for _ in 0..100 * n {
            corners.sort_by(|a, b| b.1.total_cmp(&a.1));
            let worst = corners[n].clone();
            let centre: Vec<f64> =
                (0..n).map(|i| corners[..n].iter().map(|c| c.0[i]).sum::<f64>() / n as f64).collect();
            let at = |t: f64| {
                let x: Vec<f64> = (0..n).map(|i| centre[i] + t * (worst.0[i] - centre[i])).collect();
                (x.clone(), f(&x))
            };
            let mirrored = at(-1.0);
            corners[n] = if mirrored.1 > corners[0].1 {
                let further = at(-2.0);
                if further.1 > mirrored.1 { further } else { mirrored }
            } else if mirrored.1 > corners[n - 1].1 {
                mirrored
            } else {
                let nearer = if mirrored.1 > worst.1 { at(-0.5) } else { at(0.5) };
                if nearer.1 > worst.1.max(mirrored.1) {
                    nearer
                } else {
                    let top = corners[0].0.clone();
                    for c in &mut corners[1..] {
                        let x: Vec<f64> = c.0.iter().zip(&top).map(|(x, t)| t + 0.5 * (x - t)).collect();
                        *c = (x.clone(), f(&x));
                    }
                    continue;
                }
            };
        }
        corners.sort_by(|a, b| b.1.total_cmp(&a.1));
        best = corners[0].clone();
    }
    best
}
