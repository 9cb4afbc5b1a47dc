//! Values of a test that has not been made, as figures of a plan: the mean of a state or output at a row, and the limit below
//! which 95 % of all tests stay.
//!
//! ```text
//! m = w'(μ, γ) + c,   s² = h'Σh + process noise           limit: m + 1.645 s
//! ```

use nalgebra::DVector;

use crate::predict::{Initial, Output, PredictError, Predicted, Predictor, What};
use kalfit_infer::dynamic::UnitInformation;
use kalfit_model::{Alpha, Level, PhasedModel, PhasedTest, Slots};

/// Quantile of the normal law at 95 %, by definition of the limit.
const LIMIT: f64 = 1.644_853_626_951_472_7;

/// A value at a row of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct MissionValue {
    /// The phase, by its index.
    pub phase: usize,
    /// The state or output.
    pub what: What,
    /// Row of the value, by its index within the phase.
    pub row: usize,
    /// Mean of the value over tests, and the limit that 95 % of tests stay below, in the units of the state or output.
    pub values: [f64; 2],
    /// Derivatives of both by the free coordinates of a plan.
    pub gradients: [DVector<f64>; 2],
}

/// Mean and variance of a value over tests.
struct ValueMoments {
    phase: usize,
    what: What,
    row: usize,
    moments: [f64; 2],
}

/// The values of a test at the parameters of candidates. `design`: the model for designs, with the outputs of each phase, and
/// its parameters; `slots`: the free values of α.
///
/// # Errors
/// Rows that have no value.
pub fn mission(
    (design, outputs, alpha): (&PhasedModel, &[Vec<Output>], &Alpha),
    test: &PhasedTest,
    (candidates, slots): (&UnitInformation, &Slots),
) -> Result<Vec<MissionValue>, PredictError> {
    let population = candidates.population();
    let initial = Initial::new(design, population);
    let tests = std::slice::from_ref(test);
    // mean and variance of each value
    let at = |alpha: &Alpha| -> Result<Vec<ValueMoments>, PredictError> {
        let predictor = Predictor::new(design, outputs, (alpha, &population.coefficients), None)?;
        let found = predictor.predict(tests, &[&initial])?;
        let phases = found.into_iter().flatten();
        let of_phase = phases.flat_map(|phase| {
            let values = phase.steps.into_iter().flat_map(|step| step.values);
            let of = move |one: Predicted| {
                let moments = [one.mean, one.variance()];
                ValueMoments { phase: phase.phase, what: one.what, row: one.row, moments }
            };
            values.map(of).collect::<Vec<_>>()
        });
        Ok(of_phase.collect())
    };
    let central = at(alpha)?;
    let predictor = Predictor::new(design, outputs, (alpha, &population.coefficients), None)?;
    let weights = predictor.means(tests, &initial, alpha)?;
    let mut sides = Vec::new();
    for (slot, own) in slots.slots().iter().enumerate() {
        let (values, width) = candidates.value_sides(slot);
        let moved = values.map(|value| {
            let mut alpha = alpha.clone();
            alpha.values[own.parameter] = Level::Common(value);
            at(&alpha)
        });
        let [below, above] = moved;
        sides.push((below?, above?, width));
    }
    let (first, p) = (candidates.values(), design.dimension());
    let coefficients = first + population.mean.len();
    let of = |(k, own): (usize, &ValueMoments)| {
        let [mean, variance] = own.moments;
        let (h, std_dev) = (&weights[k].weights, variance.max(0.0).sqrt());
        let mut by = [0, 1].map(|_| DVector::zeros(candidates.jacobian.nrows()));
        for (slot, (below, above, width)) in sides.iter().enumerate().filter(|(_, side)| side.2 != 0.0) {
            (0..2).for_each(|part| by[part][slot] = (above[k].moments[part] - below[k].moments[part]) / width);
        }
        (0..p).for_each(|i| by[0][first + i] = h[i]);
        (p..h.len()).for_each(|c| by[0][coefficients + c - p] = h[c]);
        for (e, (i, j)) in candidates.elements().enumerate() {
            let both = if i == j { 1.0 } else { 2.0 };
            by[1][first + candidates.means() + e] = both * h[i % p] * h[j % p];
        }
        let by_std_dev = if std_dev > 0.0 { &by[1] / (2.0 * std_dev) } else { &by[1] * 0.0 };
        let limit = &by[0] + by_std_dev * LIMIT;
        let free = |own: &DVector<f64>| candidates.jacobian.tr_mul(own);
        MissionValue {
            phase: own.phase,
            what: own.what,
            row: own.row,
            values: [mean, mean + LIMIT * std_dev],
            gradients: [free(&by[0]), free(&limit)],
        }
    };
    Ok(central.iter().enumerate().map(of).collect())
}
