//! The data of a test, and the likelihood of the data under a design.

use kalfit_model::ExactRows;

/// Limit of e'S⁻¹e, above which c + ½d'd would lose digits, so that the innovations are computed again at the best ξ.
pub(crate) const REFINE_ABOVE: f64 = 1e3;

/// Largest deviation of an exact measurement from the only possible value, relative to the sum of the absolute terms.
pub(crate) const EXACT_TOLERANCE: f64 = 1e-10;

/// The data of a test, in kernel order and whitened.
#[derive(Debug, Clone, Default)]
pub struct Data {
    /// a, n numbers.
    pub start: Vec<f64>,
    /// b of the driven states, transition after transition.
    pub inputs: Vec<f64>,
    /// z - d of each scalar measurement.
    pub values: Vec<f64>,
    /// |z| + |d| of each scalar measurement.
    pub(crate) sizes: Vec<f64>,
}

impl Data {
    /// Appends a measured value z with the constant d of the measurement.
    #[inline(always)]
    pub(crate) fn take(&mut self, z: f64, constant: f64) {
        self.values.push(z - constant);
        self.sizes.push(z.abs() + constant.abs());
    }

    /// Appends the measured values of rows. `columns`: column and constant d of each measurement of a row.
    pub(crate) fn take_rows<'a>(
        &mut self,
        rows: impl ExactSizeIterator<Item = &'a [f64]> + Clone,
        columns: &[(usize, f64)],
    ) {
        if let &[(column, constant)] = columns {
            // one value a row, for which the length of the list is known
            self.values.extend(rows.clone().map(|numbers| numbers[column] - constant));
            self.sizes.extend(rows.map(|numbers| numbers[column].abs() + constant.abs()));
            return;
        }
        for numbers in rows {
            columns.iter().for_each(|&(column, constant)| self.take(numbers[column], constant));
        }
    }

    pub(crate) fn clear(&mut self) {
        self.start.clear();
        self.inputs.clear();
        self.values.clear();
        self.sizes.clear();
    }
}

/// The likelihood of the data of a test under a design.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Outcome {
    pub(crate) constant: f64,
    /// The residual sum of squares.
    pub(crate) residual: f64,
    /// d, p numbers.
    pub(crate) data: Vec<f64>,
    /// The exact measurements, if there are any.
    pub(crate) exact: Option<Box<ExactRows>>,
}

impl Outcome {
    /// The outcome from d, the residual sum of squares and Σ log S over `active` measurements.
    pub(crate) fn new(data: Vec<f64>, residual: f64, active: usize, log_determinant: f64) -> Outcome {
        let log_density = -0.5 * (active as f64 * std::f64::consts::TAU.ln() + log_determinant);
        Outcome { constant: log_density - 0.5 * residual, residual, data, exact: None }
    }

    pub(crate) fn is_finite(&self) -> bool {
        let exact = self.exact.iter().flat_map(|exact| &exact.values);
        self.constant.is_finite() && self.data.iter().chain(exact).all(|d| d.is_finite())
    }
}

/// The error of an exact measurement: scalar measurement `row` minus the only possible value is `residual`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Miss {
    pub(crate) row: usize,
    pub(crate) residual: f64,
}
