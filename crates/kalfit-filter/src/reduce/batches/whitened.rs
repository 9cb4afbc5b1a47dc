//! Correlated measurements of tests in lanes, whitened step by step.

use crate::reduce::batches::layout::BatchLayout;
use crate::reduce::batches::values::BatchValues;
use crate::reduce::lanes::BatchColumns;
use crate::reduce::observe::Whitening;
use crate::reduce::prepare::Preparer;
use kalfit_model::Test;

impl BatchValues {
    /// Whitens, step by step, the measurements whose noises are correlated.
    pub(super) fn whiten(&mut self, layout: &BatchLayout, (preparer, tests): (&Preparer, &[&Test])) {
        for (lane, &number) in layout.tests.iter().enumerate() {
            for stretch in layout.design.stretches() {
                let rows: Vec<usize> = layout.rows_of(lane, stretch.lines).collect();
                if rows.len() > 1 && self.whiten_step((layout, lane, &rows), preparer, tests[number]).is_none() {
                    self.valid[lane] = false;
                }
            }
        }
    }

    /// Whitens these lines of one step of the test in a lane; `None` if the noises have no valid covariance matrix.
    fn whiten_step(
        &mut self,
        (layout, lane, rows): (&BatchLayout, usize, &[usize]),
        preparer: &Preparer,
        test: &Test,
    ) -> Option<()> {
        let (instances, dt) = layout.instances_of(lane, rows);
        let correlated_pairs = preparer.meters.covariances(&preparer.at(), test, dt, &instances).ok()?;
        if correlated_pairs.is_empty() {
            return Some(());
        }
        let place = |row: usize| row * layout.lanes + lane;
        let (n, (mut dense, mut measured)) = (layout.design.frame.n, self.measured_in(layout, lane, rows));
        let noises: Vec<f64> = rows.iter().map(|&row| self.batch_filter.design_batch.noise[place(row)]).collect();
        let whitening = Whitening::new(&noises, correlated_pairs.iter().map(|c| (c.i, c.j, c.value))).ok()?;
        whitening.apply(&mut dense, n);
        whitening.apply(&mut measured, 1);
        let BatchColumns { h, noise, values, .. } = self.batch_filter.columns();
        for (i, &row) in rows.iter().enumerate() {
            (noise[place(row)], values[place(row)]) = (whitening.noise(i), measured[i]);
            for (term, &state) in layout.terms(row).zip(layout.design.terms(row).0) {
                h[place(term)] = dense[i * n + state as usize];
            }
        }
        Some(())
    }

    /// (M, z - d) of the lines `rows` of the test in a lane; M is lines × n, row-major.
    pub(crate) fn measured_in(&self, layout: &BatchLayout, lane: usize, rows: &[usize]) -> (Vec<f64>, Vec<f64>) {
        let (n, place) = (layout.design.frame.n, |row: usize| row * layout.lanes + lane);
        let (mut dense, coefficients) = (vec![0.0; rows.len() * n], &self.batch_filter.design_batch.h);
        for (&row, dense_row) in rows.iter().zip(dense.chunks_exact_mut(n)) {
            for (term, &state) in layout.terms(row).zip(layout.design.terms(row).0) {
                dense_row[state as usize] = coefficients[place(term)];
            }
        }
        (dense, rows.iter().map(|&row| self.batch_filter.block.measured()[place(row)]).collect())
    }
}
