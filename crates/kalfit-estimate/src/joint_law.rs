//! The joint distribution of the estimates of (μ, Σ) and of dynamic parameters.

use nalgebra::{DMatrix, DVector};

/// Covariance of the estimates along the tangent basis of (μ, Σ) and of the free values of α that have a covariance.
/// Values that occur in matrices of the structure of Σ change Σ even at fixed coordinates of Σ.
#[derive(Debug, Clone)]
pub struct JointLaw {
    /// Joint covariance of the coordinates along the tangent basis, then of the coordinates of the values in `slots`.
    pub covariance: DMatrix<f64>,
    /// The values of α, each as (slot, dvalue/dcoordinate).
    pub slots: Vec<(usize, f64)>,
    /// dσ/dcoordinate of each value, elements × values, in η.
    pub moves: DMatrix<f64>,
    /// Slots of values that the data do not determine, or that belong to single tests.
    pub open: Vec<usize>,
    /// dσ/dcoordinate of the `open` values that change Σ: the elements of Σ that these values change have no standard
    /// error.
    pub open_moves: DMatrix<f64>,
    /// Slots of noise levels that ended at zero.
    pub at_zero: Vec<usize>,
    /// Directions along which ℓ does not change.
    pub flat: Vec<FlatDirection>,
    /// Matrices for score tests of constraints; `None` without constraints, or where the matrices were not computed.
    pub mixed: Option<Mixed>,
}

/// A direction in (α, μ, Σ) along which ℓ does not change.
#[derive(Debug, Clone)]
pub struct FlatDirection {
    /// Parameters that change along the direction.
    pub parameters: Vec<usize>,
    /// Change of (μ, Σ): one number for each column of the tangent basis.
    pub inner: DVector<f64>,
    /// Change of σ through values of α in matrices of the structure of Σ: one number for each element, in η.
    pub moves: DVector<f64>,
}

/// Covariance and information of free values of α with every element of (μ, Σ), constrained elements included.
#[derive(Debug, Clone)]
pub struct Mixed {
    /// Joint covariance of the coordinates along the tangent basis, then of the coordinates of α.
    pub covariance: DMatrix<f64>,
    /// Expected value of -∂²ℓ/∂α∂(μ in η, γ; σ pairs), a row for each coordinate of α.
    pub information: DMatrix<f64>,
}
