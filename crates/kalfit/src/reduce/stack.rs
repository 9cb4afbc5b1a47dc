//! All phases of a test as one square-root array in (ξ_1, …, ξ_I): what lies between phases is integrated out.
//!
//! From the last phase backward there are rows R on (σ_{i+1}, ξ_{i+2}, …). With the link
//! σ_{i+1} = [ξ_{i+1}; 0] + g + Gσ_i + Cu, u ~ N(0, I), they become rows on (u, σ_i, ξ_{i+1}, …); folded by plane rotations below
//! [I 0] of u and the rows of phase i, they leave u's own rows on top, whose diagonal is |I + RCC'R'|^½ and which say nothing
//! else, and below them the rows on (σ_i, ξ_{i+1}, …). Nothing is inverted, and R, P_K and Σ may be singular.
#![expect(non_snake_case, reason = "the letters of the theory: R, G, C, A the rows on σ")]

use kalfit_lanes::{Isa, Kernel, Lanes};
use nalgebra::{DMatrix, DVector};

use crate::linalg::fold::{fold, fold_row};
use crate::reduce::gains::Settle;
use crate::reduce::root::settle;

/// What stacking depends on, the data apart, of one phase of a test.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StackPhase<'a> {
    /// p_i.
    pub(crate) own: usize,
    /// R_i, packed by columns, q_i × q_i.
    pub(crate) factor: &'a [f64],
    /// Ψ_K and a root of P_K of the phase before, and T; `None` for the first phase.
    pub(crate) link: Option<[&'a DMatrix<f64>; 3]>,
}

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

/// Stacks phases.
struct Stacking<'a>(&'a StackKey);

impl Kernel for Stacking<'_> {
    type Output = Stack;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Stack {
        Stack::of(self.0)
    }
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

/// The data of a phase.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StackData<'a> {
    pub(crate) constant: f64,
    /// d_i.
    pub(crate) data: &'a [f64],
    /// g of the link that leads here.
    pub(crate) mean: Option<&'a DVector<f64>>,
}

/// A square upper triangular array, row-major.
struct Square {
    width: usize,
    entries: Vec<f64>,
}

impl Square {
    fn zeros(width: usize) -> Square {
        Square { width, entries: vec![0.0; width * width] }
    }

    /// Puts a packed factor at (at, at).
    fn put_packed(&mut self, at: usize, factor: &[f64], size: usize) {
        for k in 0..size {
            for i in 0..=k {
                self.entries[(at + i) * self.width + at + k] = factor[i + k * (k + 1) / 2];
            }
        }
    }

    /// Its rows and columns from `first` on, put at (at, at) of another.
    fn copy_from(&self, first: usize, to: &mut Square, at: usize) {
        let size = self.width - first;
        for i in 0..size {
            let row = &self.entries[(first + i) * self.width + first..][..size];
            to.entries[(at + i) * to.width + at..][..size].copy_from_slice(row);
        }
    }

    fn row(&self, i: usize) -> &[f64] {
        &self.entries[i * self.width..][..self.width]
    }
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

/// G = TΨ_K and C of a link, a root of T P_K T', from Ψ_K, a root of P_K and T.
fn link_matrices([sensitivity, root, transition]: [&DMatrix<f64>; 3]) -> (DMatrix<f64>, DMatrix<f64>) {
    (transition * sensitivity, narrow(transition * root))
}

/// A root with no more columns than rows.
fn narrow(C: DMatrix<f64>) -> DMatrix<f64> {
    let (q, u) = C.shape();
    if u <= q || q == 0 {
        return C.resize_horizontally(u.min(q), 0.0);
    }
    let (mut U, mut rows) = (vec![0.0; q * q], C.as_slice().to_vec()); // C' by rows is C by columns
    fold(&mut U, &mut rows, q);
    DMatrix::from_column_slice(q, q, &U) // U' of U by rows
}

/// Size of a packed triangle with so many entries.
pub(crate) fn packed_size(entries: usize) -> usize {
    (0..).find(|&size| size * (size + 1) / 2 >= entries).expect("sizes have no end")
}

impl Stack {
    /// Stacks the phases of a key, at least one.
    pub(crate) fn new(key: &StackKey) -> Stack {
        Isa::best().run(Stacking(key))
    }

    /// The same in any registers, to the same bits: rows of rotations are as wide as registers.
    #[inline(always)]
    fn of(key: &StackKey) -> Stack {
        let mut stack = Stack {
            factor: Vec::new(),
            links: Vec::new(),
            half_log_determinant: 0.0,
            stages: Vec::new(),
            settle: Vec::new(),
        };
        let last = key.phases.last().expect("a test has a phase");
        let q = packed_size(last.factor.len());
        let mut array = Square::zeros(q);
        array.put_packed(0, &last.factor, q);
        for pair in key.phases.windows(2).rev() {
            array = stack.join(&pair[0], &pair[1], &array);
        }
        stack.links.reverse();
        settle(&mut array.entries, array.width, &mut stack.settle);
        for k in 0..array.width {
            stack.factor.extend((0..=k).map(|i| array.row(i)[k]));
        }
        stack
    }

    /// Joins a phase and what is known of all after it: the rows on (σ_i, ξ_{i+1}, …).
    #[inline(always)]
    fn join(&mut self, before: &KeyPhase, after: &KeyPhase, later: &Square) -> Square {
        let link = after.link.as_ref().expect("a later phase has a link");
        let (G, C) = link_matrices(link.each_ref());
        let (u, from, q, own) = (C.ncols(), G.ncols(), G.nrows(), after.own);
        let mut array = Square::zeros(u + from + own + later.width - q);
        for k in 0..u {
            array.entries[k * (array.width + 1)] = 1.0;
        }
        array.put_packed(u, &before.factor, from);
        later.copy_from(q, &mut array, u + from + own);
        let mut stage = Stage { A: vec![0.0; q * q], sizes: (q, own, u), turns: Vec::new(), ends: Vec::new() };
        for i in 0..q {
            let (A, B) = later.row(i).split_at(q);
            stage.A[i * q..][..q].copy_from_slice(A);
            let product = |matrix: &DMatrix<f64>, c: usize| (i..q).map(|k| A[k] * matrix[(k, c)]).sum::<f64>();
            let mut row: Vec<f64> = (0..u).map(|c| product(&C, c)).collect();
            row.extend((0..from).map(|c| product(&G, c)));
            row.extend_from_slice(&A[..own]);
            row.extend_from_slice(B);
            fold_row(&mut array.entries, &mut row, |k, turn| {
                if turn.s != 0.0 {
                    stage.turns.push((k as u32, turn.c, turn.s));
                }
            });
            stage.ends.push(stage.turns.len());
        }
        self.half_log_determinant += (0..u).map(|k| array.row(k)[k].ln()).sum::<f64>();
        self.stages.push(stage);
        self.links.push((G, C));
        let mut rest = Square::zeros(array.width - u);
        array.copy_from(u, &mut rest, 0);
        rest
    }

    /// (constant, d) of all phases together.
    pub(crate) fn data(&self, phases: &[StackData<'_>]) -> (f64, Vec<f64>) {
        let mut d = phases.last().expect("a test has a phase").data.to_vec();
        let mut residual = 0.0;
        for (stage, pair) in self.stages.iter().zip(phases.windows(2).rev()) {
            let g = pair[1].mean.expect("a later phase has a link");
            d = stage.join(pair[0].data, g, &d, &mut residual);
        }
        for &one in &self.settle {
            one.apply(&mut d, &mut residual);
        }
        let constant = phases.iter().map(|phase| phase.constant).sum::<f64>();
        (constant - self.half_log_determinant - 0.5 * residual, d)
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
    fn join(&self, before: &[f64], g: &DVector<f64>, later: &[f64], residual: &mut f64) -> Vec<f64> {
        let (q, own, u) = self.sizes;
        let mut d = Vec::with_capacity(u + before.len() + own + later.len() - q);
        d.resize(u, 0.0);
        d.extend_from_slice(before);
        d.resize(u + before.len() + own, 0.0);
        d.extend_from_slice(&later[q..]);
        let mut start = 0;
        for (i, &end) in self.ends.iter().enumerate() {
            let known: f64 = (i..q).map(|k| self.A[i * q + k] * g[k]).sum();
            let mut left = later[i] - known;
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
