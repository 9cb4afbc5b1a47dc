//! Classes in phases of one shape, side by side.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use kalfit_lanes::{Lanes, Part};

use crate::estimate::chained::kernel::{Detail, Phases, Prior, Root, Said};
use crate::estimate::chained::{Chained, Link, Phase, Shape, centre, scales, told};
use crate::estimate::frame::Frame;
use crate::linalg::factors::Plain;
use crate::linalg::fixed::Fixed;
use crate::linalg::rows::Rows;
use crate::reduce::Chain;

/// As many classes of one shape as there are lanes, or fewer: lanes that no class takes have a class without tests.
#[derive(Debug, Clone)]
pub(crate) struct Packed {
    pub(in crate::estimate) members: Vec<usize>,
    shape: Arc<Shape>,
    lanes: usize,
    /// n of each, then all their numbers, entry by entry: of each phase the upper triangle of R by rows, d, G and C'.
    numbers: Vec<f64>,
}

impl Packed {
    /// Of classes by their numbers, at least one and at most as many as there are lanes; `of` has what each says.
    pub(crate) fn new<'a>(
        shape: Arc<Shape>,
        members: Vec<usize>,
        lanes: usize,
        of: impl Fn(usize) -> Cow<'a, Chained>,
    ) -> Packed {
        Packed::filled(shape, members, lanes, |member, to| {
            let chained = of(member);
            debug_assert!(chained.columns > 0, "data of one test at least");
            put(&chained, to, lanes);
        })
    }

    /// Of classes as the estimator gathers them; `of` has the chains of the tests of each.
    pub(crate) fn of_tests<'a>(
        shape: Arc<Shape>,
        members: Vec<usize>,
        lanes: usize,
        (ranges, frame): (&[Range<usize>], &Frame),
        of: impl Fn(usize) -> Vec<&'a Chain>,
    ) -> Packed {
        Packed::filled(shape, members, lanes, |member, to| match &of(member)[..] {
            [chain] => put_test(chain, (ranges, frame), to, lanes),
            chains => put(&Chained::new(chains, ranges, frame), to, lanes),
        })
    }

    /// Each class put by `put` where the first of every so many numbers stands.
    fn filled(shape: Arc<Shape>, members: Vec<usize>, lanes: usize, put: impl Fn(usize, &mut [f64])) -> Packed {
        let mut numbers = vec![0.0; shape.size() * lanes];
        for (lane, &member) in members.iter().enumerate() {
            put(member, &mut numbers[lane..]);
        }
        let mut packed = Packed { members, shape, lanes, numbers };
        packed.fill();
        packed
    }

    /// Fills the lanes that no class takes with the design of the first class, and no tests.
    fn fill(&mut self) {
        if self.members.len() == self.lanes {
            return;
        }
        let empty = self.chained(0).without_tests();
        for lane in self.members.len()..self.lanes {
            put(&empty, &mut self.numbers[lane..], self.lanes);
        }
    }

    /// Numbers of its classes.
    pub(crate) fn members(&self) -> &[usize] {
        &self.members
    }

    /// Of what shape its classes are.
    pub(crate) fn shape(&self) -> &Shape {
        &self.shape
    }

    /// How many tests each class has.
    #[inline(always)]
    pub(crate) fn count<T: Lanes>(&self) -> T {
        T::load(&self.numbers)
    }

    /// The class in one lane.
    pub(crate) fn chained(&self, lane: usize) -> Chained {
        let number = |entry: &[f64]| entry[lane];
        let phases = self.phases(
            self.lanes,
            |q, numbers| upper(q, numbers.chunks_exact(self.lanes).map(number)),
            |(rows, columns), numbers| {
                Rows::from_vec(rows, columns, numbers.chunks_exact(self.lanes).map(number).collect())
            },
            |(rows, columns), numbers| {
                Rows::from_vec(rows, columns, numbers.chunks_exact(self.lanes).map(number).collect())
            },
        );
        Chained { phases, columns: self.shape.columns, count: self.numbers[lane], careful: false }
    }

    /// [`Chained::at`] of all; `None` where one of them needs more care. Tests by themselves, with few states, by sizes that the
    /// compiler knows.
    #[inline(always)]
    pub(crate) fn said<T: Lanes>(&self, mean: &[T], root: &Root<'_>, detail: Detail) -> Option<Said<T>> {
        debug_assert_eq!(T::COUNT, self.lanes, "packed for others");
        let prior = Prior { root, mean };
        let size = if self.shape.columns == 1 { Some(self.shape.widest()) } else { None };
        match size {
            Some(1) if T::OWN_SIZES >= 1 => self.sized::<T, 1>(&prior, detail),
            Some(2) if T::OWN_SIZES >= 2 => self.sized::<T, 2>(&prior, detail),
            Some(3) if T::OWN_SIZES >= 3 => self.sized::<T, 3>(&prior, detail),
            Some(4) if T::OWN_SIZES >= 4 => self.sized::<T, 4>(&prior, detail),
            Some(5 | 6) if T::OWN_SIZES >= 6 => self.sized::<T, 6>(&prior, detail),
            Some(7 | 8) if T::OWN_SIZES >= 8 => self.sized::<T, 8>(&prior, detail),
            _ => T::apart(OfAnySize { packed: self, prior: &prior, detail }),
        }
    }

    #[inline(always)]
    fn sized<T: Lanes, const N: usize>(&self, prior: &Prior<'_, T>, detail: Detail) -> Option<Said<T>> {
        T::apart(OfSize::<T, N> { packed: self, prior, detail })
    }

    /// All phases, each matrix read from its numbers by what reads triangles of so many rows, matrices, and data.
    #[inline(always)]
    fn phases<M, D>(
        &self,
        lanes: usize,
        upper: impl Fn(usize, &[f64]) -> M,
        matrix: impl Fn((usize, usize), &[f64]) -> M,
        data: impl Fn((usize, usize), &[f64]) -> D,
    ) -> Vec<Phase<M, D>> {
        let mut from = lanes;
        let mut take = |entries: usize| {
            from += entries * lanes;
            &self.numbers[from - entries * lanes..from]
        };
        let mut phases = Vec::with_capacity(self.shape.phases.len());
        let mut before = 0;
        for phase in &self.shape.phases {
            let q = phase.size;
            let factor = upper(q, take(q * (q + 1) / 2));
            let data = data((q, self.shape.columns), take(q * self.shape.columns));
            let mut link = None;
            if let Some(rows) = phase.noise {
                let sensitivity = matrix((q, before), take(q * before));
                link = Some(Link { sensitivity, root: matrix((rows, q), take(rows * q)) });
            }
            phases.push(Phase { own: phase.own.clone(), factor, data, link });
            before = q;
        }
        phases
    }
}

/// Puts the numbers of a class where the first of every so many stands.
fn put(chained: &Chained, to: &mut [f64], every: usize) {
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

/// The same of a test by itself, to the bits of [`Chained::new`].
fn put_test(chain: &Chain, (ranges, frame): (&[Range<usize>], &Frame), to: &mut [f64], every: usize) {
    let mut at = 0;
    let mut write = |x: f64| {
        to[at] = x;
        at += every;
    };
    write(1.0);
    let (mut sigma, mut before) = (Vec::new(), Vec::new());
    let (mut scale, mut scale_before) = (Vec::new(), Vec::new());
    for (phase, own) in chain.phases.iter().zip(ranges) {
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
        (0..q).for_each(|i| write(phase.data[i] - told(phase, i, &sigma)));
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

/// An upper triangle from its numbers by rows.
#[inline(always)]
fn upper<T: kalfit_lanes::Real>(q: usize, mut numbers: impl Iterator<Item = T>) -> Rows<T> {
    let mut rows = Rows::zeros(q, q);
    for i in 0..q {
        for x in &mut rows.row_mut(i)[i..] {
            if let Some(number) = numbers.next() {
                *x = number;
            }
        }
    }
    rows
}

/// All that the classes say, by matrices of any size.
struct OfAnySize<'a, T> {
    packed: &'a Packed,
    prior: &'a Prior<'a, T>,
    detail: Detail,
}

impl<T: Lanes> Part for OfAnySize<'_, T> {
    type Output = Option<Said<T>>;

    #[inline(always)]
    fn run(self) -> Option<Said<T>> {
        let phases = self.packed.phases(T::COUNT, upper_rows::<T>, rows::<T>, rows::<T>);
        Phases::<Plain<T>> { phases: &phases, count: self.packed.count() }.said(self.prior, self.detail)
    }
}

#[inline(always)]
fn rows<T: Lanes>((rows, columns): (usize, usize), numbers: &[f64]) -> Rows<T> {
    let mut data = Vec::with_capacity(rows * columns);
    for x in numbers.chunks_exact(T::COUNT) {
        data.push(T::load(x));
    }
    Rows::from_vec(rows, columns, data)
}

#[inline(always)]
fn upper_rows<T: Lanes>(q: usize, numbers: &[f64]) -> Rows<T> {
    let mut rows = Rows::zeros(q, q);
    let mut numbers = numbers.chunks_exact(T::COUNT);
    for i in 0..q {
        for (x, from) in rows.row_mut(i)[i..].iter_mut().zip(&mut numbers) {
            *x = T::load(from);
        }
    }
    rows
}

/// The same by matrices of at most N rows and columns.
struct OfSize<'a, T, const N: usize> {
    packed: &'a Packed,
    prior: &'a Prior<'a, T>,
    detail: Detail,
}

impl<T: Lanes, const N: usize> Part for OfSize<'_, T, N> {
    type Output = Option<Said<T>>;

    #[inline(always)]
    fn run(self) -> Option<Said<T>> {
        let phases = self.packed.phases(T::COUNT, upper_square::<T, N>, square::<T, N>, column::<T, N>);
        Phases::<Fixed<T, N>> { phases: &phases, count: self.packed.count() }.said(self.prior, self.detail)
    }
}

#[inline(always)]
fn square<T: Lanes, const N: usize>((_, columns): (usize, usize), numbers: &[f64]) -> [[T; N]; N] {
    let mut square = [[T::splat(0.0); N]; N];
    if columns > 0 {
        for (row, from) in square.iter_mut().zip(numbers.chunks_exact(columns * T::COUNT)) {
            for (x, from) in row.iter_mut().zip(from.chunks_exact(T::COUNT)) {
                *x = T::load(from);
            }
        }
    }
    square
}

#[inline(always)]
fn upper_square<T: Lanes, const N: usize>(q: usize, numbers: &[f64]) -> [[T; N]; N] {
    let mut square = [[T::splat(0.0); N]; N];
    let mut from = 0;
    for (i, row) in square[..q].iter_mut().enumerate() {
        for x in &mut row[i..q] {
            *x = T::load(&numbers[from..]);
            from += T::COUNT;
        }
    }
    square
}

#[inline(always)]
fn column<T: Lanes, const N: usize>(_: (usize, usize), numbers: &[f64]) -> [T; N] {
    let mut column = [T::splat(0.0); N];
    for (x, from) in column.iter_mut().zip(numbers.chunks_exact(T::COUNT)) {
        *x = T::load(from);
    }
    column
}
