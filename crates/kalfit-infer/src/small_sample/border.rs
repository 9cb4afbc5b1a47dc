//! Reductions bordered by the mean, in the coordinates η of the estimator.

use nalgebra::{DMatrix, DVector};

use crate::small_sample::effects::CrossedEffects;
use kalfit_estimate::Problem;
use kalfit_filter::reduce::Reductions;

/// Coordinates of the border: T = [I E X] of a test, with E of the effects of crossed factors, where there are any, and
/// μ = m0 + Xβ with β the free coordinates of the mean in η.
pub(super) struct Border<'a> {
    /// Scale and centre of the p states of a test.
    scale: &'a [f64],
    centre: &'a [f64],
    covariate_centre: &'a [f64],
    covariate_scale: &'a [f64],
    /// For each regression coefficient, the state whose mean it acts on.
    regressors: &'a [usize],
    /// The columns of X that are the same for all tests, p × (q - regressors).
    basis: DMatrix<f64>,
    /// m0 in η.
    offset: DVector<f64>,
    /// The effects of crossed factors, whose columns stand between the states and the mean.
    effects: Option<CrossedEffects>,
    /// Whether the last row and column hold the data.
    with_data: bool,
}

impl<'a> Border<'a> {
    /// The border of tests with `p` states each.
    pub(super) fn of(problem: &'a Problem, p: usize, effects: Option<CrossedEffects>, with_data: bool) -> Border<'a> {
        let (frame, mean) = (&problem.classes.frame, &problem.mean);
        Border {
            scale: &frame.scale[..p],
            centre: &frame.centre[..p],
            covariate_centre: &frame.covariate_centre,
            covariate_scale: &frame.covariate_scale,
            regressors: &mean.regressors,
            basis: mean.basis.rows(0, p).into_owned(),
            offset: mean.offset.rows(0, p).into_owned(),
            effects,
            with_data,
        }
    }

    /// p, the number of states of a test.
    pub(super) fn states(&self) -> usize {
        self.scale.len()
    }

    /// M, the number of effects of crossed factors.
    pub(super) fn effects(&self) -> usize {
        self.effects.as_ref().map_or(0, CrossedEffects::len)
    }

    /// q, the number of free coordinates of the mean.
    pub(super) fn means(&self) -> usize {
        self.basis.ncols() + self.regressors.len()
    }

    /// K of a test; `None` where the data are needed and the sum of squares of the test is unknown, or the groups of the
    /// test are.
    pub(super) fn of_test(&self, reductions: &Reductions, j: usize) -> Option<DMatrix<f64>> {
        let (p, fixed) = (self.states(), self.basis.ncols());
        let first = p + self.effects();
        let (packed, covariates) = (reductions.factor(j), reductions.covariates(j));
        let factor =
            DMatrix::from_fn(p, p, |i, k| if i <= k { packed[i + k * (k + 1) / 2] * self.scale[k] } else { 0.0 });
        let mut all = DMatrix::zeros(p, first + self.means() + usize::from(self.with_data));
        all.columns_mut(first, fixed).copy_from(&(&factor * &self.basis));
        for (c, (&i, scale)) in self.regressors.iter().zip(self.covariate_scale).enumerate() {
            let covariate = (covariates[c] - self.covariate_centre[c]) / scale;
            all.set_column(first + fixed + c, &(factor.column(i) * covariate));
        }
        let mut squares = 0.0;
        if self.with_data {
            let centre = DVector::from_fn(p, |i, _| self.centre[i] / self.scale[i]) + &self.offset;
            let data = DVector::from_column_slice(&reductions.data(j)[..p]) - &factor * centre;
            all.set_column(first + self.means(), &data);
            squares = reductions.residual(j).0?;
        }
        all.columns_mut(0, p).copy_from(&factor);
        if let Some(effects) = &self.effects {
            for (state, effect) in effects.met_by(reductions.id(j))? {
                all.column_mut(p + effect).axpy(1.0, &factor.column(state), 1.0);
            }
        }
        let mut k = all.transpose() * &all;
        if self.with_data {
            let last = k.nrows() - 1;
            k[(last, last)] += squares;
        }
        Some(k)
    }
}

/// λ = Σ log|S| of a test; `None` where the sum of squares of the test is unknown.
pub(super) fn log_determinant(reductions: &Reductions, j: usize) -> Option<f64> {
    let (squares, count) = reductions.residual(j);
    Some(-2.0 * reductions.constant(j) - count as f64 * std::f64::consts::TAU.ln() - squares?)
}
