//! Adjoints of transitions whose coefficients are the same on every row: they depend on the length of the step alone, and go to the
//! coefficients as they come.

use crate::model::Scope;
use crate::reduce::{Evaluated, Fault, Workspace};
use crate::score::chain::adjoints::Adjoints;
use crate::score::chain::equal_steps::EqualSteps;
use crate::score::chain::moved::{Moved, add};

impl Adjoints<'_> {
    /// The transition to step `k`.
    pub(super) fn steady(&mut self, k: usize, work: &Workspace, bars: Moved<'_>) -> Result<(), Box<Fault>> {
        let preparer = self.chain.preparer;
        let dt = if preparer.dynamics.components.is_empty() { 0.0 } else { work.dt(k) };
        if self.moving.equal.length != Some(dt.to_bits()) {
            self.end_equal()?;
            self.begin_equal(dt)?;
        }
        let Adjoints { chain, moving, pending, .. } = self;
        let (needs, (phi, q)) = (chain.needs, moving.entries);
        let EqualSteps { sums, flows, .. } = &mut moving.equal;
        if needs.rates {
            add(&mut sums[..phi], bars.phi);
        }
        if needs.noise {
            add(&mut sums[phi..phi + q], bars.q);
        }
        if bars.input.is_empty() {
            return Ok(());
        }
        if needs.rates {
            preparer.plan.drive_flows(bars.input, &preparer.dynamics.inputs.fixed, &mut sums[phi + q..]);
        }
        if needs.inputs {
            let context = chain.context();
            let scope = Scope { numbers: &[], texts: &[], step: dt, alpha: context.at.alpha };
            preparer.plan.drive_inputs(bars.input, flows, |slot, bar| match chain.inputs[slot] {
                Some(tap) => pending.add(&context, tap, bar, &scope),
                None => Ok(()),
            })?;
        }
        Ok(())
    }

    fn begin_equal(&mut self, dt: f64) -> Result<(), Box<Fault>> {
        let Adjoints { chain, moving, .. } = self;
        let (preparer, equal) = (chain.preparer, &mut moving.equal);
        let (phi, q) = moving.entries;
        equal.length = Some(dt.to_bits());
        equal.sums.clear();
        equal.sums.resize(phi + q + preparer.plan.flow_len(&preparer.dynamics), 0.0);
        if chain.needs.inputs || preparer.plan.holds() {
            let values = &preparer.dynamics.table.fixed;
            preparer.plan.flows(&preparer.dynamics, values, dt, &mut equal.flows)?;
        }
        Ok(())
    }

    /// Sends what equal steps have summed on to the coefficients.
    fn end_equal(&mut self) -> Result<(), Box<Fault>> {
        let Adjoints { chain, moving, .. } = self;
        let (phi, q) = moving.entries;
        let Some(dt) = moving.equal.length.take().map(f64::from_bits) else { return Ok(()) };
        let (preparer, EqualSteps { sums, flows, .. }) = (chain.preparer, &mut moving.equal);
        let values = &preparer.dynamics.table.fixed;
        moving.bars.resize(values.len(), 0.0);
        let (phi_bar, rest) = sums.split_at_mut(phi);
        let (q_bar, flow_bar) = rest.split_at_mut(q);
        let step = Evaluated { values, dt, flows };
        preparer.plan.backward(&preparer.dynamics, &step, (phi_bar, q_bar, flow_bar), &chain.free, &mut moving.bars)
    }

    /// Sends what has come to the coefficients on to the free values.
    pub(super) fn settle_steady(&mut self) -> Result<(), Box<Fault>> {
        self.end_equal()?;
        let Adjoints { chain, moving, pending, .. } = self;
        let context = chain.context();
        let scope = Scope { numbers: &[], texts: &[], step: 0.0, alpha: context.at.alpha };
        for (tap, bar) in chain.values.iter().zip(&mut moving.bars) {
            let bar = std::mem::take(bar);
            if let Some(tap) = *tap {
                pending.add(&context, tap, bar, &scope)?;
            }
        }
        Ok(())
    }
}
