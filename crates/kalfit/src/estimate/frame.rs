//! The coordinates that estimation works in, from all tests together.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::linalg::elements::Elements;
use crate::linalg::symmetric::{self, pair, pairs};
use crate::reduce::Reduction;

/// Tests that are added up by themselves.
const CHUNK: usize = 1024;

/// The coordinates η: ξ = centre + scale ∘ η.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Frame {
    pub(crate) centre: Vec<f64>,
    pub(crate) scale: Vec<f64>,
    /// Scale of each covariate.
    pub(crate) covariate_scale: Vec<f64>,
}

impl Frame {
    /// Centre: pooled least squares. Scale: the average informed test has unit information on each state. `order` is one that does
    /// not depend on that of the reductions.
    pub(super) fn of(reductions: &[Reduction], order: &[usize], elements: &Elements, regressors: usize) -> Frame {
        let p = elements.states();
        let parts: Vec<Pooled> =
            order.par_chunks(CHUNK).map(|part| Pooled::of(reductions, part, (p, regressors))).collect();
        let Pooled { information, informed, y, squares } =
            parts.iter().fold(Pooled::none((p, regressors)), |sum, part| sum.and(part));
        let entry = |i: usize, k: usize| information[pair(i.max(k), i.min(k))];
        let unit = |i: usize| if entry(i, i) > 0.0 { (informed[i] / entry(i, i)).sqrt() } else { 1.0 };
        let scale: Vec<f64> = (0..p).map(unit).collect();
        let scaled = DMatrix::from_fn(p, p, |i, k| scale[i] * entry(i, k) * scale[k]);
        let right = DVector::from_fn(p, |i, _| scale[i] * y[i]);
        let solution = symmetric::pseudo_solve(&scaled, &right);
        let centre = (0..p).map(|i| scale[i] * solution[i]).collect();
        let n = order.len().max(1) as f64;
        let covariate_scale = squares.iter().map(|&s| if s > 0.0 { (s / n).sqrt() } else { 1.0 }).collect();
        Frame { centre, scale, covariate_scale }
    }

    /// Σ in the user's units from Σ in η.
    pub(crate) fn covariance_out(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(sigma.nrows(), sigma.ncols(), |i, j| self.scale[i] * sigma[(i, j)] * self.scale[j])
    }

    /// Σ in η from Σ in the user's units.
    pub(crate) fn covariance_in(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(sigma.nrows(), sigma.ncols(), |i, j| sigma[(i, j)] / (self.scale[i] * self.scale[j]))
    }

    /// The frame of some of the states.
    pub(crate) fn part(&self, states: &Range<usize>) -> Frame {
        let of = |all: &[f64]| all[states.clone()].to_vec();
        Frame { centre: of(&self.centre), scale: of(&self.scale), covariate_scale: self.covariate_scale.clone() }
    }

    /// μ in the user's units from μ in η.
    pub(crate) fn mean_out(&self, mu: &[f64]) -> Vec<f64> {
        mu.iter().zip(&self.centre).zip(&self.scale).map(|((m, c), s)| c + s * m).collect()
    }
}

/// What tests say together.
struct Pooled {
    /// Σ R'R, packed.
    information: Vec<f64>,
    /// Tests that inform each state.
    informed: Vec<f64>,
    /// Σ R'd.
    y: Vec<f64>,
    /// Σ of the squares of each covariate.
    squares: Vec<f64>,
}

impl Pooled {
    fn none((p, regressors): (usize, usize)) -> Pooled {
        Pooled {
            information: vec![0.0; pairs(p)],
            informed: vec![0.0; p],
            y: vec![0.0; p],
            squares: vec![0.0; regressors],
        }
    }

    fn of(reductions: &[Reduction], tests: &[usize], (p, regressors): (usize, usize)) -> Pooled {
        let mut sum = Pooled::none((p, regressors));
        for one in tests.iter().map(|&j| &reductions[j]) {
            for k in 0..p {
                let column = &one.factor[pair(k, 0)..][..=k];
                for i in 0..=k {
                    sum.information[pair(k, i)] += dot(&one.factor[pair(i, 0)..][..=i], column);
                }
                sum.informed[k] += f64::from(u8::from(column.iter().any(|x| *x != 0.0)));
                sum.y[k] += dot(column, &one.data);
            }
            sum.squares.iter_mut().zip(&one.covariates).for_each(|(s, x)| *s += x * x);
        }
        sum
    }

    fn and(mut self, other: &Pooled) -> Pooled {
        let add = |a: &mut [f64], b: &[f64]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        add(&mut self.information, &other.information);
        add(&mut self.informed, &other.informed);
        add(&mut self.y, &other.y);
        add(&mut self.squares, &other.squares);
        self
    }
}

/// Of the first numbers, as many as both have.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
