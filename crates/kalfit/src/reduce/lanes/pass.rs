//! The data pass over a block: the formulas of [`data_pass`](crate::reduce::data_pass), with a test in each lane.

use kalfit_lanes::{Kernel, Lanes, Part};

use crate::reduce::data::FEW;
use crate::reduce::design::{Design, Moved, Pattern, Stretch};
use crate::reduce::gains::Gains;
use crate::reduce::lanes::numbers::{Numbers, Side, at, put};
use crate::reduce::lanes::room::Room;
use crate::reduce::lanes::squares;
use crate::reduce::scan::{BLOCK, Scan, scanned};

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
    fn gains(&self, row: usize) -> &[f64] {
        self.gains.weighted(&self.gains.pieces[self.gains.piece(row)], row)
    }

    #[inline(always)]
    fn sensitivities(&self, row: usize) -> &[f64] {
        self.gains.sensitive(&self.gains.pieces[self.gains.piece(row)], row)
    }

    #[inline(always)]
    fn of(row: &[f64], k: usize) -> T {
        T::splat(row[k])
    }

    #[inline(always)]
    fn R(&self, at: usize) -> T {
        T::splat(self.gains.factor[at])
    }

    const SCANS: bool = true;

    #[inline(always)]
    fn scan(&self, stretch: &Stretch<'_>, x: &mut [T], e: &mut [f64]) -> bool {
        let (design, gains) = (self.design, self.gains);
        let Some(states) = scanned(design, stretch) else { return false };
        let gains = (gains, &gains.pieces[gains.piece(stretch.rows.start)]);
        Scan { design, stretch, gains, x, e, marks: None }.run(states);
        true
    }
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

/// What a pass carries from row to row.
struct State<T> {
    x: Vec<T>,
    /// Work space of a transition.
    moved: Vec<T>,
    y: Vec<T>,
    /// e'S⁻¹e.
    square: T,
    /// What the last rows add to both: rounding grows with the number of blocks, not of rows.
    y_part: Vec<T>,
    square_part: T,
}

/// The pass over tests of designs of one shape, of which `design` is one.
#[inline(always)]
pub(super) fn innovate<T: Lanes, N: Numbers<T>>(design: &Design, numbers: &N, data: Side<'_>, room: &mut Room) {
    let frame = &*design.frame;
    room.e.resize(data.values.len(), 0.0);
    room.last.resize(frame.n * T::COUNT, 0.0);
    let mut state = State::<T>::new((frame.n, frame.p));
    for i in 0..frame.n {
        state.x[i] = at(data.start, i);
    }
    let (mut line, mut row, mut input) = (0, 0, 0);
    for (at_run, run) in design.runs.iter().enumerate() {
        if N::SCANS && run.count > FEW {
            let (x, y) = (&mut *state.x, &mut *state.y);
            let long = Long { numbers, stretch: design.stretch(at_run), values: data.values, x, y, e: &mut room.e };
            if let Some(square) = T::apart(long) {
                state.square = state.square + square;
                (line, row) = (run.lines, run.rows);
                continue;
            }
        }
        for _ in 0..run.count {
            if let Some(transition) = design.transition(run) {
                state.advance((numbers, at_run), &transition.pattern);
                for &driven in &frame.driven {
                    state.x[driven as usize] = state.x[driven as usize] + at(data.inputs, input);
                    input += 1;
                }
            }
            for line in line..run.lines {
                let e = state.measure((design, line), (numbers, row), at(data.values, row));
                put(&mut room.e, row, e);
                row += 1;
                if row % BLOCK == 0 {
                    state.add_up();
                }
            }
        }
        line = run.lines;
    }
    state.add_up();
    for (i, x) in state.x.iter().enumerate() {
        put(&mut room.last, i, *x);
    }
    room.d.resize(frame.p * T::COUNT, 0.0);
    for k in 0..frame.p {
        put(&mut room.d, k, state.y[k]);
    }
    squares::solve::<T, _>(numbers, frame.p, state.square, room);
}

/// A stretch of equal steps, if it is one that is gone over at once: x̂, y and innovations; e'S⁻¹e of it.
struct Long<'a, T, N> {
    numbers: &'a N,
    stretch: Stretch<'a>,
    values: &'a [f64],
    x: &'a mut [T],
    y: &'a mut [T],
    e: &'a mut [f64],
}

impl<T: Lanes, N: Numbers<T>> Part for Long<'_, T, N> {
    type Output = Option<T>;

    #[inline(always)]
    fn run(self) -> Option<T> {
        let Long { numbers, stretch, values, x, y, e } = self;
        let rows = stretch.rows.clone();
        let of = rows.start * T::COUNT..rows.end * T::COUNT;
        e[of.clone()].copy_from_slice(&values[of.clone()]);
        let scanned = numbers.scan(&stretch, x, &mut e[of]);
        if !scanned {
            return None;
        }
        Some(squares::weigh::<T, N>(numbers, rows, e, &[], y))
    }
}

impl<T: Lanes> State<T> {
    /// Of n states and p unknowns.
    #[inline(always)]
    fn new((n, p): (usize, usize)) -> State<T> {
        let zero = T::splat(0.0);
        let zeros = || vec![zero; p];
        State { x: vec![zero; n], moved: Vec::new(), y: zeros(), square: zero, y_part: zeros(), square_part: zero }
    }

    /// Takes the parts to the sums.
    #[inline(always)]
    fn add_up(&mut self) {
        let zero = T::splat(0.0);
        for (sum, part) in self.y.iter_mut().zip(&mut self.y_part) {
            *sum = *sum + std::mem::replace(part, zero);
        }
        self.square = self.square + std::mem::replace(&mut self.square_part, zero);
    }

    /// x ← φx.
    #[inline(always)]
    fn advance<N: Numbers<T>>(&mut self, (numbers, run): (&N, usize), pattern: &Pattern) {
        if let Some(states) = pattern.diagonal() {
            for (term, state) in states.enumerate() {
                self.x[state] = numbers.phi(run, term) * self.x[state];
            }
            return;
        }
        self.moved.clear();
        for row in &pattern.moved {
            self.moved.push(self.moved((numbers, run), (pattern, row)));
        }
        for (k, row) in pattern.moved.iter().enumerate() {
            self.x[row.state as usize] = self.moved[k];
        }
    }

    /// A row of φ, times x.
    #[inline(always)]
    fn moved<N: Numbers<T>>(&self, (numbers, run): (&N, usize), (pattern, row): (&Pattern, &Moved)) -> T {
        let mut sum = T::splat(0.0);
        for term in row.start as usize..row.end as usize {
            sum = numbers.phi(run, term).fma(self.x[pattern.columns[term] as usize], sum);
        }
        sum
    }

    /// The innovation of a scalar measurement, after which x and the sums have it.
    #[inline(always)]
    fn measure<N: Numbers<T>>(&mut self, (design, line): (&Design, usize), (numbers, row): (&N, usize), value: T) -> T {
        let (states, first) = (design.terms(line).0, if line == 0 { 0 } else { design.ends[line - 1] });
        let mut e = value;
        // states that move come last: what they add is waited for
        for (k, &state) in states.iter().enumerate().rev() {
            e = numbers.h(first + k).fnma(self.x[state as usize], e);
        }
        let gains = numbers.gains(row);
        for (i, x) in self.x[..design.frame.r].iter_mut().enumerate() {
            *x = N::of(gains, 1 + i).fma(e, *x);
        }
        let weighted = e * N::of(gains, 0);
        squares::add::<T, N>(numbers.sensitivities(row), weighted, &mut self.y_part);
        self.square_part = e.fma(weighted, self.square_part);
        e
    }
}
