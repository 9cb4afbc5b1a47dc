//! P and Ψ before each of many equal steps: what a way back wants to know of the design's way forth.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi")]

use kalfit_lanes::Lanes;

use crate::reduce::design::{Design, Stretch};

/// Most states that move in equal steps that have a path.
const MOST_MOVING: usize = 4;

/// P and Ψ before the steps of a stretch as long as they change, and once more: before all that follow, or after the last one.
#[derive(Debug, Clone)]
pub(crate) struct MomentPath {
    /// The first row.
    row: usize,
    /// Numbers of P, r × r, both triangles, and of Ψ of the states that move.
    sizes: (usize, usize),
    numbers: Vec<f64>,
    /// How many times.
    many: usize,
}

impl MomentPath {
    /// So many equal steps have none: the way back goes through them one by one.
    pub(crate) const FEW: usize = 4;

    /// How many states move in a stretch, if it is of the kind that may have a path: equal steps of one scalar measurement, without
    /// known inputs.
    pub(crate) fn states(design: &Design, stretch: &Stretch<'_>) -> Option<usize> {
        design.equal_moving(stretch, MomentPath::FEW).filter(|&states| states <= MOST_MOVING)
    }

    /// Of a stretch, if it is of that kind.
    pub(super) fn new(design: &Design, stretch: &Stretch<'_>) -> Option<MomentPath> {
        let states = MomentPath::states(design, stretch)?;
        let sizes = (design.frame.r.pow(2), states * design.frame.p);
        Some(MomentPath { row: stretch.rows.start, sizes, numbers: Vec::new(), many: 0 })
    }

    /// Goes on; `P`: r × r, of which the lower triangle counts, `Psi`: of all states.
    #[inline(always)]
    pub(super) fn push<T: Lanes>(&mut self, r: usize, P: &[T], Psi: &[T]) {
        let MomentPath { numbers, sizes, many, .. } = self;
        *many += 1;
        for i in 0..r {
            for j in 0..r {
                numbers.push(P[i.max(j) * r + i.min(j)].lane(0));
            }
        }
        for x in &Psi[..sizes.1] {
            numbers.push(x.lane(0));
        }
    }

    /// The whole path, with no more room than it takes.
    pub(super) fn complete(mut self) -> MomentPath {
        self.numbers.shrink_to_fit();
        self
    }

    /// P, r × r, and Ψ of the states that move, before a step or after the last one.
    #[inline(always)]
    pub(crate) fn before(&self, step: usize) -> (&[f64], &[f64]) {
        let size = self.sizes.0 + self.sizes.1;
        self.numbers[step.min(self.many - 1) * size..][..size].split_at(self.sizes.0)
    }

    /// Bytes it occupies.
    pub(super) fn bytes(&self) -> usize {
        8 * self.numbers.capacity() + 64
    }

    /// That of the stretch with this first row.
    pub(super) fn of(paths: &[MomentPath], row: usize) -> Option<&MomentPath> {
        paths.binary_search_by_key(&row, |path| path.row).ok().map(|at| &paths[at])
    }
}
