//! The reductions as the estimator wants them: scaled, centred, and tests that share one R gathered into one class.
//!
//! Inside this module ξ = m + D η with a centre m near the population mean and a diagonal D that gives the average
//! test unit information on each state, so that nothing here depends on the user's units. For a class of n tests
//! with one R, only the mean of their d and its scatter matter: a class costs as much as one test. Tests in phases may be kept
//! phase by phase ([`Chained`]).

use std::borrow::Cow;
use std::cmp::Ordering;
use std::ops::Range;

use kalfit_lanes::Isa;
use nalgebra::{DMatrix, DVector};

use crate::estimate::chained::{Chained, Detail, Packed};
use crate::estimate::lanes::Blocks;
use crate::estimate::pass::{Order, pass};
use crate::estimate::terms::Point;
use crate::estimate::together::{each_packed, packed};
use crate::linalg::elements::Elements;
use crate::linalg::symmetric;
use crate::reduce::{Chain, ChainPhase, Path, Reduction};

/// Tests that share R and covariates, in η: log p(z_j | η) = constant_j - ½ ‖d_j - R η‖².
#[derive(Debug, Clone)]
pub(crate) struct Class<T = f64> {
    /// n, the number of tests.
    pub(crate) count: T,
    /// Σ_j constant_j.
    pub(crate) constant: T,
    /// R, p × p by rows, upper triangular.
    pub(crate) factor: Vec<T>,
    /// Mean of d_j.
    pub(crate) mean: Vec<T>,
    /// Σ_j (d_j - mean)(d_j - mean)', p × p by rows; `None` for a single test.
    pub(crate) scatter: Option<Vec<T>>,
    /// Scaled covariates of the regressions.
    pub(crate) covariates: Vec<T>,
    /// Some test of it needs square-root arithmetic.
    pub(crate) square_root: bool,
    /// The same phase by phase; R, d and their scatter are then empty.
    pub(crate) chain: Option<Box<Chained>>,
}

/// All reductions of an ensemble, ready for passes.
#[derive(Debug, Clone)]
pub(crate) struct Classes {
    /// In an order that does not depend on the order of the tests.
    pub(crate) classes: Vec<Class>,
    /// Those of them that are worked on side by side.
    pub(crate) blocks: Blocks,
    /// Numbers of those that are worked on one by one.
    pub(crate) beside: Vec<usize>,
    /// Those in phases that are worked on side by side.
    pub(crate) chains: Vec<Packed>,
    pub(crate) frame: Frame,
    pub(crate) tests: usize,
    /// Σ_j R_j'R_j, in η.
    pub(crate) information: DMatrix<f64>,
    /// The elements of Σ.
    pub(crate) elements: Elements,
    /// Number of tests that have each phase.
    pub(crate) present: Vec<f64>,
    /// Tests are kept phase by phase where that can be.
    chained: bool,
}

/// The coordinates η: ξ = centre + scale ∘ η.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Frame {
    pub(crate) centre: Vec<f64>,
    pub(crate) scale: Vec<f64>,
    /// Scale of each covariate.
    pub(crate) covariate_scale: Vec<f64>,
}

impl Frame {
    /// Σ in the user's units from Σ in η.
    pub(crate) fn covariance_out(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(sigma.nrows(), sigma.ncols(), |i, j| self.scale[i] * sigma[(i, j)] * self.scale[j])
    }

    /// Σ in η from Σ in the user's units.
    pub(crate) fn covariance_in(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(sigma.nrows(), sigma.ncols(), |i, j| sigma[(i, j)] / (self.scale[i] * self.scale[j]))
    }

    /// The frame of some of the states.
    pub(crate) fn part(&self, states: &Range<usize>) -> Frame {
        let of = |all: &[f64]| all[states.clone()].to_vec();
        Frame { centre: of(&self.centre), scale: of(&self.scale), covariate_scale: self.covariate_scale.clone() }
    }

    /// μ in the user's units from μ in η.
    pub(crate) fn mean_out(&self, mu: &[f64]) -> Vec<f64> {
        mu.iter().zip(&self.centre).zip(&self.scale).map(|((m, c), s)| c + s * m).collect()
    }
}

impl Classes {
    /// Gathers reductions with the states of each phase at these places and `regressors` covariates each. `chained`: keep tests
    /// phase by phase where their reductions are.
    pub(crate) fn new(
        reductions: &[Reduction],
        ranges: Vec<Range<usize>>,
        regressors: usize,
        chained: bool,
    ) -> Classes {
        let elements = Elements::new(ranges);
        let order = ordered(reductions);
        let frame = frame(reductions, &order, &elements, regressors);
        Classes::gathered(reductions, &order, frame, (elements, chained))
    }

    /// The same in coordinates that are given.
    pub(crate) fn within(reductions: &[Reduction], like: &Classes) -> Classes {
        let how = (like.elements.clone(), like.chained);
        Classes::gathered(reductions, &ordered(reductions), like.frame.clone(), how)
    }

    fn gathered(
        reductions: &[Reduction],
        order: &[usize],
        frame: Frame,
        (elements, chained): (Elements, bool),
    ) -> Classes {
        let p = frame.scale.len();
        let chained = chained && !elements.is_single();
        let mut classes: Vec<Class> = Vec::new();
        let mut information = DMatrix::zeros(p, p);
        let mut start = 0;
        while start < order.len() {
            let same = |k: &&usize| same_class(&reductions[order[start]], &reductions[**k], chained);
            let end = start + order[start..].iter().take_while(same).count();
            let class = gather(reductions, &order[start..end], &frame, (&elements, chained));
            if class.chain.is_some() {
                information += scaled_gram(&reductions[order[start]].factor, &frame.scale) * class.count;
            } else {
                let factor = DMatrix::from_row_slice(p, p, &class.factor);
                information += factor.transpose() * &factor * class.count;
            }
            classes.push(class);
            start = end;
        }
        let present = present(reductions, &elements);
        Classes::arranged(classes, frame, (elements, chained), (reductions.len(), information, present))
    }

    /// The classes, and who is worked on side by side with whom.
    fn arranged(
        classes: Vec<Class>,
        frame: Frame,
        (elements, chained): (Elements, bool),
        (tests, information, present): (usize, DMatrix<f64>, Vec<f64>),
    ) -> Classes {
        let (mut blocks, mut beside) = (Blocks::new(frame.scale.len(), Isa::best()), Vec::new());
        for (number, class) in classes.iter().enumerate() {
            if elements.is_single() && blocks.takes(class) {
                blocks.push(class);
            } else if class.chain.as_ref().is_none_or(|chain| chain.is_careful()) {
                beside.push(number);
            }
        }
        let chains = packed(classes.iter().map(|class| class.chain.as_deref()).enumerate(), blocks.isa().lanes());
        Classes { classes, blocks, beside, chains, frame, tests, information, elements, present, chained }
    }

    /// Every so-many-th class in their order, in the same η. The pooled information is the share that goes with the tests.
    pub(crate) fn thinned(&self, every: usize) -> Classes {
        let classes: Vec<Class> = self.classes.iter().skip(every / 2).step_by(every).cloned().collect();
        let tests = classes.iter().map(|class| class.count).sum::<f64>();
        let share = tests / self.tests as f64;
        let present = self.present.iter().map(|tests| tests * share).collect();
        let how = (self.elements.clone(), self.chained);
        Classes::arranged(classes, self.frame.clone(), how, (tests as usize, &self.information * share, present))
    }

    /// The classes of reductions that are kept phase by phase, whatever these classes are. `own`: they are those of the reductions.
    pub(crate) fn by_phase(&self, reductions: &[Reduction], own: bool) -> Cow<'_, [Class]> {
        if own && self.classes.iter().all(|class| class.chain.is_some()) {
            return Cow::Borrowed(&self.classes);
        }
        let how = (self.elements.clone(), true);
        Cow::Owned(Classes::gathered(reductions, &ordered(reductions), self.frame.clone(), how).classes)
    }

    /// One test as a class of its own, in the same η.
    pub(crate) fn single(&self, reduction: &Reduction) -> Class {
        gather(std::slice::from_ref(reduction), &[0], &self.frame, (&self.elements, self.chained))
    }

    /// Σ_j E_j'J_jE_j: information on the p elements of μ and the scaled regression coefficients at Σ = 0.
    pub(crate) fn mean_information(&self, regressors: &[usize]) -> DMatrix<f64> {
        let p = self.dimension();
        if self.classes.iter().any(|class| class.chain.is_some()) {
            return pass(self, regressors, &self.origin(regressors.len()), Order::Mean, None).mean_information;
        }
        let mut information = DMatrix::zeros(p + regressors.len(), p + regressors.len());
        for class in &self.classes {
            let column = |m: usize| if m < p { (m, 1.0) } else { (regressors[m - p], class.covariates[m - p]) };
            let rows = DMatrix::from_fn(p, p + regressors.len(), |i, m| {
                let (k, x) = column(m);
                x * class.factor[i * p + k]
            });
            information += rows.transpose() * &rows * class.count;
        }
        information
    }

    /// The centre, without spread.
    fn origin(&self, regressors: usize) -> Point {
        let p = self.dimension();
        Point { mean: vec![0.0; p], coefficients: vec![0.0; regressors], root: DMatrix::zeros(p, p) }
    }

    /// For each class its number of tests and, for each element i, Σ (y - Jμ)_i² - J_ii over them, which has the mean
    /// Σ (JΣJ)_ii, and J_ii of one of them.
    pub(crate) fn excesses(&self, mean: &DVector<f64>) -> Vec<(f64, Vec<(f64, f64)>)> {
        let p = mean.len();
        let alone = |class: &Class| {
            let factor = DMatrix::from_row_slice(p, p, &class.factor);
            let residual = factor.transpose() * (DVector::from_column_slice(&class.mean) - &factor * mean);
            let scatter =
                class.scatter.as_ref().map(|s| factor.transpose() * DMatrix::from_row_slice(p, p, s) * &factor);
            let one = |i: usize| {
                let spread = scatter.as_ref().map_or(0.0, |s| s[(i, i)]);
                let own = factor.column(i).norm_squared();
                (class.count * (residual[i] * residual[i] - own) + spread, own)
            };
            (class.count, (0..p).map(one).collect())
        };
        if self.chains.is_empty() && self.classes.iter().all(|class| class.chain.is_none()) {
            return self.classes.iter().map(alone).collect();
        }
        let classes: Vec<&Class> = self.classes.iter().collect();
        let point = Point { mean: mean.as_slice().to_vec(), ..self.origin(0) };
        let mut told: Vec<(f64, Vec<(f64, f64)>)> = vec![(0.0, Vec::new()); classes.len()];
        let packed = (self.blocks.isa(), &self.chains[..]);
        each_packed(&classes, packed, &[], &point, Detail::Phases, &mut |k, terms| {
            let one = |at: usize| (terms.outer[at] - classes[k].count * terms.W[at], terms.W[at]);
            told[k] = (classes[k].count, (0..p).map(|i| one(i * p + i)).collect());
        });
        told
    }

    /// p.
    pub(crate) fn dimension(&self) -> usize {
        self.frame.scale.len()
    }
}

fn ordered(reductions: &[Reduction]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..reductions.len()).collect();
    order.sort_by(|&a, &b| canonical(&reductions[a], &reductions[b]));
    order
}

/// Order by R, covariates, then id: a total order that gathers classes and does not see the order of the tests.
fn canonical(a: &Reduction, b: &Reduction) -> Ordering {
    compare(&a.factor, &b.factor)
        .then_with(|| compare(&a.covariates, &b.covariates))
        .then_with(|| compare_chains(a.chain.as_deref(), b.chain.as_deref()))
        .then_with(|| a.test.cmp(&b.test))
}

/// By all matrices of the phases, and where the links come from.
fn compare_chains(a: Option<&Chain>, b: Option<&Chain>) -> Ordering {
    let (Some(a), Some(b)) = (a, b) else { return a.is_some().cmp(&b.is_some()) };
    let of_phases = |(a, b): (&ChainPhase, &ChainPhase)| {
        let links = match (&a.link, &b.link) {
            (Some(a), Some(b)) => compare(a.sensitivity.as_slice(), b.sensitivity.as_slice())
                .then_with(|| compare(a.root.as_slice(), b.root.as_slice())),
            (a, b) => a.is_some().cmp(&b.is_some()),
        };
        compare(&a.factor, &b.factor).then(links)
    };
    let different = a.phases.iter().zip(&b.phases).map(of_phases).find(|o| o.is_ne());
    different.unwrap_or_else(|| a.phases.len().cmp(&b.phases.len()))
}

fn compare(a: &[f64], b: &[f64]) -> Ordering {
    let different = a.iter().zip(b).map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne());
    different.unwrap_or_else(|| a.len().cmp(&b.len()))
}

fn same_class(a: &Reduction, b: &Reduction, chained: bool) -> bool {
    compare(&a.factor, &b.factor).is_eq()
        && compare(&a.covariates, &b.covariates).is_eq()
        && (!chained || compare_chains(a.chain.as_deref(), b.chain.as_deref()).is_eq())
}

/// How many tests have each phase: all have the first one; of tests that are not kept phase by phase, those that say something
/// of its states.
fn present(reductions: &[Reduction], elements: &Elements) -> Vec<f64> {
    let has = |r: &Reduction, f: usize, range: &Range<usize>| match &r.chain {
        _ if f == 0 => true,
        Some(chain) => f < chain.phases.len(),
        None => range.clone().any(|k| r.factor[k * (k + 1) / 2..][..=k].iter().any(|x| *x != 0.0)),
    };
    let count = |(f, range): (usize, &Range<usize>)| reductions.iter().filter(|r| has(r, f, range)).count() as f64;
    elements.blocks().iter().enumerate().map(count).collect()
}

/// R'R with the columns of a packed upper triangle in units of the frame.
fn scaled_gram(factor: &[f64], scale: &[f64]) -> DMatrix<f64> {
    let p = scale.len();
    let column = |k: usize| &factor[k * (k + 1) / 2..][..=k];
    let mut gram = DMatrix::zeros(p, p);
    for k in 0..p {
        for i in 0..=k {
            let own: f64 = column(i).iter().zip(column(k)).map(|(a, b)| a * b).sum();
            gram[(i, k)] = own * scale[i] * scale[k];
            gram[(k, i)] = gram[(i, k)];
        }
    }
    gram
}

/// Centre: pooled least squares. Scale: the average informed test has unit information on each state.
fn frame(reductions: &[Reduction], order: &[usize], elements: &Elements, regressors: usize) -> Frame {
    let p = elements.states();
    let unit = vec![1.0; p];
    let mut information = DMatrix::zeros(p, p);
    let mut informed = vec![0.0; p];
    let mut y = DVector::zeros(p);
    let mut squares = vec![0.0; regressors];
    for &j in order {
        let factor = unpack(&reductions[j].factor, p);
        let own = match elements.is_single() {
            true => factor.transpose() * &factor,
            false => scaled_gram(&reductions[j].factor, &unit),
        };
        for i in 0..p {
            informed[i] += f64::from(u8::from(own[(i, i)] > 0.0));
        }
        y += factor.transpose() * DVector::from_column_slice(&reductions[j].data);
        information += own;
        squares.iter_mut().zip(&reductions[j].covariates).for_each(|(s, x)| *s += x * x);
    }
    let scale: Vec<f64> = (0..p)
        .map(|i| if information[(i, i)] > 0.0 { (informed[i] / information[(i, i)]).sqrt() } else { 1.0 })
        .collect();
    let scaled = DMatrix::from_fn(p, p, |i, j| scale[i] * information[(i, j)] * scale[j]);
    let right = DVector::from_fn(p, |i, _| scale[i] * y[i]);
    let solution = symmetric::pseudo_solve(&scaled, &right);
    let centre = (0..p).map(|i| scale[i] * solution[i]).collect();
    let n = order.len().max(1) as f64;
    let covariate_scale = squares.iter().map(|&s| if s > 0.0 { (s / n).sqrt() } else { 1.0 }).collect();
    Frame { centre, scale, covariate_scale }
}

fn gather(reductions: &[Reduction], members: &[usize], frame: &Frame, (elements, chained): (&Elements, bool)) -> Class {
    let (first, p) = (&reductions[members[0]], elements.states());
    if chained && first.chain.is_some() {
        return gather_chains(reductions, members, frame, elements);
    }
    let user = unpack(&first.factor, p);
    let offset = &user * DVector::from_column_slice(&frame.centre);
    let count = members.len() as f64;
    let centred = |j: usize| DVector::from_column_slice(&reductions[j].data) - &offset;
    let mut mean = DVector::zeros(p);
    for &j in members {
        mean += centred(j);
    }
    mean /= count;
    let scatter = (members.len() > 1).then(|| {
        let mut scatter = DMatrix::zeros(p, p);
        for &j in members {
            let away = centred(j) - &mean;
            scatter += &away * away.transpose();
        }
        rows(&scatter)
    });
    Class {
        count,
        constant: members.iter().map(|&j| reductions[j].constant).sum(),
        factor: rows(&DMatrix::from_fn(p, p, |i, k| user[(i, k)] * frame.scale[k])),
        mean: mean.as_slice().to_vec(),
        scatter,
        covariates: covariates(first, frame),
        square_root: members.iter().any(|&j| reductions[j].path == Path::SquareRoot),
        chain: None,
    }
}

fn gather_chains(reductions: &[Reduction], members: &[usize], frame: &Frame, elements: &Elements) -> Class {
    let members: Vec<&Reduction> = members.iter().map(|&j| &reductions[j]).collect();
    let constant =
        |r: &&Reduction| r.chain.iter().flat_map(|chain| &chain.phases).map(|phase| phase.constant).sum::<f64>();
    Class {
        count: members.len() as f64,
        constant: members.iter().map(constant).sum(),
        factor: Vec::new(),
        mean: Vec::new(),
        scatter: None,
        covariates: covariates(members[0], frame),
        square_root: false,
        chain: Some(Box::new(Chained::new(&members, elements.blocks(), frame))),
    }
}

/// Covariates in units of the frame.
fn covariates(reduction: &Reduction, frame: &Frame) -> Vec<f64> {
    reduction.covariates.iter().zip(&frame.covariate_scale).map(|(x, s)| x / s).collect()
}

/// The packed R of a reduction as a matrix.
pub(crate) fn unpack(factor: &[f64], p: usize) -> DMatrix<f64> {
    DMatrix::from_fn(p, p, |i, k| if i <= k { factor[i + k * (k + 1) / 2] } else { 0.0 })
}

fn rows(matrix: &DMatrix<f64>) -> Vec<f64> {
    matrix.transpose().as_slice().to_vec()
}
