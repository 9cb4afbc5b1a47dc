//! Measurements in code.

use crate::build::BuildError;
use crate::build::formula::Formula;
use crate::build::linear::{linear, nonnegative, scalar, squared};
use crate::build::names::{Names, Role};
use crate::model::Measurement;

/// Builder of a measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasurementBuilder {
    pub(super) name: String,
    column: String,
    only_where: Option<Formula>,
    equation: Formula,
    noise: Noise,
}

/// Noise of a measurement. A number, a name or a formula converts to noise with this standard deviation.
#[derive(Debug, Clone, PartialEq)]
pub enum Noise {
    /// Standard deviation of the noise.
    StdDev(Formula),
    /// Variance of the noise.
    Variance(Formula),
}

/// Noise given by its variance, for data that contain variances.
pub fn variance(variance: impl Into<Formula>) -> Noise {
    Noise::Variance(variance.into())
}

impl<T: Into<Formula>> From<T> for Noise {
    fn from(deviation: T) -> Noise {
        Noise::StdDev(deviation.into())
    }
}

/// A measurement: the values in the column of this name are `equation`, linear in the states, plus noise.
pub fn measurement(
    name: impl Into<String>,
    equation: impl Into<Formula>,
    noise: impl Into<Noise>,
) -> MeasurementBuilder {
    let name = name.into();
    let column = name.clone();
    MeasurementBuilder { name, column, only_where: None, equation: equation.into(), noise: noise.into() }
}

impl MeasurementBuilder {
    /// Reads the measurement from a column of another name.
    #[must_use]
    pub fn column(mut self, column: impl Into<String>) -> Self {
        self.column = column.into();
        self
    }

    /// Reads the measurement only from rows where the condition holds.
    #[must_use]
    pub fn only_where(mut self, condition: Formula) -> Self {
        self.only_where = Some(condition);
        self
    }

    pub(super) fn lower(&self, names: &mut Names) -> Result<Measurement, BuildError> {
        let place = format!("measurement `{}`", self.name);
        let of = |what: &str| format!("{what} of {place}");
        Ok(Measurement {
            name: self.name.clone(),
            column: names.column(&self.column, &place),
            filter: self.only_where.as_ref().map(|f| scalar(names, f, &of("condition"))).transpose()?,
            equation: linear(names, &self.equation, &of("equation"))?,
            noise_variance: match &self.noise {
                Noise::StdDev(deviation) => squared(names, deviation, &of("noise"))?,
                Noise::Variance(variance) => nonnegative(names, variance, Role::NonNegative, &of("variance"))?,
            },
        })
    }
}
