//! Sums over the classes at Σ = 0.

use nalgebra::{DMatrix, DVector};

use crate::chained::ChainDetail;
use crate::class::{Class, ClassRef};
use crate::classes::Classes;
use crate::each_class::map_classes;
use crate::order::Order;
use crate::pass::pass;
use crate::point::Point;
use crate::remote;
use crate::terms::ClassTerms;

/// For one class: the number of tests and, for each element i, (Σ over the tests of (y - Jμ)_i² - J_ii, J_ii of one
/// test). The sum has the expected value Σ (JΣJ)_ii.
type Excess = (f64, Vec<(f64, f64)>);

impl Classes {
    /// Σ_j E_j'J_jE_j: information on the p elements of μ and the scaled regression coefficients at Σ = 0.
    pub fn mean_information(&self, regressors: &[usize]) -> DMatrix<f64> {
        let p = self.dimension();
        if self.is_chained() || self.remote.is_some() {
            return pass(self, regressors, &self.origin(regressors.len()), Order::Mean, None).mean_information;
        }
        let mut information = DMatrix::zeros(p + regressors.len(), p + regressors.len());
        let mut buffer = Class::default();
        for number in 0..self.len() {
            let class = self.get(number, &mut buffer);
            let column = |m: usize| if m < p { (m, 1.0) } else { (regressors[m - p], class.covariates[m - p]) };
            let rows = DMatrix::from_fn(class.mean.len(), p + regressors.len(), |i, m| {
                let (k, x) = column(m);
                x * class.factor[i * p + k]
            });
            information += rows.transpose() * &rows * class.count;
        }
        information
    }

    /// The point at the centre, with Σ = 0.
    fn origin(&self, regressors: usize) -> Point {
        let p = self.dimension();
        Point { mean: vec![0.0; p], coefficients: vec![0.0; regressors], root: DMatrix::zeros(p, p) }
    }

    /// For each element i (Σ (y - Jμ)_i² - J_ii, Σ J_ii²), sums over tests, or over groups for elements of a level. The
    /// first sum has the expected value Σ (JΣJ)_ii.
    pub(crate) fn excess(&self, mean: &DVector<f64>) -> (DVector<f64>, DVector<f64>) {
        let p = mean.len();
        if let Some(remote) = &self.remote {
            return remote::excess(remote, &self.frame, mean);
        }
        if let Some(units) = &self.units {
            return units.excess(mean);
        }
        let (mut excess, mut weight) = (DVector::zeros(p), DVector::zeros(p));
        let mut add = |count: f64, each: &[(f64, f64)]| {
            for (i, (class_excess, own)) in each.iter().enumerate() {
                excess[i] += class_excess;
                weight[i] += count * own * own;
            }
        };
        if self.is_chained() {
            self.chained_excesses(mean).iter().for_each(|(count, each)| add(*count, each));
        } else {
            let (mut buffer, mut each) = (Class::default(), Vec::new());
            for number in 0..self.len() {
                let class = self.get(number, &mut buffer);
                class.excess(mean.as_slice(), &mut each);
                add(class.count, &each);
            }
        }
        (excess, weight)
    }

    /// The excess of each class, in order, where some classes are stored phase by phase.
    fn chained_excesses(&self, mean: &DVector<f64>) -> Vec<Excess> {
        let p = mean.len();
        let point = Point { mean: mean.as_slice().to_vec(), ..self.origin(0) };
        let of = |class_excesses: &mut Vec<(usize, Excess)>, k: usize, class: ClassRef<'_>, terms: &ClassTerms<'_>| {
            let one = |at: usize| (terms.outer[at] - class.count * terms.W[at], terms.W[at]);
            class_excesses.push((k, (class.count, (0..p).map(|i| one(i * p + i)).collect())));
        };
        let parts = map_classes(self, &[], &point, ChainDetail::Phases, &Vec::new, &of);
        let mut class_excesses: Vec<(usize, Excess)> = parts.into_iter().flatten().collect();
        class_excesses.sort_unstable_by_key(|(k, _)| *k);
        class_excesses.into_iter().map(|(_, class_excesses)| class_excesses).collect()
    }

    /// Whether some classes are stored phase by phase.
    pub(super) fn is_chained(&self) -> bool {
        !self.chains.is_empty() || self.unbatched.iter().any(|&k| self.listed.get(k).chain.is_some())
    }
}
