//! Motion of dx/dt = F x + u + white noise over a step, by scaling and doubling.
//!
//! φ = exp(Fδ), Γ = ∫₀^δ exp(Fs) ds, Q = ∫₀^δ exp(Fs) Q_c exp(F's) ds. A small step is summed by Taylor, then doubled:
//! Q ← Q + φQφ', Γ ← Γ + φΓ, φ ← φ². No exp(+δ/τ) is ever formed, so that steps far longer than the time constants are
//! exact.

mod backward;
mod lanes;

pub use backward::{flow_adjoint, scalar_adjoint, scalar_slope, stationary_adjoint};
pub use lanes::scalar_flows;

/// φ, Γ, Q of one step; each m × m, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Flow {
    /// Transition φ.
    pub phi: Vec<f64>,
    /// Response Γ to a constant input.
    pub gamma: Vec<f64>,
    /// Process noise covariance Q.
    pub q: Vec<f64>,
}

/// Why a motion has no flow or no stationary law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FlowError {
    /// An entry overflows, or was not finite to begin with.
    #[error("the transition is not finite")]
    NotFinite,
    /// There is no stationary distribution.
    #[error("the motion is not stable")]
    Unstable,
}

/// φ, Γ, Q over `step` ≥ 0. Shapes: `f`, `q` m × m, row-major; `q` symmetric, per unit time.
pub fn flow(f: &[f64], q: &[f64], m: usize, step: f64) -> Result<Flow, FlowError> {
    let flow = if m == 1 {
        let [phi, gamma, q] = scalar_flow(f[0], q[0], step);
        Flow { phi: vec![phi], gamma: vec![gamma], q: vec![q] }
    } else {
        general(f, q, m, step)?
    };
    if [&flow.phi, &flow.gamma, &flow.q].into_iter().flatten().all(|x| x.is_finite()) {
        Ok(flow)
    } else {
        Err(FlowError::NotFinite)
    }
}

/// φ, Γ, Q of a single state: exp(fδ), expm1(fδ)/f, q expm1(2fδ)/(2f). Results that overflow are not finite.
pub fn scalar_flow(f: f64, q: f64, step: f64) -> [f64; 3] {
    let integral = |rate: f64| if rate == 0.0 { step } else { (rate * step).exp_m1() / rate };
    [(f * step).exp(), integral(f), if q == 0.0 { 0.0 } else { q * integral(2.0 * f) }]
}

fn general(f: &[f64], q: &[f64], m: usize, step: f64) -> Result<Flow, FlowError> {
    let (doublings, small) = scaling(f, m, step)?;
    let mut doubling = Doubling::start(f, q, m, small);
    for _ in 0..doublings {
        doubling.double();
    }
    Ok(doubling.finish())
}

/// Number of doublings, and the small step to be doubled.
fn scaling(f: &[f64], m: usize, step: f64) -> Result<(i32, f64), FlowError> {
    let reach = norm(f, m) * step;
    if !reach.is_finite() {
        return Err(FlowError::NotFinite);
    }
    let doublings = if reach > 0.5 { (reach.log2() + 1.0).ceil() as i32 } else { 0 };
    // 2 × `reach` may overflow where `reach` does not. At most about 1026 doublings, since `reach` is finite; the power has two factors, since 2^1026 is not finite.
    Ok((doublings, step * 0.5f64.powi(doublings / 2) * 0.5f64.powi(doublings - doublings / 2)))
}

/// Stationary covariance P of dx = Fx dt + noise: FP + PF' + Q = 0. An error unless F is stable.
pub fn stationary(f: &[f64], q: &[f64], m: usize) -> Result<Vec<f64>, FlowError> {
    if m == 1 {
        return if f[0] < 0.0 { finite(vec![-q[0] / (2.0 * f[0])]) } else { Err(FlowError::Unstable) };
    }
    let size = norm(f, m);
    if size == 0.0 || !size.is_finite() {
        return Err(FlowError::Unstable);
    }
    double_until_stationary(Doubling::start(f, q, m, 0.5 / size))
}

/// Stationary covariance P of x_k = φ x_{k-1} + noise: P = φPφ' + Q. An error unless φ is stable.
pub fn stationary_discrete(phi: &[f64], q: &[f64], m: usize) -> Result<Vec<f64>, FlowError> {
    if m == 1 {
        let left = (1.0 - phi[0]) * (1.0 + phi[0]);
        return if left > 0.0 { finite(vec![q[0] / left]) } else { Err(FlowError::Unstable) };
    }
    double_until_stationary(Doubling { m, excess: None, phi: phi.to_vec(), gamma: vec![0.0; m * m], q: q.to_vec() })
}

/// Q after doublings until ‖φ‖ < 1e-30; 2^120 small steps outlast any rate that an `f64` distinguishes from zero.
fn double_until_stationary(mut doubling: Doubling) -> Result<Vec<f64>, FlowError> {
    for _ in 0..120 {
        let left = norm(&doubling.phi, doubling.m);
        if !left.is_finite() {
            return Err(FlowError::Unstable);
        }
        if left < 1e-30 {
            return finite(doubling.q);
        }
        doubling.double();
    }
    Err(FlowError::Unstable)
}

fn finite(p: Vec<f64>) -> Result<Vec<f64>, FlowError> {
    if p.iter().all(|x| x.is_finite()) { Ok(p) } else { Err(FlowError::NotFinite) }
}

struct Doubling {
    m: usize,
    /// φ - I, as long as φ is near I: squaring φ directly would double the relative error of φ each time.
    excess: Option<Vec<f64>>,
    phi: Vec<f64>,
    gamma: Vec<f64>,
    q: Vec<f64>,
}

impl Doubling {
    /// Taylor sums for a step with ‖F‖ × step ≤ ½: 18 terms leave an error of 1e-21 of the norm, and m more terms reach
    /// the far corner of the φ of a chain of m states.
    fn start(f: &[f64], q: &[f64], m: usize, step: f64) -> Doubling {
        Doubling::start_observed(f, q, m, step, |_, _| {})
    }

    /// [`Doubling::start`], which also passes the last terms of φ and of Q to `on_order` before each order.
    fn start_observed(f: &[f64], q: &[f64], m: usize, step: f64, mut on_order: impl FnMut(&[f64], &[f64])) -> Doubling {
        let transpose: Vec<f64> = (0..m * m).map(|ij| f[(ij % m) * m + ij / m]).collect();
        let fs: Vec<f64> = f.iter().map(|x| x * step).collect();
        let ts: Vec<f64> = transpose.iter().map(|x| x * step).collect();
        let mut power = identity(m); // (Fh)^k / k!, h = step
        let mut noise: Vec<f64> = q.iter().map(|x| x * step).collect(); // h^{k+1} L_k / (k+1)!, L_{k+1} = F L_k + L_k F'
        let (mut excess, mut total) = (vec![0.0; m * m], noise.clone());
        let mut gamma: Vec<f64> = identity(m).iter().map(|x| x * step).collect();
        let (mut left, mut right) = (vec![0.0; m * m], vec![0.0; m * m]);
        for k in 1..(19 + m) {
            let order = k as f64;
            on_order(&power, &noise);
            product_into(&fs, &power, m, &mut left);
            std::mem::swap(&mut power, &mut left);
            scale(&mut power, 1.0 / order);
            accumulate(&mut excess, &power, 1.0);
            accumulate(&mut gamma, &power, step / (order + 1.0));
            product_into(&fs, &noise, m, &mut left);
            product_into(&noise, &ts, m, &mut right);
            for (term, (a, b)) in noise.iter_mut().zip(left.iter().zip(&right)) {
                *term = (a + b) / (order + 1.0);
            }
            accumulate(&mut total, &noise, 1.0);
        }
        let phi = excess.iter().zip(identity(m)).map(|(a, b)| a + b).collect();
        Doubling { m, excess: Some(excess), phi, gamma, q: total }
    }

    fn double(&mut self) {
        let m = self.m;
        let half = product(&self.phi, &self.q, m);
        for i in 0..m {
            for j in 0..=i {
                let sum: f64 = (0..m).map(|k| half[i * m + k] * self.phi[j * m + k]).sum();
                self.q[i * m + j] += sum;
                self.q[j * m + i] = self.q[i * m + j];
            }
        }
        let moved = product(&self.phi, &self.gamma, m);
        accumulate(&mut self.gamma, &moved, 1.0);
        match &mut self.excess {
            Some(excess) => {
                let square = product(excess, excess, m);
                scale(excess, 2.0);
                accumulate(excess, &square, 1.0);
                self.phi = excess.iter().zip(identity(m)).map(|(a, b)| a + b).collect();
                if norm(&self.phi, m) < 0.5 {
                    self.excess = None;
                }
            }
            None => self.phi = product(&self.phi, &self.phi, m),
        }
    }

    fn finish(self) -> Flow {
        Flow { phi: self.phi, gamma: self.gamma, q: self.q }
    }
}

fn identity(m: usize) -> Vec<f64> {
    (0..m * m).map(|ij| if ij / m == ij % m { 1.0 } else { 0.0 }).collect()
}

fn product(a: &[f64], b: &[f64], m: usize) -> Vec<f64> {
    let mut out = vec![0.0; m * m];
    product_into(a, b, m, &mut out);
    out
}

fn product_into(a: &[f64], b: &[f64], m: usize, out: &mut [f64]) {
    out.fill(0.0);
    for (row, factors) in out.chunks_exact_mut(m).zip(a.chunks_exact(m)) {
        for (&factor, b) in factors.iter().zip(b.chunks_exact(m)) {
            if factor != 0.0 {
                row.iter_mut().zip(b).for_each(|(x, b)| *x += factor * b);
            }
        }
    }
}

fn scale(a: &mut [f64], factor: f64) {
    a.iter_mut().for_each(|x| *x *= factor);
}

fn accumulate(sum: &mut [f64], a: &[f64], factor: f64) {
    sum.iter_mut().zip(a).for_each(|(x, y)| *x += factor * y);
}

/// Largest Σ_k |a_ik| over the rows i; ∞ if an element is NaN.
fn norm(a: &[f64], m: usize) -> f64 {
    a.chunks_exact(m)
        .map(|row| row.iter().map(|x| x.abs()).sum::<f64>())
        .fold(0.0, |most: f64, sum| if sum.is_nan() { f64::INFINITY } else { most.max(sum) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(found: &[f64], expected: &[f64], tolerance: f64) {
        for (i, (a, b)) in found.iter().zip(expected).enumerate() {
            let error = (a - b).abs() / b.abs().max(1e-300);
            assert!(error <= tolerance || a == b, "entry {i}: {a:e} against {b:e}, {error:.1e} of {tolerance:.0e}");
        }
    }

    #[test]
    fn second_order_gauss_markov_has_its_closed_form() {
        // Rate w, critically damped: φ = e^{-wδ} [1 + wδ, δ; -w²δ, 1 - wδ]; the stationary variance is q/(4w³).
        let (w, q) = (0.7f64, 0.3);
        for step in [1e-6, 0.1, 1.0, 30.0, 800.0] {
            let flow = flow(&[0.0, 1.0, -w * w, -2.0 * w], &[0.0, 0.0, 0.0, q], 2, step).expect("finite");
            let decay = (-w * step).exp();
            let phi = [1.0 + w * step, step, -w * w * step, 1.0 - w * step].map(|x| x * decay);
            // Below 1e-16 of the norm only the size matters.
            assert_near(&flow.phi, &phi, if step > 10.0 { 1e-10 } else { 1e-14 });
            let p = [q / (4.0 * w.powi(3)), 0.0, 0.0, q / (4.0 * w)];
            let settled = p[0] - phi[0] * phi[0] * p[0] - phi[1] * phi[1] * p[3];
            if step >= 0.1 {
                assert_near(&flow.q[..1], &[settled], 1e-11);
            }
        }
    }

    #[test]
    fn a_chain_of_integrators_is_exact_in_every_entry() {
        let m = 4;
        let mut f = vec![0.0; 16];
        for i in 0..3 {
            f[i * m + i + 1] = 1.0;
        }
        let mut q = vec![0.0; 16];
        q[15] = 2.0;
        let factorial = [1.0, 1.0, 2.0, 6.0];
        for step in [1e-3, 1.0, 1e4] {
            let flow = flow(&f, &q, m, step).expect("finite");
            for i in 0..m {
                for j in 0..m {
                    let phi = if j >= i { f64::powi(step, (j - i) as i32) / factorial[j - i] } else { 0.0 };
                    assert_near(&[flow.phi[i * m + j]], &[phi], 1e-14);
                    let (a, b) = (3 - i, 3 - j);
                    let noise =
                        2.0 * f64::powi(step, (a + b + 1) as i32) / (factorial[a] * factorial[b] * (a + b + 1) as f64);
                    assert_near(&[flow.q[i * m + j]], &[noise], 1e-13);
                }
            }
        }
    }

    #[test]
    fn slow_modes_survive_beside_fast_ones() {
        // Rates -1e6 and -1e-6 coupled one way; over 1e6 time units the slow mode keeps e^{-1}.
        let flow = flow(&[-1e6, 1.0, 0.0, -1e-6], &[0.0; 4], 2, 1e6).expect("finite");
        let slow = (-1.0f64).exp();
        assert_near(&flow.phi, &[0.0, slow / (1e6 - 1e-6), 0.0, slow], 1e-13);
        assert_near(&flow.gamma[3..], &[-(-1.0f64).exp_m1() * 1e6], 1e-13);
    }

    #[test]
    fn the_stationary_law_is_what_long_steps_lead_to() {
        let (f, q) = ([-0.5, 0.2, 0.0, -1e-5], [0.1, 0.02, 0.02, 3.0]);
        let p = stationary(&f, &q, 2).expect("stable");
        let long = flow(&f, &q, 2, 1e9).expect("finite");
        assert_near(&long.q, &p, 1e-12);
        let d = stationary_discrete(&[0.5, 0.2, 0.0, -0.9], &q, 2).expect("stable");
        assert_near(&d[3..], &[3.0 / (1.0 - 0.81)], 1e-13);
        assert_eq!(stationary(&[-1.0, 1.0, 0.0, 0.0], &q, 2), Err(FlowError::Unstable));
        assert_eq!(stationary_discrete(&[1.0, 0.0, 0.0, 0.5], &q, 2), Err(FlowError::Unstable));
    }

    #[test]
    fn what_overflows_is_an_error_and_ends() {
        let q = [0.0; 4];
        assert_eq!(flow(&[1.0, 1.0, 0.0, 1.0], &q, 2, 1e6), Err(FlowError::NotFinite));
        assert_eq!(flow(&[1e300, 0.0, 0.0, 1.0], &q, 2, 1e300), Err(FlowError::NotFinite));
        assert_eq!(flow(&[f64::NAN; 4], &q, 2, 1.0), Err(FlowError::NotFinite));
        assert_eq!(flow(&[1.0], &[0.0], 1, 1e4), Err(FlowError::NotFinite));
        assert_eq!(stationary(&[f64::NAN; 4], &q, 2), Err(FlowError::Unstable));
    }
}
