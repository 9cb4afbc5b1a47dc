//! All phases of a test as one square-root array in (ξ_1, …, ξ_I): what lies between phases is integrated out.
//!
//! From the last phase backward there are rows R on (σ_{i+1}, ξ_{i+2}, …). With the link
//! σ_{i+1} = [ξ_{i+1}; 0] + g + Gσ_i + Cu, u ~ N(0, I), they become rows on (u, σ_i, ξ_{i+1}, …); folded by plane rotations below
//! [I 0] of u and the rows of phase i, they leave u's own rows on top, whose diagonal is |I + RCC'R'|^½ and which say nothing
//! else, and below them the rows on (σ_i, ξ_{i+1}, …). Nothing is inverted, and R, P_K and Σ may be singular.
#![expect(non_snake_case, reason = "the letters of the theory: R, G, C, A the rows on σ")]

use kalfit_lanes::{Isa, Kernel, Lanes};
use nalgebra::{DMatrix, DVector};

use crate::linalg::fold::{fold, fold_rows};
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

/// The phases of one test stacked, rotations forgotten.
#[derive(Debug, Clone)]
pub(crate) struct Stacked {
    /// R of all phases together, packed by columns.
    pub(crate) factor: Vec<f64>,
    /// G and C of each link, from the first on.
    pub(crate) links: Vec<(DMatrix<f64>, DMatrix<f64>)>,
    pub(crate) constant: f64,
    /// d of all phases together.
    pub(crate) data: Vec<f64>,
}

/// Stacks phases, with the data of a test or for any.
struct Stacking<'a>(&'a [StackPhase<'a>], Option<&'a [StackData<'a>]>);

impl Kernel for Stacking<'_> {
    type Output = (Stack, Option<(f64, Vec<f64>)>);

    #[inline(always)]
    fn run<T: Lanes>(self) -> Self::Output {
        Stack::of(self.0, self.1)
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

/// A square upper triangular array, row-major, perhaps with a column of data beside it.
struct Square {
    width: usize,
    /// The width with the data.
    stride: usize,
    entries: Vec<f64>,
}

impl Square {
    fn zeros(width: usize, with_data: bool) -> Square {
        let stride = width + usize::from(with_data);
        Square { width, stride, entries: vec![0.0; width * stride] }
    }

    /// Puts a packed factor at (at, at).
    fn put_packed(&mut self, at: usize, factor: &[f64], size: usize) {
        for k in 0..size {
            for i in 0..=k {
                self.entries[(at + i) * self.stride + at + k] = factor[i + k * (k + 1) / 2];
            }
        }
    }

    /// Puts data beside the rows from one on, where they have a place.
    fn put_data(&mut self, at: usize, data: &[f64]) {
        if self.stride > self.width {
            let places = self.entries.chunks_exact_mut(self.stride).skip(at);
            places.zip(data).for_each(|(row, x)| row[self.width] = *x);
        }
    }

    /// Its rows and columns from `first` on, put at (at, at) of another, whose last ones they are, and the data.
    fn copy_from(&self, first: usize, to: &mut Square, at: usize) {
        let size = self.stride - first;
        for i in 0..self.width - first {
            let row = &self.entries[(first + i) * self.stride + first..][..size];
            to.entries[(at + i) * to.stride + at..][..size].copy_from_slice(row);
        }
    }

    fn row(&self, i: usize) -> &[f64] {
        &self.entries[i * self.stride..][..self.width]
    }

    /// What stands beside a row.
    fn data(&self, i: usize) -> Option<f64> {
        (self.stride > self.width).then(|| self.entries[i * self.stride + self.width])
    }

    /// Without the data.
    fn alone(self) -> Vec<f64> {
        if self.stride == self.width {
            return self.entries;
        }
        (0..self.width).flat_map(|i| self.row(i).iter().copied()).collect()
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

    fn phases(&self) -> Vec<StackPhase<'_>> {
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
        Isa::best().run(Stacking(&key.phases(), None)).0
    }

    /// Stacks the phases of one test, at least one, with its data: to the bits of [`Stack::new`] and [`Stack::data`].
    pub(crate) fn once(phases: &[StackPhase<'_>], data: &[StackData<'_>]) -> Stacked {
        let (stack, told) = Isa::best().run(Stacking(phases, Some(data)));
        let (constant, data) = told.expect("there were data");
        Stacked { factor: stack.factor, links: stack.links, constant, data }
    }

    /// The same in any registers, to the same bits: rows of rotations are as wide as registers. With data, what they become, and
    /// rotations are not kept.
    #[inline(always)]
    fn of(phases: &[StackPhase<'_>], data: Option<&[StackData<'_>]>) -> (Stack, Option<(f64, Vec<f64>)>) {
        let mut stack = Stack {
            factor: Vec::new(),
            links: Vec::new(),
            half_log_determinant: 0.0,
            stages: Vec::new(),
            settle: Vec::new(),
        };
        let last = phases.len() - 1;
        let q = packed_size(phases[last].factor.len());
        let mut array = Square::zeros(q, data.is_some());
        array.put_packed(0, phases[last].factor, q);
        let told = |at: usize| data.map(|data| data[at]);
        if let Some(told) = told(last) {
            array.put_data(0, told.data);
        }
        let mut residual = 0.0;
        for at in (0..last).rev() {
            let told = told(at).zip(told(at + 1));
            array = stack.join((&phases[at], &phases[at + 1]), &array, told, &mut residual);
        }
        stack.links.reverse();
        let (width, mut d) = (array.width, (0..array.width).filter_map(|i| array.data(i)).collect::<Vec<f64>>());
        let mut entries = array.alone();
        settle(&mut entries, width, &mut stack.settle);
        stack.factor.reserve_exact(width * (width + 1) / 2);
        for k in 0..width {
            stack.factor.extend((0..=k).map(|i| entries[i * width + k]));
        }
        let told = data.map(|data| (stack.constant(data, &mut d, &mut residual), d));
        (stack, told)
    }

    /// Joins a phase and what is known of all after it: the rows on (σ_i, ξ_{i+1}, …). With the data of both, rotations are not kept.
    #[inline(always)]
    fn join(
        &mut self,
        (before, after): (&StackPhase<'_>, &StackPhase<'_>),
        later: &Square,
        told: Option<(StackData<'_>, StackData<'_>)>,
        residual: &mut f64,
    ) -> Square {
        let (G, C) = link_matrices(after.link.expect("a later phase has a link"));
        let (u, from, q, own) = (C.ncols(), G.ncols(), G.nrows(), after.own);
        let mut array = Square::zeros(u + from + own + later.width - q, told.is_some());
        for k in 0..u {
            array.entries[k * (array.stride + 1)] = 1.0;
        }
        array.put_packed(u, before.factor, from);
        if let Some((before, _)) = told {
            array.put_data(u, before.data);
        }
        later.copy_from(q, &mut array, u + from + own);
        let mut rows = vec![0.0; q * array.stride];
        for (i, row) in rows.chunks_exact_mut(array.stride.max(1)).enumerate() {
            let (A, B) = later.row(i).split_at(q);
            let mut to = row.iter_mut();
            for matrix in [&C, &G] {
                for (column, to) in matrix.as_slice().chunks_exact(q.max(1)).zip(&mut to) {
                    *to = A[i..].iter().zip(&column[i..]).map(|(a, x)| a * x).sum();
                }
            }
            to.zip(A[..own].iter().chain(B)).for_each(|(to, x)| *to = *x);
            if let (Some(d), Some((_, after))) = (later.data(i), told) {
                row[array.width] = d - known(&A[i..], after, i);
            }
        }
        let mut turns = vec![Vec::with_capacity(if told.is_some() { 0 } else { array.width }); q];
        fold_rows(&mut array.entries, &mut rows, (array.width, array.stride), |i, k, turn| {
            if told.is_none() && turn.s != 0.0 {
                turns[i].push((k as u32, turn.c, turn.s));
            }
        });
        self.half_log_determinant += (0..u).map(|k| array.row(k)[k].ln()).sum::<f64>();
        if told.is_some() {
            rows.chunks_exact(array.stride.max(1)).for_each(|row| *residual += row[array.width] * row[array.width]);
        } else {
            let A = (0..q).flat_map(|i| later.row(i)[..q].iter().copied()).collect();
            let ends = turns.iter().scan(0, |end, turns| {
                *end += turns.len();
                Some(*end)
            });
            self.stages.push(Stage { A, sizes: (q, own, u), ends: ends.collect(), turns: turns.concat() });
        }
        self.links.push((G, C));
        let mut rest = Square::zeros(array.width - u, told.is_some());
        array.copy_from(u, &mut rest, 0);
        rest
    }

    /// The constant of all phases together, once d is what the links leave of the data; d as it is in the end.
    fn constant(&self, phases: &[StackData<'_>], d: &mut [f64], residual: &mut f64) -> f64 {
        for &one in &self.settle {
            one.apply(d, residual);
        }
        let constant = phases.iter().map(|phase| phase.constant).sum::<f64>();
        constant - self.half_log_determinant - 0.5 * *residual
    }

    /// (constant, d) of all phases together.
    pub(crate) fn data(&self, phases: &[StackData<'_>]) -> (f64, Vec<f64>) {
        let mut d = phases.last().expect("a test has a phase").data.to_vec();
        let mut residual = 0.0;
        for (stage, pair) in self.stages.iter().zip(phases.windows(2).rev()) {
            d = stage.join(pair[0].data, pair[1], &d, &mut residual);
        }
        (self.constant(phases, &mut d, &mut residual), d)
    }

    /// Bytes it occupies.
    pub(crate) fn bytes(&self) -> usize {
        let stages: usize = self.stages.iter().map(|s| s.A.len() + 3 * s.turns.len() + s.ends.len() + 20).sum();
        let links: usize = self.links.iter().map(|(G, C)| G.len() + C.len() + 20).sum();
        8 * (stages + links + self.factor.len() + 5 * self.settle.len()) + 200
    }
}

/// What g, known of what leads to a phase, says in row i of its A, from the diagonal on.
#[inline(always)]
fn known(A: &[f64], after: StackData<'_>, i: usize) -> f64 {
    let g = after.mean.expect("a later phase has a link").as_slice();
    A.iter().zip(&g[i..]).map(|(a, g)| a * g).sum()
}

impl Stage {
    /// d of the phase before and all after it; `later`: d of those.
    fn join(&self, before: &[f64], after: StackData<'_>, later: &[f64], residual: &mut f64) -> Vec<f64> {
        let (q, own, u) = self.sizes;
        let mut d = Vec::with_capacity(u + before.len() + own + later.len() - q);
        d.resize(u, 0.0);
        d.extend_from_slice(before);
        d.resize(u + before.len() + own, 0.0);
        d.extend_from_slice(&later[q..]);
        let mut start = 0;
        for (i, &end) in self.ends.iter().enumerate() {
            let mut left = later[i] - known(&self.A[i * q + i..][..q - i], after, i);
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
