//! The numbers of tests in lanes at an α. What α does not change is evaluated once.

use std::ops::Range;

use kalfit_lanes::{Isa, MOST};

use crate::ensemble::Test;
use crate::model::Scope;
use crate::reduce::blocks::layout::Layout;
use crate::reduce::data::FEW;
use crate::reduce::design::Identity;
use crate::reduce::dynamics::Table;
use crate::reduce::lanes::{Columns, Kept};
use crate::reduce::motion::MotionColumns;
use crate::reduce::observe::Whitening;
use crate::reduce::prepare::{Preparer, Replay};
use crate::reduce::subject::{At, Coefficient, Fault};

/// What tests are at an α, and what their filters leave.
#[derive(Debug, Clone)]
pub(crate) struct Values {
    pub(crate) kept: Kept,
    pub(crate) motion: MotionColumns,
    /// Whether the numbers of the test in each lane are sound: others are to be looked at one by one.
    pub(super) sound: [bool; MOST],
}

/// What is to be done about a coefficient.
enum Rate<'a> {
    /// Nothing: it is what it was.
    Kept,
    Same(f64),
    /// It is another on each row.
    Row(&'a Coefficient),
}

impl<'a> Rate<'a> {
    /// `fresh`: nothing was evaluated before.
    fn of(at: &At<'_>, coefficient: &'a Coefficient, fresh: bool) -> Rate<'a> {
        match coefficient {
            Coefficient::Fixed(x) if fresh => Rate::Same(*x),
            Coefficient::Fixed(_) => Rate::Kept,
            Coefficient::Free(x, ..) => Rate::Same(*x),
            Coefficient::Varying(expression, _) if fresh || at.depends(expression) => Rate::Row(coefficient),
            Coefficient::Varying(..) => Rate::Kept,
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
                Rate::Kept => return,
                Rate::Same(x) => put(lane, *x),
                Rate::Row(coefficient) => match value(lane, coefficient) {
                    Ok(x) => put(lane, x),
                    Err(_) => sound[lane] = false,
                },
            }
        }
    }
}

/// Noise, constant and terms of a measurement.
struct Rates<'a> {
    noise: Rate<'a>,
    constant: Rate<'a>,
    terms: Vec<Rate<'a>>,
}

impl Values {
    /// Of no test yet.
    pub(super) fn new(isa: Isa) -> Values {
        Values { kept: Kept::new(isa), motion: MotionColumns::default(), sound: [true; MOST] }
    }

    /// The numbers of tests, none of them evaluated before, in place of those of others.
    pub(super) fn take(&mut self, layout: &Layout, of: (&Preparer, &[&Test])) {
        let dynamics = &of.0.dynamics;
        let varying = [&dynamics.table, &dynamics.inputs].map(|table| table.varying.len());
        self.kept.blank(&layout.design, layout.moves());
        self.motion.blank(varying, layout.transitions.dt.len());
        self.evaluate(layout, of, true);
    }

    /// The digest of the design of the test in a lane, which has so many steps.
    pub(super) fn identity(&self, layout: &Layout, lane: usize, steps: usize) -> u128 {
        let (Layout { lanes, design, transitions, .. }, gained) = (layout, &self.kept.gained);
        let own = |all, numbers| own(all, numbers, (lane, *lanes));
        let pattern = &design.moves[0].pattern;
        let (terms, pairs) = (pattern.columns.len(), pattern.pairs.len());
        let mut identity = Identity::new(&design.frame, own(gained.variance(), 0..design.variance.len()));
        let mut t = 0;
        for stretch in design.stretches().take(steps) {
            if stretch.transition.is_some() {
                if transitions.moving[t * lanes + lane] != 0.0 {
                    let phi = own(gained.transitions(), t * terms..(t + 1) * terms);
                    identity.moves(pattern, phi, own(gained.process_noise(), t * pairs..(t + 1) * pairs));
                }
                t += 1;
            }
            for line in layout.rows_of(lane, stretch.lines) {
                let h = own(gained.coefficients(), layout.terms(line));
                identity.line(design.terms(line).0.iter().copied().zip(h), gained.noise()[line * lanes + lane]);
            }
            identity.end(1);
        }
        identity.finish()
    }

    /// Whether so many steps on end of the test in a lane, which has so many in all, are equal that they have a pass of their own.
    pub(super) fn is_long(&self, layout: &Layout, lane: usize, steps: usize) -> bool {
        let (Layout { lanes, design, transitions, .. }, gained) = (layout, &self.kept.gained);
        let own = |all, numbers| own(all, numbers, (lane, *lanes)).map(f64::to_bits);
        let pattern = &design.moves[0].pattern;
        let (terms, pairs) = (pattern.columns.len(), pattern.pairs.len());
        let (mut before, mut now, mut alike, mut t) = (Vec::new(), Vec::new(), 0, 0);
        for stretch in design.stretches().take(steps) {
            now.clear();
            if stretch.transition.is_some() {
                now.push(transitions.moving[t * lanes + lane].to_bits());
                now.extend(own(gained.transitions(), t * terms..(t + 1) * terms));
                now.extend(own(gained.process_noise(), t * pairs..(t + 1) * pairs));
                t += 1;
            }
            for line in layout.rows_of(lane, stretch.lines) {
                now.extend(design.terms(line).0.iter().map(|&state| u64::from(state)));
                now.extend(own(gained.coefficients(), layout.terms(line)));
                now.push(gained.noise()[line * lanes + lane].to_bits());
            }
            alike = if now == before { alike + 1 } else { 1 };
            if alike > FEW {
                return true;
            }
            std::mem::swap(&mut before, &mut now);
        }
        false
    }

    /// The numbers at the α of a preparer.
    pub(super) fn evaluate(&mut self, layout: &Layout, (preparer, tests): (&Preparer, &[&Test]), fresh: bool) {
        self.sound = [true; MOST];
        self.start(layout, (preparer, tests));
        self.measure(layout, (preparer, tests), fresh);
        let at = preparer.at();
        let (dynamics, motion) = (&preparer.dynamics, &mut self.motion);
        table((layout, tests), (&at, &dynamics.table), &mut motion.values, fresh, &mut self.sound);
        table((layout, tests), (&at, &dynamics.inputs), &mut motion.inputs, fresh, &mut self.sound);
        let (isa, out) = (self.kept.block.isa(), self.kept.columns());
        let finite = preparer.plan.fill(isa, dynamics, (&layout.transitions, motion), out);
        self.sound.iter_mut().zip(finite).for_each(|(sound, finite)| *sound &= finite);
    }

    /// a and P0.
    fn start(&mut self, layout: &Layout, (preparer, tests): (&Preparer, &[&Test])) {
        let (lanes, place, r) = (layout.lanes, &preparer.order.place, layout.design.frame.r);
        let Values { kept, sound, .. } = self;
        let Columns { start, variance, .. } = kept.columns();
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
    fn measure(&mut self, layout: &Layout, (preparer, tests): (&Preparer, &[&Test]), fresh: bool) {
        let (at, lanes) = (preparer.at(), layout.lanes);
        let mixed = !preparer.meters.can_repeat();
        let rate = |coefficient| Rate::of(&at, coefficient, fresh || mixed);
        let rates = preparer.meters.parts().map(|(noise, constant, terms)| Rates {
            noise: rate(noise),
            constant: rate(constant),
            terms: terms.iter().map(|(_, h)| rate(h)).collect(),
        });
        let rates: Vec<Rates<'_>> = rates.collect();
        let Values { kept, sound, .. } = self;
        let Columns { h, noise, values, .. } = kept.columns();
        if mixed {
            h.fill(0.0);
        }
        let mut first = 0;
        for (row, &meter) in layout.meters.iter().enumerate() {
            let (Rates { noise: variance, constant, terms }, places) = (&rates[meter], row * lanes..(row + 1) * lanes);
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

    /// Makes measurements whose noises are correlated independent, step by step.
    fn whiten(&mut self, layout: &Layout, (preparer, tests): (&Preparer, &[&Test])) {
        for (lane, &number) in layout.tests.iter().enumerate() {
            for stretch in layout.design.stretches() {
                let rows: Vec<usize> = layout.rows_of(lane, stretch.lines).collect();
                if rows.len() > 1 && self.whiten_step((layout, lane, &rows), preparer, tests[number]).is_none() {
                    self.sound[lane] = false;
                }
            }
        }
    }

    /// The same of these lines of the test in a lane; `None` where their noises are no covariance.
    fn whiten_step(
        &mut self,
        (layout, lane, rows): (&Layout, usize, &[usize]),
        preparer: &Preparer,
        test: &Test,
    ) -> Option<()> {
        let (instances, dt) = layout.instances_of(lane, rows);
        let found = preparer.meters.covariances(&preparer.at(), test, dt, &instances).ok()?;
        if found.is_empty() {
            return Some(());
        }
        let place = |row: usize| row * layout.lanes + lane;
        let (n, (mut dense, mut measured)) = (layout.design.frame.n, self.measured_in(layout, lane, rows));
        let noises: Vec<f64> = rows.iter().map(|&row| self.kept.gained.noise()[place(row)]).collect();
        let whitening = Whitening::new(&noises, found.iter().map(|c| (c.i, c.j, c.value))).ok()?;
        whitening.apply(&mut dense, n);
        whitening.apply(&mut measured, 1);
        let Columns { h, noise, values, .. } = self.kept.columns();
        for (i, &row) in rows.iter().enumerate() {
            (noise[place(row)], values[place(row)]) = (whitening.noise(i), measured[i]);
            for (term, &state) in layout.terms(row).zip(layout.design.terms(row).0) {
                h[place(term)] = dense[i * n + state as usize];
            }
        }
        Some(())
    }

    /// M of these lines of the test in a lane, a row of n numbers for each, and z - d.
    pub(crate) fn measured_in(&self, layout: &Layout, lane: usize, rows: &[usize]) -> (Vec<f64>, Vec<f64>) {
        let (n, place) = (layout.design.frame.n, |row: usize| row * layout.lanes + lane);
        let (mut dense, coefficients) = (vec![0.0; rows.len() * n], self.kept.gained.coefficients());
        for (&row, own) in rows.iter().zip(dense.chunks_exact_mut(n)) {
            for (term, &state) in layout.terms(row).zip(layout.design.terms(row).0) {
                own[state as usize] = coefficients[place(term)];
            }
        }
        (dense, rows.iter().map(|&row| self.kept.block.measured()[place(row)]).collect())
    }
}

impl Layout {
    /// What a measurement is evaluated on.
    pub(crate) fn scope<'a>(&self, at: &At<'a>, tests: &[&'a Test], (place, lane): (usize, usize)) -> Scope<'a> {
        let (test, row) = (tests[self.tests[lane]], self.cells[place] as usize);
        Scope { numbers: test.numbers(row), texts: test.texts(row), step: self.dt[place], alpha: at.alpha }
    }

    /// What a transition is evaluated on.
    pub(crate) fn moving<'a>(&self, at: &At<'a>, tests: &[&'a Test], (place, lane): (usize, usize)) -> Scope<'a> {
        let (test, row) = (tests[self.tests[lane]], self.transitions.sources[place] as usize);
        Scope { numbers: test.numbers(row), texts: test.texts(row), step: self.transitions.dt[place], alpha: at.alpha }
    }
}

/// Numbers of the test in a lane.
fn own(all: &[f64], numbers: Range<usize>, (lane, lanes): (usize, usize)) -> impl Iterator<Item = f64> + use<'_> {
    numbers.map(move |k| all[k * lanes + lane])
}

/// The coefficients of a table that vary, on all transitions.
fn table(
    (layout, tests): (&Layout, &[&Test]),
    (at, table): (&At<'_>, &Table),
    columns: &mut [Vec<f64>],
    fresh: bool,
    sound: &mut [bool; MOST],
) {
    let (lanes, steps) = (layout.lanes, &layout.transitions);
    for ((_, coefficient, variance), column) in table.varying.iter().zip(columns) {
        let rate = Rate::of(at, coefficient, fresh);
        for (t, out) in column.chunks_exact_mut(lanes).enumerate() {
            let places: Range<usize> = t * lanes..(t + 1) * lanes;
            let value = |lane: usize, c: &Coefficient| {
                let scope = layout.moving(at, tests, (places.start + lane, lane));
                if *variance { at.variance_value(c, &scope) } else { at.value(c, &scope) }
            };
            rate.each(&steps.moving[places.clone()], value, sound, |lane, x| out[lane] = x);
        }
    }
}
