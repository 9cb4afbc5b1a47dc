//! Progress of the inference, reported by every thread of the inference.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError, TryLockError};

use rayon::prelude::*;

use crate::holdable::Holdable;
use kalfit_estimate::{Progress, Stage, Step};
use kalfit_model::PhasedModel;

/// Progress reports shared between threads.
pub struct SharedProgress<'p> {
    reported: Mutex<ReportedInterval<'p>>,
    /// Whether a stop was requested; never reset.
    stopped: AtomicBool,
    /// Names of the elements of μ and Σ.
    names: Vec<String>,
}

struct ReportedInterval<'p> {
    progress: &'p mut dyn Progress,
    /// Name of the quantity whose interval was begun last.
    of: String,
    is_upper: bool,
    filter_runs: usize,
}

impl ReportedInterval<'_> {
    fn report(&mut self) {
        let ReportedInterval { of, is_upper, filter_runs, .. } = self;
        self.progress.stage(Stage::Interval { of, is_upper: *is_upper, filter_runs: *filter_runs });
    }
}

impl<'p> SharedProgress<'p> {
    /// Shares `progress` between threads; `model` names the elements of μ and Σ.
    pub fn new(progress: &'p mut dyn Progress, model: Option<&PhasedModel>) -> SharedProgress<'p> {
        let reported = Mutex::new(ReportedInterval { progress, of: String::new(), is_upper: false, filter_runs: 0 });
        let names = model.map_or_else(Vec::new, PhasedModel::element_names);
        SharedProgress { reported, stopped: AtomicBool::new(false), names }
    }

    /// Whether a stop was requested.
    pub(crate) fn stops(&self) -> bool {
        if self.stopped.load(Ordering::Relaxed) {
            return true;
        }
        let stops = match self.reported.try_lock() {
            Ok(reported) => reported.progress.stops(),
            Err(TryLockError::Poisoned(reported)) => reported.into_inner().progress.stops(),
            Err(TryLockError::WouldBlock) => false, // another thread asks
        };
        self.stopped.fetch_or(stops, Ordering::Relaxed);
        stops
    }

    /// Calls `one` for 0, …, `count` - 1 in parallel and collects the results; `None` once a stop is requested.
    pub(crate) fn each<T: Send>(&self, count: usize, one: impl Fn(usize) -> T + Sync + Send) -> Option<Vec<T>> {
        let wanted = |k: usize| (!self.stops()).then(|| one(k));
        (0..count).into_par_iter().map(wanted).collect()
    }

    /// Reports which end of an interval is computed now, unless a stop was requested.
    pub(crate) fn report_end(&self, of: &str, is_upper: bool) {
        if self.stops() {
            return;
        }
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        (reported.of, reported.is_upper) = (of.to_owned(), is_upper);
        reported.report();
    }

    /// Reports the number of filter runs so far; false once a stop is requested.
    pub(crate) fn goes_on(&self, filter_runs: usize) -> bool {
        if self.stops() {
            return false;
        }
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        reported.filter_runs = filter_runs;
        if !reported.of.is_empty() {
            reported.report();
        }
        true
    }

    /// Name, in words, of the quantity of an interval.
    pub(crate) fn name(&self, what: Holdable) -> String {
        let element =
            |i: usize| self.names.get(i).map_or_else(|| format!("state {}", i + 1), |name| format!("`{name}`"));
        match what {
            Holdable::Mean(i) => format!("the mean of {}", element(i)),
            Holdable::Coefficient(c) => format!("regression coefficient {}", c + 1),
            Holdable::StdDev(i) => format!("the standard deviation of {}", element(i)),
            Holdable::Correlation(i, j) => format!("the correlation of {} and {}", element(j), element(i)),
            Holdable::Covariance(i, j) => format!("the covariance of {} and {}", element(j), element(i)),
        }
    }
}

/// Progress of a search within an interval: stops are shared, and steps are not reported.
impl Progress for &SharedProgress<'_> {
    fn step(&mut self, _: Step) {}

    fn stops(&self) -> bool {
        SharedProgress::stops(self)
    }
}
