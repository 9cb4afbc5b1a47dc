//! The data pass over equal steps under gains that no longer change: a linear scan.
#![expect(non_snake_case, reason = "the letters of the theory: K, h, phi, T")]

use crate::reduce::data::{Data, DataWork};
use crate::reduce::design::{Design, Stretch};
use crate::reduce::gains::{Gains, Piece};

/// Terms that are added up before they join the sum: rounding grows with the number of blocks, not of rows.
const BLOCK: usize = 512;
/// Sums side by side.
const LANES: usize = 8;

/// Steps of one scalar measurement z = h'x + v: x ← φx + c + Ke on the N states that move, e = z - h'(φx + c) - d.
struct Steady<const N: usize> {
    phi: [[f64; N]; N],
    /// What the states that rest add to φx.
    c: [f64; N],
    K: [f64; N],
    /// φ'h, so that e needs no predicted x.
    g: [f64; N],
    /// h'c and what the states that rest add to z.
    d: f64,
}

/// Runs the steps of a stretch from number `done` on; appends the innovations of each, and adds to e'S⁻¹e and y. False, and
/// nothing is done, where the steps are not of the kind that it knows.
pub(crate) fn scan(
    design: &Design,
    stretch: &Stretch<'_>,
    (gains, piece, done): (&Gains, &Piece, usize),
    data: &Data,
    work: &mut DataWork,
    square: &mut f64,
) -> bool {
    if stretch.lines.len() != 1 || !design.frame.driven.is_empty() {
        return false;
    }
    let moved = stretch.transition.and_then(|transition| transition.pattern.moved.last());
    let first = stretch.rows.start + done;
    let values = &data.values[first..stretch.rows.end];
    let (weight, K, T) = gains.of(piece, first);
    let line = (design.terms(stretch.lines.start), K);
    let start = work.e.len();
    let run = match design.frame.r.max(moved.map_or(0, |row| row.state as usize + 1)) {
        0 => steady::<0>,
        1 => steady::<1>,
        2 => steady::<2>,
        3 => steady::<3>,
        4 => steady::<4>,
        5 => steady::<5>,
        6 => steady::<6>,
        _ => return false,
    };
    run(stretch, line, values, work);
    let (sum, squares) = sums(&work.e[start..], 0.0);
    *square += squares * weight;
    for (y, T) in work.y.iter_mut().zip(T) {
        *y += T * (sum * weight);
    }
    true
}

fn steady<const N: usize>(
    stretch: &Stretch<'_>,
    (terms, K): ((&[u32], &[f64]), &[f64]),
    values: &[f64],
    work: &mut DataWork,
) {
    let step = Steady::<N>::new(stretch, terms, K, &work.x);
    let mut x = [0.0; N];
    x.copy_from_slice(&work.x[..N]);
    work.e.extend(values.iter().map(|z| step.take(&mut x, *z)));
    work.x[..N].copy_from_slice(&x);
}

impl<const N: usize> Steady<N> {
    fn new(stretch: &Stretch<'_>, (states, h): (&[u32], &[f64]), gain: &[f64], x: &[f64]) -> Steady<N> {
        let mut step = Steady { phi: [[0.0; N]; N], c: [0.0; N], K: [0.0; N], g: [0.0; N], d: 0.0 };
        (0..N).for_each(|i| step.phi[i][i] = 1.0);
        step.K[..gain.len()].copy_from_slice(gain);
        for row in stretch.transition.iter().flat_map(|transition| &transition.pattern.moved) {
            let transition = stretch.transition.expect("it has rows");
            let i = row.state as usize;
            step.phi[i] = [0.0; N];
            for k in row.start as usize..row.end as usize {
                match transition.pattern.columns[k] as usize {
                    j if j < N => step.phi[i][j] = transition.phi[k],
                    j => step.c[i] += transition.phi[k] * x[j],
                }
            }
        }
        for (&state, &h) in states.iter().zip(h) {
            match state as usize {
                i if i < N => {
                    (0..N).for_each(|j| step.g[j] += h * step.phi[i][j]);
                    step.d += h * step.c[i];
                }
                i => step.d += h * x[i],
            }
        }
        step
    }

    /// e; x is updated.
    #[inline(always)]
    fn take(&self, x: &mut [f64; N], z: f64) -> f64 {
        let mut e = z - self.d;
        let mut next = self.c;
        for j in 0..N {
            e -= self.g[j] * x[j];
        }
        for i in 0..N {
            for j in 0..N {
                next[i] += self.phi[i][j] * x[j];
            }
        }
        for i in 0..N {
            x[i] = next[i] + self.K[i] * e;
        }
        e
    }
}

/// (Σ (e - t), Σ (e - t)²), in blocks.
pub(crate) fn sums(e: &[f64], t: f64) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0, 0.0);
    for block in e.chunks(BLOCK) {
        let (mut lanes, mut lane_squares) = ([0.0; LANES], [0.0; LANES]);
        let chunks = block.chunks_exact(LANES);
        let rest = chunks.remainder();
        for chunk in chunks {
            for l in 0..LANES {
                let left = chunk[l] - t;
                lanes[l] += left;
                lane_squares[l] += left * left;
            }
        }
        for (l, e) in rest.iter().enumerate() {
            let left = e - t;
            lanes[l] += left;
            lane_squares[l] += left * left;
        }
        sum += lanes.iter().sum::<f64>();
        squares += lane_squares.iter().sum::<f64>();
    }
    (sum, squares)
}
