//! What is going on, for people who wait: a line on a terminal after one second, nothing before and nothing elsewhere.

use std::io::IsTerminal;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use kalfit_job::{JobWatch, ProgressShare};

use crate::interrupt;

const PATIENCE: Duration = Duration::from_secs(1);
/// The line moves at least this often.
const TICK: Duration = Duration::from_millis(200);

/// The line.
pub(crate) struct ProgressLine {
    /// `None` where nobody would see it.
    shown: Option<TerminalLine>,
    way: Option<TimedShare>,
}

/// The way to an end that is known.
#[derive(Debug, Clone, Copy)]
struct TimedShare {
    share: ProgressShare,
    began: Instant,
}

impl TimedShare {
    /// Where it is now; a way of its own when it is about something else, or begins again.
    fn on(before: Option<TimedShare>, share: ProgressShare) -> TimedShare {
        match before {
            Some(way) if way.share.what == share.what && way.share.done <= share.done => TimedShare { share, ..way },
            _ => TimedShare { share, began: Instant::now() },
        }
    }
}

/// How far it is and how long it will take from there, as far as so much time can tell.
fn outlook(share: ProgressShare, took: Duration) -> String {
    let ProgressShare { done, of, .. } = share;
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

impl ProgressLine {
    /// The line of a command that begins now.
    pub(crate) fn new(quiet: bool) -> ProgressLine {
        let wanted = !quiet && std::io::stderr().is_terminal();
        ProgressLine { shown: wanted.then(TerminalLine::new), way: None }
    }

    /// Shows these words, with the outlook when they are about the way.
    fn show(&mut self, words: &str) {
        let Some(shown) = &self.shown else { return };
        let way = self.way.filter(|way| words.starts_with(way.share.what));
        let outlook = way.map_or(String::new(), |way| outlook(way.share, way.began.elapsed()));
        shown.say(format!("{words}{outlook}"));
    }
}

impl JobWatch for ProgressLine {
    fn say(&mut self, what: &dyn Fn() -> String) {
        if self.shown.is_some() {
            self.show(&what());
        }
    }

    fn share(&mut self, share: ProgressShare) {
        self.way = Some(TimedShare::on(self.way, share));
        self.show(share.what);
    }

    fn stops(&self) -> bool {
        interrupt::asked()
    }
}

/// A line on a terminal. A thread draws it once it is due, so that it is there in time whatever the work is at.
#[derive(Debug)]
struct TerminalLine {
    line: Arc<Mutex<LineContent>>,
    /// Gone when the line is to go.
    wanted: Option<Sender<()>>,
    drawer: Option<JoinHandle<()>>,
}

/// What is drawn, or will be.
#[derive(Debug)]
struct LineContent {
    words: String,
    bar: Option<ProgressBar>,
}

impl TerminalLine {
    fn new() -> TerminalLine {
        let began = Instant::now();
        let line = Arc::new(Mutex::new(LineContent { words: "starting".to_owned(), bar: None }));
        let (wanted, waits) = channel();
        let drawn = Arc::clone(&line);
        let draw = move || {
            if waits.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
                let mut line = drawn.lock().unwrap_or_else(PoisonError::into_inner);
                let bar = bar(began);
                bar.set_message(line.words.clone());
                bar.enable_steady_tick(TICK);
                line.bar = Some(bar);
            }
        };
        let drawer = std::thread::Builder::new().name("progress".to_owned()).spawn(draw).ok();
        TerminalLine { line, wanted: Some(wanted), drawer }
    }

    fn say(&self, words: String) {
        let mut line = self.line.lock().unwrap_or_else(PoisonError::into_inner);
        match &line.bar {
            Some(bar) => bar.set_message(words),
            None => line.words = words,
        }
    }
}

/// Takes the line away.
impl Drop for TerminalLine {
    fn drop(&mut self) {
        drop(self.wanted.take());
        if let Some(drawer) = self.drawer.take() {
            let _ = drawer.join();
        }
        if let Some(bar) = self.line.lock().unwrap_or_else(PoisonError::into_inner).bar.take() {
            bar.finish_and_clear();
        }
    }
}

fn bar(began: Instant) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr()).with_elapsed(began.elapsed());
    let style = ProgressStyle::with_template("{spinner} {elapsed} {msg}").expect("the template is sound");
    bar.set_style(style);
    bar
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share(done: u64, of: u64) -> ProgressShare {
        ProgressShare { what: "reading", done, of }
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
        let way = TimedShare { share: share(50, 100), began: long_ago };
        assert_eq!(TimedShare::on(Some(way), share(60, 100)).began, long_ago);
        assert!(TimedShare::on(Some(way), share(10, 100)).began > long_ago, "data are read a second time");
        assert!(TimedShare::on(Some(way), ProgressShare { what: "drawing", done: 60, of: 100 }).began > long_ago);
    }
}
