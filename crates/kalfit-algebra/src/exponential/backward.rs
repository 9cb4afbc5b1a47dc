//! Adjoints of motions and of their stationary distributions: from ∂ℓ/∂(φ, Γ, Q) to ∂ℓ/∂(F, Q_c). The Taylor sums and
//! the doublings are passed through backwards.

use kalfit_lanes::{Lanes, MAX_LANES};

use super::{Doubling, FlowError, accumulate, product, product_into, scale, scaling, stationary, stationary_discrete};

/// (∂ℓ/∂F, ∂ℓ/∂Q_c) of [`flow`](super::flow). Shapes: all m × m, row-major; `bars` are ∂ℓ/∂φ, ∂ℓ/∂Γ, ∂ℓ/∂Q, entry by
/// entry; only the symmetric part of ∂ℓ/∂Q has an effect, the mean of the matrix and of the transposed matrix.
pub fn flow_adjoint(
    f: &[f64],
    q: &[f64],
    m: usize,
    step: f64,
    bars: [&[f64]; 3],
) -> Result<(Vec<f64>, Vec<f64>), FlowError> {
    let (f_bar, q_bar) = if m == 1 {
        let [f, q] = scalar_adjoint(f[0], q[0], step, bars.map(|bar| bar[0]));
        (vec![f], vec![q])
    } else {
        general(f, q, m, step, bars)?
    };
    if f_bar.iter().chain(&q_bar).all(|x| x.is_finite()) { Ok((f_bar, q_bar)) } else { Err(FlowError::NotFinite) }
}

/// (∂ℓ/∂f, ∂ℓ/∂q) of a single state, from (∂ℓ/∂φ, ∂ℓ/∂Γ, ∂ℓ/∂Q): φ = exp(fδ), Γ = δ g(fδ), Q = q δ g(2fδ), with g(x) =
/// expm1(x)/x.
pub fn scalar_adjoint(f: f64, q: f64, step: f64, [phi, gamma, noise]: [f64; 3]) -> [f64; 2] {
    let integral = |rate: f64| if rate == 0.0 { step } else { (rate * step).exp_m1() / rate };
    // Slope δ²g'(x); for large x the factor δ/x is applied twice, so that no intermediate result overflows.
    let slope = |rate: f64| {
        let x = rate * step;
        if x.abs() < 1.0 { step * step * near(x) } else { (step / x) * (step / x) * far(x) }
    };
    let part = |bar: f64, slope: &dyn Fn() -> f64| if bar == 0.0 { 0.0 } else { bar * slope() };
    let f_bar =
        part(phi, &|| step * (f * step).exp()) + part(gamma, &|| slope(f)) + part(noise * q, &|| 2.0 * slope(2.0 * f));
    [f_bar, if noise == 0.0 { 0.0 } else { noise * integral(2.0 * f) }]
}

/// ∂I/∂x of I = expm1(xδ)/x in lanes, given exp(xδ) and I.
#[inline(always)]
pub fn scalar_slope<T: Lanes>(rate: T, step: T, (power, integral): (T, T)) -> T {
    let x = rate * step;
    let mut near = T::splat(0.0);
    for slope in SLOPE_COEFFICIENTS.iter().rev() {
        near = near.fma(x, T::splat(*slope));
    }
    near = step * step * near;
    if x.magnitude().at_most(T::splat(1.0)) {
        return near;
    }
    let far = (step * power - integral) / rate;
    let mut all = [0.0; MAX_LANES];
    for lane in 0..T::COUNT {
        all[lane] = if x.lane(lane).abs() < 1.0 { near.lane(lane) } else { far.lane(lane) };
    }
    T::load(&all)
}

/// Number of terms of g'(x); the omitted terms are below the last digit for |x| < 1.
const SLOPE_TERMS: usize = 20;

/// Coefficients (k + 1) / (k + 2)! of g'(x).
const SLOPE_COEFFICIENTS: [f64; SLOPE_TERMS] = {
    let mut slopes = [0.5; SLOPE_TERMS];
    let mut k = 1;
    while k < SLOPE_TERMS {
        let number = k as f64;
        slopes[k] = slopes[k - 1] * (number + 1.0) / (number * (number + 2.0));
        k += 1;
    }
    slopes
};

/// g'(x) = Σ (k + 1) x^k / (k + 2)!.
fn near(x: f64) -> f64 {
    SLOPE_COEFFICIENTS.iter().rev().fold(0.0, |sum, slope| sum * x + slope)
}

/// x²g'(x) = (x - 1)eˣ + 1.
fn far(x: f64) -> f64 {
    if x < -800.0 { 1.0 } else { (x - 1.0) * x.exp() + 1.0 }
}

/// φ, Γ, Q before a doubling.
type FlowParts = (Vec<f64>, Vec<f64>, Vec<f64>);

fn general(
    f: &[f64],
    q: &[f64],
    m: usize,
    step: f64,
    [phi, gamma, noise]: [&[f64]; 3],
) -> Result<(Vec<f64>, Vec<f64>), FlowError> {
    let (doublings, small) = scaling(f, m, step)?;
    let mut orders = Vec::with_capacity(2 * m * m * (19 + m));
    let mut doubling = Doubling::start_observed(f, q, m, small, |power, noise| {
        orders.extend_from_slice(power);
        orders.extend_from_slice(noise);
    });
    let mut flows_before: Vec<FlowParts> = Vec::with_capacity(doublings.max(0) as usize);
    for _ in 0..doublings {
        flows_before.push((doubling.phi.clone(), doubling.gamma.clone(), doubling.q.clone()));
        doubling.double();
    }
    let (mut phi, mut gamma, mut noise) = (phi.to_vec(), gamma.to_vec(), symmetric(noise, m));
    for (phi_before, gamma_before, q_before) in flows_before.iter().rev() {
        doubling_adjoint([phi_before, gamma_before, q_before], [&mut phi, &mut gamma, &mut noise], m);
    }
    Ok(taylor_adjoint(f, m, small, &orders, [&phi, &gamma, &noise]))
}

/// Adjoint of a doubling Q₂ = Q + φQφ', Γ₂ = Γ + φΓ, φ₂ = φφ:
/// φ̄ = φ'φ̄₂ + φ̄₂φ' + Γ̄₂Γ' + 2Q̄₂φQ, Γ̄ = Γ̄₂ + φ'Γ̄₂, Q̄ = Q̄₂ + φ'Q̄₂φ.
fn doubling_adjoint([phi, gamma, q]: [&[f64]; 3], [phi_bar, gamma_bar, q_bar]: [&mut Vec<f64>; 3], m: usize) {
    let transposed = transpose(phi, m);
    let mut next = product(&transposed, phi_bar, m);
    accumulate(&mut next, &product(phi_bar, &transposed, m), 1.0);
    accumulate(&mut next, &product(gamma_bar, &transpose(gamma, m), m), 1.0);
    let half = product(q_bar, phi, m);
    accumulate(&mut next, &product(&half, q, m), 2.0);
    *phi_bar = next;
    let moved = product(&transposed, gamma_bar, m);
    accumulate(gamma_bar, &moved, 1.0);
    accumulate(q_bar, &product(&transposed, &half, m), 1.0);
}

/// Adjoint of the Taylor sums of a small step h. `orders` holds (Fh)^k / k! and the noise term of each order k = 0, 1,
/// …
fn taylor_adjoint(
    f: &[f64],
    m: usize,
    h: f64,
    orders: &[f64],
    [phi, gamma, noise]: [&[f64]; 3],
) -> (Vec<f64>, Vec<f64>) {
    let mut transposed = transpose(f, m);
    scale(&mut transposed, h);
    let mut f_bar = vec![0.0; m * m]; // adjoint of Fh
    let (mut power_bar, mut noise_bar, mut moved) = (vec![0.0; m * m], vec![0.0; m * m], vec![0.0; m * m]);
    for (k, terms) in orders.chunks_exact(2 * m * m).enumerate().rev() {
        let (order, (power, term)) = ((k + 1) as f64, terms.split_at(m * m));
        // power ← Fh power / k; φ += power; Γ += power h / (k + 1)
        for (bar, (phi, gamma)) in power_bar.iter_mut().zip(phi.iter().zip(gamma)) {
            *bar = (*bar + phi + gamma * h / (order + 1.0)) / order;
        }
        // noise ← (Fh noise + noise F'h) / (k + 1); Q += noise; all these matrices are symmetric
        noise_bar.iter_mut().zip(noise).for_each(|(bar, noise)| *bar = (*bar + noise) / (order + 1.0));
        for i in 0..m {
            for j in 0..m {
                let powers = dot(&power_bar[i * m..][..m], &power[j * m..][..m]);
                f_bar[i * m + j] += powers + 2.0 * dot(&noise_bar[i * m..][..m], &term[j * m..][..m]);
            }
        }
        product_into(&transposed, &power_bar, m, &mut moved);
        std::mem::swap(&mut power_bar, &mut moved);
        product_into(&transposed, &noise_bar, m, &mut moved);
        for i in 0..m {
            for j in 0..m {
                noise_bar[i * m + j] = moved[i * m + j] + moved[j * m + i];
            }
        }
    }
    accumulate(&mut noise_bar, noise, 1.0);
    scale(&mut f_bar, h);
    scale(&mut noise_bar, h);
    (f_bar, noise_bar)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// (∂ℓ/∂F, ∂ℓ/∂Q) of [`stationary`], or of [`stationary_discrete`] when `discrete`, from the law P and ∂ℓ/∂P:
/// F'X + XF + P̄ = 0, F̄ = 2XP, Q̄ = X; or X = φ'Xφ + P̄, φ̄ = 2XφP, Q̄ = X.
pub fn stationary_adjoint(
    f: &[f64],
    p: &[f64],
    p_bar: &[f64],
    m: usize,
    discrete: bool,
) -> Result<(Vec<f64>, Vec<f64>), FlowError> {
    let (transposed, p_bar) = (transpose(f, m), symmetric(p_bar, m));
    let x = if discrete { stationary_discrete(&transposed, &p_bar, m)? } else { stationary(&transposed, &p_bar, m)? };
    let moved = if discrete { product(f, p, m) } else { p.to_vec() };
    let mut f_bar = product(&x, &moved, m);
    scale(&mut f_bar, 2.0);
    if f_bar.iter().all(|x| x.is_finite()) { Ok((f_bar, x)) } else { Err(FlowError::NotFinite) }
}

fn transpose(a: &[f64], m: usize) -> Vec<f64> {
    (0..m * m).map(|ij| a[(ij % m) * m + ij / m]).collect()
}

/// ½(A + A').
fn symmetric(a: &[f64], m: usize) -> Vec<f64> {
    a.iter().zip(transpose(a, m)).map(|(a, b)| 0.5 * (a + b)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::flow;
    use super::*;

    /// Pseudo-random numbers of either sign, of a size near 1.
    fn weight(k: usize) -> f64 {
        ((k as f64 * 0.754_877_666 + 0.3).fract() - 0.5) * 3.0
    }

    fn weights(from: usize, m: usize) -> Vec<f64> {
        (0..m * m).map(|k| weight(from + k)).collect()
    }

    fn total(weights: &[f64], values: &[f64]) -> f64 {
        weights.iter().zip(values).map(|(w, x)| w * x).sum()
    }

    /// Central difference without the error terms of orders 2, 4 and 6.
    fn difference(h: f64, function: impl Fn(f64) -> f64) -> f64 {
        let central = |h: f64| (function(h) - function(-h)) / (2.0 * h);
        let d = [central(h), central(h / 2.0), central(h / 4.0), central(h / 8.0)];
        let first: Vec<f64> = d.windows(2).map(|d| (4.0 * d[1] - d[0]) / 3.0).collect();
        let second: Vec<f64> = first.windows(2).map(|d| (16.0 * d[1] - d[0]) / 15.0).collect();
        (64.0 * second[1] - second[0]) / 63.0
    }

    #[track_caller]
    fn close(what: &str, found: f64, expected: f64, size: f64) {
        let bound = 1e-9 * (expected.abs() + size);
        assert!((found - expected).abs() <= bound, "{what}: {found:.15e} against {expected:.15e}, of {size:.1e}");
    }

    /// Checks each entry of F and each symmetric pair of Q_c, for a sum of all entries of φ, Γ, Q with weights that
    /// make each matrix count equally.
    #[track_caller]
    fn check(f: &[f64], q: &[f64], m: usize, step: f64) {
        let here = flow(f, q, m, step).expect("finite");
        let size = |a: &[f64]| a.iter().fold(1e-300, |most: f64, x| most.max(x.abs()));
        let scaled = |from: usize, a: &[f64]| -> Vec<f64> { weights(from, m).iter().map(|w| w / size(a)).collect() };
        let (a, b, c) = (scaled(1, &here.phi), scaled(40, &here.gamma), scaled(90, &here.q));
        let ell = |f: &[f64], q: &[f64]| {
            let flow = flow(f, q, m, step).expect("finite");
            total(&a, &flow.phi) + total(&b, &flow.gamma) + total(&c, &flow.q)
        };
        let (f_bar, q_bar) = flow_adjoint(f, q, m, step, [&a, &b, &c]).expect("finite");
        for at in 0..m * m {
            let h = (0.02 / step).min(0.02 * f[at].abs().max(1e-3 / step));
            let moved = |x: f64| {
                let mut f = f.to_vec();
                f[at] += x;
                ell(&f, q)
            };
            close(&format!("m {m} step {step} F {at}"), f_bar[at], difference(h, moved), 1e-4 / h);
            let (i, j) = (at / m, at % m);
            let h = 0.1 * size(q);
            let moved = |x: f64| {
                let mut q = q.to_vec();
                q[i * m + j] += x;
                q[j * m + i] = q[i * m + j];
                ell(f, &q)
            };
            let expected = difference(h, moved);
            let found = if i == j { q_bar[at] } else { q_bar[at] + q_bar[j * m + i] };
            close(&format!("m {m} step {step} Q {at}"), found, expected, 1e-4 / h);
        }
    }

    fn noise(m: usize) -> Vec<f64> {
        (0..m * m).map(|ij| if ij / m == ij % m { 1.0 + 0.2 * (ij / m) as f64 } else { 0.1 }).collect()
    }

    #[test]
    fn adjoints_of_motions_equal_difference_quotients() {
        for m in 1..=4 {
            let f: Vec<f64> =
                (0..m * m).map(|ij| 0.3 * weight(ij) - if ij / m == ij % m { 0.9 } else { 0.0 }).collect();
            for step in [1e-6, 0.03, 0.4, 2.0, 30.0] {
                check(&f, &noise(m), m, step);
            }
        }
    }

    #[test]
    fn adjoints_hold_for_growth_chains_of_integrators_and_stiff_motion() {
        for step in [1e-3, 0.9, 4.0] {
            check(&[0.5], &[0.3], 1, step);
            check(&[0.0], &[0.3], 1, step);
            check(&[1e-9], &[0.3], 1, step);
            check(
                &[0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
                &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0],
                3,
                step,
            );
            check(&[0.0; 4], &noise(2), 2, step);
        }
        check(&[-1e3, 1.0, 0.5, -1e-3], &noise(2), 2, 10.0);
        check(&[-1e6, 1.0, 0.0, -1e-6], &noise(2), 2, 1e5);
    }

    #[test]
    fn a_single_state_and_one_of_two_uncoupled_agree_at_any_rate() {
        for rate in [-1e8, -30.0, -1.0, -0.4, -1e-3, -1e-12, 0.0, 1e-12, 0.3, 2.0] {
            let (one, _) = flow_adjoint(&[rate], &[0.7], 1, 1.5, [&[1.1], &[-0.4], &[0.9]]).expect("finite");
            let place = |x: f64| [x, 0.0, 0.0, 0.0];
            let bars = [&place(1.1)[..], &place(-0.4), &place(0.9)];
            let (two, _) = flow_adjoint(&place(rate), &place(0.7), 2, 1.5, bars).expect("finite");
            close(&format!("rate {rate}"), one[0], two[0], 0.0);
        }
        // After a step far longer than the time constant φ is zero, Γ = -1/f and Q = -q/2f.
        let (far, noise) = flow_adjoint(&[-1e300], &[2.0], 1, 1e20, [&[1.0], &[1.0], &[1.0]]).expect("finite");
        assert_eq!((far[0], noise[0]), (0.0, 5e-301));
    }

    #[test]
    fn slopes_side_by_side_are_those_of_one_state() {
        for (rate, step) in
            [(-0.3, 0.7), (-1e-9, 1.0), (0.0, 2.0), (-4.0, 0.251), (-40.0, 3.0), (2.5, 1.0), (-3.0, 0.0)]
        {
            let [_, integral, _] = crate::exponential::scalar_flow(rate, 0.0, step);
            let found = scalar_slope::<f64>(rate, step, ((rate * step).exp(), integral));
            let [expected, _] = scalar_adjoint(rate, 0.0, step, [0.0, 1.0, 0.0]);
            let off = (found - expected).abs() / expected.abs().max(1e-300);
            assert!(off < 1e-14, "rate {rate}, step {step}: {found} for {expected}");
        }
    }

    #[test]
    fn adjoints_of_stationary_laws_equal_difference_quotients() {
        for (m, discrete) in [(1, false), (2, false), (3, false), (1, true), (2, true), (3, true)] {
            let (scale, less) = if discrete { (0.3, 0.0) } else { (0.5, 1.2) };
            let diagonal = |ij: usize| if ij / m == ij % m { less } else { 0.0 };
            let f: Vec<f64> = (0..m * m).map(|ij| scale * weight(ij) - diagonal(ij)).collect();
            let law = |f: &[f64], q: &[f64]| {
                if discrete { stationary_discrete(f, q, m) } else { stationary(f, q, m) }.expect("stable")
            };
            let (q, w) = (noise(m), symmetric(&weights(7, m), m));
            let (f_bar, q_bar) = stationary_adjoint(&f, &law(&f, &q), &w, m, discrete).expect("stable");
            for at in 0..m * m {
                let moved = |x: f64| {
                    let mut f = f.clone();
                    f[at] += x;
                    total(&w, &law(&f, &q))
                };
                close(&format!("m {m} {discrete} F {at}"), f_bar[at], difference(0.02, moved), 1e-3);
                let (i, j) = (at / m, at % m);
                let moved = |x: f64| {
                    let mut q = q.clone();
                    q[at] += x;
                    q[j * m + i] = q[at];
                    total(&w, &law(&f, &q))
                };
                let found = if i == j { q_bar[at] } else { q_bar[at] + q_bar[j * m + i] };
                close(&format!("m {m} {discrete} Q {at}"), found, difference(0.1, moved), 1e-3);
            }
        }
    }
}
