//! ℓ(μ, Σ) without a search: value and derivatives at any point, in the user's units.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::Combination;
use crate::classes::Classes;
use crate::lanes::flops_of_a_test;
use crate::order::Order;
use crate::pass;
use crate::point::Point;
use crate::sums::Sums;
use kalfit_algebra::symmetric;
use kalfit_algebra::symmetric::pairs;
use kalfit_filter::reduce::Reductions;

/// Which derivatives are computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Derivatives {
    /// The score: one pass, as in EM.
    First,
    /// The score and the observed information: one pass, as in Newton's method.
    Second,
}

/// The log-likelihood of an ensemble of reductions as a function of (μ, Σ).
#[derive(Debug, Clone)]
pub struct Likelihood {
    classes: Classes,
}

/// ℓ and its derivatives at a point, in the user's units.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// ℓ.
    pub log_likelihood: f64,
    /// ∂ℓ/∂μ (p), (4).
    pub mean_score: DVector<f64>,
    /// G = ∂ℓ/∂Σ (p × p), (5): ℓ changes by tr(G dΣ). Zero between phases.
    pub covariance_score: DMatrix<f64>,
    /// Σ_j W_j = -∂²ℓ/∂μ∂μ' (p × p).
    pub mean_information: DMatrix<f64>,
    /// -∂²ℓ/∂σ∂σ' over the elements (0,0), (1,0), (1,1), … of each phase; an off-diagonal element changes both entries
    /// of Σ.
    pub covariance_information: Option<DMatrix<f64>>,
    /// -∂²ℓ/∂μ∂σ' (p × elements).
    pub cross_information: Option<DMatrix<f64>>,
}

impl Likelihood {
    /// Gathers the reductions, all of dimension p and without regression.
    pub fn new(reductions: &Reductions, p: usize) -> Likelihood {
        Likelihood::of_phases(reductions, std::iter::once(0..p).collect(), Combination::Stacked)
    }

    /// Gathers reductions in phases, without regression; `ranges` holds the states of each phase. The likelihood is
    /// that of all phases together, computed phase by phase under [`Combination::Chain`] and from stacked reductions
    /// otherwise.
    pub fn of_phases(reductions: &Reductions, ranges: Vec<Range<usize>>, combination: Combination) -> Likelihood {
        Likelihood { classes: Classes::new(reductions, ranges, &[], combination == Combination::Chain) }
    }

    /// Number of classes of tests with one information matrix.
    pub fn classes(&self) -> usize {
        self.classes.len()
    }

    /// ℓ and its derivatives at μ and a positive semidefinite Σ: one pass over the classes.
    pub fn at(&self, mean: &[f64], covariance: &DMatrix<f64>, derivatives: Derivatives) -> Evaluation {
        let frame = &self.classes.frame;
        let point = Point {
            mean: frame.mean_in(mean),
            coefficients: Vec::new(),
            root: self.root(&frame.covariance_in(covariance)),
        };
        let order = match derivatives {
            Derivatives::First => Order::Mean,
            Derivatives::Second => Order::Second,
        };
        self.evaluation(pass::pass(&self.classes, &[], &point, order, None), order)
    }

    /// A root of Σ, phase by phase.
    fn root(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        let mut root = DMatrix::zeros(sigma.nrows(), sigma.ncols());
        for range in self.classes.elements.blocks() {
            let at = ((range.start, range.start), (range.len(), range.len()));
            root.view_mut(at.0, at.1).copy_from(&symmetric::square_root(&sigma.view(at.0, at.1).clone_owned()));
        }
        root
    }

    fn evaluation(&self, mut sums: Sums, order: Order) -> Evaluation {
        let scale = &self.classes.frame.scale;
        let p = scale.len();
        let places: Vec<f64> = sums.elements.all().map(|(i, j)| scale[i] * scale[j]).collect();
        let score = sums.score();
        let second = order == Order::Second;
        let in_user_units = |m: DMatrix<f64>, rows: &[f64], columns: &[f64]| {
            DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)] / (rows[i] * columns[j]))
        };
        Evaluation {
            log_likelihood: sums.value,
            mean_score: DVector::from_fn(p, |i, _| sums.mean_score[i] / scale[i]),
            covariance_score: in_user_units(score, scale, scale),
            mean_information: in_user_units(sums.mean_information.clone(), scale, scale),
            covariance_information: second.then(|| in_user_units(sums.observed_information(), &places, &places)),
            cross_information: second.then(|| in_user_units(sums.cross_information(), scale, &places)),
        }
    }
}

/// Floating-point operations of one pass for one test of dimension p: the operations of the kernel and of the sums of
/// first derivatives, as counted in a run, plus the operations that add the terms of the test to the sums of second
/// derivatives.
pub fn pass_flops(p: usize, derivatives: Derivatives) -> u64 {
    let flops = flops_of_a_test(p);
    let first = flops.add + flops.mul + 2 * flops.fma + flops.div;
    let (p, s) = (p as u64, pairs(p) as u64);
    let second = match derivatives {
        Derivatives::First => 0,
        Derivatives::Second => 3 * p * p + 2 * s * s + 3 * p * p * p,
    };
    first + second
}
