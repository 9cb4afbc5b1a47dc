//! The innovations of one test and the summary of the innovations.

use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::innovations::Whiteness;
use crate::innovations::channels::{Channel, Channels};
use crate::innovations::innovation::Innovation;

/// The innovations of a test, in the order in which the filter takes the measurements, and a summary.
#[derive(Debug, Clone, PartialEq)]
pub struct Innovations {
    /// Id of the test.
    pub test: String,
    /// Each innovation, phase after phase.
    pub series: Vec<Innovation>,
    /// Summary of all innovations.
    pub summary: Summary,
    /// Log-likelihood of the test: Σ -½ (log 2πS + e²/S), plus log p of phases that are given otherwise than by rows.
    pub log_likelihood: f64,
}

/// Summary of innovations: number, size, mean and whiteness of the innovations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Number n of innovations. Measurements that can only have one value are not counted.
    pub count: usize,
    /// Normalised innovation squared, Σ e²/S; χ² with n degrees of freedom when the model is right.
    pub nis: f64,
    /// Probability of a NIS as small as this; `None` without innovations.
    pub lower_tail: Option<f64>,
    /// Probability of a NIS as large as this; `None` without innovations.
    pub upper_tail: Option<f64>,
    /// Mean of e/√S; N(0, 1/n) when the model is right. `None` without innovations.
    pub mean: Option<f64>,
    /// Test of whether the innovations are uncorrelated in time; `None` when there are too few.
    pub whiteness: Option<Whiteness>,
}

/// The innovations of one measurement of one phase.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Index of the phase.
    pub phase: usize,
    /// Index of the measurement in the phase's model.
    pub measurement: usize,
    /// Summary of the innovations of the measurement.
    pub summary: Summary,
}

impl Innovations {
    /// The innovations of a test with the summary; the last argument is log p of phases without innovations.
    pub(crate) fn new(test: String, series: Vec<Innovation>, other_log_density: f64) -> Innovations {
        // where gains are steady, S repeats
        let mut last = (f64::NAN, f64::NAN);
        let log = |one: &Innovation| {
            if one.variance != last.0 {
                last = (one.variance, (std::f64::consts::TAU * one.variance).ln());
            }
            last.1
        };
        let logs = series.iter().map(log).sum::<f64>();
        let all = series.iter().map(|one| one.standardised);
        let summary = Summary::of(all, Whiteness::of(Channels::of(&series).each().map(|one| one.standardised)));
        Innovations { test, log_likelihood: other_log_density - 0.5 * (logs + summary.nis), summary, series }
    }

    /// Summaries for each measurement of each phase that has innovations, in the order of phases and measurements. The
    /// summaries show which measurement does not behave as the model says.
    pub fn parts(&self) -> Vec<Part> {
        let part = |Channel { phase, measurement, standardised }: Channel<'_>| {
            let whiteness = Whiteness::of(std::iter::once(standardised));
            Part { phase, measurement, summary: Summary::of(standardised.iter().copied(), whiteness) }
        };
        Channels::of(&self.series).each().map(part).collect()
    }
}

impl Summary {
    /// Summary of innovations with these e/√S and this test of whiteness.
    fn of(standardised: impl ExactSizeIterator<Item = f64> + Clone, whiteness: Option<Whiteness>) -> Summary {
        let count = standardised.len();
        let nis = standardised.clone().map(|z| z * z).sum::<f64>();
        let mean = standardised.sum::<f64>() / count.max(1) as f64;
        let tails = tails(count, nis);
        Summary {
            count,
            nis,
            lower_tail: tails.map(|tails| tails.0),
            upper_tail: tails.map(|tails| tails.1),
            mean: (count > 0).then_some(mean),
            whiteness,
        }
    }

    /// Two-sided p-value of the NIS: twice the smaller tail. Innovations smaller than the model predicts count against
    /// the model too.
    ///
    /// `absorbed` is 0 where μ and Σ are known, p where they were estimated from this test among others. An estimate
    /// that follows the test makes its innovations small, but under any μ and Σ at least the residuals at the best ξ
    /// remain, χ² with n - p degrees of freedom. That law then gives the lower tail; when n ≤ p no NIS is too small.
    pub fn p_value(&self, absorbed: usize) -> Option<f64> {
        let (lower, upper) = (self.lower_tail?, self.upper_tail?);
        let lower = match (absorbed, self.count.saturating_sub(absorbed)) {
            (0, _) => lower,
            (_, 0) => 1.0,
            (_, left) => ChiSquared::new(left as f64).map_or(1.0, |chi| chi.cdf(self.nis)),
        };
        Some((2.0 * lower.min(upper)).min(1.0))
    }
}

/// Lower and upper tail probabilities of this value of χ², the smaller of them to full relative precision; `None`
/// without degrees of freedom.
fn tails(degrees_of_freedom: usize, square: f64) -> Option<(f64, f64)> {
    let chi = ChiSquared::new(degrees_of_freedom as f64).ok().filter(|_| degrees_of_freedom > 0)?;
    if square > degrees_of_freedom as f64 {
        let upper = chi.sf(square);
        return Some((1.0 - upper, upper));
    }
    let lower = chi.cdf(square);
    Some((lower, 1.0 - lower))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_of_long_series_are_those_of_the_normal_law() {
        // Wilson and Hilferty's cube root is good to 1e-4 of these tails when n is large
        for n in [1e4_f64, 1e6, 1e8] {
            let chi = ChiSquared::new(n).expect("positive");
            for z in [-3.0, 0.0, 2.0, 4.0] {
                let nis = n * (1.0 - 2.0 / (9.0 * n) + z * (2.0 / (9.0 * n)).sqrt()).powi(3);
                let expected = 0.5 * statrs::function::erf::erfc(z / std::f64::consts::SQRT_2);
                let (upper, lower) = (chi.sf(nis), chi.cdf(nis));
                assert!((upper / expected - 1.0).abs() < 2e-2, "n = {n}, z = {z}: {upper} {expected}");
                assert!((upper + lower - 1.0).abs() < 1e-9, "n = {n}, z = {z}: {upper} + {lower}");
            }
        }
        let far = Innovations::new("t".to_owned(), vec![huge(); 300], 0.0).summary;
        assert_eq!((far.upper_tail, far.lower_tail, far.p_value(2)), (Some(0.0), Some(1.0), Some(0.0)));
    }

    fn huge() -> Innovation {
        Innovation { phase: 0, step: 0, time: None, measurement: 0, value: 1e150, variance: 1.0, standardised: 1e150 }
    }
}
