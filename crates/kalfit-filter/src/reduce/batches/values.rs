//! The numbers of tests in lanes at an α. What α does not change is evaluated once.

use std::ops::Range;

use kalfit_lanes::{MOST, Width};

use crate::reduce::batches::layout::BatchLayout;
use crate::reduce::dynamics::Table;
use crate::reduce::lanes::{BatchColumns, BatchFilter};
use crate::reduce::motion::MotionColumns;
use crate::reduce::prepare::{Preparer, Replay};
use crate::reduce::subject::{Coefficient, Fault, ModelAt};
use kalfit_model::Scope;
use kalfit_model::Test;

/// What tests are at an α, and what their filters leave.
#[derive(Debug, Clone)]
pub(crate) struct BatchValues {
    pub(crate) batch_filter: BatchFilter,
    pub(crate) motion: MotionColumns,
    /// Whether the numbers of the test in each lane are sound: others are to be looked at one by one.
    pub(super) sound: [bool; MOST],
}

/// What is to be done about a coefficient.
enum Refresh<'a> {
    /// Nothing: it is what it was.
    Kept,
    Same(f64),
    /// It is another on each row.
    Row(&'a Coefficient),
}

impl<'a> Refresh<'a> {
    /// `fresh`: nothing was evaluated before.
    fn of(at: &ModelAt<'_>, coefficient: &'a Coefficient, fresh: bool) -> Refresh<'a> {
        match coefficient {
            Coefficient::Fixed(x) if fresh => Refresh::Same(*x),
            Coefficient::Fixed(_) => Refresh::Kept,
            Coefficient::Free(x, ..) => Refresh::Same(*x),
            Coefficient::Varying(expression, _) if fresh || at.depends(expression) => Refresh::Row(coefficient),
            Coefficient::Varying(..) => Refresh::Kept,
        }
    }

    /// Values in the lanes where there are some. `row`: that of a lane.
    fn each(
        &self,
        here: &[f64],
        value: impl Fn(usize, &Coefficient) -> Result<f64, Box<Fault>>,
        sound: &mut [bool; MOST],
        mut put: impl FnMut(usize, f64),
    ) {
        for lane in (0..here.len()).filter(|&lane| here[lane] != 0.0) {
            match self {
                Refresh::Kept => return,
                Refresh::Same(x) => put(lane, *x),
                Refresh::Row(coefficient) => match value(lane, coefficient) {
                    Ok(x) => put(lane, x),
                    Err(_) => sound[lane] = false,
                },
            }
        }
    }
}

/// Noise, constant and terms of a measurement.
struct MeasurementRefresh<'a> {
    noise: Refresh<'a>,
    constant: Refresh<'a>,
    terms: Vec<Refresh<'a>>,
}

impl BatchValues {
    /// Of no test yet.
    pub(super) fn new(width: Width) -> BatchValues {
        BatchValues { batch_filter: BatchFilter::new(width), motion: MotionColumns::default(), sound: [true; MOST] }
    }

    /// The numbers of tests, none of them evaluated before, in place of those of others.
    pub(super) fn take(&mut self, layout: &BatchLayout, of: (&Preparer, &[&Test])) {
        let dynamics = &of.0.dynamics;
        let varying = [&dynamics.table, &dynamics.inputs].map(|table| table.varying.len());
        self.batch_filter.blank(&layout.design, layout.moves());
        self.motion.blank(varying, layout.transitions.dt.len());
        self.evaluate(layout, of, true);
    }

    /// The numbers at the α of a preparer.
    pub(super) fn evaluate(&mut self, layout: &BatchLayout, (preparer, tests): (&Preparer, &[&Test]), fresh: bool) {
        self.sound = [true; MOST];
        self.start(layout, (preparer, tests));
        self.measure(layout, (preparer, tests), fresh);
        let at = preparer.at();
        let (dynamics, motion) = (&preparer.dynamics, &mut self.motion);
        table((layout, tests), (&at, &dynamics.table), &mut motion.values, fresh, &mut self.sound);
        table((layout, tests), (&at, &dynamics.inputs), &mut motion.inputs, fresh, &mut self.sound);
        let (width, out) = (self.batch_filter.block.width(), self.batch_filter.columns());
        let finite = preparer.plan.fill(width, dynamics, (&layout.transitions, motion), out);
        self.sound.iter_mut().zip(finite).for_each(|(sound, finite)| *sound &= finite);
    }

    /// a and P0.
    fn start(&mut self, layout: &BatchLayout, (preparer, tests): (&Preparer, &[&Test])) {
        let (lanes, place, r) = (layout.lanes, &preparer.order.place, layout.design.frame.r);
        let BatchValues { batch_filter, sound, .. } = self;
        let BatchColumns { start, variance, .. } = batch_filter.columns();
        let mut replay = Replay::default();
        variance.fill(0.0);
        for (lane, &number) in layout.tests.iter().enumerate() {
            let own;
            let law = match (preparer.law(), layout.openings.get(lane)) {
                (Some(law), _) => law,
                (None, Some(opening)) => match preparer.law_of(tests[number], opening, &mut replay) {
                    Ok(law) => {
                        own = law;
                        &own
                    }
                    Err(_) => {
                        sound[lane] = false;
                        continue;
                    }
                },
                (None, None) => unreachable!("each test has an opening"),
            };
            law.mean.iter().zip(place).for_each(|(&mean, &place)| start[lanes * place + lane] = mean);
            for &(i, j, value) in law.covariance.iter().filter(|(.., value)| *value != 0.0) {
                let (i, j) = (place[i], place[j]);
                variance[lanes * (i.max(j) * r + i.min(j)) + lane] += value;
            }
        }
    }

    /// h, R and z - d.
    fn measure(&mut self, layout: &BatchLayout, (preparer, tests): (&Preparer, &[&Test]), fresh: bool) {
        let (at, lanes) = (preparer.at(), layout.lanes);
        let mixed = !preparer.meters.can_repeat();
        let refresh = |coefficient| Refresh::of(&at, coefficient, fresh || mixed);
        let refreshes = preparer.meters.parts().map(|(noise, constant, terms)| MeasurementRefresh {
            noise: refresh(noise),
            constant: refresh(constant),
            terms: terms.iter().map(|(_, h)| refresh(h)).collect(),
        });
        let refreshes: Vec<MeasurementRefresh<'_>> = refreshes.collect();
        let BatchValues { batch_filter, sound, .. } = self;
        let BatchColumns { h, noise, values, .. } = batch_filter.columns();
        if mixed {
            h.fill(0.0);
        }
        let mut first = 0;
        for (row, &meter) in layout.meters.iter().enumerate() {
            let (MeasurementRefresh { noise: variance, constant, terms }, places) =
                (&refreshes[meter], row * lanes..(row + 1) * lanes);
            let here = &layout.measured[places.clone()];
            let scope = |lane: usize| layout.scope(&at, tests, (places.start + lane, lane));
            let out = &mut noise[places.clone()];
            variance.each(here, |lane, c| at.variance_value(c, &scope(lane)), sound, |lane, x| out[lane] = x);
            let (z, out) = (&layout.z[places.clone()], &mut values[places.clone()]);
            let value = |lane: usize, c: &Coefficient| at.value(c, &scope(lane));
            constant.each(here, value, sound, |lane, d| out[lane] = z[lane] - d);
            let (line, own) = &layout.shapes[meter];
            for (coefficient, place) in terms.iter().zip(own) {
                let out = &mut h[(first + place) * lanes..][..lanes];
                coefficient.each(here, value, sound, |lane, x| out[lane] = x);
            }
            first += line.len();
        }
        if mixed {
            self.whiten(layout, (preparer, tests));
        }
    }
}

impl BatchLayout {
    /// What a measurement is evaluated on.
    pub(crate) fn scope<'a>(&self, at: &ModelAt<'a>, tests: &[&'a Test], (place, lane): (usize, usize)) -> Scope<'a> {
        let (test, row) = (tests[self.tests[lane]], self.sources[place] as usize);
        Scope { numbers: test.numbers(row), texts: test.texts(row), step: self.dt[place], alpha: at.alpha }
    }

    /// What a transition is evaluated on.
    pub(crate) fn moving<'a>(&self, at: &ModelAt<'a>, tests: &[&'a Test], (place, lane): (usize, usize)) -> Scope<'a> {
        let (test, row) = (tests[self.tests[lane]], self.transitions.sources[place] as usize);
        Scope { numbers: test.numbers(row), texts: test.texts(row), step: self.transitions.dt[place], alpha: at.alpha }
    }
}

/// The coefficients of a table that vary, on all transitions.
fn table(
    (layout, tests): (&BatchLayout, &[&Test]),
    (at, table): (&ModelAt<'_>, &Table),
    columns: &mut [Vec<f64>],
    fresh: bool,
    sound: &mut [bool; MOST],
) {
    let (lanes, steps) = (layout.lanes, &layout.transitions);
    for ((_, coefficient, variance), column) in table.varying.iter().zip(columns) {
        let refresh = Refresh::of(at, coefficient, fresh);
        for (t, out) in column.chunks_exact_mut(lanes).enumerate() {
            let places: Range<usize> = t * lanes..(t + 1) * lanes;
            let value = |lane: usize, c: &Coefficient| {
                let scope = layout.moving(at, tests, (places.start + lane, lane));
                if *variance { at.variance_value(c, &scope) } else { at.value(c, &scope) }
            };
            refresh.each(&steps.moving[places.clone()], value, sound, |lane, x| out[lane] = x);
        }
    }
}
