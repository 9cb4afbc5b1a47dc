//! The matrices of a model with numbers for coefficients, as the reducer's filter uses them.
#![expect(non_snake_case, reason = "the letters of the equations")]

use nalgebra::{DMatrix, DVector};

use crate::export::ExportError;
use crate::export::plain::PlainModel;
use crate::export::terms::{ONE, Terms};
use kalfit_filter::reduce::{Fault, Filled, Moves, Preparer, Subject, ldl};
use kalfit_model::{Alpha, Expression, Scope};

/// A model of constant coefficients, with transition and noise of one step.
#[derive(Debug)]
pub(super) struct ConstantModel {
    preparer: Preparer,
    moves: Moves,
    /// The inputs u.
    pub(super) inputs: Vec<Expression>,
}

impl ConstantModel {
    pub(super) fn new(plain: &PlainModel, step: Option<f64>) -> Result<ConstantModel, ExportError> {
        let named = |fault: Box<Fault>| ExportError::from(fault.name(&plain.model, None));
        let preparer = Preparer::new(&plain.model, &Alpha::default()).map_err(named)?;
        let dynamics = &preparer.dynamics;
        if let (Some(component), None) = (dynamics.components.first(), step) {
            let what = Subject::Derivative(component.states[0]).words(&plain.model);
            return Err(ExportError::NoStep { what });
        }
        let step = step.unwrap_or(f64::NAN);
        let moves = preparer.plan.moves(dynamics, &dynamics.table.fixed, step, (&mut Filled::default(), None));
        let moves = moves.map_err(named)?;
        let mut inputs: Vec<Expression> = Vec::new();
        for (_, term) in plain.state_inputs.iter().chain(&plain.offsets).flatten() {
            if !inputs.contains(term) {
                inputs.push(term.clone());
            }
        }
        inputs.sort_by_key(|term| *term == ONE); // the constant is the last
        Ok(ConstantModel { preparer, moves, inputs })
    }

    /// The transition matrix F, n × n.
    pub(super) fn transition_matrix(&self) -> DMatrix<f64> {
        let states = &self.preparer.order.states;
        self.moves.transition.dense_phi(states.len(), |place| states[place])
    }

    /// The covariance Q of the process noise, n × n.
    pub(super) fn process_noise(&self) -> DMatrix<f64> {
        let states = &self.preparer.order.states;
        self.moves.transition.dense_noise(states.len(), |place| states[place])
    }

    /// The matrix B, n × k: the effect of one unit of each input in a step.
    pub(super) fn driven(&self, plain: &PlainModel) -> DMatrix<f64> {
        let (order, dynamics) = (&self.preparer.order, &self.preparer.dynamics);
        let mut B = DMatrix::zeros(order.states.len(), self.inputs.len());
        for (column, input) in self.inputs.iter().enumerate() {
            let mut values = vec![0.0; dynamics.inputs.fixed.len()];
            for (state, terms) in plain.state_inputs.iter().enumerate() {
                if let Some(input_index) = self.input_index(state) {
                    values[input_index] = coefficient(terms, input);
                }
            }
            let mut moved = Vec::new();
            self.preparer.plan.inputs(&self.moves, &values, &mut moved);
            for (&place, value) in order.frame.driven.iter().zip(moved) {
                B[(order.states[place as usize], column)] = value;
            }
        }
        B
    }

    /// Index of the input of a state among the inputs of the dynamics; `None` where the state has no input.
    fn input_index(&self, state: usize) -> Option<usize> {
        let dynamics = &self.preparer.dynamics;
        if let Some(own) = dynamics.recursions.iter().find(|own| own.state == state) {
            return own.input;
        }
        let of = |component: &kalfit_filter::reduce::Component| {
            component.inputs[component.states.binary_search(&state).ok()?]
        };
        dynamics.components.iter().find_map(of)
    }

    /// The measurement matrix H, m × n.
    pub(super) fn equations(&self) -> DMatrix<f64> {
        let model = &self.preparer.model;
        let mut H = DMatrix::zeros(model.measurements.len(), model.states.len());
        for (m, measurement) in model.measurements.iter().enumerate() {
            for (state, coefficient) in &measurement.equation.terms {
                H[(m, *state)] = number(coefficient);
            }
        }
        H
    }

    /// The matrix D, m × k: the effect of the inputs on the measurements.
    pub(super) fn offsets(&self, plain: &PlainModel) -> DMatrix<f64> {
        let of = |m: usize, input: usize| coefficient(&plain.offsets[m], &self.inputs[input]);
        DMatrix::from_fn(plain.offsets.len(), self.inputs.len(), of)
    }

    /// The covariance R of the measurement noise, m × m.
    pub(super) fn measurement_noise(&self) -> Result<DMatrix<f64>, ExportError> {
        let model = &self.preparer.model;
        let m = model.measurements.len();
        let mut R = DMatrix::zeros(m, m);
        for (i, measurement) in model.measurements.iter().enumerate() {
            R[(i, i)] = number(&measurement.noise_variance);
        }
        for (i, j, covariance) in &model.noise_covariance {
            R[(*i, *j)] += number(covariance);
            R[(*j, *i)] = R[(*i, *j)];
        }
        ldl(&mut R.as_slice().to_vec(), m).map_err(|bad| Fault::new(Subject::StepNoise, bad).name(model, None))?;
        Ok(R)
    }

    /// Mean x0 = a + Aμ and covariance P0 + AΣA' of the start.
    pub(super) fn start(
        &self,
        mean: &[f64],
        covariance: &DMatrix<f64>,
    ) -> Result<(DVector<f64>, DMatrix<f64>), ExportError> {
        let (model, dynamics) = (&self.preparer.model, &self.preparer.dynamics);
        let alpha = Alpha::default();
        let scope = Scope { numbers: &[], texts: &[], step: f64::NAN, alpha: &alpha };
        let law = self.preparer.start.law(&self.preparer.at(), &scope, &dynamics.table.fixed, &dynamics.inputs.fixed);
        let law = law.map_err(|fault| ExportError::from(fault.name(model, None)))?;
        let n = model.states.len();
        let (mut x0, mut P0) = (DVector::from_vec(law.mean), DMatrix::zeros(n, n));
        for (i, j, value) in law.covariance {
            P0[(i, j)] += value;
            if i != j {
                P0[(j, i)] += value;
            }
        }
        for (i, &state) in model.estimated.iter().enumerate() {
            x0[state] += mean[i];
            for (k, &other) in model.estimated.iter().enumerate() {
                P0[(state, other)] += covariance[(i, k)];
            }
        }
        Ok((x0, P0))
    }
}

/// The coefficient of `input` among `terms`; zero where no term is the input.
fn coefficient(terms: &Terms, input: &Expression) -> f64 {
    terms.iter().find(|(_, term)| term == input).map_or(0.0, |(coefficient, _)| *coefficient)
}

/// The value of a coefficient, which must be a number.
fn number(expression: &Expression) -> f64 {
    expression.as_number().expect("every coefficient is a number")
}
