//! What goes forth and back through the steps of [`StepCoefficients`](super::steady::StepCoefficients): arrays of known size, for the N states that
//! move and C columns of ΨC.

/// P and ΨC.
#[derive(Debug, Clone, Copy)]
pub(super) struct FilterCovariance<const N: usize, const C: usize> {
    pub(super) P: [[f64; N]; N],
    pub(super) Psi: [[f64; C]; N],
}

/// 1/S, K, TC of a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gain<const N: usize, const C: usize> {
    pub(super) weight: f64,
    pub(super) K: [f64; N],
    pub(super) T: [f64; C],
}

/// ρ, N.
#[derive(Debug, Clone, Copy)]
pub(super) struct DesignAdjoint<const N: usize, const C: usize> {
    pub(super) rho: [[f64; C]; N],
    pub(super) N: [[f64; N]; N],
}

/// The design's part of the adjoints of the coefficients, summed over steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct DesignSums<const N: usize, const C: usize> {
    pub(super) noise: f64,
    pub(super) upsilon: [f64; C],
    pub(super) h: [f64; N],
    pub(super) q: [[f64; N]; N],
    pub(super) phi: [[f64; N]; N],
    /// ρ where the transitions end.
    pub(super) rho: [[f64; C]; N],
}

impl<const N: usize, const C: usize> DesignSums<N, C> {
    pub(super) const ZERO: DesignSums<N, C> = DesignSums {
        noise: 0.0,
        upsilon: [0.0; C],
        h: [0.0; N],
        q: [[0.0; N]; N],
        phi: [[0.0; N]; N],
        rho: [[0.0; C]; N],
    };

    /// Adds so many times what others are.
    pub(super) fn add(&mut self, many: f64, others: &DesignSums<N, C>) {
        self.noise += many * others.noise;
        add(&mut self.upsilon, many, &others.upsilon);
        add(&mut self.h, many, &others.h);
        for i in 0..N {
            add(&mut self.q[i], many, &others.q[i]);
            add(&mut self.phi[i], many, &others.phi[i]);
            add(&mut self.rho[i], many, &others.rho[i]);
        }
    }
}

fn add<const M: usize>(sum: &mut [f64; M], factor: f64, others: &[f64; M]) {
    for (sum, other) in sum.iter_mut().zip(others) {
        *sum += factor * other;
    }
}
