//! Tests whose states all rest and whose rows all measure the same things: regressions with designs of their own. Their numbers go from
//! the cells straight into lanes.
//!
//! The first such test of a length is evaluated as any other. Those after it have its steps, lines and terms, and differ in h, R and
//! z - d alone: these are evaluated row by row, and nothing else is made of a test. What comes of it is the same to the last bit.

use kalfit_lanes::Isa;

use crate::ensemble::Test;
use crate::reduce::Path;
use crate::reduce::data::Outcome;
use crate::reduce::design::Design;
use crate::reduce::gains::Gains;
use crate::reduce::lanes::{Columns, Kept, is_short};
use crate::reduce::observe::Lines;
use crate::reduce::prepare::{Preparer, Workspace};
use crate::reduce::reducer::{About, Reducer};

/// Most scalar measurements of a test.
const MOST: usize = 1 << 12;

/// Tests of one length on their way through the lanes.
#[derive(Debug)]
pub(super) struct Straight {
    /// The design of the last test, whose shape is that of all.
    design: Design,
    kept: Kept,
    /// z - d of the last test; h and R of one that may be none of these.
    values: Vec<f64>,
    h: Vec<f64>,
    noise: Vec<f64>,
    seats: Vec<Seat>,
}

/// The test in a lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seat {
    pub(super) number: usize,
    digest: u128,
}

impl Straight {
    /// For tests like the one in the work space; `None` where it is not one of this kind.
    pub(super) fn like(preparer: &Preparer, test: &Test, work: &Workspace) -> Option<Straight> {
        let (design, meters) = (&work.design, preparer.meters.columns().count());
        let rows = test.rows() * meters;
        let is_plain = design.runs.len() == test.rows()
            && (design.ends.len(), work.data.values.len()) == (rows, rows)
            && (1..=MOST).contains(&rows)
            && is_short(design);
        if !is_plain || !preparer.rests() {
            return None;
        }
        let mut kept = Kept::blank(Isa::best(), design, design.runs.len());
        let lanes = kept.block.lanes();
        let Columns { start, .. } = kept.columns();
        start.chunks_exact_mut(lanes).zip(&work.data.start).for_each(|(all, x)| all.fill(*x));
        let (values, h, noise) = (Vec::new(), Vec::new(), Vec::new());
        Some(Straight { design: design.clone(), kept, values, h, noise, seats: Vec::new() })
    }

    /// Whether tests of so many rows go here.
    pub(super) fn is_of(&self, rows: usize) -> bool {
        self.design.runs.len() == rows
    }

    /// Evaluates a test; the digest of its design. `None` where it is to be evaluated as any other.
    pub(super) fn evaluate(&mut self, preparer: &Preparer, test: &Test) -> Option<u128> {
        let Straight { design, values, h, noise, .. } = self;
        let sound = preparer.meters.lines(&preparer.at(), test, &mut Lines { h, noise, values });
        sound.then(|| {
            // only then: the passes take the shape from the whole design
            std::mem::swap(&mut design.h, h);
            std::mem::swap(&mut design.noise, noise);
            design.digest()
        })
    }

    /// The design of the test that was evaluated.
    pub(super) fn design(&self) -> &Design {
        &self.design
    }

    /// Whether a test of this design is in a lane.
    pub(super) fn has(&self, digest: u128) -> bool {
        self.seats.iter().any(|seat| seat.digest == digest)
    }

    /// Puts the test that was evaluated into the next lane; true where that was the last one.
    pub(super) fn seat(&mut self, number: usize, digest: u128) -> bool {
        let (lane, lanes) = (self.seats.len(), self.kept.block.lanes());
        let Columns { h, noise, values, .. } = self.kept.columns();
        for (column, own) in [(h, &self.design.h), (noise, &self.design.noise), (values, &self.values)] {
            column.chunks_exact_mut(lanes).zip(own).for_each(|(all, x)| all[lane] = *x);
        }
        self.seats.push(Seat { number, digest });
        lane + 1 == lanes
    }

    /// Runs the filters of the tests in lanes, which leave them. `found` takes what is found of each, nothing of those that are to be
    /// looked at by themselves.
    pub(super) fn filter(
        &mut self,
        (reducer, work): (&Reducer, &mut Workspace),
        mut found: impl FnMut(usize, Option<(&Outcome, About<'_>)>),
    ) {
        if self.seats.is_empty() {
            return;
        }
        let Straight { design, kept, seats, .. } = self;
        kept.filter(design, seats.len(), &mut work.room);
        let (rows, steps, lanes) = (design.rows(), design.steps(), kept.block.lanes());
        let mut outcome = Outcome::default();
        for (lane, Seat { number, digest }) in seats.drain(..).enumerate() {
            let factor = kept.gained.found[lane].as_ref().map(|(factor, log_determinant)| {
                kept.block.outcome_to(&mut outcome, lane, (rows, *log_determinant), &work.room);
                factor
            });
            let Some(factor) = factor.filter(|_| outcome.is_finite()) else {
                found(number, None);
                continue;
            };
            reducer.ran(digest, || {
                let own = |all: &[f64]| -> Vec<f64> { all.iter().skip(lane).step_by(lanes).copied().collect() };
                let (h, noise) = (own(kept.gained.coefficients()), own(kept.gained.noise()));
                let gains: Option<Gains> = kept.gained.gains((lane, lanes), rows);
                (Design { h, noise, ..design.clone() }, gains.expect("only sound filters are noted"))
            });
            let path = Path::Information;
            found(number, Some((&outcome, About { factor, covariates: &[], steps, observations: rows, path, digest })));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::{constant, measurement, name};
    use crate::ensemble::Source;
    use crate::model::{Alpha, Model};

    /// Regressions of several lengths: some share a design, some repeat a row, some lack a value.
    fn tests() -> Vec<Test> {
        let one = |j: usize| {
            let mut test = Test::new(format!("t{j:03}"), 2, 0);
            for row in 0..if j % 5 == 4 { 4 } else { 9 } {
                let seed = if j.is_multiple_of(7) { 3 } else { j };
                let at = |row: usize| ((97 * seed + 13 * row) as f64).sin();
                let x = at(if j % 11 == 1 && row == 4 { 3 } else { row });
                let y = if j % 13 == 2 && row == 2 { f64::NAN } else { ((31 * j + 7 * row) as f64).cos() };
                test.push(&[y, x], &[], Source::default());
            }
            test
        };
        (0..200).map(one).collect()
    }

    #[test]
    fn what_goes_straight_into_lanes_is_what_tests_are_by_themselves() {
        let y = measurement("y", name("a") + name("b") * name("x"), 0.5);
        let model =
            Model::builder("").state(constant("a")).state(constant("b")).measurement(y).build().expect("a model");
        let model = &model.phases[0].model;
        let columns: Vec<&str> = model.columns.iter().map(|column| column.name.as_str()).collect();
        assert_eq!(columns, ["y", "x"], "the order of the cells of a row");
        let reducer = || Reducer::new(model, &Alpha::default()).expect("sound");
        let all = tests();
        let together = reducer().reduce(&all).expect("sound");
        for (test, found) in all.iter().zip(&together) {
            let alone = reducer().reduce(std::slice::from_ref(test)).expect("sound");
            assert_eq!(found, alone.get(0), "{}", test.id);
        }
    }
}
