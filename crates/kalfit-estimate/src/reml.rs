//! The restricted likelihood (theory §3): the likelihood of Σ after the mean is integrated out.
//!
//! With μ_j = m0 + X_jβ, X_j = E_jB, and C = Σ_j X_j'W_jX_j the information on β at a known Σ,
//!
//! ```text
//! ℓ_R(Σ) = max_β ℓ(β, Σ) + a(Σ)        a = -½ log|C| + ½ q log 2π
//! da[D] = ½ Σ_j tr(C⁻¹ X_j'W_j D W_jX_j)
//! -d²a[D,E] = Σ_j tr(W_jX_j C⁻¹ X_j'W_j D W_j E) - ½ tr(C⁻¹ Ċ[D] C⁻¹ Ċ[E])        Ċ[D] = -Σ_j X_j'W_j D W_jX_j
//! ```
//!
//! a does not depend on β, so the search is over (β, Σ) jointly as under maximum likelihood. β is in the user's units.
//! A direction of β that no test informs is left out of |C|: the determinant is then the product of the non-zero
//! eigenvalues of C in the user's coordinates, and q is the number of these eigenvalues. That is a convention; only
//! fits that leave the same directions uninformed can be compared.

use nalgebra::{DMatrix, DVector};

use kalfit_algebra::echelon::echelon;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::symmetric;
use kalfit_algebra::symmetric::{pair, pairs};

/// Scaled eigenvalues of the information on β below this are zero: no test informs that direction.
const UNINFORMED: f64 = 1e-10;

/// The part of a(Σ) that does not depend on Σ: the informed directions of β, and the user's units.
#[derive(Debug, Clone)]
pub(crate) struct Restriction {
    /// Directions Z of β (in η) that represent the informed ones, q × rank.
    informed: DMatrix<f64>,
    /// ½ rank log 2π, less half of what converts log|Z'CZ| to the log-determinant in the user's coordinates.
    constant: f64,
}

/// a(Σ) at a point, with its derivatives.
#[derive(Debug, Clone)]
pub(crate) struct RemlTerm {
    /// Value of a(Σ).
    pub(crate) value: f64,
    /// V = C⁻¹ on the informed directions, zero elsewhere: covariance of β at a known Σ, in η (q × q).
    pub(crate) covariance: DMatrix<f64>,
    /// A = ½ Σ W X V X'W: a changes by tr(A dΣ).
    pub(crate) score: DMatrix<f64>,
    /// ½ tr(V Ċ[D] V Ċ[E]), elements × elements.
    pub(crate) curvature: DMatrix<f64>,
}

impl Restriction {
    /// The restriction from the information on the free mean coordinates at Σ = 0 (q × q, in η) and the derivative of
    /// those coordinates by the user's β (q × q).
    pub(crate) fn new(information: &DMatrix<f64>, by_user: &DMatrix<f64>) -> Restriction {
        let q = information.nrows();
        // in coordinates of unit information neither units nor a large element can hide the rank
        let unit = |i: usize| if information[(i, i)] > 0.0 { information[(i, i)].sqrt().recip() } else { 1.0 };
        let unit = DVector::from_fn(q, |i, _| unit(i));
        let scaled = DMatrix::from_fn(q, q, |i, j| unit[i] * information[(i, j)] * unit[j]);
        let (values, vectors) = symmetric::eigen(&scaled);
        let empty: Vec<usize> = (0..q).filter(|&k| values[k] < UNINFORMED).collect();
        let (pivots, null) = echelon(vectors.select_columns(&empty));
        let informed_elements: Vec<usize> = (0..q).filter(|i| !pivots.contains(i)).collect();
        let informed =
            DMatrix::from_fn(q, informed_elements.len(), |i, c| if i == informed_elements[c] { unit[i] } else { 0.0 });
        // With U = by_user and the null space N of C, the product of the non-zero eigenvalues of U'CU is
        // |Z'CZ| |N'(UU')⁻¹N| |U|² / |Z N|²; N is in echelon form, so |Z N| is the product of the units.
        let to_user = by_user.clone().lu();
        let null = DMatrix::from_fn(q, pivots.len(), |i, c| unit[i] * null[(i, c)]);
        let null = to_user.solve(&null).expect("the user's coordinates are coordinates");
        let log_units: f64 = unit.iter().map(|unit| unit.ln()).sum();
        let log_volume = to_user.u().diagonal().iter().map(|x| x.abs().ln()).sum::<f64>();
        let log_null = null.qr().r().diagonal().iter().map(|x| x.abs().ln()).sum::<f64>();
        let rank = informed_elements.len() as f64;
        let constant = 0.5 * rank * std::f64::consts::TAU.ln() - log_null - log_volume + log_units;
        Restriction { informed, constant }
    }

    /// q, the number of informed directions.
    pub(crate) fn rank(&self) -> usize {
        self.informed.ncols()
    }

    /// Whether C = `information` informs every direction that C = `whole` informs, even if much less.
    pub(crate) fn informs(&self, information: &DMatrix<f64>, whole: &DMatrix<f64>) -> bool {
        let own = |of: &DMatrix<f64>| self.informed.transpose() * of * &self.informed;
        let Some(unit) = own(whole).cholesky() else { return false };
        let half = unit.l().solve_lower_triangular(&own(information));
        let both = half.and_then(|half| unit.l().solve_lower_triangular(&half.transpose()));
        both.is_some_and(|scaled| symmetric::eigen(&scaled).0.first().is_none_or(|least| *least > UNINFORMED))
    }

    /// a and its derivatives from C (q × q) and Σ_j (X'W ⊗ WX) (pairs of β × elements). `None` where C is not
    /// positive definite on the informed directions.
    pub(crate) fn at(
        &self,
        information: &DMatrix<f64>,
        spread: &DMatrix<f64>,
        elements: &Elements,
    ) -> Option<RemlTerm> {
        let own = self.informed.transpose() * information * &self.informed;
        let factor = own.cholesky()?.l();
        let half = factor.solve_lower_triangular(&self.informed.transpose())?.transpose(); // V = half half'
        let covariance = &half * half.transpose();
        let value = self.constant - factor.diagonal().iter().map(|x| x.ln()).sum::<f64>();
        let score = score(&covariance, spread, elements);
        let curvature = curvature(&half, spread, elements);
        Some(RemlTerm { value, covariance, score, curvature })
    }
}

/// A = ½ Σ_cd V_cd × (row (c, d) of the spread), p × p.
fn score(covariance: &DMatrix<f64>, spread: &DMatrix<f64>, elements: &Elements) -> DMatrix<f64> {
    let q = covariance.nrows();
    let weights = packed_weights(covariance);
    let packed = spread.transpose() * DVector::from_fn(pairs(q), |k, _| 0.5 * weights[k]);
    elements.unpack(&packed)
}

/// The elements of a symmetric matrix, packed, with elements off the diagonal times two.
fn packed_weights(matrix: &DMatrix<f64>) -> DVector<f64> {
    let q = matrix.nrows();
    let mut packed = DVector::zeros(pairs(q));
    for c in 0..q {
        for d in 0..=c {
            packed[pair(c, d)] = if c == d { matrix[(c, c)] } else { 2.0 * matrix[(c, d)] };
        }
    }
    packed
}

/// ½ tr(Y_s Y_t) with Y_s = half' Ċ[σ_s] half.
fn curvature(half: &DMatrix<f64>, spread: &DMatrix<f64>, elements: &Elements) -> DMatrix<f64> {
    let (q, rank) = half.shape();
    let mut y = DMatrix::zeros(rank * rank, elements.count());
    for (s, (k, l)) in elements.all().enumerate() {
        let multiplicity = if k == l { 1.0 } else { 2.0 };
        let slope = DMatrix::from_fn(q, q, |c, d| multiplicity * spread[(pair(c, d), s)]);
        let along = half.transpose() * slope * half;
        y.column_mut(s).copy_from_slice(along.as_slice());
    }
    y.transpose() * y * 0.5
}
