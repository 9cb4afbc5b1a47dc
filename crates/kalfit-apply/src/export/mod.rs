//! The filter that follows from a fit, as matrices for programs that are not kalfit.
//!
//! ```text
//! x_0 ~ N(x0, P0)                              a new test's start
//! x_k = F x_{k-1} + B u_k + w_k, w_k ~ N(0, Q)  one step of the given length
//! z_k = H x_k + D u_k + v_k,     v_k ~ N(0, R)
//! ```
//!
//! The code of the reducer computes F and Q. x0 is a + Aμ, and P0 is the known covariance of the start plus AΣA'
//! (theory §1), with Σ the sum over all levels of groups. The inputs u are columns that drive states or occur in an
//! equation without a state, and the constant 1. Coefficients of states and noise variances must not differ from row to
//! row: columns that a coefficient or variance reads must be given values, or the model is refused.

pub mod bind;
mod error;
mod matrices;
mod plain;
mod terms;
#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, DVector};

pub use error::{ExportError, Varies};

use crate::export::bind::Binder;
use crate::export::matrices::ConstantModel;
use crate::export::plain::PlainModel;
use kalfit_filter::reduce::Subject;
use kalfit_model::{Alpha, Expression, Phase, PhasedModel, Population};

/// Which filter is to be exported.
#[derive(Debug, Clone, Default)]
pub struct Wanted {
    /// Name of the phase; may be `None` where the model has only one phase.
    pub phase: Option<String>,
    /// Length of a step, in the unit of time; needed where a matrix depends on the length.
    pub step: Option<f64>,
    /// (Name of a column, value of the column on all rows).
    pub at: Vec<(String, String)>,
}

/// A filter of constant matrices.
#[derive(Debug, Clone)]
#[expect(non_snake_case, reason = "the letters of the equations")]
pub struct Exported {
    /// Index of the phase in the model.
    pub phase: usize,
    /// Length of a step.
    pub step: Option<f64>,
    /// Transition matrix F, n × n.
    pub F: DMatrix<f64>,
    /// Covariance Q of the process noise of a step, n × n.
    pub Q: DMatrix<f64>,
    /// Effect B of the inputs on the states, n × k.
    pub B: DMatrix<f64>,
    /// The inputs u: k expressions in the columns of the model, or the number 1 for the constant input.
    pub inputs: Vec<Expression>,
    /// Indices of the measurements of the phase that read a row at the fixed values.
    pub measurements: Vec<usize>,
    /// For each entry of `measurements`, the condition on the rows that are read; `None` where all rows are read.
    pub filters: Vec<Option<Expression>>,
    /// Measurement matrix H, m × n.
    pub H: DMatrix<f64>,
    /// Effect D of the inputs on the measurements, m × k.
    pub D: DMatrix<f64>,
    /// Covariance R of the measurement noise, m × m.
    pub R: DMatrix<f64>,
    /// x0 and P0 of a new test; `None` for a phase that inherits from the phase before.
    pub start: Option<(DVector<f64>, DMatrix<f64>)>,
}

/// The filter of a phase at α, for a new test of a population that fits the model.
///
/// # Errors
/// Matrices that are not constant, with the columns that the matrices depend on; a step that is missing or has no
/// effect; an unknown phase.
pub fn export(
    model: &PhasedModel,
    alpha: &Alpha,
    population: &Population,
    wanted: &Wanted,
) -> Result<Exported, ExportError> {
    population.check(model)?;
    let at = phase_of(model, wanted.phase.as_deref())?;
    let phase = &model.phases[at];
    check_step(phase, wanted.step)?;
    let starts = phase.carry.is_empty();
    let mut binder = Binder::new((&phase.model, alpha), wanted.step, &wanted.at)?;
    let plain = PlainModel::new(&phase.model, &mut binder, starts)?;
    let own = population.together(model.dimension(), &model.slots()).by_phase(model).swap_remove(at);
    let mean = if starts { mean(phase, &own, &mut binder)? } else { own.mean.clone() };
    if !binder.varies.is_empty() {
        return Err(ExportError::Varies { varies: binder.varies });
    }
    let constant_model = ConstantModel::new(&plain, wanted.step)?;
    let start = starts.then(|| constant_model.start(&mean, &own.covariance)).transpose()?;
    let measured = |m: &kalfit_model::Measurement| phase.model.measurements.iter().position(|own| own.name == m.name);
    Ok(Exported {
        phase: at,
        step: wanted.step,
        F: constant_model.transition_matrix(),
        Q: constant_model.process_noise(),
        B: constant_model.driven(&plain),
        measurements: plain.model.measurements.iter().filter_map(measured).collect(),
        H: constant_model.equations(),
        D: constant_model.offsets(&plain),
        R: constant_model.measurement_noise()?,
        inputs: constant_model.inputs,
        filters: plain.filters,
        start,
    })
}

fn phase_of(model: &PhasedModel, name: Option<&str>) -> Result<usize, ExportError> {
    let expected = || model.phases.iter().map(|phase| phase.name.clone()).collect();
    match name {
        None if model.is_single() => Ok(0),
        None => Err(ExportError::WhichPhase { expected: expected() }),
        Some(name) => {
            let place = model.phases.iter().position(|phase| phase.name == name);
            place.ok_or_else(|| ExportError::UnknownPhase { found: name.to_owned(), expected: expected() })
        }
    }
}

fn check_step(phase: &Phase, step: Option<f64>) -> Result<(), ExportError> {
    match step {
        Some(found) if !(found.is_finite() && found > 0.0) => Err(ExportError::BadStep { found }),
        Some(found) if phase.model.clock.time.is_none() => Err(ExportError::StepWithoutTime { found }),
        _ => Ok(()),
    }
}

/// μ of a test whose columns have the values of the binder.
fn mean(phase: &Phase, own: &Population, binder: &mut Binder<'_>) -> Result<Vec<f64>, ExportError> {
    let mut mean = own.mean.clone();
    for (r, (regression, coefficient)) in phase.model.mean.regression.iter().zip(&own.coefficients).enumerate() {
        mean[regression.element] += coefficient * binder.column_value(regression.column, Subject::Regression(r))?;
    }
    Ok(mean)
}
