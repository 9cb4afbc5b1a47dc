//! A positive definite model of -Hessian, and the steps that it asks for.

use std::sync::OnceLock;

use nalgebra::{DMatrix, DVector};

use crate::estimate::local::Tangent;
use crate::linalg::symmetric;

/// A positive definite model of -Hessian: scaled to unit diagonal, eigenvalues by absolute value, flat directions left out.
#[derive(Debug, Clone)]
pub(crate) struct Curvature {
    scale: DVector<f64>,
    scaled: DMatrix<f64>,
    /// Scaled as well.
    gradient: DVector<f64>,
    /// R with R'R = `scaled`, upper triangular, where no eigenvalue is negative or flat: it is all that a plain step takes.
    root: Option<DMatrix<f64>>,
    /// Worked out when asked for.
    spectrum: OnceLock<Spectrum>,
}

/// Eigenvalues in ascending order.
#[derive(Debug, Clone)]
struct Spectrum {
    values: Vec<f64>,
    vectors: DMatrix<f64>,
    /// Gradient in the eigenvectors.
    gradient: DVector<f64>,
}

/// Further from the optimum than this (in standard errors), by the model's account, the model is not to be trusted.
const FAR: f64 = 1.0;

/// A step that fails is tried again at no less and no more than these parts of its length.
const SHORTEST: f64 = 0.25;
const LONGEST: f64 = 0.5;

/// Information in a coordinate, at its natural size, below this part of the largest is rounding.
pub(crate) const NOTHING: f64 = 1e-14;
/// Scaled eigenvalues below this are flat: the data say nothing there.
pub(crate) const FLAT: f64 = 1e-10;
/// Where all are surely above this the root takes the place of the eigenvectors, and loses no digits by it.
const REGULAR: f64 = 1e-8;

impl Curvature {
    pub(crate) fn new(tangent: &Tangent) -> Curvature {
        let h = &tangent.information;
        let n = h.nrows();
        let own = |i: usize| h[(i, i)].abs() * tangent.sizes[i].powi(2);
        let largest = (0..n).map(own).fold(0.0, f64::max);
        let unit = |i: usize| if own(i) > NOTHING * largest { h[(i, i)].abs().sqrt().recip() } else { 0.0 };
        let scale = DVector::from_fn(n, |i, _| unit(i));
        let scaled = DMatrix::from_fn(n, n, |i, j| scale[i] * h[(i, j)] * scale[j]);
        let gradient = tangent.gradient.component_mul(&scale);
        let root = regular_root(&scaled);
        Curvature { scale, scaled, gradient, root, spectrum: OnceLock::new() }
    }

    fn spectrum(&self) -> &Spectrum {
        self.spectrum.get_or_init(|| {
            let (values, vectors) = symmetric::eigen(&self.scaled);
            let gradient = vectors.transpose() * &self.gradient;
            Spectrum { values, vectors, gradient }
        })
    }

    /// Newton decrement: the distance to the optimum of the model, in standard errors.
    pub(crate) fn decrement(&self) -> f64 {
        match &self.root {
            Some(root) => solved_below(root, &self.gradient).norm(),
            None => self.spectrum().decrement(),
        }
    }

    /// Damping for a place where the value is not concave: the model holds less far.
    pub(crate) fn doubtful(&self) -> f64 {
        if self.root.is_some() {
            return 0.0;
        }
        let least = self.spectrum().values.first().copied().unwrap_or(0.0);
        if least < -1e-3 && self.decrement() > FAR { 0.6 * -least } else { 0.0 }
    }

    /// The damping for the next try after a step with this much gave only `gain`: the value along the step as a parabola with
    /// the slope at the place says how much shorter, between a quarter and a half.
    pub(crate) fn shorter(&self, damping: f64, gain: f64) -> f64 {
        let spectrum = self.spectrum();
        let length = |d: f64| spectrum.terms().map(|(_, h, g)| (g / (h + d)).powi(2)).sum::<f64>().sqrt();
        let slope: f64 = spectrum.terms().map(|(_, h, g)| g * g / (h + damping)).sum();
        let part = slope / (2.0 * (slope - gain)); // zero where there is no value
        let wanted = length(damping) * part.clamp(SHORTEST, LONGEST);
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

    /// Step along the tangent basis with this much damping, and the gain it promises.
    pub(crate) fn step(&self, damping: f64) -> (DVector<f64>, f64) {
        let (step, gain) = match &self.root {
            Some(root) if damping == 0.0 => {
                let half = solved_below(root, &self.gradient);
                let gain = 0.5 * half.norm_squared();
                (solved_above(root, half), gain)
            }
            _ => self.spectrum().step(damping),
        };
        (step.component_mul(&self.scale), gain)
    }
}

impl Spectrum {
    /// (number, |eigenvalue|, gradient) of each direction that is not flat.
    fn terms(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let kept = |&(_, h, _): &(usize, f64, f64)| h > FLAT;
        self.values.iter().enumerate().map(|(k, v)| (k, v.abs(), self.gradient[k])).filter(kept)
    }

    fn decrement(&self) -> f64 {
        self.terms().map(|(_, h, g)| g * g / h).fold(0.0, |a, b| a + b).sqrt() // a sum of nothing is -0
    }

    fn step(&self, damping: f64) -> (DVector<f64>, f64) {
        let mut along = DVector::zeros(self.values.len());
        let mut gain = 0.0;
        for (k, h, g) in self.terms() {
            let s = g / (h + damping);
            along[k] = s;
            gain += g * s - 0.5 * h * s * s;
        }
        (&self.vectors * along, gain)
    }
}

/// R, upper triangular with R'R = A; `None` where an eigenvalue of A may be below [`REGULAR`]: the least one is at least the inverse
/// of Σ 1/λ = ‖R⁻¹‖².
fn regular_root(a: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = a.nrows();
    let mut root = DMatrix::<f64>::zeros(n, n);
    for k in 0..n {
        for i in 0..=k {
            let done = root.column(i).rows(0, i).dot(&root.column(k).rows(0, i));
            let left = a[(i, k)] - done;
            if i < k {
                root[(i, k)] = left / root[(i, i)];
            } else if left > REGULAR {
                root[(k, k)] = left.sqrt();
            } else {
                return None;
            }
        }
    }
    let mut inverses = 0.0;
    let mut column = DVector::zeros(n);
    for k in 0..n {
        column.rows_mut(0, k + 1).fill(0.0);
        column[k] = 1.0;
        above(&root, &mut column, k + 1);
        inverses += column.rows(0, k + 1).norm_squared();
    }
    (inverses * REGULAR <= 1.0).then_some(root)
}

/// R⁻ᵀg.
fn solved_below(root: &DMatrix<f64>, g: &DVector<f64>) -> DVector<f64> {
    let mut out = DVector::zeros(g.len());
    for k in 0..g.len() {
        out[k] = (g[k] - root.column(k).rows(0, k).dot(&out.rows(0, k))) / root[(k, k)];
    }
    out
}

/// R⁻¹g.
fn solved_above(root: &DMatrix<f64>, mut g: DVector<f64>) -> DVector<f64> {
    let n = g.len();
    above(root, &mut g, n);
    g
}

/// R⁻¹g in place, of a g whose first numbers alone are not zero.
fn above(root: &DMatrix<f64>, g: &mut DVector<f64>, numbers: usize) {
    for l in (0..numbers).rev() {
        g[l] /= root[(l, l)];
        let x = g[l];
        g.rows_mut(0, l).axpy(-x, &root.column(l).rows(0, l), 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(scaled: DMatrix<f64>, gradient: DVector<f64>) -> Curvature {
        let root = regular_root(&scaled);
        let scale = DVector::from_element(gradient.len(), 1.0);
        Curvature { scale, scaled, gradient, root, spectrum: OnceLock::new() }
    }

    #[test]
    fn the_root_and_the_eigenvectors_say_the_same() {
        let n = 5;
        let wave = DMatrix::from_fn(n, n, |i, k| ((3 * i + 7 * k) as f64).sin());
        let h = &wave * wave.transpose() + DMatrix::identity(n, n) * 0.05;
        let curvature = of(h, DVector::from_fn(n, |i, _| (i as f64).cos()));
        assert!(curvature.root.is_some(), "it is regular");
        let (step, gain) = curvature.step(0.0);
        let (expected, promised) = curvature.spectrum().step(0.0);
        assert!((&step - &expected).norm() < 1e-11 * expected.norm(), "{step} {expected}");
        assert!((gain - promised).abs() < 1e-11 * promised, "{gain} {promised}");
        let (decrement, by_values) = (curvature.decrement(), curvature.spectrum().decrement());
        assert!((decrement - by_values).abs() < 1e-11 * by_values, "{decrement} {by_values}");
        assert_eq!(curvature.doubtful(), 0.0);
    }

    #[test]
    fn where_a_direction_is_flat_or_not_concave_there_is_no_root() {
        let diagonal = |least: f64| DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, least, 2.0]));
        for least in [0.0, 1e-12, -0.5, f64::NAN] {
            assert!(regular_root(&diagonal(least)).is_none(), "{least}");
        }
        assert!(regular_root(&diagonal(1e-6)).is_some());
        let hilbert = DMatrix::from_fn(9, 9, |i, k| 1.0 / (i + k + 1) as f64); // least eigenvalue 3e-12
        assert!(regular_root(&hilbert).is_none());
        let flat = of(diagonal(0.0), DVector::from_vec(vec![3.0, 100.0, 0.0]));
        assert_eq!(flat.decrement(), 3.0);
        assert!(of(diagonal(-0.5), DVector::from_vec(vec![3.0, 1.0, 0.0])).doubtful() > 0.29);
    }
}
