//! What is going on, for people who wait: a line on a terminal after one second, nothing before and nothing elsewhere.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use kalfit_job::{Share, Watch};

use crate::interrupt;

const PATIENCE: Duration = Duration::from_secs(1);
/// The line moves at least this often.
const TICK: Duration = Duration::from_millis(200);

/// The line.
pub(crate) struct Line {
    began: Instant,
    wanted: bool,
    bar: Option<ProgressBar>,
    way: Option<Way>,
}

/// The way to an end that is known.
#[derive(Debug, Clone, Copy)]
struct Way {
    share: Share,
    began: Instant,
}

impl Way {
    /// Where it is now; a way of its own when it is about something else, or begins again.
    fn on(before: Option<Way>, share: Share) -> Way {
        match before {
            Some(way) if way.share.what == share.what && way.share.done <= share.done => Way { share, ..way },
            _ => Way { share, began: Instant::now() },
        }
    }
}

/// How far it is and how long it will take from there, as far as so much time can tell.
fn outlook(share: Share, took: Duration) -> String {
    let Share { done, of, .. } = share;
    if of == 0 {
        return String::new();
    }
    let part = done.min(of) as f64 / of as f64;
    let percent = format!(", {:.0} %", (100.0 * part).floor());
    if took < PATIENCE || part <= 0.0 || part >= 1.0 {
        return percent;
    }
    let seconds = (took.as_secs_f64() * (1.0 - part) / part).min(1e9);
    format!("{percent}, about {} left", HumanDuration(Duration::from_secs(seconds.ceil() as u64)))
}

impl Line {
    pub(crate) fn new(quiet: bool) -> Line {
        Line { began: Instant::now(), wanted: !quiet && std::io::stderr().is_terminal(), bar: None, way: None }
    }

    /// Shows these words, with the outlook when they are about the way.
    fn show(&mut self, words: &str) {
        let way = self.way.filter(|way| words.starts_with(way.share.what));
        let outlook = way.map_or(String::new(), |way| outlook(way.share, way.began.elapsed()));
        let bar = self.bar.get_or_insert_with(|| {
            let bar =
                ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr()).with_elapsed(self.began.elapsed());
            let style = ProgressStyle::with_template("{spinner} {elapsed} {msg}").expect("the template is sound");
            bar.set_style(style);
            bar.enable_steady_tick(TICK);
            bar
        });
        bar.set_message(format!("{words}{outlook}"));
    }

    /// True once there is something to show.
    fn is_due(&self) -> bool {
        self.wanted && self.began.elapsed() >= PATIENCE
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
        if self.is_due() {
            self.show(&what());
        }
    }

    fn share(&mut self, share: Share) {
        self.way = Some(Way::on(self.way, share));
        if self.is_due() {
            self.show(share.what);
        }
    }

    fn stops(&self) -> bool {
        interrupt::asked()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share(done: u64, of: u64) -> Share {
        Share { what: "reading", done, of }
    }

    #[test]
    fn the_time_left_is_what_the_rest_takes_at_the_pace_so_far() {
        let after = |done, of, seconds| outlook(share(done, of), Duration::from_secs(seconds));
        assert_eq!(after(25, 100, 10), ", 25 %, about 30 seconds left");
        assert_eq!(after(1, 2, 600), ", 50 %, about 10 minutes left");
        assert_eq!(after(999, 1000, 2), ", 99 %, about 1 second left");
        assert_eq!(after(1, u64::MAX, u64::MAX), ", 0 %, about 32 years left");
    }

    #[test]
    fn nothing_is_foretold_at_once_nor_at_either_end() {
        assert_eq!(outlook(share(25, 100), Duration::from_millis(10)), ", 25 %");
        assert_eq!(outlook(share(0, 100), Duration::from_secs(9)), ", 0 %");
        assert_eq!(outlook(share(100, 100), Duration::from_secs(9)), ", 100 %");
        assert_eq!(outlook(share(0, 0), Duration::from_secs(9)), "");
    }

    #[test]
    fn a_way_that_begins_again_is_timed_anew() {
        let long_ago = Instant::now().checked_sub(Duration::from_secs(60)).expect("the machine is up that long");
        let way = Way { share: share(50, 100), began: long_ago };
        assert_eq!(Way::on(Some(way), share(60, 100)).began, long_ago);
        assert!(Way::on(Some(way), share(10, 100)).began > long_ago, "data are read a second time");
        assert!(Way::on(Some(way), Share { what: "drawing", done: 60, of: 100 }).began > long_ago);
    }
}
