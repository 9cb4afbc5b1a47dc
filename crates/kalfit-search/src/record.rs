//! The record of a search: the runs of its stages, and what found the maximum.

use std::fmt;

use crate::profile_likelihood::ProfileLikelihood;
use crate::search_state::SearchEnd;

/// The record of a search for α.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SearchRecord {
    /// The stages, in order.
    pub stages: Vec<StageRuns>,
    /// Number of starts that were searched from.
    pub starts: usize,
    /// Origin of the start from which the maximum was found.
    pub found_by: Origin,
    /// Slots of noise levels that returned from zero on the way to the maximum.
    pub returned_from_zero: Vec<usize>,
}

/// Runs of the filters in a stage of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StageRuns {
    /// The stage.
    pub stage: SearchStage,
    /// Forward runs over all tests.
    pub filter_runs: usize,
    /// Backward runs over all tests.
    pub backward_runs: usize,
}

/// Stages of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SearchStage {
    /// Searches from the starts.
    Starts,
    /// Searches from candidates around the best end.
    Exploration,
    /// The search that certifies the end of a search without coefficients, or a search repeated from the best end.
    Certificate,
}

impl fmt::Display for SearchStage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            SearchStage::Starts => "starts",
            SearchStage::Exploration => "exploration",
            SearchStage::Certificate => "certificate",
        })
    }
}

/// Origin of a start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Origin {
    /// The given values, with a first guess from the data for the others.
    #[default]
    FirstStart,
    /// Noise attributed to the measurements instead of the motion, or the other way around.
    OtherBalance,
    /// A point scattered about the first start.
    Scattered,
    /// A random start that the settings request.
    Random,
    /// Another time constant.
    TimeConstant,
    /// Two coinciding processes merged into one.
    Merged,
    /// Two coinciding processes, one of which takes another size and shape.
    Separated,
    /// A noise level set to zero.
    WithoutLevel,
    /// Another covariance of two noises.
    Covariance,
    /// The variance of a process given to noise of a measurement.
    ProcessAsNoise,
    /// Noise of a measurement given to a process.
    NoiseAsProcess,
    /// A noise level at zero set to another size.
    LevelFromZero,
    /// Two unlike processes exchanged.
    Exchanged,
    /// All time constants scaled.
    ScaledTimes,
    /// A start from the data in place of given values.
    Data,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Origin::FirstStart => "the first start",
            Origin::OtherBalance => "a start with other shares of the noises",
            Origin::Scattered => "a scattered start",
            Origin::Random => "a random start",
            Origin::TimeConstant => "another time constant",
            Origin::Merged => "two processes merged",
            Origin::Separated => "two equal processes separated",
            Origin::WithoutLevel => "a noise level set to zero",
            Origin::Covariance => "another covariance of noises",
            Origin::ProcessAsNoise => "a process as measurement noise",
            Origin::NoiseAsProcess => "measurement noise as a process",
            Origin::LevelFromZero => "a noise level raised from zero",
            Origin::Exchanged => "two processes exchanged",
            Origin::ScaledTimes => "all time constants scaled",
            Origin::Data => "a start from the data",
        })
    }
}

/// A start of a search, or a candidate for one.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Candidate {
    pub(crate) values: Vec<f64>,
    pub(crate) origin: Origin,
}

impl From<&SearchEnd> for Candidate {
    fn from(end: &SearchEnd) -> Candidate {
        Candidate { values: end.restart(), origin: end.origin }
    }
}

impl Origin {
    /// Candidates of this origin.
    pub(crate) fn of(self, all: impl IntoIterator<Item = Vec<f64>>) -> impl Iterator<Item = Candidate> {
        all.into_iter().map(move |values| Candidate { values, origin: self })
    }
}

/// Stages of the searches so far.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stages {
    pub(crate) stages: Vec<StageRuns>,
    /// Number of starts that were searched from.
    pub(crate) starts: usize,
}

impl Stages {
    /// The result of work in a stage, whose runs are counted; a stage without runs is left out.
    pub(crate) fn run<T>(
        &mut self,
        objective: &ProfileLikelihood<'_>,
        stage: SearchStage,
        work: impl FnOnce() -> T,
    ) -> T {
        let counts = || [objective.filter_passes(), objective.score_passes()];
        let before = counts();
        let found = work();
        let now = counts();
        let [filter_runs, backward_runs] = [0, 1].map(|k| now[k] - before[k]);
        if filter_runs + backward_runs > 0 {
            self.stages.push(StageRuns { stage, filter_runs, backward_runs });
        }
        found
    }

    /// The record of a search that ended so.
    pub(crate) fn record(self, end: &SearchEnd) -> SearchRecord {
        SearchRecord {
            stages: self.stages,
            starts: self.starts,
            found_by: end.origin,
            returned_from_zero: end.returned.clone(),
        }
    }
}
