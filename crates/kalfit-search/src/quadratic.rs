//! Quadratic model of ℓ in α about a point, with ℓ maximised over (μ, Σ).
//!
//! Noise levels enter the quadratic by logarithms or by variances. Where noises can replace each other, variances add
//! up: along such a ridge ℓ is straight in the variances, and bends in the logarithms. Far from any maximum, logarithms
//! are better. The change of the gradient over a step shows which of the two scales predicts better.

use nalgebra::{DMatrix, DVector};

use crate::Coordinate;
use crate::coordinates::in_variance;
use crate::joint::{JointInformation, positive_inverse, solved};
use crate::profile_likelihood::ProfilePoint;

/// The function of a level in which ℓ is taken to be quadratic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LevelScale {
    Logarithm,
    Variance,
}

/// Profile information -d²ℓ of some values, with ℓ maximised over (μ, Σ).
#[derive(Debug, Clone)]
pub struct ProfileInformation {
    slots: Vec<usize>,
    information: DMatrix<f64>,
    /// Scale of levels in `information`: the scale in which ℓ has been nearer to a quadratic.
    pub(super) level_scale: LevelScale,
}

impl ProfileInformation {
    /// The profile information at a point, from the joint information there; `None` where some value belongs to a
    /// single test.
    pub(super) fn of(
        coordinates: &[Coordinate],
        level_scale: LevelScale,
        (joint, place): (&JointInformation, &ProfilePoint),
    ) -> Option<ProfileInformation> {
        let (slots, mut information) = (joint.shared().to_vec(), joint.profile_information()?);
        if level_scale == LevelScale::Variance {
            for (i, &s) in slots.iter().enumerate() {
                if let Some(exponent) = coordinates[s].level {
                    information[(i, i)] = in_variance(information[(i, i)], exponent, place.gradient[s]);
                }
            }
        }
        Some(ProfileInformation { slots, information, level_scale })
    }

    /// The profile information for a given covariance of the values in `slots`, with levels in logarithms.
    pub fn of_covariance(slots: &[usize], covariance: &DMatrix<f64>) -> ProfileInformation {
        let (information, _) = positive_inverse(covariance, 0.0);
        ProfileInformation { slots: slots.to_vec(), information, level_scale: LevelScale::Logarithm }
    }

    /// The profile information at a maximum in the other scale of levels; the matrix is the same in both scales.
    pub(super) fn other(self) -> ProfileInformation {
        let level_scale = match self.level_scale {
            LevelScale::Logarithm => LevelScale::Variance,
            LevelScale::Variance => LevelScale::Logarithm,
        };
        ProfileInformation { level_scale, ..self }
    }

    /// The profile information of `factor` times the data.
    pub(super) fn times(self, factor: f64) -> ProfileInformation {
        ProfileInformation { information: self.information * factor, ..self }
    }
}

/// A point in the free values of α, with the gradient of ℓ.
#[derive(Debug, Clone, Copy)]
pub struct Iterate<'a> {
    /// The free values.
    pub values: &'a [f64],
    /// dℓ/dcoordinate of each free value.
    pub gradient: &'a [f64],
}

impl<'a> From<&'a ProfilePoint> for Iterate<'a> {
    fn from(solved: &'a ProfilePoint) -> Iterate<'a> {
        Iterate { values: &solved.values, gradient: &solved.gradient }
    }
}

/// Quadratic model of ℓ about a point.
#[derive(Debug)]
pub struct Quadratic<'b> {
    coordinates: &'b [Coordinate],
    /// Slots of the values that move.
    slots: Vec<usize>,
    /// Values at which a step of a variance equals one of the logarithm.
    about: Vec<f64>,
    level_scale: LevelScale,
    information: DMatrix<f64>,
}

impl<'b> Quadratic<'b> {
    /// The quadratic about a point where the curvature is known.
    pub fn about(coordinates: &'b [Coordinate], curvature: ProfileInformation, values: &[f64]) -> Quadratic<'b> {
        let ProfileInformation { slots, information, level_scale } = curvature;
        Quadratic { coordinates, slots, about: values.to_vec(), level_scale, information }
    }

    /// The exponent of a level that enters by its variance; `None` for other values.
    fn exponent(&self, s: usize) -> Option<f64> {
        self.coordinates[s].level.filter(|_| self.level_scale == LevelScale::Variance)
    }

    /// Change of a value's logarithm, at `value`, per unit of its coordinate in the quadratic.
    fn unit(&self, s: usize, value: f64) -> f64 {
        self.exponent(s).map_or(1.0, |exponent| (self.about[s] / value).powf(exponent))
    }

    fn over_slots(&self, one: impl Fn(usize) -> f64) -> DVector<f64> {
        DVector::from_iterator(self.slots.len(), self.slots.iter().map(|&s| one(s)))
    }

    /// Gradient of ℓ at a point, in the coordinates of the quadratic.
    fn gradient(&self, at: Iterate<'_>) -> DVector<f64> {
        self.over_slots(|s| at.gradient[s] * self.unit(s, at.values[s]))
    }

    /// Step from one point to another, in the coordinates of the quadratic.
    fn way(&self, from: Iterate<'_>, to: Iterate<'_>) -> DVector<f64> {
        self.over_slots(|s| {
            let place = |value: f64| match self.exponent(s) {
                Some(exponent) => (value / self.about[s]).powf(exponent) / exponent,
                None => self.coordinates[s].of_value(value),
            };
            place(to.values[s]) - place(from.values[s])
        })
    }

    /// Newton's step from a point, and the decrement; `None` where ℓ does not curve downward.
    pub fn step(&self, from: Iterate<'_>) -> Option<(DVector<f64>, f64)> {
        let gradient = self.gradient(from);
        let step = solved(&self.information, &gradient)?;
        let decrement = root(step.dot(&gradient))?;
        Some((step, decrement))
    }

    /// The values after a step; `None` where some logarithm goes farther than `longest`.
    pub(super) fn moved(&self, values: &[f64], step: &DVector<f64>, longest: f64) -> Option<Vec<f64>> {
        let mut moved = values.to_vec();
        for (&s, d) in self.slots.iter().zip(step.iter()) {
            let (coordinate, value) = (&self.coordinates[s], values[s]);
            moved[s] = match self.exponent(s) {
                Some(_) => coordinate.moved_as_variance(value, d * self.unit(s, value)),
                None => coordinate.moved(value, *d),
            };
            let way = if self.exponent(s).is_some() { (moved[s] / value).ln() } else { *d };
            if coordinate.log && (way.is_nan() || way.abs() > longest) {
                return None;
            }
        }
        Some(moved)
    }

    /// Updates the information by the change of the gradient between two points (Broyden, Fletcher, Goldfarb and
    /// Shanno's update); `false` where ℓ does not curve downward between them.
    pub fn update(&mut self, before: Iterate<'_>, after: Iterate<'_>) -> bool {
        let s = self.way(before, after);
        let y = self.gradient(before) - self.gradient(after);
        let (bend, turned) = (s.dot(&y), &self.information * &s);
        let own = s.dot(&turned);
        if !(bend > 1e-10 * s.norm() * y.norm() && own > 0.0 && bend.is_finite()) {
            return false;
        }
        self.information += &y * y.transpose() / bend - &turned * turned.transpose() / own;
        true
    }

    /// Error of the predicted gradient after a step: dℓ/dlogarithm of levels, and dℓ/dcoordinate of other values, minus
    /// the prediction from the point where the step began.
    pub(super) fn prediction_error(&self, before: Iterate<'_>, after: Iterate<'_>) -> DVector<f64> {
        let missed = self.gradient(after) - self.gradient(before) + &self.information * self.way(before, after);
        let units = self.over_slots(|s| self.unit(s, after.values[s]));
        missed.component_div(&units)
    }

    /// The size of a gradient, in standard errors; `None` where ℓ does not curve downward.
    pub(super) fn decrement_of(&self, gradient: &DVector<f64>) -> Option<f64> {
        root(solved(&self.information, gradient)?.dot(gradient))
    }

    /// Whether every value that moves is above its lower bound.
    pub(super) fn is_above_bounds(&self, values: &[f64]) -> bool {
        self.slots.iter().all(|&s| !self.coordinates[s].at_lower(values[s]))
    }

    /// Whether some level, by its logarithm, has a downward slope and a curvature below `times` that slope: such a
    /// level is on the way to zero.
    pub(super) fn has_vanishing_level(&self, at: Iterate<'_>, times: f64) -> bool {
        let has_vanishing_level = |(i, &s): (usize, &usize)| {
            let slope = at.gradient[s];
            self.coordinates[s].level.is_some() && slope < 0.0 && self.information[(i, i)] < times * slope.abs()
        };
        self.level_scale == LevelScale::Logarithm && self.slots.iter().enumerate().any(has_vanishing_level)
    }
}

/// Square root, with small negative squares from rounding taken as zero; `None` where the square is not finite.
fn root(square: f64) -> Option<f64> {
    square.is_finite().then(|| square.max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEST: [f64; 2] = [0.4, 2.5]; // variance, value
    const BENDS: [[f64; 2]; 2] = [[3.0, 0.8], [0.8, 1.2]];

    /// The coordinates of a standard deviation and of a value sought as it is.
    fn coordinates() -> [Coordinate; 2] {
        let value = Coordinate { log: false, level: None, lower: f64::NEG_INFINITY, upper: f64::INFINITY };
        [Coordinate { log: true, level: Some(2.0), lower: 0.0, upper: f64::INFINITY }, value]
    }

    /// Gradient (dℓ/dlog σ, dℓ/dvalue) of an ℓ that is quadratic in the variance and the value.
    fn gradient([sigma, x]: [f64; 2]) -> [f64; 2] {
        let off = [sigma * sigma - BEST[0], x - BEST[1]];
        let [v, x] = [0, 1].map(|i| -(BENDS[i][0] * off[0] + BENDS[i][1] * off[1]));
        [2.0 * sigma * sigma * v, x]
    }

    /// The quadratic about these values; the information on the level by its logarithm or by steps z that make its
    /// variance v (1 + 2z).
    fn about<'b>(coordinates: &'b [Coordinate], values: [f64; 2], scale: LevelScale) -> Quadratic<'b> {
        let change = 2.0 * values[0] * values[0]; // dv/dlog σ = dv/dz
        let mut information = DMatrix::from_fn(2, 2, |i, j| {
            BENDS[i][j] * (if i == 0 { change } else { 1.0 }) * (if j == 0 { change } else { 1.0 })
        });
        if scale == LevelScale::Logarithm {
            information[(0, 0)] -= 2.0 * gradient(values)[0];
        }
        let curvature = ProfileInformation { slots: vec![0, 1], information, level_scale: scale };
        Quadratic::about(coordinates, curvature, &values)
    }

    #[test]
    fn what_is_quadratic_in_a_variance_is_foreseen_by_it_and_not_by_its_logarithm() {
        let coordinates = coordinates();
        let (from, to) = ([1.1, 1.0], [0.7, 2.0]);
        let (slope, other) = (gradient(from), gradient(to));
        let (before, after) = (Iterate { values: &from, gradient: &slope }, Iterate { values: &to, gradient: &other });
        let by = |scale| about(&coordinates, from, scale).prediction_error(before, after);
        let (variance, logarithm) = (by(LevelScale::Variance), by(LevelScale::Logarithm));
        assert!(variance.amax() < 1e-12, "{variance}");
        assert!(logarithm.amax() > 0.1, "{logarithm}");
        let bent = in_variance(about(&coordinates, from, LevelScale::Logarithm).information[(0, 0)], 2.0, slope[0]);
        let expected = about(&coordinates, from, LevelScale::Variance).information[(0, 0)];
        assert!((bent - expected).abs() < 1e-13, "{bent} and {expected}");
    }

    #[test]
    fn a_step_in_variances_leads_to_the_maximum_of_what_is_quadratic_in_them() {
        let coordinates = coordinates();
        // the second step begins away from the point from which variances are measured
        for (home, from) in [([1.1, 1.0], [1.1, 1.0]), ([1.1, 1.0], [0.9, 3.0])] {
            let quadratic = about(&coordinates, home, LevelScale::Variance);
            let slope = gradient(from);
            let (step, decrement) = quadratic.step(Iterate { values: &from, gradient: &slope }).expect("downward");
            let found = quadratic.moved(&from, &step, 2.0).expect("not far");
            let expected = [BEST[0].sqrt(), BEST[1]];
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?} and {expected:?}");
            let off = [from[0] * from[0] - BEST[0], from[1] - BEST[1]];
            let lost: f64 =
                (0..2).flat_map(|i| (0..2).map(move |j| (i, j))).map(|(i, j)| off[i] * BENDS[i][j] * off[j]).sum();
            assert!((decrement * decrement - lost).abs() < 1e-12, "{} and {lost}", decrement * decrement);
            assert_eq!(quadratic.moved(&from, &step, 1e-3), None, "farther than that");
        }
    }

    #[test]
    fn steps_teach_the_information_along_them() {
        let coordinates = coordinates();
        let home = [1.1, 1.0];
        let mut quadratic = about(&coordinates, home, LevelScale::Variance);
        let exact = quadratic.information.clone();
        quadratic.information = DMatrix::identity(2, 2);
        let places = [home, [0.9, 1.4], [0.8, 2.9]];
        let slopes = places.map(gradient);
        let at = |k: usize| Iterate { values: &places[k], gradient: &slopes[k] };
        for k in 1..3 {
            assert!(quadratic.update(at(k - 1), at(k)));
            let missed = quadratic.prediction_error(at(k - 1), at(k));
            assert!(missed.amax() < 1e-13, "{missed}");
        }
        let along = quadratic.way(at(1), at(2));
        let (found, expected) = (&quadratic.information * &along, &exact * &along);
        assert!((&found - &expected).amax() < 1e-13, "{found} and {expected}");
        // between points over which the slope does not fall
        assert!(
            !quadratic.update(Iterate { gradient: &slopes[1], ..at(0) }, Iterate { gradient: &slopes[0], ..at(1) })
        );
    }

    #[test]
    fn of_a_level_at_zero_nothing_is_foreseen() {
        let coordinates = coordinates();
        let (from, to) = ([1.1, 1.0], [0.0, 2.0]);
        let (slope, other) = (gradient(from), gradient(to));
        let (before, after) = (Iterate { values: &from, gradient: &slope }, Iterate { values: &to, gradient: &other });
        for scale in [LevelScale::Variance, LevelScale::Logarithm] {
            let quadratic = about(&coordinates, from, scale);
            assert_eq!(quadratic.decrement_of(&quadratic.prediction_error(before, after)), None, "{scale:?}");
        }
    }
}
