//! The data-dependent part of the backward pass of tests that differ in their data only, one test in each lane. The
//! equations of one step are:
//!
//! ```text
//! u = ē/S - K'r        ∂ℓ/∂R: ½u²        ∂ℓ/∂d: u        r ← r + hu        ∂ℓ/∂h: u (x̄⁻ + P⁻r)
//! ∂ℓ/∂Q: ½rr'        ∂ℓ/∂b: r        ∂ℓ/∂φ: r (x̄ + Pφ'r)'        r ← φ'r
//! ```
#![expect(non_snake_case, reason = "the letters of the theory: P, K")]

use kalfit_lanes::{Kernel, Lanes, MAX_LANES};

use crate::reduce::segments::SegmentedStretch;
use crate::reduce::segments::strands::StretchData;
use crate::reduce::{
    Common, Design, DesignStep, Gains, MeasuredCells, Scan, Stretch, Transition, advance, at, correct_mean, innovation,
    with_states,
};
use crate::score::backward::{
    AdjointsWanted, DataSums, EqualStretch, RecordSegment, RecordSegments, absorb, advance_transposed, smoothing_error,
};
use crate::score::classes::equal::EqualDataBackward;
use crate::score::pullback::{PullbackFactors, ResponseEntry};
use crate::score::segments::{DataAdjoints, ForwardStretch};
use kalfit_model::Test;

/// The design, gains and segments that the tests of a class share.
#[derive(Debug)]
pub(super) struct ClassShared<'a> {
    pub(super) design: &'a Design,
    pub(super) gains: &'a Gains,
    pub(super) start: &'a [f64],
    pub(super) inputs: &'a [f64],
    pub(super) cells: &'a MeasuredCells,
    pub(super) record: &'a RecordSegments<'a>,
    pub(super) wanted: AdjointsWanted,
    /// Chain rule of the representative steps.
    pub(super) response: &'a PullbackFactors,
}

/// One test of a class, with the x̂ and r of this test.
#[derive(Debug, Clone)]
pub(crate) struct ClassMember<'a> {
    pub(crate) test: &'a Test,
    /// x̂, p values, in the order of the kernels.
    pub(crate) mean: Vec<f64>,
    /// r after the last step, from later phases; empty where none follow.
    pub(crate) ending: Vec<f64>,
}

/// Computes Σ factor × adjoint of each test: tests × slots of the chain rule, by rows.
pub(super) struct DataBackward<'a> {
    pub(super) shared: &'a ClassShared<'a>,
    pub(super) tests: &'a [ClassMember<'a>],
}

impl Kernel for DataBackward<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Vec<f64> {
        let slots = self.shared.response.slots.len();
        let mut totals = vec![0.0; self.tests.len() * slots];
        let mut pass = DataBackwardState::<T>::new(self.shared);
        let mut lanes = [0.0; MAX_LANES];
        for (tests, totals) in self.tests.chunks(T::COUNT).zip(totals.chunks_mut((T::COUNT * slots).max(1))) {
            pass.forward(self.shared, tests);
            pass.back(self.shared, tests);
            for (slot, sum) in pass.sums.iter().enumerate() {
                sum.store(&mut lanes);
                for lane in 0..tests.len() {
                    totals[lane * slots + slot] = lanes[lane];
                }
            }
        }
        totals
    }
}

/// State of the passes over one block of tests.
struct DataBackwardState<T> {
    /// x̄ in the forward pass, r in the backward pass.
    x: Vec<T>,
    /// r after a transition, of the states that move.
    moved: Vec<T>,
    work: Vec<T>,
    /// z - d of each scalar measurement before the forward pass, ē after it; in lanes.
    e: Vec<f64>,
    /// x̄ before each transition (`left`) and before each measurement (`before`) of the representative steps, where P
    /// is wanted too.
    left: Vec<T>,
    before: Vec<T>,
    /// For each segment of equal steps: x̄ of all states before it, then x̄ of the moving states at the start of each
    /// block.
    marks: Vec<T>,
    /// The forward pass over each stretch that is cut into segments.
    cut: Vec<ForwardStretch>,
    /// Σ factor × adjoint, by slot.
    sums: Vec<T>,
}

/// Index of the next measurement, and index of the next transition, counted over the representative steps.
#[derive(Debug, Clone, Copy, Default)]
struct Cursor {
    row: usize,
    transition: usize,
}

/// One number of each test, in lanes; lanes beyond the last test repeat the last test.
#[inline(always)]
fn in_lanes<T: Lanes>(tests: &[ClassMember<'_>], mut number: impl FnMut(&ClassMember<'_>) -> f64) -> T {
    let mut lanes = [0.0; MAX_LANES];
    for lane in 0..T::COUNT {
        lanes[lane] = number(&tests[lane.min(tests.len() - 1)]);
    }
    T::load(&lanes)
}

impl<T: Lanes> DataBackwardState<T> {
    fn new(shared: &ClassShared<'_>) -> DataBackwardState<T> {
        let (zero, n, response) = (T::splat(0.0), shared.design.frame.n, shared.response);
        let wanted = |is: bool, many: usize| if is { many * n } else { 0 };
        DataBackwardState {
            x: vec![zero; n],
            moved: vec![zero; n],
            work: Vec::new(),
            e: vec![0.0; shared.cells.len() * T::COUNT],
            left: vec![zero; wanted(shared.wanted.motion, response.moves.len())],
            before: vec![zero; wanted(shared.wanted.equation, response.rows.len())],
            marks: Vec::new(),
            cut: Vec::new(),
            sums: vec![zero; response.slots.len()],
        }
    }

    /// The forward pass: x_0 = a + Ax̂, and the filter from there.
    #[inline(always)]
    fn forward(&mut self, shared: &ClassShared<'_>, tests: &[ClassMember<'_>]) {
        let frame = &*shared.design.frame;
        let (n, p) = (frame.n, frame.p);
        for i in 0..n {
            self.x[i] = T::splat(shared.start[i]);
        }
        for k in 0..p {
            let mean = in_lanes::<T>(tests, |own| own.mean[k]);
            for i in 0..n {
                let A = frame.sensitivity[i * p + k];
                if A != 0.0 {
                    self.x[i] = T::splat(A).fma(mean, self.x[i]);
                }
            }
        }
        let numbers: [&[f64]; MAX_LANES] =
            std::array::from_fn(|lane| tests[lane.min(tests.len() - 1)].test.all_numbers());
        shared.cells.write(&numbers[..T::COUNT], T::COUNT, &mut self.e);
        self.marks.clear();
        self.cut.clear();
        let (mut at, mut input) = (Cursor::default(), 0);
        for segment in &shared.record.segments {
            match segment {
                RecordSegment::Steps(steps) => {
                    for step in steps {
                        self.step_forward(shared, step, (&mut at, &mut input));
                    }
                }
                RecordSegment::Equal(equal) => {
                    self.equal_forward(shared, equal);
                    at.row += 1;
                    at.transition += usize::from(equal.stretch.transition.is_some());
                }
                RecordSegment::Cut(stretch, segments) => {
                    self.cut_forward(segments);
                    at.row += 1;
                    at.transition += usize::from(stretch.transition.is_some());
                }
            }
        }
    }

    /// The forward pass over a stretch that is cut into segments.
    #[inline(always)]
    fn cut_forward(&mut self, segments: &SegmentedStretch) {
        let mut x = self.of_states(segments);
        self.cut.push(ForwardStretch::new(segments, self.cut_data(segments), &mut x));
        self.set_states(segments, &x);
    }

    /// x̄ or r of the states of segments, in lanes.
    #[inline(always)]
    fn of_states(&self, segments: &SegmentedStretch) -> Vec<f64> {
        let mut numbers = vec![0.0; segments.prefix.size() * T::COUNT];
        for (numbers, &state) in numbers.chunks_exact_mut(T::COUNT).zip(&segments.prefix.states) {
            self.x[state].store(numbers);
        }
        numbers
    }

    #[inline(always)]
    fn set_states(&mut self, segments: &SegmentedStretch, numbers: &[f64]) {
        for (k, &state) in segments.prefix.states.iter().enumerate() {
            self.x[state] = at(numbers, k);
        }
    }

    #[inline(always)]
    fn cut_data(&self, segments: &SegmentedStretch) -> StretchData<'_> {
        StretchData { values: &self.e[segments.rows.start * T::COUNT..segments.rows.end * T::COUNT], tests: T::COUNT }
    }

    #[inline(always)]
    fn step_forward(
        &mut self,
        shared: &ClassShared<'_>,
        step: &DesignStep<'_>,
        (now, input): (&mut Cursor, &mut usize),
    ) {
        let frame = &*shared.design.frame;
        let (n, r) = (frame.n, frame.r);
        if let Some(transition) = step.transition {
            if !self.left.is_empty() {
                self.left[now.transition * n..][..n].copy_from_slice(&self.x);
            }
            advance(&mut self.x, 1, transition.common(), &mut self.work);
            for &state in &frame.driven {
                self.x[state as usize] = self.x[state as usize] + T::splat(shared.inputs[*input]);
                *input += 1;
            }
            now.transition += 1;
        }
        for (line, row) in step.lines.clone().zip(step.rows.clone()) {
            if !self.before.is_empty() {
                self.before[now.row * n..][..n].copy_from_slice(&self.x);
            }
            let ((states, h), (_, K, _)) = (shared.design.terms(line), shared.gains.row(row));
            let e = innovation(&self.x, (states, Common(h)), at::<T>(&self.e, row));
            correct_mean(Common(K), e, &mut self.x[..r]);
            e.store(&mut self.e[row * T::COUNT..]);
            now.row += 1;
        }
    }

    #[inline(always)]
    fn equal_forward(&mut self, shared: &ClassShared<'_>, equal: &EqualStretch<'_>) {
        let DataBackwardState { x, e, marks, .. } = self;
        marks.extend_from_slice(x);
        let (stretch, gains) = (&equal.stretch, (shared.gains, equal.piece));
        let e = &mut e[stretch.rows.start * T::COUNT..stretch.rows.end * T::COUNT];
        Scan { design: shared.design, stretch, gains, x, e, marks: Some((marks, equal.block)) }.run(equal.states);
    }

    /// The backward pass, from r of the last state to r of x_0.
    #[inline(always)]
    fn back(&mut self, shared: &ClassShared<'_>, tests: &[ClassMember<'_>]) {
        for i in 0..self.x.len() {
            self.x[i] = in_lanes::<T>(tests, |own| own.ending.get(i).copied().unwrap_or(0.0));
        }
        for sum in &mut self.sums {
            *sum = T::splat(0.0);
        }
        let response = shared.response;
        let mut at = Cursor { row: response.rows.len(), transition: response.moves.len() };
        for segment in shared.record.segments.iter().rev() {
            match segment {
                RecordSegment::Steps(steps) => {
                    for step in steps.iter().rev() {
                        self.step_back(shared, step, &mut at);
                    }
                }
                RecordSegment::Equal(equal) => {
                    at.row -= 1;
                    at.transition -= usize::from(equal.stretch.transition.is_some());
                    self.equal_back(shared, equal, at);
                }
                RecordSegment::Cut(stretch, segments) => {
                    at.row -= 1;
                    at.transition -= usize::from(stretch.transition.is_some());
                    self.cut_back(shared, (stretch, segments), at);
                }
            }
        }
        for entry in response.entries(&response.mean) {
            self.add(response, entry, self.x[entry.i]);
        }
        for entry in response.entries(&response.variance) {
            self.add(response, entry, T::splat(0.5) * self.x[entry.i] * self.x[entry.j]);
        }
    }

    #[inline(always)]
    fn step_back(&mut self, shared: &ClassShared<'_>, step: &DesignStep<'_>, at: &mut Cursor) {
        for (line, row) in step.lines.clone().zip(step.rows.clone()).rev() {
            at.row -= 1;
            self.measured(shared, (line, row), at.row);
        }
        if let Some(transition) = step.transition {
            at.transition -= 1;
            self.moved(shared, transition, at.transition);
        }
    }

    /// The backward pass over a stretch that is cut into segments.
    #[inline(always)]
    fn cut_back(
        &mut self,
        shared: &ClassShared<'_>,
        (stretch, segments): (&Stretch<'_>, &SegmentedStretch),
        at: Cursor,
    ) {
        let forward = self.cut.pop().expect("the forward pass has stored the stretch");
        let mut r = self.of_states(segments);
        let found = forward.back(segments, (self.cut_data(segments), shared.wanted), &mut r);
        self.set_states(segments, &r);
        let (response, half, prefix) = (shared.response, T::splat(0.5), &*segments.prefix);
        let lanes = |number: &dyn Fn(&DataAdjoints) -> f64| {
            let mut lanes = [0.0; MAX_LANES];
            lanes.iter_mut().zip(&found).for_each(|(lane, own)| *lane = number(own));
            T::load(&lanes)
        };
        let place = |state: usize| prefix.place(state).expect("the states of a segment include those of its steps");
        let own = &response.rows[at.row];
        self.add_span(response, own.noise, half * lanes(&DataAdjoints::uu));
        self.add_span(response, own.value, -lanes(&DataAdjoints::u));
        for entry in response.entries(&own.h) {
            self.add(response, entry, lanes(&|own| own.h(place(entry.i))));
        }
        let Some(transition) = stretch.transition else { return };
        let (own, pattern) = (&response.moves[at.transition], &transition.pattern);
        for entry in response.entries(&own.q) {
            let both = lanes(&|own| own.rr(entry.i, entry.j));
            self.add(response, entry, if entry.i == entry.j { half * both } else { both });
        }
        for entry in response.entries(&own.phi) {
            let i = place(pattern.moved[entry.i].state as usize);
            self.add(response, entry, lanes(&|own| own.phi(i, place(entry.j))));
        }
    }

    #[inline(always)]
    fn equal_back(&mut self, shared: &ClassShared<'_>, equal: &EqualStretch<'_>, at: Cursor) {
        let (n, states) = (self.x.len(), equal.states);
        let start = self.marks.len() - n - equal.blocks().count() * states;
        let DataBackwardState { x: r, e, marks, .. } = &mut *self;
        let (first, marks) = marks[start..].split_at(n);
        let first = first.to_vec();
        let e = &e[equal.stretch.rows.start * T::COUNT..equal.stretch.rows.end * T::COUNT];
        with_states!(states, N => {
            let data_sums = T::apart(EqualDataBackward::<T, N> { stretch: equal, first: &first, marks, e, r });
            self.add_equal_adjoints(shared, equal, (at, &first), &data_sums);
        });
        self.marks.truncate(start);
    }

    /// Adds the adjoints of equal steps to the sums of the slots, and to r of the constant states. `first`: x̄ before
    /// these steps.
    #[inline(always)]
    fn add_equal_adjoints<const N: usize>(
        &mut self,
        shared: &ClassShared<'_>,
        equal: &EqualStretch<'_>,
        (at, first): (Cursor, &[T]),
        data_sums: &DataSums<T, N>,
    ) {
        let (response, half) = (shared.response, T::splat(0.5));
        let own = &response.rows[at.row];
        self.add_span(response, own.noise, half * data_sums.uu);
        self.add_span(response, own.value, -data_sums.u);
        for entry in response.entries(&own.h) {
            let bar = if entry.i < N { data_sums.h[entry.i] } else { data_sums.u * first[entry.i] };
            self.add(response, entry, bar);
        }
        let (states, h) = shared.design.terms(equal.stretch.lines.start);
        for (&state, &h) in states.iter().zip(h).filter(|(state, _)| **state as usize >= N) {
            self.x[state as usize] = T::splat(h).fma(data_sums.u, self.x[state as usize]);
        }
        let Some(transition) = equal.stretch.transition else { return };
        let (own, pattern) = (&response.moves[at.transition], &transition.pattern);
        for entry in response.entries(&own.q) {
            let both = data_sums.rr[entry.i.max(entry.j)][entry.i.min(entry.j)];
            self.add(response, entry, if entry.i == entry.j { half * both } else { both });
        }
        for entry in response.entries(&own.phi) {
            let i = pattern.moved[entry.i].state as usize;
            let bar = if entry.j < N { data_sums.phi[i][entry.j] } else { data_sums.r[i] * first[entry.j] };
            self.add(response, entry, bar);
        }
        for (i, j, phi) in transition.entries().filter(|&(_, j, _)| j >= N) {
            self.x[j] = T::splat(phi).fma(data_sums.r[i], self.x[j]);
        }
    }

    /// The backward pass through a scalar measurement.
    #[inline(always)]
    fn measured(&mut self, shared: &ClassShared<'_>, (line, row): (usize, usize), representative_row: usize) {
        let (weight, K, _) = shared.gains.row(row);
        if weight == 0.0 {
            return; // no information
        }
        let (states, h) = shared.design.terms(line);
        let (response, own) = (shared.response, &shared.response.rows[representative_row]);
        let u = smoothing_error(at(&self.e, row), (T::splat(weight), Common(K)), &self.x[..K.len()]);
        self.add_span(response, own.noise, T::splat(0.5) * u * u);
        self.add_span(response, own.value, -u);
        absorb((states, Common(h)), &[u], &mut self.x);
        let (n, r) = (self.x.len(), K.len());
        for entry in response.entries(&own.h) {
            let P = shared.record.before.get((representative_row * r + entry.i) * r..).unwrap_or(&[]);
            let smoothed =
                self.smoothed(self.before[representative_row * n + entry.i], (entry.i < r).then_some(&P[..r]));
            self.add(response, entry, u * smoothed);
        }
    }

    /// The backward pass through a transition.
    #[inline(always)]
    fn moved(&mut self, shared: &ClassShared<'_>, transition: &Transition, number: usize) {
        let (response, own) = (shared.response, &shared.response.moves[number]);
        let (n, r, pattern) = (self.x.len(), shared.design.frame.r, &transition.pattern);
        for entry in response.entries(&own.input) {
            self.add(response, entry, self.x[entry.i]);
        }
        for entry in response.entries(&own.q) {
            let both = self.x[entry.i] * self.x[entry.j];
            self.add(response, entry, if entry.i == entry.j { T::splat(0.5) * both } else { both });
        }
        for (place, row) in pattern.moved.iter().enumerate() {
            self.moved[place] = self.x[row.state as usize];
        }
        advance_transposed(&mut self.x, (n, 1), transition.common(), &mut self.work);
        for entry in response.entries(&own.phi) {
            let P = shared.record.left.get((number * r + entry.j) * r..).unwrap_or(&[]);
            let smoothed = self.smoothed(self.left[number * n + entry.j], (entry.j < r).then_some(&P[..r]));
            self.add(response, entry, self.moved[entry.i] * smoothed);
        }
    }

    /// x̄ + Pr of one state; `P`: the row of P of this state, if the state is noisy.
    #[inline(always)]
    fn smoothed(&self, x: T, P: Option<&[f64]>) -> T {
        let mut smoothed = x;
        if let Some(P) = P {
            for (l, &P) in P.iter().enumerate() {
                smoothed = T::splat(P).fma(self.x[l], smoothed);
            }
        }
        smoothed
    }

    #[inline(always)]
    fn add(&mut self, response: &PullbackFactors, entry: &ResponseEntry, bar: T) {
        self.add_span(response, entry.span, bar);
    }

    #[inline(always)]
    fn add_span(&mut self, response: &PullbackFactors, span: (u32, u32), bar: T) {
        for &(slot, factor) in response.factors(span) {
            let sum = &mut self.sums[slot as usize];
            *sum = T::splat(factor).fma(bar, *sum);
        }
    }
}
