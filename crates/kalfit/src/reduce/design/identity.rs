//! When designs are one: a digest of all of a design, which says once what repeats, and equality to the bit.

use std::sync::Arc;

use crate::reduce::design::{Design, Transition, same_bits};
use crate::reduce::digest::Digest;

impl Design<f64> {
    /// Of all numbers.
    pub(crate) fn digest(&self) -> u128 {
        let mut digest = Digest::new();
        digest.wide(self.frame.digest);
        digest.numbers(&self.variance);
        digest.count(self.moves.len());
        for transition in &self.moves {
            match transition.digest {
                Some(shared) => digest.wide(shared),
                None => transition.add_to(&mut digest),
            }
        }
        self.add_runs_to(&mut digest);
        self.add_shape_to(&mut digest);
        digest.numbers(&self.h);
        let one = self.noise.first().filter(|first| self.noise.iter().all(|noise| noise.to_bits() == first.to_bits()));
        digest.numbers(one.map_or(&self.noise[..], std::slice::from_ref));
        digest.finish()
    }

    /// The runs; those on end that differ in nothing are told of once.
    fn add_runs_to(&self, digest: &mut Digest) {
        let kind = |at: usize| {
            let (run, first) = (self.runs[at], if at == 0 { 0 } else { self.runs[at - 1].lines });
            (run.lines - first, run.count, run.transition)
        };
        digest.count(self.runs.len());
        let mut at = 0;
        while at < self.runs.len() {
            let alike = (at..self.runs.len()).take_while(|&other| kind(other) == kind(at)).count();
            let (lines, count, transition) = kind(at);
            digest.word((lines as u64) << 32 ^ count as u64);
            digest.word((alike as u64) << 32 ^ transition.map_or(0, |number| u64::from(number) + 1));
            at += alike;
        }
    }

    /// How many terms each line has, and of which states; the lines of a step that all others repeat are told of once.
    fn add_shape_to(&self, digest: &mut Digest) {
        digest.count(self.ends.len());
        let lines = self.runs.iter().map(|run| run.lines).find(|&lines| lines > 0).unwrap_or(0);
        let terms = if lines == 0 { 0 } else { self.ends[lines - 1] };
        let repeats = self.ends.iter().skip(lines).zip(&self.ends).all(|(later, sooner)| later - sooner == terms)
            && self.states[terms..] == self.states[..self.states.len() - terms];
        let (lines, terms) = if repeats { (lines, terms) } else { (self.ends.len(), self.states.len()) };
        digest.counts(&self.ends[..lines]);
        digest.indices(&self.states[..terms]);
    }

    /// Equal bit for bit.
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
    use crate::reduce::design::{DENSE, Frame, Pattern, Run};

    type Change = fn(&mut Design, usize);

    /// Four steps of two lines, of two terms and one; the first without a transition, the last two with one. `noise`: of each line.
    fn design(noise: &[f64]) -> Design {
        let frame =
            Frame { n: 3, p: 1, r: 1, rows: vec![DENSE; 3], sensitivity: vec![1.0; 3], driven: vec![], digest: 0 };
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
        // the same numbers, put together otherwise
        let whole = design(&[1.0; 8]);
        let mut joined = whole.clone();
        joined.runs.remove(3);
        joined.runs[2] = Run { count: 2, ..whole.runs[2] };
        let mut swapped = whole.clone();
        swapped.moves.reverse();
        let mut sooner = whole.clone();
        (sooner.runs[0].transition, sooner.runs[1].transition) = (Some(0), None);
        let mut shorter = whole.clone();
        (shorter.ends[0], shorter.ends[2]) = (1, 4);
        let all = [&whole, &joined, &swapped, &sooner, &shorter].map(Design::digest);
        for k in 0..all.len() {
            assert!(!all[..k].contains(&all[k]), "design {k} has the digest of another");
        }
    }
}
