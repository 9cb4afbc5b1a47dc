//! First and second derivatives of λ + log|M| and of -2ℓ_R by θ, through the levels of each unit (14.3).
//!
//! Second derivatives K_ab enter everything that follows linearly. So one pass up carries K and K_a, and one pass down
//! carries Y, the derivative by W: each level adds what its own map bends, as traces, and no K_ab of Σ is formed.

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::small_sample::forest::{Forest, Leaf};
use crate::small_sample::level::{LevelMap, symmetrised, with_transpose};
use crate::small_sample::theta::Theta;
use kalfit_algebra::symmetric::pair;

/// Number of unit classes that one thread sums at a time.
const UNITS_PER_TASK: usize = 32;

/// Units under a law of ξ.
pub(super) struct Pass<'a> {
    pub(super) forest: &'a Forest,
    pub(super) theta: &'a Theta,
    /// F of the Σ = FF' of each level, p × p, the level of the tests first, and of all effects of crossed factors.
    roots: &'a [DMatrix<f64>],
    /// All units together, before the map of the effects of crossed factors; without the columns of the states.
    crossed: Option<Evaluated<'a>>,
}

/// A test or a group at the law, before the map of its level.
struct Evaluated<'a> {
    map: LevelMap,
    /// K_a of the parameters below the level.
    slopes: Vec<DMatrix<f64>>,
    /// W_a of these and of the parameters of the level.
    mapped: Vec<DMatrix<f64>>,
    members: Vec<(Evaluated<'a>, f64)>,
    leaf: Option<&'a Leaf>,
    level: usize,
}

/// K and K_a, summed over all units.
pub(super) struct Totals {
    pub(super) k: DMatrix<f64>,
    pub(super) slopes: Vec<DMatrix<f64>>,
}

impl<'a> Pass<'a> {
    /// The units under the law with these roots; `None` where numbers are not finite.
    pub(super) fn of(forest: &'a Forest, theta: &'a Theta, roots: &'a [DMatrix<f64>]) -> Option<Pass<'a>> {
        let mut pass = Pass { forest, theta, roots, crossed: None };
        if forest.crossed > 0 {
            let of_units = pass.totals()?;
            let slopes = of_units.slopes[..theta.first(pass.factors())].iter().map(|slope| pass.below_states(slope));
            let (k, slopes) = (pass.below_states(&of_units.k), slopes.collect());
            pass.crossed = Some(pass.mapped(pass.factors(), &k, slopes)?);
        }
        Some(pass)
    }

    /// The level of all crossed factors, after those of the units.
    fn factors(&self) -> usize {
        self.forest.levels.len() + 1
    }

    /// Row of the first coordinate of the mean in the sums over all units.
    pub(super) fn first_mean(&self) -> usize {
        if self.crossed.is_some() { self.forest.crossed } else { self.roots[0].nrows() }
    }

    /// Width of the sums over all units.
    pub(super) fn width(&self) -> usize {
        self.crossed.as_ref().map_or(self.forest.width(), |class| class.map.w.nrows())
    }

    /// A matrix without the rows and columns of the states of a test.
    fn below_states(&self, k: &DMatrix<f64>) -> DMatrix<f64> {
        let p = self.roots[0].nrows();
        k.view_range(p.., p..).into_owned()
    }

    /// A matrix with zeros for the states of a test before it.
    fn with_states(&self, y: &DMatrix<f64>) -> DMatrix<f64> {
        let (p, n) = (self.roots[0].nrows(), y.nrows());
        let mut all = DMatrix::zeros(p + n, p + n);
        all.view_mut((p, p), (n, n)).copy_from(y);
        all
    }

    /// K and K_a over all units, with the effects of crossed factors integrated out; `None` where numbers are not finite.
    pub(super) fn totals(&self) -> Option<Totals> {
        if let Some(class) = &self.crossed {
            return Some(Totals { k: class.map.w.clone(), slopes: class.mapped.clone() });
        }
        let (width, n) = (self.forest.width(), self.theta.len());
        let zero = || Totals { k: DMatrix::zeros(width, width), slopes: vec![DMatrix::zeros(width, width); n] };
        self.over_units(&zero, &|totals: &mut Totals, unit, count| {
            let unit = self.evaluated(self.forest.levels.len(), unit)?;
            totals.k += &unit.map.w * count;
            totals.slopes.iter_mut().zip(&unit.mapped).for_each(|(sum, own)| *sum += own * count);
            Some(())
        })
        .map(|parts| {
            parts.into_iter().fold(zero(), |mut sum, part| {
                sum.k += part.k;
                sum.slopes.iter_mut().zip(part.slopes).for_each(|(sum, own)| *sum += own);
                sum
            })
        })
    }

    /// ∂²(λ + tr(YW))/∂θ_a∂θ_b over all units with Y constant, W the bordered matrix of a unit; θ × θ.
    pub(super) fn curvature(&self, y: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let n = self.theta.len();
        let mut whole = DMatrix::zeros(n, n);
        let mut of_units = y.clone();
        if let Some(class) = &self.crossed {
            self.add_curvature(class, y, 1.0, &mut whole);
            of_units = self.with_states(&class.map.adjoint(y));
        }
        let parts = self.over_units(&|| DMatrix::zeros(n, n), &|sum: &mut DMatrix<f64>, unit, count| {
            self.add_curvature(&self.evaluated(self.forest.levels.len(), unit)?, &of_units, count, sum);
            Some(())
        })?;
        whole = parts.into_iter().fold(whole, |sum, part| sum + part);
        whole.fill_upper_triangle_with_lower_triangle();
        Some(whole)
    }

    /// Σ_ab V_ab K_ab over all units.
    pub(super) fn contracted(&self, v: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let width = self.forest.width();
        let zero = || DMatrix::zeros(width, width);
        let parts = self.over_units(&zero, &|sum: &mut DMatrix<f64>, unit, count| {
            *sum += self.bent(&self.evaluated(self.forest.levels.len(), unit)?, v) * count;
            Some(())
        })?;
        let whole = parts.into_iter().fold(zero(), |sum, part| sum + part);
        Some(match &self.crossed {
            Some(class) => self.bent_by_map(class, v, self.below_states(&whole)),
            None => whole,
        })
    }

    /// Parts of a sum over the classes of units, divided in the same way for any number of threads.
    fn over_units<T: Send>(
        &self,
        zero: &(dyn Fn() -> T + Sync),
        add: &(dyn Fn(&mut T, usize, f64) -> Option<()> + Sync),
    ) -> Option<Vec<T>> {
        let part = |units: &[(usize, usize)]| {
            let mut sum = zero();
            units.iter().try_for_each(|&(unit, count)| add(&mut sum, unit, count as f64))?;
            Some(sum)
        };
        self.forest.units.par_chunks(UNITS_PER_TASK).map(part).collect()
    }

    /// A class of level `level`, tests being level 0.
    fn evaluated(&self, level: usize, class: usize) -> Option<Evaluated<'a>> {
        let first = self.theta.first(level);
        let (members, leaf, k, slopes) = if level == 0 {
            let leaf = &self.forest.leaves[class];
            (Vec::new(), Some(leaf), leaf.k.clone(), leaf.slopes.clone())
        } else {
            let width = self.forest.width();
            let (mut k, mut slopes) = (DMatrix::zeros(width, width), vec![DMatrix::zeros(width, width); first]);
            let mut members = Vec::new();
            for &(member, count) in &self.forest.levels[level - 1][class] {
                let (mut member, count) = (self.evaluated(level - 1, member)?, count as f64);
                k += &member.map.w * count;
                let mapped = std::mem::take(&mut member.mapped);
                slopes.iter_mut().zip(mapped).for_each(|(sum, own)| *sum += own * count);
                members.push((member, count));
            }
            (members, None, k, slopes)
        };
        Some(Evaluated { members, leaf, ..self.mapped(level, &k, slopes)? })
    }

    /// K and K_a through the map of a level.
    fn mapped(&self, level: usize, k: &DMatrix<f64>, slopes: Vec<DMatrix<f64>>) -> Option<Evaluated<'a>> {
        let map = LevelMap::of(k, &self.roots[level])?;
        let mut mapped: Vec<DMatrix<f64>> = slopes.iter().map(|slope| map.turned(slope)).collect();
        mapped.extend(self.theta.levels[level].iter().map(|element| -element.within(&map.w)));
        Some(Evaluated { map, slopes, mapped, members: Vec::new(), leaf: None, level })
    }

    /// Adds the second derivatives of a class to the lower triangle of `sum`; `y` is the derivative by W of the class.
    fn add_curvature(&self, class: &Evaluated<'_>, y: &DMatrix<f64>, count: f64, sum: &mut DMatrix<f64>) {
        let LevelMap { w, p, .. } = &class.map;
        let (first, own) = (self.theta.first(class.level), &self.theta.levels[class.level]);
        let down = class.map.adjoint(y);
        let states = p.nrows();
        // below, below: -tr((P + 2B'YB)K_aPK_b)
        let mut outer = &down * 2.0;
        outer.view_mut((0, 0), (states, states)).zip_apply(p, |x, own| *x -= own);
        for (a, slope) in class.slopes.iter().enumerate() {
            let left = (&outer * slope).columns(0, states) * p; // width × p
            for (b, other) in class.slopes[..=a].iter().enumerate() {
                sum[(a, b)] -= count * left.dot(&other.columns(0, states));
            }
        }
        // below, own: tr(S_b(V_a - WYV_a - V_aYW));  own, own: -tr(S_aWS_bW) + tr(S_aWS_bG) + tr(S_aGS_bW), G = WYW
        let turned = w * y;
        for (a, slope) in class.slopes.iter().enumerate() {
            let v = class.map.turned(slope);
            let bent = &v - with_transpose(&(&turned * &v));
            own.iter().enumerate().for_each(|(b, element)| sum[(first + b, a)] += count * element.trace(&bent));
        }
        let g = symmetrised(&(turned * w));
        let rest = &g - w;
        for (a, element) in own.iter().enumerate() {
            for (b, other) in own[..=a].iter().enumerate() {
                let found = element.trace_with(w, other, &rest) + element.trace_with(&g, other, w);
                sum[(first + a, first + b)] += count * found;
            }
        }
        if let Some(leaf) = class.leaf {
            for a in 0..self.theta.noises {
                for b in 0..=a {
                    let k = pair(a, b);
                    sum[(a, b)] += count * (leaf.log_curvatures[k] + down.dot(&leaf.curvatures[k]));
                }
            }
        }
        class.members.iter().for_each(|(member, times)| self.add_curvature(member, &down, count * times, sum));
    }

    /// Σ_ab V_ab W_ab of a class.
    fn bent(&self, class: &Evaluated<'_>, v: &DMatrix<f64>) -> DMatrix<f64> {
        let width = class.map.w.nrows();
        let mut k = DMatrix::zeros(width, width);
        for (member, count) in &class.members {
            k += self.bent(member, v) * *count;
        }
        if let Some(leaf) = class.leaf {
            for (a, b) in (0..self.theta.noises).flat_map(|a| (0..self.theta.noises).map(move |b| (a, b))) {
                k += &leaf.curvatures[pair(a, b)] * v[(a, b)];
            }
        }
        self.bent_by_map(class, v, k)
    }

    /// Σ_ab V_ab W_ab of a class from `k` = Σ_ab V_ab K_ab.
    fn bent_by_map(&self, class: &Evaluated<'_>, v: &DMatrix<f64>, mut k: DMatrix<f64>) -> DMatrix<f64> {
        let LevelMap { w, p, .. } = &class.map;
        let (first, own) = (self.theta.first(class.level), &self.theta.levels[class.level]);
        let (width, states) = (w.nrows(), p.nrows());
        let mut crossed = DMatrix::zeros(width, width); // Σ_a V_a (Σ_b V_ab S_b) W
        for (a, slope) in class.slopes.iter().enumerate() {
            let mut along = DMatrix::zeros(width, width);
            class.slopes.iter().enumerate().for_each(|(b, other)| along += other * v[(a, b)]);
            k -= with_transpose(&(slope.columns(0, states) * p * along.rows(0, states)));
            let mut step = DMatrix::zeros(states, states);
            own.iter().enumerate().for_each(|(b, element)| element.add_to(v[(a, first + b)], &mut step));
            crossed += class.map.turned(slope).columns(0, states) * step * w.rows(0, states);
        }
        let mut inner = DMatrix::zeros(states, states); // Σ_ab V_ab S_a W S_b
        for (a, element) in own.iter().enumerate() {
            let mut step = DMatrix::zeros(states, states);
            own.iter().enumerate().for_each(|(b, other)| other.add_to(v[(first + a, first + b)], &mut step));
            let mut single = DMatrix::zeros(states, states);
            element.add_to(1.0, &mut single);
            inner += single * w.view((0, 0), (states, states)) * step;
        }
        let inner = w.columns(0, states) * inner * w.rows(0, states);
        class.map.turned(&k) - with_transpose(&crossed) * 2.0 + with_transpose(&inner)
    }
}
