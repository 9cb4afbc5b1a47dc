//! The law of a sum of squared distances of new tests from a population that was estimated.
//!
//! For n tests that determine p values each, against a population estimated from N such tests, D = N tr W⁻¹B, where W ~
//! Wishart_p(N - 1) and B is a sum of n squares about an estimated mean. D is the trace of Lawley and Hotelling, and
//! McKeon's F has the first two moments of D (Biometrika 61, 1974, 381). The law F is exact for one test, where D is
//! Hotelling's T², and for p = 1:
//!
//! ```text
//! tr W⁻¹B ~ c F(a, b),   a = ph,   b = 4 + (a + 2)(ν - p - 3)(ν - p) / ((ν + h - p - 1)(ν - 1) - (ν - p - 3)(ν - p)),
//! c = a (b - 2) / (b (ν - p - 1)),   W of ν and B of h degrees of freedom
//! ```

use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor, Normal};

/// A multiple of Fisher's F, or of χ².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Law {
    /// Factor of F.
    pub scale: f64,
    /// Degrees of freedom of the numerator.
    pub numerator: f64,
    /// Degrees of freedom of the denominator. Infinite where nothing is estimated: the law is then `scale` χ²_a/a with
    /// a = `numerator`.
    pub denominator: f64,
}

/// Degrees of freedom of both numerator and denominator above which the cube root of F is treated as normal.
const NORMAL_FROM_DEGREES: f64 = 1e4;

/// Rounding error of computed degrees of freedom.
const DEGREES_ROUNDING: f64 = 1e-5;

impl Law {
    /// χ² with the given degrees of freedom.
    pub fn chi_squared(degrees: f64) -> Law {
        Law { scale: degrees, numerator: degrees, denominator: f64::INFINITY }
    }

    /// Mean of the law; infinite where the law has no mean.
    pub fn mean(&self) -> f64 {
        match self.denominator {
            b if b.is_infinite() => self.scale,
            b if b > 2.0 + DEGREES_ROUNDING => self.scale * b / (b - 2.0),
            _ => f64::INFINITY,
        }
    }

    /// Standard deviation of the law; infinite where the law has no variance.
    pub fn std_dev(&self) -> f64 {
        let (a, b) = (self.numerator, self.denominator);
        match b {
            b if b.is_infinite() => self.scale * (2.0 / a).sqrt(),
            b if b > 4.0 + DEGREES_ROUNDING => self.mean() * (2.0 * (a + b - 2.0) / (a * (b - 4.0))).sqrt(),
            _ => f64::INFINITY,
        }
    }

    /// P(X ≤ x) and P(X ≥ x); `None` without degrees of freedom.
    pub fn tails(&self, x: f64) -> Option<[f64; 2]> {
        let (f, a, b) = (x / self.scale, self.numerator, self.denominator);
        if b.is_infinite() {
            let law = ChiSquared::new(a).ok()?;
            return Some([law.cdf(f * a), law.sf(f * a)]);
        }
        if a > NORMAL_FROM_DEGREES && b > NORMAL_FROM_DEGREES {
            // Paulson's approximation
            let [above, below] = [2.0 / (9.0 * a), 2.0 / (9.0 * b)];
            let root = f.cbrt();
            let z = ((1.0 - below) * root - (1.0 - above)) / (below * root * root + above).sqrt();
            let law = Normal::standard();
            return Some([law.cdf(z), law.sf(z)]);
        }
        let law = FisherSnedecor::new(a, b).ok()?;
        Some([law.cdf(f), law.sf(f)])
    }

    /// Two-sided p-value of x: twice the smaller tail, at most 1.
    pub fn two_sided(&self, x: f64) -> Option<f64> {
        self.tails(x).map(|[below, above]| (2.0 * below.min(above)).min(1.0))
    }
}

/// A sum of squared distances, with the effects of errors of estimation on the sum to first order.
#[derive(Debug, Clone, Copy)]
pub(super) struct DistanceSum {
    /// Number of distances.
    pub(super) count: f64,
    /// Degrees of freedom of all distances together.
    pub(super) degrees: f64,
    /// Size of the blocks of Σ that are estimated as one matrix: p for a full p × p covariance, 1 for separate
    /// variances.
    pub(super) dimension: f64,
    /// Number of states that share one variance: m where m variances are equal.
    pub(super) sharing_variance: f64,
    /// Variance of the sum's expectation due to errors of covariances and parameters, divided by `degrees`²; 2/(pN) in
    /// `of_tests`.
    pub(super) variance: f64,
    /// Expected increase of the sum by errors of the mean; np/N in `of_tests`.
    pub(super) of_mean: f64,
    /// Number of means that were estimated with the covariances.
    pub(super) means: f64,
    /// Whether the covariances are too small because the means were estimated: false by restricted likelihood.
    pub(super) is_biased: bool,
    /// Number of tests, or groups, that everything was estimated from.
    pub(super) tests: f64,
}

/// Relative variance below which covariances and parameters count as known.
const KNOWN_VARIANCE: f64 = 1e-12;

impl DistanceSum {
    /// Sum over `count` tests, compared with maximum-likelihood estimates from `tests` different tests that each
    /// determined all states exactly.
    pub(super) fn of_tests(count: f64, degrees: f64, tests: f64) -> DistanceSum {
        DistanceSum {
            count,
            degrees,
            dimension: degrees / count,
            sharing_variance: 1.0,
            variance: 2.0 * count / (degrees * tests),
            of_mean: degrees / tests,
            means: 1.0,
            is_biased: true,
            tests,
        }
    }

    /// Law of the sum; `None` where the estimates are from too few tests for a law.
    pub(super) fn law(&self) -> Option<Law> {
        let degrees_each = self.degrees / self.count;
        // h squares of one size replace the n squares, of which the errors of the means enlarge `means` squares
        let error = self.of_mean / degrees_each;
        let means = self.means.min(self.count).max(1.0);
        let (sum, squares) = (self.count + error, self.count - means + means * (1.0 + error / means).powi(2));
        let (h, size) = (sum * sum / squares, squares / sum);
        if self.variance < KNOWN_VARIANCE {
            let degrees = degrees_each * h;
            return Some(Law { scale: size * degrees, ..Law::chi_squared(degrees) });
        }
        let variance_degrees = 2.0 / (degrees_each * self.variance);
        let left = variance_degrees * (1.0 - self.bias(degrees_each, variance_degrees));
        let copies = degrees_each / (self.dimension * self.sharing_variance);
        let one = trace_law(self.dimension, h * self.sharing_variance, left * self.sharing_variance)?;
        Some(Law { scale: one.scale * variance_degrees * self.sharing_variance * size, ..one }.sum_of_copies(copies))
    }

    /// Relative amount by which maximum likelihood makes covariances too small. The number of tests follows from the
    /// errors of the mean and of the covariances together.
    fn bias(&self, degrees_each: f64, variance_degrees: f64) -> f64 {
        if !self.is_biased || self.of_mean <= 0.0 {
            return 0.0;
        }
        let error = self.of_mean / (self.count * degrees_each * self.means);
        let tests_from_errors = self.variance * degrees_each / (2.0 * error * error);
        let tests = variance_degrees.max(tests_from_errors.min(self.tests));
        self.means * (self.variance * degrees_each / (2.0 * tests)).sqrt()
    }
}

/// Law of tr W⁻¹B in p dimensions, where W has `degrees` and B has h degrees of freedom.
fn trace_law(p: f64, h: f64, degrees: f64) -> Option<Law> {
    let left = degrees - p;
    if h <= 1.0 {
        let denominator = left + 1.0;
        return (denominator > 0.0).then_some(Law { scale: p / denominator, numerator: p, denominator });
    }
    if left <= 1.0 {
        return None;
    }
    let a = p * h;
    let below = (left + h - 1.0) * (degrees - 1.0) - (left - 3.0) * left;
    let b = 4.0 + (a + 2.0) * (left - 3.0) * left / below;
    Some(Law { scale: a * (b - 2.0) / (b * (left - 1.0)), numerator: a, denominator: b })
}

impl Law {
    /// Law of the sum of `number` independent copies, from the mean and variance of the sum.
    fn sum_of_copies(self, number: f64) -> Law {
        let (a, b) = (self.numerator, self.denominator);
        if number == 1.0 || b <= 4.0 {
            return Law { scale: self.scale * number, numerator: a * number, ..self };
        }
        let (mean, variance) = (number * self.mean(), 2.0 * (a + b - 2.0) / (a * (b - 4.0)) / number);
        let numerator = number * a;
        let denominator = (2.0 * numerator - 4.0 + 4.0 * variance * numerator) / (variance * numerator - 2.0);
        Law { scale: mean * (denominator - 2.0) / denominator, numerator, denominator }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// n new tests of p states, compared with maximum-likelihood estimates from N tests that each determine all states
    /// exactly.
    fn exact(p: f64, n: f64, tests: f64) -> DistanceSum {
        DistanceSum::of_tests(n, n * p, tests)
    }

    #[test]
    fn one_test_has_the_law_of_hotelling() {
        // d (N - p) / (p (N + 1)) ~ F(p, N - p)
        for (p, tests) in [(1.0, 5.0), (2.0, 10.0), (4.0, 6.0), (3.0, 50.0)] {
            let found = exact(p, 1.0, tests).law().expect("enough tests");
            for (what, found, expected) in [
                ("scale", found.scale, p * (tests + 1.0) / (tests - p)),
                ("a", found.numerator, p),
                ("b", found.denominator, tests - p),
            ] {
                assert!((found - expected).abs() < 1e-9 * expected, "{what}: {found} against {expected}");
            }
        }
    }

    /// Three states that share one variance: three squares for each of N tests, less the three means.
    #[test]
    fn equal_variances_have_the_degrees_of_freedom_of_all() {
        let tests = 5.0;
        let sum = DistanceSum {
            dimension: 1.0,
            sharing_variance: 3.0,
            variance: 2.0 / (3.0 * tests),
            ..exact(3.0, 1.0, tests)
        };
        let found = sum.law().expect("enough tests");
        for (what, found, expected) in [
            ("scale", found.scale, 3.0 * (tests + 1.0) / (tests - 1.0)),
            ("a", found.numerator, 3.0),
            ("b", found.denominator, 3.0 * (tests - 1.0)),
        ] {
            assert!((found - expected).abs() < 1e-9 * expected, "{what}: {found} against {expected}");
        }
    }

    /// With one state of known mean, the law is that of the ratio of two variances.
    #[test]
    fn many_tests_of_one_state_have_the_law_of_fisher() {
        let sum = DistanceSum { of_mean: 0.0, means: 0.0, ..exact(1.0, 20.0, 12.0) };
        let found = sum.law().expect("enough tests");
        for (what, found, expected) in
            [("scale", found.scale, 20.0), ("a", found.numerator, 20.0), ("b", found.denominator, 12.0)]
        {
            assert!((found - expected).abs() < 1e-9 * expected, "{what}: {found} against {expected}");
        }
    }

    /// E tr W⁻¹B = E tr W⁻¹ · tr of one square, and Var from the moments of the inverse of a Wishart matrix, both
    /// written out.
    #[test]
    fn the_trace_has_its_moments() {
        let (p, n, tests) = (3.0, 8.0, 20.0);
        let found = exact(p, n, tests).law().expect("enough tests");
        let expected = tests * n * (1.0 + 1.0 / tests) * p / (tests - 1.0 - p - 1.0);
        assert!((found.mean() - expected).abs() < 1e-9 * expected, "{} against {expected}", found.mean());
        // with a known mean: Var = E[2h tr V²] + h² Var[tr V], V the inverse of W
        let known = DistanceSum { of_mean: 0.0, means: 0.0, ..exact(p, n, tests) }.law().expect("enough tests");
        let (nu, c) = (tests, (tests - p) * (tests - p - 1.0) * (tests - p - 3.0));
        // E[V_ii V_kk] and E[V_ik²] where W belongs to the unit matrix
        let same = 1.0 / ((nu - p - 1.0) * (nu - p - 3.0));
        let (pair, mixed) = ((nu - p - 2.0) / c, 1.0 / c);
        let (squared, both) = (p * same + p * (p - 1.0) * mixed, p * same + p * (p - 1.0) * pair);
        let variance = 2.0 * n * squared + n * n * (both - (p / (nu - p - 1.0)).powi(2));
        let expected = tests * variance.sqrt();
        assert!((known.std_dev() - expected).abs() < 1e-9 * expected, "{} against {expected}", known.std_dev());
    }

    #[test]
    fn too_few_tests_have_no_law() {
        assert_eq!(exact(4.0, 10.0, 6.0).law(), None);
        assert_eq!(exact(4.0, 1.0, 4.0).law(), None);
        assert!(exact(4.0, 1.0, 5.0).law().is_some());
    }

    #[test]
    fn what_is_known_has_the_law_of_chi_squared() {
        let sum = DistanceSum { variance: 0.0, of_mean: 0.0, means: 0.0, ..exact(2.0, 6.0, 10.0) };
        assert_eq!(sum.law(), Some(Law::chi_squared(12.0)));
    }

    #[test]
    fn tails_agree_where_one_way_takes_over_from_another() {
        // scipy.stats.f.sf(1.02, 9999, 9999), and that for 10001
        for (degrees, expected) in [(9999.0, 0.161_075_081_1), (10001.0, 0.161_050_885_2)] {
            let law = Law { scale: 1.0, numerator: degrees, denominator: degrees };
            let [_, above] = law.tails(1.02).expect("there are degrees");
            assert!((above - expected).abs() < 1e-6, "{degrees}: {above} against {expected}");
        }
    }
}
