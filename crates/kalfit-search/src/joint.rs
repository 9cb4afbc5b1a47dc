//! Joint observed information of (α, μ, Σ), from differences of exact gradients; without differences where one value
//! scales all noise.
//!
//! At fixed (μ, Σ) a small change of α gives a column of -∂²ℓ/∂α∂(α, μ, Σ). Values without a common test change at the
//! same time: thousands of levels cost as many runs of the filters as one test has values. Values of single tests are
//! eliminated test by test, so that no matrix over all values is ever formed.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, DVectorView};

use crate::coordinates::in_variance;
use crate::covariances::ValueCovariances;
use crate::differences::Differences;
use crate::profile_likelihood::{ProfileLikelihood, ProfilePoint, SecondDerivatives};
use crate::sparsity::JacobianSparsity;
use kalfit_algebra::symmetric;
use kalfit_estimate::{NEGLIGIBLE_INFORMATION, NoiseInformation, Tangent};

/// Number of free values up to which values of single tests are not eliminated test by test.
const DENSE_VALUES: usize = 24;
/// Slope and curvature of ℓ in a logarithm below which both count as zero.
pub(crate) const FLAT_LOGARITHM: f64 = 1e-7;
/// Eigenvalue of the scaled information below which ℓ itself is evaluated to both sides along the eigenvector.
const FAINT_EIGENVALUE: f64 = 1e-5;
/// Eigenvalue of the scaled information below which a result of differences may be rounding.
const ROUNDING_EIGENVALUE: f64 = 1e-6;
/// Scaled eigenvalue of the information up to which a direction is flat.
pub(crate) const FLAT_EIGENVALUE: f64 = 1e-10;
/// Component of a unit vector, in coordinates of unit curvature, above which the coordinate takes part in the
/// direction.
pub(crate) const MIN_COMPONENT: f64 = 1e-3;
/// Curvature in a coordinate of F, Σ = FF', in units of the largest remaining score, up to which the curvature may come
/// from that score alone.
const MAX_SCORE_CURVATURE: f64 = 10.0;
/// Score in a coordinate of F, relative to the square root of the information, up to which such a curvature is
/// discarded.
const MAX_REMAINING_SCORE: f64 = 1e-9;

/// The information in coordinates of α and along the tangent basis of (μ, Σ).
#[derive(Debug, Clone)]
pub struct JointInformation {
    /// Indices of the values that move.
    pub(crate) active: Vec<usize>,
    /// Indices of the values that are eliminated test by test, one list per test.
    private: Vec<Vec<usize>>,
    /// Indices of the values that are not eliminated test by test.
    shared: Vec<usize>,
    /// Nonzero entries of -∂²ℓ/∂α∂α by (row, column), both triangles.
    own: BTreeMap<(usize, usize), f64>,
    /// -∂²ℓ/∂α∂(μ, Σ), values × tangent basis.
    cross: DMatrix<f64>,
    /// -∂²ℓ/∂(μ, Σ)² along the tangent basis, m × m.
    inner: DMatrix<f64>,
}

/// The step d with H d = g, where H is the information and g the gradient; negative eigenvalues of H are replaced by
/// absolute values.
#[derive(Debug, Clone)]
pub(crate) struct JointStep {
    /// Step of each coordinate of α; zero for values that do not move.
    pub(crate) alpha: Vec<f64>,
    /// Step along the tangent basis of (μ, Σ).
    pub(crate) inner: DVector<f64>,
    /// Newton decrement δ; the predicted rise of ℓ is ½ δ².
    pub(crate) decrement: f64,
    /// Whether ℓ is concave, except along flat directions.
    pub(crate) concave: bool,
}

impl JointStep {
    /// The step with the decrement of such a step: δ² = g'd.
    pub(crate) fn with_decrement(self, gradient: &[f64], inner: &DVector<f64>) -> JointStep {
        let along = self.alpha.iter().zip(gradient).map(|(d, g)| d * g).sum::<f64>() + self.inner.dot(inner);
        JointStep { decrement: along.max(0.0).sqrt(), ..self }
    }
}

/// A direction in α and (μ, Σ), an eigenvector of the scaled information.
#[derive(Debug, Clone)]
pub(crate) struct InformationDirection {
    /// Component of the direction in α, with a largest entry of size one; zero for values that are not shared.
    pub(crate) alpha: Vec<f64>,
    /// Largest component of the unit eigenvector in α, in coordinates of unit curvature.
    pub(crate) share: f64,
    /// -∂²ℓ along the direction, from differences.
    pub(crate) curvature: f64,
    /// Index of the eigenvector of the information.
    pub(crate) eigenvector_index: usize,
    /// Eigenvalue of the scaled information per unit of curvature along the direction.
    unit: f64,
}

impl InformationDirection {
    /// Eigenvalue of the scaled information for a given curvature along the direction.
    pub(crate) fn eigenvalue_of(&self, curvature: f64) -> f64 {
        self.unit * curvature
    }

    /// Whether α takes part in the direction.
    pub(crate) fn is_of_alpha(&self) -> bool {
        self.share > MIN_COMPONENT
    }

    /// Whether differences hardly resolve the curvature.
    pub(crate) fn is_faint(&self) -> bool {
        self.eigenvalue_of(self.curvature).abs() < FAINT_EIGENVALUE
    }

    /// Whether all of the curvature may be rounding.
    pub(crate) fn may_be_rounding(&self) -> bool {
        self.eigenvalue_of(self.curvature).abs() < ROUNDING_EIGENVALUE
    }

    /// The eigenvalue for another curvature along the direction.
    pub(crate) fn known_eigenvalue(&self, curvature: f64) -> KnownEigenvalue {
        KnownEigenvalue {
            eigenvector_index: self.eigenvector_index,
            value: self.eigenvalue_of(curvature),
            share: self.share,
        }
    }
}

/// An eigenvalue of the scaled information that is known better than from differences; `value` is zero for a flat
/// direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownEigenvalue {
    eigenvector_index: usize,
    value: f64,
    /// Largest component of the unit eigenvector in α.
    share: f64,
}

impl JointInformation {
    /// The information at a solved α over the `active` values; with two-sided differences (`central`), accurate to
    /// about 1e-7.
    pub(crate) fn new(
        objective: &ProfileLikelihood<'_>,
        iterate: &ProfilePoint,
        active: &[bool],
        central: bool,
    ) -> JointInformation {
        let n = iterate.values.len();
        let inner = inner_information(&iterate.estimate.state.newton_iterate.tangent);
        let list: Vec<usize> = (0..n).filter(|&s| active[s]).collect();
        let tests = match &iterate.second_derivatives {
            SecondDerivatives::Tests(tests) => tests,
            SecondDerivatives::Scale(exact) => {
                return JointInformation::of_scale(exact, list, inner).without_flat(objective, iterate);
            }
        };
        let test_dependences = JacobianSparsity::of(objective, tests, n);
        let alone = |s: usize| {
            !objective.is_remote()
                && list.len() > DENSE_VALUES
                && test_dependences.tests[s].len() == 1
                && !test_dependences.matrix[s]
        };
        let mut by_test: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        list.iter()
            .filter(|&&s| alone(s))
            .for_each(|&s| by_test.entry(test_dependences.tests[s][0]).or_default().push(s));
        let mut joint = JointInformation {
            shared: list.iter().copied().filter(|&s| !alone(s)).collect(),
            private: by_test.into_values().collect(),
            active: list,
            own: BTreeMap::new(),
            cross: DMatrix::zeros(n, inner.nrows()),
            inner,
        };
        let colours = test_dependences.colours(&joint.active, objective.restricted());
        let differences = Differences { objective, iterate, test_dependences: &test_dependences, central };
        for columns in objective.together(|| objective.each(&colours, |colour| differences.columns(colour))) {
            joint.own.extend(columns.own);
            columns.cross.into_iter().for_each(|(s, row)| joint.cross.set_row(s, &row));
        }
        joint.symmetrise();
        joint.without_flat(objective, iterate)
    }

    /// The information where one value scales all noise, without differences.
    fn of_scale(exact: &NoiseInformation, list: Vec<usize>, inner: DMatrix<f64>) -> JointInformation {
        let own = list.iter().map(|&s| ((s, s), exact.own)).collect();
        let cross = DMatrix::from_row_slice(1, inner.nrows(), exact.cross.as_slice());
        JointInformation { shared: list.clone(), private: Vec::new(), active: list, own, cross, inner }
    }

    /// Removes logarithms along which ℓ has neither slope nor curvature: differences give only rounding there.
    fn without_flat(mut self, objective: &ProfileLikelihood<'_>, iterate: &ProfilePoint) -> JointInformation {
        let flat = |s: usize| {
            objective.coordinates[s].log
                && self.entry(s, s).abs() < FLAT_LOGARITHM
                && iterate.gradient[s].abs() < FLAT_LOGARITHM
        };
        let kept: Vec<bool> = (0..iterate.values.len()).map(|s| !flat(s)).collect();
        self.active.retain(|&s| kept[s]);
        self.shared.retain(|&s| kept[s]);
        self.private.iter_mut().for_each(|block| block.retain(|&s| kept[s]));
        self.private.retain(|block| !block.is_empty());
        self
    }

    /// Whether no value is eliminated test by test.
    pub fn is_of_shared_values(&self) -> bool {
        self.private.is_empty()
    }

    /// Indices of the values that are not eliminated test by test.
    pub fn shared(&self) -> &[usize] {
        &self.shared
    }

    /// The information with no value eliminated test by test.
    #[cfg(test)]
    pub(crate) fn undivided(&self) -> JointInformation {
        JointInformation { shared: self.active.clone(), private: Vec::new(), ..self.clone() }
    }

    /// Information matrix over the active values, then the tangent basis.
    #[cfg(test)]
    pub(crate) fn undivided_matrix(&self) -> DMatrix<f64> {
        self.undivided().information()
    }

    fn entry(&self, s: usize, t: usize) -> f64 {
        let at = |s, t| self.own.get(&(s, t)).copied().unwrap_or(0.0);
        0.5 * (at(s, t) + at(t, s))
    }

    /// -∂²ℓ between the values of a block and (shared values, tangent basis), block × (k + m).
    fn border(&self, block: &[usize]) -> DMatrix<f64> {
        let k = self.shared.len();
        DMatrix::from_fn(block.len(), k + self.inner.nrows(), |i, c| {
            if c < k { self.entry(block[i], self.shared[c]) } else { self.cross[(block[i], c - k)] }
        })
    }

    fn block(&self, block: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(block.len(), block.len(), |i, k| self.entry(block[i], block[k]))
    }

    /// Information matrix in shared values and along the tangent basis, with private values eliminated.
    fn information(&self) -> DMatrix<f64> {
        self.reduced(&vec![0.0; self.cross.nrows()], &DVector::zeros(self.inner.nrows()), 0.0).0
    }

    /// Information matrix and gradient with private values eliminated, and whether ℓ is concave in the private values.
    fn reduced(&self, gradient: &[f64], inner: &DVector<f64>, damping: f64) -> (DMatrix<f64>, DVector<f64>, bool) {
        let (k, m) = (self.shared.len(), self.inner.nrows());
        let mut matrix = DMatrix::zeros(k + m, k + m);
        matrix.view_mut((0, 0), (k, k)).copy_from(&self.block(&self.shared));
        matrix.view_mut((k, k), (m, m)).copy_from(&self.inner);
        let cross = DMatrix::from_fn(k, m, |i, c| self.cross[(self.shared[i], c)]);
        matrix.view_mut((0, k), (k, m)).copy_from(&cross);
        matrix.view_mut((k, 0), (m, k)).copy_from(&cross.transpose());
        let mut right_side = DVector::zeros(k + m);
        self.shared.iter().enumerate().for_each(|(i, &s)| right_side[i] = gradient[s]);
        right_side.rows_mut(k, m).copy_from(inner);
        let mut concave = true;
        for block in &self.private {
            let (inverse, positive) = positive_inverse(&self.block(block), damping);
            concave &= positive;
            let border = self.border(block);
            let own = DVector::from_iterator(block.len(), block.iter().map(|&s| gradient[s]));
            let half = &inverse * &border;
            matrix -= border.transpose() * &half;
            right_side -= half.transpose() * own;
        }
        (matrix, right_side, concave)
    }

    /// The information with some noise levels, (slot, exponent), expressed in variances.
    pub(crate) fn in_variances(&self, levels: &[(usize, f64)], gradient: &[f64]) -> JointInformation {
        let mut joint = self.clone();
        for &(s, exponent) in levels {
            let own = joint.own.entry((s, s)).or_insert(0.0);
            *own = in_variance(*own, exponent, gradient[s]);
        }
        joint
    }

    /// Newton's step with Levenberg's damping, in coordinates of unit curvature; negative eigenvalues are replaced by
    /// absolute values.
    pub(crate) fn step(&self, gradient: &[f64], inner: &DVector<f64>, damping: f64) -> JointStep {
        self.step_with_pinned(gradient, inner, damping, &[])
    }

    /// Newton's step with given steps of some shared values, (slot, step).
    pub(crate) fn step_with_pinned(
        &self,
        gradient: &[f64],
        inner: &DVector<f64>,
        damping: f64,
        pinned: &[(usize, f64)],
    ) -> JointStep {
        let (mut matrix, mut right_side, mut concave) = self.reduced(gradient, inner, damping);
        for &(s, step) in pinned {
            let Some(at) = self.shared.iter().position(|&shared| shared == s) else { continue };
            right_side -= matrix.column(at) * step;
            matrix.row_mut(at).fill(0.0);
            matrix.column_mut(at).fill(0.0);
            right_side[at] = 0.0;
        }
        let (inverse, positive) = positive_inverse(&matrix, damping);
        concave &= positive;
        let mut x = inverse * &right_side;
        for &(s, step) in pinned {
            self.shared.iter().position(|&shared| shared == s).into_iter().for_each(|at| x[at] = step);
        }
        let k = self.shared.len();
        let mut alpha = vec![0.0; gradient.len()];
        self.shared.iter().enumerate().for_each(|(i, &s)| alpha[s] = x[i]);
        for block in &self.private {
            let (inverse, _) = positive_inverse(&self.block(block), damping);
            let own = DVector::from_iterator(block.len(), block.iter().map(|&s| gradient[s]));
            let step = inverse * (own - self.border(block) * &x);
            block.iter().zip(step.iter()).for_each(|(&s, step)| alpha[s] = *step);
        }
        let inner_step = x.rows(k, x.len() - k).into_owned();
        JointStep { alpha, inner: inner_step, decrement: 0.0, concave }.with_decrement(gradient, inner)
    }

    /// The direction in shared values along which ℓ curves upward most, with a largest entry of size one; `None` where
    /// ℓ curves upward nowhere.
    pub(crate) fn upward(&self) -> Option<Vec<f64>> {
        let (scale, values, vectors) = scaled_eigen(&self.information());
        let (worst, _) = values.iter().enumerate().filter(|(_, v)| **v < -1e-6).min_by(|a, b| a.1.total_cmp(b.1))?;
        self.direction(&scale, vectors.column(worst))
    }

    /// The direction in shared values of an eigenvector of the scaled information, with a largest entry of size one;
    /// `None` where the eigenvector has no component in shared values.
    fn direction(&self, scale: &[f64], vector: DVectorView<'_, f64>) -> Option<Vec<f64>> {
        let mut direction = vec![0.0; self.cross.nrows()];
        self.shared.iter().enumerate().for_each(|(i, &s)| direction[s] = scale[i] * vector[i]);
        let largest = direction.iter().fold(0.0, |most: f64, d| most.max(d.abs()));
        (largest > 0.0).then(|| direction.iter().map(|d| d / largest).collect())
    }

    /// Newton's step in shared values orthogonal to a direction, in coordinates of unit curvature, without faint
    /// eigenvectors. `None` where some value belongs to a single test.
    pub(crate) fn onto_ridge(&self, along: &[f64], gradient: &[f64]) -> Option<Vec<f64>> {
        let (profile_information, scale, ridge) = self.ridge(along)?;
        let (n, ridge) = (scale.len(), ridge.normalize());
        let across = DMatrix::identity(n, n) - &ridge * ridge.transpose();
        let scaled = DMatrix::from_fn(n, n, |i, k| scale[i] * profile_information[(i, k)] * scale[k]);
        let (values, vectors) = symmetric::eigen(&(&across * scaled * &across));
        let turned = values.iter().map(|&value| if value > FAINT_EIGENVALUE { value.recip() } else { 0.0 });
        let inverse = symmetric::from_eigen(&vectors, turned);
        let own = DVector::from_fn(n, |i, _| scale[i] * gradient[self.shared[i]]);
        let step = &across * (inverse * (&across * own));
        let mut all = vec![0.0; gradient.len()];
        self.shared.iter().enumerate().for_each(|(i, &s)| all[s] = scale[i] * step[i]);
        Some(all)
    }

    /// Profile information of the shared values, the scale that gives this matrix a unit diagonal, and the direction
    /// `along` in scaled coordinates.
    fn ridge(&self, along: &[f64]) -> Option<(DMatrix<f64>, Vec<f64>, DVector<f64>)> {
        let profile_information = self.profile_information()?;
        let scale: Vec<f64> = symmetric::sizes(&profile_information).into_iter().map(f64::recip).collect();
        let ridge = DVector::from_fn(scale.len(), |i, _| along[self.shared[i]] / scale[i]);
        Some((profile_information, scale, ridge))
    }

    /// Variance of the combination of α that [`onto_ridge`](Self::onto_ridge) does not change, in two parts: from other
    /// eigenvectors that differences resolve, and from other faint eigenvectors. `None` where some value belongs to a
    /// single test.
    pub(crate) fn other_variances(&self, direction: &InformationDirection) -> Option<[f64; 2]> {
        let (_, units, ridge) = self.ridge(&direction.alpha)?;
        let weights: Vec<f64> = ridge.iter().zip(&units).map(|(own, unit)| own / unit / ridge.norm_squared()).collect();
        Some(self.variances_of(&weights, direction))
    }

    /// Variance of a weighted sum of shared values from all eigenvectors but one, in two parts: from eigenvectors that
    /// differences resolve, and from faint eigenvectors.
    fn variances_of(&self, weights: &[f64], but: &InformationDirection) -> [f64; 2] {
        let (scale, values, vectors) = scaled_eigen(&self.information());
        let part = |k: usize| -> f64 { weights.iter().enumerate().map(|(i, w)| w * scale[i] * vectors[(i, k)]).sum() };
        let mut variances = [0.0; 2];
        for k in (0..values.len()).filter(|&k| k != but.eigenvector_index) {
            variances[usize::from(values[k].abs() < FAINT_EIGENVALUE)] +=
                part(k).powi(2) / values[k].abs().max(FLAT_EIGENVALUE);
        }
        variances
    }

    /// Index of the shared value with the largest component in a direction, in coordinates of unit curvature.
    fn largest_component(&self, along: &[f64]) -> Option<usize> {
        let size = |i: usize| along[self.shared[i]].abs() * self.curvature(self.shared[i]).abs().sqrt();
        (0..self.shared.len()).max_by(|&i, &k| size(i).total_cmp(&size(k)))
    }

    /// Variance of the value with the largest component in a direction, in steps along that direction, in two parts:
    /// from other eigenvectors that differences resolve, and from other faint eigenvectors.
    pub(crate) fn variances_of_most(&self, direction: &InformationDirection) -> Option<[f64; 2]> {
        let most = self.largest_component(&direction.alpha)?;
        let mut weights = vec![0.0; self.shared.len()];
        weights[most] = direction.alpha[self.shared[most]].recip();
        Some(self.variances_of(&weights, direction))
    }

    /// Loss of curvature along a direction where all shared values but the largest component adapt: b'H⁻¹b over the
    /// adapting values, b = -∂²ℓ along the direction and each value. `None` where some value belongs to a single test.
    pub(crate) fn curvature_lost(&self, along: &[f64], bends: &[f64]) -> Option<f64> {
        let (profile_information, held) = (self.profile_information()?, self.largest_component(along)?);
        let others = profile_information.remove_row(held).remove_column(held);
        let of = |i: usize| bends[self.shared[if i < held { i } else { i + 1 }]];
        let (scale, values, vectors) = scaled_eigen(&others);
        let scaled = DVector::from_fn(scale.len(), |i, _| scale[i] * of(i));
        let parts = vectors.transpose() * scaled;
        let known = values.iter().zip(&parts).filter(|(value, _)| **value > FAINT_EIGENVALUE);
        Some(known.map(|(value, part)| part * part / value).sum())
    }

    /// Profile information of the shared values, maximised over (μ, Σ); `None` where some value belongs to a single
    /// test.
    pub(crate) fn profile_information(&self) -> Option<DMatrix<f64>> {
        if !self.private.is_empty() {
            return None;
        }
        let (k, m) = (self.shared.len(), self.inner.nrows());
        let matrix = self.information();
        let (inverse, _) = positive_inverse(&matrix.view((k, k), (m, m)).into_owned(), 0.0);
        let cross = matrix.view((0, k), (k, m)).into_owned();
        Some(matrix.view((0, 0), (k, k)) - &cross * inverse * cross.transpose())
    }

    /// Directions in shared values along which ℓ hardly curves.
    pub(crate) fn faint(&self) -> Vec<InformationDirection> {
        self.directions().into_iter().filter(InformationDirection::is_faint).collect()
    }

    /// Eigenvectors of the information as directions in shared values.
    pub(crate) fn directions(&self) -> Vec<InformationDirection> {
        let (scale, values, vectors) = scaled_eigen(&self.information());
        let along = |k: usize| {
            let alpha = self.direction(&scale, vectors.column(k))?;
            let of_alpha = 0..self.shared.len();
            let largest = of_alpha.clone().map(|i| (scale[i] * vectors[(i, k)]).abs()).fold(0.0, f64::max);
            let share = of_alpha.map(|i| vectors[(i, k)].abs()).fold(0.0, f64::max);
            let unit = largest * largest;
            Some(InformationDirection { alpha, share, curvature: values[k] / unit, eigenvector_index: k, unit })
        };
        (0..values.len()).filter_map(along).collect()
    }

    /// Covariances of all coordinates: the inverse of the information, without flat directions.
    #[cfg(test)]
    pub(crate) fn covariances(&self) -> ValueCovariances {
        self.covariances_with(&[])
    }

    /// Covariances of all coordinates, with `known` eigenvalues in place of eigenvalues from differences.
    pub fn covariances_with(&self, known: &[KnownEigenvalue]) -> ValueCovariances {
        let mut covariances = self.shared_covariances(&self.information(), known);
        for block in &self.private {
            let (own, flat, _) = inverse(&self.block(block), (&[], 0));
            let carried = &own * self.border(block);
            let total = &own + &carried * &covariances.whole * carried.transpose();
            for (i, &s) in block.iter().enumerate() {
                covariances.alpha[s] = Some(total[(i, i)]).filter(|v| *v > 0.0 && !flat[i]);
            }
        }
        covariances
    }

    /// Covariances from another information matrix over the shared values and the tangent basis; `None` where some
    /// value is eliminated test by test.
    pub fn covariances_of(&self, information: &DMatrix<f64>) -> Option<ValueCovariances> {
        self.is_of_shared_values().then(|| self.shared_covariances(information, &[]))
    }

    /// Covariances of the shared values and along the tangent basis, from a given information matrix.
    fn shared_covariances(&self, information: &DMatrix<f64>, known: &[KnownEigenvalue]) -> ValueCovariances {
        let (whole, flat, directions) = inverse(information, (known, self.shared.len()));
        let mut alpha = vec![None; self.cross.nrows()];
        for (i, &s) in self.shared.iter().enumerate() {
            alpha[s] = Some(whole[(i, i)]).filter(|v| *v > 0.0 && !flat[i]);
        }
        ValueCovariances { alpha, shared: self.shared.clone(), whole, flat: directions }
    }

    /// Copies each entry (s, t) to (t, s) where that is absent: the column of a value that occurs only in matrices of
    /// the covariance structures has no entries for values of tests.
    fn symmetrise(&mut self) {
        for ((s, t), value) in self.own.clone() {
            self.own.entry((t, s)).or_insert(value);
        }
    }

    /// Curvature -∂²ℓ of one value, everything else fixed.
    pub(crate) fn curvature(&self, s: usize) -> f64 {
        self.entry(s, s)
    }
}

/// Newton's step for an information matrix and a gradient; `None` where the information is not positive.
pub(crate) fn solved(matrix: &DMatrix<f64>, gradient: &DVector<f64>) -> Option<DVector<f64>> {
    let (inverse, positive) = positive_inverse(matrix, 0.0);
    positive.then(|| inverse * gradient)
}

/// The inverse by absolute values of the eigenvalues, damped and without flat directions; and whether no eigenvalue is
/// negative.
pub(super) fn positive_inverse(matrix: &DMatrix<f64>, damping: f64) -> (DMatrix<f64>, bool) {
    let (scale, values, vectors) = scaled_eigen(matrix);
    let positive = values.iter().all(|v| *v > -1e-6);
    let turned =
        values.iter().map(|v| if v.abs() > FLAT_EIGENVALUE { (v.abs().max(1e-8) + damping).recip() } else { 0.0 });
    let inverse = symmetric::from_eigen(&vectors, turned);
    (DMatrix::from_fn(scale.len(), scale.len(), |i, k| scale[i] * inverse[(i, k)] * scale[k]), positive)
}

/// The inverse with `known` eigenvalues; whether each coordinate takes part in a flat direction; the directions that
/// are known to be flat. The first `of_alpha` coordinates are coordinates of α; in a known direction, [`MIN_COMPONENT`]
/// is relative to the largest component in α there.
fn inverse(
    matrix: &DMatrix<f64>,
    (known, of_alpha): (&[KnownEigenvalue], usize),
) -> (DMatrix<f64>, Vec<bool>, Vec<DVector<f64>>) {
    let (scale, mut values, vectors) = scaled_eigen(matrix);
    let n = scale.len();
    known.iter().for_each(|known| values[known.eigenvector_index] = known.value);
    let is_known = |k: usize| known.iter().any(|known| known.eigenvector_index == k && known.value > 0.0);
    let is_flat = |k: usize| values[k] <= FLAT_EIGENVALUE && !is_known(k);
    let mut flat: Vec<bool> = scale.iter().map(|s| *s == 0.0).collect();
    let takes_part = |i: usize, k: usize| {
        let own = known.iter().find(|known| known.eigenvector_index == k && i < of_alpha);
        vectors[(i, k)].abs() > MIN_COMPONENT * own.map_or(1.0, |known| known.share)
    };
    for k in (0..n).filter(|&k| is_flat(k)) {
        (0..n).filter(|&i| takes_part(i, k)).for_each(|i| flat[i] = true);
    }
    let turned = (0..n).map(|k| if is_flat(k) { 0.0 } else { values[k].recip() });
    let inverse = symmetric::from_eigen(&vectors, turned);
    let part = |i: usize, k: usize| if takes_part(i, k) { vectors[(i, k)] } else { 0.0 };
    let along = |&k: &usize| DVector::from_fn(n, |i, _| scale[i] * part(i, k));
    let whole = DMatrix::from_fn(n, n, |i, k| scale[i] * inverse[(i, k)] * scale[k]);
    let known_flat = known.iter().filter(|known| known.value == 0.0).map(|known| known.eigenvector_index);
    (whole, flat, known_flat.map(|k| along(&k)).collect())
}

fn scaled_eigen(matrix: &DMatrix<f64>) -> (Vec<f64>, Vec<f64>, DMatrix<f64>) {
    let n = matrix.nrows();
    let unit = |i: usize| if matrix[(i, i)] != 0.0 { matrix[(i, i)].abs().sqrt().recip() } else { 0.0 };
    let scale: Vec<f64> = (0..n).map(unit).collect();
    let scaled = DMatrix::from_fn(n, n, |i, k| scale[i] * 0.5 * (matrix[(i, k)] + matrix[(k, i)]) * scale[k]);
    let (values, vectors) = symmetric::eigen(&scaled);
    (scale, values, vectors)
}

/// The information along the tangent basis, with zeros for coordinates that the tests do not determine: coordinates
/// with nothing but rounding, and curvature of Σ = FF' from the remaining score alone.
fn inner_information(tangent: &Tangent) -> DMatrix<f64> {
    let n = tangent.sizes.len();
    let of = |i: usize| (tangent.information[(i, i)].abs(), tangent.gradient[i].abs(), tangent.sizes[i]);
    let own = |i: usize| of(i).0 * tangent.sizes[i].powi(2);
    let largest = (0..n).map(own).fold(0.0, f64::max);
    let of_sigma = tangent.mean..n;
    let largest_remaining_score = of_sigma.clone().map(|i| of(i).1 * of(i).2).fold(0.0, f64::max);
    let is_bend = |i: usize| {
        of_sigma.contains(&i)
            && own(i) <= MAX_SCORE_CURVATURE * largest_remaining_score
            && of(i).1 <= MAX_REMAINING_SCORE * of(i).0.sqrt()
    };
    // a mean that does not vary between tests has no size to compare with much larger variances
    let largest_mean = (0..tangent.mean).map(|i| of(i).0).fold(0.0, f64::max);
    let is_mean = |i: usize| i < tangent.mean && of(i).0 > NEGLIGIBLE_INFORMATION * largest_mean;
    let is_known = |i: usize| (own(i) > NEGLIGIBLE_INFORMATION * largest && !is_bend(i)) || is_mean(i);
    let is_known: Vec<bool> = (0..n).map(is_known).collect();
    let entry = |i: usize, k: usize| if is_known[i] && is_known[k] { tangent.information[(i, k)] } else { 0.0 };
    DMatrix::from_fn(n, n, entry)
}
