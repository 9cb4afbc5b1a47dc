//! Coordinates ψ around a root F of Σ = FF'.

use std::ops::Range;

use nalgebra::DMatrix;

use crate::covariance::{CoordinateForm, CovarianceMap};
use kalfit_algebra::elements::Elements;
use kalfit_algebra::sparse::Sparse;

/// Coordinates ψ around a root F: F(ψ + s) = F + Σ s_k F_k, with each F_k as a list of entries (row, column, value).
#[derive(Debug, Clone)]
pub struct Chart {
    pub root: DMatrix<f64>,
    pub(crate) coordinates: Vec<Vec<(usize, usize, f64)>>,
    /// Value of each coordinate that cannot be negative (a standard deviation); `None` for each other coordinate.
    pub(crate) bounded: Vec<Option<f64>>,
    /// The elements of Σ.
    pub(crate) elements: Elements,
}

impl CovarianceMap {
    /// Coordinates ψ near Σ = FF', as derivatives of F.
    pub fn chart(&self, root: &DMatrix<f64>) -> Chart {
        let elements = self.elements.clone();
        let mut chart = Chart { root: root.clone(), coordinates: Vec::new(), bounded: Vec::new(), elements };
        for part in &self.parts {
            let (start, end) = (part.states.start, part.states.end);
            match &part.form {
                CoordinateForm::Factor(blocks) => factor_chart(blocks, root, &part.states, &mut chart),
                CoordinateForm::Scale(star) => {
                    let entries = (start..end).flat_map(|i| (start..end).map(move |c| (i, c)));
                    let entries = entries.map(|(i, c)| (i, c, star[(i - start, c - start)])).collect();
                    chart.coordinates.push(entries);
                    chart.bounded.push(None);
                }
                CoordinateForm::StdDevs(correlation, states) => {
                    for &i in states {
                        let row = (start..end).map(|c| (i, c, correlation[(i - start, c - start)])).collect();
                        chart.coordinates.push(row);
                        let own = root.view((start, start), (end - start, end - start)).clone_owned();
                        chart.bounded.push(Some(std_dev(&own, correlation, i - start)));
                    }
                }
                CoordinateForm::Fixed(_) => {}
            }
        }
        chart
    }
}

impl Chart {
    /// dσ_pair / dψ, elements × coordinates, at `root`, which may differ from the root of this chart.
    pub(crate) fn jacobian_at(&self, root: &DMatrix<f64>) -> Sparse {
        let elements = &self.elements;
        let mut jacobian = Sparse::with_height(elements.count());
        for entries in &self.coordinates {
            let column_terms = |&(i, c, x): &(usize, usize, f64)| {
                let term = move |j| (elements.index(i, j), x * root[(j, c)] * if i == j { 2.0 } else { 1.0 });
                elements.blocks()[elements.block_of(i)].clone().map(term)
            };
            jacobian.push(entries.iter().flat_map(column_terms));
        }
        jacobian
    }

    /// tr(G ∂²Σ/∂ψ_k∂ψ_l) = 2 tr(G F_k F_l').
    pub(crate) fn second_order(&self, score: &DMatrix<f64>, (k, l): (usize, usize)) -> f64 {
        let mut sum = 0.0;
        for &(i, c, x) in &self.coordinates[k] {
            for &(j, d, y) in &self.coordinates[l] {
                if c == d {
                    sum += score[(i, j)] * x * y;
                }
            }
        }
        2.0 * sum
    }

    /// F after a step in ψ; bounded coordinates stop at zero.
    pub(crate) fn moved(&self, step: &[f64]) -> DMatrix<f64> {
        let mut root = self.root.clone();
        for (k, entries) in self.coordinates.iter().enumerate() {
            for &(i, c, x) in entries {
                match self.bounded[k] {
                    // computed from the value, not added to the entry, so that zero is exact
                    Some(value) => root[(i, c)] = (value + step[k]).max(0.0) * x,
                    None => root[(i, c)] += step[k] * x,
                }
            }
        }
        root
    }
}

/// Rotates F (FF' stays unchanged) until each block is lower triangular in a pivoted order, and adds a coordinate for
/// each entry of the triangles.
fn factor_chart(blocks: &[Vec<usize>], root: &DMatrix<f64>, states: &Range<usize>, chart: &mut Chart) {
    let (start, p) = (states.start, states.len());
    chart.root.view_mut((start, start), (p, p)).fill(0.0);
    for block in blocks {
        let own = DMatrix::from_fn(block.len(), p, |i, c| root[(block[i], start + c)]);
        let order = pivot_order(&own);
        let rows = DMatrix::from_fn(own.ncols(), own.nrows(), |c, i| own[(order[i], c)]);
        let upper = rows.qr().r(); // own[order] = (QR)' so that own own' = R'R in that order
        for (place, &i) in order.iter().enumerate() {
            for c in 0..=place {
                let value = if c < upper.nrows() { upper[(c, place)] } else { 0.0 };
                chart.root[(block[i], block[c])] = value;
                chart.coordinates.push(vec![(block[i], block[c], 1.0)]);
                chart.bounded.push(None);
            }
        }
    }
}

/// Indices of the rows in the order of a Cholesky decomposition with pivoting: largest remaining norm first.
fn pivot_order(rows: &DMatrix<f64>) -> Vec<usize> {
    let mut remaining_rows = rows.clone();
    let mut order: Vec<usize> = Vec::new();
    while order.len() < rows.nrows() {
        let norm = |i: &usize| remaining_rows.row(*i).norm_squared();
        let rest = (0..rows.nrows()).filter(|i| !order.contains(i));
        let next = rest.max_by(|a, b| norm(a).total_cmp(&norm(b)).then(b.cmp(a))).expect("a row remains");
        order.push(next);
        let pivot = remaining_rows.row(next).clone_owned();
        let size = pivot.norm_squared();
        if size > 0.0 {
            for i in 0..remaining_rows.nrows() {
                let along = remaining_rows.row(i).dot(&pivot) / size;
                let reduced = remaining_rows.row(i) - &pivot * along;
                remaining_rows.set_row(i, &reduced);
            }
        }
    }
    order
}

/// ψ_i, the factor between row i of R^½ and row i of F = DR^½; zero where rounding made the factor negative.
fn std_dev(root: &DMatrix<f64>, correlation: &DMatrix<f64>, i: usize) -> f64 {
    let unit = correlation.row(i).norm_squared();
    if unit > 0.0 { (root.row(i).dot(&correlation.row(i)) / unit).max(0.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_standard_deviation_stops_at_exactly_zero() {
        let correlation = DMatrix::from_row_slice(1, 3, &[0.1_f64.sqrt(), 0.3_f64.sqrt(), 0.6_f64.sqrt()]);
        let entries: Vec<_> = (0..3).map(|c| (0, c, correlation[(0, c)])).collect();
        let chart = Chart {
            root: &correlation * 0.3,
            coordinates: vec![entries],
            bounded: vec![Some(std_dev(&(&correlation * 0.3), &correlation, 0))],
            elements: Elements::single(1),
        };
        assert_eq!(chart.moved(&[-5.0]), DMatrix::zeros(1, 3));
        let below = std_dev(&(&correlation * -1e-17), &correlation, 0);
        assert_eq!(below, 0.0, "a standard deviation below zero would turn the signs of the correlations");
    }
}
