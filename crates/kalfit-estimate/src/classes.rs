//! The reductions in the estimator's form: scaled, centred, and with tests that share one R gathered into one class.
//!
//! Inside this module ξ = m + D η with a centre m near the population mean and a diagonal D that gives the average test
//! unit information on each state, so that nothing here depends on the user's units. For a class of n tests with one R,
//! only the mean and the scatter of d matter: a class costs as much as one test. Tests in phases may be kept phase by
//! phase ([`ChainedClass`](crate::ChainedClass)).

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use kalfit_lanes::Isa;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::canonical::{Members, ordered};
use crate::chained::{ChainShape, ChainStore, Packed, grouped};
use crate::class::{Class, ClassRef};
use crate::frame::Frame;
use crate::frame::Pooled;
use crate::gather::{gather, gather_chains};
use crate::lanes::ClassBatches;
use crate::levels::Units;
use crate::listed::Listed;
use crate::point::Point;
use crate::residual::{NoiseScale, Residual};
use kalfit_algebra::elements::Elements;
use kalfit_filter::reduce::Reductions;
use kalfit_model::Chain;
use kalfit_model::Grouping;
use kalfit_model::Path;
use kalfit_model::remote::Remote;

/// All reductions of an ensemble, ready for passes.
#[derive(Debug, Clone)]
pub struct Classes {
    /// Where each class is stored. The order of the classes does not depend on the order of the tests.
    places: Arc<Vec<ClassIndex>>,
    /// Scale of all noise relative to the reductions that were gathered. All stored numbers hold at the scaled noise,
    /// except the constants of single classes in `blocks` and `shared`.
    noise: Option<NoiseScale>,
    /// Classes of a single test each that are evaluated in lanes.
    pub(crate) blocks: ClassBatches,
    /// Classes of several tests each that are evaluated in lanes.
    pub(crate) shared: ClassBatches,
    /// All other classes.
    pub listed: Listed,
    /// Positions in `listed` of the classes that are evaluated one by one.
    pub(crate) unbatched: Vec<usize>,
    /// The `listed` classes in phases that are evaluated in lanes.
    pub(crate) chains: Vec<Arc<Packed>>,
    /// The coordinates η of the stored numbers.
    pub frame: Frame,
    /// Number of tests.
    pub tests: usize,
    /// Σ_j R_j'R_j, in η.
    pub information: DMatrix<f64>,
    /// The elements of Σ.
    pub(crate) elements: Elements,
    /// Number of tests that have each phase.
    pub present: Vec<f64>,
    /// Whether tests are stored phase by phase where possible.
    chained: bool,
    /// The tests of each class; `None` for remote tests and for a subset of the classes of an ensemble.
    members: Option<Arc<Members>>,
    /// Stamp of the reductions that the classes were made from; `None` where the classes belong to no reductions.
    stamp: Option<u64>,
    /// The units, groups of the outermost level with the groups and tests inside, if tests are in groups; no unit if
    /// the tests are remote.
    pub units: Option<Arc<Units>>,
    /// The connection to remote tests, which have no classes here.
    pub remote: Option<Remote>,
}

/// Position of a class in its storage.
#[derive(Debug, Clone, Copy)]
struct ClassIndex {
    kind: ClassKind,
    at: u32,
}

/// The storage of a class.
#[derive(Debug, Clone, Copy)]
enum ClassKind {
    /// One test, stored in `blocks`.
    Single,
    /// Several tests, stored in `shared`.
    Several,
    Listed,
}

/// Writes the class with a number into a buffer.
type ClassFill<'a> = &'a (dyn Fn(usize, &mut Class) + Sync);

/// Number of classes that one thread gathers at a time.
const CLASSES_PER_TASK: usize = 64;

impl Classes {
    /// Gathers reductions with `regressors` covariates each; `ranges` holds the states of each phase. With `chained`, a
    /// test is stored phase by phase if the reduction of the test is.
    pub(crate) fn new(reductions: &Reductions, ranges: Vec<Range<usize>>, centred: &[bool], chained: bool) -> Classes {
        let elements = Elements::new(ranges);
        let chained = chained && !elements.is_single();
        if let Some(remote) = reductions.remote() {
            return Classes::of_remote(remote, (elements, centred), chained);
        }
        let members = ordered(reductions, chained);
        let pooled = Pooled::all(reductions, members.tests(), (elements.states(), centred.len()));
        Classes::gathered(reductions, members, (pooled.frame(centred), &pooled), (elements, chained))
    }

    /// Gathers reductions in the coordinates of other classes.
    pub(crate) fn within(reductions: &Reductions, like: &Classes) -> Classes {
        like.regathered(reductions, like.chained)
    }

    /// The classes with the groups of the tests. The reductions must be in the states of the test and of each group of
    /// the test, and every test must be in a group. The centre moves to the states of the test, as the sum over the
    /// levels; other states are centred at zero. States that one effect acts on get one scale.
    pub(crate) fn in_groups(mut self, reductions: &Reductions, grouping: &Arc<Grouping>) -> Classes {
        let levels = grouping.depth() + 1;
        let frame = self.frame.centred(levels).with_shared_scales(levels, grouping.all_slots());
        if frame != self.frame {
            self = Classes { frame, ..self }.regathered(reductions, false);
        }
        let units = Units::new(reductions, &self, grouping).expect("every test is in a group");
        if self.remote.is_none() {
            self.present = units.counts(); // remote tests report the counts
        }
        self.units = Some(Arc::new(units));
        self
    }

    /// The classes of remote tests as if there were no groups.
    pub(crate) fn apart(&self) -> Classes {
        let Some(p) = self.units.as_ref().map(|units| units.states) else { return self.clone() };
        Classes {
            frame: self.frame.part(&(0..p)),
            information: self.information.view((0, 0), (p, p)).into_owned(),
            elements: Elements::new(self.elements.blocks()[..1].to_vec()),
            present: self.present[..1].to_vec(),
            units: None,
            ..self.clone()
        }
    }

    /// The classes of `reductions` in the coordinates of these classes, stored phase by phase if `chained`.
    fn regathered(&self, reductions: &Reductions, chained: bool) -> Classes {
        if let Some(remote) = reductions.remote() {
            return Classes { remote: Some(remote.clone()), ..self.clone() }; // the pooled sums suffice for starts
        }
        let classes = Classes::in_frame(reductions, &self.frame, self.elements.clone(), chained);
        match &self.units {
            Some(units) => classes.in_groups(reductions, &units.grouping),
            None => classes,
        }
    }

    /// Gathers reductions in given coordinates.
    pub(super) fn in_frame(reductions: &Reductions, frame: &Frame, elements: Elements, chained: bool) -> Classes {
        let chained = chained && !elements.is_single();
        let members = ordered(reductions, chained);
        let pooled = Pooled::all(reductions, members.tests(), (elements.states(), frame.covariate_scale.len()));
        Classes::gathered(reductions, members, (frame.clone(), &pooled), (elements, chained))
    }

    /// The classes of remote tests from their survey: (number of tests, for each phase the number of tests that have
    /// the phase, pooled sums).
    pub(super) fn of_survey(
        remote: &Remote,
        (tests, present, pooled): (usize, Vec<f64>, &Pooled),
        (elements, centred, chained): (Elements, &[bool], bool),
    ) -> Classes {
        let frame = pooled.frame(centred);
        let totals = (tests, pooled.information(&frame), present);
        let classes = Classes::arranged((Vec::new(), &|_, _| {}), Vec::new(), (&frame, &elements, chained), totals);
        Classes { remote: Some(remote.clone()), ..classes }
    }

    fn gathered(
        reductions: &Reductions,
        members: Members,
        (frame, pooled): (Frame, &Pooled),
        (elements, chained): (Elements, bool),
    ) -> Classes {
        let totals = (reductions.len(), pooled.information(&frame), present(reductions, &elements));
        let classes = Classes::of_members(reductions, members, (&frame, &elements, chained), totals);
        Classes { stamp: Some(reductions.stamp()), ..classes }
    }

    fn of_members(
        reductions: &Reductions,
        members: Members,
        (frame, elements, chained): (&Frame, &Elements, bool),
        totals: (usize, DMatrix<f64>, Vec<f64>),
    ) -> Classes {
        let chains = if chained { for_lanes(reductions, &members, (frame, elements)) } else { Vec::new() };
        let lanes = lanes_of_classes(&chains, members.len());
        let has_blocks = elements.is_single() && !frame.scale.is_empty();
        let apart = |j: usize| reductions.path(j) == Path::SquareRoot || reductions.exact(j).is_some();
        let kind = |class: usize| match members.class(class) {
            tests if !has_blocks || tests.iter().any(|&j| apart(j)) => ClassKind::Listed,
            [_] => ClassKind::Single,
            _ => ClassKind::Several,
        };
        let fill = |class: usize, buffer: &mut Class| {
            let tests = members.class(class);
            if chained && reductions.chain(tests[0]).is_some() {
                gather_chains((reductions, tests), (frame, elements), lanes.get(class).cloned().flatten(), buffer);
            } else {
                gather(reductions, tests, frame, buffer);
            }
        };
        let kinds = (0..members.len()).map(kind).collect();
        let classes = Classes::arranged((kinds, &fill), chains, (frame, elements, chained), totals);
        Classes { members: Some(Arc::new(members)), ..classes }
    }

    /// Stores each class by kind; `fill` writes a class into a buffer.
    fn arranged(
        (kinds, fill): (Vec<ClassKind>, ClassFill<'_>),
        chains: Vec<Arc<Packed>>,
        (frame, elements, chained): (&Frame, &Elements, bool),
        (tests, information, present): (usize, DMatrix<f64>, Vec<f64>),
    ) -> Classes {
        let (mut places, mut numbers) = (Vec::with_capacity(kinds.len()), [const { Vec::new() }; 3]);
        for (class, kind) in kinds.into_iter().enumerate() {
            let numbers: &mut Vec<usize> = &mut numbers[kind as usize];
            places.push(ClassIndex { kind, at: numbers.len() as u32 });
            numbers.push(class);
        }
        let [single, several, listed] = &numbers;
        let (p, regressors) = (frame.scale.len(), frame.covariate_scale.len());
        let filled = |several: bool, numbers: &[usize]| {
            let fill = |at: usize, buffer: &mut Class| fill(numbers[at], buffer);
            ClassBatches::filled((p, regressors, several), Isa::best(), numbers.len(), &fill)
        };
        let (blocks, shared) = (filled(false, single), filled(true, several));
        let listed = list(listed, fill);
        let is_unbatched = |&number: &usize| listed.get(number).chain.is_none_or(ChainStore::is_by_rotations);
        Classes {
            unbatched: (0..listed.len()).filter(is_unbatched).collect(),
            places: Arc::new(places),
            noise: None,
            blocks,
            shared,
            listed,
            chains,
            frame: frame.clone(),
            tests,
            information,
            elements: elements.clone(),
            present,
            chained,
            members: None,
            stamp: None,
            units: None,
            remote: None,
        }
    }

    /// Number of classes.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// True where there are no classes.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Class `number`; a class in blocks is first read into `buffer`.
    pub(crate) fn get<'a>(&'a self, number: usize, buffer: &'a mut Class) -> ClassRef<'a> {
        if let ClassIndex { kind: ClassKind::Listed, at } = self.places[number] {
            return self.listed.get(at as usize);
        }
        self.read(number, buffer);
        buffer.view()
    }

    /// Writes the class with a number into a buffer.
    fn read(&self, number: usize, class: &mut Class) {
        let ClassIndex { kind, at } = self.places[number];
        match kind {
            ClassKind::Single => self.blocks.read(at as usize, class),
            ClassKind::Several => self.shared.read(at as usize, class),
            ClassKind::Listed => return class.set(self.listed.get(at as usize)),
        }
        class.constant += self.noise.as_ref().map_or(0.0, |noise| noise.change(number));
    }

    /// These classes if made from `reductions`, else the classes of `reductions` in the coordinates of these classes.
    pub fn of<'a>(&'a self, reductions: &Reductions) -> Cow<'a, Classes> {
        let own = self.stamp.is_some_and(|stamp| stamp == reductions.stamp());
        if own { Cow::Borrowed(self) } else { Cow::Owned(Classes::within(reductions, self)) }
    }

    /// These classes as the classes of `reductions`, which must hold the same tests in the same order, at the noise of
    /// these classes; `None` if the number of tests differs or tests are in groups.
    pub(super) fn with_reductions(&self, reductions: &Reductions) -> Option<Classes> {
        let members = self.members.as_ref().filter(|members| members.tests().len() == reductions.len());
        let known = members.is_some() && self.units.is_none();
        known.then(|| Classes { stamp: Some(reductions.stamp()), ..self.clone() })
    }

    /// Indices of the tests of a class, sorted by id, in the reductions that the classes were made from.
    pub fn tests_of(&self, class: usize) -> &[usize] {
        self.members.as_ref().expect("they are of reductions").class(class)
    }

    /// Whether every test of the reductions that the classes were made from is the only test of a class.
    pub fn has_class_per_test(&self) -> bool {
        self.stamp.is_some() && self.len() == self.tests
    }

    /// Classes of one test each for `tests`, in the coordinates of these classes. The pooled information is that of
    /// these classes times the share of the tests.
    pub fn each(&self, reductions: &Reductions, tests: &[usize]) -> Classes {
        let share = tests.len() as f64 / reductions.len() as f64;
        let present = self.present.iter().map(|tests| tests * share).collect();
        let totals = (tests.len(), &self.information * share, present);
        Classes::of_members(reductions, Members::each(tests), (&self.frame, &self.elements, self.chained), totals)
    }

    /// The classes with all noise variances multiplied by λ, from the residual of each class, in coordinates that are
    /// √λ times as large. The result belongs to no reductions. The tests must be in one phase.
    pub(crate) fn with_noise(&self, variance: f64, residuals: &Arc<Vec<Residual>>) -> Classes {
        debug_assert!(self.chains.is_empty(), "between phases noise has links of its own");
        let noise = NoiseScale { variance, residuals: residuals.clone() };
        let (mut changes, mut listed) = ([Residual::default(); 2], Vec::with_capacity(self.listed.len()));
        for (place, residuals) in self.places.iter().zip(residuals.iter()) {
            match place.kind {
                ClassKind::Single => changes[0] = changes[0].plus(*residuals),
                ClassKind::Several => changes[1] = changes[1].plus(*residuals),
                ClassKind::Listed => listed.push(residuals.change(variance)),
            }
        }
        let [single, several] = changes.map(|change| change.change(variance));
        let size = variance.sqrt();
        let change = residuals.iter().fold(Residual::default(), |sum, one| sum.plus(*one)).change(variance);
        let noise_unit = noise.unit();
        let scale = self.frame.scale.iter().map(|s| s * size).collect();
        Classes {
            places: self.places.clone(),
            blocks: self.blocks.at_noise(noise.unit(), single),
            shared: self.shared.at_noise(noise.unit(), several),
            listed: self.listed.at_noise(noise.unit(), |at| listed[at]),
            noise: Some(noise),
            unbatched: self.unbatched.clone(),
            chains: Vec::new(),
            frame: Frame { scale, ..self.frame.clone() },
            information: self.information.clone(),
            elements: self.elements.clone(),
            present: self.present.clone(),
            members: self.members.clone(),
            stamp: None,
            units: self.units.as_ref().map(|units| Arc::new(units.with_noise(noise_unit, change))),
            remote: None,
            ..*self
        }
    }

    /// Every k-th class, or every k-th unit where tests are in groups, k = `every`, in the coordinates of these
    /// classes. The pooled information is that of these classes times the share of the tests.
    pub(crate) fn thinned(&self, every: usize) -> Classes {
        if let Some(units) = &self.units {
            let units = units.thinned(every);
            let present = units.counts();
            let share = present[0] / self.tests as f64;
            let information = &self.information * share;
            return Classes {
                tests: present[0] as usize,
                information,
                present,
                units: Some(Arc::new(units)),
                ..self.clone()
            };
        }
        let numbers: Vec<usize> = (0..self.len()).skip(every / 2).step_by(every).collect();
        let kinds = numbers.iter().map(|&number| self.places[number].kind).collect();
        let chains = self.packed_subset(&numbers);
        let lanes = lanes_of_classes(&chains, numbers.len());
        let fill = |at: usize, buffer: &mut Class| {
            self.read(numbers[at], buffer);
            buffer.chain = lanes.get(at).cloned().flatten().or(buffer.chain.take());
        };
        let mut buffer = Class::default();
        let tests = numbers.iter().map(|&number| self.get(number, &mut buffer).count).sum::<f64>();
        let share = tests / self.tests as f64;
        let present = self.present.iter().map(|tests| tests * share).collect();
        let totals = (tests as usize, &self.information * share, present);
        Classes::arranged((kinds, &fill), chains, (&self.frame, &self.elements, self.chained), totals)
    }

    /// Packs the chains of some classes into lanes, chains of one shape together.
    fn packed_subset(&self, numbers: &[usize]) -> Vec<Arc<Packed>> {
        let lanes = Isa::best().lanes();
        let mut buffer = Class::default();
        let chain_stores: Vec<Option<ChainStore>> =
            numbers.iter().map(|&number| self.get(number, &mut buffer).chain.cloned()).collect();
        let groups = grouped(
            chain_stores.iter().map(|chain_stores| chain_stores.as_ref().and_then(ChainStore::shape)).enumerate(),
            lanes,
        );
        let of = |k: usize| chain_stores[k].as_ref().expect("it has a shape").chained();
        let pack = |(shape, numbers)| Arc::new(Packed::new(shape, numbers, lanes, of));
        groups.into_par_iter().map(pack).collect()
    }

    /// The classes of `reductions`, stored phase by phase, in the coordinates of these classes.
    pub fn by_phase(&self, reductions: &Reductions) -> Cow<'_, Classes> {
        if self.chained {
            return self.of(reductions);
        }
        Cow::Owned(self.regathered(reductions, true))
    }

    /// The class that holds one test alone, in the coordinates of these classes.
    pub fn single(&self, reductions: &Reductions, test: usize) -> Class {
        let mut class = Class::default();
        if self.chained && reductions.chain(test).is_some() {
            gather_chains((reductions, &[test]), (&self.frame, &self.elements), None, &mut class);
        } else {
            gather(reductions, &[test], &self.frame, &mut class);
        }
        class
    }

    /// Whether some test measures something exactly.
    pub(super) fn has_exact(&self) -> bool {
        let p = self.dimension();
        !self.is_chained() && (0..self.listed.len()).any(|number| self.listed.get(number).mean.len() > p)
    }

    /// Index of a class with CΣC' singular at a point, if there is one: in η, the standard deviation of one row of Cη
    /// given the rows before is nearly zero.
    pub(super) fn singular_exact_class(&self, point: &Point) -> Option<usize> {
        const ZERO_STD_DEV: f64 = 1e-8;
        let (p, mut buffer) = (self.dimension(), Class::default());
        (0..self.len()).find(|&number| {
            let class = self.get(number, &mut buffer);
            let exact = class.factor.get(p * p..).filter(|exact| !exact.is_empty());
            exact.is_some_and(|exact| {
                let rows = DMatrix::from_row_slice(exact.len() / p, p, exact) * &point.root;
                let root = rows.transpose().qr().r();
                root.nrows() < root.ncols() || root.diagonal().iter().any(|own| own.abs() < ZERO_STD_DEV)
            })
        })
    }

    /// p, the number of states.
    pub fn dimension(&self) -> usize {
        self.frame.scale.len()
    }
}

/// The classes of these indices, as a list.
fn list(numbers: &[usize], fill: ClassFill<'_>) -> Listed {
    let list_chunk = |numbers: &[usize]| {
        let (mut listed, mut buffer) = (Listed::default(), Class::default());
        for &number in numbers {
            fill(number, &mut buffer);
            listed.push(buffer.view());
        }
        listed
    };
    let parts: Vec<Listed> = numbers.par_chunks(CLASSES_PER_TASK).map(list_chunk).collect();
    let mut all = Listed::default();
    parts.into_iter().for_each(|part| all.append(part));
    all
}

/// For each phase, the number of tests that have the phase. Every test has the first phase; a test that is not stored
/// phase by phase has the later phases of which some state is informed.
pub(super) fn present(reductions: &Reductions, elements: &Elements) -> Vec<f64> {
    let has = |j: usize, f: usize, range: &Range<usize>| match reductions.chain(j) {
        Some(chain) => f < chain.phases.len(),
        None => range.clone().any(|k| reductions.factor(j)[k * (k + 1) / 2..][..=k].iter().any(|x| *x != 0.0)),
    };
    let count = |(f, range): (usize, &Range<usize>)| match f {
        0 => reductions.len() as f64,
        _ => (0..reductions.len()).filter(|&j| has(j, f, range)).count() as f64,
    };
    elements.blocks().iter().enumerate().map(count).collect()
}

/// Packs classes of tests in phases into lanes, classes of one shape together.
fn for_lanes(reductions: &Reductions, members: &Members, (frame, elements): (&Frame, &Elements)) -> Vec<Arc<Packed>> {
    let (ranges, lanes) = (elements.blocks(), Isa::best().lanes());
    let chains_of =
        |k: usize| -> Vec<&Chain> { members.class(k).iter().filter_map(|&j| reductions.chain(j)).collect() };
    let shapes: Vec<Option<ChainShape>> =
        (0..members.len()).into_par_iter().map(|k| ChainShape::for_lanes(&chains_of(k), ranges)).collect();
    let groups = grouped(shapes.into_iter().map(|shape| shape.map(Cow::Owned)).enumerate(), lanes);
    let pack = |(shape, numbers)| Arc::new(Packed::of_tests(shape, numbers, lanes, (ranges, frame), chains_of));
    groups.into_par_iter().map(pack).collect()
}

/// For each class, the lane, or `None` if the class is not packed; empty where no class is packed.
fn lanes_of_classes(chains: &[Arc<Packed>], classes: usize) -> Vec<Option<ChainStore>> {
    if chains.is_empty() {
        return Vec::new();
    }
    let mut places = vec![None; classes];
    for packed in chains {
        for (lane, &number) in packed.members().iter().enumerate() {
            places[number] = Some(ChainStore::Lane(packed.clone(), lane));
        }
    }
    places
}
