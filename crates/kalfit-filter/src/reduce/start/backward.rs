//! From ∂ℓ/∂a and ∂ℓ/∂P0 back to ∂ℓ/∂coefficient.

use crate::reduce::error::ReduceErrorKind;
use crate::reduce::start::{ModelStart, StationaryGroup};
use crate::reduce::subject::{Fault, ModelAt, Subject};
use kalfit_algebra::exponential::{stationary, stationary_adjoint, stationary_discrete};

/// ∂ℓ/∂a and ∂ℓ/∂P0 in kernel order: n numbers, and r × r with a separate derivative for each entry of the matrix.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LawAdjoint<'a> {
    pub(crate) place: &'a [usize],
    pub(crate) r: usize,
    pub(crate) mean: &'a [f64],
    pub(crate) variance: &'a [f64],
}

impl LawAdjoint<'_> {
    fn mean(&self, state: usize) -> f64 {
        self.mean[self.place[state]]
    }

    /// Derivative with respect to the covariance of states i and j, which is in both triangles of P0; 0 for states that
    /// noise does not reach.
    fn covariance(&self, i: usize, j: usize) -> f64 {
        let (i, j) = (self.place[i], self.place[j]);
        match i.max(j) < self.r {
            false => 0.0,
            true if i == j => self.variance[i * self.r + i],
            true => self.variance[i * self.r + j] + self.variance[j * self.r + i],
        }
    }
}

/// ∂ℓ/∂coefficient of a start.
#[derive(Debug, Clone, Default)]
pub(crate) struct StartAdjoint {
    /// ∂ℓ/∂coefficient in the order of [`ModelStart::coefficients`].
    pub(crate) coefficients: Vec<f64>,
    /// ∂ℓ/∂coefficient by slot of the dynamics' coefficients.
    pub(crate) values: Vec<f64>,
    /// ∂ℓ/∂input by slot of the dynamics' inputs.
    pub(crate) inputs: Vec<f64>,
}

impl ModelStart {
    /// Writes the derivatives of the start to `out`. `values`, `inputs`: the dynamics' tables that were passed to
    /// [`ModelStart::law`].
    pub(crate) fn backward(
        &self,
        at: &ModelAt<'_>,
        (values, inputs): (&[f64], &[f64]),
        law: &LawAdjoint<'_>,
        out: &mut StartAdjoint,
    ) -> Result<(), Box<Fault>> {
        out.coefficients.clear();
        for &(state, ..) in &self.known {
            out.coefficients.extend([law.mean(state), law.covariance(state, state)]);
        }
        out.coefficients.extend(self.offsets.iter().map(|&(state, _)| law.mean(state)));
        let estimated = &at.model.estimated;
        out.coefficients.extend(self.covariance.iter().map(|&(i, j, _)| law.covariance(estimated[i], estimated[j])));
        out.values.clear();
        out.values.resize(values.len(), 0.0);
        out.inputs.clear();
        out.inputs.resize(inputs.len(), 0.0);
        self.groups.iter().try_for_each(|group| group.backward((values, inputs), law, out))
    }
}

impl StationaryGroup {
    fn backward(
        &self,
        (values, inputs): (&[f64], &[f64]),
        law: &LawAdjoint<'_>,
        out: &mut StartAdjoint,
    ) -> Result<(), Box<Fault>> {
        let m = self.states.len();
        let (f, q) = self.matrices(values);
        let fault = || Fault::new(Subject::StationaryLaw(self.states[0]), ReduceErrorKind::NotFinite);
        let p = if self.continuous { stationary(&f, &q, m) } else { stationary_discrete(&f, &q, m) };
        let p_bar: Vec<f64> = (0..m * m)
            .map(|ij| {
                let (i, j) = (ij / m, ij % m);
                law.covariance(self.states[i], self.states[j]) * if i == j { 1.0 } else { 0.5 }
            })
            .collect();
        let (mut f_bar, mut q_bar) =
            stationary_adjoint(&f, &p.map_err(|_| fault())?, &p_bar, m, !self.continuous).map_err(|_| fault())?;
        if !self.inputs.is_empty() {
            // Am = u: ū = A'⁻¹m̄, F̄ += ūm'
            let a = self.fixed_point(&f);
            let mean_bar = nalgebra::DVector::from_iterator(m, self.states.iter().map(|&state| law.mean(state)));
            let u_bar = a.transpose().lu().solve(&mean_bar).ok_or_else(fault)?;
            let mean = a.lu().solve(&self.input(inputs)).ok_or_else(fault)?;
            for ij in 0..m * m {
                f_bar[ij] += u_bar[ij / m] * mean[ij % m];
            }
            self.inputs.iter().for_each(|&(i, slot)| out.inputs[slot] += u_bar[i]);
        }
        self.motion.iter().for_each(|&(i, j, slot)| out.values[slot] += f_bar[i * m + j]);
        for &(i, j, slot) in self.noise.iter().rev() {
            let lower = std::mem::take(&mut q_bar[i * m + j]);
            out.values[slot] += lower + std::mem::take(&mut q_bar[j * m + i]);
        }
        Ok(())
    }
}
