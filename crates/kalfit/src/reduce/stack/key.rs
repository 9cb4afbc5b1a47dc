//! What tests are known by that are stacked alike.

use nalgebra::DMatrix;

use crate::reduce::stack::StackPhase;

/// The phases of a test, to know tests by that are stacked alike.
#[derive(Debug, Clone)]
pub(crate) struct StackKey {
    phases: Vec<KeyPhase>,
}

#[derive(Debug, Clone)]
struct KeyPhase {
    own: usize,
    factor: Vec<f64>,
    link: Option<[DMatrix<f64>; 3]>,
}

impl StackKey {
    pub(crate) fn new(phases: &[StackPhase<'_>]) -> StackKey {
        let owned = |phase: &StackPhase<'_>| KeyPhase {
            own: phase.own,
            factor: phase.factor.to_vec(),
            link: phase.link.map(|link| link.map(Clone::clone)),
        };
        StackKey { phases: phases.iter().map(owned).collect() }
    }

    /// Equal bit for bit.
    pub(crate) fn same(&self, phases: &[StackPhase<'_>]) -> bool {
        let same_matrix =
            |a: &DMatrix<f64>, b: &DMatrix<f64>| a.shape() == b.shape() && same_bits(a.as_slice(), b.as_slice());
        let same_phase = |(a, b): (&KeyPhase, &StackPhase<'_>)| {
            let same_link = match (&a.link, b.link) {
                (Some(a), Some(b)) => a.iter().zip(b).all(|(a, b)| same_matrix(a, b)),
                (None, None) => true,
                _ => false,
            };
            a.own == b.own && same_bits(&a.factor, b.factor) && same_link
        };
        self.phases.len() == phases.len() && self.phases.iter().zip(phases).all(same_phase)
    }

    pub(super) fn phases(&self) -> Vec<StackPhase<'_>> {
        let mut phases = Vec::with_capacity(self.phases.len());
        for KeyPhase { own, factor, link } in &self.phases {
            let link = link.as_ref().map(|link| link.each_ref());
            phases.push(StackPhase { own: *own, factor, link });
        }
        phases
    }

    /// Bytes it occupies.
    pub(crate) fn bytes(&self) -> usize {
        let of = |phase: &KeyPhase| {
            let link = phase.link.as_ref().map_or(0, |link| link.iter().map(DMatrix::len).sum());
            8 * (phase.factor.len() + link) + 100
        };
        self.phases.iter().map(of).sum()
    }
}

fn same_bits(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(x, y)| x.to_bits() == y.to_bits())
}
