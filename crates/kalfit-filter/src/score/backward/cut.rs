//! Stretches that the design pass has cut into segments, in the passes over a test.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, N")]

use crate::reduce::segments::SegmentedStretch;
use crate::reduce::segments::strands::StretchData;
use crate::score::backward::equal::psi_times_root;
use crate::score::backward::input::BackwardInput;
use crate::score::backward::sink::Sink;
use crate::score::backward::work::{BackwardWork, Segment};
use crate::score::segments::{DataAdjoints, DesignAdjoints, ForwardStretch, StateAdjoints};

impl<'a> BackwardInput<'a> {
    /// Whether the sink accepts sums over every stretch that is cut. Where it does not, the gains of every row are
    /// needed.
    pub(crate) fn sums_suffice<S: Sink>(&self, sink: &mut S) -> bool {
        let mut first = 0;
        self.design.stretches().all(|stretch| {
            let steps = first..first + stretch.count;
            first = steps.end;
            self.gains.segmented(&stretch.rows).is_none() || sink.accepts_sums(steps)
        })
    }

    /// The stretch of a segment that is cut.
    pub(super) fn cut_stretch(&self, segment: &Segment) -> &'a SegmentedStretch {
        let rows = &self.design.stretch(segment.stretch).rows;
        self.gains.segmented(rows).expect("the design pass has cut the stretch")
    }

    fn cut_data(&self, stretch: &SegmentedStretch) -> StretchData<'a> {
        StretchData { values: &self.values[stretch.rows.clone()], tests: 1 }
    }

    /// The forward pass over a stretch that is cut. Innovations are not stored.
    pub(super) fn forward_cut(&self, segment: &Segment, work: &mut BackwardWork) {
        let stretch = self.cut_stretch(segment);
        let BackwardWork { e, cut_stretches, now, .. } = work;
        e.next(stretch.rows.len());
        if self.zero_data {
            cut_stretches.push(None);
        } else {
            let states = &stretch.prefix.states;
            let mut x: Vec<f64> = states.iter().map(|&state| now.x[state]).collect();
            cut_stretches.push(Some(ForwardStretch::new(stretch, self.cut_data(stretch), &mut x)));
            states.iter().zip(&x).for_each(|(&state, x)| now.x[state] = *x);
        }
        if self.needs_covariance() {
            let (P, Psi) = stretch.end();
            now.P.copy_from_slice(P);
            psi_times_root((Psi, self.design.frame.n), self.moments, &mut now.Psi);
        }
    }

    /// The backward pass over a stretch that is cut: the sums of its adjoints go to `work.measured` and `work.moved`.
    pub(super) fn back_cut(&self, segment: &Segment, work: &mut BackwardWork) {
        let stretch = self.cut_stretch(segment);
        let (states, N, c) = (&stretch.prefix.states, stretch.prefix.size(), self.moments.columns);
        let r = self.design.frame.r;
        let forward = work.cut_stretches.pop().expect("the forward pass has stored the stretch");
        let adjoint = &mut work.adjoint;
        let data = match forward {
            None => DataAdjoints::zeros(N),
            Some(forward) => {
                let mut own: Vec<f64> = states.iter().map(|&state| adjoint.r[state]).collect();
                let found = forward.back(stretch, (self.cut_data(stretch), self.wanted), &mut own);
                states.iter().zip(&own).for_each(|(&state, own)| adjoint.r[state] = *own);
                found.into_iter().next().expect("adjoints of one test")
            }
        };
        let mut state = StateAdjoints { rho: Vec::with_capacity(N * c), N: vec![0.0; N * N] };
        states.iter().for_each(|&state_index| state.rho.extend_from_slice(&adjoint.rho[state_index * c..][..c]));
        (0..r).for_each(|i| state.N[i * N..][..r].copy_from_slice(&adjoint.N[i * r..][..r]));
        let design = DesignAdjoints::of(stretch, (&self.moments.root, c), &mut state);
        for (k, &state_index) in states.iter().enumerate() {
            adjoint.rho[state_index * c..][..c].copy_from_slice(&state.rho[k * c..][..c]);
        }
        (0..r).for_each(|i| adjoint.N[i * r..][..r].copy_from_slice(&state.N[i * N..][..r]));
        self.write_cut((segment, stretch), (&design, &data), work);
    }

    fn write_cut(
        &self,
        (segment, stretch): (&Segment, &SegmentedStretch),
        (design, data): (&DesignAdjoints, &DataAdjoints),
        work: &mut BackwardWork,
    ) {
        let (prefix, N) = (&*stretch.prefix, stretch.prefix.size());
        let bar = &mut work.measured;
        bar.noise.clear();
        bar.noise.push(design.noise + 0.5 * data.uu());
        bar.value.clear();
        bar.value.push(-data.u());
        bar.h.clear();
        if self.wanted.equation {
            bar.h.resize(self.design.frame.n, 0.0);
            for (i, &state) in prefix.states.iter().enumerate() {
                bar.h[state] = design.h[i] + data.h(i);
            }
        }
        let Some(transition) = self.design.stretch(segment.stretch).transition else { return };
        let (pattern, bar) = (&transition.pattern, &mut work.moved);
        bar.input.clear();
        bar.q.clear();
        bar.q.extend(pattern.pairs.iter().map(|&(i, j)| {
            let (i, j) = (i as usize, j as usize);
            let one = design.q[i * N + j] + 0.5 * data.rr(i, j);
            if i == j { one } else { 2.0 * one }
        }));
        bar.phi.clear();
        let place =
            |state: usize| prefix.place(state).expect("the states of a segment include those of the transition");
        bar.phi.extend(transition.entries().map(|(i, j, _)| {
            let (i, j) = (place(i), place(j));
            if self.wanted.motion { design.phi[i * N + j] + data.phi(i, j) } else { 0.0 }
        }));
    }
}
