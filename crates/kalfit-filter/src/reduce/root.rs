//! The design pass in square-root arrays, for designs on which plain covariance and information arithmetic loses
//! digits.
//!
//! P = U'U is represented by the root U, measurements update U by plane rotations (Carlson's update), and whitened rows
//! T/√S are folded into R (Bierman 1977, ch. V), so no digits cancel however singular P or J are.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, K, T, S, U with U'U = P, R with R'R = J")]

use std::sync::Arc;

use crate::reduce::design::{Design, StateFrame, Transition};
use crate::reduce::exact_design::INSENSITIVE;
use crate::reduce::gains::{FactorRotations, GainSpan, Gains, RankOperation};
use crate::reduce::kernel;
use crate::reduce::moment_path::MomentPath;
use crate::reduce::semidefinite::{NotSemidefinite, root};
use crate::reduce::terminal::TerminalRoot;
use kalfit_algebra::fold::{Rotation, fold, fold_row, norm};

/// Largest ratio, of the prior standard deviation of a noise-free measurement to the standard deviation before any
/// measurement, at which the measurement counts as known already.
const KNOWN_FRACTION: f64 = 1e-12;
/// A diagonal entry of R up to this fraction of the norm of its column counts as zero information.
pub(crate) const UNINFORMED: f64 = 1e-13;

/// Reason why a design pass in square-root arrays fails.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RootError {
    /// P0 or some Q is not positive semidefinite.
    NotSemidefinite(NotSemidefinite),
    /// Some number overflows.
    NotFinite,
}

/// State of the square-root filter of a design.
#[derive(Debug, Clone)]
struct RootFilter<'a> {
    frame: &'a StateFrame,
    /// U, r × r, row-major, upper triangular.
    U: Vec<f64>,
    /// Ψ, n × p, row-major.
    Psi: Vec<f64>,
    /// P, r × r, and Ψ, n × p, propagated without measurements: the scale on which a number counts as zero.
    unmeasured_P: Vec<f64>,
    unmeasured_Psi: Vec<f64>,
    /// R, p × p, row-major.
    R: Vec<f64>,
    work: Vec<f64>,
}

/// Runs the square-root filter of a design. `states`: the state of the model at each kernel index, where the last state
/// is requested; `keeps_paths`: P and Ψ before equal steps are stored.
pub(crate) fn root_gains(design: &Design, states: Option<&[usize]>, keeps_paths: bool) -> Result<Gains, RootError> {
    let mut filter = RootFilter::start(design)?;
    let (p, r) = (design.frame.p, design.frame.r);
    let mut gains = Gains {
        r,
        p,
        gains: vec![0.0; (1 + r) * design.rows()],
        sensitivities: vec![0.0; p * design.rows()],
        pieces: vec![GainSpan::all(design.rows())],
        factor: Vec::with_capacity(p * (p + 1) / 2),
        log_determinant: 0.0,
        active: 0,
        rotations: None,
        end: None,
        paths: Vec::new(),
        segments: Vec::new(),
    };
    let mut rotations =
        FactorRotations { row_rotations: Vec::with_capacity(p * design.rows()), ..FactorRotations::default() };
    for stretch in design.stretches() {
        let mut path = keeps_paths.then(|| MomentPath::new(design, &stretch)).flatten();
        for step in stretch.steps() {
            filter.note(&mut path);
            if let Some(transition) = step.transition {
                filter.predict(transition)?;
            }
            for (line, row) in step.lines.zip(step.rows) {
                filter.update(design, (line, row), &mut gains, &mut rotations);
            }
        }
        filter.note(&mut path);
        gains.paths.extend(path.map(MomentPath::complete));
    }
    settle(&mut filter.R, p, UNINFORMED, &mut rotations.settle);
    for k in 0..p {
        gains.factor.extend((0..=k).map(|i| filter.R[i * p + k]));
    }
    let all_finite = gains.log_determinant.is_finite()
        && gains.gains.iter().chain(&gains.sensitivities).chain(&gains.factor).all(|x| x.is_finite());
    gains.rotations = Some(rotations);
    gains.end = states.map(|states| Arc::new(TerminalRoot::new(states, &filter.Psi, &filter.U, r)));
    if all_finite { Ok(gains) } else { Err(RootError::NotFinite) }
}

impl<'a> RootFilter<'a> {
    fn start(design: &'a Design) -> Result<RootFilter<'a>, RootError> {
        let frame = &*design.frame;
        Ok(RootFilter {
            frame,
            U: root(&design.variance, frame.r).map_err(RootError::NotSemidefinite)?,
            Psi: frame.sensitivity.clone(),
            unmeasured_P: design.variance.clone(),
            unmeasured_Psi: frame.sensitivity.clone(),
            R: vec![0.0; frame.p * frame.p],
            work: Vec::new(),
        })
    }

    /// Appends the current P and Ψ to a path, if there is one.
    fn note(&self, path: &mut Option<MomentPath>) {
        let Some(path) = path else { return };
        let r = self.frame.r;
        let entry = |i: usize, j: usize| (0..r).map(|k| self.U[k * r + i] * self.U[k * r + j]).sum::<f64>();
        let P: Vec<f64> = (0..r * r).map(|ij| entry(ij / r, ij % r)).collect();
        path.push(r, &P, &self.Psi);
    }

    /// Folds the rows of [Uφ'; Q^½'] into the new U.
    fn predict(&mut self, transition: &Transition) -> Result<(), RootError> {
        let (p, r) = (self.frame.p, self.frame.r);
        kernel::advance(&mut self.Psi, p, transition.view(), &mut self.work);
        kernel::advance(&mut self.unmeasured_Psi, p, transition.view(), &mut self.work);
        let still = transition.pattern.moved.first().is_none_or(|row| row.state as usize >= r);
        if still && transition.pattern.pairs.is_empty() {
            return Ok(());
        }
        kernel::predict(&mut self.unmeasured_P, r, transition.view(), &mut self.work);
        let mut rows = self.U.clone();
        for (row, old) in rows.chunks_exact_mut(r).zip(self.U.chunks_exact(r)) {
            for moved in transition.pattern.moved.iter().take_while(|moved| (moved.state as usize) < r) {
                let terms = moved.start as usize..moved.reach as usize;
                row[moved.state as usize] =
                    terms.map(|k| transition.phi[k] * old[transition.pattern.columns[k] as usize]).sum();
            }
        }
        let mut Q = vec![0.0; r * r];
        for (&(i, j), &q) in transition.pattern.pairs.iter().zip(&transition.q) {
            Q[i as usize * r + j as usize] += q;
        }
        self.U.fill(0.0);
        fold(&mut self.U, &mut rows, r);
        fold(&mut self.U, &mut root(&Q, r).map_err(RootError::NotSemidefinite)?, r);
        Ok(())
    }

    fn update(
        &mut self,
        design: &Design,
        (line, row): (usize, usize),
        gains: &mut Gains,
        rotations: &mut FactorRotations,
    ) {
        let (p, r) = (self.frame.p, self.frame.r);
        let (states, h) = design.terms(line);
        let noise = design.noise[line];
        let gain = &mut gains.gains[row * (1 + r)..][..1 + r];
        let (weight, K) = gain.split_first_mut().expect("it has a weight");
        let T = &mut gains.sensitivities[row * p..][..p];
        kernel::sensitivity(self.frame, (states, h), &self.Psi, T);
        let reach = states.partition_point(|&state| (state as usize) < r);
        let (inner, h_inner) = (&states[..reach], &h[..reach]);
        let times_h = |u: &[f64]| inner.iter().zip(h_inner).map(|(&state, h)| h * u[state as usize]).sum::<f64>();
        let w: Vec<f64> = self.U.chunks_exact(r.max(1)).map(times_h).collect();
        if noise == 0.0 {
            let unmeasured_deviation: f64 = inner
                .iter()
                .zip(h_inner)
                .map(|(&i, h)| h.abs() * self.unmeasured_P[i as usize * (r + 1)].max(0.0).sqrt())
                .sum();
            if w.iter().fold(0.0, |sum: f64, &w| sum.hypot(w)) <= KNOWN_FRACTION * unmeasured_deviation {
                let terms = self.terms(states, h);
                let sensitive = T.iter().zip(&terms).any(|(T, terms)| T.abs() > INSENSITIVE * terms);
                if sensitive && rotations.exact.take(row, T, terms) {
                    gains.active += 1;
                }
                rotations.row_rotations.extend((0..p).map(|_| (1.0, 0.0)));
                T.fill(0.0);
                return;
            }
        }
        let deviation = self.update_root(&w, noise.sqrt(), K);
        *weight = 1.0 / deviation / deviation;
        gains.log_determinant += 2.0 * deviation.ln();
        gains.active += 1;
        kernel::correct(p, K, T, &mut self.Psi);
        self.work.clear();
        self.work.extend(T.iter().map(|T| T / deviation));
        fold_row(&mut self.R, &mut self.work, |_, turn| rotations.row_rotations.push((turn.c, turn.s)));
    }

    /// Carlson's update of U for a measurement with w = Uh and noise deviation `rho`: rotates the row [√R | 0] with the
    /// rows [w_j | U_j] until all w_j are zero. Returns √S, and writes the gain to `K`.
    fn update_root(&mut self, w: &[f64], mut rho: f64, K: &mut [f64]) -> f64 {
        let r = K.len();
        K.fill(0.0);
        for j in (0..r).rev() {
            let rotation = Rotation::of(rho, w[j]);
            rho = rotation.length;
            for (K, U) in K[j..].iter_mut().zip(&mut self.U[j * r + j..][..r - j]) {
                (*K, *U) = rotation.turn(*K, *U);
            }
        }
        K.iter_mut().for_each(|K| *K /= rho);
        rho
    }

    /// Σ |h_i| (|Ψ_ic| + |Ψ⁰_ic|) for each entry c of T, with Ψ⁰ propagated without measurements: the size of the
    /// entry's terms.
    fn terms(&self, states: &[u32], h: &[f64]) -> Vec<f64> {
        let p = self.frame.p;
        let size = |at: usize| self.Psi[at].abs() + self.unmeasured_Psi[at].abs();
        let of = |c: usize| states.iter().zip(h).map(|(&i, h)| h.abs() * size(i as usize * p + c)).sum();
        (0..p).map(of).collect()
    }
}

/// Sets negligible information to zero: each diagonal entry of R that is at most `part` times the norm of the column.
/// The rest of the row is rotated into the rows below, and the data of the row go to the residual. Shape: `R` p × p,
/// row-major, upper triangular.
pub(crate) fn settle(R: &mut [f64], p: usize, part: f64, settle: &mut Vec<RankOperation>) {
    let column = |k: usize| -> Vec<f64> { (0..=k).map(|i| R[i * p + k]).collect() };
    let norms: Vec<f64> = (0..p).map(|k| norm(&column(k))).collect();
    for i in 0..p {
        if R[i * p + i] > part * norms[i] {
            continue;
        }
        R[i * p + i] = 0.0;
        for k in i + 1..p {
            let turn = Rotation::of(R[k * p + k], R[i * p + k]);
            if turn.s == 0.0 {
                continue;
            }
            for c in k..p {
                (R[k * p + c], R[i * p + c]) = turn.turn(R[k * p + c], R[i * p + c]);
            }
            R[i * p + k] = 0.0;
            settle.push(RankOperation::Rotate { k, i, c: turn.c, s: turn.s });
        }
        settle.push(RankOperation::Drop { i });
    }
}
