//! The rotations that stack the phases of a design, kept for all tests that have it.
#![expect(non_snake_case, reason = "the letters of the theory: R, G, C, A the rows on σ")]

use kalfit_lanes::{Isa, Kernel, Lanes};
use nalgebra::DMatrix;

use crate::linalg::fold::Rotation;
use crate::reduce::gains::Settle;
use crate::reduce::root::UNINFORMED;
use crate::reduce::stack::join::{Room, dot};
use crate::reduce::stack::{
    StackData, StackKey, StackPhase, constant, given, half_log_determinants, links, settle_packed,
};

/// The rotations that stack phases.
#[derive(Debug, Clone)]
pub(crate) struct Stack {
    /// R of all phases together, packed by columns.
    pub(crate) factor: Vec<f64>,
    /// G and C of each link, from the first on.
    pub(crate) links: Vec<(DMatrix<f64>, DMatrix<f64>)>,
    /// ½ Σ log|I + RCC'R'|.
    half_log_determinant: f64,
    /// From the last link to the first.
    stages: Vec<Stage>,
    settle: Vec<Settle>,
}

/// What one link does to the data.
#[derive(Debug, Clone)]
struct Stage {
    /// R on σ_{i+1}, q × q, row-major, upper triangular.
    A: Vec<f64>,
    /// q of σ_{i+1}, p of ξ_{i+1}, number of u.
    sizes: (usize, usize, usize),
    /// (place in d, c, s), those of each row of A in turn.
    turns: Vec<(u32, f64, f64)>,
    /// End of the turns of each row.
    ends: Vec<usize>,
}

/// Stacks the phases of a design.
struct Design<'a>(&'a [StackPhase<'a>]);

impl Kernel for Design<'_> {
    type Output = Stack;

    /// One test: rows of rotations are as wide as registers.
    #[inline(always)]
    fn run<T: Lanes>(self) -> Stack {
        let phases = given::<f64>(&[self.0], None);
        let mut array = phases[phases.len() - 1].last(Vec::new());
        let (mut stages, mut diagonals, mut room) = (Vec::new(), Vec::new(), Room::default());
        for pair in phases.windows(2).rev() {
            let link = pair[1].link.as_ref().expect("a later phase has a link");
            let q = link.G.rows;
            let mut turns = vec![Vec::with_capacity(array.width); q];
            let note = |i: usize, k: usize, turn: Rotation| turns[i].push((k as u32, turn.c, turn.s));
            let A = (0..q).flat_map(|i| array.row(i)[..q].iter().copied()).collect();
            let (rest, diagonal) = pair[0].join(&pair[1], array, &mut 0.0, note, &mut room);
            let ends = turns.iter().scan(0, |end, turns| {
                *end += turns.len();
                Some(*end)
            });
            let sizes = (q, pair[1].own, link.C.columns);
            stages.push(Stage { A, sizes, ends: ends.collect(), turns: turns.concat() });
            diagonals.push(diagonal);
            array = rest;
        }
        let (mut factor, mut settled) = (array.packed(), Vec::new());
        if !array.is_regular(UNINFORMED) {
            settle_packed(&mut factor, array.width, &mut settled);
        }
        let half_log_determinant = half_log_determinants(&diagonals, 1)[0];
        let links = links(&phases, 1).remove(0);
        Stack { factor, links, half_log_determinant, stages, settle: settled }
    }
}

impl Stack {
    /// Stacks the phases of a key, at least one.
    pub(crate) fn new(key: &StackKey) -> Stack {
        Isa::best().run(Design(&key.phases()))
    }

    /// (constant, d) of all phases together.
    pub(crate) fn data(&self, phases: &[StackData<'_>]) -> (f64, Vec<f64>) {
        let mut d = phases.last().expect("a test has a phase").data.to_vec();
        let mut residual = 0.0;
        for (stage, pair) in self.stages.iter().zip(phases.windows(2).rev()) {
            d = stage.join(pair[0].data, pair[1], &d, &mut residual);
        }
        self.settle.iter().for_each(|one| one.apply(&mut d, &mut residual));
        (constant(phases, self.half_log_determinant, residual), d)
    }

    /// Bytes it occupies.
    pub(crate) fn bytes(&self) -> usize {
        let stages: usize = self.stages.iter().map(|s| s.A.len() + 3 * s.turns.len() + s.ends.len() + 20).sum();
        let links: usize = self.links.iter().map(|(G, C)| G.len() + C.len() + 20).sum();
        8 * (stages + links + self.factor.len() + 5 * self.settle.len()) + 200
    }
}

impl Stage {
    /// d of the phase before and all after it; `later`: d of those.
    fn join(&self, before: &[f64], after: StackData<'_>, later: &[f64], residual: &mut f64) -> Vec<f64> {
        let (q, own, u) = self.sizes;
        let g = after.mean.expect("a later phase has a link").as_slice();
        let mut d = Vec::with_capacity(u + before.len() + own + later.len() - q);
        d.resize(u, 0.0);
        d.extend_from_slice(before);
        d.resize(u + before.len() + own, 0.0);
        d.extend_from_slice(&later[q..]);
        let mut start = 0;
        for (i, &end) in self.ends.iter().enumerate() {
            let mut left = later[i] - dot(&self.A[i * q + i..][..q - i], &g[i..]);
            for &(k, c, s) in &self.turns[start..end] {
                let d = &mut d[k as usize];
                (*d, left) = (c * *d + s * left, c * left - s * *d);
            }
            *residual += left * left;
            start = end;
        }
        d.drain(..u);
        d
    }
}
