//! Groups of steps with the same transition, whose adjoints are summed so that each group goes back through the matrix
//! exponential only once.

use std::collections::HashMap;
use std::sync::Arc;

use crate::reduce::Transition;
use crate::score::pullback::taps::CellRead;
use kalfit_model::Scope;

/// Largest number of groups, one for each distinct transition; when it is reached, the sums are passed on and the
/// groups are cleared.
const MAX_GROUPS: usize = 1024;

/// The groups of the transitions of a test that were seen so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Groups {
    /// (length of the sums of one group, length of the flows of one group).
    sizes: (usize, usize),
    last: Option<(Arc<Transition>, usize)>,
    known: HashMap<Vec<u64>, usize>,
    /// Index of the step with which each group was added.
    pub(super) steps: Vec<usize>,
    sums: Vec<f64>,
    flows: Vec<f64>,
    /// Bits of the cells of the group that was used last (`cells`), and scratch (`key`).
    cells: Vec<u64>,
    key: Vec<u64>,
}

impl Groups {
    pub(super) fn new(sums: usize, flows: usize) -> Groups {
        Groups { sizes: (sums, flows), ..Groups::default() }
    }

    /// The group that was used last, if a step with this transition and scope belongs to the group; otherwise `None`.
    /// `reads`: cells that coefficients with free values read.
    #[inline]
    pub(super) fn last_group(
        &self,
        transition: &Arc<Transition>,
        reads: &[CellRead],
        scope: Option<&Scope<'_>>,
    ) -> Option<usize> {
        let (known, group) = self.last.as_ref()?;
        let same = |scope: &Scope<'_>| reads.iter().zip(&self.cells).all(|(read, &bits)| read.bits(scope) == bits);
        (Arc::ptr_eq(known, transition) && (reads.is_empty() || scope.is_some_and(same))).then_some(*group)
    }

    /// The group of a step, and whether it is new. Transitions are distinguished by the values `made`, which they are
    /// computed from, and by the cells, not by address: whether two transitions share memory depends on other tests.
    pub(super) fn find_or_add(
        &mut self,
        (transition, k): (&Arc<Transition>, usize),
        (reads, scope): (&[CellRead], &Scope<'_>),
        made: impl Iterator<Item = f64>,
    ) -> (usize, bool) {
        self.cells.clear();
        self.cells.extend(reads.iter().map(|read| read.bits(scope)));
        self.key.clear();
        self.key.extend(made.map(f64::to_bits));
        self.key.extend_from_slice(&self.cells);
        let next = self.steps.len();
        let group = match self.known.get(&self.key) {
            Some(&group) => group,
            None => {
                self.known.insert(self.key.clone(), next);
                self.steps.push(k);
                self.sums.resize(self.sums.len() + self.sizes.0, 0.0);
                self.flows.resize(self.flows.len() + self.sizes.1, 0.0);
                next
            }
        };
        self.last = Some((transition.clone(), group));
        (group, group == next)
    }

    /// Whether the sums of the groups must be passed on before another group is added.
    pub(super) fn is_full(&self) -> bool {
        self.steps.len() >= MAX_GROUPS
    }

    pub(super) fn sums(&mut self, group: usize) -> &mut [f64] {
        &mut self.sums[group * self.sizes.0..][..self.sizes.0]
    }

    pub(super) fn flows(&mut self, group: usize) -> &mut [f64] {
        &mut self.flows[group * self.sizes.1..][..self.sizes.1]
    }

    pub(super) fn clear(&mut self) {
        self.last = None;
        self.known.clear();
        self.steps.clear();
        self.sums.clear();
        self.flows.clear();
    }
}
