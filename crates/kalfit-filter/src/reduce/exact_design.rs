//! The exact scalar measurements of a design: nothing random enters an exact measurement, so that it determines h'Ψξ
//! (theory §13).
//!
//! An exact measurement that is a linear combination of earlier exact measurements adds no information, and the value
//! must be that combination of the earlier values.

use crate::reduce::data::{EXACT_TOLERANCE, Miss};
use kalfit_model::ExactRows;

/// Sensitivities up to this fraction of the sum of absolute terms count as zero.
pub(crate) const INSENSITIVE: f64 = 1e-11;

/// The exact measurements of a design.
#[derive(Debug, Clone, Default)]
pub(crate) struct ExactDesign {
    /// C, q × p by rows.
    pub(crate) coefficients: Vec<f64>,
    /// All exact measurements in ascending order of `row`, including measurements that add no information.
    measurements: Vec<ExactMeasurement>,
    /// C after elimination, q × p by rows: row i is zero at the pivots of rows 0 … i - 1.
    reduced: Vec<f64>,
    pivots: Vec<usize>,
}

/// An exact scalar measurement.
#[derive(Debug, Clone)]
struct ExactMeasurement {
    row: usize,
    /// For each earlier row of `reduced`, the multiple of that row that is subtracted from T of the measurement.
    multipliers: Vec<f64>,
    /// True if T of the measurement is linearly independent of the earlier rows.
    is_independent: bool,
}

impl ExactDesign {
    pub(crate) fn is_empty(&self) -> bool {
        self.measurements.is_empty()
    }

    /// C with g = 0; `None` if there are no exact measurements.
    pub(crate) fn blank(&self) -> Option<Box<ExactRows>> {
        let values = vec![0.0; self.pivots.len()];
        (!self.is_empty()).then(|| Box::new(ExactRows { coefficients: self.coefficients.clone(), values }))
    }

    /// True if scalar measurement `row` is exact.
    pub(crate) fn has(&self, row: usize) -> bool {
        self.measurements.binary_search_by_key(&row, |measurement| measurement.row).is_ok()
    }

    /// Indices of the exact measurements among all scalar measurements.
    pub(crate) fn rows(&self) -> impl Iterator<Item = usize> {
        self.measurements.iter().map(|measurement| measurement.row)
    }

    /// Number of stored values, for the estimate of memory.
    pub(crate) fn len(&self) -> usize {
        self.coefficients.len() + self.reduced.len() + self.pivots.len() * self.measurements.len()
    }

    /// Adds exact measurement `row` with sensitivity T; `terms`: sizes of the terms of T. True if T is linearly
    /// independent of T of the earlier exact measurements.
    pub(crate) fn take(&mut self, row: usize, sensitivity: &[f64], mut terms: Vec<f64>) -> bool {
        let p = sensitivity.len();
        let (mut remainder, mut multipliers) = (sensitivity.to_vec(), Vec::with_capacity(self.pivots.len()));
        for (&pivot, reduced) in self.pivots.iter().zip(self.reduced.chunks_exact(p)) {
            let multiplier = remainder[pivot] / reduced[pivot];
            for ((remainder, terms), reduced) in remainder.iter_mut().zip(&mut terms).zip(reduced) {
                *remainder -= multiplier * reduced;
                *terms += (multiplier * reduced).abs();
            }
            remainder[pivot] = 0.0;
            multipliers.push(multiplier);
        }
        let is_sensitive = |k: usize| remainder[k].abs() > INSENSITIVE * terms[k];
        // the pivot is the entry that lost the fewest digits
        let fewer_lost_digits =
            |a: &usize, b: &usize| (remainder[*a].abs() / terms[*a]).total_cmp(&(remainder[*b].abs() / terms[*b]));
        let pivot = (0..p).rev().filter(|&k| is_sensitive(k)).max_by(fewer_lost_digits);
        self.measurements.push(ExactMeasurement { row, multipliers, is_independent: pivot.is_some() });
        if let Some(pivot) = pivot {
            self.coefficients.extend_from_slice(sensitivity);
            self.reduced.extend_from_slice(&remainder);
            self.pivots.push(pivot);
        }
        pivot.is_some()
    }

    /// C and g of a test, from the innovations `e` at ξ = 0; `sizes`: sizes of the terms of each exact measurement, in
    /// order.
    pub(crate) fn rows_from_innovations(&self, e: &[f64], sizes: &[f64]) -> Result<ExactRows, Miss> {
        let (mut values, mut reduced) = (Vec::new(), Vec::<(f64, f64)>::new());
        for (measurement, &size) in self.measurements.iter().zip(sizes) {
            let value = e[measurement.row];
            let (mut remainder, mut size) = (value, size);
            for (multiplier, (earlier_value, earlier_size)) in measurement.multipliers.iter().zip(&reduced) {
                remainder -= multiplier * earlier_value;
                size += (multiplier * earlier_size).abs();
            }
            if measurement.is_independent {
                values.push(value);
                reduced.push((remainder, size));
            } else if remainder.abs() > EXACT_TOLERANCE * size {
                return Err(Miss { row: measurement.row, residual: remainder });
            }
        }
        Ok(ExactRows { coefficients: self.coefficients.clone(), values })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Exact design of these rows, and whether each row is new; the size of a term is that of the entry.
    fn design(rows: &[[f64; 2]]) -> (ExactDesign, Vec<bool>) {
        let mut design = ExactDesign::default();
        let take = |(at, row): (usize, &[f64; 2])| design.take(at, row, row.iter().map(|x| x.abs()).collect());
        let new = rows.iter().enumerate().map(take).collect();
        (design, new)
    }

    #[test]
    fn a_combination_of_rows_before_it_says_nothing_new() {
        let (design, new) = design(&[[1.0, 2.0], [2.0, 4.0], [1e-3, 1.0], [7.0, -0.3]]);
        assert_eq!(new, [true, false, true, false]);
        assert_eq!(design.coefficients, [1.0, 2.0, 1e-3, 1.0]);
        // innovations of ξ = (3, -1)
        let e = [1.0, 2.0, 3e-3 - 1.0, 21.3];
        assert_eq!(design.rows_from_innovations(&e, &[1.0; 4]).unwrap().values, [1.0, 3e-3 - 1.0]);
        let miss = design.rows_from_innovations(&[1.0, 2.0, 3e-3 - 1.0, 21.4], &[1.0; 4]).unwrap_err();
        assert!(miss.row == 3 && (miss.residual - 0.1).abs() < 1e-12, "{miss:?}");
    }

    #[test]
    fn units_of_the_states_do_not_matter() {
        for unit in [1e-12, 1.0, 1e12] {
            let (_, new) = design(&[[1.0, 2.0 * unit], [1.0, 3.0 * unit], [3.0, 8.0 * unit]]);
            assert_eq!(new, [true, true, false], "{unit}");
        }
    }
}
