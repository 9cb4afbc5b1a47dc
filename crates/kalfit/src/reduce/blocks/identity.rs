//! The designs of tests in lanes, as they are of tests by themselves.

use std::ops::Range;

use crate::reduce::blocks::layout::Layout;
use crate::reduce::blocks::values::Values;
use crate::reduce::data::FEW;
use crate::reduce::design::Identity;

impl Values {
    /// The digest of the design of the test in a lane, which has so many steps.
    pub(super) fn identity(&self, layout: &Layout, lane: usize, steps: usize) -> u128 {
        let (Layout { lanes, design, transitions, .. }, gained) = (layout, &self.kept.gained);
        let own = |all, numbers| own(all, numbers, (lane, *lanes));
        let pattern = &design.moves[0].pattern;
        let (terms, pairs) = (pattern.columns.len(), pattern.pairs.len());
        let mut identity = Identity::new(&design.frame, own(gained.variance(), 0..design.variance.len()));
        let mut t = 0;
        for stretch in design.stretches().take(steps) {
            if stretch.transition.is_some() {
                if transitions.moving[t * lanes + lane] != 0.0 {
                    let phi = own(gained.transitions(), t * terms..(t + 1) * terms);
                    identity.moves(pattern, phi, own(gained.process_noise(), t * pairs..(t + 1) * pairs));
                }
                t += 1;
            }
            for line in layout.rows_of(lane, stretch.lines) {
                let h = own(gained.coefficients(), layout.terms(line));
                identity.line(design.terms(line).0.iter().copied().zip(h), gained.noise()[line * lanes + lane]);
            }
            identity.end(1);
        }
        identity.finish()
    }

    /// Whether so many steps on end of the test in a lane, which has so many in all, are equal that they have a pass of their own.
    pub(super) fn is_long(&self, layout: &Layout, lane: usize, steps: usize) -> bool {
        let (Layout { lanes, design, transitions, .. }, gained) = (layout, &self.kept.gained);
        let own = |all, numbers| own(all, numbers, (lane, *lanes)).map(f64::to_bits);
        let pattern = &design.moves[0].pattern;
        let (terms, pairs) = (pattern.columns.len(), pattern.pairs.len());
        let (mut before, mut now, mut alike, mut t) = (Vec::new(), Vec::new(), 0, 0);
        for stretch in design.stretches().take(steps) {
            now.clear();
            if stretch.transition.is_some() {
                now.push(transitions.moving[t * lanes + lane].to_bits());
                now.extend(own(gained.transitions(), t * terms..(t + 1) * terms));
                now.extend(own(gained.process_noise(), t * pairs..(t + 1) * pairs));
                t += 1;
            }
            for line in layout.rows_of(lane, stretch.lines) {
                now.extend(design.terms(line).0.iter().map(|&state| u64::from(state)));
                now.extend(own(gained.coefficients(), layout.terms(line)));
                now.push(gained.noise()[line * lanes + lane].to_bits());
            }
            alike = if now == before { alike + 1 } else { 1 };
            if alike > FEW {
                return true;
            }
            std::mem::swap(&mut before, &mut now);
        }
        false
    }
}

/// Numbers of the test in a lane.
fn own(all: &[f64], numbers: Range<usize>, (lane, lanes): (usize, usize)) -> impl Iterator<Item = f64> + use<'_> {
    numbers.map(move |k| all[k * lanes + lane])
}
