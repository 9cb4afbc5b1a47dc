//! Tails and quantiles of the laws of Student, Fisher and χ².

use statrs::distribution::{ChiSquared, Continuous, ContinuousCDF, FisherSnedecor, Normal, StudentsT};

/// Degrees of freedom from which the first term of the expansion about the normal law is taken: there it is within 1e-9
/// of the law, and the library has no more digits at 1e12.
const MANY: f64 = 1e5;
/// Largest quantile of use.
const MAX_QUANTILE: f64 = 1e9;

/// P(|t| ≥ |`t`|) with ν degrees of freedom; ν infinite: of the normal law.
pub(super) fn two_sided(t: f64, freedom: f64) -> Option<f64> {
    let p = match freedom < MANY {
        true => 2.0 * StudentsT::new(0.0, 1.0, freedom).ok()?.sf(t.abs()),
        false => 2.0 * Normal::standard().sf(t.abs() * (1.0 - (t * t + 1.0) / (4.0 * freedom)).max(0.0)),
    };
    p.is_finite().then_some(p)
}

/// Quantile of Student's t with ν degrees of freedom, of the normal law for infinite ν; `None` where its size exceeds
/// all use, or where there is no such law.
pub fn student_quantile(freedom: f64, probability: f64) -> Option<f64> {
    if freedom >= MANY {
        let z = Normal::standard().inverse_cdf(probability);
        return Some(z * (1.0 + (z * z + 1.0) / (4.0 * freedom)));
    }
    let law = StudentsT::new(0.0, 1.0, freedom).ok()?;
    let found = law.inverse_cdf(probability);
    // the library's inverse has seven digits at 1e5; a step of Newton's method gives all
    let found = found + (law.sf(found) - (1.0 - probability)) / law.pdf(found);
    (found.abs() < MAX_QUANTILE).then_some(found)
}

/// P(F ≥ `f`) with k and m degrees of freedom.
pub(super) fn upper_tail(f: f64, k: f64, m: f64) -> Option<f64> {
    Some(FisherSnedecor::new(k, m).ok()?.sf(f)).filter(|p| p.is_finite())
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
        for (freedom, expected) in
            [(0.2, 768_848.48), (1.0, 12.7062), (4.0, 2.776445), (17.0, 2.109816), (9e4, 1.959990), (1e6, 1.959966)]
        {
            let found = student_quantile(freedom, 0.975).expect("a quantile");
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
            let tail = two_sided(found, freedom).expect("a tail");
            assert!((tail / 0.05 - 1.0).abs() < 1e-7, "{tail}");
        }
        // scipy.stats.t.ppf
        for (freedom, probability, expected) in [
            (2.5, 0.05, -2.558_218_614),
            (9.0, 0.95, 1.833_112_933),
            (3.0, 0.5, 0.0),
            (f64::INFINITY, 0.95, 1.644_853_627),
        ] {
            let found = student_quantile(freedom, probability).expect("a quantile");
            assert!((found - expected).abs() < 1e-8, "{found} {expected}");
        }
        assert_eq!([student_quantile(-1.0, 0.9), student_quantile(0.01, 0.975)], [None; 2]);
        let normal = two_sided(crate::QUANTILE, f64::INFINITY).expect("a tail");
        assert!((normal - 0.05).abs() < 1e-10, "{normal}");
        let tail = upper_tail(4.965, 1.0, 10.0).expect("a tail");
        assert!((tail - 0.05).abs() < 1e-5, "{tail}");
    }
}
