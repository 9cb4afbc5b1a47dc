//! Whitening of the correlated measurements of a step: with R = LDL', L⁻¹z has independent noises D.

use crate::reduce::data::Data;
use crate::reduce::design::Design;
use crate::reduce::semidefinite::{NotSemidefinite, ldl};

/// L and D of R = LDL', the m × m noise covariance of a step.
#[derive(Debug)]
pub(crate) struct Whitening {
    factor: Vec<f64>,
    m: usize,
}

impl Whitening {
    /// Factors R, given by its diagonal and its other entries (i, j, value).
    pub(crate) fn new(
        noises: &[f64],
        covariances: impl Iterator<Item = (usize, usize, f64)>,
    ) -> Result<Whitening, NotSemidefinite> {
        let m = noises.len();
        let mut factor = vec![0.0; m * m];
        noises.iter().enumerate().for_each(|(i, noise)| factor[i * m + i] = *noise);
        covariances.for_each(|(i, j, value)| factor[i.max(j) * m + i.min(j)] += value);
        ldl(&mut factor, m)?;
        Ok(Whitening { factor, m })
    }

    /// D_ii: noise variance of measurement i after whitening.
    pub(crate) fn noise(&self, i: usize) -> f64 {
        self.factor[i * self.m + i]
    }

    /// Nonzero entries of L below the diagonal: (i, k, entry), row by row.
    fn nonzero_entries(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        let row = move |i: usize| (0..i).map(move |k| (i, k, self.factor[i * self.m + k]));
        (0..self.m).flat_map(row).filter(|(.., entry)| *entry != 0.0)
    }

    /// A ← L⁻¹A, m × `columns`.
    pub(crate) fn apply(&self, a: &mut [f64], columns: usize) {
        for (i, k, entry) in self.nonzero_entries() {
            (0..columns).for_each(|c| a[i * columns + c] -= entry * a[k * columns + c]);
        }
    }

    /// A ← L'⁻¹A, m × `columns`.
    pub(super) fn back(&self, a: &mut [f64], columns: usize) {
        for k in (0..self.m).rev() {
            for i in 0..k {
                let entry = self.factor[k * self.m + i];
                if entry != 0.0 {
                    (0..columns).for_each(|c| a[i * columns + c] -= entry * a[k * columns + c]);
                }
            }
        }
    }

    /// A ← AL⁻¹, m × m.
    pub(super) fn back_right(&self, a: &mut [f64]) {
        for row in a.chunks_exact_mut(self.m) {
            for k in (0..self.m).rev() {
                let x = row[k];
                (0..k).for_each(|j| row[j] -= x * self.factor[k * self.m + j]);
            }
        }
    }
}

/// Whitens the scalar measurements from line `first` on, the last ones of the data. `covariances`: off-diagonal entries
/// (i, j, value) of R, with i and j counted from `first`.
pub(crate) fn whiten(
    design: &mut Design,
    data: &mut Data,
    first: usize,
    covariances: &[(usize, usize, f64)],
) -> Result<(), NotSemidefinite> {
    let (m, n) = (design.ends.len() - first, design.frame.n);
    let row = data.values.len() - m;
    let whitening = Whitening::new(&design.noise[first..], covariances.iter().copied())?;
    // dense rows for now: a whitened row has the states of several measurements
    let (mut h, mut present) = (vec![0.0; m * n], vec![false; m * n]);
    for i in 0..m {
        let (states, coefficients) = design.terms(first + i);
        for (&state, &coefficient) in states.iter().zip(coefficients) {
            h[i * n + state as usize] = coefficient;
            present[i * n + state as usize] = true;
        }
    }
    whitening.apply(&mut h, n);
    whitening.apply(&mut data.values[row..], 1);
    for (i, k, entry) in whitening.nonzero_entries() {
        (0..n).for_each(|state| present[i * n + state] |= present[k * n + state]);
        data.sizes[row + i] += entry.abs() * data.sizes[row + k];
    }
    let start = if first == 0 { 0 } else { design.ends[first - 1] };
    design.states.truncate(start);
    design.h.truncate(start);
    design.ends.truncate(first);
    for i in 0..m {
        for state in (0..n).filter(|state| present[i * n + state]) {
            design.states.push(state as u32);
            design.h.push(h[i * n + state]);
        }
        design.ends.push(design.states.len());
        design.noise[first + i] = whitening.noise(i);
    }
    Ok(())
}
