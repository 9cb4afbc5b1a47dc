//! Start of a search whose tests are in several places: the combined suggestions of all places.

use crate::exchangeable::ordered;
use crate::profile_likelihood::ProfileLikelihood;
use crate::sample::sample;
use crate::{Coordinate, Settings, fit, start};
use kalfit_estimate::Progress;
use kalfit_model::PhasedTest;
use kalfit_model::{PhasedModel, Slots};

/// Ratio of a start value to the size that the data suggest, up or down, beyond which the size replaces the value.
const MAX_RATIO: f64 = 1e4;

/// The answer of one place to [`Question::Opening`](kalfit_model::remote::Question::Opening): the number n of tests
/// there, n × the coordinate of each start value, and n × the logarithm of each size.
pub fn opening(
    model: &PhasedModel,
    tests: &[PhasedTest],
    (slots, settings): (&Slots, &Settings),
    progress: &mut dyn Progress,
) -> Vec<f64> {
    let objective = ProfileLikelihood::new(model, tests, slots, settings);
    let count = tests.len() as f64;
    let units = objective.units();
    let farthest = if start::all_given(&objective) { f64::INFINITY } else { MAX_RATIO };
    let start = |(s, value): (usize, f64)| {
        let (coordinate, unit) = (&objective.coordinates[s], units[s]);
        let is_far = coordinate.log && (value <= 0.0 || value / unit > farthest || unit / value > farthest);
        coordinate.of_value(if is_far { unit } else { value })
    };
    let starts = suggested(&objective, progress).into_iter().enumerate().map(start);
    let sizes = units.iter().map(|unit| unit.max(f64::MIN_POSITIVE).ln());
    let numbers = starts.chain(sizes).map(|x| count * x);
    std::iter::once(count).chain(numbers).collect()
}

/// The given start values; if some are missing, the end of the best search on a part of the tests.
fn suggested(objective: &ProfileLikelihood<'_>, progress: &mut dyn Progress) -> Vec<f64> {
    let sample = sample(objective.tests, true);
    let small = ProfileLikelihood::new(objective.model, &sample, objective.slots, objective.settings);
    let found = if start::all_given(objective) { None } else { fit::best(&small, progress) };
    let found = found.map(|values| ordered(&objective.twins, &values));
    found.unwrap_or_else(|| start::first(objective, progress))
}

/// Suggestions of all places, combined as means over all tests.
#[derive(Debug, Clone, PartialEq)]
pub struct SuggestedValues {
    pub(crate) tests: usize,
    /// Start of each free value: the mean of its coordinate over tests, within the bounds.
    pub start: Vec<f64>,
    /// Size of each free value: the geometric mean of the sizes that the data suggest.
    pub units: Vec<f64>,
}

impl SuggestedValues {
    /// The means from the sum of the answers of all places; `None` where the number of values differs.
    pub fn of(numbers: &[f64], coordinates: &[Coordinate]) -> Option<SuggestedValues> {
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
        Some(SuggestedValues { tests: *tests as usize, start, units: units.iter().map(|unit| unit.exp()).collect() })
    }
}
