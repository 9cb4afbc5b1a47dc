//! Reductions of tests that are given in matrices.

use std::sync::Arc;

use nalgebra::DMatrix;

use crate::reduce::data::Data;
use crate::reduce::design::Design;
use crate::reduce::design_pass::information_gains;
use crate::reduce::error::{ReduceError, ReduceErrorKind, check_shape, finite, refuse};
use crate::reduce::gains::Gains;
use crate::reduce::lanes::DataWorkspace;
use crate::reduce::observe::whiten;
use crate::reduce::order::Order;
use crate::reduce::outcome::outcome;
use crate::reduce::plain::Plain;
use crate::reduce::reducer::impossible;
use crate::reduce::root::{RootError, root_gains};
use crate::reduce::schedule::GainsWork;
use crate::reduce::semidefinite::ldl;
use crate::reduce::subject::WHOLE;
use crate::reduce::terminal::Terminal;
use kalfit_model::Path;
use kalfit_model::Reduction;

impl Plain {
    /// The reduction of the test.
    pub fn reduce(&self) -> Result<Reduction, ReduceError> {
        Ok(self.solve(false, false)?.0)
    }

    /// The reduction of the test by square-root arrays, even where plain covariances are accurate enough.
    pub fn reduce_square_root(&self) -> Result<Reduction, ReduceError> {
        Ok(self.solve(true, false)?.0)
    }

    /// (reduction of the test, state after the last step).
    pub fn reduce_with_terminal(&self) -> Result<(Reduction, Terminal), ReduceError> {
        let (reduction, terminal) = self.solve(false, true)?;
        Ok((reduction, terminal.expect("it was wanted")))
    }

    /// The reduction of the test and, if `ends`, the state after the last step. `square_root`: square-root arrays are
    /// used even where plain covariances are accurate enough.
    fn solve(&self, square_root: bool, ends: bool) -> Result<(Reduction, Option<Terminal>), ReduceError> {
        self.check()?;
        let order = Order::of_matrices(self);
        let (mut design, mut data, mut rows) = (Design::new(order.frame.clone()), Data::default(), Vec::new());
        self.fill(&order, &mut design, &mut data, &mut rows)?;
        let states = ends.then_some(&*order.states);
        let information =
            if square_root { None } else { information_gains(&design, states, &mut GainsWork::default()) };
        let gains = match information {
            Some(gains) => gains,
            None => self.root(&design, states)?,
        };
        let mut pass = DataWorkspace::default();
        let outcome = outcome(&design, &gains, &data, &mut pass)
            .map_err(|miss| self.refuse(&format!("step {}", rows[miss.row] + 1), impossible(miss)))?;
        if !outcome.is_finite() {
            return Err(self.refuse(WHOLE, ReduceErrorKind::NotFinite));
        }
        let terminal = gains.terminal(&order.states, &pass.x);
        let Gains { factor, active, rotations, .. } = gains;
        let reduction = Reduction {
            test: self.id.clone(),
            constant: outcome.constant,
            residual: Some(outcome.residual),
            data: outcome.data,
            factor,
            covariates: Vec::new(),
            steps: self.steps.len(),
            observations: active,
            path: if rotations.is_some() { Path::SquareRoot } else { Path::Information },
            design: design.digest(),
            chain: None,
            exact: outcome.exact,
        };
        Ok((reduction, terminal))
    }

    /// The gains of the design, computed in square-root arrays.
    fn root(&self, design: &Design, states: Option<&[usize]>) -> Result<Gains, ReduceError> {
        root_gains(design, states, false).map_err(|error| match error {
            RootError::NotSemidefinite(bad) => self.refuse("process noise", bad),
            RootError::NotFinite => self.refuse(WHOLE, ReduceErrorKind::NotFinite),
        })
    }

    fn fill(
        &self,
        order: &Order,
        design: &mut Design,
        data: &mut Data,
        rows: &mut Vec<usize>,
    ) -> Result<(), ReduceError> {
        let r = order.frame.r;
        data.start.extend(order.states.iter().map(|&state| self.offset[state]));
        for i in 0..r {
            for j in 0..=i {
                design.variance[i * r + j] = self.covariance[(order.states[i], order.states[j])];
            }
        }
        for (k, step) in self.steps.iter().enumerate() {
            let transition = order.transition(step);
            if transition.is_some() {
                let input = |&state: &u32| step.input.as_ref().map_or(0.0, |input| input[order.states[state as usize]]);
                data.inputs.extend(order.frame.driven.iter().map(input));
            }
            let first = design.ends.len();
            let kept: Vec<usize> = (0..step.values.len())
                .filter(|&i| !step.values[i].is_nan() && step.noise[(i, i)] != f64::INFINITY)
                .collect();
            for &i in &kept {
                for (state, &from) in order.states.iter().enumerate() {
                    if step.measurement[(i, from)] != 0.0 {
                        design.states.push(state as u32);
                        design.h.push(step.measurement[(i, from)]);
                    }
                }
                design.ends.push(design.states.len());
                design.noise.push(step.noise[(i, i)]);
                data.take(step.values[i], step.constant[i]);
                rows.push(k);
            }
            let covariances: Vec<(usize, usize, f64)> = (0..kept.len())
                .flat_map(|a| (0..a).map(move |b| (a, b)))
                .map(|(a, b)| (a, b, step.noise[(kept[a], kept[b])]))
                .filter(|entry| entry.2 != 0.0)
                .collect();
            if !covariances.is_empty() {
                whiten(design, data, first, &covariances)
                    .map_err(|bad| self.refuse(&format!("noise of step {}", k + 1), bad))?;
            }
            // steps are not joined into stretches, so nothing is frozen here
            design.push_step(transition.map(Arc::new).as_ref());
        }
        Ok(())
    }

    fn refuse(&self, what: &str, kind: impl Into<ReduceErrorKind>) -> ReduceError {
        refuse(Some(&self.id), what, kind)
    }

    /// Checks that shapes agree, numbers are finite, and covariances are symmetric and positive semidefinite.
    fn check(&self) -> Result<(), ReduceError> {
        let (n, p) = (self.offset.len(), self.sensitivity.ncols());
        self.shaped("offset a", &self.offset, (n, 1))?;
        self.shaped("sensitivity A", &self.sensitivity, (n, p))?;
        self.shaped("covariance P0", &self.covariance, (n, n))?;
        self.semidefinite("covariance P0", &self.covariance)?;
        for (k, step) in self.steps.iter().enumerate() {
            let m = step.values.len();
            let name = |what: &str| format!("{what} of step {}", k + 1);
            if let Some(phi) = &step.transition {
                self.shaped(&name("transition"), phi, (n, n))?;
            }
            if let Some(input) = &step.input {
                self.shaped(&name("input"), input, (n, 1))?;
            }
            if let Some(noise) = &step.process_noise {
                self.shaped(&name("process noise"), noise, (n, n))?;
                self.semidefinite(&name("process noise"), noise)?;
            }
            self.shaped(&name("measurement"), &step.measurement, (m, n))?;
            self.shaped(&name("constant"), &step.constant, (m, 1))?;
            let finite = step.noise.map(|x| if x == f64::INFINITY { 0.0 } else { x });
            let off_diagonal = (0..finite.len()).any(|place| {
                let (i, j) = (place / m.max(1), place % m.max(1));
                step.noise.shape() == (m, m) && i != j && step.noise[(i, j)].is_infinite()
            });
            if off_diagonal {
                return Err(self.refuse(&name("noise"), ReduceErrorKind::NotFinite));
            }
            self.shaped(&name("noise"), &finite, (m, m))?;
            self.symmetric(&name("noise"), &finite)?;
            let values = step.values.map(|x| if x.is_nan() { 0.0 } else { x });
            self.shaped(&name("values"), &values, (m, 1))?;
            if let Some(value) = finite.diagonal().iter().find(|value| **value < 0.0) {
                return Err(self.refuse(&name("noise"), ReduceErrorKind::NegativeVariance { value: *value }));
            }
        }
        Ok(())
    }

    fn shaped<C: nalgebra::Dim>(
        &self,
        what: &str,
        matrix: &nalgebra::Matrix<f64, nalgebra::Dyn, C, nalgebra::VecStorage<f64, nalgebra::Dyn, C>>,
        expected: (usize, usize),
    ) -> Result<(), ReduceError> {
        let found = check_shape(matrix.shape(), expected).and_then(|()| finite(matrix.as_slice()));
        found.map_err(|kind| self.refuse(what, kind))
    }

    fn symmetric(&self, what: &str, matrix: &DMatrix<f64>) -> Result<(), ReduceError> {
        for i in 0..matrix.nrows() {
            for j in 0..i {
                let (lower, upper) = (matrix[(i, j)], matrix[(j, i)]);
                let size = (matrix[(i, i)] * matrix[(j, j)]).abs().sqrt().max(lower.abs()).max(upper.abs());
                if (lower - upper).abs() > 1e-12 * size {
                    return Err(self.refuse(what, ReduceErrorKind::NotSymmetric { upper, lower }));
                }
            }
        }
        Ok(())
    }

    fn semidefinite(&self, what: &str, matrix: &DMatrix<f64>) -> Result<(), ReduceError> {
        self.symmetric(what, matrix)?;
        let mut factor_in_place: Vec<f64> = matrix.transpose().as_slice().to_vec(); // row-major
        ldl(&mut factor_in_place, matrix.nrows()).map_err(|bad| self.refuse(what, bad))
    }
}
