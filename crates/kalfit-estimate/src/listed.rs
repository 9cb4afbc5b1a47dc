//! A list of classes that are not in blocks.

use crate::chained::ChainStore;
use crate::class::ClassRef;
use kalfit_algebra::row_lists::RowLists;

/// A list of classes, stored as one list for each quantity of a class.
#[derive(Debug, Clone, Default)]
pub struct Listed {
    counts: Vec<f64>,
    constants: Vec<f64>,
    factors: RowLists,
    means: RowLists,
    scatters: RowLists,
    covariates: RowLists,
    square_root: Vec<bool>,
    chains: Vec<Option<ChainStore>>,
}

impl Listed {
    pub fn len(&self) -> usize {
        self.counts.len()
    }

    pub fn get(&self, number: usize) -> ClassRef<'_> {
        ClassRef {
            count: self.counts[number],
            constant: self.constants[number],
            factor: self.factors.row(number),
            mean: self.means.row(number),
            scatter: self.scatters.row(number),
            covariates: self.covariates.row(number),
            square_root: self.square_root[number],
            chain: self.chains[number].as_ref(),
        }
    }

    pub(crate) fn push(&mut self, class: ClassRef<'_>) {
        let number = self.len();
        self.counts.push(class.count);
        self.constants.push(class.constant);
        self.factors.push(number, class.factor.iter().copied());
        self.means.push(number, class.mean.iter().copied());
        self.scatters.push(number, class.scatter.iter().copied());
        self.covariates.push(number, class.covariates.iter().copied());
        self.square_root.push(class.square_root);
        self.chains.push(class.chain.cloned());
    }

    /// Appends another list.
    pub(crate) fn append(&mut self, mut others: Listed) {
        let (own, more) = (self.len(), others.len());
        self.factors.append(own, &others.factors, more);
        self.means.append(own, &others.means, more);
        self.scatters.append(own, &others.scatters, more);
        self.covariates.append(own, &others.covariates, more);
        self.counts.append(&mut others.counts);
        self.constants.append(&mut others.constants);
        self.square_root.append(&mut others.square_root);
        self.chains.append(&mut others.chains);
    }

    /// The list at another noise level: d and scatter are multiplied by `unit`, and `change` is added to the constant
    /// of each class.
    pub(crate) fn at_noise(&self, unit: f64, change: impl Fn(usize) -> f64) -> Listed {
        let mut listed = self.clone();
        listed.constants.iter_mut().enumerate().for_each(|(k, constant)| *constant += change(k));
        listed.means.scale(unit);
        listed.scatters.scale(unit);
        listed
    }
}
