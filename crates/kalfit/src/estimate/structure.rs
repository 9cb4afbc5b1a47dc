//! What is assumed of μ and Σ, phase by phase. Quantities of all phases stand in a row, first those of the first phase;
//! states of different phases are independent (theory §7).

use std::ops::Range;

use nalgebra::DMatrix;

use crate::model::{Alpha, CovarianceStructure, MeanElement, MeanStructure, PhasedModel, Regression};

/// What is assumed of μ and Σ.
#[derive(Debug, Clone)]
pub struct Structure<'a> {
    /// Of each phase.
    pub phases: Vec<PhaseStructure<'a>>,
    /// Parameters that matrices of the covariance structures refer to.
    pub alpha: &'a Alpha,
}

/// What is assumed of the μ and Σ of one phase.
#[derive(Debug, Clone, Copy)]
pub struct PhaseStructure<'a> {
    /// Of μ.
    pub mean: &'a MeanStructure,
    /// Of Σ.
    pub covariance: &'a CovarianceStructure,
}

impl<'a> Structure<'a> {
    /// The structure of a model, with its parameters at α.
    pub fn of(model: &'a PhasedModel, alpha: &'a Alpha) -> Structure<'a> {
        let of = |phase: &'a crate::model::Phase| PhaseStructure {
            mean: &phase.model.mean,
            covariance: &phase.model.covariance,
        };
        Structure { phases: model.phases.iter().map(of).collect(), alpha }
    }

    /// The structure of one phase.
    pub fn single(mean: &'a MeanStructure, covariance: &'a CovarianceStructure, alpha: &'a Alpha) -> Structure<'a> {
        Structure { phases: vec![PhaseStructure { mean, covariance }], alpha }
    }

    /// Σ_i p_i.
    pub fn dimension(&self) -> usize {
        self.phases.iter().map(|phase| phase.mean.elements.len()).sum()
    }

    /// Where the elements of each phase stand among those of all.
    pub fn ranges(&self) -> Vec<Range<usize>> {
        let mut end = 0;
        let range = |phase: &PhaseStructure<'_>| {
            let start = end;
            end += phase.mean.elements.len();
            start..end
        };
        self.phases.iter().map(range).collect()
    }

    /// The regressions of all phases, on elements of all phases.
    pub fn regressions(&self) -> Vec<Regression> {
        let of = |(phase, range): (&PhaseStructure<'_>, Range<usize>)| -> Vec<Regression> {
            let moved = |r: &Regression| Regression { element: range.start + r.element, ..r.clone() };
            phase.mean.regression.iter().map(moved).collect()
        };
        self.phases.iter().zip(self.ranges()).flat_map(of).collect()
    }

    /// What was said of the elements of μ, ties among the elements of all phases.
    pub(crate) fn elements(&self) -> Vec<MeanElement> {
        let of = |(phase, range): (&PhaseStructure<'_>, Range<usize>)| -> Vec<MeanElement> {
            let moved = |element: &MeanElement| match element {
                MeanElement::Tied { constant, terms } => MeanElement::Tied {
                    constant: *constant,
                    terms: terms.iter().map(|&(k, weight)| (range.start + k, weight)).collect(),
                },
                other => other.clone(),
            };
            phase.mean.elements.iter().map(moved).collect()
        };
        self.phases.iter().zip(self.ranges()).flat_map(of).collect()
    }

    /// Start values of the elements of μ, where given.
    pub(crate) fn mean_start(&self) -> Vec<Option<f64>> {
        self.phases.iter().flat_map(|phase| phase.mean.start.iter().copied()).collect()
    }

    /// (m0, B): μ = m0 + Bβ, without the regressions; elements of different phases share no β. Shapes P and P × q.
    pub(crate) fn basis(&self) -> (Vec<f64>, DMatrix<f64>) {
        let parts: Vec<(Vec<f64>, DMatrix<f64>)> = self.phases.iter().map(|phase| phase.mean.basis()).collect();
        let (p, q) = (self.dimension(), parts.iter().map(|(_, b)| b.ncols()).sum());
        let (mut offset, mut basis) = (Vec::with_capacity(p), DMatrix::zeros(p, q));
        let mut column = 0;
        for (m0, b) in parts {
            basis.view_mut((offset.len(), column), b.shape()).copy_from(&b);
            offset.extend(m0);
            column += b.ncols();
        }
        (offset, basis)
    }
}

/// A structure of its own.
#[derive(Debug, Clone)]
pub(crate) struct Assumed {
    phases: Vec<(MeanStructure, CovarianceStructure)>,
    pub(crate) alpha: Alpha,
}

impl From<&Structure<'_>> for Assumed {
    fn from(structure: &Structure<'_>) -> Assumed {
        let own = |phase: &PhaseStructure<'_>| (phase.mean.clone(), phase.covariance.clone());
        Assumed { phases: structure.phases.iter().map(own).collect(), alpha: structure.alpha.clone() }
    }
}

impl Assumed {
    /// The structure, to be looked at.
    pub(crate) fn structure(&self) -> Structure<'_> {
        self.at(&self.alpha)
    }

    /// The same with other parameters.
    pub(crate) fn at<'a>(&'a self, alpha: &'a Alpha) -> Structure<'a> {
        let of = |(mean, covariance): &'a (MeanStructure, CovarianceStructure)| PhaseStructure { mean, covariance };
        Structure { phases: self.phases.iter().map(of).collect(), alpha }
    }
}
