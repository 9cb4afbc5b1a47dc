//! The design pass: one covariance run per design class leaves a schedule of weights, gains and sensitivities.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, G = P h, K, T, S, J")]

use std::ops::Range;

use crate::reduce::design::{Design, Frame, Stretch};
use crate::reduce::gains::{Gains, Piece};
use crate::reduce::kernel;
use crate::reduce::semidefinite::information_root;
use crate::reduce::settling::{Frozen, Settling};
use crate::reduce::small;
use kalfit_lanes::{Lanes, Real};

/// A scaled pivot of J below this is too ill-conditioned for sums of T'S⁻¹T.
const LEAST_PIVOT: f64 = 1e-9;
/// So many equal steps are not worth a kernel of their own.
const FEW: usize = 64;

/// What a design pass leaves.
#[derive(Debug, Clone)]
pub(crate) struct Schedule<R = f64> {
    /// As in [`Gains`].
    pub(crate) gains: Vec<R>,
    pub(crate) sensitivities: Vec<R>,
    pieces: Vec<Piece>,
    pub(crate) sums: Sums<R>,
    /// Rows that Π S lacks: (S, how many).
    many: Vec<(R, usize)>,
}

/// What a design pass adds up.
#[derive(Debug, Clone)]
pub(crate) struct Sums<R = f64> {
    /// J, packed by columns.
    pub(crate) J: Vec<R>,
    /// Π S = mantissa × 2^exponent.
    mantissa: R,
    exponent: R,
    /// Below zero where an update cancelled too many digits.
    kept: R,
    /// Smallest S.
    least: R,
}

/// Entries of a packed triangle.
pub(crate) fn packed(p: usize) -> usize {
    p * (p + 1) / 2
}

impl<R: Real> Sums<R> {
    #[inline(always)]
    pub(crate) fn new(p: usize) -> Sums<R> {
        let (zero, one) = (R::splat(0.0), R::splat(1.0));
        Sums { J: vec![zero; packed(p)], mantissa: one, exponent: zero, kept: one, least: one }
    }

    /// Takes S of a row into account.
    #[inline(always)]
    pub(crate) fn count(&mut self, S: R, kept: R) {
        self.kept = self.kept.minimum(kept);
        self.least = self.least.minimum(S);
        self.scale(S);
    }

    #[inline(always)]
    fn scale(&mut self, S: R) {
        let (mantissa, exponent) = (self.mantissa * S.or_one()).split();
        (self.mantissa, self.exponent) = (mantissa, self.exponent + exponent);
    }
}

impl<R: Lanes> Sums<R> {
    /// Those of each lane, one beside the other. `all`: room.
    #[inline(always)]
    pub(crate) fn lanes(&self, all: &mut Vec<f64>) {
        all.clear();
        all.resize((self.J.len() + 4) * R::COUNT, 0.0);
        let last = [self.mantissa, self.exponent, self.kept, self.least];
        for (k, to) in all.chunks_exact_mut(R::COUNT).enumerate() {
            let x = if k < self.J.len() { self.J[k] } else { last[k - self.J.len()] };
            x.store(to);
        }
    }
}

impl Sums {
    /// Those of one lane, from [`Sums::lanes`].
    pub(crate) fn of_lane(all: &[f64], lane: usize, lanes: usize) -> Sums {
        let entries = all.len() / lanes - 4;
        let at = |k: usize| all[k * lanes + lane];
        Sums {
            J: (0..entries).map(at).collect(),
            mantissa: at(entries),
            exponent: at(entries + 1),
            kept: at(entries + 2),
            least: at(entries + 3),
        }
    }

    /// (R, Σ log S), or `None` where square-root arrays are called for. `many`: more rows, (S, how many).
    pub(crate) fn root(&self, many: &[(f64, usize)]) -> Option<(Vec<f64>, f64)> {
        let sound = self.kept >= 0.0 && self.least > 0.0 && self.J.iter().all(|x| x.is_finite());
        if !sound || !self.mantissa.is_finite() {
            return None;
        }
        let p = (0..).find(|&p| packed(p) == self.J.len()).expect("J is a packed triangle");
        let (factor, least) = information_root(&self.J, p, LEAST_PIVOT);
        let repeated: f64 = many.iter().map(|&(S, many)| many as f64 * S.ln()).sum();
        let log_determinant = self.mantissa.ln() + self.exponent * std::f64::consts::LN_2 + repeated;
        (least >= LEAST_PIVOT).then_some((factor, log_determinant))
    }
}

/// Work space of the design pass; afterwards P and Ψ of the last step, those of
/// steps that changed nothing any more included.
#[derive(Debug, Clone, Default)]
pub(crate) struct GainsWork<R = f64> {
    pub(crate) P: Vec<R>,
    pub(crate) Psi: Vec<R>,
    G: Vec<R>,
    rows: Vec<R>,
    pub(crate) settling: Settling<R>,
}

/// Runs the covariance filter of a design.
pub(crate) fn schedule<R: Real>(design: &Design<R>, work: &mut GainsWork<R>) -> Schedule<R> {
    let (frame, zero) = (&*design.frame, R::splat(0.0));
    let (p, r) = (frame.p, frame.r);
    work.P.clone_from(&design.variance);
    work.Psi.clear();
    work.Psi.extend(frame.sensitivity.iter().map(|&x| R::splat(x)));
    work.G.clear();
    work.G.resize(r, zero);
    work.settling.start(&work.Psi);
    let mut out = Schedule {
        gains: Vec::with_capacity((1 + r) * design.ends.len()),
        sensitivities: Vec::with_capacity(p * design.ends.len()),
        pieces: vec![Piece::all(0)],
        sums: Sums::new(p),
        many: Vec::new(),
    };
    for stretch in design.stretches() {
        out.stretch(design, &stretch, work);
    }
    out
}

impl<R: Real> Schedule<R> {
    /// Equal steps: in full until P no longer changes, then Ψ alone until it does not change either, then all others at once.
    fn stretch(&mut self, design: &Design<R>, stretch: &Stretch<'_, R>, work: &mut GainsWork<R>) {
        let frame = &*design.frame;
        let (gain, sensitivity) = (self.gains.len() / (1 + frame.r), self.sensitivities.len() / frame.p.max(1));
        let watched = work.settling.begin(stretch.count);
        let (mut frozen, mut gain_steps, mut done) = (Frozen::Nothing, 0, 0);
        let small = if stretch.count > FEW { small::steps(design, stretch) } else { None };
        while done < stretch.count && frozen != Frozen::All {
            let before = done;
            done = if watched { work.settling.next_look().min(stretch.count) } else { stretch.count };
            match (frozen, small) {
                (Frozen::Nothing, Some(steps)) => steps(design, stretch, done - before, work, self),
                (Frozen::Nothing, None) => (before..done).for_each(|_| self.step(design, stretch, work)),
                _ => (before..done).for_each(|_| self.sensitivities(design, stretch, work)),
            }
            if frozen == Frozen::Nothing {
                gain_steps = done;
            }
            if watched {
                frozen = work.settling.look(done, (&work.P, frame.r), &work.Psi, frozen);
            }
        }
        self.repeat(frame, stretch.lines.len(), stretch.count - done);
        let piece = Piece {
            row: stretch.rows.start,
            width: stretch.lines.len(),
            gain,
            gain_steps,
            sensitivity,
            sensitivity_steps: done,
        };
        self.note(piece, stretch);
    }

    /// A step in full.
    fn step(&mut self, design: &Design<R>, stretch: &Stretch<'_, R>, work: &mut GainsWork<R>) {
        let frame = &*design.frame;
        let (p, r) = (frame.p, frame.r);
        if let Some(transition) = stretch.transition {
            kernel::predict(&mut work.P, r, transition, &mut work.rows);
            kernel::advance(&mut work.Psi, p, transition, &mut work.rows);
        }
        for line in stretch.lines.clone() {
            let (states, h) = design.terms(line);
            let (weight, K) = append(&mut self.gains, 1 + r).split_first_mut().expect("stride is positive");
            let T = append(&mut self.sensitivities, p);
            kernel::sensitivity(frame, states, h, &work.Psi, T);
            let update = kernel::update(r, states, h, design.noise[line], &mut work.P, &mut work.G, K);
            kernel::correct(p, K, T, &mut work.Psi);
            kernel::inform(T, update.weight, &mut self.sums.J);
            *weight = update.weight;
            self.sums.count(update.S, update.kept);
        }
    }

    /// A step under the gains of the last one.
    fn sensitivities(&mut self, design: &Design<R>, stretch: &Stretch<'_, R>, work: &mut GainsWork<R>) {
        let frame = &*design.frame;
        let (p, stride) = (frame.p, 1 + frame.r);
        if let Some(transition) = stretch.transition {
            kernel::advance(&mut work.Psi, p, transition, &mut work.rows);
        }
        let last = self.gains.len() - stride * stretch.lines.len();
        for (gain, line) in self.gains[last..].chunks_exact(stride).zip(stretch.lines.clone()) {
            let (states, h) = design.terms(line);
            let T = append(&mut self.sensitivities, p);
            kernel::sensitivity(frame, states, h, &work.Psi, T);
            kernel::correct(p, &gain[1..], T, &mut work.Psi);
            kernel::inform(T, gain[0], &mut self.sums.J);
            self.sums.scale(gain[0].recip_or_zero());
        }
    }

    /// So many more steps of `lines` measurements under the gains and sensitivities of the last one: J += m TT'/S.
    fn repeat(&mut self, frame: &Frame, lines: usize, many: usize) {
        if many == 0 {
            return;
        }
        let (p, stride) = (frame.p, 1 + frame.r);
        for back in (1..=lines).rev() {
            let weight = self.gains[self.gains.len() - back * stride];
            let T = &self.sensitivities[self.sensitivities.len() - back * p..][..p];
            kernel::inform(T, weight * R::splat(many as f64), &mut self.sums.J);
            self.many.push((weight.recip_or_zero().or_one(), many));
        }
    }

    /// Notes what is kept of a stretch.
    fn note(&mut self, piece: Piece, stretch: &Stretch<'_, R>) {
        let rows: Range<usize> = stretch.rows.clone();
        if rows.is_empty() {
            return;
        }
        let last = self.pieces.last_mut().expect("there is at least one piece");
        if piece.gain_steps < stretch.count {
            if last.gain_steps == 0 {
                self.pieces.pop();
            }
            self.pieces.push(piece);
        } else if last.width == 1 && last.row + last.gain_steps == rows.start {
            last.gain_steps += rows.len();
            last.sensitivity_steps += rows.len();
        } else {
            let steps = rows.len();
            self.pieces.push(Piece { width: 1, gain_steps: steps, sensitivity_steps: steps, ..piece });
        }
    }
}

/// Room for so many more numbers, and those.
fn append<R: Real>(numbers: &mut Vec<R>, many: usize) -> &mut [R] {
    let start = numbers.len();
    numbers.resize(start + many, R::splat(0.0));
    &mut numbers[start..]
}

impl Schedule<f64> {
    /// The finished information form, or `None` where square-root arrays are called for.
    pub(crate) fn finish(self, (r, p): (usize, usize), active: usize) -> Option<Gains> {
        let (factor, log_determinant) = self.sums.root(&self.many)?;
        Some(Gains {
            r,
            p,
            gains: self.gains,
            sensitivities: self.sensitivities,
            pieces: self.pieces,
            factor,
            log_determinant,
            active,
            turns: None,
            end: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::reduce::flops::design_pass;

    fn line(flops: kalfit_lanes::Flops) -> String {
        format!("add {} mul {} fma {} div {}", flops.add, flops.mul, flops.fma, flops.div)
    }

    #[test]
    fn the_design_pass_keeps_its_flop_budget() {
        // n, r, p: random coefficients; an inertial instrument; all states noisy.
        insta::assert_snapshot!(line(design_pass(2, 0, 2, 10)), @"add 30 mul 30 fma 40 div 10");
        insta::assert_snapshot!(line(design_pass(15, 2, 13, 10)), @"add 160 mul 180 fma 2230 div 10");
        insta::assert_snapshot!(line(design_pass(4, 4, 4, 10)), @"add 50 mul 130 fma 2490 div 10");
    }
}
