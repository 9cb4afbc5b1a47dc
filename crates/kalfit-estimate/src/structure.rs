//! The assumed structure of μ and Σ, phase by phase. Quantities of all phases are concatenated in the order of the
//! phases; states of different phases are independent (theory §7).

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use nalgebra::DMatrix;

use kalfit_model::Grouping;
use kalfit_model::{Alpha, CovarianceStructure, GroupLevel, MeanElement, MeanStructure, PhasedModel, Regression};

/// The assumed structure of μ and Σ.
#[derive(Debug, Clone)]
pub struct Structure<'a> {
    /// The structure of each phase. For a model with levels, the only phase is followed by one entry for each level,
    /// from the innermost on: the structure of the term, of mean zero, that the groups of the level add to ξ of a test.
    /// The terms of all levels and ξ of the phase are independent.
    pub phases: Vec<PhaseStructure<'a>>,
    /// Parameters that matrices of the covariance structures refer to.
    pub alpha: &'a Alpha,
    /// The groups of the tests, where the model has levels.
    pub grouping: Option<Arc<Grouping>>,
}

/// The assumed structure of μ and Σ of one phase, or of what the groups of a level add.
#[derive(Debug, Clone)]
pub struct PhaseStructure<'a> {
    /// Structure of μ.
    pub mean: Cow<'a, MeanStructure>,
    /// Structure of Σ.
    pub covariance: &'a CovarianceStructure,
}

impl<'a> Structure<'a> {
    /// The structure of a model with its parameters at α; for a model with levels, `grouping` holds the groups of the
    /// tests.
    pub fn of(model: &'a PhasedModel, alpha: &'a Alpha, grouping: Option<&Arc<Grouping>>) -> Structure<'a> {
        let of = |phase: &'a kalfit_model::Phase| PhaseStructure {
            mean: Cow::Borrowed(&phase.model.mean),
            covariance: &phase.model.covariance,
        };
        let p = model.dimension();
        let of_level = |level: &'a GroupLevel| PhaseStructure {
            mean: Cow::Owned(MeanStructure::zero(p)),
            covariance: &level.covariance,
        };
        let phases = model.phases.iter().map(of).chain(model.levels.iter().rev().map(of_level));
        Structure { phases: phases.collect(), alpha, grouping: grouping.cloned() }
    }

    /// The structure of one phase.
    pub fn single(mean: &'a MeanStructure, covariance: &'a CovarianceStructure, alpha: &'a Alpha) -> Structure<'a> {
        Structure { phases: vec![PhaseStructure { mean: Cow::Borrowed(mean), covariance }], alpha, grouping: None }
    }

    /// p, the number of states of the reduction of a test: the states of all phases, without the states that levels
    /// add.
    pub fn reduced_dimension(&self) -> usize {
        match self.grouping {
            Some(_) => self.phases[0].mean.elements.len(),
            None => self.dimension(),
        }
    }

    /// Σ_i p_i, the number of states of all phases and levels.
    pub fn dimension(&self) -> usize {
        self.phases.iter().map(|phase| phase.mean.elements.len()).sum()
    }

    /// For each phase, the range of indices of the elements of the phase among the elements of all phases.
    pub fn ranges(&self) -> Vec<Range<usize>> {
        let mut end = 0;
        let range = |phase: &PhaseStructure<'_>| {
            let start = end;
            end += phase.mean.elements.len();
            start..end
        };
        self.phases.iter().map(range).collect()
    }

    /// The regressions of all phases, with elements numbered over all phases.
    pub fn regressions(&self) -> Vec<Regression> {
        let of = |(phase, range): (&PhaseStructure<'_>, Range<usize>)| -> Vec<Regression> {
            let moved = |r: &Regression| Regression { element: range.start + r.element, ..r.clone() };
            phase.mean.regression.iter().map(moved).collect()
        };
        self.phases.iter().zip(self.ranges()).flat_map(of).collect()
    }

    /// The structure of each element of μ, with ties numbered over the elements of all phases.
    pub fn elements(&self) -> Vec<MeanElement> {
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

/// A structure that owns its parts.
#[derive(Debug, Clone)]
pub(crate) struct OwnedStructure {
    phases: Vec<(MeanStructure, CovarianceStructure)>,
    pub(crate) alpha: Alpha,
    grouping: Option<Arc<Grouping>>,
}

impl From<&Structure<'_>> for OwnedStructure {
    fn from(structure: &Structure<'_>) -> OwnedStructure {
        let own = |phase: &PhaseStructure<'_>| (phase.mean.clone().into_owned(), phase.covariance.clone());
        let phases = structure.phases.iter().map(own).collect();
        OwnedStructure { phases, alpha: structure.alpha.clone(), grouping: structure.grouping.clone() }
    }
}

impl OwnedStructure {
    /// A view of the structure.
    pub(crate) fn structure(&self) -> Structure<'_> {
        self.at(&self.alpha)
    }

    /// A view of the structure with other parameters.
    pub(crate) fn at<'a>(&'a self, alpha: &'a Alpha) -> Structure<'a> {
        let of = |(mean, covariance): &'a (MeanStructure, CovarianceStructure)| PhaseStructure {
            mean: Cow::Borrowed(mean),
            covariance,
        };
        Structure { phases: self.phases.iter().map(of).collect(), alpha, grouping: self.grouping.clone() }
    }
}
