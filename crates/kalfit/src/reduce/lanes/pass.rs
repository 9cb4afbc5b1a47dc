//! The data pass over a block: the formulas of [`data`](crate::reduce::data), with a test in each lane.
#![expect(non_snake_case, reason = "the letters of the theory: K, h, T, R")]

use kalfit_lanes::{Kernel, Lanes};

use crate::reduce::design::{Design, Pattern};
use crate::reduce::gains::Gains;
use crate::reduce::lanes::block::Room;
use crate::reduce::lanes::squares;

/// What a pass takes from the designs of its tests: numbers that are the same in all lanes, or each lane's own.
pub(super) trait Numbers<T> {
    /// Entry `term` of φ in a run.
    fn phi(&self, run: usize, term: usize) -> T;
    /// Coefficient `term` of the lines.
    fn h(&self, term: usize) -> T;
    /// 1/S of a row.
    fn weight(&self, row: usize) -> T;
    /// Entry `i` of K of a row.
    fn K(&self, row: usize, i: usize) -> T;
    /// Entry `k` of T of a row.
    fn T(&self, row: usize, k: usize) -> T;
    /// An entry of R, packed.
    fn R(&self, at: usize) -> T;
    /// Whether the test in a lane ends with a run.
    fn ends(&self, run: usize, lane: usize) -> bool;
}

/// Tests of one design.
struct Shared<'a> {
    design: &'a Design,
    gains: &'a Gains,
}

impl<T: Lanes> Numbers<T> for Shared<'_> {
    #[inline(always)]
    fn phi(&self, run: usize, term: usize) -> T {
        self.design
            .transition(&self.design.runs[run])
            .map_or(T::splat(0.0), |transition| T::splat(transition.phi[term]))
    }

    #[inline(always)]
    fn h(&self, term: usize) -> T {
        T::splat(self.design.h[term])
    }

    #[inline(always)]
    fn weight(&self, row: usize) -> T {
        T::splat(self.gains.gains[row * (1 + self.gains.r)])
    }

    #[inline(always)]
    fn K(&self, row: usize, i: usize) -> T {
        T::splat(self.gains.gains[row * (1 + self.gains.r) + 1 + i])
    }

    #[inline(always)]
    fn T(&self, row: usize, k: usize) -> T {
        T::splat(self.gains.sensitivities[row * self.gains.p + k])
    }

    #[inline(always)]
    fn R(&self, at: usize) -> T {
        T::splat(self.gains.factor[at])
    }

    #[inline(always)]
    fn ends(&self, run: usize, _: usize) -> bool {
        run + 1 == self.design.runs.len()
    }
}

/// The data of tests, in lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Side<'a> {
    pub(super) start: &'a [f64],
    pub(super) inputs: &'a [f64],
    pub(super) values: &'a [f64],
}

/// x̂ ← φx̂ + b, e = z - d - h'x̂, x̂ ← x̂ + Ke, then the best ξ of each test.
pub(super) struct Pass<'a> {
    pub(super) design: &'a Design,
    pub(super) gains: &'a Gains,
    pub(super) data: Side<'a>,
    pub(super) room: &'a mut Room,
}

impl Kernel for Pass<'_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let Pass { design, gains, data, room } = self;
        innovate::<T, _>(design, &Shared { design, gains }, data, room);
    }
}

/// The pass over tests of designs of one shape, of which `design` is one.
#[inline(always)]
pub(super) fn innovate<T: Lanes, N: Numbers<T>>(design: &Design, numbers: &N, data: Side<'_>, room: &mut Room) {
    let frame = &*design.frame;
    room.x.clear();
    room.x.extend_from_slice(data.start);
    room.e.resize(data.values.len(), 0.0);
    room.d.clear();
    room.d.resize(frame.p * T::COUNT, 0.0);
    room.last.resize(frame.n * T::COUNT, 0.0);
    let (mut square, mut line, mut row, mut input) = (T::splat(0.0), 0, 0, 0);
    for (at_run, run) in design.runs.iter().enumerate() {
        for _ in 0..run.count {
            if let Some(transition) = design.transition(run) {
                advance::<T, _>(&mut room.x, (numbers, at_run), &transition.pattern, &mut room.moved);
                for &state in &frame.driven {
                    let x = at::<T>(&room.x, state as usize) + at::<T>(data.inputs, input);
                    put(&mut room.x, state as usize, x);
                    input += 1;
                }
            }
            for line in line..run.lines {
                square = measure::<T, _>((design, line), (numbers, row), data.values, room, square);
                row += 1;
            }
        }
        line = run.lines;
        for lane in (0..T::COUNT).filter(|&lane| numbers.ends(at_run, lane)) {
            for state in 0..frame.n {
                room.last[state * T::COUNT + lane] = room.x[state * T::COUNT + lane];
            }
        }
    }
    squares::solve::<T, _>(numbers, frame.p, square, room);
}

/// x ← φx.
#[inline(always)]
fn advance<T: Lanes, N: Numbers<T>>(
    x: &mut [f64],
    (numbers, run): (&N, usize),
    pattern: &Pattern,
    moved: &mut Vec<f64>,
) {
    moved.resize(pattern.moved.len() * T::COUNT, 0.0);
    for (k, row) in pattern.moved.iter().enumerate() {
        let mut sum = T::splat(0.0);
        for term in row.start as usize..row.end as usize {
            sum = numbers.phi(run, term).fma(at::<T>(x, pattern.columns[term] as usize), sum);
        }
        put(moved, k, sum);
    }
    for (k, row) in pattern.moved.iter().enumerate() {
        put(x, row.state as usize, at::<T>(moved, k));
    }
}

/// A scalar measurement; e'S⁻¹e with it.
#[inline(always)]
fn measure<T: Lanes, N: Numbers<T>>(
    (design, line): (&Design, usize),
    (numbers, row): (&N, usize),
    values: &[f64],
    room: &mut Room,
    square: T,
) -> T {
    let (states, first) = (design.terms(line).0, if line == 0 { 0 } else { design.ends[line - 1] });
    let mut e = at::<T>(values, row);
    // states that move come last: what they add is waited for
    for (k, &state) in states.iter().enumerate().rev() {
        e = numbers.h(first + k).fnma(at::<T>(&room.x, state as usize), e);
    }
    for i in 0..design.frame.r {
        let x = numbers.K(row, i).fma(e, at::<T>(&room.x, i));
        put(&mut room.x, i, x);
    }
    put(&mut room.e, row, e);
    let weighted = e * numbers.weight(row);
    squares::add(numbers, row, weighted, &mut room.d);
    e.fma(weighted, square)
}

/// Number `k` of each test.
#[inline(always)]
pub(super) fn at<T: Lanes>(numbers: &[f64], k: usize) -> T {
    T::load(&numbers[k * T::COUNT..][..T::COUNT])
}

#[inline(always)]
pub(super) fn put<T: Lanes>(numbers: &mut [f64], k: usize, x: T) {
    x.store(&mut numbers[k * T::COUNT..][..T::COUNT]);
}
