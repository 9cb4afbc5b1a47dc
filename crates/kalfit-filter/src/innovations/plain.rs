//! Innovations in plain covariances: one filter over all phases; each phase starts from the known law of σ.
//!
//! With nothing unknown, σ ~ N(m, C) is part of a and P0 of a phase, as Σ is in a test of one phase. From the last step
//! of a phase, the next phase has
//!
//! ```text
//! m = [μ_j; 0] + T x̂_K + t        C = EΣE' + T P_K T'
//! ```
//!
//! Tests are filtered in lanes, phase after phase, with the same bits whatever else is in the batch. Tests that are
//! better filtered one at a time share the covariance pass of their design.

use kalfit_lanes::Isa;
use nalgebra::{DMatrix, DVector};

use crate::innovations::innovation::Innovation;
use crate::innovations::phase_prior::PhasePrior;
use crate::innovations::rows;
use crate::innovations::rows::Figures;
use crate::reduce::{
    BatchWorkspace, EnteringMoments, Gains, GatheredCells, PhaseReducer, ReduceError, Reducer, Skeleton, Terminal,
    Workspace,
};
use kalfit_model::Test;
use kalfit_model::{Alpha, Phase, PhasedModel};
use kalfit_model::{Evidence, Inherited, PhasedTest};

/// The filters of the phases.
#[derive(Debug)]
pub(super) struct PhaseFilters {
    phases: Vec<PhaseFilter>,
}

/// The filter of a phase that nothing unknown enters.
#[derive(Debug)]
struct PhaseFilter {
    reducer: Reducer,
    /// States through which σ enters.
    entering: Vec<usize>,
    /// True if the model has one phase: no covariance passes to a next phase, and the innovations may come from
    /// square-root arrays.
    is_only_phase: bool,
}

/// Work space of a phase, and tests that wait to be filtered in lanes.
#[derive(Debug)]
pub(super) struct PhaseWorkspace {
    work: Workspace,
    batch_workspace: BatchWorkspace,
    /// Skeletons of the tests of the current batch; `unused_skeletons` holds skeletons for further tests.
    own: Vec<Skeleton>,
    unused_skeletons: Vec<Skeleton>,
}

/// The result of a phase: (innovations, last state if another phase follows).
type PhaseResult = (Vec<Innovation>, Option<Terminal>);

/// A test on its way through the phases.
#[derive(Debug, Default)]
struct Track {
    series: Vec<Innovation>,
    /// The last state of the phase before.
    before: Option<Terminal>,
}

/// A phase of a batch of tests, and for each test the rows of the phase; `None` for a test that lacks the phase or has
/// failed before.
struct PhaseBatch<'a> {
    at: usize,
    phase_filter: &'a PhaseFilter,
    time: Option<usize>,
    rows: Vec<Option<&'a Test>>,
}

impl PhaseFilters {
    pub(super) fn new(model: &PhasedModel, alpha: &Alpha) -> Result<PhaseFilters, ReduceError> {
        let last = model.phases.len() - 1;
        let of = |(at, phase): (usize, &Phase)| -> Result<PhaseFilter, ReduceError> {
            let reducer = Reducer::of_known_starts(&phase.entry_model(), alpha)?;
            let reducer = if at < last { reducer.with_ends() } else { reducer };
            Ok(PhaseFilter { reducer, entering: phase.entering(), is_only_phase: last == 0 })
        };
        Ok(PhaseFilters { phases: model.phases.iter().enumerate().map(of).collect::<Result<_, _>>()? })
    }

    pub(super) fn workspace(&self) -> Vec<PhaseWorkspace> {
        let of = |PhaseFilter { reducer, .. }: &PhaseFilter| {
            let (work, batch_workspace) = (reducer.workspace(), BatchWorkspace::new(Isa::best(), reducer));
            PhaseWorkspace { work, batch_workspace, own: Vec::new(), unused_skeletons: Vec::new() }
        };
        self.phases.iter().map(of).collect()
    }

    /// The innovations of tests; `None` for a test with a phase that is given otherwise than by rows, needs square
    /// roots or fails.
    pub(super) fn series(
        &self,
        tests: &[PhasedTest],
        (starts, carries): (&[PhasePrior], &[PhaseReducer]),
        (scratch, cells): (&mut [PhaseWorkspace], &mut GatheredCells),
    ) -> Vec<Option<Vec<Innovation>>> {
        let is_plain_phase =
            |(evidence, start): (&Evidence, &PhasePrior)| matches!(evidence, Evidence::Rows(_)) && !start.filtered;
        let track = |test: &PhasedTest| test.phases.iter().zip(starts).all(is_plain_phase).then(Track::default);
        let mut tracks: Vec<Option<Track>> = tests.iter().map(track).collect();
        for (at, (phase_filter, scratch)) in self.phases.iter().zip(scratch).enumerate() {
            let rows = |(test, track): (_, &Option<Track>)| rows_of(test, at).filter(|_| track.is_some());
            let rows: Vec<Option<&Test>> = tests.iter().zip(&tracks).map(rows).collect();
            let phase_batch = PhaseBatch { at, phase_filter, time: starts[at].time, rows };
            phase_batch.run((&starts[at], &carries[at]), &mut tracks, (scratch, cells));
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

/// e, S and e/√S from e and `weight` = 1/S, where nothing is unknown.
fn figures(value: f64, weight: f64) -> Figures {
    let (variance, standardised) = (weight.recip(), value * weight.sqrt());
    Figures { value, variance, standardised }
}

impl PhaseBatch<'_> {
    /// Filters the phase of all tests that have rows in it.
    fn run(
        &self,
        of: (&PhasePrior, &PhaseReducer),
        tracks: &mut [Option<Track>],
        (PhaseWorkspace { work, batch_workspace, own, unused_skeletons }, cells): (
            &mut PhaseWorkspace,
            &mut GatheredCells,
        ),
    ) {
        let PhaseFilter { reducer, is_only_phase, .. } = self.phase_filter;
        let members = self.rows.iter().enumerate().filter_map(|(number, rows)| Some((number, (*rows)?)));
        let (numbers, tests): (Vec<usize>, Vec<&Test>) = members.unzip();
        let mut entering: Vec<EnteringMoments> = tests.iter().map(|_| EnteringMoments::default()).collect();
        for (place, (&number, rows)) in numbers.iter().zip(&tests).enumerate() {
            let Some(track) = &mut tracks[number] else { continue };
            let before = track.before.take();
            let mut skeleton = unused_skeletons.pop().unwrap_or_default();
            if !reducer.preparer().skeleton(rows, place, work, &mut skeleton) {
                unused_skeletons.push(skeleton);
                let found = self.filter_single(rows, of, before.as_ref(), (work, cells));
                add_to_track(&mut tracks[number], found);
                continue;
            }
            match self.phase_filter.entering((rows, &skeleton.covariates), of, before.as_ref(), cells) {
                Some(law) => {
                    entering[place] = law;
                    own.push(skeleton);
                }
                None => tracks[number] = None,
            }
        }
        let mut needs_square_roots = Vec::new();
        batch_workspace.pass(reducer, (&tests, own, &entering), &mut work.scratch, |skeleton, passed| {
            let place = skeleton.number;
            let found = passed.map(|passed| {
                let row_figures = passed.innovations().map(|(e, weight)| (weight > 0.0).then(|| figures(e, weight)));
                let series =
                    rows::list_innovations((self.at, tests[place], self.time), skeleton.measured(), row_figures);
                (series, passed.end.map(|end| end.terminal()))
            });
            // with only one phase, tests that need square roots may be filtered one at a time
            if found.is_none() && *is_only_phase {
                needs_square_roots.push(place)
            } else {
                add_to_track(&mut tracks[numbers[place]], found)
            }
        });
        unused_skeletons.append(own);
        for place in needs_square_roots {
            let found = self.filter_single(tests[place], of, None, (work, cells));
            add_to_track(&mut tracks[numbers[place]], found);
        }
    }

    /// Filters the phase of a single test; `None` where it needs square roots or fails.
    fn filter_single(
        &self,
        rows: &Test,
        of: (&PhasePrior, &PhaseReducer),
        before: Option<&Terminal>,
        (work, cells): (&mut Workspace, &mut GatheredCells),
    ) -> Option<PhaseResult> {
        let PhaseFilter { reducer, .. } = self.phase_filter;
        reducer.preparer().prepare(rows, work).ok()?;
        let EnteringMoments { mean, variance } =
            self.phase_filter.entering((rows, &work.covariates), of, before, cells)?;
        mean.iter().for_each(|&(place, x)| work.data.start[place] += x);
        variance.iter().for_each(|&(place, x)| work.design.variance[place] += x);
        let result_of_gains = |gains: &Gains, work: &mut Workspace| self.result_of_gains(rows, gains, work);
        reducer.with_prepared(rows, work, result_of_gains).ok()?
    }

    /// Innovations and last state from the gains; `None` where square-root arrays made the gains and the
    /// model has other phases.
    fn result_of_gains(&self, rows: &Test, gains: &Gains, work: &mut Workspace) -> Option<PhaseResult> {
        if gains.rotations.is_some() && !self.phase_filter.is_only_phase {
            return None;
        }
        let found = rows::series((self.at, rows, self.time), gains, work, |e, weight, _| figures(e, weight));
        let states = &self.phase_filter.reducer.preparer().order.states;
        Some((found, gains.terminal(states, &work.pass.x)))
    }
}

/// Adds the result of a phase to the track of a test; no result ends the track.
fn add_to_track(track: &mut Option<Track>, found: Option<PhaseResult>) {
    match (track.as_mut(), found) {
        (Some(track), Some((found, terminal))) => {
            if track.series.is_empty() {
                track.series = found
            } else {
                track.series.extend(found)
            }
            track.before = terminal;
        }
        _ => *track = None,
    }
}

impl PhaseFilter {
    /// Mean and covariance of σ of a test with these rows and covariates, as terms of a and P0; `None` on an error.
    fn entering(
        &self,
        (rows, covariates): (&Test, &[f64]),
        (start, carry): (&PhasePrior, &PhaseReducer),
        before: Option<&Terminal>,
        cells: &mut GatheredCells,
    ) -> Option<EnteringMoments> {
        let q = self.entering.len();
        let mut mean: DVector<f64> = start.mean_with_covariates(covariates, q);
        let mut carried = DMatrix::zeros(q, 0);
        if let Some(Terminal { mean: state, root, .. }) = before {
            let inherited = carry.inherited(rows, cells).ok()?;
            let Inherited { transition, input } = &*inherited;
            mean += transition * state + input;
            carried = transition * root;
        }
        let p = start.covariance.nrows();
        let covariance = |i: usize, k: usize| {
            let own = if i < p && k < p { start.covariance[(i, k)] } else { 0.0 };
            own + (0..carried.ncols()).map(|c| carried[(i, c)] * carried[(k, c)]).sum::<f64>()
        };
        let order = &self.reducer.preparer().order;
        let place = |row: usize| order.place[self.entering[row]];
        let pairs = (0..q).flat_map(|i| (0..=i).map(move |k| (i, k)));
        let variance = pairs.map(|(i, k)| {
            let (a, b) = (place(i).max(place(k)), place(i).min(place(k)));
            (a * order.frame.r + b, covariance(i, k))
        });
        Some(EnteringMoments { mean: (0..q).map(|i| (place(i), mean[i])).collect(), variance: variance.collect() })
    }
}
