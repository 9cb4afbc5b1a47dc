//! Limits of the mean, and tolerance limits, which contain a given part of all tests.
//!
//! The estimates of the mean and of the variance over tests are treated as independent. For N tests that each determine
//! a quantity of variance s² with an error of variance r, the estimate of s² + r is distributed as (s² + r) χ²_ν/ν, and
//! the estimate of the mean has the variance (s² + r)/N; N and r follow from the standard errors. Given the estimates,
//! the mean and the variance are then distributed as (generalised confidence)
//!
//! ```text
//! s_c² = (s² + r)/c² - r,    m_c = m - Z √V / c,    c² = χ²_ν/ν,    Z ~ N(0, 1)
//! one side:   P(m_c + z_p s_c ≤ m + h) = γ
//! two sides:  P(Φ((m + h - m_c)/s_c) - Φ((m - h - m_c)/s_c) ≥ p) = γ
//! ```
//!
//! The limits are exact where r = 0, with the factors of the usual tables. By maximum likelihood the estimate of s² is
//! too small, because the means were estimated from the same tests; the limits are computed from s² without this bias.

use std::collections::HashMap;
use std::sync::Mutex;

use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

use crate::predict::root::{EarlierRoots, decreasing_root, increasing_root};
use crate::predict::widths::Widths;
use crate::predict::{Estimation, FewTestsDegrees, MeanLimits, Predicted};
use kalfit_infer::student_quantile;

/// Confidence, content and sides of limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// γ: fraction of all ensembles in which the limits hold; a half or more.
    pub confidence: f64,
    /// p: fraction of all tests that the tolerance limits are to contain; a half or more.
    pub content: f64,
    /// Whether p applies to both tolerance limits together or to each limit.
    pub sides: Sides,
}

/// Which tests count as beyond the tolerance limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sides {
    /// Tests on either side: p of all tests are between the limits.
    #[default]
    Two,
    /// Tests on one side: p of all tests are below the upper limit, and p above the lower one.
    One,
}

/// Degrees of freedom above which a variance is treated as known.
const KNOWN_DEGREES: f64 = 1e5;
/// Number of intervals in the sum that replaces an expectation over a normal variable.
const INTERVALS: usize = 40;
/// Half width of the range of the sum over `INTERVALS`, in standard deviations; the normal law is negligible beyond.
const HALF_RANGE: f64 = 6.7;

/// Computes limits of predictions. Factors are cached, because many values of a design have one factor.
#[derive(Debug)]
pub struct Bounds {
    limits: Limits,
    widths: Widths,
    known: Mutex<HashMap<[u64; 3], Option<f64>>>,
}

/// Largest number of factors that are cached.
const MOST_CACHED: usize = 1 << 16;

/// Estimates of the variance over tests and of the mean, with degrees of freedom.
struct VarianceEstimate {
    /// Variance s² over tests.
    variance: f64,
    /// s² + r, the variance over tests including the errors of the tests.
    scale: f64,
    /// Degrees of freedom ν of `scale`; infinite where the variance is known.
    degrees: f64,
    /// Variance V of the estimate of the mean.
    of_mean: f64,
    /// Degrees of freedom of V.
    degrees_of_mean: f64,
}

impl VarianceEstimate {
    /// Estimate of a value's variance; `None` where there are too few tests.
    fn of(value: &Predicted) -> Option<VarianceEstimate> {
        let estimation = value.estimation?;
        if let Some(few) = estimation.few_tests {
            return VarianceEstimate::of_few_tests(value, &estimation, few);
        }
        let (population, of_population) = (value.population, estimation.population);
        if of_population <= 0.0 {
            let variance = value.variance();
            let degrees = match estimation.variance > 0.0 {
                true => 2.0 * variance * variance / estimation.variance,
                false => f64::INFINITY,
            };
            let (of_mean, degrees_of_mean) = (estimation.mean, f64::INFINITY);
            return Some(VarianceEstimate { variance, scale: variance, degrees, of_mean, degrees_of_mean });
        }
        let lost = estimation.lost as f64;
        let tests_from_variance = 2.0 * population * population / of_population;
        let tests_from_errors =
            if estimation.mean > 0.0 { of_population / (2.0 * estimation.mean.powi(2)) } else { 0.0 };
        // number of tests that the errors of mean and variance imply together, at least the number that the error of
        // the variance implies alone
        let (degrees_left, inflation) = if estimation.is_restricted {
            // `tests_from_errors` is N² / (N - k)
            let tests =
                0.5 * (tests_from_errors + (tests_from_errors * (tests_from_errors - 4.0 * lost)).max(0.0).sqrt());
            (tests_from_variance.max(tests.min(estimation.tests) - lost), 1.0)
        } else {
            let tests = tests_from_variance.max(tests_from_errors.min(estimation.tests));
            (tests - lost, tests / (tests - lost))
        };
        if degrees_left < 0.5 {
            return None;
        }
        let seen = (0.5 * of_population * degrees_left * inflation).sqrt();
        let variance = population + (inflation - 1.0) * seen + value.process;
        let scale = variance.max(inflation * seen);
        let degrees = 2.0 * scale * scale / (estimation.variance + (inflation.powi(3) - 1.0) * of_population);
        let variance_estimate = VarianceEstimate {
            variance,
            scale,
            degrees,
            of_mean: estimation.mean * inflation,
            degrees_of_mean: degrees_left,
        };
        (degrees >= 0.5).then_some(variance_estimate)
    }

    /// Estimate of a value's variance by the laws of few tests (14.11).
    fn of_few_tests(value: &Predicted, estimation: &Estimation, few: FewTestsDegrees) -> Option<VarianceEstimate> {
        let variance = value.variance();
        let seen = few.seen.filter(|degrees| degrees.is_finite());
        let scale = seen.map_or(variance, |degrees| (0.5 * degrees * estimation.variance).sqrt().max(variance));
        let degrees = if estimation.variance > 0.0 { 2.0 * scale * scale / estimation.variance } else { f64::INFINITY };
        let found = VarianceEstimate { variance, scale, degrees, of_mean: estimation.mean, degrees_of_mean: few.mean };
        (degrees >= 0.5 && few.mean >= 0.5).then_some(found)
    }

    /// Degrees of freedom of the variance of the difference between a new test and the prediction, by Satterthwaite.
    /// The variance of the mean's estimate is taken to be proportional to s² + r.
    fn degrees_of_new_test(&self) -> f64 {
        if self.scale > 0.0 {
            self.degrees * ((self.variance + self.of_mean) / (self.scale + self.of_mean)).powi(2)
        } else {
            self.degrees
        }
    }

    /// Whether r = 0: then all half widths are proportional to 1/c, and no search for c is needed.
    fn has_no_test_error(&self) -> bool {
        self.scale <= self.variance
    }

    /// Standard deviation s_c.
    fn at(&self, c: f64) -> f64 {
        (self.scale / (c * c) - (self.scale - self.variance)).max(0.0).sqrt()
    }

    /// Approximate size of a half width of `width` standard deviations with confidence γ, by Wilson and Hilferty's
    /// quantile of χ².
    fn approximate_half_width(&self, confidence: f64, width: f64) -> f64 {
        let part = 2.0 / (9.0 * self.degrees);
        let root = 1.0 - part - normal().inverse_cdf(confidence) * part.sqrt();
        (width * self.at(root.max(0.2).powf(1.5))).max(self.variance.sqrt()).max(self.of_mean.sqrt())
    }

    /// P(χ²_ν/ν ≥ c²).
    fn upper_tail(&self, law: &ChiSquared, c: f64) -> f64 {
        if c <= 0.0 { 1.0 } else { law.sf(self.degrees * c * c) }
    }
}

impl Bounds {
    /// Limits with the given confidence, content and sides.
    pub fn new(limits: Limits) -> Bounds {
        Bounds { limits, widths: Widths::new(limits.content), known: Mutex::default() }
    }

    /// Normal quantile at (1 + γ)/2, for limits of the mean by profile likelihood.
    pub fn quantile(&self) -> f64 {
        normal().inverse_cdf(0.5 * (1.0 + self.limits.confidence))
    }

    /// Confidence, content and sides of the limits.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Limits that contain the mean over tests with confidence γ; `None` where the limits are not known.
    pub fn of_mean(&self, value: &Predicted) -> Option<[f64; 2]> {
        if let MeanLimits::Profile(found) = value.limits {
            return found;
        }
        let variance_estimate = VarianceEstimate::of(value).filter(|_| !value.is_drawn_to_zero)?;
        let upper = 0.5 * (1.0 + self.limits.confidence);
        let half = student_quantile(variance_estimate.degrees_of_mean, upper)? * variance_estimate.of_mean.sqrt();
        Some([value.mean - half, value.mean + half])
    }

    /// Limits that contain the value of one new test with probability p, Student's t with the degrees of freedom that
    /// come with them (14.12); infinite where the variance is known. `None` where the limits are not known.
    pub fn of_new_test(&self, value: &Predicted) -> Option<([f64; 2], f64)> {
        let own = VarianceEstimate::of(value).filter(|_| !value.hangs_on_zero && !value.is_drawn_to_zero)?;
        let few = value.estimation.and_then(|estimation| estimation.few_tests);
        let degrees = few.map_or_else(|| own.degrees_of_new_test(), |few| few.new_test);
        if degrees < 0.5 {
            return None;
        }
        let degrees = if degrees < KNOWN_DEGREES { degrees } else { f64::INFINITY };
        let half = student_quantile(degrees, 0.5 * (1.0 + self.limits.content))? * (own.variance + own.of_mean).sqrt();
        Some(([value.mean - half, value.mean + half], degrees))
    }

    /// Limits that contain p of all tests with confidence γ; `None` where the limits are not known, or where a variance
    /// that affects the limits was estimated as zero.
    pub fn of_tests(&self, value: &Predicted) -> Option<[f64; 2]> {
        let variance_estimate =
            VarianceEstimate::of(value).filter(|_| !value.hangs_on_zero && !value.is_drawn_to_zero)?;
        if variance_estimate.scale == 0.0 {
            return self.of_mean(&Predicted { limits: MeanLimits::Error, ..value.clone() });
        }
        let half = self.factor(&variance_estimate)? * variance_estimate.scale.sqrt();
        Some([value.mean - half, value.mean + half])
    }

    /// Factor h/√(s² + r), a function of s²/(s² + r), V/(s² + r) and ν.
    fn factor(&self, variance_estimate: &VarianceEstimate) -> Option<f64> {
        let [variance, of_mean] =
            [variance_estimate.variance, variance_estimate.of_mean].map(|x| x / variance_estimate.scale);
        let key = [variance, of_mean, variance_estimate.degrees].map(f64::to_bits);
        if let Some(known) = self.known.lock().ok().and_then(|known| known.get(&key).copied()) {
            return known;
        }
        let unit = VarianceEstimate { variance, scale: 1.0, of_mean, ..*variance_estimate };
        let found = match self.limits.sides {
            Sides::One => self.one_sided(&unit),
            Sides::Two => self.two_sided(&unit),
        };
        if let Ok(mut known) = self.known.lock()
            && known.len() < MOST_CACHED
        {
            known.insert(key, found);
        }
        found
    }

    /// h with P(m_c + z_p s_c ≤ m + h) = γ.
    fn one_sided(&self, variance_estimate: &VarianceEstimate) -> Option<f64> {
        let (z, mean_offset, s) = (
            normal().inverse_cdf(self.limits.content),
            variance_estimate.of_mean.sqrt(),
            variance_estimate.variance.sqrt(),
        );
        if variance_estimate.degrees >= KNOWN_DEGREES {
            return Some(z * s + mean_offset * normal().inverse_cdf(self.limits.confidence));
        }
        let law = ChiSquared::new(variance_estimate.degrees).ok()?;
        let confidence_at = |h: f64| {
            let mut earlier_roots = EarlierRoots::default();
            let needed = |x: f64, earlier_roots: &mut EarlierRoots| match variance_estimate.has_no_test_error() {
                true => (z * s - x * mean_offset) / h,
                false => decreasing_root(&|c| z * variance_estimate.at(c) - x * mean_offset / c, h, earlier_roots),
            };
            (0..=INTERVALS)
                .map(node)
                .map(|(x, weight)| weight * variance_estimate.upper_tail(&law, needed(x, &mut earlier_roots)))
                .sum()
        };
        increasing_root(
            &confidence_at,
            self.limits.confidence,
            variance_estimate.approximate_half_width(self.limits.confidence, z),
        )
    }

    /// h with P(Φ((m + h - m_c)/s_c) - Φ((m - h - m_c)/s_c) ≥ p) = γ.
    fn two_sided(&self, variance_estimate: &VarianceEstimate) -> Option<f64> {
        let (mean_offset, s) = (variance_estimate.of_mean.sqrt(), variance_estimate.variance.sqrt());
        if variance_estimate.degrees >= KNOWN_DEGREES {
            // the content falls as the mean moves further off
            return Some(
                s * self.widths.at(mean_offset / s * normal().inverse_cdf(0.5 * (1.0 + self.limits.confidence))),
            );
        }
        let law = ChiSquared::new(variance_estimate.degrees).ok()?;
        let size = s.max(0.1 * variance_estimate.scale.sqrt());
        let needed = |x: f64, c: f64| {
            let (s, mean_offset) = (variance_estimate.at(c), x.abs() * mean_offset / c);
            if s > mean_offset * 1e-9 { s * self.widths.at(mean_offset / s) } else { mean_offset }
        };
        // the two sides of the mean are symmetric
        let confidence_at = |h: f64| {
            let mut earlier_roots = EarlierRoots::default();
            let half = (INTERVALS / 2..=INTERVALS).map(node).map(|(x, weight)| {
                let both = if x > 0.0 { 2.0 } else { 1.0 };
                let c = match variance_estimate.has_no_test_error() {
                    true => needed(x, 1.0) / h,
                    false => decreasing_root(&|c| needed(x, c), h, &mut earlier_roots),
                };
                both * weight * variance_estimate.upper_tail(&law, c)
            });
            half.sum()
        };
        increasing_root(
            &confidence_at,
            self.limits.confidence,
            variance_estimate.approximate_half_width(self.limits.confidence, self.widths.at(mean_offset / size)),
        )
    }
}

fn normal() -> Normal {
    Normal::standard()
}

/// Node k of the normal law and its weight. Weighted sums over all nodes are expectations by the trapezoidal rule,
/// which is accurate to many digits for functions that fall off as the normal law does.
fn node(k: usize) -> (f64, f64) {
    let step = 2.0 * HALF_RANGE / INTERVALS as f64;
    let x = step * (k as f64 - 0.5 * INTERVALS as f64);
    (x, step * (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::predict::{Estimation, MeanLimits, What};

    /// N tests that determine y exactly: mean 0, and variance 1 after correction of the bias.
    fn of(tests: f64) -> Predicted {
        let ml = (tests - 1.0) / tests;
        let estimation = Estimation {
            mean: ml / tests,
            variance: 2.0 * ml * ml / tests,
            population: 2.0 * ml * ml / tests,
            lost: 1,
            is_restricted: false,
            tests: 1000.0,
            few_tests: None,
        };
        Predicted {
            what: What::Output(0),
            row: 0,
            mean: 0.0,
            population: ml,
            process: 0.0,
            hangs_on_zero: false,
            is_drawn_to_zero: false,
            estimation: Some(estimation),
            limits: MeanLimits::Error,
        }
    }

    fn limits(confidence: f64, content: f64, sides: Sides) -> Bounds {
        Bounds::new(Limits { confidence, content, sides })
    }

    /// (Tests, confidence, content, factor).
    type Row = (f64, f64, f64, f64);

    const ONE_SIDED: [Row; 5] = [
        (5.0, 0.9, 0.95, 3.399_833_958),
        (10.0, 0.95, 0.9, 2.354_640_132),
        (30.0, 0.9, 0.99, 2.883_724_685),
        (3.0, 0.95, 0.95, 7.655_900_133),
        (200.0, 0.9, 0.95, 1.793_323_993),
    ];

    const TWO_SIDED: [Row; 5] = [
        (5.0, 0.9, 0.95, 4.142_464_440),
        (10.0, 0.95, 0.9, 2.856_310_849),
        (30.0, 0.9, 0.99, 3.173_308_609),
        (3.0, 0.95, 0.95, 9.788_752_403),
        (100.0, 0.9, 0.95, 2.172_381_090),
    ];

    #[test]
    fn one_sided_factors_are_those_of_the_tables() {
        // by scipy.stats.nct.ppf(γ, n - 1, z_p √n) / √n
        for (tests, confidence, content, expected) in ONE_SIDED {
            let [lower, upper] = limits(confidence, content, Sides::One).of_tests(&of(tests)).expect("enough tests");
            assert!(
                (upper - expected).abs() < 1e-6 * expected,
                "{tests} {confidence} {content}: {upper} against {expected}"
            );
            assert_eq!(lower, -upper);
        }
    }

    #[test]
    fn two_sided_factors_are_those_of_the_tables() {
        // by quadrature over the mean and the variance with scipy
        for (tests, confidence, content, expected) in TWO_SIDED {
            let [_, upper] = limits(confidence, content, Sides::Two).of_tests(&of(tests)).expect("enough tests");
            assert!(
                (upper - expected).abs() < 1e-5 * expected,
                "{tests} {confidence} {content}: {upper} against {expected}"
            );
        }
    }

    /// By restricted likelihood the variance has no bias, and an error by N - 1 degrees of freedom.
    #[test]
    fn restricted_likelihood_has_the_same_limits() {
        for tests in [5.0, 10.0, 30.0] {
            let of_variance = 2.0 / (tests - 1.0);
            let estimation = Estimation {
                mean: 1.0 / tests,
                variance: of_variance,
                population: of_variance,
                lost: 1,
                is_restricted: true,
                tests: 1000.0,
                few_tests: None,
            };
            let restricted = Predicted { population: 1.0, estimation: Some(estimation), ..of(tests) };
            let bounds = limits(0.9, 0.95, Sides::Two);
            let [found, expected] = [&restricted, &of(tests)].map(|value| bounds.of_tests(value).expect("enough")[1]);
            assert!((found - expected).abs() < 1e-8, "{tests}: {found} against {expected}");
            let [found, expected] = [&restricted, &of(tests)].map(|value| bounds.of_mean(value).expect("enough")[1]);
            assert!((found - expected).abs() < 1e-8, "{tests}: {found} against {expected}");
        }
    }

    #[test]
    fn the_mean_has_the_law_of_t() {
        // scipy.stats.t.ppf(0.95, 9) / √10
        let [lower, upper] = limits(0.9, 0.95, Sides::Two).of_mean(&of(10.0)).expect("enough tests");
        let expected = 0.579_681_207;
        assert!((upper - expected).abs() < 1e-6, "{upper} against {expected}");
        assert_eq!(lower, -upper);
    }

    #[test]
    fn a_variance_that_is_known_leaves_quantiles() {
        let known = Predicted { estimation: Some(Estimation::default()), population: 4.0, ..of(10.0) };
        let [_, upper] = limits(0.9, 0.95, Sides::Two).of_tests(&known).expect("known");
        assert!((upper - 2.0 * 1.959_963_985).abs() < 1e-8, "{upper}");
        let [_, upper] = limits(0.9, 0.95, Sides::One).of_tests(&known).expect("known");
        assert!((upper - 2.0 * 1.644_853_627).abs() < 1e-8, "{upper}");
    }

    /// 30 tests that determine y with errors of three times its variance: r is recognised, instead of ν being about
    /// two.
    #[test]
    fn errors_of_the_tests_are_allowed_for() {
        let (tests, r) = (30.0, 3.0);
        let ml: f64 = 1.0 - (1.0 + r) / tests;
        let seen = ml + r;
        let of_population = 2.0 * seen * seen / tests;
        let estimation = Estimation {
            mean: seen / tests,
            variance: of_population,
            population: of_population,
            lost: 1,
            is_restricted: false,
            tests: 1000.0,
            few_tests: None,
        };
        let value = Predicted { population: ml, estimation: Some(estimation), ..of(30.0) };
        let variance_estimate = VarianceEstimate::of(&value).expect("enough tests");
        for (what, found, expected) in [
            ("s²", variance_estimate.variance, 1.0),
            ("s² + r", variance_estimate.scale, 4.0),
            ("ν", variance_estimate.degrees, 29.0),
            ("V", variance_estimate.of_mean, 4.0 / 30.0),
        ] {
            assert!((found - expected).abs() < 1e-9, "{what}: {found} against {expected}");
        }
    }

    #[test]
    fn one_test_tells_no_limits() {
        let estimation = Some(Estimation {
            mean: 1.0,
            variance: 2.0,
            population: 2.0,
            lost: 1,
            is_restricted: false,
            tests: 1000.0,
            few_tests: None,
        });
        let one = Predicted { population: 1.0, estimation, ..of(9.0) };
        assert_eq!(limits(0.9, 0.95, Sides::Two).of_tests(&one), None);
        assert_eq!(limits(0.9, 0.95, Sides::Two).of_mean(&Predicted { estimation: None, ..of(9.0) }), None);
    }
}
