//! The information that score tests of constraints divide by: the expected (Fisher) information at the constrained
//! maximum, after the free coordinates have adapted (theory §4).
//!
//! ```text
//! s² / (I_ee - I_ez I_zz⁻¹ I_ze)      e: the element, z: all that is free
//! ```
//!
//! The observed information is that of the maximum where ℓ is quadratic. Far from it, ℓ is not: at a sample correlation
//! r of N tests, the observed information about a covariance held at zero is N(1 - 4r²), and the expected one is N.

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::law::{AsymptoticLaw, inverse};
use kalfit_algebra::sparse::Sparse;
use kalfit_estimate::{FinalState, Mixed};

/// Share of an element's information below which the data have none on the element by itself.
const LEAST_SHARE: f64 = 1e-10;

/// The expected information about all elements of (μ, Σ), and the covariance of what is free.
pub(crate) struct ScoreLaw<'a> {
    /// Expected information about (mean coordinates, elements of Σ) in η.
    information: DMatrix<f64>,
    /// d(μ in η, γ; σ pairs) / d(tangent coordinates).
    jacobian: Sparse,
    /// Covariance of the tangent coordinates, then of the coordinates of α where `mixed` is given.
    covariance: DMatrix<f64>,
    /// What α shares with the elements; `None` where α is known, or taken as known.
    mixed: Option<&'a Mixed>,
}

impl<'a> ScoreLaw<'a> {
    pub(crate) fn new(state: &'a FinalState) -> ScoreLaw<'a> {
        let information = state.sums.all_expected_information();
        let jacobian = AsymptoticLaw::new(state).jacobian().clone();
        let mixed = state.joint.as_ref().and_then(|joint| joint.mixed.as_ref());
        let covariance = match mixed {
            Some(mixed) => mixed.covariance.clone(),
            None => inverse(&jacobian.congruence(&information)),
        };
        ScoreLaw { information, jacobian, covariance, mixed }
    }

    /// The direction in which no element moves.
    pub(crate) fn no_direction(&self) -> DVector<f64> {
        DVector::zeros(self.information.nrows())
    }

    /// The information in a direction after all that is free has adapted; `None` where none is left.
    pub(crate) fn information(&self, direction: &DVector<f64>) -> Option<f64> {
        let with = &self.information * direction;
        let own = direction.dot(&with);
        let along = self.jacobian.transposed_times(&with);
        let of_alpha = self.mixed.map_or_else(|| DVector::zeros(0), |mixed| &mixed.information * direction);
        let cross = DVector::from_iterator(along.len() + of_alpha.len(), along.iter().chain(of_alpha.iter()).copied());
        let left = own - cross.dot(&(&self.covariance * &cross));
        (left > LEAST_SHARE * own.abs()).then_some(left)
    }
}

/// Tail probability of χ² with one degree of freedom, or of its one-sided half.
pub(crate) fn p_value(statistic: f64, one_sided: bool) -> f64 {
    let two_sided = ChiSquared::new(1.0).expect("one degree of freedom is legal").sf(statistic);
    if one_sided { 0.5 * two_sided } else { two_sided }
}
