//! Models and data in code: the pieces of a model file as functions, and tests as columns of numbers.
//!
//! A [`Formula`] is an expression by name: [`name`]`("bias") + name("scale") * name("turn")`. Where a name is neither a
//! state nor a parameter of the model it is a column of the data. [`Model::builder`](crate::Model::builder) collects
//! states, measurements, parameters and constraints; [`ModelBuilder::build`] looks up all names, takes the equations
//! apart into exact linear forms in the states, and refuses what does not make a model. [`Columns`] are the data of one
//! test.
//!
//! ```text
//! Model::builder ── build ──> PhasedModel ┐
//! Columns of each test ───────────────────┴─ Ensemble::new ──> Ensemble ── fit ──> Fit
//! ```
//!
//! The module `guide` of the crate `kalfit` shows whole fits.

mod builder;
mod columns;
mod constraint;
mod error;
mod formula;
mod linear;
mod lower;
mod measurement;
mod names;
mod parameter;
mod phases;
mod state;

pub use builder::ModelBuilder;
pub use columns::{Columns, ColumnsError};
pub use error::BuildError;
pub use formula::{Formula, dt, name, text_is, when};
pub use measurement::{MeasurementBuilder, Noise, measurement, variance};
pub use parameter::{ParameterBuilder, fixed, free};
pub use phases::{PhaseBuilder, PhasedModelBuilder, SchmidtBuilder, phase, schmidt};
pub use state::{
    StateBuilder, constant, gauss_markov, gauss_markov_2, integral, moving, random_walk, random_walk_by_step, stepping,
};

#[cfg(test)]
mod tests;
