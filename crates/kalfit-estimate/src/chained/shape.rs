//! The sizes of the matrices of a test in phases: tests of one shape can be worked on side by side.

use std::ops::Range;

use kalfit_model::Path;
use kalfit_model::{Chain, ChainPhase};

/// Sizes of all matrices of a class.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ChainShape {
    /// Of its data.
    pub(super) columns: usize,
    pub(super) phases: Vec<PhaseShape>,
}

/// Sizes of those of one phase.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PhaseShape {
    /// Its states among those of all phases.
    pub(super) own: Range<usize>,
    /// q.
    pub(super) size: usize,
    /// Rows of C' of the link that leads here.
    pub(super) noise: Option<usize>,
}

impl ChainShape {
    /// That of tests which can be worked on side by side with others: some, and no phase needs rotations.
    pub(crate) fn side_by_side(chains: &[&Chain], ranges: &[Range<usize>]) -> Option<ChainShape> {
        (!chains.is_empty() && !is_careful(chains)).then(|| ChainShape::of(chains, ranges))
    }

    /// Of tests with equal matrices, at least one; `ranges` says where the states of each phase of the model stand.
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

    /// How many numbers it takes.
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

    /// The most rows or columns of any matrix.
    pub(super) fn widest(&self) -> usize {
        self.phases.iter().map(|phase| phase.size.max(phase.noise.unwrap_or(0))).max().unwrap_or(0)
    }

    /// Where the states of its phases stand.
    pub(crate) fn ranges(&self) -> impl Iterator<Item = &Range<usize>> {
        self.phases.iter().map(|phase| &phase.own)
    }
}

/// Some phase of tests needs rotations: such a class is worked on by itself.
pub(super) fn is_careful(chains: &[&Chain]) -> bool {
    chains.iter().flat_map(|chain| &chain.phases).any(|phase| phase.path == Path::SquareRoot)
}

/// Columns of the data of so many tests with so many numbers each: their mean, and the scatter about it.
pub(super) fn columns(tests: usize, data: usize) -> usize {
    if tests == 1 { 1 } else { 1 + tests.min(data) }
}
