//! The values of tests in lanes at an α: h, R, z - d, φ, Q, b, a and P0. Values that do not depend on α are evaluated
//! once.

use std::ops::Range;

use kalfit_lanes::{MAX_LANES, Width};

use crate::reduce::batches::layout::BatchLayout;
use crate::reduce::dynamics::Table;
use crate::reduce::lanes::{BatchColumns, BatchFilter};
use crate::reduce::motion::MotionColumns;
use crate::reduce::prepare::{Preparer, Replay};
use crate::reduce::subject::{Coefficient, Fault, ModelAt};
use kalfit_model::Scope;
use kalfit_model::Test;

/// The values of a batch of tests at an α, and the results of the filters.
#[derive(Debug, Clone)]
pub(crate) struct BatchValues {
    pub(crate) batch_filter: BatchFilter,
    pub(crate) motion: MotionColumns,
    /// True for each lane whose values are valid; a test in another lane is reduced alone.
    pub(super) valid: [bool; MAX_LANES],
}

/// How the values of a coefficient are updated at a new α.
enum Refresh<'a> {
    /// The stored values are still right.
    Unchanged,
    Uniform(f64),
    /// The value differs from row to row.
    PerRow(&'a Coefficient),
}

impl<'a> Refresh<'a> {
    /// `fresh`: no value has been evaluated yet.
    fn of(at: &ModelAt<'_>, coefficient: &'a Coefficient, fresh: bool) -> Refresh<'a> {
        match coefficient {
            Coefficient::Fixed(x) if fresh => Refresh::Uniform(*x),
            Coefficient::Fixed(_) => Refresh::Unchanged,
            Coefficient::Free(x, ..) => Refresh::Uniform(*x),
            Coefficient::Varying(expression, _) if fresh || at.depends(expression) => Refresh::PerRow(coefficient),
            Coefficient::Varying(..) => Refresh::Unchanged,
        }
    }

    /// Updates the values in the lanes where `present` is not zero. `value` evaluates a coefficient in a lane, `put`
    /// stores the result.
    fn refresh_lanes(
        &self,
        present: &[f64],
        value: impl Fn(usize, &Coefficient) -> Result<f64, Box<Fault>>,
        valid: &mut [bool; MAX_LANES],
        mut put: impl FnMut(usize, f64),
    ) {
        for lane in (0..present.len()).filter(|&lane| present[lane] != 0.0) {
            match self {
                Refresh::Unchanged => return,
                Refresh::Uniform(x) => put(lane, *x),
                Refresh::PerRow(coefficient) => match value(lane, coefficient) {
                    Ok(x) => put(lane, x),
                    Err(_) => valid[lane] = false,
                },
            }
        }
    }
}

/// Updates of the noise, the constant and the terms of a measurement.
struct MeasurementRefresh<'a> {
    noise: Refresh<'a>,
    constant: Refresh<'a>,
    terms: Vec<Refresh<'a>>,
}

impl BatchValues {
    /// Values for lanes of this width, without tests yet.
    pub(super) fn new(width: Width) -> BatchValues {
        BatchValues {
            batch_filter: BatchFilter::new(width),
            motion: MotionColumns::default(),
            valid: [true; MAX_LANES],
        }
    }

    /// Takes new tests in place of the previous tests and evaluates all values.
    pub(super) fn take(&mut self, layout: &BatchLayout, of: (&Preparer, &[&Test])) {
        let dynamics = &of.0.dynamics;
        let varying = [&dynamics.table, &dynamics.inputs].map(|table| table.varying.len());
        self.batch_filter.blank(&layout.design, layout.moves());
        self.motion.blank(varying, layout.transitions.dt.len());
        self.evaluate(layout, of, true);
    }

    /// Evaluates the values at the α of `preparer`; if `fresh`, also the values that do not depend on α.
    pub(super) fn evaluate(&mut self, layout: &BatchLayout, (preparer, tests): (&Preparer, &[&Test]), fresh: bool) {
        self.valid = [true; MAX_LANES];
        self.start(layout, (preparer, tests));
        self.measure(layout, (preparer, tests), fresh);
        let at = preparer.at();
        let (dynamics, motion) = (&preparer.dynamics, &mut self.motion);
        table((layout, tests), (&at, &dynamics.table), &mut motion.values, fresh, &mut self.valid);
        table((layout, tests), (&at, &dynamics.inputs), &mut motion.inputs, fresh, &mut self.valid);
        let (width, out) = (self.batch_filter.block.width(), self.batch_filter.columns());
        let finite = preparer.plan.fill(width, dynamics, (&layout.transitions, motion), out);
        self.valid.iter_mut().zip(finite).for_each(|(valid, finite)| *valid &= finite);
    }

    /// Evaluates a and P0 of each test.
    fn start(&mut self, layout: &BatchLayout, (preparer, tests): (&Preparer, &[&Test])) {
        let (lanes, place, r) = (layout.lanes, &preparer.order.place, layout.design.frame.r);
        let BatchValues { batch_filter, valid, .. } = self;
        let BatchColumns { start, variance, .. } = batch_filter.columns();
        let mut replay = Replay::default();
        variance.fill(0.0);
        for (lane, &number) in layout.tests.iter().enumerate() {
            let own;
            let law = match (preparer.law(), layout.start_cells.get(lane)) {
                (Some(law), _) => law,
                (None, Some(opening)) => match preparer.law_of(tests[number], opening, &mut replay) {
                    Ok(law) => {
                        own = law;
                        &own
                    }
                    Err(_) => {
                        valid[lane] = false;
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

    /// Evaluates h, R and z - d of each row of each test.
    fn measure(&mut self, layout: &BatchLayout, (preparer, tests): (&Preparer, &[&Test]), fresh: bool) {
        let (at, lanes) = (preparer.at(), layout.lanes);
        let may_correlate = !preparer.meters.can_repeat();
        let refresh = |coefficient| Refresh::of(&at, coefficient, fresh || may_correlate);
        let refreshes = preparer.meters.parts().map(|(noise, constant, terms)| MeasurementRefresh {
            noise: refresh(noise),
            constant: refresh(constant),
            terms: terms.iter().map(|(_, h)| refresh(h)).collect(),
        });
        let refreshes: Vec<MeasurementRefresh<'_>> = refreshes.collect();
        let BatchValues { batch_filter, valid, .. } = self;
        let BatchColumns { h, noise, values, .. } = batch_filter.columns();
        if may_correlate {
            h.fill(0.0);
        }
        let mut first = 0;
        for (row, &meter) in layout.meters.iter().enumerate() {
            let (MeasurementRefresh { noise: variance, constant, terms }, places) =
                (&refreshes[meter], row * lanes..(row + 1) * lanes);
            let present = &layout.measured[places.clone()];
            let scope = |lane: usize| layout.scope(&at, tests, (places.start + lane, lane));
            let out = &mut noise[places.clone()];
            variance.refresh_lanes(
                present,
                |lane, c| at.variance_value(c, &scope(lane)),
                valid,
                |lane, x| out[lane] = x,
            );
            let (z, out) = (&layout.z[places.clone()], &mut values[places.clone()]);
            let value = |lane: usize, c: &Coefficient| at.value(c, &scope(lane));
            constant.refresh_lanes(present, value, valid, |lane, d| out[lane] = z[lane] - d);
            let (line, own) = &layout.shapes[meter];
            for (coefficient, place) in terms.iter().zip(own) {
                let out = &mut h[(first + place) * lanes..][..lanes];
                coefficient.refresh_lanes(present, value, valid, |lane, x| out[lane] = x);
            }
            first += line.len();
        }
        if may_correlate {
            self.whiten(layout, (preparer, tests));
        }
    }
}

impl BatchLayout {
    /// The cells on which a measurement is evaluated.
    pub(crate) fn scope<'a>(&self, at: &ModelAt<'a>, tests: &[&'a Test], (place, lane): (usize, usize)) -> Scope<'a> {
        let (test, row) = (tests[self.tests[lane]], self.sources[place] as usize);
        Scope { numbers: test.numbers(row), texts: test.texts(row), step: self.dt[place], alpha: at.alpha }
    }

    /// The cells on which a transition is evaluated.
    pub(crate) fn moving<'a>(&self, at: &ModelAt<'a>, tests: &[&'a Test], (place, lane): (usize, usize)) -> Scope<'a> {
        let (test, row) = (tests[self.tests[lane]], self.transitions.sources[place] as usize);
        Scope { numbers: test.numbers(row), texts: test.texts(row), step: self.transitions.dt[place], alpha: at.alpha }
    }
}

/// Evaluates the varying coefficients of a table, on all transitions.
fn table(
    (layout, tests): (&BatchLayout, &[&Test]),
    (at, table): (&ModelAt<'_>, &Table),
    columns: &mut [Vec<f64>],
    fresh: bool,
    valid: &mut [bool; MAX_LANES],
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
            refresh.refresh_lanes(&steps.moving[places.clone()], value, valid, |lane, x| out[lane] = x);
        }
    }
}
