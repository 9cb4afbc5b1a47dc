//! μ, Σ and α at the end of a search, and the ends of other searches.

use crate::joint::JointInformation;
use crate::{Method, SearchRecord, Settings, Standing};
use kalfit_estimate::{Estimate, Stop};
use kalfit_filter::reduce::Reductions;
use kalfit_model::{Alpha, Slots};

/// μ, Σ and α at the end of a search.
#[derive(Debug, Clone)]
pub struct DynamicFit {
    /// Every value of α.
    pub alpha: Alpha,
    /// Slots of the free values of α.
    pub slots: Slots,
    /// The free values, in the order of the slots.
    pub values: Vec<f64>,
    /// The free values as they are sought: covariances of noises as parts of their bounds.
    pub sought: Vec<f64>,
    /// Reductions at α, in the order of the tests.
    pub reductions: Reductions,
    /// μ and Σ at α, with a separate certificate.
    pub estimate: Estimate,
    /// Largest score of α in units of its standard error.
    pub certificate: f64,
    /// Why the search for α stopped.
    pub stop: Stop,
    /// How α was found.
    pub method: Method,
    /// ℓ after each accepted step.
    pub trace: Vec<f64>,
    /// Forward runs of the filters over all tests.
    pub filter_passes: usize,
    /// Backward runs over all tests.
    pub score_passes: usize,
    /// Passes over the reductions of all tests.
    pub passes: usize,
    /// Ends of the other searches, best first.
    pub others: Vec<OtherEnd>,
    /// Extent of the exploration for other maxima from the best end.
    pub explored: Explored,
    /// Runs of the stages, and what found the maximum.
    pub search: SearchRecord,
    /// Noise levels, by name, that raise ℓ without bound as all of them go to zero together: the data fit the model
    /// exactly. Empty where ℓ has a maximum.
    pub unbounded: Vec<String>,
    /// Observed information of (α, μ, Σ).
    pub joint: JointInformation,
    /// Standing of each free value, in the order of the slots.
    pub standing: Vec<Standing>,
    /// Settings of the search.
    pub settings: Settings,
}

impl DynamicFit {
    /// Standing of each free value, in the order of the slots.
    pub fn standing(&self) -> &[Standing] {
        &self.standing
    }

    /// Losses of ℓ, larger than `equal`, at which other starts ended at certified maxima.
    pub fn lower_maxima(&self, equal: f64) -> Vec<f64> {
        let certified = self.others.iter().filter(|end| end.stop == Stop::Certified);
        let gaps = certified.map(|end| self.estimate.log_likelihood - end.log_likelihood);
        gaps.filter(|gap| *gap > equal).collect()
    }
}

/// Extent of the exploration for other maxima from the best end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Explored {
    /// Not at all: one search takes long.
    No,
    /// In part: until the runs of the filters that may be spent on it were used up.
    Part,
    /// Completely, on a part of the data; on all of the data only where ℓ of that part was about as high elsewhere.
    Sample,
    /// Completely, on all of the data.
    Whole,
}

/// End of another search.
#[derive(Debug, Clone, PartialEq)]
pub struct OtherEnd {
    /// ℓ at that end.
    pub log_likelihood: f64,
    /// The free values of α, in the order of the slots.
    pub values: Vec<f64>,
    /// Why the search stopped.
    pub stop: Stop,
    /// Whether the search was given up because ℓ could not reach the best end.
    pub given_up: bool,
}
