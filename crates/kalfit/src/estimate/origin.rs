//! What the classes say where Σ is zero.

use nalgebra::{DMatrix, DVector};

use crate::estimate::chained::Detail;
use crate::estimate::class::Class;
use crate::estimate::classes::Classes;
use crate::estimate::order::Order;
use crate::estimate::pass::pass;
use crate::estimate::point::Point;
use crate::estimate::together::each_packed;

impl Classes {
    /// Σ_j E_j'J_jE_j: information on the p elements of μ and the scaled regression coefficients at Σ = 0.
    pub(crate) fn mean_information(&self, regressors: &[usize]) -> DMatrix<f64> {
        let p = self.dimension();
        if self.classes.iter().any(|class| class.chain.is_some()) {
            return pass(self, regressors, &self.origin(regressors.len()), Order::Mean, None).mean_information;
        }
        let mut information = DMatrix::zeros(p + regressors.len(), p + regressors.len());
        for class in self.classes.iter() {
            let column = |m: usize| if m < p { (m, 1.0) } else { (regressors[m - p], class.covariates[m - p]) };
            let rows = DMatrix::from_fn(p, p + regressors.len(), |i, m| {
                let (k, x) = column(m);
                x * class.factor[i * p + k]
            });
            information += rows.transpose() * &rows * class.count;
        }
        information
    }

    /// The centre, without spread.
    fn origin(&self, regressors: usize) -> Point {
        let p = self.dimension();
        Point { mean: vec![0.0; p], coefficients: vec![0.0; regressors], root: DMatrix::zeros(p, p) }
    }

    /// For each class its number of tests and, for each element i, Σ (y - Jμ)_i² - J_ii over them, which has the mean
    /// Σ (JΣJ)_ii, and J_ii of one of them.
    pub(crate) fn excesses(&self, mean: &DVector<f64>) -> Vec<(f64, Vec<(f64, f64)>)> {
        let p = mean.len();
        let gathered = self.classes.gathered();
        if self.chains.is_empty() && gathered.iter().all(|class| class.chain.is_none()) {
            let unit = self.classes.unit();
            return gathered.iter().map(|class| (class.count, class.excess(mean.as_slice(), unit))).collect();
        }
        let classes: Vec<&Class> = self.classes.iter().collect();
        let point = Point { mean: mean.as_slice().to_vec(), ..self.origin(0) };
        let mut told: Vec<(f64, Vec<(f64, f64)>)> = vec![(0.0, Vec::new()); classes.len()];
        let packed = (self.blocks.isa(), &self.chains[..]);
        each_packed(&classes, packed, &[], &point, Detail::Phases, &mut |k, terms| {
            let one = |at: usize| (terms.outer[at] - classes[k].count * terms.W[at], terms.W[at]);
            told[k] = (classes[k].count, (0..p).map(|i| one(i * p + i)).collect());
        });
        told
    }
}
