//! The path of one test, from the initial state to the last measurement (theory §1).
#![expect(non_snake_case, reason = "the letters of the theory: P0, Q, R, F with FF' = Q")]

use std::collections::HashMap;

use nalgebra::DMatrix;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::reduce::{Design, DesignStep, Fault, GatheredCells, Preparer, Subject, Transition, Workspace, advance, ldl};
use kalfit_algebra::symmetric;
use kalfit_model::{Model, Population};

/// Largest number of roots of Q that are cached.
const MAX_CACHED_ROOTS: usize = 1024;

/// F with FF' = Q on the m kernel states with process noise, `states`; F is m × m.
#[derive(Debug, Clone)]
struct NoiseRoot {
    states: Vec<usize>,
    F: DMatrix<f64>,
}

/// Work space of the draws of one thread for one phase; `work` holds the evaluated rows, with measurements that are not
/// whitened.
#[derive(Debug)]
pub(super) struct DrawWorkspace {
    pub(super) work: Workspace,
    /// Cells on which the phase's inheritance is evaluated.
    pub(super) cells: GatheredCells,
    /// Drawn values, one for each instance of `work`.
    pub(super) values: Vec<f64>,
    x: Vec<f64>,
    scratch: Vec<f64>,
    noise_roots: HashMap<u128, NoiseRoot>,
    /// (P0, F) of the last test with FF' = P0, both r × r; P0 row-major, lower triangle.
    start: (Vec<f64>, DMatrix<f64>),
}

impl DrawWorkspace {
    pub(super) fn new(preparer: &Preparer) -> DrawWorkspace {
        let mut work = preparer.workspace();
        work.covariances = Some(Vec::new());
        let start = (Vec::new(), DMatrix::zeros(0, 0));
        DrawWorkspace {
            work,
            cells: GatheredCells::default(),
            values: Vec::new(),
            x: Vec::new(),
            scratch: Vec::new(),
            noise_roots: HashMap::new(),
            start,
        }
    }

    /// Draws ξ ~ N(μ_j, Σ), with `root` a root of Σ.
    pub(super) fn draw_initial(
        &self,
        model: &Model,
        population: &Population,
        root: &DMatrix<f64>,
        random: &mut ChaCha8Rng,
    ) -> Vec<f64> {
        let mut xi = population.mean.clone();
        let regressions = model.mean.regression.iter().zip(&population.coefficients).zip(&self.work.covariates);
        for ((regression, coefficient), covariate) in regressions {
            xi[regression.element] += coefficient * covariate;
        }
        add_noise(root, random, |i, value| xi[i] += value);
        xi
    }

    /// Draws the measured values of the phase at entering coordinates σ = `entering`.
    pub(super) fn draw_values(&mut self, entering: &[f64], random: &mut ChaCha8Rng) -> Result<(), Box<Fault>> {
        self.start(entering, random);
        self.values.clear();
        let (work, mut input) = (&self.work, 0);
        for step in work.design.each_step() {
            if let Some(transition) = step.transition {
                advance(&mut self.x, 1, transition.view(), &mut self.scratch);
                for &state in &work.design.frame.driven {
                    self.x[state as usize] += work.data.inputs[input];
                    input += 1;
                }
                let noise = dense_noise(&mut self.noise_roots, transition);
                add_noise(&noise.F, random, |i, value| self.x[noise.states[i]] += value);
            }
            measure(work, &self.x, &step, &mut self.values, random)?;
        }
        Ok(())
    }

    /// The state after the last step, in the order of the kernels.
    pub(super) fn last(&self) -> &[f64] {
        &self.x
    }

    /// Draws x_0 = a + Eσ + ζ, with σ = `entering`.
    fn start(&mut self, entering: &[f64], random: &mut ChaCha8Rng) {
        let Design { frame, variance, .. } = &self.work.design;
        let (p, r) = (frame.p, frame.r);
        self.x.clone_from(&self.work.data.start);
        for (state, x) in self.x.iter_mut().enumerate() {
            *x += frame.sensitivity[state * p..][..p].iter().zip(entering).map(|(a, xi)| a * xi).sum::<f64>();
        }
        if self.start.0 != *variance || self.start.1.nrows() != r {
            let P0 = DMatrix::from_fn(r, r, |i, j| variance[i.max(j) * r + i.min(j)]);
            self.start = (variance.clone(), symmetric::square_root(&P0));
        }
        add_noise(&self.start.1, random, |i, value| self.x[i] += value);
    }
}

/// Appends z = Mx + d + v of one step; correlated noise is drawn by R = LDL'.
fn measure(
    work: &Workspace,
    x: &[f64],
    step: &DesignStep<'_>,
    values: &mut Vec<f64>,
    random: &mut ChaCha8Rng,
) -> Result<(), Box<Fault>> {
    let first = values.len();
    for (line, row) in step.lines.clone().zip(step.rows.clone()) {
        let (states, h) = work.design.terms(line);
        let known: f64 = states.iter().zip(h).map(|(&state, h)| h * x[state as usize]).sum();
        // the design's measured values were set to zero, so that z - d is -d
        values.push(known - work.data.values[row]);
    }
    let joint = joint_noise(work, step)?;
    let m = step.rows.len();
    let variance = |i: usize| joint.as_ref().map_or(work.design.noise[step.lines.start + i], |R| R[i * m + i]);
    let white: Vec<f64> = (0..m).map(|i| variance(i).sqrt() * normal(random)).collect();
    for (i, value) in values[first..].iter_mut().enumerate() {
        let correlated_terms = joint.iter().flat_map(|R| (0..i).map(|k| R[i * m + k] * white[k]));
        *value += white[i] + correlated_terms.sum::<f64>();
    }
    Ok(())
}

/// L and D of R = LDL' for the measurements of a step, m × m, row-major; `None` where the noises are not correlated.
fn joint_noise(work: &Workspace, step: &DesignStep<'_>) -> Result<Option<Vec<f64>>, Box<Fault>> {
    let (rows, line) = (step.rows.clone(), step.lines.start);
    let covariances = work.covariances.as_deref().unwrap_or_default();
    // the covariances of one step are adjacent, in the order of the steps
    let begin = covariances.partition_point(|&(i, ..)| i < rows.start);
    let step_covariances = covariances[begin..].iter().take_while(|(i, ..)| *i < rows.end);
    let m = rows.len();
    let mut R: Option<Vec<f64>> = None;
    for &(i, j, value) in step_covariances {
        let R = R.get_or_insert_with(|| {
            let variance = |k: usize| if k / m == k % m { work.design.noise[line + k / m] } else { 0.0 };
            (0..m * m).map(variance).collect()
        });
        R[(i.max(j) - rows.start) * m + i.min(j) - rows.start] += value;
    }
    if let Some(R) = &mut R {
        ldl(R, m).map_err(|bad| Fault::new(Subject::StepNoise, bad).on(work.instances.get(rows.start).row))?;
    }
    Ok(R)
}

/// The root of a transition's Q, which is computed only where the cache does not have it.
fn dense_noise<'a>(noise_roots: &'a mut HashMap<u128, NoiseRoot>, transition: &Transition) -> &'a NoiseRoot {
    if noise_roots.len() >= MAX_CACHED_ROOTS && !noise_roots.contains_key(&transition.digest()) {
        noise_roots.clear();
    }
    noise_roots.entry(transition.digest()).or_insert_with(|| {
        let pairs = &transition.pattern.pairs;
        let mut states: Vec<usize> = pairs.iter().flat_map(|&(i, j)| [i as usize, j as usize]).collect();
        states.sort_unstable();
        states.dedup();
        let local = |state: usize| states.binary_search(&state).expect("every state of a pair is listed");
        let Q = transition.dense_noise(states.len(), local);
        NoiseRoot { F: symmetric::square_root(&Q), states }
    })
}

/// Draws ε ~ N(0, I) and adds Fε: calls `add(i, F_ic ε_c)` for all i and c.
pub(super) fn add_noise(F: &DMatrix<f64>, random: &mut ChaCha8Rng, mut add: impl FnMut(usize, f64)) {
    for c in 0..F.ncols() {
        let epsilon = normal(random);
        (0..F.nrows()).for_each(|i| add(i, F[(i, c)] * epsilon));
    }
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}
