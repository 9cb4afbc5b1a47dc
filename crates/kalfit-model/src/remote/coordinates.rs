//! The coordinates η of estimation.

use std::ops::Range;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::ensemble::Selection;
use kalfit_algebra::symmetric;

/// The frame of estimation: ξ = centre + scale ∘ η.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Coordinates {
    /// Centre of each state.
    pub centre: Vec<f64>,
    /// Scale of each state, greater than zero.
    pub scale: Vec<f64>,
    /// Centre of each covariate; zero where the covariate is not centred.
    pub covariate_centre: Vec<f64>,
    /// Scale of each covariate.
    pub covariate_scale: Vec<f64>,
}

impl Coordinates {
    /// The frame with the sum of the centres of all levels as the centre of the first level, and zero as the centre of
    /// every other level; the states of the levels add up to ξ.
    pub fn centred(&self, levels: usize) -> Coordinates {
        let p = self.centre.len() / levels;
        let sum = |i: usize| (0..levels).map(|l| self.centre[l * p + i]).sum();
        let centre = (0..self.centre.len()).map(|k| if k < p { sum(k) } else { 0.0 }).collect();
        Coordinates { centre, ..self.clone() }
    }

    /// The frame in which states that one effect acts on, in whatever slots and levels, have one scale: that of the state
    /// with the index of the effect. The effect then enters each of them as it is.
    pub fn with_shared_scales<'a>(&self, levels: usize, slots: impl Iterator<Item = &'a Selection>) -> Coordinates {
        let p = self.scale.len() / levels;
        let mut scale = self.scale.clone();
        for &(state, effect) in slots.flat_map(Selection::pairs) {
            (0..levels).for_each(|level| scale[level * p + state] = scale[level * p + effect]);
        }
        Coordinates { scale, ..self.clone() }
    }

    /// Σ in the user's units from Σ in η, symmetric to the last bit.
    pub fn covariance_out(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        symmetric::scaled(&self.scale, |i, j| sigma[(i, j)])
    }

    /// Σ in η from Σ in the user's units.
    pub fn covariance_in(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(sigma.nrows(), sigma.ncols(), |i, j| sigma[(i, j)] / (self.scale[i] * self.scale[j]))
    }

    /// The frame of the states `states`.
    pub fn part(&self, states: &Range<usize>) -> Coordinates {
        let pick_states = |all: &[f64]| all[states.clone()].to_vec();
        Coordinates {
            centre: pick_states(&self.centre),
            scale: pick_states(&self.scale),
            covariate_centre: self.covariate_centre.clone(),
            covariate_scale: self.covariate_scale.clone(),
        }
    }

    /// μ in the user's units from μ in η.
    pub fn mean_out(&self, mu: &[f64]) -> Vec<f64> {
        let mut mean = mu.to_vec();
        self.take_mean_out(&mut mean);
        mean
    }

    /// Overwrites μ in η with μ in the user's units.
    pub fn take_mean_out(&self, mean: &mut [f64]) {
        for ((mean, centre), scale) in mean.iter_mut().zip(&self.centre).zip(&self.scale) {
            *mean = centre + scale * *mean;
        }
    }

    /// μ in η from μ in the user's units.
    pub fn mean_in(&self, mu: &[f64]) -> Vec<f64> {
        mu.iter().zip(&self.centre).zip(&self.scale).map(|((m, c), s)| (m - c) / s).collect()
    }
}
