//! Whether profile intervals end where they say: at each end of an interval the value is held, and all others are fitted from
//! several starts. The highest of these fits must lie χ²₁'s 95 % quantile, halved, below the maximum.

use kalfit::Labels;
use kalfit::dynamic::{self, DynamicFit};
use kalfit::estimate::{Silent, Stop};
use kalfit::infer::{Choices, DeletionChoice, DfChoice, IntervalKind, StdErrors, TestsChoice};
use kalfit::model::{Expression, Value};
use rand_chacha::ChaCha8Rng;

use super::drawn::DrawnModel;

/// Half of χ²₁'s 95 % quantile.
const DROP: f64 = 1.920_729_410_347_062;
/// Twice ℓ is met to this at an end.
const MET: f64 = 5e-3;
/// Starts at each end, beside the fit's own values and those that the data were drawn with.
const RANDOM: usize = 2;

/// The ends of one model's intervals.
#[derive(Default)]
pub(super) struct IntervalEnds {
    /// Ends that were held.
    pub(super) held: usize,
    /// Ends at which a fit is higher than it may be: the interval is too short.
    pub(super) short: usize,
    /// The most by which one is.
    pub(super) by: f64,
    /// Ends at which no fit is as high as it should be: the interval is too long.
    pub(super) long: usize,
}

/// Holds all ends of the intervals of a model's free values.
pub(super) fn ends(drawn: &DrawnModel, seed: u64, random: &mut ChaCha8Rng) -> IntervalEnds {
    let mut found = IntervalEnds::default();
    let model = drawn.free(None);
    let Some(fit) = drawn.fit(&model).filter(|fit| fit.stop == Stop::Certified) else { return found };
    let choices = Choices {
        std_errors: StdErrors::Observed,
        intervals: IntervalKind::Profile,
        df: DfChoice::None,
        deletion: DeletionChoice::None,
        tests: TestsChoice::None,
    };
    let data = (&Labels::default(), &drawn.tests[..]);
    let Ok((_, parameters)) = dynamic::infer(&model, data, &fit, choices, &mut Silent) else { return found };
    let of_noises = |slot: usize| {
        let named = |(.., c): &(usize, usize, Expression)| *c == Expression::Parameter(slot);
        drawn.model.phases.iter().any(|phase| phase.model.noise_covariance.iter().any(named))
    };
    // covariances of noises have no profile
    for (slot, parameter) in parameters.iter().enumerate().filter(|(slot, _)| !of_noises(*slot)) {
        for (side, end) in parameter.interval.into_iter().flatten().enumerate() {
            let Some(end) = end.filter(|end| *end != 0.0 && *end != fit.values[slot]) else { continue };
            let Some(highest) = highest(drawn, &fit, (slot, end), random) else { continue };
            let over = highest - (fit.estimate.log_likelihood - DROP);
            found.held += 1;
            found.short += usize::from(over > MET);
            found.long += usize::from(over < -MET);
            found.by = found.by.max(over);
            if over.abs() > MET {
                eprintln!(
                    "seed {seed}, {}: with {} held at {end:e}, its {}, the highest fit is {over:+.4} from where it should be; at {:?}\n{}",
                    drawn.kind,
                    drawn.model.shared().parameters[slot].name,
                    ["lower end", "upper end"][side],
                    fit.values,
                    drawn.text
                );
            }
        }
    }
    found
}

/// The highest ℓ of fits with the value of a slot held.
fn highest(drawn: &DrawnModel, fit: &DynamicFit, (slot, end): (usize, f64), random: &mut ChaCha8Rng) -> Option<f64> {
    let mut starts = vec![fit.values.clone(), drawn.truth.clone()];
    starts.extend((0..RANDOM).map(|_| drawn.scattered(random)));
    let value = |starts: &Vec<f64>| {
        let mut model = drawn.free(Some(starts));
        model.models_mut().for_each(|phase| phase.parameters[slot].value = Value::Fixed(end));
        drawn.fit(&model).map(|fit| fit.estimate.log_likelihood)
    };
    starts.iter().filter_map(value).max_by(f64::total_cmp)
}
