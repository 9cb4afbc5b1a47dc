//! What profiles over α hold.

use nalgebra::DVector;

use crate::dynamic::outer::Outer;
use crate::estimate::{Estimate, Point};
use crate::infer::{HeldMaximum, Holdable, Holder, Law, value};
use crate::model::{Alpha, Population};

/// A quantity that can be held at a value while α moves.
pub(super) trait Target: Copy + Sync {
    /// The best (μ, Σ) at some α with it held, from a point nearby.
    fn maximum(self, at: (&Holder<'_>, &Alpha), x: f64, near: &Point) -> Option<HeldMaximum>;
    /// Its estimate.
    fn value(self, outer: &Outer<'_, '_>) -> Option<f64>;
    /// Its derivative along the tangent basis at the estimate.
    fn along(self, law: &Law<'_>, estimate: &Estimate) -> DVector<f64>;
    /// Its derivative by the coordinates of the values that move, at the estimate.
    fn slopes(self, outer: &Outer<'_, '_>) -> DVector<f64>;
    /// The same at other values, with (μ, Σ) there.
    fn slopes_at(self, outer: &Outer<'_, '_>, values: &[f64], there: &Population) -> Option<DVector<f64>>;
}

impl Target for Holdable {
    fn maximum(self, (holder, _): (&Holder<'_>, &Alpha), x: f64, near: &Point) -> Option<HeldMaximum> {
        holder.maximum(self, x, near)
    }

    fn value(self, outer: &Outer<'_, '_>) -> Option<f64> {
        value(outer.estimate, self)
    }

    fn along(self, law: &Law<'_>, estimate: &Estimate) -> DVector<f64> {
        law.derivative(&estimate.covariance, self)
    }

    fn slopes(self, outer: &Outer<'_, '_>) -> DVector<f64> {
        DVector::zeros(outer.slots.len())
    }

    fn slopes_at(self, outer: &Outer<'_, '_>, _: &[f64], _: &Population) -> Option<DVector<f64>> {
        Some(self.slopes(outer))
    }
}
