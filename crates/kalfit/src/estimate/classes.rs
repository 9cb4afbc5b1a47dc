//! The reductions as the estimator wants them: scaled, centred, and tests that share one R gathered into one class.
//!
//! Inside this module ξ = m + D η with a centre m near the population mean and a diagonal D that gives the average
//! test unit information on each state, so that nothing here depends on the user's units. For a class of n tests
//! with one R, only the mean of their d and its scatter matter: a class costs as much as one test. Tests in phases may be kept
//! phase by phase ([`Chained`]).

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use kalfit_lanes::Isa;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::ensemble::Grouping;
use crate::estimate::canonical::{ordered, spans};
use crate::estimate::chained::{Chained, Kept, Packed, Shape, grouped};
use crate::estimate::class::Class;
use crate::estimate::frame::{Frame, Pooled};
use crate::estimate::lanes::Blocks;
use crate::estimate::levels::Units;
use crate::estimate::listed::{Listed, Noise, Residual};
use crate::linalg::elements::Elements;
use crate::linalg::symmetric::{self, pair};
use crate::reduce::{Path, ReductionRef, Reductions};

/// All reductions of an ensemble, ready for passes.
#[derive(Debug, Clone)]
pub(crate) struct Classes {
    /// In an order that does not depend on the order of the tests.
    pub(crate) classes: Listed,
    /// Those of a single test that are worked on side by side.
    pub(crate) blocks: Blocks,
    /// The same of several tests each.
    pub(crate) shared: Blocks,
    /// Numbers of those that are worked on one by one.
    pub(crate) beside: Vec<usize>,
    /// Those in phases that are worked on side by side.
    pub(crate) chains: Vec<Arc<Packed>>,
    pub(crate) frame: Frame,
    pub(crate) tests: usize,
    /// Σ_j R_j'R_j, in η.
    pub(crate) information: DMatrix<f64>,
    /// The elements of Σ.
    pub(crate) elements: Elements,
    /// Number of tests that have each phase.
    pub(crate) present: Vec<f64>,
    /// Tests are kept phase by phase where that can be.
    chained: bool,
    /// The tests of one class after the other, by number, and where those of each class stand; empty where the classes are a part of
    /// others.
    order: Vec<usize>,
    spans: Vec<Range<usize>>,
    /// The reductions that these are the classes of; `None` where they are a part of others.
    stamp: Option<u64>,
    /// Where tests stand in groups: the groups of the outermost level with all that stands in them.
    pub(crate) units: Option<Arc<Units>>,
}

/// Classes that are made by themselves, by whatever thread.
const CHUNK: usize = 64;

impl Classes {
    /// Gathers reductions with the states of each phase at these places and `regressors` covariates each. `chained`: keep tests
    /// phase by phase where their reductions are.
    pub(crate) fn new(reductions: &Reductions, ranges: Vec<Range<usize>>, regressors: usize, chained: bool) -> Classes {
        let elements = Elements::new(ranges);
        let order = ordered(reductions);
        let pooled = Pooled::all(reductions, &order, (elements.states(), regressors));
        let frame = Frame::of(&pooled);
        let information = pooled.information(&frame);
        Classes::gathered((reductions, order), (frame, information), (elements, chained))
    }

    /// The same in coordinates that are given.
    pub(crate) fn within(reductions: &Reductions, like: &Classes) -> Classes {
        like.again(reductions, like.chained)
    }

    /// Other reductions, or in other ways, in the same coordinates.
    fn again(&self, reductions: &Reductions, chained: bool) -> Classes {
        let (order, elements) = (ordered(reductions), self.elements.clone());
        let pooled = Pooled::all(reductions, &order, (elements.states(), self.frame.covariate_scale.len()));
        let frame = self.frame.clone();
        let information = pooled.information(&frame);
        let classes = Classes::gathered((reductions, order), (frame, information), (elements, chained));
        match &self.units {
            Some(units) => classes.in_groups(reductions, &units.grouping),
            None => classes,
        }
    }

    fn gathered(
        (reductions, order): (&Reductions, Vec<usize>),
        (frame, information): (Frame, DMatrix<f64>),
        (elements, chained): (Elements, bool),
    ) -> Classes {
        let chained = chained && !elements.is_single();
        let spans = spans(reductions, &order, chained);
        let chains = if chained { side_by_side(reductions, &order, &spans, (&frame, &elements)) } else { Vec::new() };
        let places = places(&chains, spans.len());
        let class = |(span, place): (&Range<usize>, Option<Kept>)| {
            let tests: Vec<ReductionRef<'_>> = order[span.clone()].iter().map(|&j| reductions.get(j)).collect();
            gather(&tests, &frame, (&elements, chained), place)
        };
        let classes = spans.par_iter().zip(places).with_min_len(CHUNK).map(class).collect();
        let present = present(reductions, &elements);
        let found = (reductions.len(), information, present);
        let mut classes = Classes::arranged((classes, chains), frame.clone(), (elements.clone(), chained), found);
        (classes.order, classes.spans) = (order, spans);
        classes.stamp = Some(reductions.stamp());
        classes
    }

    /// The classes, and who is worked on side by side with whom.
    fn arranged(
        (classes, chains): (Vec<Class>, Vec<Arc<Packed>>),
        frame: Frame,
        (elements, chained): (Elements, bool),
        (tests, information, present): (usize, DMatrix<f64>, Vec<f64>),
    ) -> Classes {
        let none = |several| Blocks::new(frame.scale.len(), frame.covariate_scale.len(), several, Isa::best());
        let (mut blocks, mut shared, mut beside) = (none(false), none(true), Vec::new());
        for (number, class) in classes.iter().enumerate() {
            if elements.is_single() && blocks.takes(class) {
                blocks.push(class);
            } else if elements.is_single() && shared.takes(class) {
                shared.push(class);
            } else if class.chain.as_ref().is_none_or(Kept::is_careful) {
                beside.push(number);
            }
        }
        let (order, spans, stamp) = (Vec::new(), Vec::new(), None);
        Classes {
            classes: Listed::new(classes),
            blocks,
            shared,
            beside,
            chains,
            frame,
            tests,
            information,
            elements,
            present,
            chained,
            order,
            spans,
            stamp,
            units: None,
        }
    }

    /// With the groups that the tests stand in. All tests of the reductions, which must be in what is a test's own and what each of its
    /// groups adds, are in some. Then the centre is that of the sum.
    pub(crate) fn in_groups(mut self, reductions: &Reductions, grouping: &Arc<Grouping>) -> Classes {
        let centre = self.frame.centred(grouping.depth() + 1);
        if centre != self.frame {
            let information = self.information.clone();
            let order = ordered(reductions);
            self = Classes::gathered((reductions, order), (centre, information), (self.elements, false));
        }
        let tests: Vec<&[usize]> = (0..self.len()).map(|class| self.tests_of(class)).collect();
        let found = Units::new(reductions, (self.classes.gathered(), &tests), &self.frame, grouping);
        let units = found.expect("every test is in a group");
        self.present = units.counts();
        self.units = Some(Arc::new(units));
        self
    }

    /// These classes, if they are those of the reductions, or the classes of the reductions in the same coordinates.
    pub(crate) fn of<'a>(&'a self, reductions: &Reductions) -> Cow<'a, Classes> {
        if self.stamp == Some(reductions.stamp()) {
            Cow::Borrowed(self)
        } else {
            Cow::Owned(Classes::within(reductions, self))
        }
    }

    /// How many they are.
    pub(crate) fn len(&self) -> usize {
        self.classes.len()
    }

    /// Numbers of the tests of a class, by their ids, of the reductions that these are the classes of.
    pub(crate) fn tests_of(&self, class: usize) -> &[usize] {
        &self.order[self.spans[class].clone()]
    }

    /// Every test has a class to itself, of those that these are the classes of.
    pub(crate) fn are_single(&self) -> bool {
        self.stamp.is_some() && self.classes.len() == self.tests
    }

    /// The same where all noise is λ times as large, from what each class says of it, in coordinates that are √λ times as large.
    /// They are the classes of no reductions, and of tests in one phase.
    pub(crate) fn with_noise(&self, variance: f64, told: &Arc<Vec<Residual>>) -> Classes {
        debug_assert!(self.chains.is_empty(), "between phases noise has links of its own");
        let noise = Noise { variance, told: told.clone() };
        let mut changes = [Residual::default(); 2];
        let mut beside = self.beside.iter().peekable();
        for (k, class) in self.classes.gathered().iter().enumerate() {
            if beside.next_if(|&&number| number == k).is_none() {
                let change = &mut changes[usize::from(class.count > 1.0)];
                *change = change.and(told[k]);
            }
        }
        let [single, several] = changes.map(|change| change.change(variance));
        let size = variance.sqrt();
        let change = told.iter().fold(Residual::default(), |sum, one| sum.and(*one)).change(variance);
        let noise_unit = noise.unit();
        let scale = self.frame.scale.iter().map(|s| s * size).collect();
        Classes {
            blocks: self.blocks.shrunk(noise.unit(), single),
            shared: self.shared.shrunk(noise.unit(), several),
            classes: self.classes.with(noise),
            beside: self.beside.clone(),
            chains: Vec::new(),
            frame: Frame { scale, ..self.frame.clone() },
            information: self.information.clone(),
            elements: self.elements.clone(),
            present: self.present.clone(),
            order: Vec::new(),
            spans: Vec::new(),
            stamp: None,
            units: self.units.as_ref().map(|units| Arc::new(units.with_noise(noise_unit, change))),
            ..*self
        }
    }

    /// Every so-many-th class in their order, in the same η. The pooled information is the share that goes with the tests.
    pub(crate) fn thinned(&self, every: usize) -> Classes {
        let mut classes = self.classes.thinned(every);
        let chains = repacked(&mut classes);
        let tests = classes.iter().map(|class| class.count).sum::<f64>();
        let share = tests / self.tests as f64;
        let present = self.present.iter().map(|tests| tests * share).collect();
        let how = (self.elements.clone(), self.chained);
        Classes::arranged(
            (classes, chains),
            self.frame.clone(),
            how,
            (tests as usize, &self.information * share, present),
        )
    }

    /// The classes of the reductions, kept phase by phase, whatever these classes are.
    pub(crate) fn by_phase(&self, reductions: &Reductions) -> Cow<'_, Classes> {
        if self.chained {
            return self.of(reductions);
        }
        Cow::Owned(self.again(reductions, true))
    }

    /// One test as a class of its own, in the same η.
    pub(crate) fn single(&self, reduction: ReductionRef<'_>) -> Class {
        gather(&[reduction], &self.frame, (&self.elements, self.chained), None)
    }

    /// p.
    pub(crate) fn dimension(&self) -> usize {
        self.frame.scale.len()
    }
}

/// How many tests have each phase: all have the first one; of tests that are not kept phase by phase, those that say something
/// of its states.
fn present(reductions: &Reductions, elements: &Elements) -> Vec<f64> {
    let has = |r: ReductionRef<'_>, f: usize, range: &Range<usize>| match r.chain {
        _ if f == 0 => true,
        Some(chain) => f < chain.phases.len(),
        None => range.clone().any(|k| r.factor[k * (k + 1) / 2..][..=k].iter().any(|x| *x != 0.0)),
    };
    let count = |(f, range): (usize, &Range<usize>)| reductions.iter().filter(|r| has(*r, f, range)).count() as f64;
    elements.blocks().iter().enumerate().map(count).collect()
}

/// Classes of tests in phases that can be worked on side by side, by their numbers.
fn side_by_side(
    reductions: &Reductions,
    order: &[usize],
    spans: &[Range<usize>],
    (frame, elements): (&Frame, &Elements),
) -> Vec<Arc<Packed>> {
    let (ranges, lanes) = (elements.blocks(), Isa::best().lanes());
    let members =
        |k: usize| -> Vec<ReductionRef<'_>> { order[spans[k].clone()].iter().map(|&j| reductions.get(j)).collect() };
    let shapes: Vec<Option<Shape>> = (0..spans.len()).into_par_iter().map(|k| Shape::of(&members(k), ranges)).collect();
    let groups = grouped(shapes.into_iter().map(|shape| shape.map(Cow::Owned)).enumerate(), lanes);
    let pack = |(shape, numbers)| Arc::new(Packed::of_tests(shape, numbers, lanes, (ranges, frame), members));
    groups.into_par_iter().map(pack).collect()
}

/// Where each of so many classes stands.
fn places(chains: &[Arc<Packed>], classes: usize) -> Vec<Option<Kept>> {
    let mut places = vec![None; classes];
    for packed in chains {
        for (lane, &number) in packed.members().iter().enumerate() {
            places[number] = Some(Kept::Lane(packed.clone(), lane));
        }
    }
    places
}

/// Puts those of some classes that can be side by side.
fn repacked(classes: &mut [Class]) -> Vec<Arc<Packed>> {
    let lanes = Isa::best().lanes();
    let kept: Vec<Option<Kept>> = classes.iter().map(|class| class.chain.clone()).collect();
    let groups = grouped(kept.iter().map(|kept| kept.as_ref().and_then(Kept::shape)).enumerate(), lanes);
    let of = |k: usize| kept[k].as_ref().expect("it has a shape").chained();
    let pack = |(shape, numbers)| Arc::new(Packed::new(shape, numbers, lanes, of));
    let chains: Vec<Arc<Packed>> = groups.into_par_iter().map(pack).collect();
    for (class, place) in classes.iter_mut().zip(places(&chains, kept.len())) {
        class.chain = place.or(class.chain.take());
    }
    chains
}

/// One class; of tests in phases, where its chain stands if it is made.
fn gather(
    tests: &[ReductionRef<'_>],
    frame: &Frame,
    (elements, chained): (&Elements, bool),
    place: Option<Kept>,
) -> Class {
    let (first, p) = (tests[0], elements.states());
    if chained && first.chain.is_some() {
        return gather_chains(tests, frame, elements, place);
    }
    let mut factor = vec![0.0; p * p];
    let mut offset = vec![0.0; p]; // R × the centre
    for k in 0..p {
        for (i, &x) in first.factor[pair(k, 0)..][..=k].iter().enumerate() {
            factor[i * p + k] = x * frame.scale[k];
            offset[i] += x * frame.centre[k];
        }
    }
    let count = tests.len() as f64;
    let mut mean = vec![0.0; p];
    for test in tests {
        (0..p).for_each(|i| mean[i] += test.data[i] - offset[i]);
    }
    mean.iter_mut().for_each(|m| *m /= count);
    let away = |test: &ReductionRef<'_>| -> Vec<f64> { (0..p).map(|i| test.data[i] - offset[i] - mean[i]).collect() };
    let scatter = match tests.len() {
        1 => Vec::new(),
        n if n <= p => tests.iter().flat_map(away).collect(),
        _ => scatter(tests.iter().map(away), p),
    };
    Class {
        count,
        constant: tests.iter().map(|test| test.constant).sum(),
        factor,
        mean,
        scatter,
        covariates: covariates(first, frame),
        square_root: tests.iter().any(|test| test.path == Path::SquareRoot),
        chain: None,
    }
}

/// p vectors whose outer products add up to those of all vectors.
fn scatter(vectors: impl Iterator<Item = Vec<f64>>, p: usize) -> Vec<f64> {
    let mut sum = DMatrix::zeros(p, p);
    for x in vectors {
        for (k, column) in sum.as_mut_slice().chunks_exact_mut(p.max(1)).enumerate() {
            column.iter_mut().zip(&x).for_each(|(s, a)| *s += a * x[k]);
        }
    }
    symmetric::square_root(&sum).as_slice().to_vec()
}

fn gather_chains(tests: &[ReductionRef<'_>], frame: &Frame, elements: &Elements, place: Option<Kept>) -> Class {
    let constant =
        |r: &ReductionRef<'_>| r.chain.iter().flat_map(|chain| &chain.phases).map(|phase| phase.constant).sum::<f64>();
    Class {
        count: tests.len() as f64,
        constant: tests.iter().map(constant).sum(),
        factor: Vec::new(),
        mean: Vec::new(),
        scatter: Vec::new(),
        covariates: covariates(tests[0], frame),
        square_root: false,
        chain: Some(place.unwrap_or_else(|| Kept::Apart(Chained::new(tests, elements.blocks(), frame).into()))),
    }
}

/// Covariates in units of the frame.
fn covariates(reduction: ReductionRef<'_>, frame: &Frame) -> Vec<f64> {
    reduction.covariates.iter().zip(&frame.covariate_scale).map(|(x, s)| x / s).collect()
}
