//! The law of (μ, Σ) where dynamic parameters were estimated beside them.

use nalgebra::{DMatrix, DVector};

/// Covariance along the tangent basis of (μ, Σ) and of the free values of α that have a law. Values that stand in matrices of the
/// structure of Σ move Σ at fixed coordinates of it.
#[derive(Debug, Clone)]
pub struct JointLaw {
    /// Along the tangent basis, then of the coordinates of the values.
    pub covariance: DMatrix<f64>,
    /// The values: (slot, dvalue/dcoordinate).
    pub slots: Vec<(usize, f64)>,
    /// dσ/dcoordinate of each, elements × values, in η.
    pub moves: DMatrix<f64>,
    /// Slots that the data do not determine, or of single tests.
    pub open: Vec<usize>,
    /// dσ/dcoordinate of those of them that move Σ: what they move has no standard error.
    pub open_moves: DMatrix<f64>,
    /// Slots of noise levels that ended at zero.
    pub at_zero: Vec<usize>,
    /// Directions along which ℓ does not change.
    pub flat: Vec<FlatDirection>,
    /// What score tests of constraints want to know besides, where there are any and it was worked out.
    pub mixed: Option<Mixed>,
}

/// A direction in (α, μ, Σ) along which ℓ does not change.
#[derive(Debug, Clone)]
pub struct FlatDirection {
    /// Parameters that move.
    pub parameters: Vec<usize>,
    /// What μ and Σ do along the tangent basis.
    pub inner: DVector<f64>,
    /// dσ by what stands in matrices of the structure of Σ, by elements, in η.
    pub moves: DVector<f64>,
}

/// How free values of α and every element of (μ, Σ) go together, elements that constraints hold among them.
#[derive(Debug, Clone)]
pub struct Mixed {
    /// Covariance along the tangent basis, then of the coordinates of α.
    pub covariance: DMatrix<f64>,
    /// -∂²ℓ/∂α∂(μ in η, γ; σ pairs), a row for each coordinate of α.
    pub information: DMatrix<f64>,
}
