//! Likelihood terms, at a point, of tests in phases that share all matrices (theory §7).
//!
//! With σ_{i+1} = Eξ_{i+1} + G σ_i + w, E = [I; 0], and log p(z_i | σ_i) = constant - ½ ‖d_i - R_i σ_i‖² of each phase,
//! the backward pass starts from the last phase, where R̃ = R, d̃ = d:
//!
//! ```text
//! S = I + R̃_{i+1} (EΣE' + CC') R̃_{i+1}' = U'U
//! [R̃_i d̃_i] = triangle from QR of [R_i d_i] above U⁻ᵀ[R̃_{i+1}G  d̃_{i+1} - R̃_{i+1}Eμ]
//! ```
//!
//! This step lowers ℓ of a test by log|U| and half the squared residual of the QR. The forward pass has the root B_i
//! and the mean m_i⁻ of the prior of σ_i given the phases before phase i, and C_i, a root of (P⁻⁻¹ + J_i)⁻¹ = B_i(I +
//! B_i'J_iB_i)⁻¹B_i':
//!
//! ```text
//! [U u] = triangle from QR of [I 0] above [R_iB_i  d_i - R_i m_i⁻]      C_i = B_iU⁻¹
//! m_i = m_i⁻ + C_iu      m_{i+1}⁻ = Eμ + G m_i      B_{i+1} = [EF | G C_i | C]
//! ```
//!
//! u equals U⁻ᵀB_i'R_i'(d_i - R_i m_i⁻), but this product would lose digits with the square of R_i: all digits where a
//! measurement is very exact.
//!
//! R̃_i, d̃_i are the information of phase i and all later phases on σ_i, and B_i, m_i⁻ the prior of σ_i given the
//! earlier phases, so with S = I + R̃BB'R̃' the formulas of one phase hold: r_i = R̃'S⁻¹(d̃ - R̃m⁻) and N_i = R̃'S⁻¹R̃.
//! The blocks of W are W_ii = E'N_iE and W_ki = E'N_k F_{k-1}…F_i E, F_i = G_i(I - C_iC_i'J_i). No inverse of P⁻, Σ or
//! J occurs; the cost is linear in the number of phases, except for the blocks of W between phases.
#![expect(non_snake_case, reason = "B, C, R, F, N are the letters of the theory")]

use std::borrow::Cow;

use nalgebra::DMatrix;

use crate::chained::phase::PhaseView;
use kalfit_algebra::algebra::Algebra;
use kalfit_algebra::factors::Factors;
use kalfit_algebra::rows::Rows;
use kalfit_lanes::Real;

/// F with Σ = FF' of all phases: lower triangular, by columns.
#[derive(Debug, Clone)]
pub(crate) struct Root<'a>(Cow<'a, DMatrix<f64>>);

impl<'a> Root<'a> {
    /// The lower triangular L with LL' = FF', for any root F.
    pub(crate) fn of(root: &'a DMatrix<f64>) -> Self {
        let p = root.nrows();
        if (0..p).all(|i| root[(i, i)] >= 0.0 && (i + 1..p).all(|c| root[(i, c)] == 0.0)) {
            return Root(Cow::Borrowed(root));
        }
        Root(Cow::Owned(root.transpose().qr().r().transpose()))
    }

    /// The matrix F.
    pub(crate) fn lower(&self) -> &DMatrix<f64> {
        &self.0
    }
}

/// The point at which phases are evaluated: F and μ, both of all phases.
pub(super) struct Prior<'a, T> {
    pub(super) root: &'a Root<'a>,
    pub(super) mean: &'a [T],
}

/// Which likelihood terms of a class are computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChainDetail {
    /// r, and the blocks of W within phases.
    Phases,
    /// r, and all blocks of W.
    Between,
    /// r, the blocks of W within phases, Var[ξ_i | z] of each phase, and |S| of the links.
    Posterior,
}

/// Likelihood terms of a class at a point. Matrices are by rows.
#[derive(Debug, Clone)]
pub(crate) struct ChainTerms<T = f64> {
    /// Sum of the quadratic forms over the tests of the class.
    pub(crate) quadratic: T,
    /// Root of |I + RΣR'| of one test, as (mantissa, exponent): |I + RΣR'| = (mantissa × 2^exponent)².
    pub(crate) root_det: (T, T),
    /// r of each phase, p × columns: one column for the mean of the data, then one for each column of the scatter.
    pub(crate) r: Vec<Rows<T>>,
    /// W_ki for k ≥ i, at index k(k+1)/2 + i, p_k × p_i; blocks between phases are `None` unless requested.
    pub(crate) W: Vec<Option<Rows<T>>>,
    /// Var[ξ_i | z] of each phase, p_i × p_i; empty unless requested.
    pub(crate) covariances: Vec<Rows<T>>,
    /// Root of |S| at Σ = 0, as (mantissa, exponent) like `root_det`: at Σ = 0 the noise between the phases lowers ℓ by
    /// the logarithm of this root; 1 unless posteriors are requested.
    pub(crate) link_root_det: (T, T),
}

/// The phases of tests that share all matrices, and the number of tests.
pub(super) struct ChainPhases<'a, A: Algebra> {
    pub(super) phases: &'a [PhaseView<A::Matrix, A::Data>],
    pub(super) count: A::Number,
}

/// Information of a phase and all later phases on σ of the phase.
struct PhaseInformation<A: Algebra> {
    /// R̃, q × q.
    factor: A::Matrix,
    /// d̃, q × columns.
    data: A::Data,
}

impl<A: Algebra> ChainPhases<'_, A> {
    /// Likelihood terms of the class; `None` where the arithmetic would lose digits.
    #[inline(always)]
    pub(super) fn evaluated(&self, prior: &Prior<'_, A::Number>, detail: ChainDetail) -> Option<ChainTerms<A::Number>> {
        let (mut root_det, mut is_accurate) = (RootDet::new(), true);
        let (later_information, mut quadratic) = self.backward(prior, &mut root_det, &mut is_accurate);
        let phases = self.phases.len();
        let (mut r, mut within) = (Vec::with_capacity(phases), Vec::with_capacity(phases));
        let (mut N, mut transitions, mut covariances) = (Vec::new(), Vec::new(), Vec::new());
        let mut rest: Option<[A::Matrix; 2]> = None;
        let (mut B, mut m) = (prior.root::<A>(&self.phases[0]), prior.mean::<A>(&self.phases[0]));
        for (i, (phase, later_information)) in self.phases.iter().zip(&later_information).enumerate() {
            let (own, next) = (phase.own.len(), self.phases.get(i + 1));
            let upper = A::identity_plus(&[&A::times_upper_transpose(&B, &later_information.factor)], &mut is_accurate);
            let u = A::solved_data(
                &upper,
                A::less(later_information.data.clone(), &A::apply(&later_information.factor, &m)),
            );
            let Y = A::solved(&upper, later_information.factor.clone());
            if i == 0 {
                root_det.add::<A>(&upper);
                quadratic = quadratic + A::squares(self.count, &u);
            }
            r.push(A::head(&A::apply_transpose(&Y, &u), own));
            let information = A::transpose_times(&Y, &Y);
            within.push(A::leading_block(&information, own, own));
            if detail == ChainDetail::Between {
                N.push(information);
            }
            if detail == ChainDetail::Posterior {
                covariances.push(posterior_covariance::<A>(
                    prior,
                    phase,
                    rest.as_ref(),
                    later_information,
                    &mut is_accurate,
                ));
            }
            let Some(next) = next else { continue };
            let link = next.link.as_ref().expect("later phases have links");
            let step = PhaseUpdate::<A>::new(phase, (B, m));
            m = A::plus(A::apply(&link.sensitivity, &step.mean), &prior.mean::<A>(next));
            if detail == ChainDetail::Between {
                transitions.push(A::times(&link.sensitivity, &step.left(phase)));
            }
            let inherited = A::times_transpose(&step.root, &link.sensitivity);
            rest = (detail == ChainDetail::Posterior).then(|| [inherited.clone(), link.root.clone()]);
            B = prior.root::<A>(next);
            A::absorb_rows(&mut B, inherited);
            A::absorb_rows(&mut B, link.root.clone());
        }
        let W = if detail == ChainDetail::Between {
            self.blocks(within, &N, &transitions)
        } else {
            diagonal_blocks(within)
        };
        let link_root_det = match detail {
            ChainDetail::Posterior => self.link_root_det(&mut is_accurate).parts(),
            _ => RootDet::new().parts(),
        };
        is_accurate.then_some(ChainTerms { quadratic, root_det: root_det.parts(), r, W, covariances, link_root_det })
    }

    /// Root of |S| at Σ = 0, where S = I + R̃CC'R̃' has only the noise of the links.
    #[inline(always)]
    fn link_root_det(&self, is_accurate: &mut bool) -> RootDet<A::Number> {
        let states = self.phases.iter().map(|phase| phase.own.end).max().unwrap_or(0);
        let (root, mean) = (Root(Cow::Owned(DMatrix::zeros(states, states))), vec![A::Number::splat(0.0); states]);
        let mut root_det = RootDet::new();
        self.backward(&Prior { root: &root, mean: &mean }, &mut root_det, is_accurate);
        root_det
    }

    /// Backward pass: R̃_i and d̃_i of each phase, and the sum of the squared residuals of the QRs.
    #[inline(always)]
    fn backward(
        &self,
        prior: &Prior<'_, A::Number>,
        root_det: &mut RootDet<A::Number>,
        is_accurate: &mut bool,
    ) -> (Vec<PhaseInformation<A>>, A::Number) {
        let mut squared_residuals = A::Number::splat(0.0);
        let mut all: Vec<PhaseInformation<A>> = Vec::with_capacity(self.phases.len());
        for (i, phase) in self.phases.iter().enumerate().rev() {
            let (mut factor, mut data) = (phase.factor.clone(), phase.data.clone());
            if let (Some(later), Some(next)) = (all.last(), self.phases.get(i + 1)) {
                let link = next.link.as_ref().expect("later phases have links");
                let own = A::times_upper_transpose(&prior.root::<A>(next), &later.factor);
                let noise = A::times_upper_transpose(&link.root, &later.factor);
                let innovation_root = A::identity_plus(&[&own, &noise], is_accurate);
                root_det.add::<A>(&innovation_root);
                let residual = A::less(later.data.clone(), &A::apply(&later.factor, &prior.mean::<A>(next)));
                let whitened = A::solved(&innovation_root, A::times(&later.factor, &link.sensitivity));
                let left = A::absorb(&mut factor, &mut data, whitened, A::solved_data(&innovation_root, residual));
                squared_residuals = squared_residuals + A::squares(self.count, &left);
            }
            all.push(PhaseInformation { factor, data });
        }
        all.reverse();
        (all, squared_residuals)
    }

    /// All blocks W_ki = E'N_k F_{k-1}…F_i E; `within` has the blocks W_kk.
    #[inline(always)]
    fn blocks(
        &self,
        within: Vec<Rows<A::Number>>,
        N: &[A::Matrix],
        transitions: &[A::Matrix],
    ) -> Vec<Option<Rows<A::Number>>> {
        let phases = self.phases.len();
        let mut blocks = Vec::with_capacity(phases * (phases + 1) / 2);
        for (k, own) in within.into_iter().enumerate() {
            let (p, first) = (own.nrows(), blocks.len());
            blocks.push(Some(own));
            if k > 0 {
                let mut row = A::times(&N[k], &transitions[k - 1]);
                blocks.push(Some(A::leading_block(&row, p, self.phases[k - 1].own.len())));
                for i in (0..k - 1).rev() {
                    row = A::times(&row, &transitions[i]);
                    blocks.push(Some(A::leading_block(&row, p, self.phases[i].own.len())));
                }
            }
            blocks[first..].reverse();
        }
        blocks
    }
}

/// The blocks of W within phases, with `None` between phases.
fn diagonal_blocks<T>(within: Vec<Rows<T>>) -> Vec<Option<Rows<T>>> {
    let mut blocks = Vec::with_capacity(within.len() * (within.len() + 1) / 2);
    for (k, own) in within.into_iter().enumerate() {
        blocks.extend((0..k).map(|_| None));
        blocks.push(Some(own));
    }
    blocks
}

impl<T: Real> Prior<'_, T> {
    /// (EF)' of a phase: the rows of F for the states that are new in the phase, transposed.
    #[inline(always)]
    fn root<A: Algebra<Number = T>>(&self, phase: &PhaseView<A::Matrix, A::Data>) -> A::Matrix {
        A::phase_root(&self.root.0, &phase.own, &phase.factor)
    }

    /// Eμ of a phase in the column for the mean of the data, zero in the columns of the scatter.
    #[inline(always)]
    fn mean<A: Algebra<Number = T>>(&self, phase: &PhaseView<A::Matrix, A::Data>) -> A::Data {
        A::mean_of(self.mean, &phase.own, &phase.data)
    }
}

/// The posterior of σ_i given phase i and the earlier phases.
struct PhaseUpdate<A: Algebra> {
    /// C', with C a root of the posterior covariance.
    root: A::Matrix,
    /// m, the posterior mean.
    mean: A::Data,
}

impl<A: Algebra> PhaseUpdate<A> {
    /// Updates the prior of σ_i, given by B' and m⁻, with the phase's data.
    #[inline(always)]
    fn new(phase: &PhaseView<A::Matrix, A::Data>, (B, prior): (A::Matrix, A::Data)) -> PhaseUpdate<A> {
        let rows = A::transposed(&A::times_upper_transpose(&B, &phase.factor));
        let residual = A::less(phase.data.clone(), &A::apply(&phase.factor, &prior));
        let (upper, whitened) = A::identity_absorbing(rows, residual);
        let root = A::solved(&upper, B);
        let mean = A::plus(prior, &A::apply_transpose(&root, &whitened));
        PhaseUpdate { root, mean }
    }

    /// The matrix I - CC'J.
    #[inline(always)]
    fn left(&self, phase: &PhaseView<A::Matrix, A::Data>) -> A::Matrix {
        let whitened_factor = A::times_upper_transpose(&self.root, &phase.factor);
        A::identity_less(&A::transpose_times(&self.root, &A::times(&whitened_factor, &phase.factor)))
    }
}

/// Var[ξ_i | z] = F(I + F'N°F)⁻¹F', with N° the information of all measurements on ξ_i. `rest`: (GC)' of the phase
/// before and C' of the link, the rows of a root of the prior covariance of σ_i without the part of ξ_i.
#[inline(always)]
fn posterior_covariance<A: Algebra>(
    prior: &Prior<'_, A::Number>,
    phase: &PhaseView<A::Matrix, A::Data>,
    rest: Option<&[A::Matrix; 2]>,
    later_information: &PhaseInformation<A>,
    is_accurate: &mut bool,
) -> Rows<A::Number> {
    let p = phase.own.len();
    let whitened_factor = match rest {
        None => later_information.factor.clone(),
        Some([inherited, noise]) => {
            let inherited = A::times_upper_transpose(inherited, &later_information.factor);
            let noise = A::times_upper_transpose(noise, &later_information.factor);
            A::solved(&A::identity_plus(&[&inherited, &noise], is_accurate), later_information.factor.clone())
        }
    };
    let own = prior.root::<A>(phase);
    let half = A::solved(&A::identity_plus(&[&A::times_transpose(&whitened_factor, &own)], is_accurate), own);
    A::leading_block(&A::transpose_times(&half, &half), p, p)
}

/// Upper triangular R, q × q, with R'R = rows'rows.
#[inline(always)]
pub(super) fn compressed<F: Factors>(rows: Rows<F::Number>) -> Rows<F::Number> {
    let q = rows.ncols();
    let mut upper = Rows::zeros(q, q);
    <F as Factors>::absorb(&mut upper, rows, q);
    upper
}

/// |U|, accumulated as mantissa × 2^exponent.
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
    fn add<A: Algebra<Number = T>>(&mut self, factor: &A::Factor) {
        for x in A::diagonal(factor) {
            let (mantissa, exponent) = (self.mantissa * x).split();
            self.mantissa = mantissa;
            self.exponent = self.exponent + exponent;
        }
    }
}
