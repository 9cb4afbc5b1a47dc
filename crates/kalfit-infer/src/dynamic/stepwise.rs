//! Tests at an α, μ and Σ as sequences of time steps: motions and scalar measurements of the states.
//!
//! The entry into a phase is a motion like any other, from the last state of the phase before; the first entry starts
//! from no states. The tests of a group follow each other; the effects of the groups of a test are states that precede
//! the states of the phase. Correlated noises of a step are further states during the step.

use nalgebra::{DMatrix, DVector};

use kalfit_filter::reduce::{Data, Design, DesignStep, PhasedReducer, PhasedWork, ReduceError, Transition};
use kalfit_filter::score::InitialLaw;
use kalfit_model::Alpha;
use kalfit_model::{Evidence, PhasedTest};
use kalfit_search::DynamicError;
use kalfit_search::ProfileLikelihood;

/// A point in all coordinates: α and the law of ξ.
pub(super) struct EvaluationPoint {
    reducer: PhasedReducer,
    law: InitialLaw,
    /// Roots F of the covariances FF' of the per-test effects, then of each level of groups from the innermost on.
    roots: Vec<DMatrix<f64>>,
}

/// A test, and the indices of the test's groups from the innermost level on.
pub(super) struct GroupedTest<'t> {
    pub(super) test: &'t PhasedTest,
    pub(super) groups: Vec<usize>,
}

/// Tests that follow each other, evaluated at a point.
pub(super) struct RecordMoments {
    sections: Vec<Section>,
}

/// A phase of a test: the entry into the phase, and the steps of the phase.
struct Section {
    entry: MotionValues,
    design: Design,
    data: Data,
    /// (i, j, covariance) of the noises of the scalar measurements i and j, which are of one step.
    covariances: Vec<(usize, usize, f64)>,
    /// Number of group effects, which are states that precede the states of the phase.
    group_states: usize,
}

/// x → φx + b + w, w ~ N(0, Q), or the slopes of φ, Q and b; φ is (states after) × (states before).
pub(super) struct MotionValues {
    pub(super) phi: DMatrix<f64>,
    pub(super) noise: DMatrix<f64>,
    pub(super) input: DVector<f64>,
}

/// h, R and z - d of a scalar measurement, or the slopes of h, R and z - d.
pub(super) struct LineValues {
    pub(super) h: DVector<f64>,
    pub(super) noise: f64,
    pub(super) value: f64,
}

/// A motion, and the measurements after the motion.
pub(super) struct TimeStep {
    pub(super) motion: Option<MotionValues>,
    pub(super) lines: Vec<LineValues>,
}

impl EvaluationPoint {
    pub(super) fn new(
        objective: &ProfileLikelihood<'_>,
        alpha: &Alpha,
        law: InitialLaw,
    ) -> Result<EvaluationPoint, DynamicError> {
        let reducer = PhasedReducer::scoring(objective.model, alpha, objective.slots).map_err(Box::new)?;
        let levels = objective.model.levels.len() + 1;
        let width = law.root.ncols() / levels;
        let roots = (0..levels).map(|level| law.root.columns(level * width, width).into_owned()).collect();
        Ok(EvaluationPoint { reducer, law, roots })
    }

    /// Evaluates tests one after the other.
    pub(super) fn record(&self, members: &[GroupedTest<'_>]) -> Result<RecordMoments, ReduceError> {
        let mut work = self.reducer.workspace();
        work.phases.iter_mut().for_each(|phase| phase.covariances = Some(Vec::new()));
        let mut sections: Vec<Section> = Vec::new();
        for (k, member) in members.iter().enumerate() {
            let last = k.checked_sub(1).map(|k| &members[k]).zip(sections.last().map(Section::states));
            sections.extend(self.sections(member, last, &mut work)?);
        }
        Ok(RecordMoments { sections })
    }

    /// The phases of a test. `last`: the previous test, and the number of states at the end of the previous test.
    fn sections(
        &self,
        member: &GroupedTest<'_>,
        last: Option<(&GroupedTest<'_>, usize)>,
        work: &mut PhasedWork,
    ) -> Result<Vec<Section>, ReduceError> {
        let group_states = member.groups.len() * self.law.root.nrows();
        let (mut sections, mut covariates) = (Vec::new(), Vec::new());
        for ((phase, evidence), room) in self.reducer.phases().iter().zip(&*member.test.phases).zip(&mut work.phases) {
            let Evidence::Rows(rows) = evidence else { unreachable!("tests that are no rows were refused") };
            let (design, data, own) = phase.reducer.evaluated(rows, room).map_err(|error| phase.named(error))?;
            covariates.extend(own);
            let covariances = room.covariances.clone().unwrap_or_default();
            sections.push(Section {
                entry: MotionValues::zero_motion((0, 0)),
                design,
                data,
                covariances,
                group_states,
            });
        }
        let mean = self.law.mean_of(&covariates);
        let (mut first, mut before) = (0, last.map_or(0, |(_, states)| states));
        for (at, section) in sections.iter_mut().enumerate() {
            let own = self.reducer.phases()[at].own;
            let a = section.sensitivity();
            let mut entry = section.start(before, &a * mean.rows(first, own).insert_rows(own, a.ncols() - own, 0.0));
            entry.add_noise(&(a.columns(0, own) * self.roots[0].rows(first, own)), group_states);
            if at == 0 {
                self.groups(&mut entry, &a.columns(0, own).into_owned(), (member, last.map(|(member, _)| member)));
            } else {
                self.inherit((&mut entry, &a), (at, member, group_states), work)?;
            }
            section.entry = entry;
            (first, before) = (first + own, section.states());
        }
        Ok(sections)
    }

    /// Adds the effects of groups to an entry: states of groups shared with the previous test are kept unchanged,
    /// states of all other groups start anew from the groups' Σ.
    fn groups(
        &self,
        entry: &mut MotionValues,
        a: &DMatrix<f64>,
        (member, last): (&GroupedTest<'_>, Option<&GroupedTest<'_>>),
    ) {
        let (p, group_states) = (self.law.root.nrows(), member.groups.len() * self.law.root.nrows());
        for (level, group) in member.groups.iter().enumerate() {
            let place = level * p;
            if last.is_some_and(|last| last.groups[level] == *group) {
                entry.phi.view_mut((place, place), (p, p)).fill_with_identity();
                entry.phi.view_mut((group_states, place), a.shape()).copy_from(a);
                continue;
            }
            let root = &self.roots[level + 1];
            let mut fresh = DMatrix::zeros(entry.phi.nrows(), root.ncols());
            fresh.rows_mut(place, p).copy_from(root);
            fresh.rows_mut(group_states, a.nrows()).copy_from(&(a * root));
            entry.noise += &fresh * fresh.transpose();
        }
    }

    /// Adds the part of an entry that a later phase inherits.
    fn inherit(
        &self,
        (entry, a): (&mut MotionValues, &DMatrix<f64>),
        (at, member, group_states): (usize, &GroupedTest<'_>, usize),
        work: &mut PhasedWork,
    ) -> Result<(), ReduceError> {
        let [before, phase] = [&self.reducer.phases()[at - 1], &self.reducer.phases()[at]];
        let Evidence::Rows(rows) = &member.test.phases[at] else { unreachable!("tests that are no rows were refused") };
        let inherited = phase.inherited(rows, &mut work.cells)?;
        let carried = a * &inherited.transition;
        for (state, &place) in before.reducer.preparer().order.place.iter().enumerate() {
            entry.phi.view_mut((group_states, group_states + place), (a.nrows(), 1)).copy_from(&carried.column(state));
        }
        entry.phi.view_mut((0, 0), (group_states, group_states)).fill_with_identity();
        let mut input = entry.input.rows_mut(group_states, a.nrows());
        input += a * &inherited.input;
        Ok(())
    }
}

impl Section {
    /// Number of states at the end of the phase, including the group effects.
    fn states(&self) -> usize {
        self.group_states + self.design.frame.n
    }

    fn sensitivity(&self) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.design.frame.n, self.design.frame.p, &self.design.frame.sensitivity)
    }

    /// The entry from `before` states, with φ = 0; `own`: the contribution of the mean.
    fn start(&self, before: usize, own: DVector<f64>) -> MotionValues {
        let (group_states, n, r) = (self.group_states, self.design.frame.n, self.design.frame.r);
        let mut entry = MotionValues::zero_motion((group_states + n, before));
        entry.input.rows_mut(group_states, n).copy_from(&(own + DVector::from_column_slice(&self.data.start)));
        for i in 0..r {
            for j in 0..r {
                entry.noise[(group_states + i, group_states + j)] = self.design.variance[i.max(j) * r + i.min(j)];
            }
        }
        entry
    }
}

impl RecordMoments {
    /// All time steps, in order.
    pub(super) fn moments(&self) -> TimeSteps<'_> {
        TimeSteps { record: self, section: 0, step: None, inputs: 0, crossed: 0, noise_states: 0 }
    }
}

/// Iterator over the time steps of a record.
pub(super) struct TimeSteps<'r> {
    record: &'r RecordMoments,
    section: usize,
    /// Index of the next step of the section; `None` before the entry into the section.
    step: Option<usize>,
    /// Number of inputs of the section's data that earlier steps took.
    inputs: usize,
    /// Number of the section's covariances of noises that earlier steps took.
    crossed: usize,
    /// Number of noises that are states during the present step.
    noise_states: usize,
}

impl Iterator for TimeSteps<'_> {
    type Item = TimeStep;

    fn next(&mut self) -> Option<TimeStep> {
        let section = self.record.sections.get(self.section)?;
        let Some(k) = self.step else {
            (self.step, self.inputs, self.crossed) = (Some(0), 0, 0);
            let entry = section.entry.with_noises(std::mem::take(&mut self.noise_states), &DMatrix::zeros(0, 0));
            return Some(TimeStep { motion: Some(entry), lines: Vec::new() });
        };
        if k == section.design.steps() {
            (self.section, self.step) = (self.section + 1, None);
            return self.next();
        }
        self.step = Some(k + 1);
        let step = section.design.step(k);
        let crossed = self.crossed(section, &step);
        let noises = section.noises(&step, crossed);
        let motion = step.transition.map(|transition| self.motion(section, transition));
        let before = std::mem::replace(&mut self.noise_states, noises.len());
        let states = section.states();
        let motion = match before + noises.len() {
            0 => motion,
            _ => {
                let covariance = section.covariance(&step, &noises, crossed);
                Some(motion.unwrap_or_else(|| MotionValues::identity_motion(states)).with_noises(before, &covariance))
            }
        };
        let line =
            |(line, row)| section.line((line, row), (states + noises.len(), noises.iter().position(|&at| at == row)));
        Some(TimeStep { motion, lines: step.lines.zip(step.rows).map(line).collect() })
    }
}

impl TimeSteps<'_> {
    /// Takes the covariances of noises of a step.
    fn crossed<'s>(&mut self, section: &'s Section, step: &DesignStep<'_>) -> &'s [(usize, usize, f64)] {
        let left = &section.covariances[self.crossed..];
        let own = left.iter().take_while(|(i, ..)| *i < step.rows.end).count();
        self.crossed += own;
        &left[..own]
    }

    /// φ, Q and b of a transition; takes the inputs b from the section's data.
    fn motion(&mut self, section: &Section, transition: &Transition) -> MotionValues {
        let (n, group_states) = (section.design.frame.n, section.group_states);
        let mut motion = MotionValues::identity_motion(group_states + n);
        motion.phi.view_mut((group_states, group_states), (n, n)).copy_from(&transition.dense_phi(n, |i| i));
        motion.noise.view_mut((group_states, group_states), (n, n)).copy_from(&transition.dense_noise(n, |i| i));
        for &state in &section.design.frame.driven {
            motion.input[group_states + state as usize] = section.data.inputs[self.inputs];
            self.inputs += 1;
        }
        motion
    }
}

impl Section {
    /// Scalar measurements of a step whose noises are correlated.
    fn noises(&self, step: &DesignStep<'_>, crossed: &[(usize, usize, f64)]) -> Vec<usize> {
        let is_crossed = |row: &usize| crossed.iter().any(|(i, j, _)| i == row || j == row);
        step.rows.clone().filter(is_crossed).collect()
    }

    /// Covariance of `noises`, noises × noises.
    fn covariance(&self, step: &DesignStep<'_>, noises: &[usize], crossed: &[(usize, usize, f64)]) -> DMatrix<f64> {
        let mut covariance = DMatrix::zeros(noises.len(), noises.len());
        for (k, row) in noises.iter().enumerate() {
            covariance[(k, k)] = self.design.noise[step.lines.start + row - step.rows.start];
        }
        let place = |row: usize| noises.iter().position(|&at| at == row);
        for &(i, j, value) in crossed {
            if let (Some(i), Some(j)) = (place(i), place(j)) {
                covariance[(i, j)] += value;
                covariance[(j, i)] += value;
            }
        }
        covariance
    }

    /// A scalar measurement on `states` states; `noise`: index of the measurement's noise among the noises that are
    /// states; `None` for an uncorrelated noise.
    fn line(&self, (line, row): (usize, usize), (states, noise): (usize, Option<usize>)) -> LineValues {
        let (of, terms) = self.design.terms(line);
        let mut h = DVector::zeros(states);
        of.iter().zip(terms).for_each(|(&state, &term)| h[self.group_states + state as usize] = term);
        if let Some(place) = noise {
            h[self.states() + place] = 1.0;
        }
        let own = if noise.is_some() { 0.0 } else { self.design.noise[line] };
        LineValues { h, noise: own, value: self.data.values[row] }
    }
}

impl MotionValues {
    /// A motion with φ = 0 (`to` × `from`), Q = 0 and b = 0: the slopes of a constant motion.
    pub(super) fn zero_motion((to, from): (usize, usize)) -> MotionValues {
        MotionValues { phi: DMatrix::zeros(to, from), noise: DMatrix::zeros(to, to), input: DVector::zeros(to) }
    }

    /// The motion of n states that do not change.
    fn identity_motion(n: usize) -> MotionValues {
        MotionValues { phi: DMatrix::identity(n, n), ..MotionValues::zero_motion((n, n)) }
    }

    /// Adds noise with the root `root` to the states from `first` on.
    fn add_noise(&mut self, root: &DMatrix<f64>, first: usize) {
        let n = root.nrows();
        let mut noise = self.noise.view_mut((first, first), (n, n));
        noise += root * root.transpose();
    }

    /// This motion with noises as additional last states: `before` noises in the states before, noises with
    /// `covariance` in the states after.
    fn with_noises(&self, before: usize, covariance: &DMatrix<f64>) -> MotionValues {
        let ((to, from), now) = (self.phi.shape(), covariance.nrows());
        let mut motion = MotionValues::zero_motion((to + now, from + before));
        motion.phi.view_mut((0, 0), (to, from)).copy_from(&self.phi);
        motion.noise.view_mut((0, 0), (to, to)).copy_from(&self.noise);
        motion.noise.view_mut((to, to), (now, now)).copy_from(covariance);
        motion.input.rows_mut(0, to).copy_from(&self.input);
        motion
    }
}
