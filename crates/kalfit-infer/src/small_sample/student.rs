//! Laws of Student and Fisher with degrees of freedom that are no whole numbers.

use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};
use statrs::function::beta::beta_reg;

/// Degrees of freedom from which the law of t differs from the normal law by the first terms of an expansion only.
const MANY: f64 = 1e5;
/// Most steps of the search for a quantile.
const MAX_STEPS: usize = 200;

/// P(|t| ≥ |`t`|) with ν degrees of freedom; ν infinite: of the normal law.
pub(super) fn two_sided(t: f64, freedom: f64) -> Option<f64> {
    let p = match freedom < MANY {
        true => beta_reg(0.5 * freedom, 0.5, freedom / (freedom + t * t)),
        false => 2.0 * Normal::standard().sf(t.abs() * (1.0 - (t * t + 1.0) / (4.0 * freedom)).max(0.0)),
    };
    p.is_finite().then_some(p)
}

/// Quantile of 97.5 % with ν degrees of freedom; `None` where it exceeds all use.
pub(super) fn quantile(freedom: f64) -> Option<f64> {
    let z = crate::QUANTILE;
    if freedom >= MANY {
        return Some(z * (1.0 + (z * z + 1.0) / (4.0 * freedom)));
    }
    // bisection in log t: the tail falls from 1 to 0
    let (mut below, mut above) = (1.0_f64.ln(), 1e9_f64.ln());
    if two_sided(above.exp(), freedom)? > 0.05 {
        return None;
    }
    for _ in 0..MAX_STEPS {
        let middle = 0.5 * (below + above);
        if middle <= below || middle >= above {
            break;
        }
        let outside = two_sided(middle.exp(), freedom)? > 0.05;
        if outside { below = middle } else { above = middle }
    }
    Some((0.5 * (below + above)).exp())
}

/// P(F ≥ `f`) with k and m degrees of freedom.
pub(super) fn upper_tail(f: f64, k: f64, m: f64) -> Option<f64> {
    let p = beta_reg(0.5 * m, 0.5 * k, m / (m + k * f.max(0.0)));
    p.is_finite().then_some(p)
}

/// P(χ² ≥ `x`) with k degrees of freedom.
pub(super) fn chi_square_tail(x: f64, k: usize) -> f64 {
    ChiSquared::new(k as f64).map_or(1.0, |law| law.sf(x.max(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_and_tails_are_those_of_tables() {
        for (freedom, expected) in [(1.0, 12.7062), (4.0, 2.776445), (17.0, 2.109816), (9e4, 1.959990), (1e6, 1.959966)]
        {
            let found = quantile(freedom).expect("a quantile");
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
            let tail = two_sided(found, freedom).expect("a tail");
            assert!((tail / 0.05 - 1.0).abs() < 1e-7, "{tail}");
        }
        let normal = two_sided(crate::QUANTILE, f64::INFINITY).expect("a tail");
        assert!((normal - 0.05).abs() < 1e-10, "{normal}");
        let tail = upper_tail(4.965, 1.0, 10.0).expect("a tail");
        assert!((tail - 0.05).abs() < 1e-5, "{tail}");
    }
}
