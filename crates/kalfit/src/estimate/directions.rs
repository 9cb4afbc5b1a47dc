//! Directions in which Σ may move.

use nalgebra::{DMatrix, DVector};

use crate::estimate::chart::Chart;
use crate::estimate::covariance::{CovarianceMap, Form};
use crate::estimate::local::normals;
use crate::linalg::symmetric;

impl CovarianceMap {
    /// Directions in which Σ may move, elements × directions: the free elements where Σ is linear in them, else along ψ.
    pub(crate) fn free_directions(&self, chart: &Chart) -> DMatrix<f64> {
        self.directions(chart, false)
    }

    /// The same, where Σ = βΣ* along β: dΣ/dψ vanishes at Σ = 0, and yet β > 0 is a direction.
    pub(crate) fn cone_directions(&self, chart: &Chart) -> DMatrix<f64> {
        self.directions(chart, true)
    }

    fn directions(&self, chart: &Chart, by_scale: bool) -> DMatrix<f64> {
        let count = self.elements.count();
        let along = chart.jacobian_at(&chart.root);
        let mut columns: Vec<DVector<f64>> = Vec::new();
        for part in &self.parts {
            if let (true, Form::Scale(star)) = (by_scale, &part.form) {
                let star = part.placed(&(star * star.transpose()), self.p);
                columns.push(DVector::from_iterator(count, self.elements.all().map(|at| star[at])));
            } else if let Form::Factor(_) = part.form {
                let own = |&&(i, j): &&(usize, usize)| part.states.contains(&i) && !self.is_structural_zero(i, j);
                let all: Vec<(usize, usize)> = self.elements.all().collect();
                let unit = |&(i, j): &(usize, usize)| {
                    let mut unit = DVector::zeros(count);
                    unit[self.elements.index(i, j)] = 1.0;
                    unit
                };
                columns.extend(all.iter().filter(own).map(unit));
            } else {
                let own = |k: &usize| chart.coordinates[*k].iter().any(|(i, _, _)| part.states.contains(i));
                columns.extend((0..chart.coordinates.len()).filter(own).map(|k| along.column(k).clone_owned()));
            }
        }
        let all = match columns.is_empty() {
            true => DMatrix::zeros(count, 0),
            false => DMatrix::from_columns(&columns),
        };
        if self.constraints.is_empty() {
            return all;
        }
        let normals = normals(&self.constraints, &self.elements) * &all;
        let (values, vectors) = symmetric::eigen(&(normals.transpose() * &normals));
        let null: Vec<usize> = (0..values.len()).filter(|&k| values[k] < 1e-12).collect();
        all * vectors.select_columns(&null)
    }
}
