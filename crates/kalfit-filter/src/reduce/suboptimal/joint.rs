//! The truth and the filter propagated together, s = [x_k; x̂_k; x̂_{0|k}] (theory §8): the part that does not depend
//! on data.
#![expect(non_snake_case, reason = "the letters of the theory: D, F, K, M, Q, R, S")]

use std::sync::Arc;

use nalgebra::DMatrix;

use crate::reduce::design::Transition;
use crate::reduce::error::ReduceErrorKind;
use crate::reduce::prepare::{Preparer, Workspace};
use crate::reduce::semidefinite::NotSemidefinite;
use crate::reduce::subject::{Fault, Subject};
use crate::reduce::suboptimal::believed::AssumedCovariance;
use crate::reduce::suboptimal::matrices::{Matrices, append, fold, root_of};
use kalfit_model::Filter;

/// Gains and moments that are shared by tests that the filter processes identically.
#[derive(Debug, Clone)]
pub(super) struct FilterDesign {
    /// [K; K⁰] of each scalar measurement of the test, 2n numbers per measurement, states in the filter's kernel order.
    pub(super) gains: Vec<f64>,
    /// S, the sensitivity of s to x_0, 3n × n.
    pub(super) sensitivity: DMatrix<f64>,
    /// D with DD' = Γ, 3n × at most 3n.
    pub(super) root: DMatrix<f64>,
}

/// A preparer, and the work space with the test that the preparer evaluated.
pub(super) type EvaluatedModel<'a> = (&'a Preparer, &'a Workspace);

/// Runs the truth and the filter through a test.
pub(super) fn run(
    truth: EvaluatedModel<'_>,
    assumed: EvaluatedModel<'_>,
    filter: &Filter,
) -> Result<FilterDesign, Box<Fault>> {
    let n = truth.0.order.states.len();
    let (true_matrices, assumed_matrices) = (Matrices::new(truth.0, truth.1), Matrices::new(assumed.0, assumed.1));
    let mut joint = JointMoments::new(n);
    let mut believed = AssumedCovariance::new(filter);
    let mut gains = Vec::with_capacity(2 * n * truth.1.design.rows());
    let (mut true_motion, mut assumed_motion) = (LastMotion::default(), LastMotion::default());
    for (step, assumed_step) in truth.1.design.each_step().zip(assumed.1.design.each_step()) {
        let moved = true_motion.of(&true_matrices, step.transition)?;
        let assumed_moved = assumed_motion.of(&assumed_matrices, assumed_step.transition)?;
        joint.predict(moved, assumed_moved);
        if let Some(motion) = assumed_moved {
            believed.predict(&motion.phi, &motion.Q, &motion.root);
        }
        if step.rows.is_empty() {
            continue;
        }
        let row = truth.1.instances.get(step.rows.start).row;
        let refuse = |bad: NotSemidefinite| Fault::new(Subject::StepNoise, bad).on(row);
        let (M, assumed_M) = (true_matrices.measurement(&step), assumed_matrices.measurement(&assumed_step));
        let root = root_of(&true_matrices.noise(&step)).map_err(refuse)?;
        let assumed_root = root_of(&assumed_matrices.noise(&assumed_step)).map_err(refuse)?;
        let K = believed.update(&assumed_M, &assumed_root);
        joint.update((&M, &assumed_M), &K, &root);
        for column in K.column_iter() {
            let states = &assumed.0.order.states;
            gains.extend(
                (0..2).flat_map(|half| states.iter().map(move |&state| (half, state))).map(gain_entry(&column, n)),
            );
        }
    }
    let JointMoments { sensitivity, mut root, .. } = joint;
    fold(&mut root);
    if gains.iter().chain(&sensitivity).chain(&root).all(|x| x.is_finite()) {
        Ok(FilterDesign { gains, sensitivity, root })
    } else {
        Err(Fault::new(Subject::Test, ReduceErrorKind::NotFinite))
    }
}

fn gain_entry<'a>(column: &'a nalgebra::DVectorView<'_, f64>, n: usize) -> impl Fn((usize, usize)) -> f64 + 'a {
    move |(half, state)| column[half * n + state]
}

/// Cache of the last transition as matrices: successive steps often have the same transition.
#[derive(Debug, Default)]
struct LastMotion(Option<(Arc<Transition>, StepMotion)>);

/// φ, Q and a root of Q.
#[derive(Debug, Clone)]
struct StepMotion {
    phi: DMatrix<f64>,
    Q: DMatrix<f64>,
    root: DMatrix<f64>,
}

impl LastMotion {
    fn of(
        &mut self,
        matrices: &Matrices<'_>,
        transition: Option<&Arc<Transition>>,
    ) -> Result<Option<&StepMotion>, Box<Fault>> {
        let Some(transition) = transition else { return Ok(None) };
        if !self.0.as_ref().is_some_and(|(known, _)| Arc::ptr_eq(known, transition)) {
            let (phi, Q) = matrices.motion(transition);
            let root = root_of(&Q).map_err(|bad| Fault::new(Subject::Transition, bad))?;
            self.0 = Some((transition.clone(), StepMotion { phi, Q, root }));
        }
        Ok(self.0.as_ref().map(|(_, moving)| moving))
    }
}

/// S and D of s = [x; x̂; x̂_0].
#[derive(Debug, Clone)]
struct JointMoments {
    n: usize,
    /// S, 3n × n.
    sensitivity: DMatrix<f64>,
    /// D, 3n × any number of columns. Γ = DD' is never formed, since the product would lose half the digits of nearly
    /// certain directions.
    root: DMatrix<f64>,
}

impl JointMoments {
    /// S_0 = [I; 0; 0], Γ_0 = 0.
    fn new(n: usize) -> JointMoments {
        let mut sensitivity = DMatrix::zeros(3 * n, n);
        sensitivity.view_mut((0, 0), (n, n)).fill_with_identity();
        JointMoments { n, sensitivity, root: DMatrix::zeros(3 * n, 0) }
    }

    /// x moves by φ and noise of the truth, x̂ by φ of the filter; x̂_0 does not change.
    fn predict(&mut self, truth: Option<&StepMotion>, assumed: Option<&StepMotion>) {
        let n = self.n;
        for all in [&mut self.sensitivity, &mut self.root] {
            for (first, motion) in [(0, truth), (n, assumed)] {
                if let Some(motion) = motion {
                    let moved = &motion.phi * all.rows(first, n);
                    all.rows_mut(first, n).copy_from(&moved);
                }
            }
        }
        if let Some(motion) = truth {
            append(&mut self.root, 0, &motion.root);
        }
    }

    /// x̂ += Ke and x̂_0 += K⁰e, with e = Mx + v - M_f x̂.
    fn update(&mut self, (M, assumed_M): (&DMatrix<f64>, &DMatrix<f64>), K: &DMatrix<f64>, noise: &DMatrix<f64>) {
        let n = self.n;
        for all in [&mut self.sensitivity, &mut self.root] {
            let e = M * all.rows(0, n) - assumed_M * all.rows(n, n);
            let mut estimates = all.rows_mut(n, 2 * n);
            estimates += K * e;
        }
        append(&mut self.root, n, &(K * noise));
    }
}
