//! Runs of a filter, optimal or not, over tests: the estimates, and how the estimates depend on the truth.

use std::sync::Arc;

use rayon::prelude::*;

use crate::reduce::design::Design;
use crate::reduce::digest::Digest;
use crate::reduce::error::{ReduceError, ReduceErrorKind, refuse};
use crate::reduce::kernel;
use crate::reduce::prepare::{Preparer, Workspace};
use crate::reduce::shared_store::{SharedStore, StoreEntry};
use crate::reduce::subject::{Fault, Subject};
use crate::reduce::suboptimal::joint;
use crate::reduce::suboptimal::joint::FilterDesign;
use crate::reduce::suboptimal::known::{check, constants, without_start};
use kalfit_model::Estimates;
use kalfit_model::Test;
use kalfit_model::{Alpha, Filter, Level, Phase};

/// Largest number of bytes of cached gains.
const CLASS_BYTES: usize = 256 << 20;

type NoiseCovariances = Vec<(usize, usize, f64)>;
type FilterDesignResult = Result<FilterDesign, Box<Fault>>;

/// Designs and noise covariances of the truth and of the filter, on which gains, S and Γ depend.
#[derive(Debug, Clone)]
struct FilterClass {
    designs: [Design; 2],
    covariances: [NoiseCovariances; 2],
}

/// Runs the `[filter]` of a phase over tests (theory §8).
///
/// The truth has the model's φ, M, Q, R, b, d at α; the filter has a different φ, M, Q, R, b, d where the filter
/// assumes other parameters, and a separate prior of all states at x_0. The filter's gain is the joint gain of all
/// measurements of a step, with zero rows for considered states, in the filter and in the fixed-point smoother of x_0.
///
/// The filter's parameters have the values of α, except for the values that [`Filter::parameters`] sets. Tests that the
/// filter processes identically share gains. Estimates do not depend on this sharing, on threads or on the order of the
/// tests.
#[derive(Debug)]
pub struct FilterRunner {
    filter: Filter,
    truth: Preparer,
    assumed: Preparer,
    classes: SharedStore<FilterClass, FilterDesignResult>,
}

/// Work space for one test.
struct RunWorkspace {
    truth: Workspace,
    assumed: Workspace,
    /// x̂ and s̄_2 as the columns of an n × 2 array, in the filter's kernel order; the columns of `first` are x̂_0 and
    /// s̄_3.
    filtered: Vec<f64>,
    smoothed: Vec<f64>,
    /// s̄_1, in the truth's kernel order.
    drift: Vec<f64>,
    moved: Vec<f64>,
}

impl FilterRunner {
    /// A runner of the phase's filter at α.
    ///
    /// # Errors
    /// A phase without a filter ([`ReduceErrorKind::NoFilter`]); a prior that has other states than the model, or is
    /// not finite or not positive semidefinite; coefficients without a value, whatever the data.
    pub fn new(phase: &Phase, alpha: &Alpha) -> Result<FilterRunner, ReduceError> {
        let Some(filter) = &phase.filter else {
            return Err(refuse(None, &format!("phase `{}`", phase.name), ReduceErrorKind::NoFilter));
        };
        check(filter, &phase.model).map_err(|(what, kind)| refuse(None, what, kind))?;
        let model = without_start(&phase.model);
        let mut assumed_alpha = alpha.clone();
        for &(parameter, value) in &filter.parameters {
            let count = assumed_alpha.values.len();
            let kind = ReduceErrorKind::Shape { found: (parameter + 1, 1), expected: (count, 1) };
            let wrong = || refuse(None, "parameter of the filter", kind);
            *assumed_alpha.values.get_mut(parameter).ok_or_else(wrong)? = Level::Common(value);
        }
        let truth = Preparer::new(&model, alpha).map_err(|fault| fault.name(&model, None))?;
        let assumed = Preparer::new(&model, &assumed_alpha).map_err(|fault| of_filter(fault.name(&model, None)))?;
        Ok(FilterRunner { filter: filter.clone(), truth, assumed, classes: SharedStore::new(CLASS_BYTES) })
    }

    /// The filter's estimates of a test, ŝ = [x̂_K; x̂_{0|K}], 2n numbers, and how ŝ depends on x_0 and on noise.
    /// `test` has the rows of the phase.
    ///
    /// # Errors
    /// Missing cells, covariances that are not positive semidefinite, and any other error that prevents the
    /// reduction of a test.
    pub fn run(&self, test: &Test) -> Result<Estimates, ReduceError> {
        self.run_in(test, &mut self.scratch())
    }

    /// The estimates of `tests`, in the order of `tests`, or the error of the first test in error.
    pub fn run_all(&self, tests: &[Test]) -> Result<Vec<Estimates>, ReduceError> {
        let all: Vec<Result<Estimates, ReduceError>> =
            tests.par_iter().map_init(|| self.scratch(), |scratch, test| self.run_in(test, scratch)).collect();
        all.into_iter().collect()
    }

    fn scratch(&self) -> RunWorkspace {
        let workspace = |preparer: &Preparer| {
            let mut work = preparer.workspace();
            work.covariances = Some(Vec::new());
            work
        };
        let (truth, assumed) = (workspace(&self.truth), workspace(&self.assumed));
        RunWorkspace {
            truth,
            assumed,
            filtered: Vec::new(),
            smoothed: Vec::new(),
            drift: Vec::new(),
            moved: Vec::new(),
        }
    }

    fn run_in(&self, test: &Test, scratch: &mut RunWorkspace) -> Result<Estimates, ReduceError> {
        let model = &self.truth.model;
        let named = |fault: Box<Fault>| fault.name(model, Some(test));
        self.truth.prepare(test, &mut scratch.truth).map_err(named)?;
        self.assumed.prepare(test, &mut scratch.assumed).map_err(|fault| of_filter(named(fault)))?;
        let (found, expected) = (scratch.assumed.instances.len(), scratch.truth.instances.len());
        if found != expected || !scratch.assumed.instances.iter().eq(scratch.truth.instances.iter()) {
            return Err(named(Fault::new(Subject::Test, ReduceErrorKind::OtherMeasurements { found, expected })));
        }
        let entry = self.class(scratch);
        let class = entry.value().as_ref().map_err(|fault| named(fault.clone()))?;
        let shift = self.shift(test, scratch).map_err(named)?;
        self.pass(class, shift.as_deref(), scratch);
        let estimates = self.estimates(class, test, scratch);
        let all_finite =
            estimates.estimates.iter().chain(&estimates.offsets).chain(&estimates.drift).all(|x| x.is_finite());
        if all_finite { Ok(estimates) } else { Err(named(Fault::new(Subject::Test, ReduceErrorKind::NotFinite))) }
    }

    /// The filter design of the test in `scratch`, which tests that the filter processes identically share.
    fn class(&self, scratch: &RunWorkspace) -> Arc<StoreEntry<FilterClass, FilterDesignResult>> {
        let sides = [&scratch.truth, &scratch.assumed];
        let covariances = |work: &Workspace| work.covariances.clone().unwrap_or_default();
        let mut digest = Digest::new();
        for side in sides {
            digest.wide(side.design.digest());
            for &(i, j, value) in side.covariances.iter().flatten() {
                digest.count(i);
                digest.count(j);
                digest.numbers(&[value]);
            }
        }
        let same = |known: &FilterClass| {
            let same_covariances = |(a, b): (&NoiseCovariances, &Workspace)| b.covariances.as_ref() == Some(a);
            known.designs.iter().zip(sides).all(|(a, b)| a.same(&b.design))
                && known.covariances.iter().zip(sides).all(same_covariances)
        };
        self.classes.get(
            digest.finish(),
            same,
            || FilterClass { designs: sides.map(|side| side.design.clone()), covariances: sides.map(covariances) },
            |_| joint::run((&self.truth, &scratch.truth), (&self.assumed, &scratch.assumed), &self.filter),
            |class, made| {
                let numbers = made.as_ref().map_or(0, |made| made.gains.len() + 2 * made.root.len());
                class.designs.iter().map(Design::bytes).sum::<usize>()
                    + class.covariances.iter().map(|c| 24 * c.len()).sum::<usize>()
                    + 8 * numbers
            },
        )
    }

    /// d - d_f of each measurement; `None` where the filter sets no parameters, so that d_f = d.
    fn shift(&self, test: &Test, scratch: &RunWorkspace) -> Result<Option<Vec<f64>>, Box<Fault>> {
        if self.filter.parameters.is_empty() {
            return Ok(None);
        }
        let constants = self.truth.measured_constants(test, &scratch.truth)?;
        let assumed = self.assumed.measured_constants(test, &scratch.assumed)?;
        Ok(Some(constants.iter().zip(&assumed).map(|(a, b)| a - b).collect()))
    }

    /// Computes x̂ from the data, and s̄, which is x̂ from the data that x_0 = 0 without noise would give.
    fn pass(&self, class: &FilterDesign, shift: Option<&[f64]>, scratch: &mut RunWorkspace) {
        let RunWorkspace { truth, assumed, filtered, smoothed, drift, moved } = scratch;
        let n = self.filter.mean.len();
        filtered.clear();
        filtered.extend(self.assumed.order.states.iter().flat_map(|&state| [self.filter.mean[state]; 2]));
        smoothed.clone_from(filtered);
        drift.clear();
        drift.resize(n, 0.0);
        let (mut true_input, mut assumed_input) = (0, 0);
        for (step, assumed_step) in truth.design.each_step().zip(assumed.design.each_step()) {
            if let Some(transition) = step.transition {
                kernel::advance(drift, 1, transition.view(), moved);
                for &state in &truth.design.frame.driven {
                    drift[state as usize] += truth.data.inputs[true_input];
                    true_input += 1;
                }
            }
            if let Some(transition) = assumed_step.transition {
                kernel::advance(filtered, 2, transition.view(), moved);
                for &state in &assumed.design.frame.driven {
                    let input = assumed.data.inputs[assumed_input];
                    filtered[2 * state as usize..][..2].iter_mut().for_each(|x| *x += input);
                    assumed_input += 1;
                }
            }
            // all innovations of a step come before any update, since the gain of a step is joint
            moved.clear();
            for (i, row) in step.rows.clone().enumerate() {
                let (line, assumed_line) = (step.lines.start + i, assumed_step.lines.start + i);
                let mut e = [assumed.data.values[row], shift.map_or(0.0, |shift| shift[row])];
                let (states, h) = truth.design.terms(line);
                e[1] += states.iter().zip(h).map(|(&state, h)| h * drift[state as usize]).sum::<f64>();
                let (states, h) = assumed.design.terms(assumed_line);
                for (k, e) in e.iter_mut().enumerate() {
                    *e -= states.iter().zip(h).map(|(&state, h)| h * filtered[2 * state as usize + k]).sum::<f64>();
                }
                moved.extend(e);
            }
            for (e, row) in moved.chunks_exact(2).zip(step.rows) {
                let (gain, gain_of_first) = class.gains[2 * n * row..][..2 * n].split_at(n);
                for (x, gain) in
                    filtered.chunks_exact_mut(2).zip(gain).chain(smoothed.chunks_exact_mut(2).zip(gain_of_first))
                {
                    x[0] += gain * e[0];
                    x[1] += gain * e[1];
                }
            }
        }
    }

    fn estimates(&self, class: &FilterDesign, test: &Test, scratch: &RunWorkspace) -> Estimates {
        let n = self.filter.mean.len();
        let place = &self.assumed.order.place;
        let both = |k: usize| {
            let half = |x: &[f64]| (0..n).map(|state| x[2 * place[state] + k]).collect::<Vec<f64>>();
            let mut all = half(&scratch.filtered);
            all.extend(half(&scratch.smoothed));
            nalgebra::DVector::from_vec(all)
        };
        Estimates {
            estimates: both(0),
            offsets: both(1),
            sensitivities: class.sensitivity.rows(n, 2 * n).into_owned(),
            transition: class.sensitivity.rows(0, n).into_owned(),
            drift: nalgebra::DVector::from_fn(n, |state, _| scratch.drift[self.truth.order.place[state]]),
            root: class.root.clone(),
            constants: constants(&self.truth.model, test),
            steps: scratch.truth.design.steps(),
            observations: scratch.truth.design.rows(),
        }
    }
}

/// Marks an error as an error of the filter, not of the model.
fn of_filter(mut error: ReduceError) -> ReduceError {
    error.what.push_str(", as the filter has it");
    error
}
