//! Sums over blocks of classes of several tests, with regressions, and with what the restricted likelihood wants, for any number of
//! states. The mean of test j is E_jm: m the p elements of μ, then the coefficients of the regressions, M in all.
#![expect(non_snake_case, reason = "W, E, V, X are the letters of the theory")]

use kalfit_lanes::{Isa, Kernel, Lanes};
use nalgebra::DMatrix;

use crate::estimate::lanes::any::Room;
use crate::estimate::lanes::gather::Gather;
use crate::estimate::lanes::layout::Layout;
use crate::estimate::lanes::rows::{add_one, at, log_det, sums};
use crate::estimate::order::{Order, Wanted};
use crate::estimate::point::Point;
use crate::linalg::symmetric::{pair, pairs};

/// One pass over some blocks.
pub(super) struct Pass<'a> {
    pub(super) blocks: &'a [f64],
    pub(super) layout: Layout,
    pub(super) point: &'a Point,
    /// F with Σ = FF', lower triangular.
    pub(super) root: &'a DMatrix<f64>,
    pub(super) wanted: Wanted<'a>,
    pub(super) isa: Isa,
}

/// Sums over tests. Matrices and triangles by rows.
#[derive(Debug, Clone)]
pub(crate) struct Totals {
    /// Σ log|S|.
    pub(crate) log_det: f64,
    /// Σ u'D⁻¹u.
    pub(crate) quadratic: f64,
    /// Σ E'r, M.
    pub(crate) score: Vec<f64>,
    /// Σ E'WE, M × M.
    pub(crate) information: Vec<f64>,
    /// Σ r r', a triangle.
    pub(crate) outer: Vec<f64>,
    /// Σ W ⊗ (r r' - ½W), where V is known Σ W ⊗ (r r' - ½W + WXVX'W), triangle × triangle, if it is wanted.
    pub(crate) curvature: Vec<f64>,
    /// Σ WE ⊗ r, pM × p, if it is wanted.
    pub(crate) cross: Vec<f64>,
    /// Σ W ⊗ W, triangle × triangle, if it is wanted.
    pub(crate) expected: Vec<f64>,
    /// Σ WX ⊗ WX, pq × pq, if it is wanted.
    pub(crate) spread: Vec<f64>,
}

impl Kernel for Pass<'_> {
    type Output = Totals;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Totals {
        let size = self.layout.size() * T::COUNT;
        let columns = if self.layout.several { 1 + self.layout.p } else { 1 };
        let mut room = Room::new(&self.point.mean, self.root, columns, T::COUNT);
        let mut sums = Sums::<T>::new(&self);
        for block in self.blocks.chunks_exact(size) {
            self.move_mean::<T>(block, &mut room);
            let root_det = room.evaluate::<T>(block);
            sums.add(block, &room, root_det);
        }
        sums.totals()
    }
}

impl Pass<'_> {
    /// Moves μ by the regressions.
    #[inline(always)]
    fn move_mean<T: Lanes>(&self, block: &[f64], room: &mut Room) {
        let regressors = self.wanted.regressors;
        for &element in regressors {
            T::splat(self.point.mean[element]).store(&mut room.mean[element * T::COUNT..]);
        }
        for (c, &element) in regressors.iter().enumerate() {
            let x = at::<T>(block, self.layout.covariates() + c);
            let mean = x.fma(T::splat(self.point.coefficients[c]), at(&room.mean, element));
            mean.store(&mut room.mean[element * T::COUNT..]);
        }
    }
}

/// Sums in lanes, and what one block says.
struct Sums<'a, T> {
    layout: Layout,
    wanted: Wanted<'a>,
    /// M and q.
    mean: usize,
    free: usize,
    log_det: f64,
    /// Π |S| = mantissa × 2^exponent, of classes of one test.
    mantissa: T,
    exponent: T,
    quadratic: T,
    score: Vec<f64>,
    information: Vec<f64>,
    outer: Vec<f64>,
    curvature: Gather,
    cross: Gather,
    expected: Gather,
    spread: Gather,
    /// WE of the block, p × M.
    WE: Vec<f64>,
    /// WX, p × q, and WXV.
    WX: Vec<f64>,
    WXV: Vec<f64>,
    /// n r r' and what the scatter adds to it, a triangle.
    moment: Vec<f64>,
}

impl<'a, T: Lanes> Sums<'a, T> {
    fn new(pass: &Pass<'a>) -> Self {
        let (wanted, p, isa) = (pass.wanted, pass.layout.p, pass.isa);
        let (m, s) = (p + wanted.regressors.len(), pairs(p));
        let q = wanted.flat.map_or(0, |flat| flat.jacobian.ncols());
        let zeros = |size: usize| vec![0.0; size * T::COUNT];
        let second = wanted.order >= Order::Second;
        Sums {
            layout: pass.layout,
            wanted,
            mean: m,
            free: q,
            log_det: 0.0,
            mantissa: T::splat(1.0),
            exponent: T::splat(0.0),
            quadratic: T::splat(0.0),
            score: zeros(m),
            information: zeros(m * m),
            outer: zeros(s),
            curvature: Gather::new(isa, (s, s), second),
            cross: Gather::new(isa, (p * m, p), second),
            expected: Gather::new(isa, (s, s), wanted.order >= Order::Expected),
            spread: Gather::new(isa, (p * q, p * q), q > 0),
            WE: zeros(p * m),
            WX: zeros(p * q),
            WXV: zeros(p * q),
            moment: zeros(s),
        }
    }

    #[inline(always)]
    fn add(&mut self, block: &[f64], room: &Room, root_det: (T, T)) {
        let count = if self.layout.several { at::<T>(block, self.layout.count()) } else { T::splat(1.0) };
        self.add_det(count, root_det);
        self.quadratic = count.fma(room.quadratic(0), self.quadratic);
        for column in 1..room.columns {
            self.quadratic = self.quadratic + room.quadratic(column);
        }
        self.weigh(block, room);
        self.add_mean(count, block, room);
        self.second_moment(count, room);
        add_one(&mut self.outer, T::splat(1.0), &self.moment);
        let uncertain = self.add_flat(count);
        if self.wanted.order >= Order::Second {
            self.add_second(count, room, uncertain);
        }
        if self.wanted.order >= Order::Expected {
            let (left, right) = self.expected.next();
            triangle::<T>(room, self.layout.p, T::splat(1.0), right);
            triangle::<T>(room, self.layout.p, count, left);
        }
    }

    #[inline(always)]
    fn add_det(&mut self, count: T, (mantissa, exponent): (T, T)) {
        if self.layout.several {
            for lane in 0..T::COUNT {
                let of_one = mantissa.lane(lane).ln() + exponent.lane(lane) * std::f64::consts::LN_2;
                self.log_det += count.lane(lane) * of_one;
            }
        } else {
            let (both, more) = (self.mantissa * mantissa).split();
            (self.mantissa, self.exponent) = (both, self.exponent + exponent + more);
        }
    }

    /// WE.
    #[inline(always)]
    fn weigh(&mut self, block: &[f64], room: &Room) {
        let (p, m, n) = (self.layout.p, self.mean, T::COUNT);
        for a in 0..p {
            let row = room.row::<T>(a);
            for b in 0..=a {
                let w = at::<T>(row, b);
                w.store(&mut self.WE[(a * m + b) * n..]);
                w.store(&mut self.WE[(b * m + a) * n..]);
            }
        }
        for (c, &element) in self.wanted.regressors.iter().enumerate() {
            let x = at::<T>(block, self.layout.covariates() + c);
            for row in self.WE.chunks_exact_mut(m * n) {
                (x * at(row, element)).store(&mut row[(p + c) * n..]);
            }
        }
    }

    /// n E'r and n E'WE.
    #[inline(always)]
    fn add_mean(&mut self, count: T, block: &[f64], room: &Room) {
        let (p, m, n) = (self.layout.p, self.mean, T::COUNT);
        let r = room.r::<T>();
        add_one(&mut self.score[..p * n], count, r);
        add_one(&mut self.information[..p * m * n], count, &self.WE);
        for (c, &element) in self.wanted.regressors.iter().enumerate() {
            let x = count * at::<T>(block, self.layout.covariates() + c);
            add_one(&mut self.score[(p + c) * n..][..n], x, &r[element * n..][..n]);
            add_one(&mut self.information[(p + c) * m * n..][..m * n], x, &self.WE[element * m * n..][..m * n]);
        }
    }

    /// n r r' and what the scatter adds to it.
    #[inline(always)]
    fn second_moment(&mut self, count: T, room: &Room) {
        self.moment.fill(0.0);
        for column in 0..room.columns {
            let r = room.r_of::<T>(column);
            let weight = if column == 0 { count } else { T::splat(1.0) };
            for a in 0..self.layout.p {
                let (start, size) = (pair(a, 0) * T::COUNT, (a + 1) * T::COUNT);
                add_one(&mut self.moment[start..start + size], weight * at(r, a), &r[..size]);
            }
        }
    }

    /// n WX ⊗ WX; says whether V is known, and leaves WX and WXV.
    #[inline(always)]
    fn add_flat(&mut self, count: T) -> bool {
        let Some(flat) = self.wanted.flat else { return false };
        let (m, q) = (self.mean, self.free);
        if q == 0 {
            return false;
        }
        times::<T>(&self.WE, m, flat.jacobian, &mut self.WX);
        let (left, right) = self.spread.next();
        right.copy_from_slice(&self.WX);
        scaled(count, &self.WX, left);
        let Some(covariance) = flat.covariance else { return false };
        times::<T>(&self.WX, q, covariance, &mut self.WXV);
        true
    }

    /// W ⊗ (n r r' - ½nW + n WXVX'W) and n WE ⊗ r.
    #[inline(always)]
    fn add_second(&mut self, count: T, room: &Room, uncertain: bool) {
        let (p, q, n) = (self.layout.p, self.free, T::COUNT);
        let (left, right) = self.curvature.next();
        triangle::<T>(room, p, T::splat(1.0), left);
        right.copy_from_slice(&self.moment);
        add_one(right, T::splat(-0.5) * count, left);
        if uncertain {
            for a in 0..p {
                let weighed = &self.WXV[a * q * n..][..q * n];
                for b in 0..=a {
                    let own = &self.WX[b * q * n..][..q * n];
                    let mut sum = T::splat(0.0);
                    for c in 0..q {
                        sum = at::<T>(weighed, c).fma(at(own, c), sum);
                    }
                    let to = &mut right[pair(a, b) * n..];
                    count.fma(sum, T::load(to)).store(to);
                }
            }
        }
        let (left, right) = self.cross.next();
        right.copy_from_slice(room.r::<T>());
        scaled(count, &self.WE, left);
    }

    #[inline(always)]
    fn totals(self) -> Totals {
        Totals {
            log_det: self.log_det + log_det(self.mantissa, self.exponent),
            quadratic: self.quadratic.sum(),
            score: sums::<T>(&self.score),
            information: sums::<T>(&self.information),
            outer: sums::<T>(&self.outer),
            curvature: self.curvature.total(),
            cross: self.cross.total(),
            expected: self.expected.total(),
            spread: self.spread.total(),
        }
    }
}

/// Scale × the lower triangle of W.
#[inline(always)]
fn triangle<T: Lanes>(room: &Room, p: usize, scale: T, to: &mut [f64]) {
    to.fill(0.0);
    for a in 0..p {
        add_one(&mut to[pair(a, 0) * T::COUNT..][..(a + 1) * T::COUNT], scale, room.row::<T>(a));
    }
}

/// Scale × the numbers.
#[inline(always)]
fn scaled<T: Lanes>(scale: T, numbers: &[f64], to: &mut [f64]) {
    let mut numbers = numbers.chunks_exact(T::COUNT);
    for to in to.chunks_exact_mut(T::COUNT) {
        let Some(x) = numbers.next() else { return };
        (scale * T::load(x)).store(to);
    }
}

/// A × B, A in lanes and as wide as B is high.
#[inline(always)]
fn times<T: Lanes>(A: &[f64], width: usize, B: &DMatrix<f64>, to: &mut [f64]) {
    let n = T::COUNT;
    let mut rows = A.chunks_exact(width * n);
    for to in to.chunks_exact_mut(B.ncols() * n) {
        let Some(from) = rows.next() else { return };
        for c in 0..B.ncols() {
            let mut sum = T::splat(0.0);
            for k in 0..width {
                sum = at::<T>(from, k).fma(T::splat(B[(k, c)]), sum);
            }
            sum.store(&mut to[c * n..]);
        }
    }
}
