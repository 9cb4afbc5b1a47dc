//! What is going on, for people who wait: a line on a terminal after one second, nothing before and nothing elsewhere.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use kalfit::estimate::{Progress, Step};

const PATIENCE: Duration = Duration::from_secs(1);

/// The line.
pub(crate) struct Line {
    began: Instant,
    wanted: bool,
    bar: Option<ProgressBar>,
}

impl Line {
    pub(crate) fn new(quiet: bool) -> Line {
        Line { began: Instant::now(), wanted: !quiet && std::io::stderr().is_terminal(), bar: None }
    }

    /// Time since the work began.
    pub(crate) fn seconds(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// Says what is being done now.
    pub(crate) fn say(&mut self, what: impl FnOnce() -> String) {
        if !self.wanted || self.began.elapsed() < PATIENCE {
            return;
        }
        let bar = self.bar.get_or_insert_with(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template("{spinner} {elapsed} {msg}").expect("the template is sound");
            bar.set_style(style);
            bar
        });
        bar.set_message(what());
        bar.tick();
    }

    /// Takes the line away.
    pub(crate) fn clear(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.clear();
    }
}

impl Progress for Line {
    fn step(&mut self, step: Step) {
        self.say(|| {
            let far = step.decrement.map_or(String::new(), |d| format!(", about {d:.1e} standard errors to go"));
            format!("fitting: pass {}, log-likelihood {:.4}{far}", step.passes, step.log_likelihood)
        });
    }
}
