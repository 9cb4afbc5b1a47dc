//! Where a search begins whose tests are in several places: what each of them suggests, put together.

use crate::dynamic::bench::Bench;
use crate::dynamic::{Coordinate, Settings, start};
use crate::estimate::Progress;
use crate::model::{PhasedModel, Slots};
use crate::reduce::PhasedTest;

/// The answer of one place to [`Question::Opening`](crate::remote::Question::Opening): its number of tests, and that many times the
/// coordinate of each start value and the logarithm of each size.
pub(crate) fn opening(
    model: &PhasedModel,
    tests: &[PhasedTest],
    (slots, settings): (&Slots, &Settings),
    progress: &mut dyn Progress,
) -> Vec<f64> {
    let bench = Bench::new(model, tests, slots, settings);
    let count = tests.len() as f64;
    let units = bench.units();
    let start = |(s, value): (usize, f64)| {
        let coordinate = &bench.coordinates[s];
        coordinate.of_value(if coordinate.log && value <= 0.0 { units[s] } else { value })
    };
    let starts = start::first(&bench, progress).into_iter().enumerate().map(start);
    let sizes = units.iter().map(|unit| unit.max(f64::MIN_POSITIVE).ln());
    let numbers = starts.chain(sizes).map(|x| count * x);
    std::iter::once(count).chain(numbers).collect()
}

/// What all places suggest: the mean over their tests.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Opening {
    pub(crate) tests: usize,
    pub(crate) start: Vec<f64>,
    pub(crate) units: Vec<f64>,
}

impl Opening {
    /// From the sum of the answers; `None` where they are not of these values.
    pub(crate) fn of(numbers: &[f64], coordinates: &[Coordinate]) -> Option<Opening> {
        let (tests, rest) = numbers.split_first()?;
        if rest.len() != 2 * coordinates.len() {
            return None;
        }
        let mean: Vec<f64> = rest.iter().map(|x| x / tests.max(1.0)).collect();
        let (starts, units) = mean.split_at(coordinates.len());
        let value = |(place, coordinate): (&f64, &Coordinate)| {
            let value = if coordinate.log { place.exp() } else { *place };
            value.clamp(coordinate.lower, coordinate.upper)
        };
        let start = starts.iter().zip(coordinates).map(value).collect();
        Some(Opening { tests: *tests as usize, start, units: units.iter().map(|unit| unit.exp()).collect() })
    }
}
