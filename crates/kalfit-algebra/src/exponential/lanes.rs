//! Flows of single states in lanes, by an exponential of the numbers of all lanes at once.

use kalfit_lanes::{Lanes, MAX_LANES};

use super::scalar_flow;

/// Largest |x| whose exponential is computed in lanes; beyond it, eˣ is close to overflow or underflow.
const MAX_EXPONENT: f64 = 700.0;
/// 1½ × 2^52: the sum of this number and x holds the whole number nearest to x in the last bits.
const ROUNDING_SHIFT: f64 = 6_755_399_441_055_744.0;
/// ln 2 in two parts; multiples of the first are exact.
const LN_2: [f64; 2] = [0.693_147_180_369_123_8, 1.908_214_929_270_587_7e-10];

/// Number of terms of (eʳ - 1 - r)/r² that affect the last digit for |r| ≤ ½ ln 2.
const EXPONENTIAL_TERMS: usize = 12;

/// Coefficients 1 / (k + 2)! of (eʳ - 1 - r)/r² = Σ r^k / (k + 2)!.
const INVERSE_FACTORIALS: [f64; EXPONENTIAL_TERMS] = {
    let mut terms = [0.5; EXPONENTIAL_TERMS];
    let mut k = 1;
    while k < EXPONENTIAL_TERMS {
        terms[k] = terms[k - 1] / (k as f64 + 2.0);
        k += 1;
    }
    terms
};

/// exp(x) and expm1(x), |x| ≤ [`MAX_EXPONENT`], to a few units in the last place.
#[inline(always)]
fn exponentials<T: Lanes>(x: T) -> [T; 2] {
    let rounding_shift = T::splat(ROUNDING_SHIFT);
    let shifted = x.fma(T::splat(std::f64::consts::LOG2_E), rounding_shift);
    let k = shifted - rounding_shift;
    let r = k.fnma(T::splat(LN_2[1]), k.fnma(T::splat(LN_2[0]), x));
    let mut sum = T::splat(0.0);
    for term in INVERSE_FACTORIALS.iter().rev() {
        sum = sum.fma(r, T::splat(*term));
    }
    let part = (r * r).fma(sum, r);
    let mut powers = [0.0; MAX_LANES];
    shifted.store(&mut powers);
    for power in &mut powers[..T::COUNT] {
        // k in the last bits becomes an exponent
        *power = f64::from_bits((power.to_bits() << 52).wrapping_add(1023 << 52));
    }
    let power = T::load(&powers);
    [power.fma(part, power), power.fma(part, power - T::splat(1.0))]
}

/// [`scalar_flow`] in lanes, to a few units in the last place. No lane depends on another lane.
#[inline(always)]
pub fn scalar_flows<T: Lanes>(f: T, q: T, step: T) -> [T; 3] {
    let two = T::splat(2.0);
    let x = f * step;
    let ([phi, expm1_x], [_, expm1_2x]) = (exponentials(x), exponentials(two * x));
    let found = [phi, expm1_x / f, q * (expm1_2x / (two * f))];
    if T::splat(f64::MIN_POSITIVE).at_most(f.magnitude()) && x.magnitude().at_most(T::splat(0.5 * MAX_EXPONENT)) {
        return found;
    }
    with_scalar_lanes(found, (f, q, step))
}

/// Replaces the flows of rates that are too small or too large for [`exponentials`] by [`scalar_flow`] of each lane.
#[inline(always)]
fn with_scalar_lanes<T: Lanes>(found: [T; 3], (f, q, step): (T, T, T)) -> [T; 3] {
    let mut all = [[0.0; MAX_LANES]; 3];
    all.iter_mut().zip(found).for_each(|(all, found)| found.store(all));
    for lane in 0..T::COUNT {
        let (f, step) = (f.lane(lane), step.lane(lane));
        if f.abs() >= f64::MIN_POSITIVE && (f * step).abs() <= 0.5 * MAX_EXPONENT {
            continue;
        }
        let lane_flows = scalar_flow(f, q.lane(lane), step);
        all.iter_mut().zip(lane_flows).for_each(|(all, x)| all[lane] = x);
    }
    [T::load(&all[0]), T::load(&all[1]), T::load(&all[2])]
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_lanes::{Isa, Kernel};

    struct Flows<'a>(&'a [f64], &'a [f64]);

    impl Kernel for Flows<'_> {
        type Output = Vec<[f64; 3]>;

        #[inline(always)]
        fn run<T: Lanes>(self) -> Vec<[f64; 3]> {
            let mut found = Vec::new();
            for (f, step) in self.0.chunks_exact(T::COUNT).zip(self.1.chunks_exact(T::COUNT)) {
                let lane_flows = scalar_flows(T::load(f), T::splat(1.7), T::load(step));
                (0..T::COUNT).for_each(|lane| {
                    found.push([lane_flows[0].lane(lane), lane_flows[1].lane(lane), lane_flows[2].lane(lane)])
                });
            }
            found
        }
    }

    #[test]
    fn flows_side_by_side_are_those_of_single_states() {
        let rates: Vec<f64> =
            (0..8000).map(|k| -(10f64.powf(-9.0 + f64::from(k % 1000) * 0.0113)) + 1e-3 * f64::from(k % 3)).collect();
        let steps: Vec<f64> = (0..8000).map(|k| 0.01 * f64::from(k % 487)).collect();
        let zero = |k: usize, x: f64| if k.is_multiple_of(97) { 0.0 } else { x };
        let rates: Vec<f64> = rates.iter().enumerate().map(|(k, &x)| zero(k, x)).collect();
        for isa in Isa::all() {
            for (k, found) in isa.run(Flows(&rates, &steps)).iter().enumerate() {
                let expected = scalar_flow(rates[k], 1.7, steps[k]);
                for (found, expected) in found.iter().zip(expected) {
                    let off = (found - expected).abs();
                    assert!(
                        off <= 2e-15 * expected.abs(),
                        "{isa:?}, F = {}, δ = {}: {found} for {expected}",
                        rates[k],
                        steps[k]
                    );
                }
            }
        }
    }
}
