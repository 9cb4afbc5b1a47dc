//! Equality of designs: a digest of a whole design, step by step, and comparison to the bit.

use std::sync::Arc;

use crate::reduce::cell_mask::mix_word;
use crate::reduce::design::{Design, Pattern, StateFrame, Stretch, Transition, same_bits};
use crate::reduce::digest::Digest;

/// Number of words after which the digest is updated, at the end of a step.
const WORDS_PER_UPDATE: usize = 1 << 12;

/// The digest of a design in progress, step by step. After `finish`, another design can begin.
#[derive(Debug)]
pub(crate) struct DesignDigest {
    digest: Digest,
    /// Words that the digest has not yet taken.
    words: Vec<u64>,
    /// Number of scalar measurements of the current step so far.
    lines: u64,
}

impl DesignDigest {
    pub(crate) fn new() -> DesignDigest {
        DesignDigest { digest: Digest::new(), words: Vec::new(), lines: 0 }
    }

    /// Begins a design. `variance`: P0.
    pub(crate) fn begin(&mut self, frame: &StateFrame, variance: impl Iterator<Item = f64>) {
        self.digest.wide(frame.digest);
        self.words.extend(variance.map(f64::to_bits));
    }

    /// Takes the transition to the current step.
    pub(crate) fn moves(&mut self, pattern: &Pattern, phi: impl Iterator<Item = f64>, q: impl Iterator<Item = f64>) {
        self.words.extend([pattern.digest as u64, (pattern.digest >> 64) as u64]);
        self.words.extend(phi.chain(q).map(f64::to_bits));
    }

    /// Takes a scalar measurement of the current step. Terms with h = 0, which whitened measurements can have,
    /// are omitted.
    #[inline]
    pub(crate) fn line(&mut self, terms: impl Iterator<Item = (u32, f64)>, noise: f64) {
        let mut states = 1;
        for (state, h) in terms.filter(|(_, h)| *h != 0.0) {
            states = mix_word(states, u64::from(state));
            self.words.push(h.to_bits());
        }
        self.words.extend([states, noise.to_bits()]);
        self.lines += 1;
    }

    /// Ends the current step, which occurs `many` times.
    #[inline]
    pub(crate) fn end(&mut self, many: usize) {
        self.words.push(std::mem::take(&mut self.lines) << 32 ^ many as u64);
        if self.words.len() >= WORDS_PER_UPDATE {
            self.digest.words(&self.words);
            self.words.clear();
        }
    }

    /// The digest of the design; resets the state for the next design.
    pub(crate) fn finish(&mut self) -> u128 {
        self.digest.words(&self.words);
        self.words.clear();
        std::mem::replace(&mut self.digest, Digest::new()).finish()
    }
}

impl Design {
    /// Digest of all numbers of the design. Consecutive equal steps enter one by one, as in lanes, except in long
    /// stretches.
    pub(crate) fn digest(&self) -> u128 {
        let mut design_digest = DesignDigest::new();
        design_digest.begin(&self.frame, self.variance.iter().copied());
        for Stretch { transition, lines, count, .. } in self.stretches() {
            let (times, many) = if self.is_long(count) { (1, count) } else { (count, 1) };
            for _ in 0..times {
                if let Some(transition) = transition {
                    design_digest.moves(
                        &transition.pattern,
                        transition.phi.iter().copied(),
                        transition.q.iter().copied(),
                    );
                }
                for line in lines.clone() {
                    let (states, h) = self.terms(line);
                    design_digest.line(states.iter().copied().zip(h.iter().copied()), self.noise[line]);
                }
                design_digest.end(many);
            }
        }
        design_digest.finish()
    }

    /// True if the designs are equal bit for bit.
    pub(crate) fn same(&self, other: &Design) -> bool {
        let same_moves = |(a, b): (&Arc<Transition>, &Arc<Transition>)| Arc::ptr_eq(a, b) || a.same(b);
        (Arc::ptr_eq(&self.frame, &other.frame) || self.frame == other.frame)
            && self.runs == other.runs
            && self.ends == other.ends
            && self.states == other.states
            && same_bits(&self.variance, &other.variance)
            && same_bits(&self.h, &other.h)
            && same_bits(&self.noise, &other.noise)
            && self.moves.len() == other.moves.len()
            && self.moves.iter().zip(&other.moves).all(same_moves)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::design::{DENSE, EqualSteps};

    type Change = fn(&mut Design, usize);

    /// Four steps of two lines, which have two terms and one term; the first step has no transition, the last two share
    /// one. `noise`: R of each line.
    fn design(noise: &[f64]) -> Design {
        let frame =
            StateFrame { n: 3, p: 1, r: 1, rows: vec![DENSE; 3], sensitivity: vec![1.0; 3], driven: vec![], digest: 0 };
        let mut pattern = Pattern::default();
        pattern.push(0, 1, [0, 1].into_iter());
        pattern.pairs = vec![(0, 0)];
        let pattern = Arc::new(pattern.seal());
        let mut design = Design::new(Arc::new(frame.seal()));
        design.variance = vec![2.0];
        let moves = [0.5, 0.25].map(|x| Arc::new(Transition::new(pattern.clone(), vec![x, 0.125], vec![x])));
        for transition in [None, Some(&moves[0]), Some(&moves[1]), Some(&moves[1])] {
            for states in [&[0, 1][..], &[2]] {
                design.h.extend(states.iter().map(|&state| f64::from(state) + 0.5));
                design.states.extend(states);
                design.ends.push(design.states.len());
            }
            design.push_step(transition);
        }
        design.noise = noise.to_vec();
        design
    }

    #[test]
    fn a_digest_tells_of_all_that_designs_differ_in() {
        let changes: [(Change, usize); 11] = [
            (|design, k| design.h[k] += 1.0, 12),
            (|design, k| design.noise[k] += 1.0, 8),
            (|design, k| design.states[k] += 1, 12),
            (|design, k| design.ends[k] -= 1, 8),
            (|design, k| design.runs[k].count += 1, 4),
            (|design, k| design.runs[k].transition = None, 4),
            (|design, k| design.runs[k].lines -= 1, 4),
            (|design, k| Arc::make_mut(&mut design.moves[k]).phi[1] += 1.0, 2),
            (|design, k| Arc::make_mut(&mut design.moves[k]).q[0] += 1.0, 2),
            (|design, _| design.variance[0] += 1.0, 1),
            (|design, _| design.noise.iter_mut().for_each(|noise| *noise += 1.0), 1),
        ];
        for noise in [[1.0; 8], [1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0, 2.0]] {
            let (one, other) = (design(&noise), design(&noise));
            assert!(one.same(&other) && one.digest() == other.digest(), "made anew it is the same");
            for (kind, (change, places)) in changes.iter().enumerate() {
                for place in 0..*places {
                    let mut other = design(&noise);
                    change(&mut other, place);
                    let is_same = one.runs == other.runs && one.same(&other);
                    assert_eq!(is_same, one.digest() == other.digest(), "change {kind} at {place}");
                    assert_eq!(
                        is_same,
                        kind == 5 && place == 0,
                        "change {kind} at {place}: the first step had no transition"
                    );
                }
            }
        }
    }

    #[test]
    fn what_repeats_is_told_apart_from_what_almost_does() {
        let whole = design(&[1.0; 8]);
        let mut joined = whole.clone();
        joined.runs.remove(3);
        joined.runs[2] = EqualSteps { count: 2, ..whole.runs[2] };
        assert_eq!(joined.digest(), whole.digest(), "few equal steps are one by one, however they are kept");
        // different designs made of the same numbers
        let mut swapped = whole.clone();
        swapped.moves.reverse();
        let mut sooner = whole.clone();
        (sooner.runs[0].transition, sooner.runs[1].transition) = (Some(0), None);
        let mut shorter = whole.clone();
        (shorter.ends[0], shorter.ends[2]) = (1, 4);
        let all = [&whole, &swapped, &sooner, &shorter].map(Design::digest);
        for k in 0..all.len() {
            assert!(!all[..k].contains(&all[k]), "design {k} has the digest of another");
        }
    }
}
