//! Work that takes time: what is going on, for whoever waits, and whether they still do.

use std::time::Instant;

use kalfit::estimate::{Progress, Stage, Step};

use crate::failure::Failure;

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
    /// What the filters run over.
    size: Option<WorkSize>,
    /// When the search began to run the filters.
    searching: Option<Instant>,
}

/// What a run of the filters takes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WorkSize {
    pub(crate) tests: usize,
    pub(crate) rows: usize,
    pub(crate) states: usize,
}

/// Filter runs of most searches, from few to many free parameters.
const USUAL_RUNS: [f64; 2] = [50.0, 500.0];
/// Seconds from which it is said how long a search will take.
const LONG: f64 = 60.0;

impl<'a> JobWork<'a> {
    pub(crate) fn new(watch: &'a mut dyn JobWatch) -> JobWork<'a> {
        JobWork { began: Instant::now(), watch, slow: false, size: None, searching: None }
    }

    /// Time since the work began.
    pub(crate) fn seconds(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// Tells what the filters of a search will run over.
    pub(crate) fn takes(&mut self, size: WorkSize) {
        self.size = Some(size);
    }

    /// How long the search will take, once runs of the filters were made and where it is more than a minute.
    fn forecast(&mut self, filter_runs: usize) -> String {
        let began = *self.searching.get_or_insert_with(Instant::now);
        let Some(size) = self.size.filter(|_| filter_runs > 0) else { return String::new() };
        size.forecast(began.elapsed().as_secs_f64() / filter_runs as f64)
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

impl WorkSize {
    /// How long a search will take whose runs take so many seconds, where it is more than a minute.
    fn forecast(self, seconds: f64) -> String {
        if seconds * USUAL_RUNS[1] < LONG {
            return String::new();
        }
        let WorkSize { tests, rows, states } = self;
        let [least, most] = USUAL_RUNS.map(|runs| in_words(runs * seconds));
        format!(
            "; {} a run over {tests} tests, {rows} rows, {states} states: most searches take {least} to {most}",
            in_words(seconds)
        )
    }
}

/// A duration, roughly.
fn in_words(seconds: f64) -> String {
    match seconds {
        ..0.95 => format!("{seconds:.1} s"),
        ..90.0 => format!("{seconds:.0} s"),
        ..5400.0 => format!("{:.0} min", seconds / 60.0),
        _ => format!("{:.0} h", seconds / 3600.0),
    }
}

impl Progress for JobWork<'_> {
    fn step(&mut self, step: Step) {
        let slow = if self.slow { "; EM is slow here, the hybrid method takes fewer runs" } else { "" };
        self.say(|| {
            let far =
                step.decrement.map_or(String::new(), |d| format!(", {} standard errors from the optimum", rough(d)));
            format!("pass {}: log-likelihood {:.2}{far}{slow}", step.passes, step.log_likelihood)
        });
    }

    fn stage(&mut self, stage: Stage<'_>) {
        self.slow |= matches!(stage, Stage::Slow);
        let forecast = match stage {
            Stage::Filters { filter_runs } => self.forecast(filter_runs),
            _ => String::new(),
        };
        self.say(|| match stage {
            Stage::StartValues { filter_runs } => format!("start values: filter run {}", filter_runs + 1),
            Stage::Filters { filter_runs } => format!("search: filter run {}{forecast}", filter_runs + 1),
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
        let size = WorkSize { tests: 6, rows: 6_000_000, states: 3 };
        assert_eq!(size.forecast(0.1), "");
        assert_eq!(
            size.forecast(0.5),
            "; 0.5 s a run over 6 tests, 6000000 rows, 3 states: most searches take 25 s to 4 min"
        );
        assert_eq!([0.04, 7.0, 600.0, 9000.0].map(in_words), ["0.0 s", "7 s", "10 min", "2 h"]);
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
