//! Adjoints of the measurements of a test.

use std::ops::Range;

use crate::reduce::{Fault, Workspace};
use crate::score::backward::MeasurementAdjoint;
use crate::score::pullback::adjoints::{Adjoints, UnwhiteningScratch};
use kalfit_model::Scope;
use kalfit_model::Test;

impl Adjoints<'_> {
    /// Takes the adjoints of the measurements of step `k` of a test, after
    /// [`Preparer::prepare`](crate::reduce::Preparer::prepare) into `work`. h̄ is not read, and may be empty, unless
    /// [`Pullback::needs_equation`](super::Pullback::needs_equation).
    pub(crate) fn step_measured(
        &mut self,
        test: &Test,
        k: usize,
        work: &Workspace,
        bars: &MeasurementAdjoint,
    ) -> Result<(), Box<Fault>> {
        if !self.pullback.needs.measurements {
            return Ok(());
        }
        let rows = work.design.step(k).rows;
        if rows.len() < 2
            || self.pullback.pairs.is_empty()
            || !self.unwhiten_if_correlated(test, k, rows.clone(), work, bars)?
        {
            return self.add_unwhitened(test, k, rows, work, bars);
        }
        let own = std::mem::take(&mut self.unwhitening.bars);
        let result = self.add_unwhitened(test, k, rows, work, &own);
        self.unwhitening.bars = own;
        result
    }

    /// Takes the adjoints of measurements as the model defines them, not whitened.
    fn add_unwhitened(
        &mut self,
        test: &Test,
        k: usize,
        rows: Range<usize>,
        work: &Workspace,
        bars: &MeasurementAdjoint,
    ) -> Result<(), Box<Fault>> {
        let Adjoints { pullback, pending, .. } = self;
        let (context, n, step) = (pullback.context(), work.design.frame.n, work.dt(k));
        for (i, instance) in rows.map(|row| work.instances.get(row)).enumerate() {
            let (meter, row) = (&pullback.meters[instance.meter], instance.row);
            let scope = Scope { numbers: test.numbers(row), texts: test.texts(row), step, alpha: context.at.alpha };
            if let Some(tap) = meter.noise {
                pending.add(&context, tap, bars.noise[i], &scope)?;
            }
            if let Some(tap) = meter.constant {
                pending.add(&context, tap, -bars.value[i], &scope)?;
            }
            for &(state, tap) in &meter.terms {
                pending.add(&context, tap, bars.h[i * n + state], &scope)?;
            }
        }
        Ok(())
    }

    /// Takes the adjoints back through the whitening of step `k`; returns false if no noises of the step are
    /// correlated.
    fn unwhiten_if_correlated(
        &mut self,
        test: &Test,
        k: usize,
        rows: Range<usize>,
        work: &Workspace,
        bars: &MeasurementAdjoint,
    ) -> Result<bool, Box<Fault>> {
        let Adjoints { pullback, pending, unwhitening: UnwhiteningScratch { raw, unwhitened, bars: own }, .. } = self;
        let (context, meters, dt, m) = (pullback.context(), &pullback.preparer.meters, work.dt(k), rows.len());
        let instances = &work.instances.of(rows.clone());
        let found = meters.covariances(&context.at, test, dt, instances)?;
        if found.is_empty() {
            return Ok(false);
        }
        meters.noises(&context.at, test, (instances, dt), raw)?;
        let whitened = (&*bars.noise, &*bars.value, &*bars.h);
        let (n, lines) = (work.design.frame.n, work.design.step(k).lines);
        let mut h = vec![0.0; m * n];
        for (line, own) in lines.zip(h.chunks_exact_mut(n)) {
            let (states, terms) = work.design.terms(line);
            states.iter().zip(terms).for_each(|(&state, x)| own[state as usize] = *x);
        }
        unwhitened.set((&h, &work.data.values[rows], n), (raw, &found), whitened);
        for c in &found {
            if let Some(tap) = pullback.pairs[c.pair] {
                let scope =
                    Scope { numbers: test.numbers(c.row), texts: test.texts(c.row), step: dt, alpha: context.at.alpha };
                pending.add(
                    &context,
                    tap,
                    unwhitened.noise[c.i * m + c.j] + unwhitened.noise[c.j * m + c.i],
                    &scope,
                )?;
            }
        }
        own.noise.clear();
        own.noise.extend((0..m).map(|i| unwhitened.noise[i * m + i]));
        std::mem::swap(&mut own.value, &mut unwhitened.value);
        std::mem::swap(&mut own.h, &mut unwhitened.h);
        Ok(true)
    }
}
