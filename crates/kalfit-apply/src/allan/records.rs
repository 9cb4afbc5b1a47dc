//! Allan's variance of records, estimated from all pairs of neighbouring spans; pairs may overlap.

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Largest deviation of a step from the usual step, as a fraction of the usual step.
const STEP_TOLERANCE: f64 = 0.1;
/// Smallest fraction of steps near the median at which the median is the usual step.
const MIN_USUAL_FRACTION: f64 = 0.5;

/// Allan's variance of records over spans of one length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The mean of ½(ȳ_2 - ȳ_1)² over all pairs of neighbouring spans in a stretch.
    pub variance: f64,
    /// Number of pairs of neighbouring spans in all stretches.
    pub pairs: usize,
    /// Effective degrees of freedom. A stretch of N values has M = N/m independent spans and adds max(⅔(M - 1), 1), no
    /// more than the overlapping estimate has under white noise, flicker noise or a random walk.
    pub degrees_of_freedom: f64,
}

impl Estimate {
    /// 95 % limits of the variance; the estimate is treated as a multiple of χ² with `degrees_of_freedom`.
    pub fn interval95(&self) -> Option<[f64; 2]> {
        let chi = ChiSquared::new(self.degrees_of_freedom).ok()?;
        let limit = |p: f64| self.variance * self.degrees_of_freedom / chi.inverse_cdf(p);
        Some([limit(0.975), limit(0.025)]).filter(|ends| ends.iter().all(|end| end.is_finite()))
    }
}

/// The usual step of records of (time, value): the median of the positive differences of times. `None` where no
/// difference is positive, or where less than half of the positive differences are within 10 % of the median.
pub fn median_step(records: &[Vec<(f64, f64)>]) -> Option<f64> {
    let differences = records.iter().flat_map(|record| record.windows(2)).map(|pair| pair[1].0 - pair[0].0);
    let mut steps: Vec<f64> = differences.filter(|step| *step > 0.0 && step.is_finite()).collect();
    let middle = steps.len() / 2;
    let step = *(steps.len() > middle).then(|| steps.select_nth_unstable_by(middle, f64::total_cmp).1)?;
    let usual = steps.iter().filter(|own| is_usual(**own, step)).count();
    (usual as f64 >= MIN_USUAL_FRACTION * steps.len() as f64).then_some(step)
}

fn is_usual(step: f64, usual: f64) -> bool {
    (step - usual).abs() <= STEP_TOLERANCE * usual
}

/// The values of a record of (time, value) in stretches without a gap: neighbouring values are in one stretch if the
/// times of the two values differ by `step`, to within 10 %.
pub fn stretches(record: &[(f64, f64)], step: f64) -> Vec<Vec<f64>> {
    let chunks = record.chunk_by(|before, after| is_usual(after.0 - before.0, step));
    chunks.map(|stretch| stretch.iter().map(|(_, value)| *value).collect()).collect()
}

/// Allan's variance over spans of m values; `None` where no stretch contains two spans.
pub fn estimate(stretches: &[Vec<f64>], m: usize) -> Option<Estimate> {
    let (mut sum, mut pairs, mut degrees_of_freedom) = (0.0, 0, 0.0);
    for stretch in stretches.iter().filter(|stretch| m > 0 && stretch.len() / 2 >= m) {
        // the mean cancels in the differences; sums of deviations from the mean lose fewer digits
        let mean = stretch.iter().sum::<f64>() / stretch.len() as f64;
        let sums = stretch.iter().scan(0.0, |sum, value| {
            *sum += value - mean;
            Some(*sum)
        });
        let sums: Vec<f64> = std::iter::once(0.0).chain(sums).collect();
        for start in 0..=stretch.len() - 2 * m {
            let difference = (sums[start + 2 * m] - 2.0 * sums[start + m] + sums[start]) / m as f64;
            sum += 0.5 * difference * difference;
        }
        pairs += stretch.len() - 2 * m + 1;
        degrees_of_freedom += (2.0 / 3.0 * (stretch.len() as f64 / m as f64 - 1.0)).max(1.0);
    }
    (pairs > 0).then(|| Estimate { variance: sum / pairs as f64, pairs, degrees_of_freedom })
}
