//! Digests of the designs of tests in lanes, equal to `Design::digest` of each design.

use std::ops::Range;

use crate::reduce::batches::layout::BatchLayout;
use crate::reduce::batches::values::BatchValues;
use crate::reduce::design::DesignDigest;
use crate::reduce::equal_steps::EqualStepCount;

impl BatchValues {
    /// The digest of the design of each test. `steps`: number of steps of each test; `design_digests`: work space.
    pub(super) fn design_digests(
        &self,
        layout: &BatchLayout,
        steps: &[usize],
        design_digests: &mut Vec<DesignDigest>,
    ) -> Vec<u128> {
        let (BatchLayout { lanes, design, transitions, .. }, designs) = (layout, &self.batch_filter.design_batch);
        let own = |all, numbers, lane| own(all, numbers, (lane, *lanes));
        let pattern = &design.moves[0].pattern;
        let (terms, pairs) = (pattern.columns.len(), pattern.pairs.len());
        let (coefficients, noise) = (&designs.h, &designs.noise);
        design_digests.resize_with(steps.len(), DesignDigest::new);
        for (lane, identity) in design_digests.iter_mut().enumerate() {
            identity.begin(&design.frame, own(&designs.variance, 0..design.variance.len(), lane));
        }
        let mut t = 0;
        for (k, stretch) in design.stretches().enumerate() {
            if stretch.transition.is_some() {
                for (lane, identity) in design_digests.iter_mut().enumerate() {
                    if transitions.moving[t * lanes + lane] != 0.0 {
                        let phi = own(&designs.phi, t * terms..(t + 1) * terms, lane);
                        identity.moves(pattern, phi, own(&designs.q, t * pairs..(t + 1) * pairs, lane));
                    }
                }
                t += 1;
            }
            for line in stretch.lines {
                let (range, states) = (layout.terms(line), design.terms(line).0);
                let h = &coefficients[range.start * lanes..range.end * lanes];
                let [noise, measured] = [noise, &*layout.measured].map(|all| &all[line * lanes..][..*lanes]);
                for (lane, identity) in design_digests.iter_mut().enumerate().filter(|(lane, _)| measured[*lane] != 0.0)
                {
                    let h = h.chunks_exact(*lanes).map(|h| h[lane]);
                    identity.line(states.iter().copied().zip(h), noise[lane]);
                }
            }
            design_digests
                .iter_mut()
                .zip(steps)
                .filter(|(_, steps)| k < **steps)
                .for_each(|(identity, _)| identity.end(1));
        }
        design_digests.iter_mut().map(DesignDigest::finish).collect()
    }

    /// True if most of the `steps` steps of the test in a lane are in long stretches of equal steps; such a test is
    /// scanned instead of filtered in a lane.
    pub(super) fn is_long(&self, layout: &BatchLayout, lane: usize, steps: usize) -> bool {
        let (BatchLayout { lanes, design, transitions, .. }, designs) = (layout, &self.batch_filter.design_batch);
        let own = |all, numbers| own(all, numbers, (lane, *lanes)).map(f64::to_bits);
        let pattern = &design.moves[0].pattern;
        let (terms, pairs) = (pattern.columns.len(), pattern.pairs.len());
        let (mut before, mut now, mut count, mut t) = (Vec::new(), Vec::new(), EqualStepCount::new(steps), 0);
        for stretch in design.stretches().take(steps) {
            now.clear();
            if stretch.transition.is_some() {
                now.push(transitions.moving[t * lanes + lane].to_bits());
                now.extend(own(&designs.phi, t * terms..(t + 1) * terms));
                now.extend(own(&designs.q, t * pairs..(t + 1) * pairs));
                t += 1;
            }
            for line in layout.rows_of(lane, stretch.lines) {
                now.extend(design.terms(line).0.iter().map(|&state| u64::from(state)));
                now.extend(own(&designs.h, layout.terms(line)));
                now.push(designs.noise[line * lanes + lane].to_bits());
            }
            if count.take(now == before) {
                return true;
            }
            std::mem::swap(&mut before, &mut now);
        }
        false
    }
}

/// Entries k in `numbers` of a list in lanes, for the test in a lane: entry k is at k × lanes + lane.
fn own(all: &[f64], numbers: Range<usize>, (lane, lanes): (usize, usize)) -> impl Iterator<Item = f64> + use<'_> {
    numbers.map(move |k| all[k * lanes + lane])
}
