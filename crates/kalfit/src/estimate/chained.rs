//! Tests in phases that share all matrices, and what they say at a point, phase by phase (theory §7).
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
//!
//! Data of a class: everything is linear in d, so a class of n tests is the mean of its d and columns whose outer products
//! add up to the scatter about it, no more of them than numbers in d.
#![expect(non_snake_case, reason = "B, C, R, F, N are the letters of the theory")]

use std::ops::Range;

use nalgebra::DMatrix;

use crate::estimate::classes::Frame;
use crate::linalg::real::Real;
use crate::linalg::rows::{Care, Rows, absorb, identity_plus};
use crate::reduce::{Chain, ChainPhase, Path, Reduction};

/// Beyond this RΣR' is too large for cross products.
const LARGE: f64 = 1e10;

/// Tests whose chains share all matrices, in η: σ in units of the frame where it is a phase's own, centred.
#[derive(Debug, Clone)]
pub(crate) struct Chained {
    phases: Vec<Phase>,
    /// The mean of the data of the tests, then columns for the scatter about it.
    columns: usize,
    /// n.
    count: f64,
    care: Care,
}

#[derive(Debug, Clone)]
struct Phase {
    /// Its states among those of all phases.
    own: Range<usize>,
    /// R, q × q.
    factor: Rows,
    /// d of all columns, q × columns.
    data: Rows,
    link: Option<Link>,
}

#[derive(Debug, Clone)]
struct Link {
    /// G, q × q of the phase before.
    sensitivity: Rows,
    /// C', any number × q.
    root: Rows,
}

/// Where phases meet a point: E'F' of each phase and Eμ.
struct Prior<'a> {
    root: &'a DMatrix<f64>,
    mean: &'a [f64],
}

/// What the later phases and a phase itself know of its σ.
struct Known {
    /// R̃.
    factor: Rows,
    /// d̃.
    data: Rows,
}

/// What a class says at a point. Matrices by rows.
#[derive(Debug, Clone)]
pub(crate) struct Said {
    /// Σ_j of the quadratic forms.
    pub(crate) quadratic: f64,
    /// log|I + RΣR'| of a test.
    pub(crate) log_det: f64,
    /// By phase r of the mean and of the columns of the scatter, p × columns.
    pub(crate) r: Vec<Rows>,
    /// W_ki for k ≥ i, at k(k+1)/2 + i, p_k × p_i; without the blocks between phases if those were not asked for.
    pub(crate) W: Vec<Option<Rows>>,
}

impl Chained {
    /// Tests with equal matrices, in a frame; `ranges` says where the states of each phase of the model stand.
    pub(crate) fn new(members: &[&Reduction], ranges: &[Range<usize>], frame: &Frame) -> Chained {
        let chains: Vec<&Chain> = members.iter().map(|r| r.chain.as_deref().expect("it has a chain")).collect();
        let careful = chains.iter().any(|chain| chain.phases.iter().any(|phase| phase.path == Path::SquareRoot));
        let data: Vec<Vec<Vec<f64>>> = chains.iter().map(|chain| centred(chain, ranges, frame)).collect();
        let columns = columns(&data);
        let mut row = 0;
        let mut before: Option<Vec<f64>> = None;
        let phases = chains[0].phases.iter().zip(ranges).map(|(phase, own)| {
            let scale = scales(phase, own, frame);
            let q = phase.data.len();
            let own_data = Rows::from_fn(q, columns.ncols(), |i, k| columns[(row + i, k)]);
            row += q;
            let link = phase.link.as_ref().zip(before.as_ref()).map(|(link, from)| Link {
                sensitivity: Rows::from_fn(q, from.len(), |i, k| link.sensitivity[(i, k)] * from[k] / scale[i]),
                root: Rows::from_fn(link.root.ncols(), q, |c, i| link.root[(i, c)] / scale[i]),
            });
            let factor = Rows::from_fn(q, q, |i, k| packed(&phase.factor, i, k) * scale[k]);
            before = Some(scale);
            Phase { own: own.clone(), factor, data: own_data, link }
        });
        let phases: Vec<Phase> = phases.collect();
        let care = if careful { Care::Rotations } else { Care::Plain };
        Chained { phases, columns: columns.ncols(), count: members.len() as f64, care }
    }

    /// How many phases its tests have.
    pub(crate) fn phases(&self) -> usize {
        self.phases.len()
    }

    /// How many coordinates enter a phase.
    pub(crate) fn entering(&self, phase: usize) -> usize {
        self.phases[phase].factor.nrows()
    }

    /// n J of a phase by itself, in what enters it.
    pub(crate) fn own_information(&self, phase: usize) -> DMatrix<f64> {
        let factor = &self.phases[phase].factor;
        let gram = factor.transpose_times(factor);
        DMatrix::from_fn(gram.nrows(), gram.ncols(), |i, k| self.count * gram[(i, k)])
    }

    /// n J of the first phases together on the initial states of all, `states` of them.
    pub(crate) fn information(&self, phases: usize, states: usize) -> DMatrix<f64> {
        let first = Chained { phases: self.phases[..phases].to_vec(), ..self.clone() };
        let said = first.at(&vec![0.0; states], &DMatrix::zeros(states, states), true);
        let mut information = DMatrix::zeros(states, states);
        let own: Vec<&Range<usize>> = first.ranges().collect();
        let mut blocks = said.W.iter().flatten();
        for (k, one) in own.iter().enumerate() {
            for (other, block) in own[..=k].iter().zip(&mut blocks) {
                for (a, row) in (**one).clone().enumerate() {
                    for (b, column) in (**other).clone().enumerate() {
                        information[(row, column)] = self.count * block[(a, b)];
                        information[(column, row)] = information[(row, column)];
                    }
                }
            }
        }
        information
    }

    /// All that the class says at a point: μ of its tests and F with Σ = FF', both of all phases; the blocks of W between phases
    /// where they are wanted.
    pub(crate) fn at(&self, mean: &[f64], root: &DMatrix<f64>, between: bool) -> Said {
        let prior = Prior { root, mean };
        match self.said(&prior, between, self.care) {
            Some(said) => said,
            None => self.said(&prior, between, Care::Rotations).expect("rotations bear any size"),
        }
    }

    /// `None` where cross products would lose digits.
    fn said(&self, prior: &Prior<'_>, between: bool, care: Care) -> Option<Said> {
        let mut log_det = LogDet::default();
        let (known, lost) = self.backward(prior, care, &mut log_det)?;
        let mut said = Said { quadratic: lost, log_det: 0.0, r: Vec::new(), W: Vec::new() };
        let mut N: Vec<Rows> = Vec::new();
        let mut carried: Vec<Rows> = Vec::new();
        let (mut B, mut m) = (Rows::zeros(0, 0), Rows::zeros(0, 0));
        for (i, (phase, known)) in self.phases.iter().zip(&known).enumerate() {
            if i == 0 {
                (B, m) = (prior.root_of(phase), self.prior_mean(prior, phase));
            }
            let upper = self.spread(&B, &known.factor, care)?;
            let u = Rows::solved_below(&upper, known.data.clone().less(&known.factor.times(&m)));
            let Y = Rows::solved_below(&upper, known.factor.clone());
            if i == 0 {
                log_det.add(&upper);
                said.quadratic += self.squares(&u);
            }
            let p = phase.own.len();
            said.r.push(Y.transpose_times(&u).first_rows(p));
            N.push(Y.transpose_times(&Y));
            let Some(next) = self.phases.get(i + 1) else { continue };
            let link = next.link.as_ref().expect("later phases have links");
            let step = phase.update(&B, care)?;
            m = link.sensitivity.times(&step.mean(phase, m)).plus(&self.prior_mean(prior, next));
            if between {
                carried.push(link.sensitivity.times(&step.left(phase)));
            }
            let mut rows = prior.root_of(next);
            rows.append(&link.carried(&step));
            B = compressed(rows, care);
        }
        said.log_det = log_det.value();
        said.W = self.blocks(&N, &carried, between);
        Some(said)
    }

    /// log|S| of the links alone: what ℓ at Σ = 0 loses to the noise between the phases.
    pub(crate) fn link_log_det(&self, states: usize) -> f64 {
        let nothing = DMatrix::zeros(states, states);
        let prior = Prior { root: &nothing, mean: &vec![0.0; states] };
        let along = |care: Care| {
            let mut log_det = LogDet::default();
            self.backward(&prior, care, &mut log_det).map(|_| log_det.value())
        };
        along(self.care).unwrap_or_else(|| along(Care::Rotations).expect("rotations bear any size"))
    }

    /// Var[ξ_i | z] of each phase of a test, p_i × p_i: with N° the information that all else gives on ξ_i, F(I + F'N°F)⁻¹F'.
    pub(crate) fn posterior_covariances(&self, root: &DMatrix<f64>) -> Vec<DMatrix<f64>> {
        let prior = Prior { root, mean: &vec![0.0; root.nrows()] };
        let found = self.posteriors(&prior, self.care);
        found.unwrap_or_else(|| self.posteriors(&prior, Care::Rotations).expect("rotations bear any size"))
    }

    fn posteriors(&self, prior: &Prior<'_>, care: Care) -> Option<Vec<DMatrix<f64>>> {
        let (known, _) = self.backward(prior, care, &mut LogDet::default())?;
        let mut found = Vec::with_capacity(self.phases.len());
        // root of the prior of σ_i but for its own ξ_i
        let mut rest = Rows::zeros(0, self.phases[0].factor.nrows());
        for (i, (phase, known)) in self.phases.iter().zip(&known).enumerate() {
            let p = phase.own.len();
            let seen = Rows::solved_below(&self.spread(&rest, &known.factor, care)?, known.factor.first_columns(p));
            let own = prior.root_of(phase);
            let half = posterior_root(&own.first_columns(p), &seen, care)?;
            let covariance = half.transpose_times(&half);
            found.push(DMatrix::from_fn(p, p, |a, b| covariance[(a, b)]));
            let Some(next) = self.phases.get(i + 1) else { continue };
            let mut rows = own;
            rows.append(&rest);
            let step = phase.update(&compressed(rows, care), care)?;
            rest = next.link.as_ref().expect("later phases have links").carried(&step);
        }
        Some(found)
    }

    /// R̃_i and d̃_i of each phase, and what ℓ loses to residuals.
    fn backward(&self, prior: &Prior<'_>, care: Care, log_det: &mut LogDet) -> Option<(Vec<Known>, f64)> {
        let mut lost = 0.0;
        let mut all: Vec<Known> = Vec::with_capacity(self.phases.len());
        for (i, phase) in self.phases.iter().enumerate().rev() {
            let q = phase.factor.nrows();
            let mut upper = phase.factor.beside(&phase.data);
            if let (Some(later), Some(next)) = (all.last(), self.phases.get(i + 1)) {
                let link = next.link.as_ref().expect("later phases have links");
                let mut root = prior.root_of(next);
                root.append(&link.root);
                let spread = self.spread(&root, &later.factor, care)?;
                log_det.add(&spread);
                let residual = later.data.clone().less(&later.factor.times(&self.prior_mean(prior, next)));
                let told = later.factor.times(&link.sensitivity).beside(&residual);
                let left = absorb(&mut upper, Rows::solved_below(&spread, told), q, care);
                lost += self.squares(&left.last_columns(self.columns));
            }
            all.push(Known { factor: upper.first_columns(q), data: upper.last_columns(self.columns) });
        }
        all.reverse();
        Some((all, lost))
    }

    /// U with U'U = I + R BB' R', B' given by rows.
    fn spread(&self, root: &Rows, factor: &Rows, care: Care) -> Option<Rows> {
        let rows = root.times_transpose(factor);
        (care == Care::Rotations || rows.amax() < LARGE.sqrt()).then(|| identity_plus(&rows, care))
    }

    /// Eμ for the mean of the tests; the columns of the scatter have none.
    fn prior_mean(&self, prior: &Prior<'_>, phase: &Phase) -> Rows {
        let mut mean = Rows::zeros(phase.factor.nrows(), self.columns);
        for (i, own) in phase.own.clone().enumerate() {
            mean[(i, 0)] = prior.mean[own];
        }
        mean
    }

    /// Sum of squares over the tests.
    fn squares(&self, u: &Rows) -> f64 {
        let weight = |k: usize| if k == 0 { self.count } else { 1.0 };
        (0..u.nrows()).map(|i| u.row(i).iter().enumerate().map(|(k, x)| weight(k) * x * x).sum::<f64>()).sum()
    }

    /// W_ki = E'N_k F_{k-1}…F_i E.
    fn blocks(&self, N: &[Rows], carried: &[Rows], between: bool) -> Vec<Option<Rows>> {
        let mut blocks = Vec::new();
        for k in 0..self.phases.len() {
            let p = self.phases[k].own.len();
            let mut row = N[k].first_rows(p);
            let mut own = vec![Some(row.first_columns(p))];
            for i in (0..k).rev() {
                own.push(between.then(|| {
                    row = row.times(&carried[i]);
                    row.first_columns(self.phases[i].own.len())
                }));
            }
            blocks.extend(own.into_iter().rev());
        }
        blocks
    }

    /// Where the states of its phases stand.
    pub(crate) fn ranges(&self) -> impl Iterator<Item = &Range<usize>> {
        self.phases.iter().map(|phase| &phase.own)
    }
}

impl Link {
    /// A root, by rows, of the covariance of what the next phase inherits.
    fn carried(&self, step: &Update) -> Rows {
        let mut rows = step.root.times_transpose(&self.sensitivity);
        rows.append(&self.root);
        rows
    }
}

impl Prior<'_> {
    /// (EF)' of a phase: p × q.
    fn root_of(&self, phase: &Phase) -> Rows {
        let (own, q) = (&phase.own, phase.factor.nrows());
        let p = own.len();
        Rows::from_fn(p, q, |c, i| if i < p { self.root[(own.start + i, own.start + c)] } else { 0.0 })
    }
}

/// The posterior of σ_i given this phase and the earlier ones.
struct Update {
    /// C', by rows.
    root: Rows,
    /// C'R'.
    seen: Rows,
}

impl Phase {
    fn update(&self, B: &Rows, care: Care) -> Option<Update> {
        let root = posterior_root(B, &self.factor, care)?;
        let seen = root.times_transpose(&self.factor);
        Some(Update { root, seen })
    }
}

impl Update {
    /// m = m⁻ + CC'R'(d - Rm⁻).
    fn mean(&self, phase: &Phase, prior: Rows) -> Rows {
        let residual = phase.data.clone().less(&phase.factor.times(&prior));
        prior.plus(&self.root.transpose_times(&self.seen.times(&residual)))
    }

    /// I - CC'J.
    fn left(&self, phase: &Phase) -> Rows {
        let q = phase.factor.nrows();
        let taken = self.root.transpose_times(&self.seen.times(&phase.factor));
        Rows::from_fn(q, q, |i, k| f64::from(u8::from(i == k)) - taken[(i, k)])
    }
}

/// C' with CC' = B(I + B'JB)⁻¹B', J = R'R; B' by rows. `None` where cross products would lose digits.
fn posterior_root(B: &Rows, factor: &Rows, care: Care) -> Option<Rows> {
    let rows = factor.times_transpose(B); // RB
    let is_borne = care == Care::Rotations || rows.amax() < LARGE.sqrt();
    is_borne.then(|| Rows::solved_below(&identity_plus(&rows, care), B.clone()))
}

/// log|U'U|, as a product.
struct LogDet {
    mantissa: f64,
    exponent: f64,
}

impl Default for LogDet {
    fn default() -> LogDet {
        LogDet { mantissa: 1.0, exponent: 0.0 }
    }
}

impl LogDet {
    fn add(&mut self, upper: &Rows) {
        for i in 0..upper.nrows() {
            let (mantissa, exponent) = (self.mantissa * upper[(i, i)]).split();
            self.mantissa = mantissa;
            self.exponent += exponent;
        }
    }

    fn value(&self) -> f64 {
        2.0 * (self.mantissa.ln() + self.exponent * std::f64::consts::LN_2)
    }
}

/// Upper triangular R with R'R = rows'rows; no more rows than columns.
fn compressed(rows: Rows, care: Care) -> Rows {
    let q = rows.ncols();
    let mut upper = Rows::zeros(q, q);
    absorb(&mut upper, rows, q, care);
    upper
}

/// The unit of each coordinate of a phase's σ: that of the frame where it is its own.
fn scales(phase: &ChainPhase, own: &Range<usize>, frame: &Frame) -> Vec<f64> {
    let of = |i: usize| if i < own.len() { frame.scale[own.start + i] } else { 1.0 };
    (0..phase.data.len()).map(of).collect()
}

/// d_i - R_i × (σ_i at the centre of the frame without noise), by phase.
fn centred(chain: &Chain, ranges: &[Range<usize>], frame: &Frame) -> Vec<Vec<f64>> {
    let mut at: Vec<f64> = Vec::new();
    let one = |(phase, own): (&ChainPhase, &Range<usize>)| {
        let q = phase.data.len();
        let mut sigma: Vec<f64> =
            (0..q).map(|i| if i < own.len() { frame.centre[own.start + i] } else { 0.0 }).collect();
        if let Some(link) = &phase.link {
            for (i, s) in sigma.iter_mut().enumerate() {
                *s += link.mean[i] + at.iter().enumerate().map(|(k, x)| link.sensitivity[(i, k)] * x).sum::<f64>();
            }
        }
        let told = |i: usize| (i..q).map(|k| packed(&phase.factor, i, k) * sigma[k]).sum::<f64>();
        let data = (0..q).map(|i| phase.data[i] - told(i)).collect();
        at = sigma;
        data
    };
    chain.phases.iter().zip(ranges).map(one).collect()
}

/// The mean of the data of the tests, then columns whose outer products add up to the scatter about it: one for each test, or, if
/// that is less, one for each number of data.
fn columns(data: &[Vec<Vec<f64>>]) -> Rows {
    let all: Vec<Vec<f64>> = data.iter().map(|test| test.concat()).collect();
    let (n, size) = (all.len(), all[0].len());
    let mut mean = vec![0.0; size];
    all.iter().for_each(|test| mean.iter_mut().zip(test).for_each(|(m, d)| *m += d));
    mean.iter_mut().for_each(|m| *m /= n as f64);
    let away = |j: usize, i: usize| all[j][i] - mean[i];
    let scatter = match n {
        1 => Rows::zeros(0, size),
        n if n <= size => Rows::from_fn(n, size, away),
        n => compressed(Rows::from_fn(n, size, away), Care::Plain),
    };
    let m = scatter.nrows();
    Rows::from_fn(size, 1 + m, |i, k| if k == 0 { mean[i] } else { scatter[(k - 1, i)] })
}

/// Entry (i, k) of a packed upper triangle.
fn packed(factor: &[f64], i: usize, k: usize) -> f64 {
    if i <= k { factor[i + k * (k + 1) / 2] } else { 0.0 }
}
