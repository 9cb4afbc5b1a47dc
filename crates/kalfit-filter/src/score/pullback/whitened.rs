//! Correlated measurements of tests in lanes: from the adjoints after whitening to the adjoints before whitening.

use crate::reduce::{Fault, FilteredBatch, Instance, Unwhitened};
use crate::score::backward::BatchAdjoints;
use crate::score::pullback::Pullback;
use kalfit_model::Test;

/// ∂ℓ/∂covariance of two measurements of a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct PairBar {
    pub(super) lane: usize,
    pub(super) tap: usize,
    /// Row of the test on which the covariance was evaluated (`row`), and length of the step of this row (`dt`).
    pub(super) row: usize,
    pub(super) dt: f64,
    pub(super) bar: f64,
}

impl Pullback<'_> {
    /// Replaces the adjoints of the measurements of a block after whitening by the adjoints before whitening; returns
    /// the adjoints of the noise covariances that depend on free values.
    pub(super) fn unwhiten(&self, block: FilteredBatch<'_>, tests: &[&Test], bars: &mut BatchAdjoints) -> Vec<PairBar> {
        let (mut pairs, mut unwhitened) = (Vec::new(), Unwhitened::default());
        for (lane, number) in block.tests() {
            for stretch in block.layout.design.stretches() {
                let rows: Vec<usize> = block.layout.rows_of(lane, stretch.lines).collect();
                if rows.len() > 1 {
                    let step = (block, lane, &*rows);
                    let found = self.unwhiten_step(step, tests[number], (&mut *bars, &mut unwhitened), &mut pairs);
                    found.expect("it was sound on the way forward");
                }
            }
        }
        pairs
    }

    fn unwhiten_step(
        &self,
        (block, lane, rows): (FilteredBatch<'_>, usize, &[usize]),
        test: &Test,
        (bars, unwhitened): (&mut BatchAdjoints, &mut Unwhitened),
        pairs: &mut Vec<PairBar>,
    ) -> Result<(), Box<Fault>> {
        let (meters, at, m) = (&self.preparer.meters, self.preparer.at(), rows.len());
        let (instances, dt): (Vec<Instance>, f64) = block.layout.instances_of(lane, rows);
        let found = meters.covariances(&at, test, dt, &instances)?;
        if found.is_empty() {
            return Ok(());
        }
        let mut noises = Vec::new();
        meters.noises(&at, test, (&instances, dt), &mut noises)?;
        let (n, lanes) = (block.layout.design.frame.n, block.layout.lanes);
        let whitened = block.values.measured_in(block.layout, lane, rows);
        let (all, width) = bars.rows_mut();
        let place = |row: usize, k: usize| (row * width + k) * lanes + lane;
        let column = |k: usize| rows.iter().map(|&row| all[place(row, k)]).collect::<Vec<f64>>();
        let h: Vec<f64> =
            rows.iter().flat_map(|&row| (2..width).map(move |k| (row, k))).map(|(row, k)| all[place(row, k)]).collect();
        unwhitened.set((&whitened.0, &whitened.1, n), (&noises, &found), (&column(0), &column(1), &h));
        for (i, &row) in rows.iter().enumerate() {
            all[place(row, 0)] = unwhitened.noise[i * m + i];
            all[place(row, 1)] = unwhitened.value[i];
            (2..width).for_each(|k| all[place(row, k)] = unwhitened.h[i * n + k - 2]);
        }
        for c in &found {
            if let Some(tap) = self.pairs[c.pair] {
                let bar = unwhitened.noise[c.i * m + c.j] + unwhitened.noise[c.j * m + c.i];
                pairs.push(PairBar { lane, tap, row: c.row, dt, bar });
            }
        }
        Ok(())
    }
}
