//! Classes in phases of one shape, one class in each lane.

use std::borrow::Cow;
use std::ops::Range;
use std::slice::ChunksExact;
use std::sync::Arc;

use kalfit_lanes::{Lanes, Part, Real};

use crate::chained::kernel::{ChainDetail, ChainPhases, ChainTerms, Prior, Root};
use crate::chained::shape::is_by_rotations;
use crate::chained::{ChainShape, ChainedClass, LinkView, PhaseView, centre, columns, factor_row_times, scales};
use crate::frame::Frame;
use kalfit_algebra::algebra::Algebra;
use kalfit_algebra::factors::CrossFactors;
use kalfit_algebra::fixed::Fixed;
use kalfit_model::Chain;

/// Classes of one shape, one in each lane; remaining lanes hold a class without tests.
#[derive(Debug, Clone)]
pub struct Packed {
    pub(crate) members: Vec<usize>,
    shape: Arc<ChainShape>,
    lanes: usize,
    /// Values of the classes, entry by entry, each entry with one value for every lane: n, then for each phase the
    /// upper triangle of R by rows, d, G and C'.
    numbers: Vec<f64>,
}

impl Packed {
    /// Packs the classes with the indices `members`: at least one, and at most one for each lane; `of` returns the
    /// class with a given index.
    pub(crate) fn new<'a>(
        shape: Arc<ChainShape>,
        members: Vec<usize>,
        lanes: usize,
        of: impl Fn(usize) -> Cow<'a, ChainedClass>,
    ) -> Packed {
        Packed::filled(shape, members, lanes, |member, to| {
            let chained = of(member);
            debug_assert!(chained.shape.columns > 0, "data of one test at least");
            put(&chained, to, lanes);
        })
    }

    /// Packs the classes with the indices `members`; `of` returns the chains of the tests of the class with a given
    /// index.
    pub(crate) fn of_tests<'a>(
        shape: Arc<ChainShape>,
        members: Vec<usize>,
        lanes: usize,
        (ranges, frame): (&[Range<usize>], &Frame),
        of: impl Fn(usize) -> Vec<&'a Chain>,
    ) -> Packed {
        Packed::filled(shape, members, lanes, |member, to| put_tests(&of(member), (ranges, frame), to, lanes))
    }

    /// Packs classes: `put` writes a class to every `lanes`-th number of a slice that starts at the lane of the class.
    fn filled(shape: Arc<ChainShape>, members: Vec<usize>, lanes: usize, put: impl Fn(usize, &mut [f64])) -> Packed {
        let mut numbers = vec![0.0; shape.size() * lanes];
        for (lane, &member) in members.iter().enumerate() {
            put(member, &mut numbers[lane..]);
        }
        let mut packed = Packed { members, shape, lanes, numbers };
        packed.fill();
        packed
    }

    /// Fills the remaining lanes with the matrices of the first class, and no tests.
    fn fill(&mut self) {
        if self.members.len() == self.lanes {
            return;
        }
        let empty = self.chained(0).without_tests();
        for lane in self.members.len()..self.lanes {
            put(&empty, &mut self.numbers[lane..], self.lanes);
        }
    }

    /// Indices of the classes, lane by lane.
    pub(crate) fn members(&self) -> &[usize] {
        &self.members
    }

    /// Shape of the classes.
    pub(crate) fn shape(&self) -> &ChainShape {
        &self.shape
    }

    /// Number of tests of each class.
    #[inline(always)]
    pub(crate) fn count<T: Lanes>(&self) -> T {
        T::load(&self.numbers)
    }

    /// The class in one lane.
    pub(crate) fn chained(&self, lane: usize) -> ChainedClass {
        let phases = self.phases::<CrossFactors<f64>>(self.lanes, |entry| entry[lane]);
        ChainedClass { phases, shape: self.shape.clone(), count: self.numbers[lane], needs_rotations: false }
    }

    /// [`ChainedClass::at`] of all classes; `None` where a class needs square-root arithmetic. Classes of one test with
    /// few states use matrices whose sizes are known at compile time.
    #[inline(always)]
    pub(crate) fn evaluated<T: Lanes>(
        &self,
        mean: &[T],
        root: &Root<'_>,
        detail: ChainDetail,
    ) -> Option<ChainTerms<T>> {
        debug_assert_eq!(T::COUNT, self.lanes, "packed for others");
        let prior = Prior { root, mean };
        let size = if self.shape.columns == 1 { Some(self.shape.widest()) } else { None };
        match size {
            Some(1) if T::MAX_FIXED_SIZE >= 1 => self.by::<Fixed<T, 1>>(&prior, detail),
            Some(2) if T::MAX_FIXED_SIZE >= 2 => self.by::<Fixed<T, 2>>(&prior, detail),
            Some(3) if T::MAX_FIXED_SIZE >= 3 => self.by::<Fixed<T, 3>>(&prior, detail),
            Some(4) if T::MAX_FIXED_SIZE >= 4 => self.by::<Fixed<T, 4>>(&prior, detail),
            Some(5 | 6) if T::MAX_FIXED_SIZE >= 6 => self.by::<Fixed<T, 6>>(&prior, detail),
            Some(7 | 8) if T::MAX_FIXED_SIZE >= 8 => self.by::<Fixed<T, 8>>(&prior, detail),
            _ => self.by::<CrossFactors<T>>(&prior, detail),
        }
    }

    #[inline(always)]
    fn by<A: Algebra<Number: Lanes>>(
        &self,
        prior: &Prior<'_, A::Number>,
        detail: ChainDetail,
    ) -> Option<ChainTerms<A::Number>> {
        A::Number::apart(PackedEvaluation::<A> { packed: self, prior, detail })
    }

    /// The matrices and data of all phases; `number` converts an entry, a slice of `lanes` numbers.
    #[inline(always)]
    fn phases<A: Algebra>(
        &self,
        lanes: usize,
        number: impl Fn(&[f64]) -> A::Number,
    ) -> Vec<PhaseView<A::Matrix, A::Data>> {
        let mut entries = self.numbers[lanes..].chunks_exact(lanes);
        let mut phases = Vec::with_capacity(self.shape.phases.len());
        let mut before = 0;
        for phase in &self.shape.phases {
            let (q, columns) = (phase.size, self.shape.columns);
            let (mut factor, mut data, mut link) = (A::zeros(q, q), A::zero_data(q, columns), None);
            for i in 0..q {
                read(&mut A::row_mut(&mut factor, i)[i..q], &mut entries, &number);
            }
            for i in 0..q {
                read(&mut A::data_row_mut(&mut data, i)[..columns], &mut entries, &number);
            }
            if let Some(rows) = phase.noise {
                let (mut sensitivity, mut root) = (A::zeros(q, before), A::zeros(rows, q));
                for i in 0..q {
                    read(&mut A::row_mut(&mut sensitivity, i)[..before], &mut entries, &number);
                }
                for i in 0..rows {
                    read(&mut A::row_mut(&mut root, i)[..q], &mut entries, &number);
                }
                link = Some(LinkView { sensitivity, root });
            }
            phases.push(PhaseView { own: phase.own.clone(), factor, data, link });
            before = q;
        }
        phases
    }
}

impl ChainedClass {
    /// A class of at least one test, all with equal matrices, in a frame; `ranges`: range of the states of each phase
    /// of the model.
    pub(crate) fn new(chains: &[&Chain], ranges: &[Range<usize>], frame: &Frame) -> ChainedClass {
        let shape = Arc::new(ChainShape::of(chains, ranges));
        let packed = Packed::of_tests(shape, vec![0], 1, (ranges, frame), |_| chains.to_vec());
        ChainedClass { needs_rotations: is_by_rotations(chains), ..packed.chained(0) }
    }
}

/// Reads entries into a row.
#[inline(always)]
fn read<T>(row: &mut [T], entries: &mut ChunksExact<'_, f64>, number: &impl Fn(&[f64]) -> T) {
    for (x, entry) in row.iter_mut().zip(entries) {
        *x = number(entry);
    }
}

/// Writes the numbers of a class to every `every`-th position of `to`.
fn put(chained: &ChainedClass, to: &mut [f64], every: usize) {
    let mut to = to.iter_mut().step_by(every);
    let mut write = |numbers: &[f64]| numbers.iter().zip(&mut to).for_each(|(x, to)| *to = *x);
    write(&[chained.count]);
    for phase in &chained.phases {
        for i in 0..phase.factor.nrows() {
            write(&phase.factor.row(i)[i..]);
        }
        write(phase.data.as_slice());
        if let Some(link) = &phase.link {
            write(link.sensitivity.as_slice());
            write(link.root.as_slice());
        }
    }
}

/// Writes the numbers of a class to every `every`-th position of `to`, from the chains of the class's tests, which have
/// equal matrices.
fn put_tests(chains: &[&Chain], (ranges, frame): (&[Range<usize>], &Frame), to: &mut [f64], every: usize) {
    let mut at = 0;
    let mut write = |x: f64| {
        to[at] = x;
        at += every;
    };
    write(chains.len() as f64);
    let shared = (chains.len() > 1).then(|| columns(chains, ranges, frame));
    let mut row = 0;
    let (mut sigma, mut before) = (Vec::new(), Vec::new());
    let (mut scale, mut scale_before) = (Vec::new(), Vec::new());
    for (phase, own) in chains[0].phases.iter().zip(ranges) {
        let q = phase.data.len();
        scales(q, own, frame, &mut scale);
        centre(phase, own, frame, &before, &mut sigma);
        for i in 0..q {
            let mut place = i * (i + 3) / 2;
            for (k, scale) in scale.iter().enumerate().skip(i) {
                write(phase.factor[place] * scale);
                place += k + 1;
            }
        }
        match &shared {
            Some(columns) => (row..row + q).flat_map(|i| columns.row(i)).for_each(|x| write(*x)),
            None => (0..q).for_each(|i| write(phase.data[i] - factor_row_times(phase, i, &sigma))),
        }
        row += q;
        if let Some(link) = &phase.link {
            let sensitivity = link.sensitivity.as_slice();
            for (i, scale) in scale.iter().enumerate() {
                let row = sensitivity.iter().skip(i).step_by(q);
                row.zip(&scale_before).for_each(|(x, before)| write(x * before / scale));
            }
            for column in link.root.as_slice().chunks_exact(q.max(1)) {
                column.iter().zip(&scale).for_each(|(x, scale)| write(x / scale));
            }
        }
        std::mem::swap(&mut sigma, &mut before);
        std::mem::swap(&mut scale, &mut scale_before);
    }
}

/// Evaluates packed classes with one kind of matrices.
struct PackedEvaluation<'a, A: Algebra> {
    packed: &'a Packed,
    prior: &'a Prior<'a, A::Number>,
    detail: ChainDetail,
}

impl<A: Algebra<Number: Lanes>> Part for PackedEvaluation<'_, A> {
    type Output = Option<ChainTerms<A::Number>>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let phases = self.packed.phases::<A>(A::Number::COUNT, A::Number::load);
        ChainPhases::<A> { phases: &phases, count: self.packed.count() }.evaluated(self.prior, self.detail)
    }
}
