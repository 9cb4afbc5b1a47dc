//! Posterior moments of ξ in the form that the backward pass reads.

use nalgebra::{DMatrix, DVector};

use crate::reduce::ReductionRef;
use crate::score::InitialLaw;
use kalfit_algebra::{Conditional, posterior_root};
use kalfit_model::unpack;

/// E[ξ | z] and a root C of Var[ξ | z] = CC'.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Moments {
    /// x̂ (p).
    pub(crate) mean: Vec<f64>,
    /// C, p × columns, by rows.
    pub(crate) root: Vec<f64>,
    pub(crate) columns: usize,
}

impl Moments {
    /// Moments with x̂ = `mean` and C = `root`.
    pub fn of(mean: &DVector<f64>, root: &DMatrix<f64>) -> Moments {
        Moments { mean: mean.as_slice().to_vec(), root: root.transpose().as_slice().to_vec(), columns: root.ncols() }
    }

    /// E‖d - Rξ‖² of a reduction: ‖d - Rx̂‖² + ‖RC‖².
    fn expected_square(&self, reduction: ReductionRef<'_>) -> f64 {
        let line = |k: usize, x: &dyn Fn(usize) -> f64| -> f64 {
            (k..self.mean.len()).map(|i| reduction.factor[k + i * (i + 1) / 2] * x(i)).sum()
        };
        let square_of_row = |k: usize| {
            let left = reduction.data[k] - line(k, &|i| self.mean[i]);
            let spread = (0..self.columns).map(|c| line(k, &|i| self.root[i * self.columns + c]).powi(2));
            left * left + spread.sum::<f64>()
        };
        (0..self.mean.len()).map(square_of_row).sum()
    }
}

/// The law of ξ given the exact measurements of a test; `None` where the test has no exact measurements, or where the
/// exact measurements are ignored.
pub struct ExactConditional(Option<Conditional>);

impl ExactConditional {
    /// The law given the exact measurements Cξ of a reduction; Cξ is ignored where the covariance CΣC' is singular.
    pub fn of(reduction: ReductionRef<'_>, law: &InitialLaw) -> ExactConditional {
        ExactConditional(reduction.exact.and_then(|exact| Conditional::new(exact.matrix(law.root.nrows()), &law.root)))
    }

    /// Mean of ξ given the exact measurements, p values; μ of the test without exact measurements.
    pub fn mean(&self, reduction: ReductionRef<'_>, law: &InitialLaw) -> DVector<f64> {
        let mean = law.mean_of(reduction.covariates);
        match (&self.0, reduction.exact) {
            (Some(known), Some(exact)) => known.mean(&mean, &exact.values),
            _ => mean,
        }
    }

    /// Root F of the covariance FF' of ξ given the exact measurements; FF' = Σ without exact measurements.
    pub fn root<'a>(&'a self, law: &'a InitialLaw) -> &'a DMatrix<f64> {
        self.0.as_ref().map_or(&law.root, |known| &known.root)
    }

    /// x - KCx for directions x of the mean: the part that the exact measurements Cξ do not determine.
    pub fn left(&self, directions: DMatrix<f64>) -> DMatrix<f64> {
        self.0.as_ref().map(|known| known.left(&directions)).unwrap_or(directions)
    }

    /// Effect of directions of the mean on the exact measurements, whitened; `None` without exact measurements.
    pub fn whitened(&self, reduction: ReductionRef<'_>, directions: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let exact = reduction.exact?.matrix(directions.nrows());
        Some(self.0.as_ref()?.whitened(&(exact * directions)))
    }

    /// Log-density of the exact measurements; zero without exact measurements.
    pub fn log_density(&self, reduction: ReductionRef<'_>, law: &InitialLaw) -> f64 {
        let told = self.0.as_ref().zip(reduction.exact);
        told.map_or(0.0, |(known, exact)| known.log_density(&law.mean_of(reduction.covariates), &exact.values))
    }
}

/// Largest magnitude of entries of RF for which S = I + RΣR' is formed: with larger entries, rounding loses the
/// identity.
const MAX_RF_ENTRY: f64 = 1e4;

/// E‖d - Rξ‖² of a reduction given the data of the test: ‖S⁻¹e‖² + tr(I - S⁻¹) with e = d - Rμ and S = I + RΣR', as d -
/// Rx̂ = S⁻¹e and RVR' = I - S⁻¹. The moments of ξ are used in place of S where S is large, under the restricted
/// likelihood, with a law per test, and with exact measurements.
pub fn expected_square(reduction: ReductionRef<'_>, law: &InitialLaw) -> f64 {
    let special = law.is_restricted() || law.has_posteriors() || reduction.exact.is_some();
    let own = if special { None } else { plain_square(reduction, law) };
    own.unwrap_or_else(|| moments(reduction, law).expected_square(reduction))
}

/// E‖d - Rξ‖² from S; `None` where an entry of RF is beyond [`MAX_RF_ENTRY`].
fn plain_square(reduction: ReductionRef<'_>, law: &InitialLaw) -> Option<f64> {
    let (p, columns) = law.root.shape();
    let line = |k: usize, x: &dyn Fn(usize) -> f64| -> f64 {
        (k..p).map(|i| reduction.factor[k + i * (i + 1) / 2] * x(i)).sum()
    };
    let mean = law.mean_of(reduction.covariates);
    let spread: Vec<f64> = (0..p * columns).map(|at| line(at / columns, &|i| law.root[(i, at % columns)])).collect();
    if !spread.iter().all(|x| x.abs() <= MAX_RF_ENTRY) {
        return None;
    }
    // row by row: L with LL' = S, then L⁻¹ and L⁻¹e
    let row = |k: usize| &spread[k * columns..][..columns];
    let (mut lower, mut inverse, mut whitened_residual) = (vec![0.0; p * p], vec![0.0; p * p], vec![0.0; p]);
    for k in 0..p {
        for i in 0..=k {
            let own = f64::from(u8::from(i == k)) + row(k).iter().zip(row(i)).map(|(a, b)| a * b).sum::<f64>();
            let left = own - (0..i).map(|m| lower[k * p + m] * lower[i * p + m]).sum::<f64>();
            lower[k * p + i] = if i == k { left.max(1.0).sqrt() } else { left / lower[i * p + i] };
        }
        let pivot = lower[k * p + k];
        for c in 0..=k {
            let own = f64::from(u8::from(c == k)) - (c..k).map(|m| lower[k * p + m] * inverse[m * p + c]).sum::<f64>();
            inverse[k * p + c] = own / pivot;
        }
        let e = reduction.data[k] - line(k, &|i| mean[i]);
        whitened_residual[k] = (e - (0..k).map(|m| lower[k * p + m] * whitened_residual[m]).sum::<f64>()) / pivot;
    }
    let left = |c: usize| (c..p).map(|k| inverse[k * p + c] * whitened_residual[k]).sum::<f64>();
    let told = |c: usize| 1.0 - (c..p).map(|k| inverse[k * p + c].powi(2)).sum::<f64>();
    Some((0..p).map(|c| left(c).powi(2) + told(c)).sum())
}

/// x̂ = μ + V(y - Jμ) and V = F(I + F'JF)⁻¹F' (10), (11).
///
/// Under the restricted likelihood V also contains (I+ΣJ)⁻¹XX'(I+JΣ)⁻¹, with XX' the covariance of μ_j at a known Σ:
/// with this V, ℓ_R changes by -½ tr(V ∂J), as ℓ does with V of (11).
pub(crate) fn moments(reduction: ReductionRef<'_>, law: &InitialLaw) -> Moments {
    if let Some((mean, root)) = law.given(reduction.test) {
        return Moments::of(mean, root);
    }
    let p = law.root.nrows();
    let factor = unpack(reduction.factor, p);
    let known = ExactConditional::of(reduction, law);
    let mean = known.mean(reduction, law);
    let root = posterior_root(&factor, known.root(law));
    let residual = DVector::from_column_slice(reduction.data) - &factor * &mean;
    let mean = mean + &root * (root.transpose() * (factor.transpose() * &residual));
    let mut columns: Vec<DVector<f64>> = root.column_iter().map(|c| c.into_owned()).collect();
    if let Some(extra) = law.mean_root_of(reduction.covariates) {
        let extra = known.left(extra);
        // (I+ΣJ)⁻¹X = X - VJX
        let moved = &extra - &root * (root.transpose() * (factor.transpose() * (&factor * &extra)));
        columns.extend(moved.column_iter().map(|c| c.into_owned()));
    }
    columns.retain(|c| c.amax() > 0.0);
    let entry = |i: usize, c: usize| columns[c][i];
    let root = (0..p).flat_map(|i| (0..columns.len()).map(move |c| (i, c))).map(|(i, c)| entry(i, c)).collect();
    Moments { mean: mean.as_slice().to_vec(), root, columns: columns.len() }
}

impl Moments {
    /// These moments with C padded by zeros to `columns` columns.
    pub(crate) fn widened(mut self, columns: usize) -> Moments {
        if columns > self.columns {
            let rows = (0..self.mean.len()).map(|i| &self.root[i * self.columns..(i + 1) * self.columns]);
            let rest = vec![0.0; columns - self.columns];
            self.root = rows.flat_map(|row| row.iter().chain(&rest).copied()).collect();
            self.columns = columns;
        }
        self
    }

    /// x̂ = μ + CC'R'(d - Rμ) of another test that shares R and the law with this test; the law must not be a
    /// restricted one.
    pub(crate) fn mean_of(&self, reduction: ReductionRef<'_>, law: &InitialLaw) -> Vec<f64> {
        let (p, factor) = (self.mean.len(), |i: usize, k: usize| reduction.factor[i + k * (k + 1) / 2]);
        let mut mean = ExactConditional::of(reduction, law).mean(reduction, law).as_slice().to_vec();
        let residual = |i: usize| reduction.data[i] - (i..p).map(|k| factor(i, k) * mean[k]).sum::<f64>();
        let residuals: Vec<f64> = (0..p).map(residual).collect();
        let weighted: Vec<f64> = (0..p).map(|k| (0..=k).map(|i| factor(i, k) * residuals[i]).sum()).collect();
        for c in 0..self.columns {
            let column = || self.root.iter().skip(c).step_by(self.columns);
            let along: f64 = column().zip(&weighted).map(|(root, weighted)| root * weighted).sum();
            mean.iter_mut().zip(column()).for_each(|(mean, root)| *mean += root * along);
        }
        mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::Path;
    use kalfit_model::Reduction;

    fn reduction(data: [f64; 3], factor: [f64; 6]) -> Reduction {
        Reduction {
            test: "a".to_owned(),
            constant: 0.0,
            residual: None,
            data: data.to_vec(),
            factor: factor.to_vec(),
            covariates: Vec::new(),
            steps: 1,
            observations: 3,
            path: Path::Information,
            design: 0,
            chain: None,
            exact: None,
        }
    }

    #[test]
    fn means_from_the_root_of_another_test_are_those_of_their_own() {
        let law = InitialLaw::known(
            DVector::from_vec(vec![0.3, -1.0, 2.0]),
            DMatrix::from_row_slice(3, 2, &[1.0, 0.2, -0.5, 2.0, 0.3, 0.1]),
        );
        let factor = [2.0, 0.5, 1.5, -1.0, 0.7, 0.0];
        let other = moments(reduction([5.0, 1.0, 0.0], factor).view(), &law);
        let of = reduction([1.0, -2.0, 0.0], factor);
        for (found, expected) in other.mean_of(of.view(), &law).iter().zip(moments(of.view(), &law).mean) {
            assert!((found - expected).abs() < 1e-13, "{found} {expected}");
        }
    }

    #[test]
    fn squares_from_s_are_those_from_the_moments() {
        let root = DMatrix::from_row_slice(3, 2, &[1.0, 0.2, -0.5, 2.0, 0.3, 0.1]);
        for (size, plain) in [(1e-3, true), (1.0, true), (1e2, true), (1e6, false)] {
            let law = InitialLaw::known(DVector::from_vec(vec![0.3, -1.0, 2.0]), &root * size);
            // the last row of R is zero
            let of = reduction([1.0, -2.0, 0.0], [2.0, 0.5, 1.5, -1.0, 0.7, 0.0]);
            let expected = moments(of.view(), &law).expected_square(of.view());
            assert_eq!(plain_square(of.view(), &law).is_some(), plain, "size {size}");
            let found = expected_square(of.view(), &law);
            assert!((found - expected).abs() <= 1e-9 * expected, "size {size}: {found} against {expected}");
        }
    }
}
