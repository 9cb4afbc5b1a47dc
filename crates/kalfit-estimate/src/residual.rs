//! What tests say of the level of the noise.

use std::sync::Arc;

use kalfit_filter::reduce::Reductions;

/// What tests say of the level of the noise by themselves.
#[derive(Debug, Clone, Copy, Default)]
pub struct Residual {
    /// n.
    pub measurements: f64,
    /// r.
    pub squares: f64,
}

impl Residual {
    /// Of a test whose r is known.
    pub fn of(reductions: &Reductions, number: usize) -> Residual {
        let (squares, observations) = reductions.residual(number);
        let squares = squares.expect("r is known").max(0.0); // rounding leaves less than nothing
        Residual { measurements: observations as f64, squares }
    }

    pub(crate) fn and(self, other: Residual) -> Residual {
        Residual { measurements: self.measurements + other.measurements, squares: self.squares + other.squares }
    }

    /// What is added to the constant where all noise is so many times as large: -½ n log λ - ½ r (1/λ - 1).
    pub fn change(self, variance: f64) -> f64 {
        -0.5 * (self.measurements * variance.ln() + self.squares * (variance.recip() - 1.0))
    }
}

/// All noise λ times as large, in coordinates that are √λ times as large: R stays, d is d/√λ.
#[derive(Debug, Clone)]
pub(crate) struct NoiseScale {
    pub(crate) variance: f64,
    /// Of each class.
    pub(crate) told: Arc<Vec<Residual>>,
}

impl NoiseScale {
    /// 1/√λ.
    pub(crate) fn unit(&self) -> f64 {
        self.variance.sqrt().recip()
    }

    /// What is added to the constant of a class.
    pub(crate) fn change(&self, class: usize) -> f64 {
        self.told[class].change(self.variance)
    }
}
