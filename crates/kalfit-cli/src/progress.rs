//! What is going on, for people who wait: a line on a terminal after one second, nothing before and nothing elsewhere.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use kalfit_job::Watch;

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

    /// Takes the line away.
    fn clear(&mut self) {
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

impl Watch for Line {
    fn say(&mut self, what: &dyn Fn() -> String) {
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
}
