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
//! better filtered apart share the covariance pass of their design; successive ones that differ only in measured values
//! and covariates are evaluated once, and their data passes run in lanes.

use kalfit_lanes::Isa;
use nalgebra::{DMatrix, DVector};

use crate::innovations::change::Change;
use crate::innovations::phase_prior::PhasePrior;
use crate::innovations::rows;
use crate::innovations::rows::{Figures, ListedInnovation};
use crate::reduce::{
    BatchWorkspace, DataWorkspace, EnteringMoments, Gains, GatheredCells, MAX_ROWS_IN_LANES, PhaseReducer, ReduceError,
    Reducer, Skeleton, Terminal, Workspace,
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
type PhaseResult<T> = (Vec<T>, Option<Terminal>);

/// A test on its way through the phases.
#[derive(Debug)]
struct Track<T> {
    series: Vec<T>,
    /// The last state of the phase before.
    before: Option<Terminal>,
}

/// A test that is filtered apart from the batch.
struct TestApart<'a> {
    rows: &'a Test,
    /// Place among the tests of the batch.
    place: usize,
    /// The last state of the phase before.
    before: Option<Terminal>,
    /// True if the test differs from the one before only in measured values and covariates.
    is_replicate: bool,
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
    pub(super) fn series<T: ListedInnovation>(
        &self,
        tests: &[PhasedTest],
        (starts, carries): (&[PhasePrior], &[PhaseReducer]),
        (scratch, cells): (&mut [PhaseWorkspace], &mut GatheredCells),
    ) -> Vec<Option<Vec<T>>> {
        let is_plain_phase =
            |(evidence, start): (&Evidence, &PhasePrior)| matches!(evidence, Evidence::Rows(_)) && !start.filtered;
        let track = |test: &PhasedTest| {
            let is_plain = test.phases.iter().zip(starts).all(is_plain_phase);
            is_plain.then(|| Track { series: Vec::new(), before: None })
        };
        let mut tracks: Vec<Option<Track<T>>> = tests.iter().map(track).collect();
        for (at, (phase_filter, scratch)) in self.phases.iter().zip(scratch).enumerate() {
            let rows = |(test, track): (_, &Option<Track<T>>)| rows_of(test, at).filter(|_| track.is_some());
            let rows: Vec<Option<&Test>> = tests.iter().zip(&tracks).map(rows).collect();
            let phase_batch = PhaseBatch { at, phase_filter, time: starts[at].time, rows };
            phase_batch.run((&starts[at], &carries[at]), &mut tracks, (scratch, cells));
        }
        tracks.into_iter().map(|track| track.map(|track| track.series)).collect()
    }
}

impl PhaseFilters {
    /// e/√S of a test with each of these changes; `None` for a test that is not filtered alone, in one phase without
    /// square roots.
    pub(super) fn changed(
        &self,
        test: &PhasedTest,
        changes: &[Change<'_>],
        (starts, carries): (&[PhasePrior], &[PhaseReducer]),
        (scratch, cells): (&mut [PhaseWorkspace], &mut GatheredCells),
    ) -> Option<Vec<Vec<f64>>> {
        let ([phase_filter], [start], [carry]) = (&self.phases[..], starts, carries) else { return None };
        let rows = rows_of(test, 0).filter(|_| !start.filtered)?;
        let PhaseWorkspace { work, unused_skeletons, .. } = scratch.first_mut()?;
        let preparer = phase_filter.reducer.preparer();
        let mut skeleton = unused_skeletons.pop().unwrap_or_default();
        let is_in_batch = preparer.skeleton(rows, 0, work, &mut skeleton);
        unused_skeletons.push(skeleton);
        // without a mask a measured value is a sum of several cells
        if is_in_batch || preparer.cell_mask.is_none() {
            return None;
        }
        phase_filter.prepare(rows, (start, carry), None, (work, cells))?;
        let measured_cells = preparer.measured_cells(rows, work).ok()?;
        let series = |gains: &Gains, work: &mut Workspace| {
            let unchanged = work.data.values.clone();
            let of = |change: &Change<'_>| {
                let Workspace { data, instances, .. } = &mut *work;
                data.values.clone_from(&unchanged);
                for (value, (instance, (cell, d))) in
                    data.values.iter_mut().zip(instances.iter().zip(measured_cells.iter()))
                {
                    if instance.meter == change.measurement {
                        *value = (change.value)(instance.row, rows.all_numbers()[cell]) - d;
                    }
                }
                rows::series((0, rows, None), gains, work, |e, weight, _| figures(e, weight))
            };
            gains.rotations.is_none().then(|| changes.iter().map(of).collect())
        };
        phase_filter.reducer.with_prepared(rows, work, series).ok()?
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
    fn run<T: ListedInnovation>(
        &self,
        of: (&PhasePrior, &PhaseReducer),
        tracks: &mut [Option<Track<T>>],
        (PhaseWorkspace { work, batch_workspace, own, unused_skeletons }, cells): (
            &mut PhaseWorkspace,
            &mut GatheredCells,
        ),
    ) {
        let PhaseFilter { reducer, .. } = self.phase_filter;
        let members = self.rows.iter().enumerate().filter_map(|(number, rows)| Some((number, (*rows)?)));
        let (numbers, tests): (Vec<usize>, Vec<&Test>) = members.unzip();
        let mut entering: Vec<EnteringMoments> = tests.iter().map(|_| EnteringMoments::default()).collect();
        let mut apart: Vec<TestApart<'_>> = Vec::new();
        for (place, (&number, &rows)) in numbers.iter().zip(&tests).enumerate() {
            let Some(track) = &mut tracks[number] else { continue };
            let before = track.before.take();
            if apart.last().is_some_and(|last| last.place + 1 == place && self.is_replicate(rows, last.rows, work)) {
                apart.push(TestApart { rows, place, before, is_replicate: true });
                continue;
            }
            let mut skeleton = unused_skeletons.pop().unwrap_or_default();
            if !reducer.preparer().skeleton(rows, place, work, &mut skeleton) {
                unused_skeletons.push(skeleton);
                apart.push(TestApart { rows, place, before, is_replicate: false });
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
        let lanes = work.block.lanes();
        for set in apart.chunk_by(|_, next| next.is_replicate).flat_map(|set| set.chunks(lanes)) {
            let found = self.filter_apart(set, of, (work, cells));
            set.iter().zip(found).for_each(|(one, found)| add_to_track(&mut tracks[numbers[one.place]], found));
        }
        let room = (batch_workspace, &mut work.scratch);
        let needs_square_roots = self.filter_batch((&numbers, &tests), (own, &entering), tracks, room);
        unused_skeletons.append(own);
        for place in needs_square_roots {
            let found = self.filter_single(tests[place], of, None, (work, cells));
            add_to_track(&mut tracks[numbers[place]], found);
        }
    }

    /// Filters the tests with skeletons in lanes. Returns the places of tests that need square roots and may be filtered
    /// one at a time, as there is only one phase.
    fn filter_batch<T: ListedInnovation>(
        &self,
        (numbers, tests): (&[usize], &[&Test]),
        (skeletons, entering): (&mut [Skeleton], &[EnteringMoments]),
        tracks: &mut [Option<Track<T>>],
        (batch_workspace, scratch): (&mut BatchWorkspace, &mut DataWorkspace),
    ) -> Vec<usize> {
        let PhaseFilter { reducer, is_only_phase, .. } = self.phase_filter;
        let mut needs_square_roots = Vec::new();
        batch_workspace.pass(reducer, (tests, skeletons, entering), scratch, |skeleton, passed| {
            let place = skeleton.number;
            let found = passed.map(|passed| {
                let row_figures = passed.innovations().map(|(e, weight)| (weight > 0.0).then(|| figures(e, weight)));
                let mut series = Vec::with_capacity(skeleton.instances.len());
                T::append(&mut series, (self.at, tests[place], self.time), skeleton.measured(), row_figures);
                (series, passed.end.map(|end| end.terminal()))
            });
            if found.is_none() && *is_only_phase {
                needs_square_roots.push(place)
            } else {
                add_to_track(&mut tracks[numbers[place]], found)
            }
        });
        needs_square_roots
    }

    /// True if a test differs from another one, whose covariates are sound, only in measured values and covariates.
    fn is_replicate(&self, test: &Test, other: &Test, work: &mut Workspace) -> bool {
        let preparer = self.phase_filter.reducer.preparer();
        let is_same = preparer.cell_mask.as_ref().is_some_and(|mask| mask.agrees_on(test, other));
        is_same && preparer.covariates_of(other, work).is_ok()
    }

    /// Filters the phase of replicates, at most as many as lanes; `None` for a test that needs square roots or fails.
    fn filter_apart<T: ListedInnovation>(
        &self,
        set: &[TestApart<'_>],
        of: (&PhasePrior, &PhaseReducer),
        (work, cells): (&mut Workspace, &mut GatheredCells),
    ) -> Vec<Option<PhaseResult<T>>> {
        // a block has room for all lanes, however many are taken
        let fills_lanes = 2 * set.len() > work.block.lanes();
        let in_lanes = fills_lanes.then(|| self.filter_in_lanes(set, of, (&mut *work, &mut *cells))).flatten();
        let mut found: Vec<Option<PhaseResult<T>>> =
            in_lanes.map_or_else(|| set.iter().map(|_| None).collect(), |found| found.into_iter().map(Some).collect());
        for (one, found) in set.iter().zip(&mut found) {
            // a missing or an infinite value is reported as of a test alone
            if found.as_ref().is_none_or(|(series, _)| !rows::are_finite(series)) {
                *found = self.filter_single(one.rows, of, one.before.as_ref(), (work, cells));
            }
        }
        found
    }

    /// Filters the phase of replicates in lanes; `None` where the tests must be filtered one at a time.
    fn filter_in_lanes<T: ListedInnovation>(
        &self,
        set: &[TestApart<'_>],
        of: (&PhasePrior, &PhaseReducer),
        (work, cells): (&mut Workspace, &mut GatheredCells),
    ) -> Option<Vec<PhaseResult<T>>> {
        let PhaseFilter { reducer, .. } = self.phase_filter;
        let (preparer, first) = (reducer.preparer(), set[0].rows);
        let mut entering = Vec::with_capacity(set.len());
        for TestApart { rows, before, .. } in set {
            preparer.covariates_of(rows, work).ok()?;
            entering.push(self.phase_filter.entering((rows, &work.covariates), of, before.as_ref(), cells)?);
        }
        let variance = &entering[0].variance;
        if entering.iter().any(|own| own.variance != *variance) {
            return None;
        }
        preparer.prepare(first, work).ok()?;
        if !(1..=MAX_ROWS_IN_LANES).contains(&work.design.rows()) {
            return None;
        }
        let measured_cells = preparer.measured_cells(first, work).ok()?;
        variance.iter().for_each(|&(place, x)| work.design.variance[place] += x);
        let tests: Vec<&Test> = set.iter().map(|one| one.rows).collect();
        let results_of_gains = |gains: &Gains, work: &mut Workspace| {
            if gains.rotations.is_some() {
                return None;
            }
            let Workspace { design, data, block, scratch, .. } = &mut *work;
            block.clear(data.start.len(), data.inputs.len(), measured_cells.len());
            for (lane, EnteringMoments { mean, .. }) in entering.iter().enumerate() {
                let mut start = data.start.clone();
                mean.iter().for_each(|&(place, x)| start[place] += x);
                block.begin(lane, &start, &data.inputs);
            }
            let values: Vec<&[f64]> = tests.iter().map(|test| test.all_numbers()).collect();
            block.put_values(&values, &measured_cells);
            block.run(design, gains, scratch);
            let series = rows::series_in_lanes((self.at, &tests, self.time), gains, work, figures);
            let terminal = |lane: usize| {
                let last: Vec<f64> = work.block.last(lane, &work.scratch).collect();
                gains.terminal(&preparer.order.states, &last)
            };
            Some(series.into_iter().enumerate().map(|(lane, series)| (series, terminal(lane))).collect())
        };
        reducer.with_prepared(first, work, results_of_gains).ok()?
    }

    /// Filters the phase of a single test; `None` where it needs square roots or fails.
    fn filter_single<T: ListedInnovation>(
        &self,
        rows: &Test,
        of: (&PhasePrior, &PhaseReducer),
        before: Option<&Terminal>,
        (work, cells): (&mut Workspace, &mut GatheredCells),
    ) -> Option<PhaseResult<T>> {
        let PhaseFilter { reducer, .. } = self.phase_filter;
        self.phase_filter.prepare(rows, of, before, (&mut *work, cells))?;
        let result_of_gains = |gains: &Gains, work: &mut Workspace| self.result_of_gains(rows, gains, work);
        reducer.with_prepared(rows, work, result_of_gains).ok()?
    }

    /// Innovations and last state from the gains; `None` where square-root arrays made the gains and the
    /// model has other phases.
    fn result_of_gains<T: ListedInnovation>(
        &self,
        rows: &Test,
        gains: &Gains,
        work: &mut Workspace,
    ) -> Option<PhaseResult<T>> {
        if gains.rotations.is_some() && !self.phase_filter.is_only_phase {
            return None;
        }
        let found = rows::series((self.at, rows, self.time), gains, work, |e, weight, _| figures(e, weight));
        let states = &self.phase_filter.reducer.preparer().order.states;
        Some((found, gains.terminal(states, &work.pass.x)))
    }
}

/// Adds the result of a phase to the track of a test; no result ends the track.
fn add_to_track<T>(track: &mut Option<Track<T>>, found: Option<PhaseResult<T>>) {
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
    /// Evaluates the rows of a test, with the law of σ in a and P0, into the work space; `None` on an error.
    fn prepare(
        &self,
        rows: &Test,
        of: (&PhasePrior, &PhaseReducer),
        before: Option<&Terminal>,
        (work, cells): (&mut Workspace, &mut GatheredCells),
    ) -> Option<()> {
        self.reducer.preparer().prepare(rows, work).ok()?;
        let EnteringMoments { mean, variance } = self.entering((rows, &work.covariates), of, before, cells)?;
        mean.iter().for_each(|&(place, x)| work.data.start[place] += x);
        variance.iter().for_each(|&(place, x)| work.design.variance[place] += x);
        Some(())
    }

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
