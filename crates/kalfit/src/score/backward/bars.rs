//! What goes forth and back through the steps of [`Steady`](super::steady::Steady): arrays of known size, for the N states that
//! move and C columns of ΨC.

/// P and ΨC.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spread<const N: usize, const C: usize> {
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

/// r, ρ, N.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bars<const N: usize, const C: usize> {
    pub(super) r: [f64; N],
    pub(super) rho: [[f64; C]; N],
    pub(super) N: [[f64; N]; N],
}

/// Adjoints of the coefficients, summed over steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sums<const N: usize, const C: usize> {
    pub(super) noise: f64,
    pub(super) u: f64,
    pub(super) upsilon: [f64; C],
    pub(super) h: [f64; N],
    pub(super) q: [[f64; N]; N],
    pub(super) phi: [[f64; N]; N],
    /// r and ρ where the transitions end.
    pub(super) r: [f64; N],
    pub(super) rho: [[f64; C]; N],
}

/// Products that are summed while N and ρ rest, so that only r and x change.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rest<const N: usize> {
    pub(super) count: usize,
    pub(super) u: f64,
    pub(super) uu: f64,
    pub(super) ux: [f64; N],
    pub(super) ur: [f64; N],
    pub(super) r: [f64; N],
    pub(super) rr: [[f64; N]; N],
    pub(super) rx: [[f64; N]; N],
}

impl<const N: usize, const C: usize> Sums<N, C> {
    pub(super) const ZERO: Sums<N, C> = Sums {
        noise: 0.0,
        u: 0.0,
        upsilon: [0.0; C],
        h: [0.0; N],
        q: [[0.0; N]; N],
        phi: [[0.0; N]; N],
        r: [0.0; N],
        rho: [[0.0; C]; N],
    };
}

impl<const N: usize> Rest<N> {
    pub(super) const ZERO: Rest<N> = Rest {
        count: 0,
        u: 0.0,
        uu: 0.0,
        ux: [0.0; N],
        ur: [0.0; N],
        r: [0.0; N],
        rr: [[0.0; N]; N],
        rx: [[0.0; N]; N],
    };
}
