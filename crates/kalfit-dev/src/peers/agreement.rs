//! Whether two programs found the same: before that is sure, no times are compared.

use kalfit::FitRecord;
use kalfit::record::CovarianceRecord;

use super::answer::PeerAnswer;

/// What kalfit found, in the order of [`PeerAnswer::estimates`], each with its standard error.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct KalfitAnswer {
    pub(crate) log_likelihood: f64,
    pub(crate) estimates: Vec<(f64, f64)>,
}

/// How far apart two answers are that agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PeerAgreement {
    /// kalfit's log-likelihood less the peer's.
    pub(crate) log_likelihood: f64,
    /// Largest difference of an estimate, in its standard errors.
    pub(crate) estimates: f64,
}

/// A difference of log-likelihoods that no comparison of models sees, and rounding of a long sum.
fn allowed(log_likelihood: f64) -> f64 {
    0.01 + 1e-8 * log_likelihood.abs()
}

/// Largest difference of an estimate, in its standard errors.
const STANDARD_ERRORS: f64 = 0.05;

/// The lower triangle of a covariance by rows, each element with its standard error.
fn triangle(covariance: &CovarianceRecord) -> impl Iterator<Item = (f64, Option<f64>)> {
    let places = (0..covariance.estimate.len()).flat_map(|i| (0..=i).map(move |j| (i, j)));
    places.map(|(i, j)| (covariance.estimate[i][j], covariance.std_error[i][j]))
}

impl KalfitAnswer {
    /// Mean and covariance of the only phase, the parameters, all of which must be free, and the covariances of crossed
    /// factors and of levels of groups.
    pub(super) fn of(record: &FitRecord) -> Result<KalfitAnswer, String> {
        let [phase] = &record.phases[..] else { return Err("the fit has more than one phase".to_owned()) };
        let (mean, covariance) = (&phase.mean, &phase.covariance);
        let mean = mean.estimate.iter().copied().zip(mean.std_error.iter().copied());
        let covariance = triangle(covariance);
        let parameters = record.parameters.iter().map(|parameter| (parameter.estimate, parameter.std_error));
        let with_error = |(estimate, error): (f64, Option<f64>)| Some((estimate, error?));
        // the last level is that of the tests, whose covariance is that of the phase
        let outer = record.levels.split_last().map_or(&[][..], |(_, outer)| outer);
        let factors = record.crossed.iter().map(|factor| &factor.level);
        let groups = factors.chain(outer).flat_map(|level| triangle(&level.covariance));
        let all = mean.chain(covariance).chain(parameters).chain(groups);
        let estimates: Option<Vec<(f64, f64)>> = all.map(with_error).collect();
        let estimates = estimates.ok_or("an estimate of kalfit's has no standard error")?;
        Ok(KalfitAnswer { log_likelihood: record.log_likelihood, estimates })
    }

    /// The distance of an answer that agrees, or where it does not.
    pub(super) fn against(&self, theirs: &PeerAnswer) -> Result<PeerAgreement, String> {
        let log_likelihood = self.log_likelihood - theirs.log_likelihood;
        if log_likelihood.abs() > allowed(self.log_likelihood) {
            let (ours, theirs) = (self.log_likelihood, theirs.log_likelihood);
            return Err(format!("log-likelihood {theirs}, kalfit's {ours}"));
        }
        if self.estimates.len() != theirs.estimates.len() {
            let (ours, theirs) = (self.estimates.len(), theirs.estimates.len());
            return Err(format!("{theirs} estimates, kalfit has {ours}"));
        }
        let mut largest: f64 = 0.0;
        for (k, ((ours, error), theirs)) in self.estimates.iter().zip(&theirs.estimates).enumerate() {
            let distance = (ours - theirs).abs() / error;
            if distance > STANDARD_ERRORS {
                return Err(format!("estimate {} is {theirs}, kalfit's {ours} ± {error}", k + 1));
            }
            largest = largest.max(distance);
        }
        Ok(PeerAgreement { log_likelihood, estimates: largest })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::peers::clock::TimeTaken;

    fn ours() -> KalfitAnswer {
        KalfitAnswer { log_likelihood: -1000.0, estimates: vec![(10.0, 0.1), (2.0, 0.2)] }
    }

    fn theirs(log_likelihood: f64, estimates: &[f64]) -> PeerAnswer {
        let taken = TimeTaken { processor: 1.0, elapsed: 1.0 };
        PeerAnswer { program: "peer 1".to_owned(), log_likelihood, estimates: estimates.to_vec(), taken }
    }

    #[test]
    fn answers_agree_within_a_small_part_of_the_standard_errors() {
        let agreement = ours().against(&theirs(-1000.001, &[10.001, 2.004])).unwrap();
        assert!((agreement.log_likelihood - 0.001).abs() < 1e-9, "{agreement:?}");
        assert!((agreement.estimates - 0.02).abs() < 1e-9, "{agreement:?}");
    }

    #[test]
    fn answers_that_differ_are_told_by_what_differs() {
        let why = |theirs: &PeerAnswer| ours().against(theirs).unwrap_err();
        assert_eq!(why(&theirs(-1000.1, &[10.0, 2.0])), "log-likelihood -1000.1, kalfit's -1000");
        assert_eq!(why(&theirs(-999.9, &[10.0, 2.0])), "log-likelihood -999.9, kalfit's -1000");
        assert_eq!(why(&theirs(-1000.0, &[10.0])), "1 estimates, kalfit has 2");
        assert_eq!(why(&theirs(-1000.0, &[10.0, 2.1])), "estimate 2 is 2.1, kalfit's 2 ± 0.2");
    }
}
