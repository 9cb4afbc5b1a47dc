//! Adjoints of the transitions of a test.

use std::sync::Arc;

use crate::reduce::{Evaluated, Fault, Transition, Workspace};
use crate::score::backward::TransitionAdjoint;
use crate::score::pullback::adjoints::{Adjoints, TransitionSums};
use kalfit_model::Scope;
use kalfit_model::Test;

impl Adjoints<'_> {
    /// Takes the adjoints of the transition to step `k` of a test, after
    /// [`Preparer::prepare`](crate::reduce::Preparer::prepare) into `work`. Adjoints that no free value needs are not
    /// read, and may be empty.
    pub(crate) fn step_moved(
        &mut self,
        test: &Test,
        k: usize,
        work: &Workspace,
        bars: &TransitionAdjoint,
    ) -> Result<(), Box<Fault>> {
        let needs = self.pullback.needs;
        if !(needs.rates || needs.noise || needs.inputs) {
            return Ok(());
        }
        let Some(transition) = work.design.step(k).transition else { return Ok(()) };
        let group = match self.last_group(transition, test, k, work)? {
            Some(group) => group,
            None => self.find_or_add_group(transition, test, k, work)?,
        };
        let (phi, q) = self.moving.entries;
        let sums = self.moving.groups.sums(group);
        if needs.rates {
            add(&mut sums[..phi], &bars.phi);
        }
        if needs.noise {
            add(&mut sums[phi..phi + q], &bars.q);
        }
        if bars.input.is_empty() { Ok(()) } else { self.add_input_adjoints(test, k, work, group, &bars.input) }
    }

    /// The group that was used last, if step `k` belongs to this group; otherwise `None`.
    #[inline]
    fn last_group(
        &mut self,
        transition: &Arc<Transition>,
        test: &Test,
        k: usize,
        work: &Workspace,
    ) -> Result<Option<usize>, Box<Fault>> {
        let Adjoints { pullback, moving, .. } = self;
        if pullback.reads.is_empty() {
            return Ok(moving.groups.last_group(transition, &[], None));
        }
        let scope = pullback.preparer.moving(test, k, work, &mut moving.cells)?;
        Ok(moving.groups.last_group(transition, &pullback.reads, Some(&scope)))
    }

    /// Bits of the cells that coefficients with free values read for the transition to step `k`.
    pub(super) fn cells(&mut self, test: &Test, k: usize, work: &Workspace) -> Result<Vec<u64>, Box<Fault>> {
        let Adjoints { pullback, moving, .. } = self;
        if pullback.reads.is_empty() {
            return Ok(Vec::new());
        }
        let scope = pullback.preparer.moving(test, k, work, &mut moving.cells)?;
        Ok(pullback.reads.iter().map(|read| read.bits(&scope)).collect())
    }

    /// The group of step `k`, which is added if there is none.
    fn find_or_add_group(
        &mut self,
        transition: &Arc<Transition>,
        test: &Test,
        k: usize,
        work: &Workspace,
    ) -> Result<usize, Box<Fault>> {
        if self.moving.groups.is_full() {
            self.flush_groups(test, work)?;
        }
        let Adjoints { pullback, moving, replay, .. } = self;
        let preparer = pullback.preparer;
        let scope = preparer.moving(test, k, work, &mut moving.cells)?;
        preparer.values(&scope, replay)?;
        let dt = if preparer.dynamics.components.is_empty() { 0.0 } else { scope.step };
        let varying = preparer.dynamics.table.varying.iter().map(|(slot, ..)| replay.values[*slot]);
        let made = std::iter::once(dt).chain(varying);
        let (group, new) = moving.groups.find_or_add((transition, k), (&pullback.reads, &scope), made);
        if new && pullback.needs.inputs {
            preparer.plan.flows(&preparer.dynamics, &replay.values, scope.step, &mut moving.flows)?;
            moving.groups.flows(group).copy_from_slice(&moving.flows);
        }
        Ok(group)
    }

    /// Takes the adjoints of b = Γu of one step.
    fn add_input_adjoints(
        &mut self,
        test: &Test,
        k: usize,
        work: &Workspace,
        group: usize,
        bars: &[f64],
    ) -> Result<(), Box<Fault>> {
        let Adjoints { pullback, moving, pending, replay, .. } = self;
        let (preparer, context) = (pullback.preparer, pullback.context());
        let TransitionSums { groups, entries: (phi, q), cells, .. } = moving;
        let inputs = &preparer.dynamics.inputs;
        let scope = if inputs.varying.is_empty() {
            Scope { numbers: &[], texts: &[], step: work.dt(k), alpha: context.at.alpha }
        } else {
            preparer.moving(test, k, work, cells)?
        };
        if pullback.needs.rates {
            let values = if inputs.varying.is_empty() {
                &inputs.fixed
            } else {
                preparer.inputs(&scope, replay)?;
                &replay.inputs
            };
            preparer.plan.drive_flows(bars, values, &mut groups.sums(group)[*phi + *q..]);
        }
        if pullback.needs.inputs {
            preparer.plan.drive_inputs(bars, groups.flows(group), |slot, bar| match pullback.inputs[slot] {
                Some(tap) => pending.add(&context, tap, bar, &scope),
                None => Ok(()),
            })?;
        }
        Ok(())
    }

    /// Passes the sums of the groups on to the coefficients, and clears the groups.
    pub(super) fn flush_groups(&mut self, test: &Test, work: &Workspace) -> Result<(), Box<Fault>> {
        let Adjoints { pullback, moving, pending, replay, .. } = self;
        let (preparer, context) = (pullback.preparer, pullback.context());
        let TransitionSums { groups, entries: (phi, q), cells, sums, bars, flows, .. } = moving;
        for group in 0..groups.steps.len() {
            let k = groups.steps[group];
            let scope = preparer.moving(test, k, work, cells)?;
            preparer.values(&scope, replay)?;
            if pullback.needs.inputs {
                flows.clear();
                flows.extend_from_slice(groups.flows(group));
            } else if preparer.plan.holds() {
                preparer.plan.flows(&preparer.dynamics, &replay.values, scope.step, flows)?;
            }
            sums.clear();
            sums.extend_from_slice(groups.sums(group));
            bars.clear();
            bars.resize(replay.values.len(), 0.0);
            let (phi_bar, rest) = sums.split_at_mut(*phi);
            let (q_bar, flow_bar) = rest.split_at_mut(*q);
            let step = Evaluated { values: &replay.values, dt: scope.step, flows };
            let adjoints = (&*phi_bar, &*q_bar, flow_bar);
            preparer.plan.backward(&preparer.dynamics, &step, adjoints, &pullback.free, bars)?;
            for (tap, &bar) in pullback.values.iter().zip(&*bars) {
                if let Some(tap) = *tap {
                    pending.add(&context, tap, bar, &scope)?;
                }
            }
        }
        groups.clear();
        Ok(())
    }
}

fn add(sums: &mut [f64], bars: &[f64]) {
    debug_assert_eq!(sums.len(), bars.len(), "one adjoint for each entry");
    sums.iter_mut().zip(bars).for_each(|(sum, bar)| *sum += bar);
}
