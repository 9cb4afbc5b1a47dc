//! All phases of a test as one square-root array in (ξ_1, …, ξ_I): what lies between phases is integrated out.
//!
//! From the last phase backward there are rows R on (σ_{i+1}, ξ_{i+2}, …). With the link
//! σ_{i+1} = [ξ_{i+1}; 0] + g + Gσ_i + Cu, u ~ N(0, I), they become rows on (u, σ_i, ξ_{i+1}, …); folded by plane rotations below
//! [I 0] of u and the rows of phase i, they leave u's own rows on top, whose diagonal is |I + RCC'R'|^½ and which say nothing
//! else, and below them the rows on (σ_i, ξ_{i+1}, …). Nothing is inverted, and R, P_K and Σ may be singular.
//!
//! Designs that several tests have are stacked once, and the rotations are done to the data of each ([`Stack`]); tests with designs of
//! their own are stacked side by side with their data ([`Stacked`]). Both come to the same bits.
#![expect(non_snake_case, reason = "the letters of the theory: R, G, C, A the rows on σ")]

mod join;
mod square;

use kalfit_lanes::{Isa, Kernel, Lanes, MOST};
use nalgebra::{DMatrix, DVector};

use crate::linalg::fold::Rotation;
use crate::reduce::gains::Settle;
use crate::reduce::root::{UNINFORMED, settle};
use join::{Given, Room, apart, dot};

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

/// The sizes of the matrices that stacking depends on: tests with the same ones can be stacked side by side.
pub(crate) type StackShape = Vec<(usize, usize, Option<[(usize, usize); 3]>)>;

/// The sizes of phases.
pub(crate) fn shape(phases: &[StackPhase<'_>]) -> StackShape {
    phases
        .iter()
        .map(|phase| (phase.own, phase.factor.len(), phase.link.map(|link| link.map(DMatrix::shape))))
        .collect()
}

impl StackPhase<'_> {
    /// q_i.
    fn size(&self) -> usize {
        packed_size(self.factor.len())
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

/// Size of a packed triangle with so many entries.
pub(crate) fn packed_size(entries: usize) -> usize {
    (0..).find(|&size| size * (size + 1) / 2 >= entries).expect("sizes have no end")
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

/// Stacks phases of tests of one shape, each with its data.
struct Abreast<'a> {
    tests: &'a [&'a [StackPhase<'a>]],
    data: &'a [&'a [StackData<'a>]],
}

impl Kernel for Abreast<'_> {
    type Output = Vec<Stacked>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Vec<Stacked> {
        let mut all = Vec::with_capacity(self.tests.len());
        let mut room = (Room::default(), Vec::new());
        for (tests, data) in self.tests.chunks(T::COUNT).zip(self.data.chunks(T::COUNT)) {
            if tests.len() == 1 {
                stack_abreast::<f64>(tests, data, &mut Default::default(), &mut all);
            } else {
                stack_abreast::<T>(tests, data, &mut room, &mut all);
            }
        }
        all
    }
}

/// As many tests as there are lanes, or fewer.
#[inline(always)]
fn stack_abreast<T: Lanes>(
    tests: &[&[StackPhase<'_>]],
    data: &[&[StackData<'_>]],
    (room, memory): &mut (Room<T>, Vec<T>),
    all: &mut Vec<Stacked>,
) {
    let phases = given::<T>(tests, Some(data));
    let mut array = phases[phases.len() - 1].last(std::mem::take(memory));
    let (mut residual, mut diagonals) = (T::splat(0.0), Vec::new());
    for pair in phases.windows(2).rev() {
        let (rest, diagonal) = pair[0].join(&pair[1], array, &mut residual, |_, _, _| {}, room);
        diagonals.push(diagonal);
        array = rest;
    }
    let count = tests.len();
    let mut left = [0.0; MOST];
    residual.store(&mut left);
    let is_regular = array.is_regular(UNINFORMED);
    let factors = apart(&array.packed(), count);
    let rest = links(&phases, count).into_iter().zip(half_log_determinants(&diagonals, count));
    for (((mut factor, (links, half_log_determinant)), data), mut residual) in
        factors.into_iter().zip(rest).zip(data).zip(left)
    {
        let mut d = factor.split_off(factor.len() - array.width);
        if !is_regular {
            let mut settled = Vec::new();
            settle_packed(&mut factor, array.width, &mut settled);
            settled.iter().for_each(|one| one.apply(&mut d, &mut residual));
        }
        all.push(Stacked { factor, links, constant: constant(data, half_log_determinant, residual), data: d });
    }
    *memory = array.entries;
}

/// The phases of tests of one shape.
#[inline(always)]
fn given<T: Lanes>(tests: &[&[StackPhase<'_>]], data: Option<&[&[StackData<'_>]]>) -> Vec<Given<T>> {
    let mut phases = Vec::with_capacity(tests[0].len());
    for at in 0..tests[0].len() {
        phases.push(Given::new(tests, data, at));
    }
    phases
}

/// Rounds directions without information to none.
fn settle_packed(factor: &mut [f64], width: usize, settled: &mut Vec<Settle>) {
    let mut entries = vec![0.0; width * width];
    let places = || (0..width).flat_map(|k| (0..=k).map(move |i| i * width + k));
    places().zip(&*factor).for_each(|(place, x)| entries[place] = *x);
    settle(&mut entries, width, settled);
    places().zip(factor).for_each(|(place, x)| *x = entries[place]);
}

/// G and C of each link of each test.
#[inline(always)]
fn links<T: Lanes>(phases: &[Given<T>], tests: usize) -> Vec<Vec<(DMatrix<f64>, DMatrix<f64>)>> {
    let mut all = vec![Vec::with_capacity(phases.len() - 1); tests];
    for phase in phases {
        if let Some(link) = &phase.link {
            for (own, pair) in all.iter_mut().zip(link.G.apart(tests).into_iter().zip(link.C.apart(tests))) {
                own.push(pair);
            }
        }
    }
    all
}

/// ½ Σ log|I + RCC'R'| of each test, from the diagonals of u's rows.
#[inline(always)]
fn half_log_determinants<T: Lanes>(diagonals: &[Vec<T>], tests: usize) -> Vec<f64> {
    let mut sums = vec![0.0; tests];
    for diagonal in diagonals {
        for (sum, diagonal) in sums.iter_mut().zip(apart(diagonal, tests)) {
            *sum += diagonal.iter().map(|x| x.ln()).sum::<f64>();
        }
    }
    sums
}

/// The constant of all phases together.
fn constant(phases: &[StackData<'_>], half_log_determinant: f64, residual: f64) -> f64 {
    phases.iter().map(|phase| phase.constant).sum::<f64>() - half_log_determinant - 0.5 * residual
}

impl Stacked {
    /// Stacks the phases of tests of one shape, each with its data: to the bits of [`Stack::new`] and [`Stack::data`].
    pub(crate) fn all(tests: &[&[StackPhase<'_>]], data: &[&[StackData<'_>]]) -> Vec<Stacked> {
        Isa::best().run(Abreast { tests, data })
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

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// A phase of a test: R packed, d, constant, and Ψ, C, T, g of the link that leads here.
    struct Own {
        factor: Vec<f64>,
        data: Vec<f64>,
        link: Option<([DMatrix<f64>; 3], DVector<f64>)>,
    }

    /// Random phases of given sizes (p, q, states before, columns of C); some numbers are zero, in some lanes whole rows.
    fn phases(sizes: &[(usize, usize, usize, usize)], random: &mut ChaCha8Rng) -> Vec<Own> {
        let sparse = random.random_bool(0.5);
        let number = |random: &mut ChaCha8Rng| {
            if sparse && random.random_bool(0.4) {
                0.0
            } else {
                random.random_range(-1.5..1.5) * 10f64.powi(random.random_range(-3..3))
            }
        };
        let mut before = 0;
        let mut all = Vec::new();
        for (at, &(_, q, n, u)) in sizes.iter().enumerate() {
            let mut factor = Vec::new();
            for k in 0..q {
                (0..k).for_each(|_| factor.push(number(random)));
                factor.push(number(random).abs());
            }
            let mut matrix = |rows: usize, columns: usize| DMatrix::from_fn(rows, columns, |_, _| number(random));
            let link = (at > 0).then(|| [matrix(n, before), matrix(n, u), matrix(q, n)]);
            let link = link.map(|link| (link, DVector::from_fn(q, |_, _| number(random))));
            let data = (0..q).map(|_| number(random)).collect();
            all.push(Own { factor, data, link });
            before = q;
        }
        all
    }

    fn design<'a>(phases: &'a [Own], sizes: &[(usize, usize, usize, usize)]) -> Vec<StackPhase<'a>> {
        let phase = |(own, size): (&'a Own, &(usize, usize, usize, usize))| StackPhase {
            own: size.0,
            factor: &own.factor,
            link: own.link.as_ref().map(|(link, _)| link.each_ref()),
        };
        phases.iter().zip(sizes).map(phase).collect()
    }

    fn told(phases: &[Own]) -> Vec<StackData<'_>> {
        let phase = |own| {
            let Own { data, link, .. }: &Own = own;
            StackData { constant: 0.25, data, mean: link.as_ref().map(|(_, mean)| mean) }
        };
        phases.iter().map(phase).collect()
    }

    fn bits(numbers: &[f64]) -> Vec<u64> {
        numbers.iter().map(|x| x.to_bits()).collect()
    }

    #[test]
    fn tests_side_by_side_are_stacked_to_the_bits_of_each_alone_and_of_its_rotations() {
        let shapes: [&[(usize, usize, usize, usize)]; 5] = [
            &[(2, 2, 0, 0), (2, 2, 2, 1)],
            &[(3, 3, 0, 0), (1, 4, 3, 3), (0, 2, 4, 0)],
            &[(0, 0, 0, 0), (2, 3, 1, 5)],
            &[(2, 2, 0, 0), (0, 0, 2, 2), (1, 1, 0, 0)],
            &[(6, 6, 0, 0), (6, 6, 6, 2), (6, 6, 6, 8)],
        ];
        let mut random = ChaCha8Rng::seed_from_u64(11);
        for sizes in shapes {
            for count in [1, 2, 4, 8, 11] {
                let tests: Vec<Vec<Own>> = (0..count).map(|_| phases(sizes, &mut random)).collect();
                let designs: Vec<Vec<StackPhase<'_>>> = tests.iter().map(|test| design(test, sizes)).collect();
                let data: Vec<Vec<StackData<'_>>> = tests.iter().map(|test| told(test)).collect();
                let designs: Vec<&[StackPhase<'_>]> = designs.iter().map(|design| &**design).collect();
                let data: Vec<&[StackData<'_>]> = data.iter().map(|data| &**data).collect();
                for isa in Isa::all() {
                    let found = isa.run(Abreast { tests: &designs, data: &data });
                    assert_eq!(found.len(), count);
                    for (lane, found) in found.iter().enumerate() {
                        let stack = Stack::new(&StackKey::new(designs[lane]));
                        let (constant, d) = stack.data(data[lane]);
                        let about = format!("{isa:?}, {sizes:?}, test {lane} of {count}");
                        assert_eq!(bits(&found.factor), bits(&stack.factor), "R: {about}");
                        assert_eq!(found.links, stack.links, "links: {about}");
                        assert_eq!(
                            found.constant.to_bits(),
                            constant.to_bits(),
                            "{about}: {} {constant}",
                            found.constant
                        );
                        assert_eq!(bits(&found.data), bits(&d), "d: {about}");
                    }
                }
            }
        }
    }

    #[test]
    fn stacked_rows_are_those_of_the_joint_law() {
        // log p(z | ξ) = constant - ½ ‖d - Rξ‖² against z_2 | ξ by hand: one state, one number a phase
        let (r, d, constant) = ([2.0, 3.0], [1.0, -0.5], 0.25);
        let (psi, root, transition, g) = (0.75, 0.5, 1.5, 0.125);
        let one = |x: f64| DMatrix::from_element(1, 1, x);
        let own = |at: usize, link| Own { factor: vec![r[at]], data: vec![d[at]], link };
        let link = ([one(psi), one(root), one(transition)], DVector::from_element(1, g));
        let test = vec![own(0, None), own(1, Some(link))];
        let sizes = [(1, 1, 0, 0), (1, 1, 1, 1)];
        let found = &Stacked::all(&[&design(&test, &sizes)], &[&told(&test)])[0];
        let spread: f64 = 1.0 + r[1] * r[1] * (transition * root) * (transition * root);
        for xi in [[0.0, 0.0], [1.0, -2.0], [0.3, 0.8]] {
            let first = d[0] - r[0] * xi[0];
            let second = d[1] - r[1] * (xi[1] + g + transition * psi * xi[0]);
            let expected = 2.0 * constant - 0.5 * (first * first + second * second / spread) - 0.5 * spread.ln();
            let rows = [
                found.data[0] - found.factor[0] * xi[0] - found.factor[1] * xi[1],
                found.data[1] - found.factor[2] * xi[1],
            ];
            let value = found.constant - 0.5 * (rows[0] * rows[0] + rows[1] * rows[1]);
            assert!((value - expected).abs() < 1e-13, "at {xi:?}: {value}, by hand {expected}");
        }
    }
}
