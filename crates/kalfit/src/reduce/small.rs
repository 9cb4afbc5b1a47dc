//! The design pass over many equal steps of one measurement, for few moving states: the steps of [`kernel`](super::kernel) on
//! arrays of known size, which stay in registers.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, Q, G = P h, K, T, S")]

use crate::reduce::design::{Design, Stretch, Transition};
use crate::reduce::kernel::{ScalarUpdate, inform, mirror, update};
use crate::reduce::schedule::{GainSchedule, GainsWork};
use kalfit_lanes::Real;

/// The transition of the N states that move; W columns of Ψ. Those of states that rest are constants.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SmallMotion<const N: usize, const W: usize> {
    pub(crate) phi: [[f64; N]; N],
    Q: [[f64; N]; N],
    /// What the states that rest add to φΨ.
    pub(crate) c: [[f64; W]; N],
}

/// Steps of one measurement.
struct Small<const N: usize, const W: usize> {
    motion: SmallMotion<N, W>,
    h: [f64; N],
    /// What they add to T.
    t: [f64; W],
    noise: f64,
}

/// So many steps of a stretch.
pub(crate) type SmallSteps = fn(&Design, &Stretch<'_>, usize, &mut GainsWork, &mut GainSchedule);

/// The steps of a stretch, if it is of this kind.
pub(crate) fn steps(design: &Design, stretch: &Stretch<'_>) -> Option<SmallSteps> {
    if stretch.lines.len() != 1 {
        return None;
    }
    Some(match (moving(design, stretch), design.frame.p) {
        (1, 0) => run::<1, 0>,
        (1, 1) => run::<1, 1>,
        (1, 2) => run::<1, 2>,
        (1, 3) => run::<1, 3>,
        (2, 0) => run::<2, 0>,
        (2, 1) => run::<2, 1>,
        (2, 2) => run::<2, 2>,
        (2, 3) => run::<2, 3>,
        (3, 0) => run::<3, 0>,
        (3, 1) => run::<3, 1>,
        (3, 2) => run::<3, 2>,
        (3, 3) => run::<3, 3>,
        (4, 0) => run::<4, 0>,
        (4, 1) => run::<4, 1>,
        (4, 2) => run::<4, 2>,
        (4, 3) => run::<4, 3>,
        _ => return None,
    })
}

/// States that noise reaches or that move: the first ones of the kernels' order.
pub(crate) fn moving(design: &Design, stretch: &Stretch<'_>) -> usize {
    let last = stretch.transition.and_then(|transition| transition.pattern.moved.last());
    design.frame.r.max(last.map_or(0, |row| row.state as usize + 1))
}

fn run<const N: usize, const W: usize>(
    design: &Design,
    stretch: &Stretch<'_>,
    many: usize,
    work: &mut GainsWork,
    out: &mut GainSchedule,
) {
    let r = design.frame.r;
    let step = Small::<N, W>::new(design, stretch, &work.Psi);
    let (mut P, mut Psi) = ([[0.0; N]; N], [[0.0; W]; N]);
    for i in 0..r {
        for j in 0..=i {
            (P[i][j], P[j][i]) = (work.P[i * r + j], work.P[i * r + j]);
        }
    }
    for (i, row) in Psi.iter_mut().enumerate() {
        row.copy_from_slice(&work.Psi[i * W..][..W]);
    }
    out.gains.reserve((1 + r) * many);
    out.sensitivities.reserve(W * many);
    let mut J = vec![0.0; out.sums.J.len()];
    for _ in 0..many {
        step.take(&mut P, &mut Psi, r, &mut J, out);
    }
    for (sum, part) in out.sums.J.iter_mut().zip(&J) {
        *sum += *part;
    }
    for i in 0..r {
        work.P[i * r..][..=i].copy_from_slice(&P[i][..=i]);
    }
    for (i, row) in Psi.iter().enumerate() {
        work.Psi[i * W..][..W].copy_from_slice(row);
    }
}

impl<const N: usize, const W: usize> SmallMotion<N, W> {
    /// Of steps without a transition, if there is none. `Psi`: n × W, or empty.
    pub(crate) fn new(transition: Option<&Transition>, Psi: &[f64]) -> SmallMotion<N, W> {
        let mut motion = SmallMotion { phi: [[0.0; N]; N], Q: [[0.0; N]; N], c: [[0.0; W]; N] };
        (0..N).for_each(|i| motion.phi[i][i] = 1.0);
        let Some(transition) = transition else { return motion };
        for row in &transition.pattern.moved {
            let i = row.state as usize;
            motion.phi[i] = [0.0; N];
            for k in row.start as usize..row.end as usize {
                match transition.pattern.columns[k] as usize {
                    j if j < N => motion.phi[i][j] = transition.phi[k],
                    j if !Psi.is_empty() => add(&mut motion.c[i], transition.phi[k], &Psi[j * W..]),
                    _ => {}
                }
            }
        }
        for (&(i, j), &q) in transition.pattern.pairs.iter().zip(&transition.q) {
            let (i, j) = (i as usize, j as usize);
            (motion.Q[i][j], motion.Q[j][i]) = (q, q);
        }
        motion
    }

    /// φΨ.
    #[inline(always)]
    pub(crate) fn advance(&self, Psi: &[[f64; W]; N]) -> [[f64; W]; N] {
        let mut moved = self.c;
        for i in 0..N {
            for k in 0..N {
                for j in 0..W {
                    moved[i][j] = self.phi[i][k].fma(Psi[k][j], moved[i][j]);
                }
            }
        }
        moved
    }

    /// φPφ' + Q.
    #[inline(always)]
    pub(crate) fn predict(&self, P: &[[f64; N]; N]) -> [[f64; N]; N] {
        let mut moved = self.Q;
        let mut phiP = [[0.0; N]; N];
        for i in 0..N {
            for k in 0..N {
                for j in 0..N {
                    phiP[i][j] = self.phi[i][k].fma(P[k][j], phiP[i][j]);
                }
            }
        }
        for i in 0..N {
            for j in 0..=i {
                let mut sum = 0.0;
                for k in 0..N {
                    sum = self.phi[j][k].fma(phiP[i][k], sum);
                }
                moved[i][j] += sum;
                moved[j][i] = moved[i][j];
            }
        }
        moved
    }
}

impl<const N: usize, const W: usize> Small<N, W> {
    fn new(design: &Design, stretch: &Stretch<'_>, Psi: &[f64]) -> Small<N, W> {
        let line = stretch.lines.start;
        let motion = SmallMotion::new(stretch.transition.map(|transition| &**transition), Psi);
        let mut step = Small { motion, h: [0.0; N], t: [0.0; W], noise: design.noise[line] };
        let (states, h) = design.terms(line);
        for (&state, &h) in states.iter().zip(h) {
            match state as usize {
                i if i < N => step.h[i] = h,
                i => add(&mut step.t, h, &Psi[i * W..]),
            }
        }
        step
    }

    /// One step; its gains, sensitivities and information go to `out` and `J`.
    #[inline(always)]
    fn take(&self, P: &mut [[f64; N]; N], Psi: &mut [[f64; W]; N], r: usize, J: &mut [f64], out: &mut GainSchedule) {
        let predicted = self.motion.advance(Psi);
        *P = self.motion.predict(P);
        let (mut G, mut K, mut T) = ([0.0; N], [0.0; N], self.t);
        for i in 0..N {
            for j in 0..W {
                T[j] = self.h[i].fma(predicted[i][j], T[j]);
            }
        }
        let states: [u32; N] = std::array::from_fn(|i| i as u32);
        let ScalarUpdate { S, weight, kept } =
            update(N, &states, &self.h, self.noise, P.as_flattened_mut(), &mut G, &mut K);
        mirror(P.as_flattened_mut(), N);
        for i in 0..N {
            for j in 0..W {
                Psi[i][j] = K[i].fnma(T[j], predicted[i][j]);
            }
        }
        inform(&T, weight, J);
        out.gains.push(weight);
        out.gains.extend_from_slice(&K[..r]);
        out.sensitivities.extend_from_slice(&T);
        out.sums.count(S, kept);
    }
}

fn add(sum: &mut [f64], factor: f64, row: &[f64]) {
    for (sum, &x) in sum.iter_mut().zip(row) {
        *sum = factor.fma(x, *sum);
    }
}
