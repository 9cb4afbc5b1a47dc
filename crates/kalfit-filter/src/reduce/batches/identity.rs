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
        let lane_entries = |all, numbers, lane| lane_entries(all, numbers, (lane, *lanes));
        let pattern = &design.moves[0].pattern;
        let (terms, pairs) = (pattern.columns.len(), pattern.pairs.len());
        let (coefficients, noise) = (&designs.h, &designs.noise);
        design_digests.resize_with(steps.len(), DesignDigest::new);
        for (lane, design_digest) in design_digests.iter_mut().enumerate() {
            design_digest.begin(&design.frame, lane_entries(&designs.variance, 0..design.variance.len(), lane));
        }
        let mut t = 0;
        for (k, stretch) in design.stretches().enumerate() {
            if stretch.transition.is_some() {
                for (lane, design_digest) in design_digests.iter_mut().enumerate() {
                    if transitions.moving[t * lanes + lane] != 0.0 {
                        let phi = lane_entries(&designs.phi, t * terms..(t + 1) * terms, lane);
                        design_digest.moves(pattern, phi, lane_entries(&designs.q, t * pairs..(t + 1) * pairs, lane));
                    }
                }
                t += 1;
            }
            for line in stretch.lines {
                let (range, states) = (layout.terms(line), design.terms(line).0);
                let h = &coefficients[range.start * lanes..range.end * lanes];
                let [noise, measured] = [noise, &*layout.measured].map(|all| &all[line * lanes..][..*lanes]);
                for (lane, design_digest) in
                    design_digests.iter_mut().enumerate().filter(|(lane, _)| measured[*lane] != 0.0)
                {
                    let h = h.chunks_exact(*lanes).map(|h| h[lane]);
                    design_digest.line(states.iter().copied().zip(h), noise[lane]);
                }
            }
            design_digests
                .iter_mut()
                .zip(steps)
                .filter(|(_, steps)| k < **steps)
                .for_each(|(design_digest, _)| design_digest.end(1));
        }
        design_digests.iter_mut().map(DesignDigest::finish).collect()
    }

    /// True if most of the `steps` steps of the test in a lane are in long stretches of equal steps; such a test is
    /// scanned instead of filtered in a lane.
    pub(super) fn is_long(&self, layout: &BatchLayout, lane: usize, steps: usize) -> bool {
        let (BatchLayout { lanes, design, transitions, .. }, designs) = (layout, &self.batch_filter.design_batch);
        let lane_entries = |all, numbers| lane_entries(all, numbers, (lane, *lanes)).map(f64::to_bits);
        let pattern = &design.moves[0].pattern;
        let (terms, pairs) = (pattern.columns.len(), pattern.pairs.len());
        let (mut previous_bits, mut step_bits, mut count, mut t) =
            (Vec::new(), Vec::new(), EqualStepCount::new(steps), 0);
        for stretch in design.stretches().take(steps) {
            step_bits.clear();
            if stretch.transition.is_some() {
                step_bits.push(transitions.moving[t * lanes + lane].to_bits());
                step_bits.extend(lane_entries(&designs.phi, t * terms..(t + 1) * terms));
                step_bits.extend(lane_entries(&designs.q, t * pairs..(t + 1) * pairs));
                t += 1;
            }
            for line in layout.rows_of(lane, stretch.lines) {
                step_bits.extend(design.terms(line).0.iter().map(|&state| u64::from(state)));
                step_bits.extend(lane_entries(&designs.h, layout.terms(line)));
                step_bits.push(designs.noise[line * lanes + lane].to_bits());
            }
            if count.take(step_bits == previous_bits) {
                return true;
            }
            std::mem::swap(&mut previous_bits, &mut step_bits);
        }
        false
    }
}

/// Entries k in `numbers` of a list in lanes, for the test in a lane: entry k is at k × lanes + lane.
fn lane_entries(
    all: &[f64],
    numbers: Range<usize>,
    (lane, lanes): (usize, usize),
) -> impl Iterator<Item = f64> + use<'_> {
    numbers.map(move |k| all[k * lanes + lane])
}
