//! How often intervals hold the truth.

use kalfit::record::Interval;

#[derive(Debug, Clone, Copy, Default)]
pub(super) struct IntervalTally {
    pub(super) held: u64,
    /// Fits without this interval.
    pub(super) without: u64,
}

impl IntervalTally {
    pub(super) fn add(&mut self, interval: Interval, truth: f64) {
        match interval {
            Some([low, high]) => {
                let inside = low.is_none_or(|low| low <= truth) && high.is_none_or(|high| truth <= high);
                self.held += u64::from(inside);
            }
            None => self.without += 1,
        }
    }

    /// Share of the intervals that held the truth; in brackets how many fits have none.
    pub(super) fn shown(&self, ensembles: u64) -> String {
        match (ensembles - self.without, self.without) {
            (0, _) => "-".to_owned(),
            (all, 0) => format!("{:.1} %", 100.0 * self.held as f64 / all as f64),
            (all, without) => format!("{:.1} % ({without})", 100.0 * self.held as f64 / all as f64),
        }
    }
}
