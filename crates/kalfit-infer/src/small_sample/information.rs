//! The information about θ, expected (14.5) or observed (14.4), and its inverse over the directions that it identifies.

use nalgebra::{DMatrix, DVector};

use crate::small_sample::pass::{Pass, Totals};
use kalfit_algebra::symmetric;

/// Eigenvalues of the information, in units of the information at a known mean, below this one count as zero.
const MIN_EIGENVALUE: f64 = 1e-10;
/// A derivative that lies outside of the identified directions by more than this fraction has no variance.
const MAX_OUTSIDE: f64 = 1e-6;

/// V_θ: covariance of the estimates of θ over all directions that the structure leaves free, singular Σ or not.
#[derive(Debug, Clone)]
pub(super) struct ThetaLaw {
    /// V_θ, θ × θ.
    pub(super) covariance: DMatrix<f64>,
    /// Directions of θ without information, θ × directions, in units of the information at a known mean.
    open: DMatrix<f64>,
    /// These units for each θ.
    units: DMatrix<f64>,
}

/// Sums over the coordinates of the mean: C on the informed directions, and what C moves with.
#[derive(Debug, Clone)]
pub(super) struct MeanSums {
    /// C = M⁻¹, q × q; zero in directions that no test informs.
    pub(super) covariance: DMatrix<f64>,
    /// Directions of the mean that no test informs, q × directions.
    pub(super) open: DMatrix<f64>,
    /// M_a of each θ.
    pub(super) slopes: Vec<DMatrix<f64>>,
    /// u_a = (K_a w)_β of each θ, where the data are there; ∂β̂/∂θ_a = C u_a.
    pub(super) moves: Vec<DVector<f64>>,
    /// w = (-β̂, 1), where the data are there.
    residual: Option<DVector<f64>>,
    /// First row of the mean in a bordered matrix.
    first: usize,
    width: usize,
}

impl MeanSums {
    /// From the totals with the mean's coordinates from row `first` on, `q` of them.
    pub(super) fn of(totals: &Totals, first: usize, q: usize) -> MeanSums {
        let of = |k: &DMatrix<f64>| k.view((first, first), (q, q)).into_owned();
        let information = of(&totals.k);
        let (size, values, vectors) = symmetric::scaled_eigen(&information);
        let seen = |value: f64| value > MIN_EIGENVALUE;
        let inverse = symmetric::from_eigen(&vectors, values.iter().map(|&v| if seen(v) { v.recip() } else { 0.0 }));
        let covariance = DMatrix::from_fn(q, q, |i, j| inverse[(i, j)] / (size[i] * size[j]));
        let unseen: Vec<usize> = (0..q).filter(|&k| !seen(values[k])).collect();
        let open = DMatrix::from_fn(q, unseen.len(), |i, c| vectors[(i, unseen[c])] / size[i]);
        let width = totals.k.nrows();
        let residual = (width > first + q).then(|| {
            let estimate = &covariance * totals.k.view((first, width - 1), (q, 1));
            DVector::from_iterator(q + 1, estimate.iter().map(|x| -x).chain([1.0]))
        });
        let moved = |k: &DMatrix<f64>, w: &DVector<f64>| k.view((first, first), (q, q + 1)) * w;
        let moves = residual.iter().flat_map(|w| totals.slopes.iter().map(|k| moved(k, w))).collect();
        let slopes = totals.slopes.iter().map(of).collect();
        MeanSums { covariance, open, slopes, moves, residual, first, width }
    }

    /// A bordered matrix with C for the mean, and ww' with the data.
    fn derivative(&self, with_data: bool) -> DMatrix<f64> {
        let mut y = DMatrix::zeros(self.width, self.width);
        let q = self.covariance.nrows();
        y.view_mut((self.first, self.first), (q, q)).copy_from(&self.covariance);
        if let Some(w) = self.residual.as_ref().filter(|_| with_data) {
            y.view_mut((self.first, self.first), (q + 1, q + 1)).ger(1.0, w, w, 1.0);
        }
        y
    }
}

/// -½∂²(λ + log|M|)/∂θ_a∂θ_b, the expected information under the restricted likelihood (14.5).
pub(super) fn expected(pass: &Pass<'_>, mean: &MeanSums) -> Option<DMatrix<f64>> {
    let bent = pass.curvature(&mean.derivative(false))?;
    let turned: Vec<DMatrix<f64>> = mean.slopes.iter().map(|slope| &mean.covariance * slope).collect();
    Some(DMatrix::from_fn(bent.nrows(), bent.ncols(), |a, b| {
        -0.5 * (bent[(a, b)] - turned[a].dot(&turned[b].transpose()))
    }))
}

/// ½∂²(-2ℓ_R)/∂θ_a∂θ_b, the observed information under the restricted likelihood (14.4).
pub(super) fn observed(pass: &Pass<'_>, mean: &MeanSums) -> Option<DMatrix<f64>> {
    let bent = pass.curvature(&mean.derivative(true))?;
    let c = &mean.covariance;
    let turned: Vec<DMatrix<f64>> = mean.slopes.iter().map(|slope| c * slope).collect();
    Some(DMatrix::from_fn(bent.nrows(), bent.ncols(), |a, b| {
        let moves = 2.0 * mean.moves[a].dot(&(c * &mean.moves[b]));
        0.5 * (bent[(a, b)] - turned[a].dot(&turned[b].transpose()) - moves)
    }))
}

impl ThetaLaw {
    /// The inverse of an information over the free directions; `None` where the information is not positive
    /// semidefinite.
    pub(super) fn of(pass: &Pass<'_>, information: &DMatrix<f64>) -> Option<ThetaLaw> {
        let width = pass.width();
        let directions = &pass.theta.directions;
        let along = |matrix: &DMatrix<f64>| directions.transpose() * matrix * directions;
        let known_mean = along(&(pass.curvature(&DMatrix::zeros(width, width))? * -0.5));
        let (own, n) = (along(information), directions.ncols());
        if own.iter().chain(known_mean.iter()).any(|x| !x.is_finite()) {
            return None;
        }
        // the observed information may exceed that at a known mean
        let size: Vec<f64> = (0..n).map(|a| known_mean[(a, a)].max(own[(a, a)]).max(0.0).sqrt()).collect();
        let unit = |a: usize| if size[a] > 0.0 { size[a].recip() } else { 1.0 };
        let scaled = DMatrix::from_fn(n, n, |a, b| unit(a) * own[(a, b)] * unit(b));
        let (values, vectors) = symmetric::eigen(&scaled);
        if values.first().is_some_and(|least| *least < -MIN_EIGENVALUE) {
            return None;
        }
        let units = DMatrix::from_fn(directions.nrows(), n, |i, a| directions[(i, a)] * unit(a));
        let inverse = |&value: &f64| if value > MIN_EIGENVALUE { value.recip() } else { 0.0 };
        let covariance = &units * symmetric::from_eigen(&vectors, values.iter().map(inverse)) * units.transpose();
        let unseen: Vec<usize> = (0..n).filter(|&k| values[k] <= MIN_EIGENVALUE).collect();
        let open = &units * vectors.select_columns(&unseen);
        Some(ThetaLaw { covariance, open, units })
    }

    /// g'Vg; `None` where g has a part that the data do not identify.
    pub(super) fn variance(&self, g: &DVector<f64>) -> Option<f64> {
        let size = (self.units.transpose() * g).amax();
        let outside = (self.open.transpose() * g).amax();
        let variance = g.dot(&(&self.covariance * g));
        (outside <= MAX_OUTSIDE * size && variance.is_finite()).then_some(variance.max(0.0))
    }
}
