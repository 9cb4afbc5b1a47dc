//! Sums over blocks of tests with one J each.
#![expect(non_snake_case, reason = "W is the letter of the theory")]

use kalfit_lanes::{Isa, Kernel, Lanes};
use nalgebra::DMatrix;

use crate::estimate::lanes::any::Room;
use crate::estimate::lanes::dense::{Law, Told, entries, told};
use crate::estimate::lanes::gather::Gather;
use crate::estimate::lanes::rows::{add_one, at, log_det, sums};
use crate::estimate::order::Order;

/// Most states whose sums of first derivatives are few enough for the registers.
const IN_REGISTERS: usize = 3;

/// One pass over some blocks.
pub(super) struct Pass<'a> {
    /// [`entries`] numbers in lanes for each block.
    pub(super) blocks: &'a [f64],
    pub(super) mean: &'a [f64],
    /// F with Σ = FF', lower triangular.
    pub(super) root: &'a DMatrix<f64>,
    pub(super) order: Order,
    pub(super) isa: Isa,
}

/// Sums over tests; triangles by rows, one number for (i, k), k ≤ i.
#[derive(Debug, Clone, Default)]
pub(crate) struct Totals {
    /// Σ log|S|.
    pub(crate) log_det: f64,
    /// Σ u'D⁻¹u.
    pub(crate) quadratic: f64,
    /// Σ r.
    pub(crate) r: Vec<f64>,
    /// Σ W, a triangle.
    pub(crate) W: Vec<f64>,
    /// Σ r r', a triangle.
    pub(crate) outer: Vec<f64>,
    /// Σ W ⊗ (r r' - ½W), triangle × triangle, if it is wanted.
    pub(crate) curvature: Vec<f64>,
    /// Σ W ⊗ r, triangle × p, if it is wanted.
    pub(crate) cross: Vec<f64>,
    /// Σ W ⊗ W, triangle × triangle, if it is wanted.
    pub(crate) expected: Vec<f64>,
}

impl Kernel for Pass<'_> {
    type Output = Totals;

    /// Few states by sizes that the compiler knows, so that all of a block stays in registers.
    #[inline(always)]
    fn run<T: Lanes>(self) -> Totals {
        match self.mean.len() {
            1 if T::OWN_SIZES >= 1 => self.sized::<T, 1>(),
            2 if T::OWN_SIZES >= 2 => self.sized::<T, 2>(),
            3 if T::OWN_SIZES >= 3 => self.sized::<T, 3>(),
            4 if T::OWN_SIZES >= 4 => self.sized::<T, 4>(),
            5 if T::OWN_SIZES >= 5 => self.sized::<T, 5>(),
            6 if T::OWN_SIZES >= 6 => self.sized::<T, 6>(),
            7 if T::OWN_SIZES >= 7 => self.sized::<T, 7>(),
            8 if T::OWN_SIZES >= 8 => self.sized::<T, 8>(),
            9 if T::OWN_SIZES >= 9 => self.sized::<T, 9>(),
            10 if T::OWN_SIZES >= 10 => self.sized::<T, 10>(),
            _ => self.any::<T>(),
        }
    }
}

impl Pass<'_> {
    #[inline(always)]
    fn sized<T: Lanes, const P: usize>(self) -> Totals {
        let law = self.law::<P>();
        if P <= IN_REGISTERS && self.order < Order::Second {
            return self.first::<T, P>(&law);
        }
        let mut products = Products::new(self.isa, P, self.order);
        let mut sums = Sums::<T, P>::new();
        for block in self.blocks.chunks_exact(entries(P) * T::COUNT) {
            let told = told::<T, P>(block, &law, &mut sums.det);
            sums.add(&told);
            if self.order >= Order::Second {
                products.take(
                    #[inline(always)]
                    |weights, inner, r| told.write(weights, inner, r),
                );
            }
        }
        products.into(sums.totals())
    }

    /// First derivatives alone. Nothing else is in the loop, so that the sums of few states stay in registers.
    #[inline(always)]
    fn first<T: Lanes, const P: usize>(self, law: &Law<P>) -> Totals {
        let mut sums = Sums::<T, P>::new();
        for block in self.blocks.chunks_exact(entries(P) * T::COUNT) {
            let told = told::<T, P>(block, law, &mut sums.det);
            sums.add(&told);
        }
        sums.totals()
    }

    #[inline(always)]
    fn any<T: Lanes>(self) -> Totals {
        let p = self.mean.len();
        let mut room = Room::new(self.mean, self.root, 1, T::COUNT);
        let mut products = Products::new(self.isa, p, self.order);
        let mut sums = AnySums::<T>::new(p);
        for block in self.blocks.chunks_exact(entries(p) * T::COUNT) {
            let root_det = room.evaluate::<T>(block);
            sums.add(&room, root_det);
            if self.order >= Order::Second {
                products.take(
                    #[inline(always)]
                    |weights, inner, r| write_any::<T>(&room, p, weights, inner, r),
                );
            }
        }
        products.into(sums.totals())
    }

    fn law<const P: usize>(&self) -> Law<P> {
        let mut law = Law { mean: [0.0; P], root: [[0.0; P]; P] };
        for i in 0..P {
            law.mean[i] = self.mean[i];
            for c in 0..=i {
                law.root[i][c] = self.root[(i, c)];
            }
        }
        law
    }
}

/// What second derivatives add up.
struct Products {
    p: usize,
    lanes: usize,
    /// W ⊗ [r r' - ½W, r].
    observed: Gather,
    /// W ⊗ W, if it is wanted.
    expected: Option<Gather>,
}

impl Products {
    fn new(isa: Isa, p: usize, order: Order) -> Products {
        let s = p * (p + 1) / 2;
        let observed = Gather::new(isa, (s, s + p), order >= Order::Second);
        let expected = (order >= Order::Expected).then(|| Gather::new(isa, (s, s), true));
        Products { p, lanes: isa.lanes(), observed, expected }
    }

    /// Takes in W, r r' - ½W and r of a block, which `write` puts there.
    #[inline(always)]
    fn take(&mut self, write: impl FnOnce(&mut [f64], &mut [f64], &mut [f64])) {
        let (weights, right) = self.observed.next();
        let (inner, r) = right.split_at_mut(right.len() - self.p * self.lanes);
        write(weights, inner, r);
        if let Some(expected) = &mut self.expected {
            let (left, right) = expected.next();
            left.copy_from_slice(weights);
            right.copy_from_slice(weights);
        }
    }

    fn into(self, totals: Totals) -> Totals {
        let s = self.p * (self.p + 1) / 2;
        let (mut curvature, mut cross) = (self.observed.total(), Vec::new());
        // in place: of many states there is no room for a second one
        let rows = curvature.len() / (s + self.p).max(1);
        for row in 0..rows {
            let start = row * (s + self.p);
            cross.extend_from_slice(&curvature[start + s..][..self.p]);
            curvature.copy_within(start..start + s, row * s);
        }
        curvature.truncate(rows * s);
        Totals { curvature, cross, expected: self.expected.map(Gather::total).unwrap_or_default(), ..totals }
    }
}

impl<T: Lanes, const P: usize> Told<T, P> {
    /// W, r r' - ½W and r.
    #[inline(always)]
    fn write(&self, weights: &mut [f64], inner: &mut [f64], r: &mut [f64]) {
        let half = T::splat(0.5);
        let mut at = 0;
        for a in 0..P {
            self.r[a].store(&mut r[a * T::COUNT..]);
            for b in 0..=a {
                self.W[a][b].store(&mut weights[at..]);
                self.r[a].fma(self.r[b], -(half * self.W[a][b])).store(&mut inner[at..]);
                at += T::COUNT;
            }
        }
    }
}

/// The same of any number of states.
#[inline(always)]
fn write_any<T: Lanes>(room: &Room, p: usize, weights: &mut [f64], inner: &mut [f64], r: &mut [f64]) {
    r.copy_from_slice(room.r::<T>());
    weights.fill(0.0);
    inner.fill(0.0);
    let mut start = 0;
    for a in 0..p {
        let (row, size) = (room.row::<T>(a), (a + 1) * T::COUNT);
        weights[start..start + size].copy_from_slice(row);
        let inner = &mut inner[start..start + size];
        add_one(inner, T::splat(-0.5), row);
        add_one(inner, at::<T>(r, a), &r[..size]);
        start += size;
    }
}

/// Sums in lanes, of any number of states.
struct AnySums<T> {
    p: usize,
    /// Π |S| = mantissa × 2^exponent.
    mantissa: T,
    exponent: T,
    /// Σ of the lower triangle of [W r; r' u'D⁻¹u] and of what is above it, (p + 1) × (p + 1).
    W: Vec<f64>,
    /// The lower triangle of Σ r r'.
    outer: Vec<f64>,
}

impl<T: Lanes> AnySums<T> {
    #[inline(always)]
    fn new(p: usize) -> Self {
        let zeros = |size: usize| vec![0.0; size * T::COUNT];
        let (mantissa, exponent) = (T::splat(1.0), T::splat(0.0));
        AnySums { p, mantissa, exponent, W: zeros((p + 1) * (p + 1)), outer: zeros(p * (p + 1) / 2) }
    }

    #[inline(always)]
    fn add(&mut self, room: &Room, (mantissa, exponent): (T, T)) {
        let (both, more) = (self.mantissa * mantissa).split();
        (self.mantissa, self.exponent) = (both, self.exponent + exponent + more);
        add_one(&mut self.W, T::splat(1.0), &room.W);
        let r = room.r::<T>();
        let mut start = 0;
        for a in 0..self.p {
            let size = (a + 1) * T::COUNT;
            add_one(&mut self.outer[start..start + size], at::<T>(r, a), &r[..size]);
            start += size;
        }
    }

    #[inline(always)]
    fn totals(&self) -> Totals {
        let (p, n) = (self.p, T::COUNT);
        let row = |a: usize, size: usize| sums::<T>(&self.W[a * (p + 1) * n..][..size * n]);
        Totals {
            log_det: log_det(self.mantissa, self.exponent),
            quadratic: row(p, p + 1)[p],
            r: row(p, p),
            W: (0..p).flat_map(|a| row(a, a + 1)).collect(),
            outer: sums::<T>(&self.outer),
            ..Totals::default()
        }
    }
}

/// Sums in lanes, of a number of states that the compiler knows.
struct Sums<T, const P: usize> {
    /// Π |S| = mantissa × 2^exponent.
    det: (T, T),
    quadratic: T,
    r: [T; P],
    W: [[T; P]; P],
    outer: [[T; P]; P],
}

impl<T: Lanes, const P: usize> Sums<T, P> {
    #[inline(always)]
    fn new() -> Self {
        let zero = T::splat(0.0);
        let square = [[zero; P]; P];
        Sums { det: (T::splat(1.0), zero), quadratic: zero, r: [zero; P], W: square, outer: square }
    }

    #[inline(always)]
    fn add(&mut self, told: &Told<T, P>) {
        self.quadratic = self.quadratic + told.quadratic;
        for a in 0..P {
            self.r[a] = self.r[a] + told.r[a];
            for b in 0..=a {
                self.W[a][b] = self.W[a][b] + told.W[a][b];
                self.outer[a][b] = told.r[a].fma(told.r[b], self.outer[a][b]);
            }
        }
    }

    #[inline(always)]
    fn totals(&self) -> Totals {
        let (mut r, mut W, mut outer) = (Vec::new(), Vec::new(), Vec::new());
        for a in 0..P {
            r.push(self.r[a].sum());
            for b in 0..=a {
                W.push(self.W[a][b].sum());
                outer.push(self.outer[a][b].sum());
            }
        }
        Totals {
            log_det: log_det(self.det.0, self.det.1),
            quadratic: self.quadratic.sum(),
            r,
            W,
            outer,
            ..Totals::default()
        }
    }
}
