//! The kernel order of a test given in matrices.

use std::sync::Arc;

use nalgebra::DMatrix;

use crate::reduce::design::{Pattern, Transition};
use crate::reduce::order::{Order, StateTraits};
use crate::reduce::plain::{Plain, StepMatrices};

impl Order {
    /// The order of the states of a test given in matrices.
    pub(super) fn of_matrices(test: &Plain) -> Order {
        let (n, p) = (test.offset.len(), test.sensitivity.ncols());
        let noises = || test.steps.iter().filter_map(|step| step.process_noise.as_ref()).chain([&test.covariance]);
        let mut noisy: Vec<bool> = (0..n).map(|i| noises().any(|q| q[(i, i)] != 0.0)).collect();
        let (mut moving, mut driven) = (vec![false; n], vec![false; n]);
        let mut depends = DMatrix::from_element(n, n, false);
        for step in &test.steps {
            for i in 0..n {
                if let Some(phi) = &step.transition {
                    (0..n).filter(|&j| phi[(i, j)] != 0.0).for_each(|j| depends[(i, j)] = true);
                    moving[i] |= !is_identity_row(phi, i);
                }
                driven[i] |= step.input.as_ref().is_some_and(|input| input[i] != 0.0);
            }
        }
        for _ in 0..n {
            for i in 0..n {
                noisy[i] |= (0..n).any(|j| depends[(i, j)] && noisy[j]);
            }
        }
        // the transpose of A stored by columns is A stored by rows
        Order::of(&StateTraits { noisy, moving, driven }, test.sensitivity.transpose().as_slice(), p)
    }

    /// φ and Q of a step in kernel order; `None` where no state moves.
    pub(super) fn transition(&self, step: &StepMatrices) -> Option<Transition> {
        if step.transition.is_none() && step.process_noise.is_none() && step.input.is_none() {
            return None;
        }
        let (mut pattern, mut phi, mut q) = (Pattern::default(), Vec::new(), Vec::new());
        if let Some(matrix) = &step.transition {
            for (place, &i) in self.states.iter().enumerate().filter(|&(_, &i)| !is_identity_row(matrix, i)) {
                let columns: Vec<usize> = (0..self.frame.n).filter(|&c| matrix[(i, self.states[c])] != 0.0).collect();
                phi.extend(columns.iter().map(|&c| matrix[(i, self.states[c])]));
                pattern.push(place, self.frame.r, columns.into_iter());
            }
        }
        if let Some(noise) = &step.process_noise {
            for i in 0..self.frame.r {
                for j in (0..=i).filter(|&j| noise[(self.states[i], self.states[j])] != 0.0) {
                    pattern.pairs.push((i as u32, j as u32));
                    q.push(noise[(self.states[i], self.states[j])]);
                }
            }
        }
        Some(Transition::new(Arc::new(pattern.seal()), phi, q))
    }
}

fn is_identity_row(phi: &DMatrix<f64>, i: usize) -> bool {
    (0..phi.ncols()).all(|j| phi[(i, j)] == f64::from(i == j))
}
