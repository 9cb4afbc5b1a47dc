//! Tests in several phases, made by hand: chains with random matrices, and the same stacked by an independent formula, the joint
//! covariance of all their data. Then what the estimator makes of the one and of the other.

mod fits;
mod marginal;
mod passes;
mod single;

use std::ops::Range;

use kalfit::reduce::{Chain, ChainPhase, Link, Path, Reduction, Reductions};
use kalfit_fixtures::dense::{Linear, unpacked};
use nalgebra::{DMatrix, DVector};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::simulated::normal;

/// What a random ensemble of chains is like.
#[derive(Debug, Clone)]
pub(crate) struct Recipe {
    pub(crate) tests: usize,
    /// p_i.
    pub(crate) own: Vec<usize>,
    /// States of phase i that only inherit; the first phase has none.
    pub(crate) heirs: Vec<usize>,
    /// Rows of R_i that are not zero, at most.
    pub(crate) observed: usize,
    /// Size of R.
    pub(crate) strength: f64,
    /// Columns of the noise between phases.
    pub(crate) noise: usize,
    /// Number of distinct designs.
    pub(crate) designs: usize,
    /// Every third test lacks the last phases.
    pub(crate) missing: bool,
    pub(crate) regressors: usize,
    /// A root of the Σ that tests are drawn from, of all phases.
    pub(crate) root: DMatrix<f64>,
    pub(crate) path: Path,
}

impl Recipe {
    /// Two phases of two and three states.
    pub(crate) fn two() -> Recipe {
        Recipe {
            tests: 30,
            own: vec![2, 3],
            heirs: vec![0, 1],
            observed: 5,
            strength: 2.0,
            noise: 2,
            designs: 30,
            missing: false,
            regressors: 0,
            root: DMatrix::identity(5, 5),
            path: Path::Information,
        }
    }

    pub(crate) fn ranges(&self) -> Vec<Range<usize>> {
        let mut end = 0;
        let range = |p: &usize| {
            let start = end;
            end += p;
            start..end
        };
        self.own.iter().map(range).collect()
    }

    pub(crate) fn states(&self) -> usize {
        self.own.iter().sum()
    }
}

/// The matrices of a test.
struct Design {
    factors: Vec<DMatrix<f64>>,
    links: Vec<(DMatrix<f64>, DMatrix<f64>)>,
}

fn design(recipe: &Recipe, rng: &mut impl Rng) -> Design {
    let sizes: Vec<usize> = recipe.own.iter().zip(&recipe.heirs).map(|(p, h)| p + h).collect();
    let factor = |&q: &usize, rng: &mut dyn FnMut() -> f64, m: usize| {
        let rows = DMatrix::from_fn(m.max(q), q, |i, _| if i < m { recipe.strength * rng() } else { 0.0 });
        let mut upper = rows.qr().r();
        for i in 0..q {
            (0..i).for_each(|k| upper[(i, k)] = 0.0);
            if upper[(i, i)] < 0.0 {
                upper.row_mut(i).neg_mut();
            }
        }
        upper
    };
    let factors = sizes
        .iter()
        .map(|q| {
            let m = rng.random_range(1..=recipe.observed);
            factor(q, &mut || normal(&mut *rng), m)
        })
        .collect();
    let links = sizes.windows(2).map(|pair| {
        let sensitivity = DMatrix::from_fn(pair[1], pair[0], |_, _| 0.7 * normal(&mut *rng));
        let root = DMatrix::from_fn(pair[1], recipe.noise, |_, _| 0.4 * normal(&mut *rng));
        (sensitivity, root)
    });
    let links = links.collect();
    Design { factors, links }
}

/// Reductions with chains, and stacked.
pub(crate) fn ensemble(recipe: &Recipe, seed: u64) -> Reductions {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let designs: Vec<Design> = (0..recipe.designs).map(|_| design(recipe, &mut rng)).collect();
    let p = recipe.states();
    let mu = DVector::from_fn(p, |i, _| 1.0 + i as f64);
    (0..recipe.tests)
        .map(|j| {
            let covariates: Vec<f64> = (0..recipe.regressors).map(|_| normal(&mut rng)).collect();
            let mut xi = &mu + &recipe.root * DVector::from_fn(recipe.root.ncols(), |_, _| normal(&mut rng));
            covariates.iter().enumerate().for_each(|(c, x)| xi[c] += 0.7 * x);
            let phases =
                if recipe.missing && j % 3 == 1 { 1 + j % (recipe.own.len() - 1).max(1) } else { recipe.own.len() };
            let chain = test(recipe, &designs[j % recipe.designs], &xi, phases, &mut rng);
            let stacked = stacked(&chain, &recipe.own);
            Reduction { test: format!("t{j:04}"), covariates, chain: Some(Box::new(chain)), ..stacked }
        })
        .collect()
}

fn test(recipe: &Recipe, design: &Design, xi: &DVector<f64>, phases: usize, rng: &mut impl Rng) -> Chain {
    let mut sigma = DVector::zeros(0);
    let mut all = Vec::new();
    for i in 0..phases {
        let factor = &design.factors[i];
        let (q, own) = (factor.nrows(), recipe.own[i]);
        let start: usize = recipe.own[..i].iter().sum();
        let mut next = DVector::from_fn(q, |k, _| if k < own { xi[start + k] } else { 0.0 });
        let link = (i > 0).then(|| {
            let (sensitivity, root) = design.links[i - 1].clone();
            Link { mean: DVector::from_fn(q, |_, _| 2.0 * normal(rng)), sensitivity, root }
        });
        if let Some(link) = &link {
            let noise = DVector::from_fn(link.root.ncols(), |_, _| normal(rng));
            next += &link.mean + &link.sensitivity * &sigma + &link.root * noise;
        }
        sigma = next;
        let noise = DVector::from_fn(q, |k, _| if factor.row(k).norm() > 0.0 { normal(rng) } else { 0.0 });
        let data = factor * &sigma + noise;
        all.push(ChainPhase {
            own,
            constant: normal(rng),
            data: data.as_slice().to_vec(),
            factor: packed(factor),
            path: recipe.path,
            link,
        });
    }
    Chain { phases: all }
}

fn packed(factor: &DMatrix<f64>) -> Vec<f64> {
    let q = factor.nrows();
    (0..q).flat_map(|k| (0..=k).map(move |i| (i, k))).map(|at| factor[at]).collect()
}

/// All data of a test in a row: d = m + H ξ + e, e ~ N(0, V), V = I + R (noise between phases) R'.
pub(crate) struct Joint {
    /// H has P columns; those of missing phases are zero.
    pub(crate) law: Linear,
    pub(crate) constant: f64,
}

impl Joint {
    pub(crate) fn of(chain: &Chain, own: &[usize]) -> Joint {
        let p: usize = own.iter().sum();
        let total: usize = chain.phases.iter().map(|phase| phase.data.len()).sum();
        let widths = chain.phases.iter().map(|phase| phase.link.as_ref().map_or(0, |link| link.root.ncols()));
        let noises: usize = widths.sum();
        let mut law = Linear {
            residual: DVector::zeros(total),
            sensitivity: DMatrix::zeros(total, p),
            covariance: DMatrix::identity(total, total),
        };
        // σ_i = h + H ξ + N × white noise
        let (mut h, mut big, mut n) = (DVector::zeros(0), DMatrix::zeros(0, p), DMatrix::zeros(0, noises));
        let mut noise = DMatrix::zeros(total, noises);
        let (mut row, mut state, mut column) = (0, 0, 0);
        for phase in &chain.phases {
            let q = phase.data.len();
            let (mut h_next, mut big_next, mut n_next) =
                (DVector::zeros(q), DMatrix::zeros(q, p), DMatrix::zeros(q, noises));
            if let Some(link) = &phase.link {
                h_next = &link.mean + &link.sensitivity * &h;
                big_next = &link.sensitivity * &big;
                n_next = &link.sensitivity * &n;
                let width = link.root.ncols();
                let mut own = n_next.view_mut((0, column), (q, width));
                own += &link.root;
                column += width;
            }
            (0..phase.own).for_each(|i| big_next[(i, state + i)] += 1.0);
            state += phase.own;
            let r = unpacked(&phase.factor, q);
            law.residual.rows_mut(row, q).copy_from(&(DVector::from_column_slice(&phase.data) - &r * &h_next));
            law.sensitivity.view_mut((row, 0), (q, p)).copy_from(&(&r * &big_next));
            noise.view_mut((row, 0), (q, noises)).copy_from(&(&r * &n_next));
            row += q;
            (h, big, n) = (h_next, big_next, n_next);
        }
        law.covariance += &noise * noise.transpose();
        Joint { law, constant: chain.phases.iter().map(|phase| phase.constant).sum() }
    }

    /// What rounding does to [`Joint::log_density`], by and large: the covariance is formed, and the noise in it is one.
    pub(crate) fn rounding(&self, sigma: &DMatrix<f64>) -> f64 {
        1e-15 * self.law.total(sigma).amax()
    }

    /// log p at μ and Σ; what `constant` holds of 2π is all there is.
    pub(crate) fn log_density(&self, mean: &DVector<f64>, sigma: &DMatrix<f64>) -> f64 {
        let half = 0.5 * self.law.residual.len() as f64 * std::f64::consts::TAU.ln();
        self.constant + half + self.law.log_density(mean, sigma)
    }
}

/// The reduction of ξ of all phases together.
pub(crate) fn stacked(chain: &Chain, own: &[usize]) -> Reduction {
    let Joint { law, constant } = Joint::of(chain, own);
    let (total, p) = law.sensitivity.shape();
    let factor = law.covariance.clone().cholesky().expect("a covariance of data").l();
    let log_det = 2.0 * factor.diagonal().map(f64::ln).sum();
    let mut rows = DMatrix::zeros((total).max(p + 1), p + 1);
    rows.view_mut((0, 0), (total, p)).copy_from(&law.sensitivity);
    rows.view_mut((0, p), (total, 1)).copy_from(&law.residual);
    let top = factor.solve_lower_triangular(&rows.rows(0, total).clone_owned()).expect("regular");
    rows.rows_mut(0, total).copy_from(&top);
    let mut upper = rows.qr().r();
    let unseen: Vec<bool> = (0..p).map(|k| law.sensitivity.column(k).amax() == 0.0).collect();
    for i in 0..=p {
        if upper[(i, i)] < 0.0 {
            upper.row_mut(i).neg_mut();
        }
    }
    for i in 0..p {
        (0..p).filter(|&k| unseen[k]).for_each(|k| upper[(i, k)] = 0.0);
        if (i..p).all(|k| upper[(i, k)] == 0.0) {
            upper[(p, p)] = upper[(p, p)].hypot(upper[(i, p)]); // it says nothing of ξ
            upper[(i, p)] = 0.0;
        }
    }
    Reduction {
        test: String::new(),
        constant: constant - 0.5 * (log_det + upper[(p, p)].powi(2)),
        residual: None,
        data: (0..p).map(|i| upper[(i, p)]).collect(),
        factor: (0..p).flat_map(|k| (0..=k).map(move |i| (i, k))).map(|at| upper[at]).collect(),
        covariates: Vec::new(),
        steps: 1,
        observations: 1,
        path: Path::Information,
        design: 0,
        chain: None,
        exact: None,
    }
}
