//! What tests in phases that share all matrices say at a point (theory §7).
//!
//! With σ_{i+1} = Eξ_{i+1} + G σ_i + w, E = [I; 0], and each phase's log p(z_i | σ_i) = constant - ½ ‖d_i - R_i σ_i‖², backwards
//! from the last phase, where R̃ = R, d̃ = d:
//!
//! ```text
//! S = I + R̃_{i+1} (EΣE' + CC') R̃_{i+1}' = U'U
//! [R̃_i d̃_i] = what QR leaves of [R_i d_i] above U⁻ᵀ[R̃_{i+1}G  d̃_{i+1} - R̃_{i+1}Eμ]
//! ```
//!
//! log|U| and the residual of the QR are what ℓ loses there. Forwards, with the root B_i and the mean m_i⁻ of the prior of σ_i given
//! the phases before it, C_i a root of (P⁻⁻¹ + J_i)⁻¹ = B_i(I + B_i'J_iB_i)⁻¹B_i':
//!
//! ```text
//! m_i = m_i⁻ + C_iC_i'R_i'(d_i - R_i m_i⁻)      m_{i+1}⁻ = Eμ + G m_i      B_{i+1} = [EF | G C_i | C]
//! ```
//!
//! R̃_i, d̃_i say what this phase and all later ones know of σ_i, B_i and m_i⁻ what the earlier ones do, so with S = I + R̃BB'R̃'
//! the formulas of one phase hold: r_i = R̃'S⁻¹(d̃ - R̃m⁻) and N_i = R̃'S⁻¹R̃. The blocks of W are W_ii = E'N_iE and W_ki =
//! E'N_k F_{k-1}…F_i E, F_i = G_i(I - C_iC_i'J_i). No inverse of P⁻, Σ or J occurs; the cost is linear in the number of phases but for
//! the blocks of W between phases.
#![expect(non_snake_case, reason = "B, C, R, F, N are the letters of the theory")]

use nalgebra::DMatrix;

use crate::estimate::chained::{Chained, Link, Phase};
use crate::linalg::rows::{Factors, Rows};
use kalfit_lanes::Real;

/// Where phases meet a point: F with Σ = FF', and μ, both of all phases.
pub(super) struct Prior<'a, T> {
    pub(super) root: &'a DMatrix<f64>,
    pub(super) mean: &'a [T],
}

/// How much of what a class says is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Detail {
    /// r, and W within phases.
    Phases,
    /// And W between phases.
    Between,
    /// r, W within phases, and what posteriors need.
    Posterior,
}

/// What a class says at a point. Matrices by rows.
#[derive(Debug, Clone)]
pub(crate) struct Said<T = f64> {
    /// Σ_j of the quadratic forms.
    pub(crate) quadratic: T,
    /// |I + RΣR'| of a test is the square of the first times 2 to the second.
    pub(crate) root_det: (T, T),
    /// By phase r of the mean and of the columns of the scatter, p × columns.
    pub(crate) r: Vec<Rows<T>>,
    /// W_ki for k ≥ i, at k(k+1)/2 + i, p_k × p_i; without the blocks between phases if those were not asked for.
    pub(crate) W: Vec<Option<Rows<T>>>,
    /// Var[ξ_i | z] by phase, p_i × p_i, where it is asked for.
    pub(crate) covariances: Vec<Rows<T>>,
    /// What log|S| of the links alone is, as `root_det`: what ℓ at Σ = 0 loses to the noise between the phases; where it is asked for.
    pub(crate) link_root_det: (T, T),
}

/// What the later phases and a phase itself know of its σ.
struct Known<T> {
    /// R̃.
    factor: Rows<T>,
    /// d̃.
    data: Rows<T>,
}

/// Beyond this RΣR' is too large for cross products.
const LARGE: f64 = 1e10;

impl<T: Real> Chained<T> {
    /// All that the class says; `None` where the arithmetic would lose digits.
    #[inline(always)]
    pub(super) fn said<A: Factors<Number = T>>(&self, prior: &Prior<'_, T>, detail: Detail) -> Option<Said<T>> {
        let mut root_det = RootDet::new();
        let (known, mut quadratic) = self.backward::<A>(prior, &mut root_det)?;
        let (mut r, mut N, mut carried, mut covariances) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let first = &self.phases[0];
        let mut rest = Rows::zeros(0, first.factor.nrows());
        let (mut B, mut m) = (prior.root_of(first), self.prior_mean(prior, first));
        for (i, (phase, known)) in self.phases.iter().zip(&known).enumerate() {
            let upper = spread::<A>(&B, &known.factor)?;
            let u = Rows::solved_below(&upper, known.data.clone().less(&known.factor.times(&m)));
            let Y = Rows::solved_below(&upper, known.factor.clone());
            if i == 0 {
                root_det.add(&upper);
                quadratic = quadratic + self.squares(&u);
            }
            r.push(Y.transpose_times(&u).first_rows(phase.own.len()));
            N.push(Y.transpose_times(&Y));
            if detail == Detail::Posterior {
                covariances.push(posterior_covariance::<A>(prior, phase, &rest, known)?);
            }
            let Some(next) = self.phases.get(i + 1) else { continue };
            let link = next.link.as_ref().expect("later phases have links");
            let step = Update::new::<A>(phase, &B)?;
            m = link.sensitivity.times(&step.mean(phase, m)).plus(&self.prior_mean(prior, next));
            if detail == Detail::Between {
                carried.push(link.sensitivity.times(&step.left(phase)));
            }
            let mut rows = prior.root_of(next);
            rest = link.carried(&step);
            rows.append(&rest);
            B = compressed::<A>(rows);
        }
        let W = self.blocks(&N, &carried, detail == Detail::Between);
        let link_root_det = match detail {
            Detail::Posterior => self.link_root_det::<A>()?.parts(),
            _ => RootDet::new().parts(),
        };
        Some(Said { quadratic, root_det: root_det.parts(), r, W, covariances, link_root_det })
    }

    /// |S| of the links alone.
    #[inline(always)]
    fn link_root_det<A: Factors<Number = T>>(&self) -> Option<RootDet<T>> {
        let states = self.phases.iter().map(|phase| phase.own.end).max().unwrap_or(0);
        let (root, mean) = (DMatrix::zeros(states, states), vec![T::splat(0.0); states]);
        let mut root_det = RootDet::new();
        self.backward::<A>(&Prior { root: &root, mean: &mean }, &mut root_det)?;
        Some(root_det)
    }

    /// R̃_i and d̃_i of each phase, and what ℓ loses to residuals.
    #[inline(always)]
    fn backward<A: Factors<Number = T>>(
        &self,
        prior: &Prior<'_, T>,
        root_det: &mut RootDet<T>,
    ) -> Option<(Vec<Known<T>>, T)> {
        let mut lost = T::splat(0.0);
        let mut all: Vec<Known<T>> = Vec::with_capacity(self.phases.len());
        for (i, phase) in self.phases.iter().enumerate().rev() {
            let q = phase.factor.nrows();
            let (Some(later), Some(next)) = (all.last(), self.phases.get(i + 1)) else {
                all.push(Known { factor: phase.factor.clone(), data: phase.data.clone() });
                continue;
            };
            let link = next.link.as_ref().expect("later phases have links");
            let mut root = prior.root_of(next);
            root.append(&link.root);
            let spread = spread::<A>(&root, &later.factor)?;
            root_det.add(&spread);
            let residual = later.data.clone().less(&later.factor.times(&self.prior_mean(prior, next)));
            let told = later.factor.times(&link.sensitivity).beside(&residual);
            let mut upper = phase.factor.beside(&phase.data);
            let left = A::absorb(&mut upper, Rows::solved_below(&spread, told), q);
            lost = lost + self.squares(&left.last_columns(self.columns));
            all.push(Known { factor: upper.first_columns(q), data: upper.last_columns(self.columns) });
        }
        all.reverse();
        Some((all, lost))
    }

    /// Eμ for the mean of the tests; the columns of the scatter have none.
    #[inline(always)]
    fn prior_mean(&self, prior: &Prior<'_, T>, phase: &Phase<T>) -> Rows<T> {
        let mut mean = Rows::zeros(phase.factor.nrows(), self.columns);
        for (i, own) in phase.own.clone().enumerate() {
            mean[(i, 0)] = prior.mean[own];
        }
        mean
    }

    /// Sum of squares over the tests.
    #[inline(always)]
    fn squares(&self, u: &Rows<T>) -> T {
        let mut sum = T::splat(0.0);
        for i in 0..u.nrows() {
            for (k, &x) in u.row(i).iter().enumerate() {
                sum = if k == 0 { (self.count * x).fma(x, sum) } else { x.fma(x, sum) };
            }
        }
        sum
    }

    /// W_ki = E'N_k F_{k-1}…F_i E.
    #[inline(always)]
    fn blocks(&self, N: &[Rows<T>], carried: &[Rows<T>], between: bool) -> Vec<Option<Rows<T>>> {
        let mut blocks = Vec::new();
        for k in 0..self.phases.len() {
            let p = self.phases[k].own.len();
            let mut row = N[k].first_rows(p);
            let mut own = vec![Some(row.first_columns(p))];
            for i in (0..k).rev() {
                if between {
                    row = row.times(&carried[i]);
                    own.push(Some(row.first_columns(self.phases[i].own.len())));
                } else {
                    own.push(None);
                }
            }
            blocks.extend(own.into_iter().rev());
        }
        blocks
    }
}

impl<T: Real> Link<T> {
    /// A root, by rows, of the covariance of what the next phase inherits.
    #[inline(always)]
    fn carried(&self, step: &Update<T>) -> Rows<T> {
        let mut rows = step.root.times_transpose(&self.sensitivity);
        rows.append(&self.root);
        rows
    }
}

impl<T: Real> Prior<'_, T> {
    /// (EF)' of a phase: p × q.
    #[inline(always)]
    fn root_of(&self, phase: &Phase<T>) -> Rows<T> {
        let (start, p) = (phase.own.start, phase.own.len());
        let mut rows = Rows::zeros(p, phase.factor.nrows());
        for c in 0..p {
            for i in 0..p {
                rows[(c, i)] = T::splat(self.root[(start + i, start + c)]);
            }
        }
        rows
    }
}

/// The posterior of σ_i given this phase and the earlier ones.
struct Update<T> {
    /// C', by rows.
    root: Rows<T>,
    /// C'R'.
    seen: Rows<T>,
}

impl<T: Real> Update<T> {
    #[inline(always)]
    fn new<A: Factors<Number = T>>(phase: &Phase<T>, B: &Rows<T>) -> Option<Update<T>> {
        let root = posterior_root::<A>(B, &phase.factor)?;
        let seen = root.times_transpose(&phase.factor);
        Some(Update { root, seen })
    }

    /// m = m⁻ + CC'R'(d - Rm⁻).
    #[inline(always)]
    fn mean(&self, phase: &Phase<T>, prior: Rows<T>) -> Rows<T> {
        let residual = phase.data.clone().less(&phase.factor.times(&prior));
        prior.plus(&self.root.transpose_times(&self.seen.times(&residual)))
    }

    /// I - CC'J.
    #[inline(always)]
    fn left(&self, phase: &Phase<T>) -> Rows<T> {
        let taken = self.root.transpose_times(&self.seen.times(&phase.factor));
        Rows::identity(phase.factor.nrows()).less(&taken)
    }
}

/// Var[ξ_i | z]: with N° the information that all else gives on ξ_i, F(I + F'N°F)⁻¹F'. `rest` is a root of the prior of σ_i but for
/// its own ξ_i, by rows.
#[inline(always)]
fn posterior_covariance<A: Factors>(
    prior: &Prior<'_, A::Number>,
    phase: &Phase<A::Number>,
    rest: &Rows<A::Number>,
    known: &Known<A::Number>,
) -> Option<Rows<A::Number>> {
    let p = phase.own.len();
    let seen = Rows::solved_below(&spread::<A>(rest, &known.factor)?, known.factor.first_columns(p));
    let half = posterior_root::<A>(&prior.root_of(phase).first_columns(p), &seen)?;
    Some(half.transpose_times(&half))
}

/// U with U'U = I + R BB' R', B' given by rows.
#[inline(always)]
fn spread<A: Factors>(root: &Rows<A::Number>, factor: &Rows<A::Number>) -> Option<Rows<A::Number>> {
    borne::<A>(&root.times_transpose(factor))
}

/// C' with CC' = B(I + B'JB)⁻¹B', J = R'R; B' by rows.
#[inline(always)]
fn posterior_root<A: Factors>(B: &Rows<A::Number>, factor: &Rows<A::Number>) -> Option<Rows<A::Number>> {
    let upper = borne::<A>(&factor.times_transpose(B))?;
    Some(Rows::solved_below(&upper, B.clone()))
}

/// U with U'U = I + rows'rows; `None` where cross products would lose digits.
#[inline(always)]
fn borne<A: Factors>(rows: &Rows<A::Number>) -> Option<Rows<A::Number>> {
    if A::CAREFUL || rows.is_within(LARGE.sqrt()) { Some(A::identity_plus(rows)) } else { None }
}

/// Upper triangular R with R'R = rows'rows; no more rows than columns.
#[inline(always)]
pub(super) fn compressed<A: Factors>(rows: Rows<A::Number>) -> Rows<A::Number> {
    let q = rows.ncols();
    let mut upper = Rows::zeros(q, q);
    A::absorb(&mut upper, rows, q);
    upper
}

/// |U|, as a product.
struct RootDet<T> {
    mantissa: T,
    exponent: T,
}

impl<T: Real> RootDet<T> {
    #[inline(always)]
    fn new() -> RootDet<T> {
        RootDet { mantissa: T::splat(1.0), exponent: T::splat(0.0) }
    }

    #[inline(always)]
    fn parts(&self) -> (T, T) {
        (self.mantissa, self.exponent)
    }

    #[inline(always)]
    fn add(&mut self, upper: &Rows<T>) {
        for i in 0..upper.nrows() {
            let (mantissa, exponent) = (self.mantissa * upper[(i, i)]).split();
            self.mantissa = mantissa;
            self.exponent = self.exponent + exponent;
        }
    }
}
