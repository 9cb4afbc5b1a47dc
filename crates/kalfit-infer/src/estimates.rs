//! The joint covariance of all estimates: μ, the regression coefficients, the elements of Σ and the free values of α.

use nalgebra::{DMatrix, DVector};

use crate::estimated::Estimated;
use crate::law::AsymptoticLaw;

/// The asymptotic covariance of the estimates, in the user's units, without numbers that are fixed, on a bound or at
/// zero.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EstimateCovariance {
    /// The estimated numbers, in the order of the rows of the covariance.
    pub quantities: Vec<Estimated>,
    /// Covariance of the estimates.
    pub covariance: DMatrix<f64>,
    /// Estimates that the data do not determine.
    pub open: Vec<Estimated>,
    /// Free variances, and free noise levels, whose estimate is zero.
    pub at_zero: Vec<Estimated>,
}

/// Largest number of estimates whose covariance is reported.
const MAX_ESTIMATES: usize = 200;
/// A quantity is fixed if no derivative of the quantity, in η, exceeds this threshold.
const FIXED_DERIVATIVE: f64 = 1e-12;

impl AsymptoticLaw<'_> {
    /// Covariance of all estimates; `None` for more than [`MAX_ESTIMATES`], or where an entry is not finite. `is_open`:
    /// whether the data do not determine a quantity.
    pub(super) fn estimates(&self, is_open: &dyn Fn(Estimated) -> bool) -> Option<EstimateCovariance> {
        let joint = self.state.joint.as_ref();
        let empty = DMatrix::zeros(0, 0);
        let (law, free, element_slopes) = match joint {
            Some(joint) => (&joint.covariance, joint.slots.as_slice(), &joint.moves),
            None => (self.coordinates(), &[][..], &empty),
        };
        let (rows, coordinates) = (self.jacobian().nrows(), self.jacobian().ncols());
        let by_row = self.jacobian().transposed();
        let elements = element_slopes.nrows();
        let mut all: Vec<(Estimated, DVector<f64>)> = Vec::new();
        let mut open: Vec<Estimated> =
            joint.map_or(Vec::new(), |joint| joint.open.iter().map(|&slot| Estimated::Value(slot)).collect());
        for (row, quantity, unit) in self.quantities() {
            if is_open(quantity) {
                open.push(quantity);
                continue;
            }
            let of_value = |c: usize| match row.checked_sub(rows - elements) {
                Some(element) => element_slopes[(element, c)],
                None => 0.0,
            };
            let mut derivative = DVector::zeros(coordinates + free.len());
            if is_of_mean(quantity) {
                derivative.rows_mut(0, coordinates).copy_from(&self.derivative_of_coordinate(row));
            } else {
                by_row.column(row).iter().for_each(|&(c, x)| derivative[c] = x);
            }
            (0..free.len()).for_each(|c| derivative[coordinates + c] = of_value(c));
            if derivative.amax() > FIXED_DERIVATIVE {
                all.push((quantity, derivative * unit));
            }
            if all.len() > MAX_ESTIMATES {
                return None;
            }
        }
        for (c, &(slot, slope)) in free.iter().enumerate() {
            let mut derivative = DVector::zeros(coordinates + free.len());
            derivative[coordinates + c] = slope;
            all.push((Estimated::Value(slot), derivative));
        }
        if all.len() > MAX_ESTIMATES {
            return None;
        }
        // covariance of a mean with any other number: with the generalised least squares law, the mean is correlated
        // with other estimates through α alone
        let followed = |mean: &DVector<f64>, other: &DVector<f64>| {
            let Some(follows) = self.follows().filter(|_| !free.is_empty()) else { return 0.0 };
            let by_values = follows.transpose() * mean.rows(0, coordinates);
            by_values.dot(&(law.rows(coordinates, free.len()) * other))
        };
        let covariance = DMatrix::from_fn(all.len(), all.len(), |i, k| {
            let ((first, a), (second, b)) = (&all[i], &all[k]);
            match (self.mean_law(), is_of_mean(*first), is_of_mean(*second)) {
                (None, ..) | (Some(_), false, false) => a.dot(&(law * b)),
                (Some(mean), true, true) => a.rows(0, coordinates).dot(&(mean * b.rows(0, coordinates))),
                (Some(_), true, false) => followed(a, b),
                (Some(_), false, true) => followed(b, a),
            }
        });
        let quantities = all.into_iter().map(|(quantity, _)| quantity).collect();
        let at_zero =
            joint.map_or(Vec::new(), |joint| joint.at_zero.iter().map(|&slot| Estimated::Value(slot)).collect());
        let is_known = covariance.iter().all(|entry| entry.is_finite());
        is_known.then_some(EstimateCovariance { quantities, covariance, open, at_zero })
    }
}

fn is_of_mean(quantity: Estimated) -> bool {
    matches!(quantity, Estimated::Mean(_) | Estimated::Coefficient(_))
}
