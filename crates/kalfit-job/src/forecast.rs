//! How long a search will take, told once runs of the filters have shown how long one takes.

use std::time::Instant;

use kalfit_report::seconds;

/// Filter runs of most searches: one free value takes some 50, three processes some 500.
const USUAL_RUNS: [f64; 2] = [50.0, 500.0];
/// Seconds from which it is told how long a search may take.
const LONG: f64 = 60.0;

/// The forecast of a search.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SearchForecast {
    tests: usize,
    rows: usize,
    states: usize,
    /// When the search began, and the number of runs before it.
    began: Option<(Instant, usize)>,
}

impl SearchForecast {
    /// The forecast of a search whose filters run over so many tests and rows, with so many estimated states.
    pub(crate) fn new(tests: usize, rows: usize, states: usize) -> SearchForecast {
        SearchForecast { tests, rows, states, began: None }
    }

    /// The search begins, after so many runs of the filters.
    pub(crate) fn begin(&mut self, runs: usize) {
        self.began = Some((Instant::now(), runs));
    }

    /// What is told after so many runs: nothing where the search takes no minute.
    pub(crate) fn after(self, runs: usize) -> String {
        let of_a_run = |(since, before): (Instant, usize)| match runs.checked_sub(before) {
            None | Some(0) => String::new(),
            Some(own) => self.words(since.elapsed().as_secs_f64() / own as f64),
        };
        self.began.map_or(String::new(), of_a_run)
    }

    fn words(self, of_a_run: f64) -> String {
        if of_a_run * USUAL_RUNS[1] < LONG {
            return String::new();
        }
        let SearchForecast { tests, rows, states, .. } = self;
        let [least, most] = USUAL_RUNS.map(|runs| seconds(runs * of_a_run));
        let run = seconds(of_a_run);
        format!("; a run (tests: {tests}, rows: {rows}, states: {states}) takes {run}, most searches {least} to {most}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_of_minutes_is_told_with_its_size() {
        let mut forecast = SearchForecast::new(6, 6_000_000, 3);
        assert_eq!(forecast.words(0.1), "");
        let told = "; a run (tests: 6, rows: 6000000, states: 3) takes 500 ms, most searches 25 s to 4.2 min";
        assert_eq!(forecast.words(0.5), told);
        forecast.begin(4);
        assert_eq!([forecast.after(4), forecast.after(5), forecast.after(0)], ["", "", ""]);
    }
}
