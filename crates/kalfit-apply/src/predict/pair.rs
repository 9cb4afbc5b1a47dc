//! Two quantities together: the ellipse and the circles that hold a given part of all tests.

use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

/// Two jointly normal quantities.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Means of the two quantities.
    pub mean: [f64; 2],
    /// (Variance of the first quantity, variance of the second, covariance of the two).
    pub variances: [f64; 3],
}

/// An ellipse about the means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse {
    /// Half axes, the longer first.
    pub axes: [f64; 2],
    /// Angle of the longer axis from the first quantity towards the second, in radians, in (-π/2, π/2].
    pub angle: f64,
}

/// Ratio of the variances along the two axes below which the smaller variance is rounding error.
const LEAST_VARIANCE_RATIO: f64 = 1e-12;
/// Number of strips in the integral over a circle.
const STRIPS: usize = 400;

impl Pair {
    /// Standard deviations along the axes of the ellipse, the longer first, and the angle of the longer axis.
    fn axes(&self) -> ([f64; 2], f64) {
        let [a, b, c] = self.variances;
        let (middle, half) = (0.5 * (a + b), (0.25 * (a - b) * (a - b) + c * c).sqrt());
        let [long, short] = [middle + half, middle - half];
        let short = if short > LEAST_VARIANCE_RATIO * long { short.sqrt() } else { 0.0 };
        ([long.max(0.0).sqrt(), short], 0.5 * (2.0 * c).atan2(a - b))
    }

    /// The ellipse that contains the fraction `content` of all tests.
    pub fn ellipse(&self, content: f64) -> Ellipse {
        let (axes, angle) = self.axes();
        let law = ChiSquared::new(2.0).expect("two degrees of freedom");
        let radius = law.inverse_cdf(content).sqrt();
        Ellipse { axes: axes.map(|axis| radius * axis), angle }
    }

    /// Radius of the circle about the means that contains the fraction `content` of all tests; for ½, the circular
    /// error probable.
    pub fn circle(&self, content: f64) -> f64 {
        radius(content, [0.0; 2], self.axes().0)
    }

    /// Radius of the circle about zero that contains the fraction `content` of all tests.
    pub fn circle_about_zero(&self, content: f64) -> f64 {
        let (axes, angle) = self.axes();
        let ([x, y], (sin, cos)) = (self.mean, angle.sin_cos());
        radius(content, [x * cos + y * sin, y * cos - x * sin], axes)
    }
}

fn radius(content: f64, mean: [f64; 2], axes: [f64; 2]) -> f64 {
    let offset = mean[0].hypot(mean[1]);
    let (mut low, mut high) = (0.0, offset + 10.0 * axes[0]);
    if axes[0] == 0.0 {
        return offset;
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if probability_within(middle, mean, axes) < content { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// P(x² + y² ≤ R²) for independent x and y, integrated over x = R sin t.
fn probability_within(radius: f64, mean: [f64; 2], axes: [f64; 2]) -> f64 {
    let law = Normal::standard();
    let cdf = |x: f64, axis: usize| match axes[axis] > 0.0 {
        true => law.cdf((x - mean[axis]) / axes[axis]),
        false => f64::from(u8::from(x >= mean[axis])),
    };
    let step = std::f64::consts::PI / STRIPS as f64;
    let strip = |k: usize| {
        let t = -0.5 * std::f64::consts::PI + step * (k as f64 + 0.5);
        let (x, y) = (radius * t.sin(), radius * t.cos());
        let density =
            (-0.5 * ((x - mean[0]) / axes[0]).powi(2)).exp() / (axes[0] * (2.0 * std::f64::consts::PI).sqrt());
        density * y * (cdf(y, 1) - cdf(-y, 1))
    };
    step * (0..STRIPS).map(strip).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_law_has_a_round_ellipse() {
        let round = Pair { mean: [0.0; 2], variances: [4.0, 4.0, 0.0] };
        let expected = 2.0 * (2.0 * 2f64.ln()).sqrt();
        assert!((round.circle(0.5) - expected).abs() < 1e-6, "{} against {expected}", round.circle(0.5));
        let Ellipse { axes, .. } = round.ellipse(0.5);
        axes.iter().for_each(|axis| assert!((axis - expected).abs() < 1e-6, "{axis} against {expected}"));
    }

    #[test]
    fn a_line_is_a_normal_law() {
        // all tests are along (3, 4) / 5: half of the tests are within 0.6745 standard deviations
        let line = Pair { mean: [0.0; 2], variances: [9.0, 16.0, 12.0] };
        let expected = 5.0 * 0.674_489_75;
        assert!((line.circle(0.5) - expected).abs() < 1e-4 * expected, "{} against {expected}", line.circle(0.5));
        assert!((line.ellipse(0.9).angle - (4f64 / 3.0).atan()).abs() < 1e-12);
    }

    #[test]
    fn circles_about_zero_hold_what_they_say() {
        // by scipy: noncentral χ² with 2 degrees of freedom and λ = 25
        let off = Pair { mean: [3.0, 4.0], variances: [1.0, 1.0, 0.0] };
        let expected = 5.099_676_038;
        let found = off.circle_about_zero(0.5);
        assert!((found - expected).abs() < 1e-5, "{found} against {expected}");
    }
}
