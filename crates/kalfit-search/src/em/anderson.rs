//! Anderson's extrapolation of a fixed-point iteration x ← x + f(x).

use nalgebra::{DMatrix, DVector};

/// Maximal number of differences that are kept.
const DEPTH: usize = 16;
/// Size, relative to the largest singular value, below which a singular value counts as zero.
const MIN_SINGULAR_VALUE: f64 = 1e-9;

/// Pairs (x, f(x)) so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Anderson {
    points: Vec<(DVector<f64>, DVector<f64>)>,
}

impl Anderson {
    pub(super) fn clear(&mut self) {
        self.points.clear();
    }

    /// Forgets all but the last point.
    pub(super) fn restart(&mut self) {
        let keep = self.points.len().saturating_sub(1);
        self.points.drain(..keep);
    }

    /// f - (ΔX + ΔF)γ with the γ that minimises |f - ΔFγ|; `None` at the first point.
    pub(super) fn extrapolate(&mut self, x: &[f64], f: &[f64], active: &[bool]) -> Option<Vec<f64>> {
        let (x, f) = (DVector::from_column_slice(x), DVector::from_column_slice(f));
        self.points.push((x, f));
        let room = DEPTH.min(active.iter().filter(|a| **a).count()) + 1;
        let drop = self.points.len().saturating_sub(room);
        self.points.drain(..drop);
        let (last_x, last_f) = self.points.last()?;
        let columns = self.points.len() - 1;
        if columns == 0 {
            return None;
        }
        let n = last_f.len();
        let weight = |i: usize| if active[i] { 1.0 } else { 0.0 };
        let points = &self.points;
        let df = DMatrix::from_fn(n, columns, |i, c| weight(i) * (points[c + 1].1[i] - points[c].1[i]));
        let dx = DMatrix::from_fn(n, columns, |i, c| weight(i) * (points[c + 1].0[i] - points[c].0[i]));
        let size: Vec<f64> = df.column_iter().map(|c| c.norm()).collect();
        if size.contains(&0.0) || last_x.len() != n {
            return None;
        }
        let scaled = DMatrix::from_fn(n, columns, |i, c| df[(i, c)] / size[c]);
        let svd = scaled.svd(true, true);
        let most = svd.singular_values.max();
        let gamma = svd.solve(last_f, MIN_SINGULAR_VALUE * most).ok()?;
        let gamma = DVector::from_fn(columns, |c, _| gamma[c] / size[c]);
        let step = last_f - (dx + df) * gamma;
        step.iter().all(|d| d.is_finite()).then(|| step.as_slice().to_vec())
    }
}
