//! Directions in which Σ may move.

use crate::chart::Chart;
use crate::covariance::{CoordinateForm, CovarianceMap};
use crate::local::normals;
use kalfit_algebra::sparse::Sparse;
use kalfit_algebra::symmetric;

impl CovarianceMap {
    /// Directions in which Σ may move, elements × directions: each free element in phases with blocks, dσ/dψ in other
    /// phases, restricted to the null space of the constraints.
    pub fn free_directions(&self, chart: &Chart) -> Sparse {
        self.directions(chart, false)
    }

    /// The directions of `free_directions`, but with Σ* in place of dΣ/dψ where Σ = βΣ*: dΣ/dψ vanishes at Σ = 0,
    /// although β may grow from zero.
    pub fn cone_directions(&self, chart: &Chart) -> Sparse {
        self.directions(chart, true)
    }

    fn directions(&self, chart: &Chart, by_scale: bool) -> Sparse {
        let elements = &self.elements;
        let along = chart.jacobian_at(&chart.root);
        let mut all = Sparse::with_height(elements.count());
        for part in &self.parts {
            if let (true, CoordinateForm::Scale(star)) = (by_scale, &part.form) {
                let star = part.placed(&(star * star.transpose()), self.p);
                all.push(elements.all().map(|at| star[at]).enumerate());
            } else if let CoordinateForm::Factor(_) = part.form {
                let own = |(i, j): &(usize, usize)| part.states.contains(i) && !self.is_structural_zero(*i, *j);
                elements.all().filter(own).for_each(|(i, j)| all.push([(elements.index(i, j), 1.0)].into_iter()));
            } else {
                let own = |k: &usize| chart.coordinates[*k].iter().any(|(i, _, _)| part.states.contains(i));
                (0..chart.coordinates.len()).filter(own).for_each(|k| all.push(along.column(k).iter().copied()));
            }
        }
        if self.constraints.is_empty() {
            return all;
        }
        let normals = all.after(&normals(&self.constraints, elements));
        let (values, vectors) = symmetric::eigen(&(normals.transpose() * &normals));
        let null: Vec<usize> = (0..values.len()).filter(|&k| values[k] < 1e-12).collect();
        all.times_columns(&Sparse::of(&vectors.select_columns(&null)))
    }
}
