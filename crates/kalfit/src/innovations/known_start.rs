//! A model whose initial state is known in law: μ and Σ become part of a and P0, and ξ is gone.

use std::sync::Arc;

use crate::ensemble::Test;
use crate::innovations::rows::{self, Figures};
use crate::innovations::series::Innovations;
use crate::model::{Alpha, Expression, Model, Operator, Population};
use crate::reduce::{Frame, Gains, ReduceError, ReduceErrorKind, Reducer, Workspace};

/// The filter of a model from x_0 ~ N(a + Aμ_j, P0 + AΣA').
#[derive(Debug)]
pub(crate) struct KnownStart {
    reducer: Reducer,
    /// The reducer's order of states, without ξ.
    frame: Arc<Frame>,
    time: Option<usize>,
}

impl KnownStart {
    /// `initial` is of the shape of the model.
    pub(crate) fn new(model: &Model, alpha: &Alpha, initial: &Population) -> Result<KnownStart, ReduceError> {
        let reducer = Reducer::new(&known(model, initial), alpha)?;
        let frame = Arc::new(reducer.workspace().design.frame.without_unknowns());
        Ok(KnownStart { reducer, frame, time: model.clock.time })
    }

    pub(crate) fn workspace(&self) -> Workspace {
        let mut work = self.reducer.workspace();
        work.design.frame = self.frame.clone();
        work
    }

    /// The innovations of a test. `work` is of [`KnownStart::workspace`].
    pub(crate) fn innovations(&self, test: &Test, work: &mut Workspace) -> Result<Innovations, ReduceError> {
        let known = |value: f64, weight: f64, _: &[f64]| {
            let (variance, standardised) = (weight.recip(), value * weight.sqrt());
            Figures { value, variance, standardised }
        };
        let look = |gains: &Gains, work: &mut Workspace| rows::series((0, test, self.time), gains, work, known);
        let series = self.reducer.with_gains(test, work, look)?;
        if !rows::are_finite(&series) {
            let kind = Box::new(ReduceErrorKind::NotFinite);
            return Err(ReduceError { test: Some(test.id.clone()), row: None, what: "innovations".to_owned(), kind });
        }
        Ok(Innovations::new(test.id.clone(), series))
    }
}

/// The model with μ_j among the offsets and Σ added to the known covariance.
fn known(model: &Model, initial: &Population) -> Model {
    let mut known = model.clone();
    for (i, &state) in model.estimated.iter().enumerate() {
        add(&mut known.states[state].offset, Expression::Number(initial.mean[i]));
    }
    for (regression, &coefficient) in model.mean.regression.iter().zip(&initial.coefficients) {
        let (slope, column) = (Expression::Number(coefficient), Expression::Column(regression.column));
        let product = Expression::Binary(Operator::Multiply, Box::new(slope), Box::new(column));
        add(&mut known.states[model.estimated[regression.element]].offset, product);
    }
    let p = model.estimated.len();
    let zero = || vec![vec![Expression::Number(0.0); p]; p];
    let matrix = known.covariance.known.get_or_insert_with(zero);
    for (i, row) in matrix.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            let own = std::mem::replace(entry, Expression::Number(0.0));
            *entry = sum(own, Expression::Number(initial.covariance[(i, j)]));
        }
    }
    known
}

fn add(offset: &mut Option<Expression>, term: Expression) {
    *offset = Some(match offset.take() {
        Some(own) => sum(own, term),
        None => term,
    });
}

/// a + b; a number where both are.
fn sum(a: Expression, b: Expression) -> Expression {
    match (a.as_number(), b.as_number()) {
        (Some(a), Some(b)) => Expression::Number(a + b),
        _ => Expression::Binary(Operator::Add, Box::new(a), Box::new(b)),
    }
}
