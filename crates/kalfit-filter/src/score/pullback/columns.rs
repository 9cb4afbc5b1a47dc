//! The chain rule of tests in lanes: the adjoints of the tests are summed column by column.

use kalfit_lanes::{Kernel, Lanes};

use crate::reduce::{Fault, FilteredBatch, MotionPullback, Workspace};
use crate::score::backward::BatchAdjoints;
use crate::score::pullback::adjoints::Adjoints;
use crate::score::pullback::taps::Gradient;
use crate::score::pullback::whitened::PairBar;
use crate::score::pullback::{MeterTaps, Pullback};
use kalfit_model::Scope;
use kalfit_model::Test;

/// The adjoints of coefficients, in lanes.
#[derive(Debug)]
pub(crate) struct Pulled {
    /// Adjoint of each tap, summed over a test; taps × lanes, by rows.
    sums: Vec<f64>,
    /// (slot, adjoint at each transition, in lanes) of the coefficients of the motion (`values`), and of the known
    /// inputs of the motion (`inputs`), whose taps read cells.
    values: Vec<(usize, Vec<f64>)>,
    inputs: Vec<(usize, Vec<f64>)>,
    /// Adjoints of the noise covariances that depend on free values.
    pairs: Vec<PairBar>,
}

struct Pull<'a> {
    pullback: &'a Pullback<'a>,
    block: FilteredBatch<'a>,
    back: MotionPullback<'a>,
    bars: &'a BatchAdjoints,
}

impl Pullback<'_> {
    /// The adjoints of the coefficients that depend on free values, from the adjoints `bars` of a block. The adjoints
    /// of the measurements in `bars` are replaced by the adjoints before whitening.
    pub(crate) fn pull(&self, block: FilteredBatch<'_>, tests: &[&Test], bars: &mut BatchAdjoints) -> Pulled {
        let pairs = if self.pairs.is_empty() { Vec::new() } else { self.unwhiten(block, tests, bars) };
        let steps = (&block.layout.transitions, &block.values.motion);
        let back = self.preparer.plan.back(&self.preparer.dynamics, steps, &self.free);
        let pulled = block.values.batch_filter.block.width().run(Pull { pullback: self, block, back, bars });
        Pulled { pairs, ..pulled }
    }

    /// (slot, tap) of each of the coefficients or known inputs of the motion whose tap reads cells.
    fn columns<'s>(&'s self, taps: &'s [Option<usize>]) -> impl Iterator<Item = (usize, usize)> + 's {
        taps.iter().enumerate().filter_map(|(slot, tap)| Some((slot, (*tap)?))).filter(|&(_, tap)| self.reads(tap))
    }

    fn reads(&self, tap: usize) -> bool {
        !self.taps.reads(tap).is_empty()
    }
}

impl Kernel for Pull<'_> {
    type Output = Pulled;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Pulled {
        let Pull { pullback, block, .. } = &self;
        let mut sums = vec![T::splat(0.0); pullback.taps.len()];
        self.measured(&mut sums);
        let zero_columns = |taps: &[Option<usize>]| -> Vec<(usize, Vec<f64>)> {
            pullback.columns(taps).map(|(slot, _)| (slot, vec![0.0; block.layout.transitions.dt.len()])).collect()
        };
        let (mut values, mut inputs) = (zero_columns(&pullback.values), zero_columns(&pullback.inputs));
        let (transition_adjoints, width) = self.bars.transition_adjoints();
        let mut bars = self.back.zero::<T>();
        for (t, own) in transition_adjoints.chunks_exact((width * T::COUNT).max(1)).enumerate() {
            self.back.pull(t, own, &mut bars);
            for (slot, column) in &mut values {
                let bar = std::mem::replace(&mut bars.values[*slot], T::splat(0.0));
                bar.store(&mut column[t * T::COUNT..]);
            }
            for (slot, column) in &mut inputs {
                let bar = std::mem::replace(&mut bars.inputs[*slot], T::splat(0.0));
                bar.store(&mut column[t * T::COUNT..]);
            }
        }
        self.back.finish(&mut bars);
        for (taps, bars) in [(&pullback.values, &bars.values), (&pullback.inputs, &bars.inputs)] {
            for (tap, &bar) in taps.iter().zip(bars) {
                if let Some(tap) = *tap {
                    sums[tap] = sums[tap] + bar;
                }
            }
        }
        let mut all = vec![0.0; sums.len() * T::COUNT];
        for (sum, out) in sums.iter().zip(all.chunks_exact_mut(T::COUNT)) {
            sum.store(out);
        }
        Pulled { sums: all, values, inputs, pairs: Vec::new() }
    }
}

impl Pull<'_> {
    /// Adds the adjoints of the measurements to the sums of the taps of R, d and h.
    #[inline(always)]
    fn measured<T: Lanes>(&self, sums: &mut [T]) {
        let (layout, (rows, width)) = (self.block.layout, self.bars.rows());
        for (row, &meter) in layout.meters.iter().enumerate() {
            let MeterTaps { noise, constant, terms } = &self.pullback.meters[meter];
            let is_measured = T::load(&layout.measured[row * T::COUNT..]);
            let bars = &rows[row * width * T::COUNT..][..width * T::COUNT];
            if let Some(tap) = *noise {
                sums[tap] = is_measured.fma(T::load(bars), sums[tap]);
            }
            if let Some(tap) = *constant {
                sums[tap] = is_measured.fnma(T::load(&bars[T::COUNT..]), sums[tap]);
            }
            for &(state, tap) in terms {
                sums[tap] = is_measured.fma(T::load(&bars[(2 + state) * T::COUNT..]), sums[tap]);
            }
        }
    }
}

impl Adjoints<'_> {
    /// dℓ/dα of the test in a lane of a block, from the sums of [`Pullback::pull`]. `work`: scratch.
    pub(crate) fn of_lane(
        &mut self,
        (block, bars, pulled): (FilteredBatch<'_>, &BatchAdjoints, &Pulled),
        lane: usize,
        tests: &[&Test],
        work: &Workspace,
    ) -> Result<Gradient, Box<Fault>> {
        let test = tests[block.layout.tests[lane]];
        let found = self.gather((block, bars, pulled), lane, tests).and_then(|()| {
            let pullback = self.pullback;
            let ([mean, variance], alpha) = (bars.start(lane), pullback.context().at.alpha);
            let no_cells = Scope { numbers: &[], texts: &[], step: 0.0, alpha };
            match block.layout.start_cells.get(lane) {
                None => self.started_at((&no_cells, &no_cells), &mean, &variance),
                Some(own) => self.started_at((&own.first(test, alpha), &own.whole(alpha)), &mean, &variance),
            }
        });
        // also after an error, to clear the accumulator
        let gradient = self.finish(test, work);
        found.and(gradient)
    }

    fn gather(
        &mut self,
        (block, bars, pulled): (FilteredBatch<'_>, &BatchAdjoints, &Pulled),
        lane: usize,
        tests: &[&Test],
    ) -> Result<(), Box<Fault>> {
        let (pullback, lanes, layout) = (self.pullback, block.layout.lanes, block.layout);
        let context = pullback.context();
        let no_cells = Scope { numbers: &[], texts: &[], step: 0.0, alpha: context.at.alpha };
        for tap in (0..pullback.taps.len()).filter(|&tap| !pullback.reads(tap)) {
            self.pending.add(&context, tap, pulled.sums[tap * lanes + lane], &no_cells)?;
        }
        if pullback.meters.iter().any(|meter| meter.taps().any(|tap| pullback.reads(tap))) {
            self.rows((block, bars), lane, tests)?;
        }
        for pair in pulled.pairs.iter().filter(|pair| pair.lane == lane) {
            let test = tests[layout.tests[lane]];
            let (numbers, texts) = (test.numbers(pair.row), test.texts(pair.row));
            let scope = Scope { numbers, texts, step: pair.dt, alpha: context.at.alpha };
            self.pending.add(&context, pair.tap, pair.bar, &scope)?;
        }
        let tables = [(&pullback.values, &pulled.values), (&pullback.inputs, &pulled.inputs)];
        for ((slot, column), taps) in tables.iter().flat_map(|(taps, all)| all.iter().map(move |own| (own, *taps))) {
            let tap = taps[*slot].expect("only those with a tap have a column");
            for place in (lane..column.len()).step_by(lanes).filter(|&place| layout.transitions.moving[place] != 0.0) {
                let scope = layout.moving(&context.at, tests, (place, lane));
                self.pending.add(&context, tap, column[place], &scope)?;
            }
        }
        Ok(())
    }

    /// Adds the adjoints of the coefficients of measurements whose expressions read cells.
    fn rows(
        &mut self,
        (block, bars): (FilteredBatch<'_>, &BatchAdjoints),
        lane: usize,
        tests: &[&Test],
    ) -> Result<(), Box<Fault>> {
        let (pullback, lanes, layout, (rows, width)) = (self.pullback, block.layout.lanes, block.layout, bars.rows());
        let context = pullback.context();
        for (row, &meter) in layout.meters.iter().enumerate() {
            let place = row * lanes + lane;
            if layout.measured[place] == 0.0 {
                continue;
            }
            let (taps, scope) = (&pullback.meters[meter], layout.scope(&context.at, tests, (place, lane)));
            let bar = |k: usize| rows[(row * width + k) * lanes + lane];
            let noise = taps.noise.map(|tap| (tap, bar(0)));
            let constant = taps.constant.map(|tap| (tap, -bar(1)));
            let terms = taps.terms.iter().map(|&(state, tap)| (tap, bar(2 + state)));
            for (tap, seed) in noise.into_iter().chain(constant).chain(terms).filter(|&(tap, _)| pullback.reads(tap)) {
                self.pending.add(&context, tap, seed, &scope)?;
            }
        }
        Ok(())
    }
}
