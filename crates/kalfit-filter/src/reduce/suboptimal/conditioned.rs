//! The information of estimates about x_0, by conditioning on the space in which the estimates are random (theory §8):
//! the part that does not depend on the values of the estimates.
#![expect(non_snake_case, reason = "the letters of the theory: B, D, E, G, N, S, T, U, V, W, phi")]

use nalgebra::{DMatrix, DVector};

use crate::reduce::suboptimal::jacobi::SingularValues;
use kalfit_model::Estimates;

/// A direction of ŝ, with elements scaled to unit deviation, is not random when the standard deviation is at most this
/// fraction of the largest standard deviation.
const CERTAIN_FRACTION: f64 = 1e-10;
/// A sum counts as zero up to this fraction of the size of the terms.
const CANCELLED_FRACTION: f64 = 1e-9;
/// Bound on the rounding error of a relation, as a multiple of the singular value that it leaves.
const ROUNDING_BOUND: f64 = 1e4;
/// Certain values may deviate by this fraction of the size of the terms, plus [`TOLERATED_DEVIATIONS`] standard
/// deviations of the elements of ŝ: files have only so many digits.
const TOLERATED_FRACTION: f64 = 1e-9;
const TOLERATED_DEVIATIONS: f64 = 1e-4;

/// The error that estimates would determine a combination of ξ exactly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ExactCombination;

/// The start of estimates: x_0 = a + Eσ + Pη, η white.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct EstimateStart<'a> {
    /// Indices of the q states that E picks.
    pub(super) entering: &'a [usize],
    /// P, a root of P0: n × l.
    pub(super) root: DMatrix<f64>,
}

/// Conditioned estimates, with η = V_B η_B + V_0 η', where η_B is the part of ζ that certain combinations of ŝ
/// determine, and η' is the rest:
///
/// ```text
/// u = ŝ - s̄ - Sa         y_B = B u = T_B σ + η_B         y = W u - C y_B = T σ + G η' + w,   w, η', η_B white
/// x_K = φa + s̄_1 + φEσ + (φPV_B) η_B + (φPV_0) η' + (D_1 V) w + rest × white
/// ```
#[derive(Debug, Clone)]
pub(super) struct Conditioned {
    /// W, r × m.
    pub(super) W: DMatrix<f64>,
    /// B, which gives y_B = B u.
    pub(super) B: DMatrix<f64>,
    /// C, which removes η_B from W u.
    pub(super) C: DMatrix<f64>,
    /// N: N u is certain to be zero.
    N: DMatrix<f64>,
    /// Tolerated deviation of each element of N u from zero.
    slack: DVector<f64>,
    /// [G T; 0 T_B]; the first `free` columns belong to η', all further columns to σ.
    pub(super) rows: DMatrix<f64>,
    /// Number of elements of η'.
    pub(super) free: usize,
    /// ½ log |Γ_hh| over an orthonormal basis of the range of Γ_hh, in the units of ŝ.
    pub(super) log_volume: f64,
    /// ½ log |cov(ŝ | σ, η')| over an orthonormal basis of the range of the covariance, in the units of ŝ.
    pub(super) log_spread: f64,
    /// φE, n × q.
    pub(super) phi_E: DMatrix<f64>,
    /// φPV_B, the effect of η_B on x_K.
    pub(super) from_taken: DMatrix<f64>,
    /// φPV_0, the effect of η' on x_K.
    pub(super) from_free: DMatrix<f64>,
    /// D_1V, the effect of w on x_K.
    pub(super) from_white: DMatrix<f64>,
    /// Root of the noise that x_K still has when w is known.
    pub(super) rest: DMatrix<f64>,
}

impl Conditioned {
    pub(super) fn new(estimates: &Estimates, entry: &EstimateStart<'_>) -> Result<Conditioned, ExactCombination> {
        let Estimates { sensitivities: S, transition: phi, root, .. } = estimates;
        let (n, m) = (phi.nrows(), S.nrows());
        let (D_1, D_h) = (root.rows(0, n), root.rows(n, m));
        let deviation: Vec<f64> = D_h.row_iter().map(|row| row.norm()).collect();
        let size: Vec<f64> = deviation.iter().map(|s| if *s > 0.0 { *s } else { 1.0 }).collect();
        let scaled = |a: &DMatrix<f64>| DMatrix::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] / size[j]);
        let singular_values = SingularValues::of(&DMatrix::from_fn(m, D_h.ncols(), |i, j| D_h[(i, j)] / size[i]));
        let r = singular_values.rank(CERTAIN_FRACTION);
        let U = singular_values.left.columns(0, r).into_owned();
        let V =
            DMatrix::from_fn(D_h.ncols(), r, |i, k| singular_values.scaled_right[(i, k)] / singular_values.values[k]);
        let W = scaled(&DMatrix::from_fn(r, m, |k, i| U[(i, k)] / singular_values.values[k]));
        let certain = scaled(&singular_values.left.columns(r, m - r).transpose());
        let (WS, SP) = (&W * S, S * &entry.root);
        let relations = Relations {
            rows: &certain,
            rounding_deviation: rounding_deviation(&singular_values, r, &deviation),
            WS: &WS,
        };
        let CertainInformation { V_B, V_0, T_B, B, left, log_values, basis } =
            relations.certain_information(S, entry)?;
        let C = &W * &SP * &V_B;
        let G = &W * &SP * &V_0;
        let T = WS.select_columns(entry.entering) - &C * &T_B;
        let N = left * &certain;
        let slack = N.map(f64::abs) * DVector::from_vec(deviation) * TOLERATED_DEVIATIONS;
        let (k, q) = (V_0.ncols(), entry.entering.len());
        let mut rows = DMatrix::zeros(r + T_B.nrows(), k + q);
        rows.view_mut((0, 0), (r, k)).copy_from(&G);
        rows.view_mut((0, k), (r, q)).copy_from(&T);
        rows.view_mut((r, k), T_B.shape()).copy_from(&T_B);
        let logs: f64 = singular_values.values[..r].iter().map(|x| x.ln()).sum();
        let mut random = U.clone().resize_horizontally(r + basis.ncols(), 0.0);
        random.columns_mut(r, basis.ncols()).copy_from(&(singular_values.left.columns(r, m - r) * basis));
        let from_white = D_1 * &V;
        Ok(Conditioned {
            log_volume: logs + log_spread(&U, &size),
            log_spread: logs + log_values + log_spread(&random, &size),
            rest: D_1 - &from_white * V.transpose(),
            from_taken: phi * &entry.root * V_B,
            from_free: phi * &entry.root * V_0,
            phi_E: phi.select_columns(entry.entering),
            free: k,
            W,
            B,
            C,
            N,
            slack,
            rows,
            from_white,
        })
    }

    /// Checks that N u is zero to within the tolerance. `terms`: size of the terms of each element of u. The error is
    /// (found, allowed).
    pub(super) fn check(&self, u: &DVector<f64>, terms: &DVector<f64>) -> Result<(), (f64, f64)> {
        let (discrepancy, sizes) = (&self.N * u, self.N.map(f64::abs) * terms);
        for ((discrepancy, size), slack) in discrepancy.iter().zip(&sizes).zip(&self.slack) {
            let allowed = TOLERATED_FRACTION * size + slack;
            if discrepancy.abs() > allowed {
                return Err((discrepancy.abs(), allowed));
            }
        }
        Ok(())
    }

    /// Bytes of memory that the matrices occupy.
    pub(super) fn bytes(&self) -> usize {
        let Conditioned { W, B, C, N, rows, phi_E, from_taken, from_free, from_white, rest, .. } = self;
        let matrices = [W, B, C, N, rows, phi_E, from_taken, from_free, from_white, rest];
        8 * matrices.iter().map(|matrix| matrix.len()).sum::<usize>() + 400
    }
}

/// Information of certain combinations of ŝ about η and σ: B u = V_B'η + T_B σ.
struct CertainInformation {
    V_B: DMatrix<f64>,
    /// Orthonormal basis of the complement of V_B in the space of η.
    V_0: DMatrix<f64>,
    T_B: DMatrix<f64>,
    B: DMatrix<f64>,
    /// Combinations of the relations that are certain given σ alone, one per row.
    left: DMatrix<f64>,
    /// Σ log of the standard deviations, given σ, of the combinations in `basis`.
    log_values: f64,
    /// Orthonormal basis of the combinations that are not certain given σ, one per column.
    basis: DMatrix<f64>,
}

/// Combinations of ŝ that are not random given x_0, to within rounding.
///
/// N is a null space of D_h up to an error ε: N u is within ε deviations of NS(x_0 - a), and N has a component ε/λ in
/// the range of D_h for each of its singular values λ, which leaves ε × WS in a sensitivity that should be zero. Both
/// lead to one rule: taken as a measurement with deviation ε, a relation must inform more of a state than everything
/// else does. A sensitivity that informs less is rounding error, however it compares with the terms of its sum, since N
/// itself has entries that are rounding error.
struct Relations<'a> {
    /// N, one relation per row.
    rows: &'a DMatrix<f64>,
    /// ε of each row.
    rounding_deviation: DVector<f64>,
    /// WS: the whitened sensitivities of everything else in ŝ.
    WS: &'a DMatrix<f64>,
}

impl Relations<'_> {
    fn certain_information(
        &self,
        S: &DMatrix<f64>,
        entry: &EstimateStart<'_>,
    ) -> Result<CertainInformation, ExactCombination> {
        let rounding = |norms: &[f64]| {
            DMatrix::from_fn(self.rounding_deviation.len(), norms.len(), |i, j| self.rounding_deviation[i] * norms[j])
        };
        let norms = |a: &DMatrix<f64>| a.column_iter().map(|column| column.norm()).collect::<Vec<f64>>();
        let (NS, E) = (clean(self.rows, S, &rounding(&norms(self.WS))), entry.entering);
        // the law of η, which is white, informs of η as well
        let norms: Vec<f64> = norms(&(self.WS * &entry.root)).iter().map(|norms| norms.hypot(1.0)).collect();
        let NP = clean(&NS, &entry.root, &rounding(&norms));
        let (k, l) = NP.shape();
        let known = SingularValues::of(&NP);
        let b = known.rank(CERTAIN_FRACTION);
        let V_B = DMatrix::from_fn(l, b, |i, j| known.scaled_right[(i, j)] / known.values[j]);
        let basis = known.left.columns(0, b).into_owned();
        let pick = DMatrix::from_fn(b, k, |j, i| basis[(i, j)] / known.values[j]);
        let left = known.left.columns(b, k - b).transpose();
        let NE = NS.select_columns(E);
        if clean(&left, &NE, &DMatrix::zeros(k - b, E.len())).iter().any(|x| *x != 0.0) {
            return Err(ExactCombination);
        }
        // the complement of V_B: the directions that V_B V_B' maps to zero
        let rest = SingularValues::of(&(DMatrix::identity(l, l) - &V_B * V_B.transpose()));
        let V_0 = rest.left.columns(0, l - b).into_owned();
        let log_values = known.values[..b].iter().map(|x| x.ln()).sum();
        Ok(CertainInformation { T_B: &pick * NE, B: pick * self.rows, V_B, V_0, left, log_values, basis })
    }
}

/// ε of each relation, in deviations: from the singular value of the relation, which is zero up to rounding, or from
/// the rounding error of the largest singular value; zero for relations of elements without noise.
fn rounding_deviation(singular_values: &SingularValues, r: usize, deviation: &[f64]) -> DVector<f64> {
    let m = deviation.len();
    let least = singular_values.values.first().map_or(0.0, |largest| m as f64 * f64::EPSILON * largest);
    let random = |i: usize| (0..m).any(|row| deviation[row] > 0.0 && singular_values.left[(row, i)] != 0.0);
    DVector::from_fn(
        m - r,
        |i, _| if random(r + i) { ROUNDING_BOUND * singular_values.values[r + i].max(least) } else { 0.0 },
    )
}

/// AB with rounding errors set to zero: entries up to CANCELLED_FRACTION × the size of the entry's terms + `rounding`.
fn clean(a: &DMatrix<f64>, b: &DMatrix<f64>, rounding: &DMatrix<f64>) -> DMatrix<f64> {
    let (product, size) = (a * b, a.map(f64::abs) * b.map(f64::abs));
    product.zip_zip_map(
        &size,
        rounding,
        |x, size, rounding| if x.abs() <= CANCELLED_FRACTION * size + rounding { 0.0 } else { x },
    )
}

/// ½ log |Q'S²Q| for Q with orthonormal columns and S = diag(size).
fn log_spread(Q: &DMatrix<f64>, size: &[f64]) -> f64 {
    if Q.nrows() == Q.ncols() {
        return size.iter().map(|s| s.ln()).sum();
    }
    // large rows first and columns pivoted, so that rows of very different sizes lose no digits
    let mut order: Vec<usize> = (0..Q.nrows()).collect();
    order.sort_by(|&i, &j| size[j].total_cmp(&size[i]));
    let sorted = DMatrix::from_fn(Q.nrows(), Q.ncols(), |i, j| size[order[i]] * Q[(order[i], j)]);
    sorted.col_piv_qr().r().diagonal().iter().map(|x| x.abs().ln()).sum()
}
