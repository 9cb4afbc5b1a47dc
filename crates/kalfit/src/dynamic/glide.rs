//! Steps between two looks at the second derivatives.
//!
//! Second derivatives cost a run of the filters for each value; the gradient comes with ℓ. After a step that kept its word what the
//! gradient has done on the way corrects the information (Broyden, Fletcher, Goldfarb and Shanno's update), and the next step costs
//! one run. The end is certified by differences all the same.

use nalgebra::{DMatrix, DVector};

use crate::dynamic::Method;
use crate::dynamic::bench::Solved;
use crate::dynamic::curvature::Curvature;
use crate::dynamic::iterate::{LONGEST, Search};
use crate::dynamic::joint::{Joint, solved};

/// Most steps before the next look.
const STEPS: usize = 12;
/// A step keeps its word when ℓ rises by this part of what it promised.
const KEPT: f64 = 0.2;
/// Levels sink in their variances, which are not looked at here: a slope below and a curvature about it leave that to others.
const SINKING: f64 = 2.5;

impl Search<'_, '_> {
    /// Goes on from where a step led; `before`: where it began, `joint` the information there.
    pub(super) fn glide(&mut self, joint: &Joint, before: &Solved) {
        if let Some(curvature) = Curvature::of(joint) {
            self.glide_on(curvature, (Some(before.clone()), true));
        }
    }

    /// The same, with nothing to learn from that step.
    pub(super) fn glide_by(&mut self, joint: &Joint) {
        if let Some(curvature) = Curvature::of(joint) {
            self.glide_on(curvature, (None, false));
        }
    }

    /// Goes on by a curvature at hand; `last`: where it was known, if that is not here; `learns`: it is corrected on the way.
    pub(super) fn glide_on(&mut self, curvature: Curvature, (mut last, learns): (Option<Solved>, bool)) {
        if self.bench.settings.method != Method::Hybrid {
            return;
        }
        let Curvature { slots, mut information } = curvature;
        for _ in 0..STEPS {
            let before = last.as_ref().filter(|_| learns);
            let learnt = before.is_none_or(|last| self.learn(&mut information, &slots, last));
            if !learnt || self.sinks(&information, &slots) {
                return;
            }
            let gradient = DVector::from_iterator(slots.len(), slots.iter().map(|&s| self.home.gradient[s]));
            let Some(step) = solved(&information, &gradient) else { return };
            let promised = 0.5 * step.dot(&gradient);
            let far = |(&s, d): (&usize, &f64)| self.bench.coordinates[s].log && d.abs() > LONGEST;
            let decrement = (2.0 * promised.max(0.0)).sqrt();
            self.glided = Some(decrement);
            if self.is_lost(decrement) {
                return;
            }
            if promised <= 0.05 * self.tolerance().powi(2) || slots.iter().zip(step.iter()).any(far) {
                return;
            }
            let mut values = self.home.values.clone();
            slots
                .iter()
                .zip(step.iter())
                .for_each(|(&s, d)| values[s] = self.bench.coordinates[s].moved(values[s], *d));
            let slack = 1e-12 * self.home.value().abs().max(1.0);
            let rises = |next: &Solved| next.value() >= self.home.value() + KEPT * promised - slack;
            let Some(next) = self.at(&values).filter(rises) else { return };
            let kept = slots.iter().all(|&s| !self.bench.coordinates[s].at_lower(next.values[s]));
            last = Some(std::mem::replace(&mut self.home, next));
            self.tell(decrement);
            if !kept || self.stops() {
                return;
            }
        }
    }

    /// What the gradient did between the last place and this one; `false` where that is not the way of a maximum.
    fn learn(&self, information: &mut DMatrix<f64>, slots: &[usize], last: &Solved) -> bool {
        let way = |&s: &usize| {
            let coordinate = &self.bench.coordinates[s];
            coordinate.of_value(self.home.values[s]) - coordinate.of_value(last.values[s])
        };
        let s = DVector::from_iterator(slots.len(), slots.iter().map(way));
        let y = DVector::from_iterator(slots.len(), slots.iter().map(|&s| last.gradient[s] - self.home.gradient[s]));
        let (bend, turned) = (s.dot(&y), &*information * &s);
        let own = s.dot(&turned);
        if !(bend > 1e-10 * s.norm() * y.norm() && own > 0.0 && bend.is_finite()) {
            return false;
        }
        *information += &y * y.transpose() / bend - &turned * turned.transpose() / own;
        true
    }

    /// A level is on its way to zero.
    fn sinks(&self, information: &DMatrix<f64>, slots: &[usize]) -> bool {
        slots.iter().enumerate().any(|(i, &s)| {
            let slope = self.home.gradient[s];
            self.bench.coordinates[s].level.is_some() && slope < 0.0 && information[(i, i)] < SINKING * slope.abs()
        })
    }
}
