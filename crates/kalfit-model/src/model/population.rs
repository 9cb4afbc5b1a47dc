//! A population of tests: values of μ, of the regression coefficients and of Σ.

use nalgebra::DMatrix;

use crate::ensemble::LevelSlots;
use crate::model::{
    Alpha, CovarianceKind, CovarianceStructure, Expression, MeanElement, Model, PhasedModel, Scope, StructureError,
};
use kalfit_algebra::symmetric;

/// ξ_j ~ N(μ_j, Σ) with μ_j = μ + Σ_r e_state(r) × covariate_jr × coefficient_r. In a model of phases, ξ_j holds the
/// estimated states of all phases one after the other; states of different phases are independent.
#[derive(Debug, Clone, PartialEq)]
pub struct Population {
    /// μ (p), in the order of [`Model::estimated`], phase by phase. In a model with levels of groups, the p elements of
    /// the tests come first, then p elements of mean zero for each level, the innermost first: ξ_j is the sum over
    /// tests and levels.
    pub mean: Vec<f64>,
    /// The regression coefficients, in the order of
    /// [`MeanStructure::regression`](crate::model::MeanStructure::regression), phase by phase.
    pub coefficients: Vec<f64>,
    /// Σ (p × p), positive semidefinite, possibly singular, zero between phases and between levels.
    pub covariance: DMatrix<f64>,
}

/// Reason why there is no population.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PopulationError {
    /// A number of elements differs from the number in the model.
    #[error("found {found} {what}, expected {expected} as in the model")]
    Count {
        /// What was counted.
        what: &'static str,
        /// Number in the population.
        found: usize,
        /// Number in the model.
        expected: usize,
    },
    /// A value is not a finite number.
    #[error("{what} is {found}, expected a finite number")]
    NotFinite {
        /// Name of the value.
        what: String,
        /// The value.
        found: f64,
    },
    /// Σ is not symmetric.
    #[error("the covariance is not symmetric: {upper} above the diagonal, {lower} below, for `{first}` and `{second}`")]
    NotSymmetric {
        /// One of the two states.
        first: String,
        /// The other state.
        second: String,
        /// Entry above the diagonal.
        upper: f64,
        /// Entry below the diagonal.
        lower: f64,
    },
    /// States of different phases are correlated.
    #[error("the covariance of `{first}` and `{second}` is {found}, expected 0: they are of different phases")]
    AcrossPhases {
        /// One of the two states.
        first: String,
        /// The other state.
        second: String,
        /// Covariance of the two states.
        found: f64,
    },
    /// A matrix is not positive semidefinite, or has no value.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// The model gives no value to some elements.
    #[error("no value is given for {}", elements.join(", "))]
    NoValue {
        /// Names of the elements, such as `mean[a]` or `covariance[a, b]`.
        elements: Vec<String>,
    },
}

impl Population {
    /// The marginal law of a test with p states in groups, whose effects enter by `slots`: the sum over all levels. A
    /// population in one level is unchanged.
    #[must_use]
    pub fn together(&self, p: usize, slots: &LevelSlots) -> Population {
        let levels = self.mean.len().checked_div(p).unwrap_or(1);
        let mean = (0..p).map(|i| (0..levels).map(|l| self.mean[l * p + i]).sum()).collect();
        let block = |level: usize| self.covariance.view((level * p, level * p), (p, p)).into_owned();
        let covariance = (1..levels).fold(block(0), |sum, level| sum + slots.spread(level, &block(level)));
        Population { mean, coefficients: self.coefficients.clone(), covariance }
    }

    /// The population of the fixed values in a model or, for elements that are not fixed, of the start values.
    ///
    /// # Errors
    /// [`PopulationError::NoValue`] names all elements without a fixed value or a start value; another error is a
    /// matrix that is not positive semidefinite.
    pub fn of_model(model: &PhasedModel, alpha: &Alpha) -> Result<Population, PopulationError> {
        let names = model.element_names();
        let p = names.len();
        let (mut mean, mut sigma, mut missing) = (Vec::with_capacity(p), DMatrix::zeros(p, p), Vec::new());
        for (phase, range) in model.phases.iter().zip(model.ranges()) {
            let structure = &phase.model.covariance;
            let named_block = NamedBlock { model: &phase.model, structure, names: &names[range.clone()] };
            mean.extend(named_block.means(&mut missing));
            for regression in &phase.model.mean.regression {
                let column = &phase.model.columns[regression.column].name;
                let element = &named_block.names[regression.element];
                missing.push(format!("the coefficient of `{column}` in mean[{element}]"));
            }
            let own = named_block.covariance(alpha, &mut missing)?;
            sigma.view_mut((range.start, range.start), own.shape()).copy_from(&own);
        }
        for (structure, range) in model.blocks().skip(model.phases.len()) {
            mean.resize(range.end, 0.0);
            let named_block = NamedBlock { model: model.shared(), structure, names: &names[range.clone()] };
            let own = named_block.covariance(alpha, &mut missing)?;
            sigma.view_mut((range.start, range.start), own.shape()).copy_from(&own);
        }
        if !missing.is_empty() {
            return Err(PopulationError::NoValue { elements: missing });
        }
        let population = Population { mean, coefficients: Vec::new(), covariance: sigma };
        population.check(model)?;
        Ok(population)
    }

    /// Checks that the population has the dimensions of the model, finite values, and a covariance that is symmetric
    /// and positive semidefinite.
    ///
    /// # Errors
    /// The error names the first condition that does not hold.
    pub fn check(&self, model: &PhasedModel) -> Result<(), PopulationError> {
        let regressions = model.phases.iter().map(|phase| phase.model.mean.regression.len()).sum();
        let names = model.element_names();
        self.check_named(names.len(), regressions, &|i| names[i].clone())?;
        let phase_of: Vec<usize> =
            model.blocks().enumerate().flat_map(|(block, (_, range))| range.map(move |_| block)).collect();
        let different_blocks = |&(i, j): &(usize, usize)| phase_of[i] != phase_of[j] && self.covariance[(i, j)] != 0.0;
        match (0..names.len()).flat_map(|i| (0..i).map(move |j| (i, j))).find(different_blocks) {
            Some((i, j)) => Err(PopulationError::AcrossPhases {
                first: names[j].clone(),
                second: names[i].clone(),
                found: self.covariance[(i, j)],
            }),
            None => Ok(()),
        }
    }

    /// [`Population::check`] for p states with names `name(i)` and for `regressions` regression coefficients;
    /// correlations between phases are not checked.
    pub fn check_named(
        &self,
        p: usize,
        regressions: usize,
        name: &dyn Fn(usize) -> String,
    ) -> Result<(), PopulationError> {
        let sigma = &self.covariance;
        for (what, found, expected) in [
            ("means", self.mean.len(), p),
            ("regression coefficients", self.coefficients.len(), regressions),
            ("rows of the covariance", sigma.nrows(), p),
            ("columns of the covariance", sigma.ncols(), p),
        ] {
            if found != expected {
                return Err(PopulationError::Count { what, found, expected });
            }
        }
        let finite = |found: f64, what: &dyn Fn() -> String| match found.is_finite() {
            true => Ok(()),
            false => Err(PopulationError::NotFinite { what: what(), found }),
        };
        for (i, &mean) in self.mean.iter().enumerate() {
            finite(mean, &|| format!("mean[{}]", name(i)))?;
        }
        for (r, &coefficient) in self.coefficients.iter().enumerate() {
            finite(coefficient, &|| format!("regression coefficient {}", r + 1))?;
        }
        for i in 0..p {
            for j in 0..p {
                finite(sigma[(i, j)], &|| format!("covariance[{}, {}]", name(i), name(j)))?;
            }
        }
        for i in 0..p {
            for j in 0..i {
                let (lower, upper) = (sigma[(i, j)], sigma[(j, i)]);
                if (lower - upper).abs() > 1e-9 * lower.abs().max(upper.abs()) {
                    return Err(PopulationError::NotSymmetric { first: name(j), second: name(i), upper, lower });
                }
            }
        }
        if sigma.diagonal().iter().any(|v| *v < 0.0) || !symmetric::is_semidefinite(sigma) {
            let (values, _) = symmetric::eigen(sigma);
            let (least, largest) = (values[0], values[p - 1]);
            return Err(StructureError::NotSemidefinite { what: "the covariance".to_owned(), least, largest }.into());
        }
        Ok(())
    }
}

/// The model of one phase, with the names of the estimated states for messages.
struct NamedBlock<'a> {
    model: &'a Model,
    /// Structure of the covariance of the phase, or of a level of groups.
    structure: &'a CovarianceStructure,
    names: &'a [String],
}

impl NamedBlock<'_> {
    /// μ, with zeros where no value is given; the names of elements without a value are added to `missing`.
    fn means(&self, missing: &mut Vec<String>) -> Vec<f64> {
        let structure = &self.model.mean;
        let scale = structure.elements.iter().zip(&structure.start).find_map(|(element, start)| match element {
            MeanElement::Proportional(weight) if *weight != 0.0 => start.map(|start| start / weight),
            _ => None,
        });
        let own = |i: usize| match structure.elements[i] {
            MeanElement::Fixed(value) => Some(value),
            MeanElement::Free => structure.start[i],
            MeanElement::Proportional(weight) => scale.map(|scale| scale * weight),
            MeanElement::Tied { .. } => None,
        };
        let mut mean = vec![0.0; structure.elements.len()];
        for (i, element) in structure.elements.iter().enumerate() {
            // A tied element is not listed: the list contains the elements without a value in the tie.
            match (element, own(i)) {
                (MeanElement::Tied { constant, terms }, _) => {
                    mean[i] = terms.iter().fold(*constant, |sum, &(k, weight)| sum + weight * own(k).unwrap_or(0.0));
                }
                (_, Some(value)) => mean[i] = value,
                (_, None) => missing.push(format!("mean[{}]", self.names[i])),
            }
        }
        mean
    }

    /// Σ, with zeros where no value is given; the names of elements without a value are added to `missing`.
    fn covariance(&self, alpha: &Alpha, missing: &mut Vec<String>) -> Result<DMatrix<f64>, PopulationError> {
        let NamedBlock { structure, names: name, .. } = *self;
        let p = name.len();
        let blocks: Vec<Vec<usize>> = match &structure.kind {
            CovarianceKind::Fixed(entries) => return evaluated_entries(entries, alpha),
            CovarianceKind::Proportional(_) => {
                missing.push("the scale of the proportional covariance".to_owned());
                return Ok(DMatrix::zeros(p, p));
            }
            CovarianceKind::Correlation(_) => {
                missing.extend(
                    (0..p).filter(|&i| !is_zero(structure, i)).map(|i| format!("covariance[{0}, {0}]", name[i])),
                );
                return Ok(DMatrix::zeros(p, p));
            }
            CovarianceKind::Linear { .. } => {
                return Ok(structure.start.clone().unwrap_or_else(|| {
                    missing.push("the coefficients of the linear covariance".to_owned());
                    DMatrix::zeros(p, p)
                }));
            }
            CovarianceKind::Full => vec![(0..p).collect()],
            CovarianceKind::Diagonal => (0..p).map(|i| vec![i]).collect(),
            CovarianceKind::Blocks(blocks) => blocks.clone(),
        };
        if let Some(start) = &structure.start {
            return Ok(start.clone());
        }
        let mut sigma = DMatrix::zeros(p, p);
        for i in 0..p {
            for j in 0..=i {
                let fixed = structure.fixed.iter().find(|e| (e.i, e.j) == (i, j)).map(|e| e.value);
                let imposed_zero = is_zero(structure, i)
                    || is_zero(structure, j)
                    || !blocks.iter().any(|block| block.contains(&i) && block.contains(&j));
                match fixed {
                    Some(value) => (sigma[(i, j)], sigma[(j, i)]) = (value, value),
                    None if imposed_zero => {}
                    None => missing.push(format!("covariance[{}, {}]", name[j], name[i])),
                }
            }
        }
        Ok(sigma)
    }
}

/// Whether variance σ_ii is fixed at zero.
fn is_zero(structure: &CovarianceStructure, i: usize) -> bool {
    structure.fixed.iter().any(|e| (e.i, e.j) == (i, i) && e.value == 0.0)
}

fn evaluated_entries(entries: &[Vec<Expression>], alpha: &Alpha) -> Result<DMatrix<f64>, PopulationError> {
    let scope = Scope { numbers: &[], texts: &[], step: 0.0, alpha };
    let mut values = DMatrix::zeros(entries.len(), entries.len());
    for (row, expressions) in entries.iter().enumerate() {
        for (column, expression) in expressions.iter().enumerate() {
            values[(row, column)] = expression.evaluate(&scope).map_err(|source| {
                let what = "the fixed covariance".to_owned();
                StructureError::Entry { what, row, column, source }
            })?;
        }
    }
    Ok(values)
}
