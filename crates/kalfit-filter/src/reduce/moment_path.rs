//! P and Ψ before each step of a stretch of equal steps: the moments of the design's forward pass that a backward pass
//! needs.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi")]

use kalfit_lanes::Lanes;

use crate::reduce::design::{Design, Stretch};

/// Largest number of moving states for which equal steps have a path.
const MOST_MOVING: usize = 4;

/// Pairs (P, Ψ) of a stretch: one pair before each step while P and Ψ change, and a last pair before all remaining
/// steps or after the last step.
#[derive(Debug, Clone)]
pub(crate) struct MomentPath {
    /// First row of the stretch.
    row: usize,
    /// Number of entries of P (r × r, both triangles), and of Ψ of the moving states.
    sizes: (usize, usize),
    numbers: Vec<f64>,
    /// Number of pairs (P, Ψ) stored.
    count: usize,
}

impl MomentPath {
    /// Largest number of equal steps without a path: the backward pass goes through so short a stretch step by step.
    pub(crate) const MOST_WITHOUT_PATH: usize = 4;

    /// Number of moving states of a stretch that may have a path: equal steps of one scalar measurement, without known
    /// inputs. `None` for any other stretch.
    pub(crate) fn states(design: &Design, stretch: &Stretch<'_>) -> Option<usize> {
        design.moving_in_equal_steps(stretch, MomentPath::MOST_WITHOUT_PATH).filter(|&states| states <= MOST_MOVING)
    }

    /// An empty path of a stretch; `None` for a stretch that has no path.
    pub(super) fn new(design: &Design, stretch: &Stretch<'_>) -> Option<MomentPath> {
        let states = MomentPath::states(design, stretch)?;
        let sizes = (design.frame.r.pow(2), states * design.frame.p);
        Some(MomentPath { row: stretch.rows.start, sizes, numbers: Vec::new(), count: 0 })
    }

    /// Appends P and Ψ. `P`: r × r, of which only the lower triangle is read; `Psi`: rows of all states.
    #[inline(always)]
    pub(super) fn push<T: Lanes>(&mut self, r: usize, P: &[T], Psi: &[T]) {
        let MomentPath { numbers, sizes, count, .. } = self;
        *count += 1;
        for i in 0..r {
            for j in 0..r {
                numbers.push(P[i.max(j) * r + i.min(j)].lane(0));
            }
        }
        for x in &Psi[..sizes.1] {
            numbers.push(x.lane(0));
        }
    }

    /// The finished path, with spare capacity released.
    pub(super) fn complete(mut self) -> MomentPath {
        self.numbers.shrink_to_fit();
        self
    }

    /// (P, Ψ) before step `step`, or after the last step: P is r × r, Ψ has the rows of the moving states.
    #[inline(always)]
    pub(crate) fn before(&self, step: usize) -> (&[f64], &[f64]) {
        let size = self.sizes.0 + self.sizes.1;
        self.numbers[step.min(self.count - 1) * size..][..size].split_at(self.sizes.0)
    }

    /// Bytes of memory that the path occupies.
    pub(super) fn bytes(&self) -> usize {
        8 * self.numbers.capacity() + 64
    }

    /// The path of the stretch whose first row is `row`.
    pub(super) fn of(paths: &[MomentPath], row: usize) -> Option<&MomentPath> {
        paths.binary_search_by_key(&row, |path| path.row).ok().map(|index| &paths[index])
    }
}
