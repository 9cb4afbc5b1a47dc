//! The expected log-likelihood of the complete data, which the M-step of EM raises, at any α near the α of the moments:
//!
//! ```text
//! Q(α) = -½ Σ_k (log R_k + E[v_k²]/R_k) - ½ Σ_k (log|Q_k| + tr Q_k⁻¹E[w_k w_k']) - ½ (log|P0| + tr P0⁻¹E[ζζ'])
//! v_k = z_k - d_k - h_k'x_k        w_k = x_k - φ_k x_{k-1} - b_k        ζ = x_0 - a - Aξ
//! ```
//!
//! up to a constant. Of a singular covariance only the range counts, and the noise must be in this range: numbers that
//! the complete data determine exactly cannot change. The gradient goes through the pullback of ℓ.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::reduce::{Design, DesignStep, Fault, ReduceError, StateFrame, Transition, Workspace};
use crate::score::Scorer;
use crate::score::backward::{MeasurementAdjoint, Smoothed, TransitionAdjoint};
use crate::score::complete::{Complete, InitialMoments, SmoothedTransition};
use crate::score::pullback::{Adjoints, Gradient};
use kalfit_algebra::symmetric;
use kalfit_model::Test;

/// Largest eigenvalue of a scaled covariance, as a fraction of the largest of all, that counts as zero and is outside
/// the range.
const RANGE_TOLERANCE: f64 = 1e-10;
/// Largest scaled variance of noise outside the range that is taken for a rounding error.
const MAX_VARIANCE_OUTSIDE: f64 = 1e-6;
/// Largest E[v²] of a measurement without noise that counts as zero, as a fraction of the sum of the squared terms of the measurement.
const EXACT_TOLERANCE: f64 = 1e-12;

impl Scorer<'_> {
    /// Q of a test, and the gradient of Q; `None` where the complete data are impossible at this α.
    pub(crate) fn expected(
        &self,
        test: &Test,
        complete: &Complete,
        (work, adjoints): (&mut Workspace, &mut Adjoints<'_>),
    ) -> Result<Option<(f64, Gradient)>, ReduceError> {
        let preparer = self.reducer.preparer();
        let named = |fault: Box<Fault>| fault.name(&preparer.model, Some(test));
        preparer.prepare(test, work).map_err(named)?;
        let value = sum(test, complete, work, adjoints).map_err(named)?;
        let gradient = adjoints.finish(test, work).map_err(named)?;
        Ok(value.map(|value| (value, gradient)))
    }
}

fn sum(
    test: &Test,
    complete: &Complete,
    work: &Workspace,
    adjoints: &mut Adjoints<'_>,
) -> Result<Option<f64>, Box<Fault>> {
    let design = &work.design;
    let driven = design.frame.driven.len();
    let mut input = work.data.inputs.len();
    let (mut value, mut known) = (0.0, RangeInverseCache::default());
    let mut k = design.steps();
    for step in design.each_step().rev() {
        k -= 1;
        let Some((own, bar)) = measurements(work, &step, (k, complete)) else { return Ok(None) };
        value += own;
        adjoints.step_measured(test, k, work, &bar)?;
        if let (Some(new), Some(old)) = (step.transition, &complete.transitions[k]) {
            input -= driven;
            let change =
                TransitionChange { new, input: &work.data.inputs[input..][..driven], old, before: &complete.states[k] };
            let Some((own, bar)) = change.expected(&design.frame, &mut known) else { return Ok(None) };
            value += own;
            adjoints.step_moved(test, k, work, &bar)?;
        }
    }
    let Some(start_part) = start(design, &work.data.start, &complete.start) else { return Ok(None) };
    adjoints.started(test, work, &start_part.mean, &start_part.variance)?;
    Ok(Some(value + start_part.value))
}

/// The part of Q from the scalar measurements of a step, and the derivatives of this part. `None` where a measurement
/// gains or loses noise, or where a measurement without noise does not fit the states.
fn measurements(
    work: &Workspace,
    step: &DesignStep<'_>,
    (k, complete): (usize, &Complete),
) -> Option<(f64, MeasurementAdjoint)> {
    let (design, n, state) = (&work.design, work.design.frame.n, &complete.states[k + 1]);
    let (mut value, mut bar) = (0.0, MeasurementAdjoint::default());
    for (line, row) in step.lines.clone().zip(step.rows.clone()) {
        let (states, h) = design.terms(line);
        let (noise, z) = (design.noise[line], work.data.values[row]);
        if (noise > 0.0) != complete.noisy[row] {
            return None;
        }
        let terms = || states.iter().map(|state| *state as usize).zip(h);
        let residual = z - terms().map(|(i, h)| h * state.mean[i]).sum::<f64>();
        let covariance_h = |i: usize| terms().map(|(j, h)| h * state.variance[i * n + j]).sum::<f64>(); // (Vh)_i
        let spread = terms().map(|(i, h)| h * covariance_h(i)).sum::<f64>();
        let second = residual * residual + spread;
        if noise > 0.0 {
            value -= 0.5 * (noise.ln() + second / noise);
            bar.noise.push(0.5 * (second / noise - 1.0) / noise);
            bar.value.push(-residual / noise);
            bar.h.extend((0..n).map(|i| (residual * state.mean[i] - covariance_h(i)) / noise));
        } else {
            let size = z * z + terms().map(|(i, h)| h * h * state.variance[i * n + i]).sum::<f64>();
            if second > EXACT_TOLERANCE * size {
                return None;
            }
            bar.noise.push(0.0);
            bar.value.push(0.0);
            bar.h.resize(bar.h.len() + n, 0.0);
        }
    }
    Some((value, bar))
}

/// A transition at a new α, and the moments of the same transition at the old α.
struct TransitionChange<'a> {
    new: &'a Arc<Transition>,
    input: &'a [f64],
    old: &'a SmoothedTransition,
    before: &'a Smoothed,
}

/// (transition at the old α, transition at the new α, inverse of Q) of the covariance that was inverted last.
#[derive(Debug, Default)]
struct RangeInverseCache {
    last: Option<(Arc<Transition>, Arc<Transition>, RangeInverse)>,
}

impl RangeInverseCache {
    fn range_inverse_of(&mut self, old: &Arc<Transition>, new: &Arc<Transition>, r: usize) -> Option<&RangeInverse> {
        let same =
            |(a, b, _): &(Arc<Transition>, Arc<Transition>, RangeInverse)| Arc::ptr_eq(a, old) && Arc::ptr_eq(b, new);
        if !self.last.as_ref().is_some_and(same) {
            let range_inverse = RangeInverse::new(&old.dense_noise(r, |i| i), &new.dense_noise(r, |i| i))?;
            self.last = Some((old.clone(), new.clone(), range_inverse));
        }
        self.last.as_ref().map(|(.., range_inverse)| range_inverse)
    }
}

impl TransitionChange<'_> {
    /// The part of Q from the transition, and the derivatives of this part. Primes mark the new α: w at the new α is w
    /// at the old α plus d - Dx̃, where D = φ' - φ, d = -(Dx̄ + b' - b) and x̃ = x - x̄.
    fn expected(&self, frame: &StateFrame, known: &mut RangeInverseCache) -> Option<(f64, TransitionAdjoint)> {
        let (n, r) = (frame.n, frame.r);
        let pattern = &self.new.pattern;
        let range_inverse = known.range_inverse_of(&self.old.transition, self.new, r)?;
        let (step, shift) = self.difference(frame, range_inverse)?;
        let noise = &self.old.noise;
        let variance = DMatrix::from_row_slice(n, n, &self.before.variance);
        let cross = DMatrix::from_row_slice(r, n, &noise.cross) - &step * variance; // Cov[w', x]
        let mean = DVector::from_column_slice(&noise.mean);
        // E[w'w''] = E[ww'] - D Cov[x, w] - Cov[w', x] D' + d E[w]' + E[w] d' + dd'
        let old_cross = DMatrix::from_row_slice(r, n, &noise.cross);
        let mut second = DMatrix::from_row_slice(r, r, &noise.second);
        second -= &step * old_cross.transpose() + &cross * step.transpose();
        second += &shift * mean.transpose() + &mean * shift.transpose() + &shift * shift.transpose();
        let part = range_inverse.expected(&second)?;
        let mean = mean + shift;
        let reached =
            &range_inverse.inverse * (cross + &mean * DVector::from_column_slice(&self.before.mean).transpose());
        let pull = &range_inverse.inverse * mean;
        let mut phi = vec![0.0; self.new.phi.len()];
        for row in pattern.moved.iter().filter(|row| (row.state as usize) < r) {
            for k in row.start as usize..row.end as usize {
                phi[k] = reached[(row.state as usize, pattern.columns[k] as usize)];
            }
        }
        let entry = |&(i, j): &(u32, u32)| part.bar[(i as usize, j as usize)] * if i == j { 1.0 } else { 2.0 };
        let q = pattern.pairs.iter().map(entry).collect();
        let input = frame.driven.iter().map(|&i| if (i as usize) < r { pull[i as usize] } else { 0.0 }).collect();
        Some((part.value, TransitionAdjoint { phi, q, input }))
    }

    /// D (r × n) and d (r); `None` where a state without noise would move differently.
    fn difference(&self, frame: &StateFrame, range_inverse: &RangeInverse) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let (n, r) = (frame.n, frame.r);
        let (mut step, mut shift) = (DMatrix::zeros(r, n), DVector::zeros(r));
        let is_noisy = |i: usize| i < r && range_inverse.noisy[i];
        let pattern = &self.new.pattern;
        for row in &pattern.moved {
            let i = row.state as usize;
            for k in row.start as usize..row.end as usize {
                let (new, old, j) = (self.new.phi[k], self.old.transition.phi[k], pattern.columns[k] as usize);
                if is_noisy(i) {
                    step[(i, j)] = new - old;
                    shift[i] -= (new - old) * self.before.mean[j];
                } else if differ(new, old) {
                    return None;
                }
            }
        }
        for ((&i, new), old) in frame.driven.iter().zip(self.input).zip(&self.old.input) {
            if is_noisy(i as usize) {
                shift[i as usize] -= new - old;
            } else if differ(*new, *old) {
                return None;
            }
        }
        Some((step, shift))
    }
}

fn differ(a: f64, b: f64) -> bool {
    (a - b).abs() > 1e-14 * a.abs().max(b.abs())
}

/// The part of Q from x_0, and the derivatives of this part to a (n) and P0 (r × r).
struct StartPart {
    value: f64,
    mean: Vec<f64>,
    variance: Vec<f64>,
}

fn start(design: &Design, known: &[f64], old: &InitialMoments) -> Option<StartPart> {
    let (n, r) = (design.frame.n, design.frame.r);
    let new = DMatrix::from_fn(r, r, |i, j| design.variance[i.max(j) * r + i.min(j)]);
    let range_inverse = RangeInverse::new(&DMatrix::from_row_slice(r, r, &old.variance), &new)?;
    let mut shift = DVector::zeros(r);
    for i in 0..n {
        if i < r && range_inverse.noisy[i] {
            shift[i] = old.known[i] - known[i];
        } else if differ(known[i], old.known[i]) {
            return None;
        }
    }
    let mean = DVector::from_column_slice(&old.mean);
    let mut second = DMatrix::from_row_slice(r, r, &old.second);
    second += &shift * mean.transpose() + &mean * shift.transpose() + &shift * shift.transpose();
    let part = range_inverse.expected(&second)?;
    let pull = &range_inverse.inverse * (mean + shift);
    let mean = (0..n).map(|i| if i < r { pull[i] } else { 0.0 }).collect();
    Some(StartPart { value: part.value, mean, variance: part.bar.transpose().as_slice().to_vec() })
}

/// The inverse of a covariance on the range of the covariance, with the range decided in units of the old standard
/// deviations.
#[derive(Debug)]
struct RangeInverse {
    inverse: DMatrix<f64>,
    /// log|Q| on the range, up to a constant.
    log_determinant: f64,
    /// Whether each state has noise.
    noisy: Vec<bool>,
    /// Linear combinations of the states that no noise reaches, scaled to unit size, one per row.
    outside: DMatrix<f64>,
}

/// -½ (log|Q| + tr Q⁻¹E), and the derivatives to the entries of Q, taken as independent.
struct QuadraticTerm {
    value: f64,
    bar: DMatrix<f64>,
}

impl RangeInverse {
    /// Inverts `new` on the range of `new`; `None` where the ranges of `new` and `old` differ.
    fn new(old: &DMatrix<f64>, new: &DMatrix<f64>) -> Option<RangeInverse> {
        let r = old.nrows();
        let noisy: Vec<bool> = (0..r).map(|i| old[(i, i)] > 0.0).collect();
        let noisy_states: Vec<usize> = (0..r).filter(|&i| noisy[i]).collect();
        if (0..r).any(|i| (new[(i, i)] > 0.0) != noisy[i]) {
            return None;
        }
        let scale: Vec<f64> = noisy_states.iter().map(|&i| old[(i, i)].sqrt().recip()).collect();
        let scaled = |q: &DMatrix<f64>| {
            DMatrix::from_fn(noisy_states.len(), noisy_states.len(), |i, j| {
                scale[i] * q[(noisy_states[i], noisy_states[j])] * scale[j]
            })
        };
        let range = |values: &[f64]| {
            let most = values.iter().copied().fold(0.0, f64::max);
            values.iter().map(|v| *v > RANGE_TOLERANCE * most).collect::<Vec<bool>>()
        };
        let (values, vectors) = symmetric::eigen(&scaled(new));
        let inside = range(&values);
        let (before, _) = symmetric::eigen(&scaled(old));
        let count = |inside: &[bool]| inside.iter().filter(|inside| **inside).count();
        if count(&inside) != count(&range(&before)) {
            return None;
        }
        let mut range_inverse =
            RangeInverse { inverse: DMatrix::zeros(r, r), log_determinant: 0.0, noisy, outside: DMatrix::zeros(0, r) };
        for (k, value) in values.iter().enumerate() {
            let mut direction = DVector::zeros(r);
            noisy_states.iter().enumerate().for_each(|(i, &state)| direction[state] = scale[i] * vectors[(i, k)]);
            if inside[k] {
                range_inverse.log_determinant += value.ln();
                range_inverse.inverse += &direction * direction.transpose() / *value;
            } else {
                let at = range_inverse.outside.nrows();
                range_inverse.outside = range_inverse.outside.insert_row(at, 0.0);
                range_inverse.outside.set_row(at, &direction.transpose());
            }
        }
        Some(range_inverse)
    }

    /// -½ (log|Q| + tr Q⁻¹E) with E = `second`; `None` where the noise would have to leave the range.
    fn expected(&self, second: &DMatrix<f64>) -> Option<QuadraticTerm> {
        for direction in self.outside.row_iter() {
            if (direction * second * direction.transpose())[(0, 0)] > MAX_VARIANCE_OUTSIDE {
                return None;
            }
        }
        let half = &self.inverse * second;
        let value = -0.5 * (self.log_determinant + half.trace());
        let bar = (&half * &self.inverse - &self.inverse) * 0.5;
        value.is_finite().then_some(QuadraticTerm { value, bar })
    }
}
