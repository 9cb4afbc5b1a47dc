//! The data pass: innovations of a test under the schedule of its design, and what they add up to.
#![expect(non_snake_case, reason = "the letters of the theory: K, T, J")]

use crate::reduce::data::{Data, DataWork, Miss, Outcome, REFINE};
use crate::reduce::design::Design;
use crate::reduce::gains::{Gains, Turns};
use crate::reduce::kernel;
use crate::reduce::scan::scan;
use kalfit_lanes::Real;

/// A measurement that can only be one value may miss it by this part of the size of its terms.
const ROUNDING: f64 = 1e-10;

/// x̂ ← φx̂ + b, e = z - d - h'x̂, x̂ ← x̂ + Ke over the test; y = Σ T'e/S. Returns e'S⁻¹e.
pub(crate) fn innovate(design: &Design, gains: &Gains, data: &Data, work: &mut DataWork) -> f64 {
    pass(design, gains, data, work, None)
}

/// Sees (row, its line, e, x̂) before the update.
type Look<'a> = &'a mut dyn FnMut(usize, usize, f64, &[f64]);

/// [`innovate`]; with `look`, which sees every innovation, step by step to the end.
fn pass(design: &Design, gains: &Gains, data: &Data, work: &mut DataWork, mut look: Option<Look<'_>>) -> f64 {
    work.x.clone_from(&data.start);
    work.e.clear();
    work.e.reserve(data.values.len());
    work.y.clear();
    work.y.resize(design.frame.p, 0.0);
    let (mut square, mut input, mut at) = (0.0, 0, 0);
    for stretch in design.stretches() {
        while gains.pieces.get(at + 1).is_some_and(|next| next.row <= stretch.rows.start) {
            at += 1;
        }
        let piece = &gains.pieces[at];
        if look.is_none() && scan(design, &stretch, (gains, piece), data, work, &mut square) {
            continue;
        }
        for step in stretch.steps() {
            if let Some(transition) = step.transition {
                kernel::advance(&mut work.x, 1, transition, &mut work.moved);
                for &state in &design.frame.driven {
                    work.x[state as usize] += data.inputs[input];
                    input += 1;
                }
            }
            for (line, row) in step.lines.zip(step.rows) {
                let (states, h) = design.terms(line);
                let mut e = data.values[row];
                for (&state, &h) in states.iter().zip(h) {
                    e = h.fnma(work.x[state as usize], e);
                }
                if let Some(look) = &mut look {
                    look(row, line, e, &work.x);
                }
                let (weight, K, T) = gains.of(piece, row);
                let weighted = e * weight;
                for (x, &K) in work.x.iter_mut().zip(K) {
                    *x = K.fma(e, *x);
                }
                for (y, &T) in work.y.iter_mut().zip(T) {
                    *y = T.fma(weighted, *y);
                }
                square = e.fma(weighted, square);
                work.e.push(e);
            }
        }
    }
    square
}

/// The outcome of a test. An error when a measurement that can only be one value is another.
pub(crate) fn outcome(design: &Design, gains: &Gains, data: &Data, work: &mut DataWork) -> Result<Outcome, Miss> {
    let log_density = -0.5 * (gains.active as f64 * std::f64::consts::TAU.ln() + gains.log_determinant);
    let (residual, data) = match &gains.turns {
        None => {
            let square = innovate(design, gains, data, work);
            least_squares(design, gains, work, square)
        }
        Some(turns) => {
            if gains.active < design.rows() {
                possible(design, gains, data, work)?;
            } else {
                innovate(design, gains, data, work);
            }
            folded(design, gains, turns, work)
        }
    };
    Ok(Outcome { constant: log_density - 0.5 * residual, residual, data })
}

/// The data pass of a test with measurements that say nothing: each must be what it must be.
fn possible(design: &Design, gains: &Gains, data: &Data, work: &mut DataWork) -> Result<(), Miss> {
    let mut miss = None;
    let mut look = |row: usize, line: usize, e: f64, x: &[f64]| {
        let (states, h) = design.terms(line);
        let terms: f64 = states.iter().zip(h).map(|(&state, h)| (h * x[state as usize]).abs()).sum();
        let silent = gains.row(row).0 == 0.0;
        let off = e.abs() > ROUNDING * (data.sizes[row] + terms);
        if silent && off && miss.is_none() {
            miss = Some(Miss { row, residual: e });
        }
    };
    pass(design, gains, data, work, Some(&mut look));
    miss.map_or(Ok(()), Err)
}

/// (residual sum of squares, d) from y and e'S⁻¹e. Where these are large, the innovations at the best ξ, e - Tξ, are what
/// counts: nothing cancels in them. (Corrected seminormal equations, Björck 1987.)
fn least_squares(design: &Design, gains: &Gains, work: &mut DataWork, square: f64) -> (f64, Vec<f64>) {
    let p = design.frame.p;
    let mut d = work.y.clone();
    forward(&gains.factor, &mut d);
    if square <= REFINE || p == 0 {
        return (square - d.iter().map(|x| x * x).sum::<f64>(), d);
    }
    let mut best = d;
    backward(&gains.factor, &mut best);
    let (mut left, mut correction) = (0.0, vec![0.0; p]);
    for (piece, end) in gains.stretches(work.e.len()) {
        left += gains.weigh((piece, piece.row..end), &work.e[piece.row..end], &best, &mut correction);
    }
    forward(&gains.factor, &mut correction);
    left -= correction.iter().map(|x| x * x).sum::<f64>();
    let mut at = 0;
    for k in 0..p {
        for i in 0..=k {
            correction[i] += gains.factor[at + i] * best[k]; // d = R ξ + what is left
        }
        at += k + 1;
    }
    (left, correction)
}

/// d ← R'⁻¹ d, zero for zero rows of R.
fn forward(factor: &[f64], d: &mut [f64]) {
    let mut at = 0;
    for k in 0..d.len() {
        let mut sum = d[k];
        for i in 0..k {
            sum -= factor[at + i] * d[i];
        }
        d[k] = if factor[at + k] > 0.0 { sum / factor[at + k] } else { 0.0 };
        at += k + 1;
    }
}

/// ξ ← R⁻¹ ξ, zero for zero rows of R.
fn backward(factor: &[f64], x: &mut [f64]) {
    for k in (0..x.len()).rev() {
        let at = k * (k + 1) / 2;
        x[k] = if factor[at + k] > 0.0 { x[k] / factor[at + k] } else { 0.0 };
        for i in 0..k {
            x[i] -= factor[at + i] * x[k];
        }
    }
}

/// (residual sum of squares, d): the innovations take the rotations that made R.
fn folded(design: &Design, gains: &Gains, turns: &Turns, work: &DataWork) -> (f64, Vec<f64>) {
    let p = design.frame.p;
    let (mut d, mut residual) = (vec![0.0; p], 0.0);
    for (row, &e) in work.e.iter().enumerate() {
        let mut left = e * gains.row(row).0.sqrt();
        for (d, &(c, s)) in d.iter_mut().zip(&turns.folds[row * p..]) {
            (*d, left) = (c * *d + s * left, c * left - s * *d);
        }
        residual += left * left;
    }
    for &settle in &turns.settle {
        settle.apply(&mut d, &mut residual);
    }
    (residual, d)
}
