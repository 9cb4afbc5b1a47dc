//! The mean innovation of each step, or time, that tests share.
//!
//! A column for each step would be a matrix as large as the steps are many. Innovations are white, so that the columns
//! are taken in innovations instead: A, with one entry for each innovation of the step, and A'A diagonal.

use std::collections::BTreeMap;

use kalfit_filter::innovations::Innovation;
use nalgebra::{DMatrix, DVector};

use kalfit_algebra::symmetric::{scaled_eigen, sizes};

use crate::misfit::columns::{Columns, UnitColumns};
use crate::misfit::score::{FTest, Score};
use crate::misfit::terms::TermKind;
use crate::misfit::{Deviation, TermTest};

/// A direction of the mean counts as a mean of steps when this part of its square or less is left within steps.
const BETWEEN: f64 = 1e-8;

/// Innovations and columns of mean coordinates, which [`StepMeans::tests`] sums up by step.
pub(super) struct StepMeans {
    /// (phase, measurement, time as [`ordered`]) of each row, and its time.
    places: Vec<(StepKey, f64)>,
    /// Residual and mean coordinates of each row, row after row.
    values: Vec<f64>,
    mean_coordinates: usize,
}

type StepKey = (usize, usize, u64);

/// Sums over the rows of a step.
#[derive(Debug, Clone)]
struct StepSum {
    count: usize,
    at: f64,
    residual: f64,
    means: DVector<f64>,
}

impl StepMeans {
    pub(super) fn new(columns: &Columns<'_>) -> StepMeans {
        let mean_coordinates = columns.basis().ncols() + columns.regressors().len();
        StepMeans { places: Vec::new(), values: Vec::new(), mean_coordinates }
    }

    /// `columns`: those of [`Score::of_means`].
    pub(super) fn add(&mut self, unit: &UnitColumns, columns: &DMatrix<f64>) {
        let width = 1 + self.mean_coordinates;
        self.places.reserve(unit.places.len());
        self.values.reserve(unit.places.len() * width);
        for (row, place) in unit.places.iter().enumerate() {
            let at = position(place);
            self.places.push(((place.phase, place.measurement, ordered(at)), at));
            self.values.extend((0..width).map(|column| columns[(row, column)]));
        }
    }

    /// The sums of the steps of several rows, by phase, measurement and time. Each sum is in the order in which rows came.
    fn sums(&self) -> Vec<(StepKey, StepSum)> {
        let mut order: Vec<usize> = (0..self.places.len()).collect();
        order.sort_by_key(|&row| self.places[row].0);
        let steps = order.chunk_by(|&a, &b| self.places[a].0 == self.places[b].0).filter(|rows| rows.len() > 1);
        steps.map(|rows| (self.places[rows[0]].0, self.sum(rows))).collect()
    }

    fn sum(&self, rows: &[usize]) -> StepSum {
        let q = self.mean_coordinates;
        let mut sum = StepSum { count: 0, at: self.places[rows[0]].1, residual: 0.0, means: DVector::zeros(q) };
        for row in rows {
            let values = &self.values[row * (1 + q)..][..1 + q];
            sum.count += 1;
            sum.residual += values[0];
            sum.means.iter_mut().zip(&values[1..]).for_each(|(sum, mean)| *sum += mean);
        }
        sum
    }

    /// One test for each measurement of which tests share steps.
    pub(super) fn tests(&self, score: &Score) -> Vec<TermTest> {
        let mut by_measurement: BTreeMap<(usize, usize), Vec<&StepSum>> = BTreeMap::new();
        let sums = self.sums();
        for ((phase, measurement, _), sum) in &sums {
            by_measurement.entry((*phase, *measurement)).or_default().push(sum);
        }
        let several = by_measurement.into_iter().filter(|(_, steps)| steps.len() > 1);
        several.filter_map(|(owner, steps)| test(owner, &steps, score)).collect()
    }
}

/// Time of an innovation, or number of its step.
pub(super) fn position(place: &Innovation) -> f64 {
    place.time.unwrap_or(place.step as f64)
}

/// A number that is ordered as x.
pub(super) fn ordered(x: f64) -> u64 {
    let bits = (x + 0.0).to_bits();
    if bits >> 63 == 0 { bits | 1 << 63 } else { !bits }
}

/// With b = A'r and U = A'X over steps, A of columns of length one: s = b - UG⁻X'r, I = I - UG⁻U', and by Woodbury
/// T = s's + (U's)'(G - U'U)⁻(U's).
fn test((phase, measurement): (usize, usize), steps: &[&StepSum], score: &Score) -> Option<TermTest> {
    let (information, of_means) = score.of_mean_coordinates();
    let q = of_means.len();
    let root = |step: &StepSum| (step.count as f64).sqrt();
    let between = DMatrix::from_fn(steps.len(), q, |t, k| steps[t].means[k] / root(steps[t]));
    let change = kalfit_algebra::symmetric::scaled_inverse(&information) * &of_means;
    let residual = DVector::from_fn(steps.len(), |t, _| steps[t].residual / root(steps[t])) - &between * &change;
    // in units in which G has a diagonal of ones, what is left within steps is a share
    let size = sizes(&information);
    let within = &information - between.transpose() * &between;
    let shares = DMatrix::from_fn(q, q, |i, k| within[(i, k)] / size[i] / size[k]);
    let projected = DVector::from_iterator(q, (between.transpose() * &residual).iter().zip(&size).map(|(x, s)| x / s));
    let (unit, values, vectors) = scaled_eigen(&shares);
    let is_within = |k: usize| values[k] > BETWEEN * q as f64;
    let mut statistic = residual.norm_squared();
    let mut lost = 0;
    for k in 0..q {
        let along: f64 = (0..q).map(|i| vectors[(i, k)] * projected[i] / unit[i]).sum();
        if is_within(k) && shares[(k, k)].is_finite() {
            statistic += along * along / values[k];
        } else {
            lost += 1;
        }
    }
    let (square, all) = score.left();
    let found = FTest::of(statistic, steps.len().checked_sub(lost)?, square, all)?;
    let deviation = |step: &&&StepSum| (step.residual / root(step)).abs();
    let largest = steps.iter().max_by(|a, b| deviation(a).total_cmp(&deviation(b)))?;
    Some(TermTest {
        phase,
        measurement,
        kind: TermKind::Steps,
        statistic: found.value,
        degrees_of_freedom: found.degrees_of_freedom,
        p_value: found.p_value(),
        largest: Some(Deviation {
            at: [largest.at; 2],
            value: largest.residual / largest.count as f64,
            std_dev: root(largest).recip(),
        }),
    })
}

#[cfg(test)]
mod tests {
    use super::ordered;

    #[test]
    fn times_keep_their_order() {
        let times = [f64::NEG_INFINITY, -3.0, -1e-300, 0.0, 1e-300, 2.0, f64::INFINITY];
        assert!(times.windows(2).all(|pair| ordered(pair[0]) < ordered(pair[1])));
        assert_eq!(ordered(-0.0), ordered(0.0));
    }
}
