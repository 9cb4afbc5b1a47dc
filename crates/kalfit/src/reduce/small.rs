//! The design pass over many equal steps of one measurement, for few moving states: the steps of [`kernel`](super::kernel) on
//! arrays of known size, which stay in registers.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, Q, G = P h, K, T, S")]

use crate::reduce::design::{Design, Stretch, Transition};
use crate::reduce::kernel::{Update, inform, mirror, update};
use crate::reduce::schedule::{GainsWork, Schedule};
use kalfit_lanes::Real;

/// The transition of the N states that move; W columns of Ψ. Those of states that rest are constants.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion<R, const N: usize, const W: usize> {
    pub(crate) phi: [[R; N]; N],
    Q: [[R; N]; N],
    /// What the states that rest add to φΨ.
    pub(crate) c: [[R; W]; N],
}

/// Steps of one measurement.
struct Small<R, const N: usize, const W: usize> {
    motion: Motion<R, N, W>,
    h: [R; N],
    /// What they add to T.
    t: [R; W],
    noise: R,
}

/// So many steps of a stretch.
pub(crate) type Steps<R> = fn(&Design<R>, &Stretch<'_, R>, usize, &mut GainsWork<R>, &mut Schedule<R>);

/// The steps of a stretch, if it is of this kind.
pub(crate) fn steps<R: Real>(design: &Design<R>, stretch: &Stretch<'_, R>) -> Option<Steps<R>> {
    if stretch.lines.len() != 1 {
        return None;
    }
    Some(match (moving(design, stretch), design.frame.p) {
        (1, 0) => run::<R, 1, 0>,
        (1, 1) => run::<R, 1, 1>,
        (1, 2) => run::<R, 1, 2>,
        (1, 3) => run::<R, 1, 3>,
        (2, 0) => run::<R, 2, 0>,
        (2, 1) => run::<R, 2, 1>,
        (2, 2) => run::<R, 2, 2>,
        (2, 3) => run::<R, 2, 3>,
        (3, 0) => run::<R, 3, 0>,
        (3, 1) => run::<R, 3, 1>,
        (3, 2) => run::<R, 3, 2>,
        (3, 3) => run::<R, 3, 3>,
        (4, 0) => run::<R, 4, 0>,
        (4, 1) => run::<R, 4, 1>,
        (4, 2) => run::<R, 4, 2>,
        (4, 3) => run::<R, 4, 3>,
        _ => return None,
    })
}

/// States that noise reaches or that move: the first ones of the kernels' order.
pub(crate) fn moving<R: Real>(design: &Design<R>, stretch: &Stretch<'_, R>) -> usize {
    let last = stretch.transition.and_then(|transition| transition.pattern.moved.last());
    design.frame.r.max(last.map_or(0, |row| row.state as usize + 1))
}

fn run<R: Real, const N: usize, const W: usize>(
    design: &Design<R>,
    stretch: &Stretch<'_, R>,
    many: usize,
    work: &mut GainsWork<R>,
    out: &mut Schedule<R>,
) {
    let (zero, r) = (R::splat(0.0), design.frame.r);
    let step = Small::<R, N, W>::new(design, stretch, &work.Psi);
    let (mut P, mut Psi) = ([[zero; N]; N], [[zero; W]; N]);
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
    let mut J = vec![zero; out.sums.J.len()];
    for _ in 0..many {
        step.take(&mut P, &mut Psi, r, &mut J, out);
    }
    for (sum, part) in out.sums.J.iter_mut().zip(&J) {
        *sum = *sum + *part;
    }
    for i in 0..r {
        work.P[i * r..][..=i].copy_from_slice(&P[i][..=i]);
    }
    for (i, row) in Psi.iter().enumerate() {
        work.Psi[i * W..][..W].copy_from_slice(row);
    }
}

impl<R: Real, const N: usize, const W: usize> Motion<R, N, W> {
    /// Of steps without a transition, if there is none. `Psi`: n × W, or empty.
    pub(crate) fn new(transition: Option<&Transition<R>>, Psi: &[R]) -> Motion<R, N, W> {
        let (zero, one) = (R::splat(0.0), R::splat(1.0));
        let mut motion = Motion { phi: [[zero; N]; N], Q: [[zero; N]; N], c: [[zero; W]; N] };
        (0..N).for_each(|i| motion.phi[i][i] = one);
        let Some(transition) = transition else { return motion };
        for row in &transition.pattern.moved {
            let i = row.state as usize;
            motion.phi[i] = [zero; N];
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
    pub(crate) fn advance(&self, Psi: &[[R; W]; N]) -> [[R; W]; N] {
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
    pub(crate) fn predict(&self, P: &[[R; N]; N]) -> [[R; N]; N] {
        let (zero, mut moved) = (R::splat(0.0), self.Q);
        let mut phiP = [[zero; N]; N];
        for i in 0..N {
            for k in 0..N {
                for j in 0..N {
                    phiP[i][j] = self.phi[i][k].fma(P[k][j], phiP[i][j]);
                }
            }
        }
        for i in 0..N {
            for j in 0..=i {
                let mut sum = zero;
                for k in 0..N {
                    sum = self.phi[j][k].fma(phiP[i][k], sum);
                }
                moved[i][j] = sum + moved[i][j];
                moved[j][i] = moved[i][j];
            }
        }
        moved
    }
}

impl<R: Real, const N: usize, const W: usize> Small<R, N, W> {
    fn new(design: &Design<R>, stretch: &Stretch<'_, R>, Psi: &[R]) -> Small<R, N, W> {
        let (zero, line) = (R::splat(0.0), stretch.lines.start);
        let motion = Motion::new(stretch.transition.map(|transition| &**transition), Psi);
        let mut step = Small { motion, h: [zero; N], t: [zero; W], noise: design.noise[line] };
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
    fn take(&self, P: &mut [[R; N]; N], Psi: &mut [[R; W]; N], r: usize, J: &mut [R], out: &mut Schedule<R>) {
        let zero = R::splat(0.0);
        let predicted = self.motion.advance(Psi);
        *P = self.motion.predict(P);
        let (mut G, mut K, mut T) = ([zero; N], [zero; N], self.t);
        for i in 0..N {
            for j in 0..W {
                T[j] = self.h[i].fma(predicted[i][j], T[j]);
            }
        }
        let states: [u32; N] = std::array::from_fn(|i| i as u32);
        let Update { S, weight, kept } = update(N, &states, &self.h, self.noise, P.as_flattened_mut(), &mut G, &mut K);
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

fn add<R: Real>(sum: &mut [R], factor: R, row: &[R]) {
    for (sum, &x) in sum.iter_mut().zip(row) {
        *sum = factor.fma(x, *sum);
    }
}
