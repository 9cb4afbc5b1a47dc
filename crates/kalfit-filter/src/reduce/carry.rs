//! What a phase inherits: σ = [ξ; 0] + T x_K + t; x_K is the last state of the phase before (theory §7).

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};

use crate::reduce::error::ReduceError;
use crate::reduce::steps::GatheredCells;
use crate::reduce::subject::{Coefficient, Fault, ModelAt, Subject, Uses};
use kalfit_model::Inherited;
use kalfit_model::Test;
use kalfit_model::{Alpha, Phase, Scope};

/// T and t of a phase at α, as coefficients.
#[derive(Debug, Clone)]
pub(crate) struct Inheritance {
    /// (q, n), the shape of T; n is the number of states of the phase before.
    shape: (usize, usize),
    /// The entries of T and t that can differ from zero.
    pub(crate) terms: Vec<InheritanceTerm>,
    /// Columns of the data that must be constant within the phase.
    uses: Uses,
    /// T and t, if equal for all tests; else `None`.
    fixed: Option<Inherited>,
}

/// One coefficient of T or t.
#[derive(Debug, Clone)]
pub(crate) struct InheritanceTerm {
    /// Row of T and t: the position of the state among the entering coordinates.
    pub(crate) row: usize,
    /// Column of T: a state of the phase before; `None` for an entry of t.
    pub(crate) from: Option<usize>,
    pub(crate) coefficient: Coefficient,
}

impl Inheritance {
    /// The inheritance of `phase`, given the number of states of the phase before. `at`: the model of `phase` at α.
    pub(crate) fn new(phase: &Phase, previous_states: usize, at: &ModelAt<'_>) -> Result<Inheritance, Box<Fault>> {
        let entering = phase.entering();
        let (mut terms, mut uses) = (Vec::new(), Uses::default());
        for carry in &phase.carry {
            let row = entering.iter().position(|&state| state == carry.state).expect("a state that inherits enters");
            let linear = carry.from.terms.iter().map(|(state, coefficient)| (Some(*state), coefficient));
            for (from, expression) in linear.chain([(None, &carry.from.constant)]) {
                let coefficient = at.coefficient(expression, Subject::Carry(carry.state))?;
                if !coefficient.is_zero() {
                    uses.add(&coefficient, at.alpha);
                    terms.push(InheritanceTerm { row, from, coefficient });
                }
            }
        }
        let mut inheritance = Inheritance { shape: (entering.len(), previous_states), terms, uses, fixed: None };
        if inheritance.terms.iter().all(|term| term.coefficient.constant().is_some()) {
            let scope = Scope { numbers: &[], texts: &[], step: f64::NAN, alpha: at.alpha };
            inheritance.fixed = Some(inheritance.at(at, &scope)?);
        }
        Ok(inheritance)
    }

    /// The cells on which the coefficients of a test are evaluated; a column that varies within the phase is an error.
    pub(crate) fn scope<'a>(
        &self,
        at: &ModelAt<'a>,
        test: &Test,
        cells: &'a mut GatheredCells,
    ) -> Result<Scope<'a>, Box<Fault>> {
        cells.gather(at, test, 0..test.rows(), (&self.uses, true))?;
        let alpha: &'a Alpha = at.alpha;
        Ok(Scope { numbers: &cells.numbers, texts: &cells.texts, step: f64::NAN, alpha })
    }

    /// T and t of a test. `test`: the rows of the test in this phase.
    pub(crate) fn of(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        cells: &mut GatheredCells,
    ) -> Result<Cow<'_, Inherited>, ReduceError> {
        if let Some(fixed) = &self.fixed {
            return Ok(Cow::Borrowed(fixed));
        }
        let with_names = |fault: Box<Fault>| fault.name(at.model, Some(test));
        let scope = self.scope(at, test, cells).map_err(with_names)?;
        self.at(at, &scope).map(Cow::Owned).map_err(|fault| with_names(fault.on(0)))
    }

    fn at(&self, at: &ModelAt<'_>, scope: &Scope<'_>) -> Result<Inherited, Box<Fault>> {
        let mut inherited =
            Inherited { transition: DMatrix::zeros(self.shape.0, self.shape.1), input: DVector::zeros(self.shape.0) };
        for term in &self.terms {
            let value = at.value(&term.coefficient, scope)?;
            match term.from {
                Some(state) => inherited.transition[(term.row, state)] = value,
                None => inherited.input[term.row] = value,
            }
        }
        Ok(inherited)
    }
}
