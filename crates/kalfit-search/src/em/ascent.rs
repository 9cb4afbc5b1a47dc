//! Maximum of a smooth function in the coordinates of α, within their bounds, by limited-memory BFGS. The learnt
//! curvature serves after the next E-step, too, because the complete data change little.

use crate::profile_likelihood::ProfileLikelihood;

/// Maximal number of pairs (step, fall of the gradient).
const DEPTH: usize = 12;
/// Maximal number of steps of one maximisation.
const STEPS: usize = 60;
/// Predicted rise, relative to that of the first step, at which a maximisation ends.
const RELATIVE_GAIN: f64 = 1e-10;
/// Predicted rise at which a maximisation ends in any case.
const MIN_GAIN: f64 = 1e-18;
/// Longest first step of a coordinate, while the curvature is unknown.
const FIRST_STEP: f64 = 0.1;
/// Longest step of a logarithm.
const LONGEST: f64 = 1.5;

/// The curvature learnt so far, as pairs (step, fall of the gradient).
#[derive(Debug, Clone, Default)]
pub(super) struct Ascent {
    pairs: Vec<(Vec<f64>, Vec<f64>)>,
}

/// A function of the values and its gradient by the coordinates; `None` where it is not defined.
pub(super) type AscentFunction<'f> = dyn Fn(&[f64]) -> Option<(f64, Vec<f64>)> + 'f;

impl Ascent {
    /// Values near `values` at which `function` is maximal over the `free` values, and never lower than at the start.
    pub(super) fn maximise(
        &mut self,
        function: &AscentFunction<'_>,
        mut values: Vec<f64>,
        free: &[bool],
        objective: &ProfileLikelihood<'_>,
    ) -> Vec<f64> {
        let Some((mut value, mut gradient)) = function(&values) else { return values };
        let mut first = None;
        for _ in 0..STEPS {
            let inside = free_inside(objective, &values, &gradient, free);
            let step = self.direction(&gradient, &inside, objective);
            let promised = dot(&step, &gradient, &inside);
            let first = *first.get_or_insert(promised);
            if promised <= MIN_GAIN.max(RELATIVE_GAIN * first) {
                break;
            }
            let Some(next) = line_search(function, (&values, value), (&step, promised), objective) else {
                if self.pairs.is_empty() {
                    break;
                }
                self.pairs.clear(); // the learnt curvature is no longer valid
                continue;
            };
            let moved: Vec<f64> = (0..values.len())
                .map(|s| objective.coordinates[s].of_value(next.0[s]) - objective.coordinates[s].of_value(values[s]))
                .map(|d| if d.is_finite() { d } else { 0.0 })
                .collect();
            let fall: Vec<f64> = gradient.iter().zip(&next.2).map(|(old, new)| old - new).collect();
            self.learn(moved, fall, free);
            (values, value, gradient) = next;
        }
        values
    }

    fn learn(&mut self, step: Vec<f64>, fall: Vec<f64>, free: &[bool]) {
        let (own, size) = (dot(&step, &fall, free), dot(&fall, &fall, free) * dot(&step, &step, free));
        if own > 1e-10 * size.sqrt() {
            self.pairs.push((step, fall));
        }
        if self.pairs.len() > DEPTH {
            self.pairs.remove(0);
        }
    }

    /// The two loops of L-BFGS over the coordinates in `inside`.
    fn direction(&self, gradient: &[f64], inside: &[bool], objective: &ProfileLikelihood<'_>) -> Vec<f64> {
        let mut step: Vec<f64> = gradient.iter().zip(inside).map(|(g, own)| if *own { *g } else { 0.0 }).collect();
        let useful = |(s, y): &&(Vec<f64>, Vec<f64>)| dot(s, y, inside) > 0.0;
        let pairs: Vec<&(Vec<f64>, Vec<f64>)> = self.pairs.iter().filter(useful).collect();
        let mut weights = Vec::with_capacity(pairs.len());
        for (s, y) in pairs.iter().rev() {
            let weight = dot(s, &step, inside) / dot(s, y, inside);
            add(&mut step, -weight, y, inside);
            weights.push(weight);
        }
        let most = step.iter().fold(0.0, |most: f64, d| most.max(d.abs()));
        let scale = match pairs.last() {
            Some((s, y)) => dot(s, y, inside) / dot(y, y, inside),
            None => {
                if most > 0.0 {
                    (FIRST_STEP / most).min(1.0)
                } else {
                    0.0
                }
            }
        };
        step.iter_mut().for_each(|d| *d *= scale);
        for ((s, y), weight) in pairs.iter().zip(weights.iter().rev()) {
            let back = dot(y, &step, inside) / dot(s, y, inside);
            add(&mut step, weight - back, s, inside);
        }
        let far = |(s, d): (usize, &f64)| if objective.coordinates[s].log { d.abs() } else { 0.0 };
        let longest = step.iter().enumerate().map(far).fold(0.0, f64::max);
        if longest > LONGEST {
            step.iter_mut().for_each(|d| *d *= LONGEST / longest);
        }
        step
    }
}

/// Whether each value is free and not at a bound beyond which the function rises.
fn free_inside(objective: &ProfileLikelihood<'_>, values: &[f64], gradient: &[f64], free: &[bool]) -> Vec<bool> {
    let one = |s: usize| {
        let coordinate = &objective.coordinates[s];
        let pressed = coordinate.at_lower(values[s]) && gradient[s] <= 0.0
            || coordinate.at_upper(values[s]) && gradient[s] >= 0.0;
        free[s] && !pressed
    };
    (0..values.len()).map(one).collect()
}

/// The step, shortened until the function rises enough.
fn line_search(
    function: &AscentFunction<'_>,
    (values, value): (&[f64], f64),
    (step, promised): (&[f64], f64),
    objective: &ProfileLikelihood<'_>,
) -> Option<(Vec<f64>, f64, Vec<f64>)> {
    let slack = 1e-13 * value.abs().max(1.0);
    let mut part = 1.0;
    for _ in 0..30 {
        let next = objective.moved(values, step, part);
        if next == values {
            return None;
        }
        if let Some((new, gradient)) = function(&next) {
            let gain = new - value;
            if gain >= 1e-4 * part * promised || (promised * part <= slack && gain >= -slack) {
                return Some((next, new, gradient));
            }
        }
        part *= 0.4;
    }
    None
}

fn dot(a: &[f64], b: &[f64], mask: &[bool]) -> f64 {
    a.iter().zip(b).zip(mask).filter(|(_, mask)| **mask).map(|((a, b), _)| a * b).sum()
}

fn add(a: &mut [f64], weight: f64, b: &[f64], mask: &[bool]) {
    a.iter_mut().zip(b).zip(mask).filter(|(_, mask)| **mask).for_each(|((a, b), _)| *a += weight * b);
}
