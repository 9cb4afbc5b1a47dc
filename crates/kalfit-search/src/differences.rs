//! Columns of -∂²ℓ/∂α∂(α, μ, Σ), from differences of exact gradients.

use std::collections::BTreeMap;

use nalgebra::{DVector, RowDVector};

use crate::profile_likelihood::{FixedLawPoint, ProfileLikelihood, ProfilePoint};
use crate::sparsity::JacobianSparsity;

/// Step of a logarithm for differences to both sides.
const STEP: f64 = 1e-4;
/// Step of a logarithm for differences to one side.
const ONE_SIDED_STEP: f64 = 1e-6;
/// Range, in standard errors, in which the step of a value that is not positive should lie.
const STEP_RANGE: [f64; 2] = [1e-6, 3e-2];
/// Maximal number of times that steps are made longer or shorter.
const MAX_ATTEMPTS: usize = 5;

/// Input of the differences: likelihood, point, dependences, and one or two sides.
pub(super) struct Differences<'s> {
    pub(super) objective: &'s ProfileLikelihood<'s>,
    pub(super) iterate: &'s ProfilePoint,
    pub(super) test_dependences: &'s JacobianSparsity,
    /// Whether differences are two-sided.
    pub(super) central: bool,
}

/// Columns of -∂²ℓ/∂α∂(α, μ, Σ) for the values of one colour, which have no common test.
#[derive(Default)]
pub(super) struct ColourColumns {
    /// -∂²ℓ/∂α∂α, by (row: any value, column: value of the colour).
    pub(super) own: BTreeMap<(usize, usize), f64>,
    /// -∂²ℓ/∂α∂(μ, Σ) along the tangent basis, as (value of the colour, 1 × m).
    pub(super) cross: Vec<(usize, RowDVector<f64>)>,
}

impl Differences<'_> {
    /// The columns of the values of a colour, from one run of the filters or two.
    pub(super) fn columns(&self, colour: &[usize]) -> ColourColumns {
        let Differences { objective, iterate, central, .. } = *self;
        let mut steps: Vec<f64> = colour.iter().map(|&s| first_step(objective, &iterate.values, s, central)).collect();
        let mut columns = ColourColumns::default();
        for attempt in 0..MAX_ATTEMPTS {
            let sides = sides(objective, iterate, (colour, &steps), central);
            let Some(sides) = sides.filter(|sides| widths(objective, colour, sides).values().all(|w| *w > 0.0)) else {
                if objective.is_waiting() {
                    break; // the sides are not known yet
                }
                steps.iter_mut().for_each(|h| *h *= 1e-2);
                continue;
            };
            columns = self.between(colour, &sides);
            let mut wrong = false;
            for (&s, h) in colour.iter().zip(&mut steps) {
                let own = columns.own.get(&(s, s)).copied().unwrap_or(0.0).abs().sqrt();
                let part = *h * own;
                if !objective.coordinates[s].log
                    && own > 0.0
                    && attempt < 3
                    && !(STEP_RANGE[0]..=STEP_RANGE[1]).contains(&part)
                {
                    *h = (STEP_RANGE[0] * STEP_RANGE[1]).sqrt() / own;
                    wrong = true;
                }
            }
            if !wrong {
                break;
            }
        }
        columns
    }

    /// The columns of a colour from the gradients on the two sides.
    fn between(&self, colour: &[usize], sides: &[FixedLawPoint; 2]) -> ColourColumns {
        let Differences { objective, test_dependences, .. } = *self;
        let width = widths(objective, colour, sides);
        let mut own = BTreeMap::new();
        let mut add = |s: usize, t: usize, value: f64| *own.entry((s, t)).or_insert(0.0) += value;
        let slope = |side: &FixedLawPoint, s: usize| objective.coordinates[s].slope(side.values[s]);
        for (j, by) in
            objective.order().iter().map(|&j| (j, test_dependences.of_test[j].iter().find(|s| width.contains_key(s))))
        {
            let Some(&by) = by else { continue };
            for (side, sign) in sides.iter().zip([-1.0, 1.0]) {
                for &(s, bar) in &side.tests.scores[j] {
                    add(s, by, sign * bar * slope(side, s) / width[&by]);
                }
            }
        }
        for &by in colour.iter().filter(|&&s| test_dependences.matrix[s] || test_dependences.is_common(s)) {
            for (side, sign) in sides.iter().zip([-1.0, 1.0]) {
                for &(s, bar) in &side.matrix {
                    add(s, by, sign * bar * slope(side, s) / width[&by]);
                }
            }
        }
        let cross = colour.iter().map(|&s| (s, self.cross((colour, s), sides).transpose() / width[&s])).collect();
        ColourColumns { own, cross }
    }

    /// Difference of the gradient along the tangent basis, for a value of a colour.
    fn cross(&self, (colour, s): (&[usize], usize), sides: &[FixedLawPoint; 2]) -> DVector<f64> {
        if colour.len() == 1 {
            return &sides[1].inner - &sides[0].inner;
        }
        let state = &self.iterate.estimate.state;
        let mut row = DVector::zeros(sides[0].inner.len());
        for &j in &self.test_dependences.tests[s] {
            let [before, after] = sides.each_ref().map(|side| state.gradient_of(side.tests.reductions.get(j)));
            row += after - before;
        }
        row
    }
}

/// Gradients on both sides of `iterate`, with the values of a colour moved; the lower side is `iterate` itself for
/// differences to one side.
fn sides(
    objective: &ProfileLikelihood<'_>,
    iterate: &ProfilePoint,
    (colour, steps): (&[usize], &[f64]),
    central: bool,
) -> Option<[FixedLawPoint; 2]> {
    let moved = |sign: f64| objective.shift(iterate, &moved_to_side(objective, &iterate.values, (colour, steps), sign));
    let upper = moved(1.0);
    let lower = if central || (upper.is_none() && !objective.is_waiting()) {
        moved(-1.0)
    } else {
        objective.at_iterate(iterate)
    };
    two_sides(upper, lower, || objective.at_iterate(iterate))
}

/// Two sides; where one of them is undefined, `iterate` takes its place.
pub fn two_sides<T>(upper: Option<T>, lower: Option<T>, iterate: impl FnOnce() -> Option<T>) -> Option<[T; 2]> {
    match (upper, lower) {
        (Some(upper), Some(lower)) => Some([upper, lower]),
        (Some(upper), None) => Some([upper, iterate()?]),
        (None, Some(lower)) => Some([iterate()?, lower]),
        (None, None) => None,
    }
}

/// Distance between the sides in each coordinate of a colour.
fn widths(objective: &ProfileLikelihood<'_>, colour: &[usize], sides: &[FixedLawPoint; 2]) -> BTreeMap<usize, f64> {
    let width = |&s: &usize| {
        let [upper, lower] = [sides[0].values[s], sides[1].values[s]];
        (s, if objective.coordinates[s].log { (upper / lower).ln() } else { upper - lower })
    };
    colour.iter().map(width).collect()
}

/// The values with those of a colour moved to one side.
fn moved_to_side(
    objective: &ProfileLikelihood<'_>,
    values: &[f64],
    (colour, steps): (&[usize], &[f64]),
    sign: f64,
) -> Vec<f64> {
    let mut values = values.to_vec();
    colour.iter().zip(steps).for_each(|(&s, h)| values[s] = objective.coordinates[s].moved(values[s], sign * h));
    values
}

/// First points that [`Differences::columns`] evaluates around given values, where all tests depend on every value.
pub(crate) fn first_points(
    objective: &ProfileLikelihood<'_>,
    values: &[f64],
    active: &[bool],
    central: bool,
) -> Vec<Vec<f64>> {
    let signs: &[f64] = if central { &[1.0, -1.0] } else { &[1.0] };
    let of = |s: usize| {
        let step = first_step(objective, values, s, central);
        signs.iter().map(move |sign| moved_to_side(objective, values, (&[s], &[step]), *sign))
    };
    (0..values.len()).filter(|&s| active[s]).flat_map(of).collect()
}

fn first_step(objective: &ProfileLikelihood<'_>, values: &[f64], s: usize, central: bool) -> f64 {
    objective.coordinates[s].step(values[s], if central { STEP } else { ONE_SIDED_STEP })
}
