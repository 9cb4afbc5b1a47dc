//! The data pass: innovations of tests under the gains of the designs, and sums over the innovations, one test per
//! lane.
#![expect(non_snake_case, reason = "the letters of the theory: K, R")]

use std::cell::Cell;

use kalfit_lanes::{Isa, Kernel, Lanes, Part};

use crate::reduce::data::Data;
use crate::reduce::design::{Design, Stretch, TransitionView};
use crate::reduce::entries::{Common, Entries};
use crate::reduce::gains::{GainSpan, Gains};
use crate::reduce::kernel;
use crate::reduce::lanes::least_squares;
use crate::reduce::lanes::numbers::{DataView, Numbers, Repeats, at, put};
use crate::reduce::lanes::workspace::DataWorkspace;
use crate::reduce::scan::{STEPS_PER_SUM, Scan, scanned};
use crate::reduce::segments::strands::StretchData;
use crate::reduce::segments::{FilteredStretch, SegmentedStretch, TestsInLanes};

/// A design that all lanes share, and the gains of the design.
struct SharedDesign<'a> {
    design: &'a Design,
    gains: &'a Gains,
    /// Index of the piece of the row visited last; rows are visited in order.
    piece: Cell<usize>,
}

impl<'a> SharedDesign<'a> {
    fn new(design: &'a Design, gains: &'a Gains) -> SharedDesign<'a> {
        SharedDesign { design, gains, piece: Cell::new(0) }
    }

    /// (piece that contains a row, end of the rows of the piece).
    #[inline(always)]
    fn piece(&self, row: usize) -> (&GainSpan, usize) {
        let (pieces, last) = (&self.gains.pieces, self.piece.get());
        let end = |at: usize| pieces.get(at + 1).map_or(usize::MAX, |next| next.row);
        if pieces[last].row <= row && row < end(last) {
            return (&pieces[last], end(last));
        }
        let at = self.gains.piece(row);
        self.piece.set(at);
        (&pieces[at], end(at))
    }
}

impl<T: Lanes> Numbers<T> for SharedDesign<'_> {
    type List<'a>
        = Common<'a>
    where
        Self: 'a;

    #[inline(always)]
    fn transition<'a>(&'a self, design: &'a Design, run: usize) -> Option<TransitionView<'a, Common<'a>>> {
        design.transition(&design.runs[run]).map(|transition| transition.common())
    }

    #[inline(always)]
    fn h(&self) -> Common<'_> {
        Common(&self.design.h)
    }

    #[inline(always)]
    fn gains(&self, row: usize) -> (T, Common<'_>) {
        let gains = self.gains.weighted(self.piece(row).0, row);
        (T::splat(gains[0]), Common(&gains[1..]))
    }

    #[inline(always)]
    fn sensitivities(&self, row: usize) -> Common<'_> {
        Common(self.gains.sensitivity_row(self.piece(row).0, row))
    }

    #[inline(always)]
    fn R(&self) -> Common<'_> {
        Common(&self.gains.factor)
    }

    #[inline(always)]
    fn repeats(&self, row: usize, end: usize) -> Repeats {
        let (piece, last) = self.piece(row);
        let (end, width) = (end.min(last), piece.width);
        Repeats { steady: (piece.row + piece.moving() * width).clamp(row, end), end, width }
    }

    #[inline(always)]
    fn segments(&self) -> &[SegmentedStretch] {
        &self.gains.segments
    }

    const CAN_SCAN: bool = true;

    #[inline(always)]
    fn scan(&self, stretch: &Stretch<'_>, x: &mut [T], e: &mut [f64]) -> bool {
        let (design, gains) = (self.design, self.gains);
        let Some(states) = scanned(design, stretch) else { return false };
        let gains = (gains, self.piece(stretch.rows.start).0);
        Scan { design, stretch, gains, x, e, marks: None }.run(states);
        true
    }
}

/// The data pass over tests of one design: x̂ ← φx̂ + b, e = z - d - h'x̂, x̂ ← x̂ + Ke, then the best ξ of each test.
pub(super) struct DataPass<'a> {
    pub(super) design: &'a Design,
    pub(super) gains: &'a Gains,
    pub(super) data: DataView<'a>,
    pub(super) scratch: &'a mut DataWorkspace,
}

impl Kernel for DataPass<'_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let DataPass { design, gains, data, scratch } = self;
        let shared = SharedDesign::new(design, gains);
        let square = run_innovations::<T, _, _>(design, &shared, data, scratch, &mut ());
        least_squares::solve::<T, _>((&shared, design), (square, data.values), scratch);
    }
}

/// The pass for the innovations of one test alone, without the best ξ.
struct InnovationPass<'a, L> {
    design: &'a Design,
    gains: &'a Gains,
    data: DataView<'a>,
    scratch: &'a mut DataWorkspace,
    observer: &'a mut L,
}

impl<L: InnovationObserver> Kernel for InnovationPass<'_, L> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let InnovationPass { design, gains, data, scratch, observer } = self;
        run_innovations::<T, _, _>(design, &SharedDesign::new(design, gains), data, scratch, observer);
    }
}

/// Computes the innovations of a single test, with the same bits as in a lane of a batch.
pub(crate) fn innovations<L: InnovationObserver>(
    (design, gains): (&Design, &Gains),
    data: &Data,
    scratch: &mut DataWorkspace,
    observer: &mut L,
) {
    let data = DataView::of(data);
    Isa::best().alone().run(InnovationPass { design, gains, data, scratch, observer });
}

/// Runs the data pass of a single test, with the same bits as in a lane of a batch, and writes the results to
/// `scratch`.
pub(crate) fn pass_alone((design, gains): (&Design, &Gains), data: &Data, scratch: &mut DataWorkspace) {
    Isa::best().alone().run(DataPass { design, gains, data: DataView::of(data), scratch });
}

/// Observes the innovations of a pass.
pub(crate) trait InnovationObserver {
    /// True if every innovation must be observed, so that no stretch is scanned.
    const OBSERVES_EVERY_ROW: bool;

    /// Observes the innovation at (row, line), with x̂ before the update.
    fn observe<T: Lanes>(&mut self, at: (usize, usize), e: T, x: &[T]);
}

impl InnovationObserver for () {
    const OBSERVES_EVERY_ROW: bool = false;

    #[inline(always)]
    fn observe<T: Lanes>(&mut self, _: (usize, usize), _: T, _: &[T]) {}
}

/// The state of a pass from row to row.
struct MeanState<T> {
    x: Vec<T>,
    /// Work space of a transition.
    work: Vec<T>,
    y: Vec<T>,
    /// Sum of e'S⁻¹e over the completed blocks of steps.
    square: T,
    /// Sums y and e'S⁻¹e over the current block of steps only, so that rounding grows with the number of blocks, not
    /// the number of rows.
    y_part: Vec<T>,
    square_part: T,
}

/// Runs the pass over tests whose designs have the shape of `design`. Returns e'S⁻¹e; y goes to `scratch.d`.
#[inline(always)]
pub(super) fn run_innovations<T: Lanes, N: Numbers<T>, L: InnovationObserver>(
    design: &Design,
    numbers: &N,
    data: DataView<'_>,
    scratch: &mut DataWorkspace,
    observer: &mut L,
) -> T {
    let frame = &*design.frame;
    if scratch.e.capacity() < data.values.len() {
        // memory of zeros is not touched where no innovation is written, as in segments
        scratch.e = vec![0.0; data.values.len()];
    }
    scratch.e.resize(data.values.len(), 0.0);
    scratch.x.resize(frame.n * T::COUNT, 0.0);
    let mut state = MeanState::<T>::new((frame.n, frame.p));
    for i in 0..frame.n {
        state.x[i] = at(data.start, i);
    }
    scratch.stretches.clear();
    let mut segments = numbers.segments().iter().peekable();
    let (mut line, mut row, mut input, mut step) = (0, 0, 0, 0);
    for (at_run, run) in design.runs.iter().enumerate() {
        if let Some(stretch) = segments.next_if(|stretch| stretch.rows == (row..run.rows)) {
            scratch.stretches.push(state.segments(stretch, data.values));
            (line, row, step) = (run.lines, run.rows, run.steps);
            continue;
        }
        if N::CAN_SCAN && !L::OBSERVES_EVERY_ROW && design.is_long(run.count) {
            let (x, y) = (&mut *state.x, &mut *state.y);
            let stretch_scan = StretchScan {
                numbers,
                design,
                stretch: design.stretch(at_run),
                values: data.values,
                x,
                y,
                e: &mut scratch.e,
            };
            if let Some(square) = T::apart(stretch_scan) {
                state.square = state.square + square;
                (line, row, step) = (run.lines, run.rows, run.steps);
                continue;
            }
        }
        for _ in 0..run.count {
            if let Some(transition) = numbers.transition(design, at_run) {
                kernel::advance(&mut state.x, 1, transition, &mut state.work);
                for &driven in &frame.driven {
                    state.x[driven as usize] = state.x[driven as usize] + at(data.inputs, input);
                    input += 1;
                }
            }
            for line in line..run.lines {
                let e = state.measure((design, line), (numbers, row), at(data.values, row), observer);
                put(&mut scratch.e, row, e);
                row += 1;
            }
            step += 1;
            if step % STEPS_PER_SUM == 0 {
                state.flush_block();
            }
        }
        line = run.lines;
    }
    state.flush_block();
    for (i, x) in state.x.iter().enumerate() {
        put(&mut scratch.x, i, *x);
    }
    scratch.d.resize(frame.p * T::COUNT, 0.0);
    for k in 0..frame.p {
        put(&mut scratch.d, k, state.y[k]);
    }
    state.square
}

/// The scan of a stretch of equal steps: updates x̂, y and e. Gives e'S⁻¹e of the stretch; `None` if the
/// stretch cannot be scanned.
struct StretchScan<'a, T, N> {
    numbers: &'a N,
    design: &'a Design,
    stretch: Stretch<'a>,
    values: &'a [f64],
    x: &'a mut [T],
    y: &'a mut [T],
    e: &'a mut [f64],
}

impl<T: Lanes, N: Numbers<T>> Part for StretchScan<'_, T, N> {
    type Output = Option<T>;

    #[inline(always)]
    fn run(self) -> Option<T> {
        let StretchScan { numbers, design, stretch, values, x, y, e } = self;
        let rows = stretch.rows.clone();
        let of = rows.start * T::COUNT..rows.end * T::COUNT;
        e[of.clone()].copy_from_slice(&values[of.clone()]);
        let scanned = numbers.scan(&stretch, x, &mut e[of]);
        if !scanned {
            return None;
        }
        Some(least_squares::weighted_sums::<T, N>((numbers, design), rows, e, &[], y))
    }
}

impl<T: Lanes> MeanState<T> {
    /// State for n states and p unknowns, with sums of zero.
    #[inline(always)]
    fn new((n, p): (usize, usize)) -> MeanState<T> {
        let zero = T::splat(0.0);
        let zeros = || vec![zero; p];
        MeanState { x: vec![zero; n], work: Vec::new(), y: zeros(), square: zero, y_part: zeros(), square_part: zero }
    }

    /// Filters the rows of a stretch that is cut into segments.
    #[inline(always)]
    fn segments(&mut self, stretch: &SegmentedStretch, values: &[f64]) -> FilteredStretch {
        let in_lanes = |numbers: &mut [T], out: &mut Vec<f64>| {
            out.clear();
            out.resize(numbers.len() * T::COUNT, 0.0);
            numbers.iter().enumerate().for_each(|(k, x)| put(out, k, *x));
        };
        let (mut x, mut y, mut square) = (Vec::new(), vec![0.0; self.y.len() * T::COUNT], vec![0.0; T::COUNT]);
        in_lanes(&mut self.x, &mut x);
        let data = StretchData {
            values: &values[stretch.rows.start * T::COUNT..stretch.rows.end * T::COUNT],
            tests: T::COUNT,
        };
        let filtered = stretch.filter_tests(TestsInLanes { data, y: &mut y, square: &mut square }, &mut x);
        for (k, own) in self.x.iter_mut().enumerate() {
            *own = at(&x, k);
        }
        for (k, own) in self.y.iter_mut().enumerate() {
            *own = *own + at(&y, k);
        }
        self.square = self.square + at(&square, 0);
        filtered
    }

    /// Adds the parts of the current block to the sums.
    #[inline(always)]
    fn flush_block(&mut self) {
        let zero = T::splat(0.0);
        for (sum, part) in self.y.iter_mut().zip(&mut self.y_part) {
            *sum = *sum + std::mem::replace(part, zero);
        }
        self.square = self.square + std::mem::replace(&mut self.square_part, zero);
    }

    /// The innovation of a scalar measurement; updates x and the sums.
    #[inline(always)]
    fn measure<N: Numbers<T>, L: InnovationObserver>(
        &mut self,
        (design, line): (&Design, usize),
        (numbers, row): (&N, usize),
        value: T,
        observer: &mut L,
    ) -> T {
        let (states, first) = (design.terms(line).0, if line == 0 { 0 } else { design.ends[line - 1] });
        let e = kernel::innovation(&self.x, (states, numbers.h().skip(first)), value);
        observer.observe((row, line), e, &self.x);
        let (weight, K) = numbers.gains(row);
        kernel::correct_mean(K, e, &mut self.x[..design.frame.r]);
        let weighted = e * weight;
        least_squares::add_weighted_row(numbers.sensitivities(row), weighted, &mut self.y_part);
        self.square_part = e.fma(weighted, self.square_part);
        e
    }
}
