//! The kernel order of a test given in matrices.

use std::sync::Arc;

use nalgebra::DMatrix;

use crate::reduce::design::{DENSE, Pattern, StateFrame, Transition, ZERO};
use crate::reduce::plain::{Plain, StepMatrices};

/// Kernel order of a test's states.
pub(crate) struct PlainOrder {
    /// State of the test at each place of the kernels.
    pub(crate) states: Vec<usize>,
    pub(crate) frame: Arc<StateFrame>,
}

impl PlainOrder {
    pub(crate) fn new(test: &Plain) -> PlainOrder {
        let (n, p) = (test.offset.len(), test.sensitivity.ncols());
        let noises = || test.steps.iter().filter_map(|step| step.process_noise.as_ref()).chain([&test.covariance]);
        let mut noisy: Vec<bool> = (0..n).map(|i| noises().any(|q| q[(i, i)] != 0.0)).collect();
        let mut moving = vec![false; n];
        let mut driven = vec![false; n];
        let mut depends = DMatrix::from_element(n, n, false);
        for step in &test.steps {
            for i in 0..n {
                if let Some(phi) = &step.transition {
                    (0..n).filter(|&j| phi[(i, j)] != 0.0).for_each(|j| depends[(i, j)] = true);
                    moving[i] |= !identity_row(phi, i);
                }
                driven[i] |= step.input.as_ref().is_some_and(|input| input[i] != 0.0);
            }
        }
        for _ in 0..n {
            for i in 0..n {
                noisy[i] |= (0..n).any(|j| depends[(i, j)] && noisy[j]);
            }
        }
        let mut states: Vec<usize> = (0..n).collect();
        states.sort_by_key(|&i| (!noisy[i], !moving[i], i));
        let row = |&state: &usize| {
            let row: Vec<f64> = test.sensitivity.row(state).iter().copied().collect();
            let unit = row.iter().position(|&x| x != 0.0);
            match unit {
                _ if noisy[state] || moving[state] => DENSE,
                None => ZERO,
                Some(c) if row[c] == 1.0 && row[c + 1..].iter().all(|&x| x == 0.0) => c as u32,
                Some(_) => DENSE,
            }
        };
        let frame = StateFrame {
            n,
            p,
            r: noisy.iter().filter(|&&noisy| noisy).count(),
            rows: states.iter().map(row).collect(),
            sensitivity: states.iter().flat_map(|&state| (0..p).map(move |c| test.sensitivity[(state, c)])).collect(),
            driven: (0..n).filter(|&place| driven[states[place]]).map(|place| place as u32).collect(),
            digest: 0,
        };
        PlainOrder { states, frame: Arc::new(frame.seal()) }
    }

    pub(crate) fn transition(&self, step: &StepMatrices) -> Option<Transition> {
        if step.transition.is_none() && step.process_noise.is_none() && step.input.is_none() {
            return None;
        }
        let (mut pattern, mut phi, mut q) = (Pattern::default(), Vec::new(), Vec::new());
        if let Some(matrix) = &step.transition {
            for (place, &i) in self.states.iter().enumerate().filter(|&(_, &i)| !identity_row(matrix, i)) {
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

fn identity_row(phi: &DMatrix<f64>, i: usize) -> bool {
    (0..phi.ncols()).all(|j| phi[(i, j)] == f64::from(i == j))
}
