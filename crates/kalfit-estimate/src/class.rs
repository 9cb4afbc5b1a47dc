//! Tests that share R and covariates.

use crate::chained::ChainStore;

/// Tests that share R and covariates, in η: log p(z_j | η) = constant_j - ½ ‖d_j - R η‖². Where the tests measure Cη =
/// g_j exactly, C has q rows of length one, C follows R in `factor`, and g follows d.
#[derive(Debug, Clone, Copy)]
pub struct ClassRef<'a> {
    /// n, the number of tests.
    pub(crate) count: f64,
    /// Σ_j constant_j.
    pub constant: f64,
    /// R, p × p by rows, upper triangular; C, q × p by rows.
    pub factor: &'a [f64],
    /// Mean of d_j, followed by the mean of g_j.
    pub(crate) mean: &'a [f64],
    /// Vectors v, one after the other, with Σ vv' = Σ_j (d_j - mean)(d_j - mean)'; at most as many vectors as `mean`
    /// has elements, none for a single test.
    pub(crate) scatter: &'a [f64],
    /// Scaled covariates of the regressions.
    pub(crate) covariates: &'a [f64],
    /// Whether some test of the class needs square-root arithmetic.
    pub(crate) square_root: bool,
    /// The class phase by phase, if stored in that form; `factor`, `mean` and `scatter` are then empty.
    pub chain: Option<&'a ChainStore>,
}

/// An owned class, also used as a buffer for one class after another.
#[derive(Debug, Clone, Default)]
pub struct Class {
    pub(crate) count: f64,
    pub(crate) constant: f64,
    /// R, p × p by rows, upper triangular; C, q × p by rows.
    pub factor: Vec<f64>,
    pub(crate) mean: Vec<f64>,
    pub(crate) scatter: Vec<f64>,
    pub(crate) covariates: Vec<f64>,
    pub(crate) square_root: bool,
    pub(crate) chain: Option<ChainStore>,
}

impl Class {
    /// A view of the class.
    pub fn view(&self) -> ClassRef<'_> {
        ClassRef {
            count: self.count,
            constant: self.constant,
            factor: &self.factor,
            mean: &self.mean,
            scatter: &self.scatter,
            covariates: &self.covariates,
            square_root: self.square_root,
            chain: self.chain.as_ref(),
        }
    }

    /// Overwrites this class with another one.
    pub(super) fn set(&mut self, class: ClassRef<'_>) {
        let copy = |to: &mut Vec<f64>, from: &[f64]| {
            to.clear();
            to.extend_from_slice(from);
        };
        (self.count, self.constant, self.square_root) = (class.count, class.constant, class.square_root);
        copy(&mut self.factor, class.factor);
        copy(&mut self.mean, class.mean);
        copy(&mut self.scatter, class.scatter);
        copy(&mut self.covariates, class.covariates);
        self.chain = class.chain.cloned();
    }
}

impl ClassRef<'_> {
    /// Writes, for each element i, (Σ over the tests of (y - Jμ)_i² - J_ii, J_ii of one test) into `found`.
    pub(super) fn excess(&self, mean: &[f64], found: &mut Vec<(f64, f64)>) {
        let p = mean.len();
        let rows = || self.factor.chunks_exact(p.max(1));
        found.clear();
        found.resize(p, (0.0, 0.0));
        for (row, d) in rows().zip(self.mean) {
            let residual = d - row.iter().zip(mean).map(|(r, x)| r * x).sum::<f64>();
            for ((moment, information), r) in found.iter_mut().zip(row) {
                *moment += r * residual;
                *information += r * r;
            }
        }
        for (i, (moment, information)) in found.iter_mut().enumerate() {
            let transposed_product = |x: &[f64]| rows().zip(x).map(|(row, x)| row[i] * x).sum::<f64>(); // (R'x)_i
            let scatter_square: f64 =
                self.scatter.chunks_exact(self.mean.len().max(1)).map(|x| transposed_product(x).powi(2)).sum();
            *moment = self.count * (moment.powi(2) - *information) + scatter_square;
        }
    }
}
