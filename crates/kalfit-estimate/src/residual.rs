//! The information on the noise level within tests.

use std::sync::Arc;

use kalfit_filter::reduce::Reductions;

/// Information of tests on the noise level that does not depend on ξ.
#[derive(Debug, Clone, Copy, Default)]
pub struct Residual {
    /// n, the number of measurements.
    pub measurements: f64,
    /// r, the residual sum of squares.
    pub squares: f64,
}

impl Residual {
    /// The residual of a test whose r is known.
    pub fn of(reductions: &Reductions, number: usize) -> Residual {
        let (squares, observations) = reductions.residual(number);
        let squares = squares.expect("r is known").max(0.0); // rounding may make it negative
        Residual { measurements: observations as f64, squares }
    }

    pub(crate) fn plus(self, other: Residual) -> Residual {
        Residual { measurements: self.measurements + other.measurements, squares: self.squares + other.squares }
    }

    /// Change of the constant where all noise variances are multiplied by λ: -½ n log λ - ½ r (1/λ - 1).
    pub fn change(self, variance: f64) -> f64 {
        -0.5 * (self.measurements * variance.ln() + self.squares * (variance.recip() - 1.0))
    }
}

/// A factor λ of all noise variances, in coordinates that are √λ times as large: R does not change, d becomes d/√λ.
#[derive(Debug, Clone)]
pub(crate) struct NoiseScale {
    pub(crate) variance: f64,
    /// Residual of each class.
    pub(crate) residuals: Arc<Vec<Residual>>,
}

impl NoiseScale {
    /// 1/√λ.
    pub(crate) fn unit(&self) -> f64 {
        self.variance.sqrt().recip()
    }

    /// Change of the constant of a class.
    pub(crate) fn change(&self, class: usize) -> f64 {
        self.residuals[class].change(self.variance)
    }
}
