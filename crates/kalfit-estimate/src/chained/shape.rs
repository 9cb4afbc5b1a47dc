//! The sizes of the matrices of a test in phases: tests of one shape can be packed in lanes.

use std::ops::Range;

use kalfit_model::Path;
use kalfit_model::{Chain, ChainPhase};

/// Sizes of all matrices of a class.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ChainShape {
    /// Number of columns of the data.
    pub(super) columns: usize,
    pub(super) phases: Vec<PhaseShape>,
}

/// Sizes of the matrices of one phase.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PhaseShape {
    /// Range of the states that are new in the phase, as indices into the states of all phases.
    pub(super) own: Range<usize>,
    /// q, number of coordinates that enter the phase.
    pub(super) size: usize,
    /// Number of rows of C' of the link that leads to this phase; `None` for the first phase.
    pub(super) noise: Option<usize>,
}

impl ChainShape {
    /// Shape of a class of tests, to pack the class in a lane; `None` without tests, or where some phase needs
    /// rotations.
    pub(crate) fn for_lanes(chains: &[&Chain], ranges: &[Range<usize>]) -> Option<ChainShape> {
        (!chains.is_empty() && !is_by_rotations(chains)).then(|| ChainShape::of(chains, ranges))
    }

    /// Shape of a class of at least one test, all with equal matrices; `ranges`: range of the states of each phase of
    /// the model.
    pub(super) fn of(chains: &[&Chain], ranges: &[Range<usize>]) -> ChainShape {
        let phase = |(phase, own): (&ChainPhase, &Range<usize>)| PhaseShape {
            own: own.clone(),
            size: phase.data.len(),
            noise: phase.link.as_ref().map(|link| link.root.ncols()),
        };
        let phases: Vec<PhaseShape> = chains[0].phases.iter().zip(ranges).map(phase).collect();
        let data = phases.iter().map(|phase| phase.size).sum();
        ChainShape { columns: columns(chains.len(), data), phases }
    }

    /// Number of values that a class of this shape takes.
    pub(super) fn size(&self) -> usize {
        let mut before = 0;
        let of = |phase: &PhaseShape| {
            let q = phase.size;
            let link = phase.noise.map_or(0, |rows| q * before + rows * q);
            before = q;
            q * (q + 1) / 2 + q * self.columns + link
        };
        1 + self.phases.iter().map(of).sum::<usize>()
    }

    /// The largest number of rows or columns of any matrix.
    pub(super) fn widest(&self) -> usize {
        self.phases.iter().map(|phase| phase.size.max(phase.noise.unwrap_or(0))).max().unwrap_or(0)
    }

    /// For each phase the range of the new states, as indices into the states of all phases.
    pub(crate) fn ranges(&self) -> impl Iterator<Item = &Range<usize>> {
        self.phases.iter().map(|phase| &phase.own)
    }
}

/// Whether some phase of the tests needs rotations: such a class is evaluated by itself.
pub(super) fn is_by_rotations(chains: &[&Chain]) -> bool {
    chains.iter().flat_map(|chain| &chain.phases).any(|phase| phase.path == Path::SquareRoot)
}

/// Number of data columns of a class of `tests` tests with `data` numbers each: one column for the mean, the others for
/// the scatter about the mean.
pub(super) fn columns(tests: usize, data: usize) -> usize {
    if tests == 1 { 1 } else { 1 + tests.min(data) }
}
