//! Faults that are planted in ensembles: the model that is fitted does not have them.

use kalfit::FitRecord;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::drawn::{DrawnEnsemble, DrawnTest};

/// Ratios of units that are mistaken for each other: of angles, of a thousand, of lengths, and of accelerations.
const UNIT_RATIOS: [f64; 6] = [57.295_779_513, 0.017_453_292_5, 1000.0, 0.001, 0.3048, 9.806_65];
/// Number of stations, each with a disturbance of its own: with one the disturbance would be a drift common to all tests.
const STATIONS: usize = 3;

/// A fault of the data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    Clipping,
    CubicResponse,
    CommonDrift,
    SharedStation,
    WrongNoise,
    WrongUnit,
    Outlier,
    Lag,
}

pub(super) const FAULTS: [Fault; 8] = [
    Fault::Clipping,
    Fault::CubicResponse,
    Fault::CommonDrift,
    Fault::SharedStation,
    Fault::WrongNoise,
    Fault::WrongUnit,
    Fault::Outlier,
    Fault::Lag,
];

impl Fault {
    pub(super) fn name(self) -> &'static str {
        match self {
            Fault::Clipping => "values beyond a limit are cut off",
            Fault::CubicResponse => "a cubic response",
            Fault::CommonDrift => "a drift common to all tests",
            Fault::SharedStation => "tests of a station share a disturbance",
            Fault::WrongNoise => "a noise that is not the given one",
            Fault::WrongUnit => "one test in another unit",
            Fault::Outlier => "one wrong value",
            Fault::Lag => "an input that is one row late",
        }
    }

    /// Plants the fault, with a random size, in tests of gyros; what a verdict that names it holds.
    pub(super) fn plant(self, drawn: &mut DrawnEnsemble, random: &mut ChaCha8Rng) -> Option<Planted> {
        let (x, y, noise) = (drawn.column("x")?, drawn.column("y")?, drawn.noise()?);
        let tests = &mut drawn.tests;
        let mut size = |[least, most]: [f64; 2]| f64::exp(random.random_range(least.ln()..most.ln()));
        match self {
            Fault::Clipping => {
                let limit = size([0.6, 0.98]) * rows(tests).map(|row| row[y].abs()).fold(0.0, f64::max);
                rows_mut(tests).for_each(|row| row[y] = row[y].clamp(-limit, limit));
                Some(Planted::RowsOrMisfit(&["levels", "square"]))
            }
            Fault::CubicResponse => {
                let cubic = size([0.05, 3.0]);
                rows_mut(tests).for_each(|row| row[y] += cubic * row[x].powi(3));
                Some(Planted::Misfit(&["levels", "square"]))
            }
            Fault::CommonDrift => {
                let (amplitude, period) = (size([0.02, 1.0]), size([5.0, 60.0]));
                let add = |(k, row): (usize, &mut Vec<f64>)| row[y] += amplitude * (k as f64 / period).sin();
                of_first_phases(tests).for_each(|rows| rows.iter_mut().enumerate().for_each(add));
                Some(Planted::Misfit(&["steps", "record", "shared"]))
            }
            Fault::SharedStation => {
                let amplitude = size([0.03, 0.6]);
                let steps = tests.iter().map(|test| test.phases[0].len()).max()?;
                let disturbance: Vec<f64> = (0..steps * STATIONS).map(|_| amplitude * normal(random)).collect();
                for (test, rows) in of_first_phases(tests).enumerate() {
                    let station = test % STATIONS;
                    rows.iter_mut().zip(&disturbance[station * steps..]).for_each(|(row, add)| row[y] += add);
                }
                Some(Planted::Misfit(&["steps", "shared"]))
            }
            Fault::WrongNoise => {
                let ratio = size([1.05, 2.0]);
                Some(Planted::Noise(if random.random_bool(0.5) { ratio } else { 1.0 / ratio }))
            }
            Fault::WrongUnit => {
                let ratio = UNIT_RATIOS[random.random_range(0..UNIT_RATIOS.len())];
                let test = random.random_range(0..tests.len());
                tests[test].phases[0].iter_mut().for_each(|row| row[y] *= ratio);
                Some(Planted::Test(tests[test].id.clone()))
            }
            Fault::Outlier => {
                let deviation = noise * size([4.0, 100.0]);
                let test = random.random_range(0..tests.len());
                let row = random.random_range(0..tests[test].phases[0].len());
                tests[test].phases[0][row][y] += deviation;
                Some(Planted::Row(tests[test].id.clone()))
            }
            Fault::Lag => {
                for rows in of_first_phases(tests) {
                    (1..rows.len()).rev().for_each(|row| rows[row][x] = rows[row - 1][x]);
                }
                Some(Planted::Misfit(&["change"]))
            }
        }
    }
}

/// The content of a verdict that names a planted fault.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Planted {
    /// Mean terms.
    Misfit(&'static [&'static str]),
    /// Single rows, or mean terms where there are many of them.
    RowsOrMisfit(&'static [&'static str]),
    /// The size of all innovations; the given noise as a multiple of the true one.
    Noise(f64),
    /// A test.
    Test(String),
    /// A row of a test.
    Row(String),
}

impl Planted {
    /// Whether the check of a fit names the fault.
    pub(super) fn is_named(&self, record: &FitRecord) -> bool {
        let findings = || record.model_check.iter().flat_map(|check| &check.findings);
        match self {
            Planted::Misfit(terms) => {
                let least = record.misfit.as_ref().and_then(|misfit| misfit.terms.first());
                let is_found = findings().any(|finding| finding.kind == "misfit");
                is_found && least.is_some_and(|term| terms.contains(&term.term.as_str()))
            }
            Planted::RowsOrMisfit(terms) => {
                findings().any(|finding| finding.kind == "row") || Planted::Misfit(terms).is_named(record)
            }
            Planted::Noise(_) => findings().any(|finding| finding.kind == "mean_square"),
            Planted::Test(id) => findings().any(|finding| finding.text.contains(id.as_str())),
            Planted::Row(id) => findings().any(|finding| finding.kind == "row" && finding.text.contains(id.as_str())),
        }
    }
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

fn of_first_phases(tests: &mut [DrawnTest]) -> impl Iterator<Item = &mut Vec<Vec<f64>>> {
    tests.iter_mut().filter_map(|test| test.phases.first_mut())
}

fn rows(tests: &[DrawnTest]) -> impl Iterator<Item = &Vec<f64>> {
    tests.iter().flat_map(|test| test.phases.iter().flatten())
}

fn rows_mut(tests: &mut [DrawnTest]) -> impl Iterator<Item = &mut Vec<f64>> {
    of_first_phases(tests).flatten()
}
