//! The forward filter at ξ = x̂ under the gains of a design, step by step.

use crate::reduce::Transition;
use crate::score::backward::{Run, dot};

/// x̄ (n); where adjoints of φ or h are wanted P (r × r, both triangles) and ΨC (n × c) too.
#[derive(Debug, Clone, Default)]
pub(super) struct Filtered {
    pub(super) x: Vec<f64>,
    pub(super) P: Vec<f64>,
    pub(super) Psi: Vec<f64>,
    rows: Vec<f64>,
    G: Vec<f64>,
    T: Vec<f64>,
}

/// What [`Filtered::save`] has kept, to read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) x: &'a [f64],
    pub(super) P: &'a [f64],
    pub(super) Psi: &'a [f64],
}

impl<'a> Seen<'a> {
    pub(super) fn new(kept: &'a [f64], (n, r): (usize, usize)) -> Seen<'a> {
        let (x, rest) = kept.split_at(n);
        let (P, Psi) = rest.split_at(r * r);
        Seen { x, P, Psi }
    }
}

impl Filtered {
    /// x_0 = a + Ax̂, P0 and AC.
    pub(super) fn begin(&mut self, run: &Run<'_>) {
        let frame = &run.design.frame;
        let (n, p, r, c) = (frame.n, frame.p, frame.r, run.moments.columns);
        self.x.clear();
        self.x.extend_from_slice(run.start);
        self.P.clear();
        self.Psi.clear();
        if run.tracked() {
            let lower = &run.design.variance;
            self.P.extend((0..r * r).map(|ij| lower[(ij / r).max(ij % r) * r + (ij / r).min(ij % r)]));
            self.Psi.resize(n * c, 0.0);
        }
        for i in 0..n {
            for k in 0..p {
                let a = frame.sensitivity[i * p + k];
                if a == 0.0 {
                    continue;
                }
                self.x[i] += a * run.moments.mean[k];
                let root = &run.moments.root[k * c..][..c];
                let row = self.Psi.iter_mut().skip(i * c);
                row.zip(root).for_each(|(Psi, root)| *Psi += a * root);
            }
        }
    }

    pub(super) fn save(&self, out: &mut Vec<f64>) {
        out.extend_from_slice(&self.x);
        out.extend_from_slice(&self.P);
        out.extend_from_slice(&self.Psi);
    }

    pub(super) fn load(&mut self, kept: &[f64], sizes: (usize, usize)) {
        let seen = Seen::new(kept, sizes);
        for (own, seen) in [(&mut self.x, seen.x), (&mut self.P, seen.P), (&mut self.Psi, seen.Psi)] {
            own.clear();
            own.extend_from_slice(seen);
        }
    }

    pub(super) fn advance(&mut self, transition: &Transition, inputs: &[f64], run: &Run<'_>) {
        let (r, c) = (run.design.frame.r, run.moments.columns);
        crate::reduce::advance(&mut self.x, 1, transition, &mut self.rows);
        for (&state, input) in run.design.frame.driven.iter().zip(inputs) {
            self.x[state as usize] += input;
        }
        if !self.Psi.is_empty() {
            crate::reduce::advance(&mut self.Psi, c, transition, &mut self.rows);
        }
        if !self.P.is_empty() {
            forth(&mut self.P, r, transition, &mut self.rows);
            for (&(i, j), &q) in transition.pattern.pairs.iter().zip(&transition.q) {
                let (i, j) = (i as usize, j as usize);
                self.P[i * r + j] += q;
                if i != j {
                    self.P[j * r + i] += q;
                }
            }
        }
    }

    /// The innovation of a row, which goes to the end of `e` unless it is there already; and the update by it.
    pub(super) fn measure(&mut self, run: &Run<'_>, (line, row): (usize, usize), e: &mut Vec<f64>) {
        let (r, c) = (run.design.frame.r, run.moments.columns);
        let (states, h) = run.design.terms(line);
        let (_, K, T) = run.gains.row(row);
        if row == e.len() {
            let terms = states.iter().zip(h);
            e.push(terms.fold(run.values[row], |e, (&state, &h)| e - h * self.x[state as usize]));
        }
        for i in 0..r {
            self.x[i] += K[i] * e[row];
        }
        if !self.Psi.is_empty() {
            run.times_root(T, &mut self.T);
            for i in 0..r {
                self.Psi[i * c..][..c].iter_mut().zip(&self.T).for_each(|(Psi, T)| *Psi -= K[i] * T);
            }
        }
        if !self.P.is_empty() {
            self.joseph(r, (states, h), K, run.design.noise[line]);
        }
    }

    /// P ← (I-Kh')P(I-Kh')' + KRK'.
    fn joseph(&mut self, r: usize, (states, h): (&[u32], &[f64]), K: &[f64], noise: f64) {
        let reach = states.partition_point(|&state| (state as usize) < r);
        let (states, h) = (&states[..reach], &h[..reach]);
        let Filtered { P, G, .. } = self;
        G.clear();
        G.extend(P.chunks_exact(r).map(|row| states.iter().zip(h).map(|(&s, &h)| h * row[s as usize]).sum::<f64>()));
        let S = noise + states.iter().zip(h).map(|(&s, &h)| h * G[s as usize]).sum::<f64>();
        for (i, row) in P.chunks_exact_mut(r).enumerate() {
            for j in 0..r {
                row[j] += S * K[i] * K[j] - K[i] * G[j] - G[i] * K[j];
            }
        }
    }
}

/// P ← φPφ' on the r noisy states, both triangles.
fn forth(P: &mut [f64], r: usize, transition: &Transition, work: &mut Vec<f64>) {
    let moved = transition.pattern.moved.partition_point(|row| (row.state as usize) < r);
    let moved = &transition.pattern.moved[..moved];
    for side in 0..2 {
        work.clear();
        for row in moved {
            let terms = row.start as usize..row.reach as usize;
            let (phi, columns) = (&transition.phi[terms.clone()], &transition.pattern.columns[terms]);
            for j in 0..r {
                let at = |column: usize| if side == 0 { P[column * r + j] } else { P[j * r + column] };
                work.push(phi.iter().zip(columns).map(|(phi, &column)| phi * at(column as usize)).sum());
            }
        }
        for (row, new) in moved.iter().zip(work.chunks_exact(r)) {
            let i = row.state as usize;
            for (j, &value) in new.iter().enumerate() {
                P[if side == 0 { i * r + j } else { j * r + i }] = value;
            }
        }
    }
}

impl Run<'_> {
    /// TC of a row.
    #[inline]
    pub(super) fn times_root(&self, T: &[f64], out: &mut Vec<f64>) {
        let c = self.moments.columns;
        out.clear();
        out.resize(c, 0.0);
        for (&T, root) in T.iter().zip(self.moments.root.chunks_exact(c.max(1))) {
            out.iter_mut().zip(root).for_each(|(sum, root)| *sum += T * root);
        }
    }

    /// x̄, P, ΨC of a state kept as [`Filtered::save`] does.
    pub(super) fn sizes(&self) -> (usize, usize) {
        let frame = &self.design.frame;
        (frame.n, frame.r)
    }
}

/// r_i r_j + (ρρ')_ij.
pub(super) fn second(adjoint: &[f64], rho: &[f64], c: usize, i: usize, j: usize) -> f64 {
    adjoint[i] * adjoint[j] + dot(&rho[i * c..][..c], &rho[j * c..][..c])
}
