//! Innovations of selected tests in order of time, for charts: bounded, whatever the size of the ensemble.

use std::collections::BTreeMap;

use crate::InnovationRecord;
use crate::series::{AutocorrelationRecord, SeriesRecord, WindowRecord};
use kalfit_filter::innovations::{Innovation, Innovations};
use kalfit_model::PhasedModel;

/// Largest number of tests whose innovations are included: the least probable ones.
const MOST_TESTS: usize = 100;
/// Largest number of innovations of one test that are included one by one; of a longer test, only windows are included.
const MOST_ROWS: usize = 1000;
/// Largest number of innovations of all tests that are included one by one.
const MOST_ROWS_OF_ALL: usize = 20_000;
/// Largest number of windows of a test.
const MOST_WINDOWS: usize = 40;
/// Smallest size of a window, in innovations.
const LEAST_IN_WINDOW: usize = 5;
/// Largest lag of the autocorrelation.
const MOST_LAGS: usize = 20;
/// Largest number of measurements with separate autocorrelations; more measurements have one common autocorrelation.
const MOST_MEASUREMENTS: usize = 6;
/// Values are rounded to this many steps per unit, because they are for charts only.
const ROUNDING_STEPS: f64 = 1e4;

/// Collects innovations test by test, and retains those of the least probable tests.
#[derive(Debug, Default)]
pub struct SeriesKeeper {
    /// (p-value, test, series) of the retained tests, in order of p-value, then of id.
    retained: Vec<(f64, String, SeriesRecord)>,
}

impl SeriesKeeper {
    /// Takes the innovations of one test, which are retained if the test is among the least probable.
    pub fn offer(&mut self, found: &Innovations, figures: &InnovationRecord, model: &PhasedModel) {
        if found.series.is_empty() {
            return;
        }
        let white = figures.whiteness.as_ref().map(|w| w.p_value);
        let p = [figures.nis_p_value, white].into_iter().flatten().fold(2.0, f64::min);
        let place = self.retained.partition_point(|(q, id, _)| (*q, id.as_str()) < (p, found.test.as_str()));
        if place < MOST_TESTS {
            self.retained.insert(place, (p, found.test.clone(), SeriesRecord::new(&found.series, model)));
            self.retained.truncate(MOST_TESTS);
        }
    }

    /// Series of the retained tests, by test id.
    pub(super) fn into_series(self) -> BTreeMap<String, SeriesRecord> {
        let mut remaining = MOST_ROWS_OF_ALL;
        let mut retained = BTreeMap::new();
        for (_, id, mut series) in self.retained {
            if series.at.len() > remaining {
                (series.at, series.measurement, series.standardised) = Default::default();
            }
            remaining -= series.at.len();
            retained.insert(id, series);
        }
        retained
    }
}

impl SeriesRecord {
    fn new(series: &[Innovation], model: &PhasedModel) -> SeriesRecord {
        let mut index: BTreeMap<(usize, usize), usize> = BTreeMap::new();
        runs(series).for_each(|(owner, _)| {
            index.entry(owner).or_default();
        });
        index.values_mut().enumerate().for_each(|(i, place)| *place = i);
        // times may restart in each phase; step numbers do restart, so `StepCount` counts over all phases
        let timed = model.is_single() && series.iter().all(|one| one.time.is_some_and(f64::is_finite));
        let mut steps = StepCount::default();
        let at: Vec<f64> =
            series.iter().map(|one| one.time.filter(|_| timed).unwrap_or_else(|| steps.number(one) as f64)).collect();
        let is_short = series.len() <= MOST_ROWS;
        let rows = |of: &dyn Fn(usize) -> f64| (0..series.len()).filter(|_| is_short).map(of).collect();
        SeriesRecord {
            measurements: index.keys().map(|&key| name(model, key)).collect(),
            measurement: series.iter().filter(|_| is_short).map(|one| index[&(one.phase, one.measurement)]).collect(),
            standardised: rows(&|i| rounded(series[i].standardised)),
            timed,
            time_unit: model.shared().clock.unit.clone().filter(|_| timed),
            windows: windows(series, &at),
            autocorrelation: autocorrelations(series, model),
            at: rows(&|i| at[i]),
        }
    }
}

/// Counts steps over all phases of a test.
#[derive(Default)]
struct StepCount {
    phase: usize,
    steps_before: usize,
    last: usize,
}

impl StepCount {
    fn number(&mut self, one: &Innovation) -> usize {
        if one.phase != self.phase {
            (self.phase, self.steps_before) = (one.phase, self.last + 1);
        }
        self.last = self.steps_before + one.step;
        self.last
    }
}

/// (phase, measurement) of successive innovations of one measurement, and these innovations.
fn runs(series: &[Innovation]) -> impl Iterator<Item = ((usize, usize), &[Innovation])> {
    let owner = |one: &Innovation| (one.phase, one.measurement);
    series.chunk_by(move |a, b| owner(a) == owner(b)).map(move |run| (owner(&run[0]), run))
}

fn name(model: &PhasedModel, (phase, measurement): (usize, usize)) -> String {
    let of = &model.phases[phase];
    let name = &of.model.measurements[measurement].name;
    if model.is_single() { name.clone() } else { format!("{}: {name}", of.name) }
}

fn rounded(x: f64) -> f64 {
    if x.abs() < 1e9 { (x * ROUNDING_STEPS).round() / ROUNDING_STEPS } else { x.clamp(-f64::MAX, f64::MAX) }
}

fn windows(series: &[Innovation], at: &[f64]) -> Vec<WindowRecord> {
    let size = series.len().div_ceil(MOST_WINDOWS).max(LEAST_IN_WINDOW);
    let window = |(ones, at): (&[Innovation], &[f64])| WindowRecord {
        from: at[0],
        to: at[at.len() - 1],
        count: ones.len(),
        nis: ones.iter().map(|one| one.standardised * one.standardised).sum::<f64>().min(f64::MAX),
    };
    series.chunks(size).zip(at.chunks(size)).map(window).collect()
}

fn autocorrelations(series: &[Innovation], model: &PhasedModel) -> Vec<AutocorrelationRecord> {
    let mut channels: BTreeMap<(usize, usize), Vec<f64>> = BTreeMap::new();
    runs(series).for_each(|(owner, run)| {
        channels.entry(owner).or_default().extend(run.iter().map(|one| one.standardised));
    });
    let of = |measurement, z: &[&[f64]]| {
        let (count, lags) = autocorrelation(z)?;
        Some(AutocorrelationRecord { measurement, count, lags })
    };
    if channels.len() <= MOST_MEASUREMENTS {
        channels.iter().filter_map(|(&key, z)| of(Some(name(model, key)), &[z])).collect()
    } else {
        let all: Vec<&[f64]> = channels.values().map(Vec::as_slice).collect();
        of(None, &all).into_iter().collect()
    }
}

/// r_k = Σ z_t z_{t+k} / Σ z_t², sums over all channels; up to half as many lags as a channel has innovations.
fn autocorrelation(channels: &[&[f64]]) -> Option<(usize, Vec<f64>)> {
    let count = channels.iter().map(|z| z.len()).sum();
    let longest = channels.iter().map(|z| z.len()).max().unwrap_or(0);
    let largest = channels.iter().flat_map(|z| z.iter()).fold(0.0, |most: f64, x| most.max(x.abs()));
    let lags = (longest / 2).min(MOST_LAGS);
    if lags == 0 || largest == 0.0 || !largest.is_finite() {
        return None;
    }
    let mut sums = vec![NO_SUM; 1 + lags];
    for z in channels {
        // values are divided by the largest, so that no square overflows or vanishes
        let z: Vec<f64> = z.iter().map(|x| x / largest).collect();
        sums.iter_mut().zip(lagged_products(&z, lags)).for_each(|(sum, product)| *sum += product);
    }
    Some((count, sums[1..].iter().map(|sum| rounded(sum / sums[0])).collect()))
}

/// The sum of no numbers, which changes no number that is added, zeros of either sign included.
const NO_SUM: f64 = -0.0;

/// Σ_t z_t z_{t+k} for k = 0 … `lags`, all in one pass: each sum is in the order of t.
fn lagged_products(z: &[f64], lags: usize) -> Vec<f64> {
    let mut sums = vec![NO_SUM; 1 + lags];
    for window in z.windows(1 + lags) {
        sums.iter_mut().zip(window).for_each(|(sum, later)| *sum += window[0] * later);
    }
    let rest = &z[z.len().saturating_sub(lags)..];
    for (t, earlier) in rest.iter().enumerate() {
        sums.iter_mut().zip(&rest[t..]).for_each(|(sum, later)| *sum += earlier * later);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn autocorrelation_is_about_zero_and_over_all_channels() {
        let (count, lags) = autocorrelation(&[&[1.0, 2.0, -1.0, 3.0]]).unwrap();
        // (1·2 - 2·1 - 1·3)/15 and (-1·1 + 2·3)/15
        assert_eq!((count, lags), (4, vec![-0.2, 0.3333]));
        let (count, lags) = autocorrelation(&[&[1.0, 1.0], &[1.0, -1.0]]).unwrap();
        assert_eq!((count, lags), (4, vec![0.0]));
        assert_eq!(autocorrelation(&[&[0.0; 30]]), None);
        let huge = autocorrelation(&[&[1e200; 9]]).unwrap();
        assert!(huge.1.iter().all(|r| r.is_finite() && r.abs() <= 1.0), "{huge:?}");
    }

    #[test]
    fn windows_hold_every_innovation_once() {
        let one = |k: usize| Innovation {
            phase: 0,
            step: k,
            time: None,
            measurement: 0,
            value: 1.0,
            variance: 1.0,
            standardised: 2.0,
        };
        for n in [1, 4, 5, 201, 1234] {
            let series: Vec<Innovation> = (0..n).map(one).collect();
            let at: Vec<f64> = (0..n).map(|k| k as f64).collect();
            let windows = windows(&series, &at);
            assert!(windows.len() <= MOST_WINDOWS, "{n}: {}", windows.len());
            assert_eq!(windows.iter().map(|w| w.count).sum::<usize>(), n);
            assert_eq!(windows.iter().map(|w| w.nis).sum::<f64>(), 4.0 * n as f64);
            assert_eq!((windows[0].from, windows.last().unwrap().to), (0.0, (n - 1) as f64));
        }
    }
}
