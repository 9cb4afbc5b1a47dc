//! Ends of profile intervals: values where the maximum of ℓ with one quantity held is below the overall maximum by as
//! much as the interval allows.

use crate::held::Held;
use crate::progress::SharedProgress;

/// Most evaluations of the profile for one end.
const MAX_EVALUATIONS: usize = 30;
/// Number of evaluations after which every second one halves the bracket: where the highest branch changes, Newton
/// steps fail.
const BISECT_AFTER: usize = 8;
/// Where the profile jumps, the jump is located to this fraction of the jump's distance from the estimate.
const JUMP_TOLERANCE: f64 = 1e-3;

/// Finds maxima with one quantity held.
pub(crate) trait Holds: Sync {
    /// Absolute tolerance of ζ, the root of the deviance, at an end.
    const PRECISION: f64;
    /// Whether a quantity can be held at a limit, not only near the limit.
    const ATTAINS_LIMITS: bool = false;
    /// A quantity that can be held.
    type What: Copy + Sync;
    /// The start of a search for a maximum: another maximum nearby.
    type Near: Clone + Sync;
    /// The maximum with `what` held at `value`. `None` where the search ends without a certified maximum.
    fn held(&self, what: Self::What, value: f64, near: &Self::Near) -> Option<Held<Self::Near>>;
    /// Whether the maximum is on a branch that was unknown when values further out were rejected as too unlikely.
    fn is_on_new_branch(_near: &Self::Near) -> bool {
        false
    }
}

/// The profile of one quantity.
pub(crate) struct Profile<'a, 'p, H: Holds> {
    pub(crate) holder: &'a H,
    pub(crate) what: H::What,
    /// Name of the quantity in progress reports.
    pub(crate) name: String,
    /// Estimate of the quantity.
    pub(crate) centre: f64,
    /// ℓ at the estimate.
    pub(crate) maximum: f64,
    /// q: an interval holds the values with ℓ_max(x) ≥ `maximum` - ½q².
    pub(crate) quantile: f64,
    /// Lower and upper limit of the quantity; `None` for an unlimited side.
    pub(crate) limits: [Option<f64>; 2],
    /// Receives which end is computed; once `progress` stops, ends are `None`.
    pub(crate) progress: &'a SharedProgress<'p>,
}

impl<H: Holds> Profile<'_, '_, H> {
    /// Both ends, with a first step of length `step` to each side; `None` where an end is not found.
    pub(crate) fn ends(&self, start: &H::Near, step: f64) -> Option<[f64; 2]> {
        Some([self.end(start, -step)?, self.end(start, step)?])
    }

    /// ζ = √(2(ℓ_max - ℓ_max(x))), the derivative of ζ away from the centre, and the maximum at x.
    fn root(&self, x: f64, near: &H::Near, sign: f64) -> Option<(f64, f64, Held<H::Near>)> {
        let held = self.holder.held(self.what, x, near)?;
        let zeta = (2.0 * (self.maximum - held.value)).max(0.0).sqrt();
        let slope = if zeta > 0.0 { -sign * held.slope / zeta } else { 0.0 };
        Some((zeta, slope, held))
    }

    /// The value where ζ reaches or jumps over the quantile, or the limit if ζ is below the quantile up to the limit:
    /// Newton's method inside a bracket, with the exact slope from the Lagrange multiplier.
    pub(crate) fn end(&self, start: &H::Near, step: f64) -> Option<f64> {
        let sign = step.signum();
        let limit = self.limits[usize::from(sign > 0.0)];
        if limit.is_some_and(|limit| sign * (limit - self.centre) <= 1e-12 * step.abs()) {
            return limit;
        }
        self.progress.report_end(&self.name, sign > 0.0);
        let mut near = start.clone();
        // `is_unlikely`: ζ at `above` exceeds the quantile, as opposed to no certified maximum at `above`
        let (mut below, mut above, mut is_unlikely) = (self.centre, f64::INFINITY * sign, false);
        let mut x = self.inside(self.centre + step, self.centre, limit, sign);
        for tries in 1..=MAX_EVALUATIONS {
            if self.progress.stops() {
                return None;
            }
            let Some((zeta, slope, held)) = self.root(x, &near, sign) else {
                (above, is_unlikely) = (x, false); // no certified maximum at x: halve the distance to `below`
                x = 0.5 * (below + x);
                continue;
            };
            if (zeta - self.quantile).abs() < H::PRECISION {
                return Some(x);
            }
            if zeta < self.quantile {
                if H::is_on_new_branch(&held.near) {
                    above = f64::INFINITY * sign;
                }
                below = x;
                near = held.near;
                if limit.is_some_and(|l| (l - x).abs() <= 1e-4 * (l - self.centre).abs()) {
                    return limit;
                }
                if (x - self.centre).abs() > 1e7 * step.abs() {
                    return None;
                }
            } else {
                (above, is_unlikely) = (x, true);
            }
            x = match above.is_finite() && tries > BISECT_AFTER && tries.is_multiple_of(2) {
                true => 0.5 * (below + above),
                false => self.next(x, zeta, slope, (below, above), step),
            };
            x = self.inside(x, below, limit, sign);
        }
        let jumps = is_unlikely && (above - below).abs() <= JUMP_TOLERANCE * (above - self.centre).abs();
        jumps.then_some(0.5 * (below + above))
    }

    fn next(&self, x: f64, zeta: f64, slope: f64, (below, above): (f64, f64), step: f64) -> f64 {
        let sign = step.signum();
        let newton = x + sign * (self.quantile - zeta) / slope;
        let farthest = below + 3.0 * sign * (below - self.centre).abs().max(step.abs());
        let newton = if slope > 0.0 && newton.is_finite() { newton } else { farthest };
        let newton = if above.is_finite() || sign * (newton - farthest) <= 0.0 { newton } else { farthest };
        let inside = sign * (newton - below) > 0.0 && sign * (above - newton) > 0.0;
        match (inside, above.is_finite()) {
            (true, _) => newton,
            (false, true) => 0.5 * (below + above),
            (false, false) => farthest,
        }
    }

    /// `x`, or the limit if `x` is beyond the limit; where limits cannot be attained, nine tenths of the way to the
    /// limit.
    fn inside(&self, x: f64, below: f64, limit: Option<f64>, sign: f64) -> f64 {
        match limit {
            Some(limit) if sign * (x - limit) >= 0.0 && H::ATTAINS_LIMITS => limit,
            Some(limit) if sign * (x - limit) >= 0.0 => below + 0.9 * (limit - below),
            _ => x,
        }
    }
}

#[cfg(test)]
mod tests {
    use kalfit_fixtures::near;

    use super::*;
    use kalfit_estimate::Silent;

    /// A profile in closed form: ζ and its slope at a distance from the centre, `None` where no maximum is found.
    struct Known<F>(F);

    impl<F: Fn(f64) -> Option<(f64, f64)> + Sync> Holds for Known<F> {
        const PRECISION: f64 = 1e-6;
        const ATTAINS_LIMITS: bool = true;
        type What = ();
        type Near = ();

        fn held(&self, (): (), x: f64, (): &()) -> Option<Held<()>> {
            let (zeta, slope) = self.0(x.abs())?;
            Some(Held { value: -0.5 * zeta * zeta, slope: -x.signum() * zeta * slope, near: () })
        }
    }

    /// The upper end, checked to be the mirror image of the lower end.
    fn end(profile: impl Fn(f64) -> Option<(f64, f64)> + Sync, step: f64, limit: Option<f64>) -> Option<f64> {
        let limits = [limit.map(|limit| -limit), limit];
        let (holder, mut silent) = (Known(profile), Silent);
        let progress = &SharedProgress::new(&mut silent, None);
        let (centre, maximum, quantile, name) = (0.0, 0.0, 2.0, String::new());
        let profile = Profile { holder: &holder, what: (), name, centre, maximum, quantile, limits, progress };
        let [lower, upper] = [profile.end(&(), -step), profile.end(&(), step)];
        println!("{lower:?} {upper:?}");
        assert_eq!(lower.map(|end| -end), upper);
        upper
    }

    #[test]
    fn an_end_is_found_in_any_unit_and_from_any_first_step() {
        for unit in [1e-13, 1.0, 1e9] {
            for step in [0.05, 1.0, 40.0] {
                let curved = |x: f64| Some(((1.0 + x / unit).ln() * 3.0, 3.0 / (unit + x)));
                near::relative(
                    "the end",
                    end(curved, step * unit, Some(1e4 * unit)).expect("an end"),
                    ((2.0_f64 / 3.0).exp() - 1.0) * unit,
                    1e-6,
                );
            }
        }
    }

    #[test]
    fn a_profile_that_jumps_over_the_quantile_ends_at_the_jump() {
        for (at, below, above) in [(0.4055, 0.55, 2.05), (0.3, 1.99, 9.0), (2.7, 0.1, 2.0001)] {
            let jumping = |x: f64| Some(if x < at { (below * x / at, below / at) } else { (above + x - at, 1.0) });
            near::relative("the end", end(jumping, 1.0, None).expect("an end"), at, 2e-3);
        }
    }

    #[test]
    fn without_maxima_further_out_there_is_no_end_and_at_a_limit_it_is_the_limit() {
        let slow = |x: f64| (x, 1.0);
        assert_eq!(end(|x| (x < 1.0).then(|| slow(x)), 0.3, None), None);
        // values of likelihood zero are different: the end is where they begin
        near::relative(
            "the end",
            end(|x| Some(if x < 1.0 { slow(x) } else { (f64::INFINITY, 0.0) }), 0.3, None).expect("an end"),
            1.0,
            1e-3,
        );
        assert_eq!(end(|x| Some(slow(x)), 0.3, Some(1.5)), Some(1.5));
    }
}
