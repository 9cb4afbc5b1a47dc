//! A positive definite model of -Hessian, and the steps that it gives.

use std::sync::OnceLock;

use nalgebra::{DMatrix, DMatrixView, DVector};

use crate::local::Tangent;
use kalfit_algebra::regular::Regular;
use kalfit_algebra::symmetric;

/// A positive definite model of -Hessian: the information scaled to unit diagonal, with eigenvalues by absolute value
/// and flat directions omitted.
#[derive(Debug, Clone)]
pub(crate) struct Curvature {
    scale: DVector<f64>,
    /// Gradient along the tangent basis, times `scale`.
    gradient: DVector<f64>,
    /// The undamped step, where no eigenvalue is negative or flat.
    undamped: Option<UndampedStep>,
    /// Eigenvalues and eigenvectors of the model: computed at once where there is no undamped step, else when first
    /// needed.
    spectrum: OnceLock<Spectrum>,
}

/// The step without damping from a root of the model, the gain in ℓ that the step promises, and the decrement.
#[derive(Debug, Clone)]
struct UndampedStep {
    step: DVector<f64>,
    gain: f64,
    decrement: f64,
}

/// Eigenvalues of the model in ascending order, and the eigenvectors as columns.
#[derive(Debug, Clone)]
struct Spectrum {
    values: Vec<f64>,
    vectors: DMatrix<f64>,
    /// Gradient in the basis of the eigenvectors.
    gradient: DVector<f64>,
}

/// A model with a negative eigenvalue is not trusted beyond this decrement, in standard errors.
const MAX_TRUSTED_DECREMENT: f64 = 1.0;

/// A step that fails is tried again at no less than this fraction of its length.
const MIN_SHORTENING: f64 = 0.25;
/// A step that fails is tried again at no more than this fraction of its length.
const MAX_SHORTENING: f64 = 0.5;

/// Information on a coordinate, in units of natural sizes, below this fraction of the largest is rounding error.
pub const NEGLIGIBLE_INFORMATION: f64 = 1e-14;
/// Directions with scaled eigenvalues up to this are flat: the data do not inform such directions.
const FLAT_EIGENVALUE: f64 = 1e-10;
/// Scaled eigenvalues below this are rounding errors: steps along flat directions then divide by this constant.
const ROUNDING_EIGENVALUE: f64 = 1e-15;
/// No step is taken along flat directions whose slopes promise a gain in ℓ of at most this.
const MIN_FLAT_GAIN: f64 = 1e-6;

impl Curvature {
    pub(crate) fn new(tangent: &Tangent) -> Curvature {
        let h = &tangent.information;
        let n = h.nrows();
        let own = |i: usize| h[(i, i)].abs() * tangent.sizes[i].powi(2);
        let largest = (0..n).map(own).fold(0.0, f64::max);
        let unit =
            |i: usize| if own(i) > NEGLIGIBLE_INFORMATION * largest { h[(i, i)].abs().sqrt().recip() } else { 0.0 };
        let scale = DVector::from_fn(n, |i, _| unit(i));
        let gradient = tangent.gradient.component_mul(&scale);
        Curvature::scaled_by(scale, gradient, h.as_view())
    }

    /// The model from an information matrix that `scale` brings to unit diagonal, and a gradient that is scaled
    /// already.
    pub(super) fn scaled_by(
        scale: DVector<f64>,
        gradient: DVector<f64>,
        information: DMatrixView<'_, f64>,
    ) -> Curvature {
        let mut found = Curvature { scale, gradient, undamped: None, spectrum: OnceLock::new() };
        // with many states neither the matrix nor its root can be stored, but the step derived from them can
        found.undamped =
            Regular::within(found.scaled(information)).map(|root| UndampedStep::of(&root, &found.gradient));
        if found.undamped.is_none() {
            found.spectrum(information);
        }
        found
    }

    fn scaled(&self, information: DMatrixView<'_, f64>) -> DMatrix<f64> {
        let (n, scale) = (self.scale.len(), &self.scale);
        DMatrix::from_fn(n, n, |i, j| scale[i] * information[(i, j)] * scale[j])
    }

    /// The eigenvalues, computed on first use. `information`: the information along the tangent basis, n × n.
    fn spectrum(&self, information: DMatrixView<'_, f64>) -> &Spectrum {
        self.spectrum.get_or_init(|| {
            let scaled = self.scaled(information);
            // where there is a root, the matrix decomposed is the product of that root
            let root = self.undamped.as_ref().and_then(|_| Regular::within(scaled.clone()));
            let (values, vectors) = symmetric::eigen(&root.map_or(scaled, Regular::into_product));
            let gradient = vectors.transpose() * &self.gradient;
            Spectrum { values, vectors, gradient }
        })
    }

    /// The spectrum, which exists where there is no root.
    fn spectrum_without_root(&self) -> &Spectrum {
        self.spectrum.get().expect("it is worked out where there is no root")
    }

    /// Newton decrement: the distance to the optimum of the model, in standard errors.
    pub(crate) fn decrement(&self) -> f64 {
        self.undamped.as_ref().map_or_else(|| self.spectrum_without_root().decrement(), |undamped| undamped.decrement)
    }

    /// (step along flat directions, in the tangent basis; gain in ℓ that the slopes promise); `None` where that gain is
    /// negligible. The gain must be checked on ℓ: where two quantities are almost confounded, as a state and another
    /// times 10⁷ ± 1, ℓ determines more than its curvature can show.
    pub(crate) fn along_flat(&self) -> Option<(DVector<f64>, f64)> {
        let spectrum = self.spectrum.get().filter(|_| self.undamped.is_none())?;
        let (step, gain) = spectrum.along_flat();
        (gain > MIN_FLAT_GAIN).then(|| (step.component_mul(&self.scale), gain))
    }

    /// Least damping of a step: above zero only where ℓ is clearly not concave and the optimum is far away, as the
    /// model then holds over a short distance only.
    pub(crate) fn nonconcave_damping(&self) -> f64 {
        if self.undamped.is_some() {
            return 0.0;
        }
        let least = self.spectrum_without_root().values.first().copied().unwrap_or(0.0);
        if least < -1e-3 && self.decrement() > MAX_TRUSTED_DECREMENT { 0.6 * -least } else { 0.0 }
    }

    /// The damping for the next try after a step with `damping` gained only `gain`: a parabola through the values of ℓ
    /// at both ends of the step, with the slope at the start, gives the new length, between a quarter and a half of the
    /// old length. `information`: the information along the tangent basis, n × n.
    pub(crate) fn damping_after_failure(&self, information: &DMatrix<f64>, damping: f64, gain: f64) -> f64 {
        let spectrum = self.spectrum(information.as_view());
        let length = |d: f64| spectrum.terms().map(|(_, h, g)| (g / (h + d)).powi(2)).sum::<f64>().sqrt();
        let slope: f64 = spectrum.terms().map(|(_, h, g)| g * g / (h + damping)).sum();
        let part = slope / (2.0 * (slope - gain)); // zero where ℓ has no value
        let wanted = length(damping) * part.clamp(MIN_SHORTENING, MAX_SHORTENING);
        let (mut low, mut high) = (damping, damping.max(1e-3));
        while length(high) > wanted && high < 1e30 {
            low = high;
            high *= 4.0;
        }
        for _ in 0..20 {
            let middle = 0.5 * (low + high);
            if length(middle) > wanted { low = middle } else { high = middle }
        }
        high
    }

    /// (step along the tangent basis with the given damping, gain in ℓ that the step promises). `information`: the
    /// information along the tangent basis, n × n.
    pub(crate) fn step(&self, information: &DMatrix<f64>, damping: f64) -> (DVector<f64>, f64) {
        let (step, gain) = match &self.undamped {
            Some(undamped) if damping == 0.0 => (undamped.step.clone(), undamped.gain),
            _ => self.spectrum(information.as_view()).step(damping),
        };
        (step.component_mul(&self.scale), gain)
    }
}

impl UndampedStep {
    fn of(root: &Regular, gradient: &DVector<f64>) -> UndampedStep {
        let whitened_gradient = root.below(gradient);
        UndampedStep {
            gain: 0.5 * whitened_gradient.norm_squared(),
            decrement: whitened_gradient.norm(),
            step: root.above(whitened_gradient),
        }
    }
}

impl Spectrum {
    /// (index, |eigenvalue|, slope along the eigenvector) of each direction that is not flat.
    fn terms(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let is_not_flat = |&(_, h, _): &(usize, f64, f64)| h > FLAT_EIGENVALUE;
        self.values.iter().enumerate().map(|(k, v)| (k, v.abs(), self.gradient[k])).filter(is_not_flat)
    }

    fn decrement(&self) -> f64 {
        self.terms().map(|(_, h, g)| g * g / h).fold(0.0, |a, b| a + b).sqrt() // an empty sum would be -0
    }

    /// (step along flat directions, gain in ℓ that the step promises).
    fn along_flat(&self) -> (DVector<f64>, f64) {
        let mut eigen_step = DVector::zeros(self.values.len());
        let mut gain = 0.0;
        for (k, h) in self.values.iter().map(|v| v.abs()).enumerate().filter(|(_, h)| *h <= FLAT_EIGENVALUE) {
            eigen_step[k] = self.gradient[k] / h.max(ROUNDING_EIGENVALUE);
            gain += 0.5 * self.gradient[k] * eigen_step[k];
        }
        (&self.vectors * eigen_step, gain)
    }

    fn step(&self, damping: f64) -> (DVector<f64>, f64) {
        let mut eigen_step = DVector::zeros(self.values.len());
        let mut gain = 0.0;
        for (k, h, g) in self.terms() {
            let s = g / (h + damping);
            eigen_step[k] = s;
            gain += g * s - 0.5 * h * s * s;
        }
        (&self.vectors * eigen_step, gain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::Chart;
    use kalfit_algebra::elements::Elements;
    use kalfit_algebra::sparse::Sparse;

    fn of(scaled: &DMatrix<f64>, gradient: DVector<f64>) -> Curvature {
        let scale = DVector::from_element(gradient.len(), 1.0);
        Curvature::scaled_by(scale, gradient, scaled.as_view())
    }

    #[test]
    fn the_root_and_the_eigenvectors_say_the_same() {
        let n = 5;
        let wave = DMatrix::from_fn(n, n, |i, k| ((3 * i + 7 * k) as f64).sin());
        let h = &wave * wave.transpose() + DMatrix::identity(n, n) * 0.05;
        let curvature = of(&h, DVector::from_fn(n, |i, _| (i as f64).cos()));
        assert!(curvature.undamped.is_some(), "it is regular");
        let (step, gain) = curvature.step(&h, 0.0);
        let (expected, promised) = curvature.spectrum(h.as_view()).step(0.0);
        assert!((&step - &expected).norm() < 1e-11 * expected.norm(), "{step} {expected}");
        assert!((gain - promised).abs() < 1e-11 * promised, "{gain} {promised}");
        let (decrement, by_values) = (curvature.decrement(), curvature.spectrum_without_root().decrement());
        assert!((decrement - by_values).abs() < 1e-11 * by_values, "{decrement} {by_values}");
        assert_eq!(curvature.nonconcave_damping(), 0.0);
    }

    #[test]
    fn where_a_direction_is_flat_or_not_concave_there_is_no_root() {
        let diagonal = |least: f64| DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, least, 2.0]));
        assert!(of(&diagonal(0.5), DVector::zeros(3)).undamped.is_some());
        let flat = of(&diagonal(0.0), DVector::from_vec(vec![3.0, 100.0, 0.0]));
        assert_eq!(flat.decrement(), 3.0);
        for (least, size, expected) in
            [(-0.5, 1.0, 0.3), (-2e-3, 1.0, 1.2e-3), (-5e-4, 1.0, 0.0), (0.0, 1.0, 0.0), (-0.5, 0.1, 0.0)]
        {
            let found = of(&diagonal(least), DVector::from_vec(vec![3.0 * size, 0.0, 0.0])).nonconcave_damping();
            assert!((found - expected).abs() < 1e-12, "{least} at {size}: {found} {expected}");
        }
    }

    #[test]
    fn slopes_along_flat_directions_ask_for_a_step_where_they_promise_something() {
        let diagonal = |least: f64| DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, least, 2.0]));
        for (least, slope, length) in
            [(1e-12, 1e-8, Some(1e4)), (1e-12, 1e-10, None), (1e-17, 1e-10, Some(1e5)), (0.1, 1.0, None)]
        {
            let found = of(&diagonal(least), DVector::from_vec(vec![0.3, slope, 0.0])).along_flat();
            match (found, length) {
                (None, None) => {}
                (Some((step, gain)), Some(length)) => {
                    assert!((step[1] / length - 1.0).abs() < 1e-12 && step[0] == 0.0, "{step} {length}");
                    assert!((gain - 0.5 * slope * step[1]).abs() <= 1e-12 * gain, "{gain}");
                }
                other => panic!("{least} {slope}: {other:?}"),
            }
        }
    }

    /// A coordinate counts where its information exceeds 10⁻¹⁴ of the largest, each taken at its natural size.
    #[test]
    fn information_is_nothing_beside_the_largest_at_natural_sizes() {
        for (small, size, counts) in
            [(1e-13, 1.0, true), (1e-15, 1.0, false), (1e-15, 10.0, true), (1e-13, 0.01, false), (0.0, 1.0, false)]
        {
            let tangent = Tangent {
                mean: 2,
                chart: Chart {
                    root: DMatrix::zeros(0, 0),
                    coordinates: Vec::new(),
                    bounded: Vec::new(),
                    elements: Elements::single(0),
                },
                jacobian: Sparse::with_height(0),
                basis: Sparse::with_height(2),
                gradient: DVector::from_vec(vec![3.0, 4.0 * f64::sqrt(small)]),
                information: DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, small])),
                sizes: vec![1.0, size],
                multipliers: Vec::new(),
                residual_score: DMatrix::zeros(0, 0),
            };
            let found = Curvature::new(&tangent).decrement();
            let expected = if counts { 5.0 } else { 3.0 };
            assert!((found - expected).abs() < 1e-12, "{small} at size {size}: {found} {expected}");
        }
    }

    /// Where the value is no parabola, a failed step g'(H + d)⁻¹ is shortened to between a quarter and a half of its
    /// length.
    #[test]
    fn a_step_that_failed_is_made_shorter_as_its_gain_says() {
        let (values, g) = ([4.0, 1.0], [8.0, 3.0]);
        let h = DMatrix::from_diagonal(&DVector::from_column_slice(&values));
        let curvature = of(&h, DVector::from_column_slice(&g));
        for damping in [0.0, 0.7] {
            let length = |d: f64| (0..2).map(|k| (g[k] / (values[k] + d)).powi(2)).sum::<f64>().sqrt();
            let slope: f64 = (0..2).map(|k| g[k] * g[k] / (values[k] + damping)).sum();
            // a parabola with this slope that has fallen by `loss` at the end of the step has its maximum at this
            // fraction of the step
            for (loss, part) in [(0.1 * slope, 1.0 / 2.2), (f64::INFINITY, 0.25), (-0.01 * slope, 0.5)] {
                let found = length(curvature.damping_after_failure(&h, damping, -loss)) / length(damping);
                assert!((found - part).abs() < 1e-4, "{damping} {loss}: {found} {part}");
            }
        }
    }
}
