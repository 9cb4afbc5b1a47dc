//! Whoever waits for what is inferred: told and asked from every thread that works at it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError, TryLockError};

use rayon::prelude::*;

use crate::holdable::Holdable;
use kalfit_estimate::{Progress, Stage, Step};
use kalfit_model::PhasedModel;

/// Progress that threads share.
pub struct SharedProgress<'p> {
    told: Mutex<ToldInterval<'p>>,
    /// Somebody asked for the end: that stays so.
    stopped: AtomicBool,
    /// Names of the elements of μ and Σ.
    names: Vec<String>,
}

struct ToldInterval<'p> {
    progress: &'p mut dyn Progress,
    /// The interval that was begun last, and its end.
    of: String,
    is_upper: bool,
    filter_runs: usize,
}

impl ToldInterval<'_> {
    fn tell(&mut self) {
        let ToldInterval { of, is_upper, filter_runs, .. } = self;
        self.progress.stage(Stage::Interval { of, is_upper: *is_upper, filter_runs: *filter_runs });
    }
}

impl<'p> SharedProgress<'p> {
    pub fn new(progress: &'p mut dyn Progress, model: Option<&PhasedModel>) -> SharedProgress<'p> {
        let told = Mutex::new(ToldInterval { progress, of: String::new(), is_upper: false, filter_runs: 0 });
        let names = model.map_or_else(Vec::new, PhasedModel::element_names);
        SharedProgress { told, stopped: AtomicBool::new(false), names }
    }

    /// True once nobody waits any longer.
    pub(crate) fn stops(&self) -> bool {
        if self.stopped.load(Ordering::Relaxed) {
            return true;
        }
        let stops = match self.told.try_lock() {
            Ok(told) => told.progress.stops(),
            Err(TryLockError::Poisoned(told)) => told.into_inner().progress.stops(),
            Err(TryLockError::WouldBlock) => false, // another thread asks
        };
        self.stopped.fetch_or(stops, Ordering::Relaxed);
        stops
    }

    /// One thing of each of so many, side by side; `None` when nobody waits any longer.
    pub(crate) fn each<T: Send>(&self, count: usize, one: impl Fn(usize) -> T + Sync + Send) -> Option<Vec<T>> {
        let wanted = |k: usize| (!self.stops()).then(|| one(k));
        (0..count).into_par_iter().map(wanted).collect()
    }

    /// Says which end of an interval is sought now, if somebody still waits.
    pub(crate) fn seeks(&self, of: &str, is_upper: bool) {
        if self.stops() {
            return;
        }
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        (told.of, told.is_upper) = (of.to_owned(), is_upper);
        told.tell();
    }

    /// Says that the filters are to run once more, if somebody still waits.
    pub(crate) fn goes_on(&self, filter_runs: usize) -> bool {
        if self.stops() {
            return false;
        }
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        told.filter_runs = filter_runs;
        if !told.of.is_empty() {
            told.tell();
        }
        true
    }

    /// What an interval of μ, of the regression coefficients or of Σ is of.
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

/// A search within an interval is asked to end like the rest, and its own steps are told to nobody.
impl Progress for &SharedProgress<'_> {
    fn step(&mut self, _: Step) {}

    fn stops(&self) -> bool {
        SharedProgress::stops(self)
    }
}
