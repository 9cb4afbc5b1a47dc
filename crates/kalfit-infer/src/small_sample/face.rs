//! Degrees of freedom on the face: among matrices of the rank of the estimated Σ, with the observed information.

use nalgebra::{DMatrix, DVector};

use crate::law::AsymptoticLaw;
use crate::small_sample::mean_law::MeanLaw;
use crate::small_sample::theta::Theta;
use crate::small_sample::variances::Variances;
use kalfit_estimate::FinalState;

/// The covariance of θ by kalfit's standard errors.
#[derive(Debug, Clone)]
pub(super) struct Face {
    covariance: DMatrix<f64>,
}

impl Face {
    /// V of θ; `None` where free parameters have no joint law.
    pub(super) fn of(state: &FinalState, theta: &Theta, variances: Option<&Variances>) -> Option<Face> {
        let law = AsymptoticLaw::new(state);
        let (jacobian, elements) = (law.jacobian(), state.problem.covariance.elements.count());
        let (first, coordinates) = (jacobian.nrows() - elements, jacobian.ncols());
        let joint = state.joint.as_ref().filter(|_| theta.noises > 0);
        let covariance = match joint {
            Some(joint) => &joint.covariance,
            None => law.coordinates(),
        };
        // dθ/d(coordinates along the tangent basis, coordinates of α)
        let mut along = DMatrix::zeros(theta.len(), covariance.nrows());
        let dense = jacobian.dense();
        for (place, &k) in theta.elements.iter().enumerate() {
            along.view_mut((theta.noises + place, 0), (1, coordinates)).copy_from(&dense.row(first + k));
        }
        if let Some(variances) = variances {
            for (a, slot) in variances.slots.iter().enumerate() {
                let place = joint?.slots.iter().position(|(own, _)| own == slot)?;
                along[(a, coordinates + place)] = variances.by_coordinate[a][0];
            }
        }
        let covariance = &along * covariance * along.transpose();
        covariance.iter().all(|x| x.is_finite()).then_some(Face { covariance })
    }

    /// ν of l'β.
    pub(super) fn freedom(&self, law: &MeanLaw, l: &DVector<f64>) -> Option<f64> {
        let (g, c) = (law.slopes_of(l), l.dot(&(&law.covariance * l)));
        let freedom = 2.0 * c * c / g.dot(&(&self.covariance * &g));
        (freedom.is_finite() && freedom > 0.0).then_some(freedom)
    }
}
