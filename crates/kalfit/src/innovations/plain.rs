//! Innovations in plain covariances: one filter over all phases that starts from the known law of what enters.
//!
//! With nothing unknown, σ ~ N(m, C) is part of a and P0 of a phase, as Σ is of a test of one phase, and from the last step of a
//! phase on
//!
//! ```text
//! m = [μ_j; 0] + T x̂_K + t        C = EΣE' + T P_K T'
//! ```
//!
//! Tests of one design then have one covariance run, and each but a data pass. Those with designs of their own are filtered side
//! by side, phase after phase, and to the same bits in any company.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::ensemble::Test;
use crate::innovations::innovation::Innovation;
use crate::innovations::rows::{self, Figures};
use crate::innovations::start::Start;
use crate::model::{Alpha, Phase, PhasedModel};
use crate::reduce::{
    Cells, Evidence, Frame, Gains, Inherited, PhaseReducer, PhasedTest, Queue, ReduceError, Reducer, Terminal,
    Workspace,
};

/// The filters of the phases.
#[derive(Debug)]
pub(super) struct Plain {
    phases: Vec<Known>,
}

/// The filter of a phase that nothing unknown enters.
#[derive(Debug)]
struct Known {
    reducer: Reducer,
    /// The reducer's order of states, without unknowns.
    frame: Arc<Frame>,
    /// Through which states σ enters.
    entering: Vec<usize>,
    /// The only phase: no covariance is handed on, and it may come from square-root arrays.
    alone: bool,
}

/// Work space of a phase, and tests that wait to be filtered side by side.
#[derive(Debug)]
pub(super) struct Waiting {
    work: Workspace,
    queue: Queue,
}

/// What a phase leaves: its innovations, and the last state where another phase follows.
type Left = (Vec<Innovation>, Option<Terminal>);

/// A test on its way through the phases.
#[derive(Debug, Default)]
struct Track {
    series: Vec<Innovation>,
    /// The last state of the phase before.
    before: Option<Terminal>,
}

/// A phase, and its rows in the tests of a batch that have it and are sound so far.
struct Stage<'a> {
    at: usize,
    known: &'a Known,
    time: Option<usize>,
    rows: Vec<Option<&'a Test>>,
}

impl Plain {
    pub(super) fn new(model: &PhasedModel, alpha: &Alpha) -> Result<Plain, ReduceError> {
        let last = model.phases.len() - 1;
        let of = |(at, phase): (usize, &Phase)| -> Result<Known, ReduceError> {
            let reducer = Reducer::of_known_starts(&phase.entry_model(), alpha)?;
            let reducer = if at < last { reducer.with_ends() } else { reducer };
            let frame = Arc::new(reducer.workspace().design.frame.without_unknowns());
            Ok(Known { reducer, frame, entering: phase.entering(), alone: last == 0 })
        };
        Ok(Plain { phases: model.phases.iter().enumerate().map(of).collect::<Result<_, _>>()? })
    }

    pub(super) fn workspace(&self) -> Vec<Waiting> {
        let of = |known: &Known| {
            let mut work = known.reducer.workspace();
            work.design.frame = known.frame.clone();
            Waiting { work, queue: Queue::default() }
        };
        self.phases.iter().map(of).collect()
    }

    /// The innovations of tests; `None` where some phase is given otherwise than by rows, calls for square roots or is in error.
    pub(super) fn series(
        &self,
        tests: &[PhasedTest],
        (starts, carries): (&[Start], &[PhaseReducer]),
        (room, cells): (&mut [Waiting], &mut Cells),
    ) -> Vec<Option<Vec<Innovation>>> {
        let plain = |(evidence, start): (&Evidence, &Start)| matches!(evidence, Evidence::Rows(_)) && !start.filtered;
        let track = |test: &PhasedTest| test.phases.iter().zip(starts).all(plain).then(Track::default);
        let mut tracks: Vec<Option<Track>> = tests.iter().map(track).collect();
        for (at, (known, room)) in self.phases.iter().zip(room).enumerate() {
            let rows = |(test, track): (_, &Option<Track>)| rows_of(test, at).filter(|_| track.is_some());
            let rows: Vec<Option<&Test>> = tests.iter().zip(&tracks).map(rows).collect();
            let stage = Stage { at, known, time: starts[at].time, rows };
            stage.run((&starts[at], &carries[at]), &mut tracks, (room, cells));
        }
        tracks.into_iter().map(|track| track.map(|track| track.series)).collect()
    }
}

/// The rows of a phase of a test.
fn rows_of(test: &PhasedTest, at: usize) -> Option<&Test> {
    match test.phases.get(at) {
        Some(Evidence::Rows(rows)) => Some(rows),
        _ => None,
    }
}

/// e, S and e/√S where nothing is unknown.
fn figures(value: f64, weight: f64) -> Figures {
    let (variance, standardised) = (weight.recip(), value * weight.sqrt());
    Figures { value, variance, standardised }
}

impl Stage<'_> {
    /// The phase of all tests that have it.
    fn run(
        &self,
        (start, carry): (&Start, &PhaseReducer),
        tracks: &mut [Option<Track>],
        (Waiting { work, queue }, cells): (&mut Waiting, &mut Cells),
    ) {
        let reducer = &self.known.reducer;
        let mut odd = Vec::new();
        for (number, rows) in self.rows.iter().enumerate() {
            let (Some(rows), Some(track)) = (rows, &mut tracks[number]) else { continue };
            let before = track.before.take();
            if self.known.begin(rows, (start, carry), before.as_ref(), (work, cells)).is_none() {
                tracks[number] = None;
                continue;
            }
            let digest = work.design.digest();
            if let Some(line) = queue.line_with(digest) {
                self.side_by_side(line, tracks, (work, queue), &mut odd);
            }
            if reducer.goes_aside(digest, &work.design) {
                if let Some(full) = queue.push(number, digest, work) {
                    self.side_by_side(full, tracks, (work, queue), &mut odd);
                }
                continue;
            }
            note(&mut tracks[number], self.by_itself(rows, digest, work));
        }
        while let Some(line) = queue.any() {
            self.side_by_side(line, tracks, (work, queue), &mut odd);
        }
        for number in odd {
            let rows = self.rows[number].expect("it was filtered");
            let begun = self.known.begin(rows, (start, carry), None, (work, cells));
            let digest = work.design.digest();
            note(&mut tracks[number], begun.and_then(|()| self.by_itself(rows, digest, work)));
        }
    }

    /// The phase of the test in the work space; `None` where it calls for square roots or is in error.
    fn by_itself(&self, rows: &Test, digest: u128, work: &mut Workspace) -> Option<Left> {
        let look = |gains: &Gains, work: &mut Workspace| self.look(rows, gains, work);
        self.known.reducer.with_prepared(rows, digest, work, look).ok()?
    }

    /// What its gains leave; `None` where they call for square roots.
    fn look(&self, rows: &Test, gains: &Gains, work: &mut Workspace) -> Option<Left> {
        if gains.turns.is_some() && !self.known.alone {
            return None;
        }
        let found = rows::series((self.at, rows, self.time), gains, work, |e, weight, _| figures(e, weight));
        let states = &self.known.reducer.preparer().order.states;
        Some((found, gains.end.as_ref().map(|end| end.terminal(states, &work.pass.x))))
    }

    /// The phase of the tests in a line. Those that call for square roots are `odd` where they may go by themselves.
    fn side_by_side(
        &self,
        line: usize,
        tracks: &mut [Option<Track>],
        (work, queue): (&mut Workspace, &mut Queue),
        odd: &mut Vec<usize>,
    ) {
        let waiting = queue.take(line);
        let filtered = self.known.reducer.filter(&waiting, work);
        for (lane, own) in waiting.iter().enumerate() {
            let found = filtered.of(lane).map(|filter| {
                let each = filtered.innovations(lane).map(|(e, weight)| (weight > 0.0).then(|| figures(e, weight)));
                let rows = self.rows[own.number].expect("it was filtered");
                let series = rows::listed((self.at, rows, self.time), (&own.design, &own.instances), each);
                (series, filter.end.map(|end| filtered.terminal(lane, end)))
            });
            if found.is_none() && self.known.alone {
                odd.push(own.number);
            } else {
                note(&mut tracks[own.number], found);
            }
        }
        queue.give_back(waiting);
    }
}

/// What a phase left of a test.
fn note(track: &mut Option<Track>, found: Option<Left>) {
    match (track.as_mut(), found) {
        (Some(track), Some((found, terminal))) => {
            track.series.extend(found);
            track.before = terminal;
        }
        _ => *track = None,
    }
}

impl Known {
    /// Evaluates the rows of a test, and adds the law of σ to a and P0; `None` where something is wrong with it.
    fn begin(
        &self,
        rows: &Test,
        (start, carry): (&Start, &PhaseReducer),
        before: Option<&Terminal>,
        (work, cells): (&mut Workspace, &mut Cells),
    ) -> Option<()> {
        let inherited = match before {
            Some(terminal) => Some((terminal, carry.inherited(rows, cells).ok()?)),
            None => None,
        };
        self.reducer.preparer().prepare(rows, work).ok()?;
        let q = self.entering.len();
        let mut mean: DVector<f64> = start.mean_of(&work.covariates, q);
        let mut carried = DMatrix::zeros(q, 0);
        if let Some((Terminal { mean: state, root, .. }, inherited)) = inherited {
            let Inherited { transition, input } = &*inherited;
            mean += transition * state + input;
            carried = transition * root;
        }
        let p = start.covariance.nrows();
        let covariance = |i: usize, k: usize| {
            let own = if i < p && k < p { start.covariance[(i, k)] } else { 0.0 };
            own + (0..carried.ncols()).map(|c| carried[(i, c)] * carried[(k, c)]).sum::<f64>()
        };
        let place = |row: usize| self.reducer.preparer().order.place[self.entering[row]];
        let r = work.design.frame.r;
        for i in 0..q {
            work.data.start[place(i)] += mean[i];
            for k in 0..=i {
                let (a, b) = (place(i).max(place(k)), place(i).min(place(k)));
                work.design.variance[a * r + b] += covariance(i, k);
            }
        }
        Some(())
    }
}
