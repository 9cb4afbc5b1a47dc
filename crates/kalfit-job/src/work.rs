//! Work that takes time: what is going on, for whoever waits, and whether they still do.

use std::time::Instant;

use kalfit::estimate::{Progress, Stage, Step};

use crate::failure::Failure;
use crate::forecast::SearchForecast;

/// How far something has come whose end is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgressShare {
    /// What is being done: the words of [`JobWatch::say`] begin with it.
    pub what: &'static str,
    /// So much of it is done.
    pub done: u64,
    /// Of so much.
    pub of: u64,
}

/// Somebody who waits for a job: heard in whatever thread works at it.
pub trait JobWatch: Send {
    /// Hears what is being done now. The words are made only when they are asked for.
    fn say(&mut self, what: &dyn Fn() -> String);

    /// Hears how far it is, where the end is known.
    fn share(&mut self, _: ProgressShare) {}

    /// True once the job is to end as soon as it can. A search for a fit ends where it is, with a result that says so; whatever
    /// else is under way ends with [`Failure::Interrupted`].
    fn stops(&self) -> bool {
        false
    }
}

/// Waits in silence.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unwatched;

impl JobWatch for Unwatched {
    fn say(&mut self, _: &dyn Fn() -> String) {}
}

/// A job under way.
pub(crate) struct JobWork<'a> {
    began: Instant,
    watch: &'a mut dyn JobWatch,
    /// The search gains slowly by the method that was asked for.
    slow: bool,
    /// How long the search will take, where tests are here.
    forecast: Option<SearchForecast>,
}

impl<'a> JobWork<'a> {
    pub(crate) fn new(watch: &'a mut dyn JobWatch) -> JobWork<'a> {
        JobWork { began: Instant::now(), watch, slow: false, forecast: None }
    }

    /// Time since the work began.
    pub(crate) fn seconds(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// Takes a forecast of the search, which is told with the progress.
    pub(crate) fn forecasts(&mut self, forecast: SearchForecast) {
        self.forecast = Some(forecast);
    }

    /// Says what is being done now.
    pub(crate) fn say(&mut self, what: impl Fn() -> String) {
        self.watch.say(&what);
    }

    /// Says how far it is.
    pub(crate) fn share(&mut self, what: &'static str, done: u64, of: u64) {
        self.watch.share(ProgressShare { what, done, of });
    }

    /// True when nobody waits any longer.
    pub(crate) fn is_stopped(&self) -> bool {
        self.watch.stops()
    }

    /// Goes on, if somebody still waits.
    ///
    /// # Errors
    /// Nobody does.
    pub(crate) fn go_on(&self) -> Result<(), Failure> {
        if self.is_stopped() { Err(Failure::Interrupted) } else { Ok(()) }
    }
}

impl Progress for JobWork<'_> {
    fn step(&mut self, step: Step) {
        let slow = if self.slow { "; EM is slow here, the hybrid method takes fewer runs" } else { "" };
        let forecast = self.forecast.map_or(String::new(), |forecast| forecast.after(step.passes));
        self.say(|| {
            let far =
                step.decrement.map_or(String::new(), |d| format!(", {} standard errors from the optimum", rough(d)));
            format!("pass {}: log-likelihood {:.2}{far}{slow}{forecast}", step.passes, step.log_likelihood)
        });
    }

    fn stage(&mut self, stage: Stage<'_>) {
        self.slow |= matches!(stage, Stage::Slow);
        if let (Stage::Filters { filter_runs }, Some(forecast)) = (stage, &mut self.forecast) {
            forecast.begin(filter_runs);
        }
        self.say(|| match stage {
            Stage::StartValues { filter_runs } => format!("start values: filter run {}", filter_runs + 1),
            Stage::Filters { filter_runs } => format!("search: filter run {}", filter_runs + 1),
            Stage::Slow => "search: EM is slow here, the hybrid method takes fewer runs".to_owned(),
            Stage::Interval { of, is_upper, filter_runs } => {
                let end = if is_upper { "upper" } else { "lower" };
                let runs = if filter_runs > 0 { format!(": filter run {}", filter_runs + 1) } else { String::new() };
                format!("interval of {of}, {end} end{runs}")
            }
            _ => "fitting".to_owned(),
        });
    }

    fn stops(&self) -> bool {
        self.is_stopped()
    }
}

/// Two digits of a distance.
fn rough(distance: f64) -> String {
    if (0.1..10.0).contains(&distance) {
        format!("{distance:.1}")
    } else if (10.0..1e6).contains(&distance) {
        format!("{distance:.0}")
    } else {
        format!("{distance:.0e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct LastWords(String);

    impl JobWatch for LastWords {
        fn say(&mut self, what: &dyn Fn() -> String) {
            self.0 = what();
        }
    }

    #[test]
    fn steps_and_stages_are_told_in_words() {
        let mut last = LastWords(String::new());
        let mut told = |tell: &dyn Fn(&mut JobWork<'_>)| {
            tell(&mut JobWork::new(&mut last));
            last.0.clone()
        };
        let step = |decrement| Step { passes: 4, log_likelihood: 926_723.209_2, decrement };
        let far = told(&|work| work.step(step(Some(4.6))));
        assert_eq!(far, "pass 4: log-likelihood 926723.21, 4.6 standard errors from the optimum");
        assert_eq!(told(&|work| work.step(step(None))), "pass 4: log-likelihood 926723.21");
        assert_eq!(told(&|work| work.stage(Stage::StartValues { filter_runs: 0 })), "start values: filter run 1");
        assert_eq!(told(&|work| work.stage(Stage::Filters { filter_runs: 11 })), "search: filter run 12");
        let interval = |filter_runs| Stage::Interval { of: "`tau1`", is_upper: filter_runs == 0, filter_runs };
        assert_eq!(told(&|work| work.stage(interval(0))), "interval of `tau1`, upper end");
        assert_eq!(told(&|work| work.stage(interval(7))), "interval of `tau1`, lower end: filter run 8");
        let slowly = told(&|work| {
            work.stage(Stage::Slow);
            work.step(step(None));
        });
        assert_eq!(slowly, "pass 4: log-likelihood 926723.21; EM is slow here, the hybrid method takes fewer runs");
        assert_eq!([0.04, 0.5, 12.3, 3e8].map(rough), ["4e-2", "0.5", "12", "3e8"]);
    }
}
