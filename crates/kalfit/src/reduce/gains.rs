//! The design pass: one covariance run per design class leaves a schedule of weights, gains and sensitivities.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, G = P h, K, T, S, J")]

use crate::linalg::real::Real;
use crate::reduce::design::Design;
use crate::reduce::kernel;
use crate::reduce::semidefinite::information_root;

/// A scaled pivot of J below this is too ill-conditioned for sums of T'S⁻¹T.
const LEAST_PIVOT: f64 = 1e-9;

/// What a design pass leaves.
#[derive(Debug, Clone)]
pub(crate) struct Schedule<R = f64> {
    /// For each scalar measurement 1/S, K (r), T (p).
    pub(crate) rows: Vec<R>,
    /// J, packed by columns.
    pub(crate) J: Vec<R>,
    /// Π S = mantissa × 2^exponent.
    mantissa: R,
    exponent: R,
    /// Below zero where an update cancelled too many digits.
    kept: R,
    /// Smallest S.
    least: R,
}

/// Work space of the design pass; afterwards P and Ψ of the last step.
#[derive(Debug, Clone, Default)]
pub(crate) struct GainsWork<R = f64> {
    pub(crate) P: Vec<R>,
    pub(crate) Psi: Vec<R>,
    G: Vec<R>,
    rows: Vec<R>,
}

/// A finished design pass: everything but the data.
#[derive(Debug, Clone)]
pub(crate) struct Gains {
    /// r, length of K.
    pub(crate) r: usize,
    /// p, length of T.
    pub(crate) p: usize,
    /// For each scalar measurement 1/S, K (r), T (p); 1/S = 0 for one that says nothing.
    pub(crate) rows: Vec<f64>,
    /// R with J = R'R, packed by columns.
    pub(crate) factor: Vec<f64>,
    /// Σ log S.
    pub(crate) log_determinant: f64,
    /// Number of measurements that say something.
    pub(crate) active: usize,
    /// How the data are folded, when square-root arrays made it.
    pub(crate) turns: Option<Turns>,
}

/// The rotations that took [T | ·]/√S into R: the data take them too.
#[derive(Debug, Clone, Default)]
pub(crate) struct Turns {
    /// (c, s) with each row of R, for each scalar measurement.
    pub(crate) folds: Vec<(f64, f64)>,
    /// What rounded small diagonals of R to zero, in order.
    pub(crate) settle: Vec<Settle>,
}

/// One operation on d.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Settle {
    /// Rotate rows `k` and `i` by (c, s).
    Turn { k: usize, i: usize, c: f64, s: f64 },
    /// Row `i` of R is zero now: what is left of d_i is residual.
    Drop { i: usize },
}

impl Gains {
    /// (1/S, K, T) of a scalar measurement; 1/S = 0 for one that says nothing.
    #[inline(always)]
    pub(crate) fn row(&self, row: usize) -> (f64, &[f64], &[f64]) {
        let stride = 1 + self.r + self.p;
        let (weight, gains) = self.rows[row * stride..][..stride].split_first().expect("stride is positive");
        let (K, T) = gains.split_at(self.r);
        (*weight, K, T)
    }

    /// Bytes it occupies.
    pub(crate) fn bytes(&self) -> usize {
        let turns = self.turns.as_ref().map_or(0, |turns| 2 * turns.folds.len() + 5 * turns.settle.len());
        8 * (self.rows.len() + self.factor.len() + turns) + 200
    }
}

/// Runs the covariance filter of a design.
pub(crate) fn schedule<R: Real>(design: &Design<R>, work: &mut GainsWork<R>) -> Schedule<R> {
    let (frame, zero) = (&*design.frame, R::splat(0.0));
    let (p, r) = (frame.p, frame.r);
    work.P.clone_from(&design.variance);
    work.Psi.clear();
    work.Psi.extend(frame.sensitivity.iter().map(|&x| R::splat(x)));
    work.G.clear();
    work.G.resize(r, zero);
    let stride = 1 + r + p;
    let one = R::splat(1.0);
    let mut out = Schedule {
        rows: vec![zero; stride * design.rows.len()],
        J: vec![zero; p * (p + 1) / 2],
        mantissa: one,
        exponent: zero,
        kept: one,
        least: one,
    };
    let mut first = 0;
    for step in &design.steps {
        if let Some(transition) = &step.transition {
            kernel::predict(&mut work.P, r, transition, &mut work.rows);
            kernel::advance(&mut work.Psi, p, transition, &mut work.rows);
        }
        for row in first..step.rows {
            let (states, h) = design.terms(row);
            let (weight, gains) = out.rows[row * stride..][..stride].split_first_mut().expect("stride is positive");
            let (K, T) = gains.split_at_mut(r);
            kernel::sensitivity(frame, states, h, &work.Psi, T);
            let update = kernel::update(r, states, h, design.noise[row], &mut work.P, &mut work.G, K);
            kernel::correct(p, K, T, &mut work.Psi);
            kernel::inform(T, update.weight, &mut out.J);
            *weight = update.weight;
            out.kept = out.kept.minimum(update.kept);
            out.least = out.least.minimum(update.S);
            let (mantissa, exponent) = (out.mantissa * update.S.or_one()).split();
            (out.mantissa, out.exponent) = (mantissa, out.exponent + exponent);
        }
        first = step.rows;
    }
    out
}

impl Schedule<f64> {
    /// The finished information form, or `None` where square-root arrays are called for.
    pub(crate) fn finish(self, (r, p): (usize, usize), active: usize) -> Option<Gains> {
        let sound = self.kept >= 0.0 && self.least > 0.0 && self.J.iter().all(|x| x.is_finite());
        if !sound || !self.mantissa.is_finite() {
            return None;
        }
        let (factor, least) = information_root(&self.J, p, LEAST_PIVOT);
        let log_determinant = self.mantissa.ln() + self.exponent * std::f64::consts::LN_2;
        (least >= LEAST_PIVOT).then_some(Gains { r, p, rows: self.rows, factor, log_determinant, active, turns: None })
    }
}

#[cfg(test)]
mod tests {
    use crate::reduce::flops::design_pass;

    fn line(flops: crate::linalg::real::Flops) -> String {
        format!("add {} mul {} fma {} div {}", flops.add, flops.mul, flops.fma, flops.div)
    }

    #[test]
    fn the_design_pass_keeps_its_flop_budget() {
        // n, r, p: random coefficients; an inertial instrument; all states noisy.
        insta::assert_snapshot!(line(design_pass(2, 0, 2, 10)), @"add 30 mul 30 fma 40 div 10");
        insta::assert_snapshot!(line(design_pass(15, 2, 13, 10)), @"add 160 mul 180 fma 2230 div 10");
        insta::assert_snapshot!(line(design_pass(4, 4, 4, 10)), @"add 50 mul 130 fma 2490 div 10");
    }
}
