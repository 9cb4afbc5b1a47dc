//! The structure of Σ in η: Σ = FF' with F linear in the solver's coordinates ψ, and linear constraints on Σ.
//!
//! Every structure of the model file has this form. Within a block Σ_b = L_b L_b' with L_b lower triangular in a
//! pivoted order, so that a singular Σ shows as trailing columns that are zero; Σ = βΣ* is F = ψ root(Σ*); Σ = DRD is F
//! = D root(R). Fixed and equal elements that no such form gives are constraints Σ_ab coefficient σ_ab = value. Each
//! phase has a separate form; between phases Σ is zero.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::frame::Frame;
use crate::structure::Structure;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::symmetric;
use kalfit_algebra::symmetric::pairs;
use kalfit_model::StructureError;

/// How the Σ of a phase is built from coordinates ψ. Matrices have the size of the phase; states are numbered over all
/// phases.
#[derive(Debug, Clone)]
pub enum CoordinateForm {
    /// Blocks Σ_b = L_b L_b'.
    Factor(Vec<Vec<usize>>),
    /// Σ = ψ² root root'.
    Scale(DMatrix<f64>),
    /// Σ = D root root' D, D = diag(ψ) over these states.
    StdDevs(DMatrix<f64>, Vec<usize>),
    /// Σ is this matrix.
    Fixed(DMatrix<f64>),
}

/// The structure of the Σ of one phase, in η.
#[derive(Debug, Clone)]
pub struct PhaseForm {
    /// States of the phase.
    pub states: Range<usize>,
    /// How the Σ of the phase is built from coordinates ψ.
    pub form: CoordinateForm,
    /// Whether the phase has a linear covariance structure.
    pub linear: bool,
    /// Start value of Σ from the model, in η, if given.
    pub start: Option<DMatrix<f64>>,
}

/// A linear constraint: Σ coefficient × σ_ij = value.
#[derive(Debug, Clone, PartialEq)]
pub struct Constraint {
    /// (i, j, coefficient) of each element σ_ij in the sum.
    pub terms: Vec<(usize, usize, f64)>,
    /// Value of the sum.
    pub value: f64,
}

/// The structure of Σ, in η.
#[derive(Debug, Clone)]
pub struct CovarianceMap {
    pub(crate) p: usize,
    /// The form of each phase.
    pub parts: Vec<PhaseForm>,
    /// Linear constraints on Σ that the forms of the phases do not give.
    pub constraints: Vec<Constraint>,
    /// States whose variance is not held at zero.
    pub random: Vec<usize>,
    /// For each regression coefficient, the state whose mean the coefficient acts on: the variance of that state sets
    /// the natural size of the coefficient.
    pub(crate) regressors: Vec<usize>,
    /// The elements of Σ.
    pub elements: Elements,
}

impl CovarianceMap {
    pub(crate) fn new(structure: &Structure<'_>, frame: &Frame) -> Result<CovarianceMap, StructureError> {
        let ranges = structure.ranges();
        let elements = Elements::new(ranges.clone());
        let mut all = CovarianceMap {
            p: elements.states(),
            parts: Vec::new(),
            constraints: Vec::new(),
            random: Vec::new(),
            regressors: structure.regressions().iter().map(|r| r.element).collect(),
            elements,
        };
        for (phase, range) in structure.phases.iter().zip(ranges) {
            let own = CovarianceMap::of_phase(phase.covariance, structure.alpha, &frame.part(&range))?;
            all.append(own, range.start);
        }
        Ok(all)
    }

    /// Adds the structure of a phase whose states begin at `start`.
    fn append(&mut self, phase: CovarianceMap, start: usize) {
        self.parts.extend(phase.parts.into_iter().map(|part| part.with_shifted_states(start as isize)));
        self.random.extend(phase.random.iter().map(|i| start + i));
        self.constraints.extend(phase.constraints.iter().map(|c| c.with_shifted_states(start as isize)));
    }

    /// The structure of one phase, with states numbered from zero.
    pub fn of_part(&self, part: &PhaseForm) -> CovarianceMap {
        let states = &part.states;
        let back = -(states.start as isize);
        let own = |c: &&Constraint| c.terms.iter().all(|(i, _, _)| states.contains(i));
        CovarianceMap {
            p: states.len(),
            parts: vec![part.with_shifted_states(back)],
            constraints: self.constraints.iter().filter(own).map(|c| c.with_shifted_states(back)).collect(),
            random: self.random.iter().filter(|i| states.contains(i)).map(|i| i - states.start).collect(),
            regressors: Vec::new(),
            elements: Elements::single(states.len()),
        }
    }

    /// Blocks Σ_b = L_b L_b' of all phases that have blocks.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = &Vec<usize>> {
        self.parts.iter().flat_map(|part| match &part.form {
            CoordinateForm::Factor(blocks) => blocks.as_slice(),
            _ => &[],
        })
    }

    /// The form of the Σ of the phase that a state belongs to.
    pub fn form_of(&self, state: usize) -> &CoordinateForm {
        &self.parts[self.elements.block_of(state)].form
    }

    /// The p × p matrix with these diagonal blocks, one for each phase, and zeros elsewhere.
    pub(crate) fn block_diagonal(&self, parts: impl IntoIterator<Item = DMatrix<f64>>) -> DMatrix<f64> {
        let mut whole = DMatrix::zeros(self.p, self.p);
        for (part, own) in self.parts.iter().zip(parts) {
            let start = part.states.start;
            whole.view_mut((start, start), own.shape()).copy_from(&own);
        }
        whole
    }

    /// Whether element (i, j) is zero because of the form.
    pub fn is_structural_zero(&self, i: usize, j: usize) -> bool {
        match self.form_of(i) {
            _ if self.elements.get(i, j).is_none() => true,
            CoordinateForm::Factor(blocks) => !blocks.iter().any(|b| b.contains(&i) && b.contains(&j)),
            _ => !(self.random.contains(&i) && self.random.contains(&j)),
        }
    }

    /// Σ with structural zeros set to zero.
    pub fn mask(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(self.p, self.p, |i, j| if self.is_structural_zero(i, j) { 0.0 } else { sigma[(i, j)] })
    }

    /// Σ coefficient × σ_ij - value for each constraint.
    pub fn residual(&self, sigma: &DMatrix<f64>) -> DVector<f64> {
        let left = |c: &Constraint| c.terms.iter().map(|&(i, j, x)| x * sigma[(i, j)]).sum::<f64>();
        DVector::from_iterator(self.constraints.len(), self.constraints.iter().map(|c| left(c) - c.value))
    }

    /// The largest |residual| / (1 + |value| + Σ |coefficient| √(σ_ii σ_jj)) of a constraint: a large variance outside
    /// a constraint must not hide the residual of that constraint.
    pub fn relative_residual(&self, sigma: &DMatrix<f64>, residual: &DVector<f64>) -> f64 {
        let size = |c: &Constraint| {
            let std_dev_product = |i: usize, j: usize| (sigma[(i, i)] * sigma[(j, j)]).max(0.0).sqrt();
            c.value.abs() + c.terms.iter().map(|&(i, j, x)| x.abs() * std_dev_product(i, j)).sum::<f64>()
        };
        let relative = self.constraints.iter().zip(residual.iter()).map(|(c, r)| r.abs() / (1.0 + size(c)));
        relative.fold(0.0, f64::max)
    }

    /// Number of free covariance quantities of the declared structure: coordinates less constraints.
    pub(crate) fn declared(&self) -> usize {
        let of_form = |part: &PhaseForm| match &part.form {
            CoordinateForm::Factor(blocks) => blocks.iter().map(|b| pairs(b.len())).sum(),
            CoordinateForm::Scale(_) => 1,
            CoordinateForm::StdDevs(_, states) => states.len(),
            CoordinateForm::Fixed(_) => 0,
        };
        self.parts.iter().map(of_form).sum::<usize>() - self.constraints.len()
    }

    /// A root F in the form of the structure, from a Σ that nearly meets the structure.
    pub fn root_of(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        let mut root = DMatrix::zeros(self.p, self.p);
        for part in &self.parts {
            let start = part.states.start;
            let mut whole = |own: DMatrix<f64>| root.view_mut((start, start), own.shape()).copy_from(&own);
            match &part.form {
                CoordinateForm::Factor(blocks) => {
                    for block in blocks {
                        let own = symmetric::square_root(&submatrix(sigma, block));
                        place(&mut root, block, &own);
                    }
                }
                CoordinateForm::Scale(star) => {
                    let star_trace: f64 = star.norm_squared();
                    let trace: f64 = part.states.clone().map(|i| sigma[(i, i)]).sum();
                    whole(star * (trace.max(0.0) / star_trace.max(f64::MIN_POSITIVE)).sqrt());
                }
                CoordinateForm::StdDevs(correlation, states) => {
                    let sd = |i| if states.contains(&i) { sigma[(i, i)].max(0.0).sqrt() } else { 0.0 };
                    let n = part.states.len();
                    whole(DMatrix::from_fn(n, n, |i, c| sd(start + i) * correlation[(i, c)]));
                }
                CoordinateForm::Fixed(known) => whole(symmetric::square_root(known)),
            }
        }
        root
    }
}

impl PhaseForm {
    /// The diagonal block of the phase in a p × p matrix.
    pub fn of(&self, matrix: &DMatrix<f64>) -> DMatrix<f64> {
        let (start, n) = (self.states.start, self.states.len());
        matrix.view((start, start), (n, n)).clone_owned()
    }

    /// A p × p matrix with the given block for the phase, zero elsewhere.
    pub fn placed(&self, own: &DMatrix<f64>, p: usize) -> DMatrix<f64> {
        let mut whole = DMatrix::zeros(p, p);
        whole.view_mut((self.states.start, self.states.start), own.shape()).copy_from(own);
        whole
    }

    /// The form with `by` added to every state index.
    fn with_shifted_states(&self, by: isize) -> PhaseForm {
        let shifted_index = |i: usize| i.strict_add_signed(by);
        let form = match &self.form {
            CoordinateForm::Factor(blocks) => CoordinateForm::Factor(
                blocks.iter().map(|block| block.iter().map(|&i| shifted_index(i)).collect()).collect(),
            ),
            CoordinateForm::StdDevs(root, states) => {
                CoordinateForm::StdDevs(root.clone(), states.iter().map(|&i| shifted_index(i)).collect())
            }
            other => other.clone(),
        };
        PhaseForm { states: shifted_index(self.states.start)..shifted_index(self.states.end), form, ..self.clone() }
    }
}

impl Constraint {
    fn with_shifted_states(&self, by: isize) -> Constraint {
        let shifted_index = |i: usize| i.strict_add_signed(by);
        Constraint {
            terms: self.terms.iter().map(|&(i, j, x)| (shifted_index(i), shifted_index(j), x)).collect(),
            ..self.clone()
        }
    }
}

/// The rows and columns of `matrix` that `block` lists.
pub(crate) fn submatrix(matrix: &DMatrix<f64>, block: &[usize]) -> DMatrix<f64> {
    DMatrix::from_fn(block.len(), block.len(), |i, j| matrix[(block[i], block[j])])
}

/// Writes `own` into the rows and columns that `block` lists.
pub(crate) fn place(into: &mut DMatrix<f64>, block: &[usize], own: &DMatrix<f64>) {
    for i in 0..block.len() {
        for j in 0..block.len() {
            into[(block[i], block[j])] = own[(i, j)];
        }
    }
}
