//! The best plan among candidates, with what it will tell: figures, their expected standard errors, and how good the plan is
//! (theory §15).

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::plan::Quantity;
use crate::plan::mission::MissionValue;
use crate::plan::optimal::{Criterion, Kinds, PlanProblem, Relaxed, Scenario, WholePlan, in_whole_numbers, relax};
use crate::plan::range::Range;
use kalfit_infer::dynamic::UnitInformation;
use kalfit_infer::{Estimand, Estimated, Knowledge};
use kalfit_model::Slots;

/// Figures depend on each other where the Gram matrix of their unit derivatives has an eigenvalue below this: they differ by
/// 1e-5 or less, which rounding of derivatives by differences can make.
const DEPENDENT: f64 = 1e-10;
/// Degrees of freedom from which quantiles of Student's t equal those of the normal law to five digits.
const MANY_DEGREES: f64 = 1e6;
/// The fraction of a test of each candidate that is added to a plan where gains are compared, since gains have no value at a
/// singular information.
const LITTLE: f64 = 1e-4;

/// A number that a plan is to make known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// A mean, coefficient, standard deviation, correlation or covariance.
    Quantity(Quantity),
    /// A free value of α, by slot.
    Value(usize),
    /// The mean of a value of a mission, by its index.
    Output(usize),
    /// The limit of a value of a mission below which 95 % of all tests stay, by its index.
    Limit(usize),
}

/// A goal says what the best plan makes known best.
#[derive(Debug, Clone, PartialEq)]
pub enum Goal {
    /// All free values together: the determinant of their information.
    All,
    /// Figures, each with the size that its standard error is compared with: the sum of the squared ratios.
    Figures(Vec<(Figure, f64)>),
    /// Figures together: the determinant of their covariance.
    FiguresTogether(Vec<Figure>),
}

/// The information of the candidates at one set of parameters.
#[derive(Debug, Clone)]
pub struct CandidateInformation {
    /// Expected information of one test of each candidate.
    pub candidates: UnitInformation,
    /// Information that is there before, of tests that were made or of a fit: rows as of the candidates'.
    so_far: DMatrix<f64>,
    /// Information of each unit of tests that were made.
    made: Vec<DMatrix<f64>>,
    /// Number of tests, or units, of a fit that is known.
    fitted: f64,
    /// Values of a mission.
    mission: Vec<MissionValue>,
}

/// Why there is no best plan.
#[derive(Debug, Clone, PartialEq)]
pub enum NoPlan {
    /// The model fixes a figure.
    Fixed(Figure),
    /// No candidate informs some figures, and nothing was known before.
    Uninformed(Vec<Figure>),
    /// The budget is below the cost of the cheapest candidate.
    Budget {
        /// The cost of the cheapest.
        cheapest: f64,
    },
    /// The figures that are to be known together depend on each other.
    Dependent,
    /// The model leaves nothing free that could be asked for.
    NothingFree,
    /// No plan in whole numbers within the budget determines what is to be known.
    TooLittle,
}

/// A figure with its expected standard errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlannedFigure {
    /// The figure.
    pub figure: Figure,
    /// Value of the figure at the parameters that are planned for.
    pub value: Option<f64>,
    /// Standard error of the figure before any test of the plan; `None` where nothing determines the figure.
    pub before: Option<f64>,
    /// Standard error of the figure after all tests of the plan; `None` where the plan does not determine the figure.
    pub after: Option<f64>,
    /// Degrees of freedom of a mean or coefficient after the plan (14.8), where tests are independent.
    pub df: Option<f64>,
    /// The candidate of which one more unit of cost makes it better known than of any other.
    pub informed_by: Option<usize>,
}

/// The best plan.
#[derive(Debug, Clone, PartialEq)]
pub struct BestPlan {
    /// The best plan in any numbers.
    pub relaxed: Relaxed,
    /// The best plan in whole numbers that was found.
    pub whole: WholePlan,
    /// ⟨G, F_k⟩ · budget / c_k at the relaxed plan, the function of the equivalence theorem.
    pub sensitivities: Vec<f64>,
    /// The term that log φ gains when the information is stated in the user's units.
    pub offset: f64,
    /// All figures that the model leaves free.
    pub figures: Vec<PlannedFigure>,
}

impl BestPlan {
    /// Least efficiency of the plan in whole numbers against any plan within the budget: φ over the bound of (15.4).
    pub fn efficiency(&self, scenarios: usize) -> f64 {
        let bound = if scenarios == 1 { self.relaxed.gap.max(0.0).ln_1p() } else { self.relaxed.gap.max(0.0) };
        (self.whole.log_phi - self.relaxed.log_phi - bound).exp().min(1.0)
    }
}

impl CandidateInformation {
    /// Candidates of which nothing is known before.
    pub fn new(candidates: UnitInformation) -> CandidateInformation {
        let size = candidates.jacobian.nrows();
        CandidateInformation {
            candidates,
            so_far: DMatrix::zeros(size, size),
            made: Vec::new(),
            fitted: 0.0,
            mission: Vec::new(),
        }
    }

    /// With the values of a mission among the figures.
    #[must_use]
    pub fn with_mission(self, mission: Vec<MissionValue>) -> CandidateInformation {
        CandidateInformation { mission, ..self }
    }

    /// With tests that were made already, about the same values of α.
    #[must_use]
    pub fn after_tests(mut self, made: &UnitInformation) -> CandidateInformation {
        made.units.iter().for_each(|unit| self.so_far += unit);
        self.made.extend(made.units.iter().cloned());
        self
    }

    /// With what a fit knows already; `slots`: the free values of α.
    #[must_use]
    pub fn after_fit(mut self, knowledge: &Knowledge, slots: &Slots) -> CandidateInformation {
        self.so_far += of_estimates(knowledge, slots, &self.candidates);
        self.fitted += knowledge.tests;
        self
    }

    /// The values of the mission.
    pub fn mission(&self) -> &[MissionValue] {
        &self.mission
    }

    /// The derivatives of a figure by the free coordinates.
    pub fn gradient(&self, figure: Figure) -> DVector<f64> {
        match figure {
            Figure::Quantity(quantity) => self.candidates.gradient(quantity),
            Figure::Value(slot) => self.candidates.gradient_of_value(slot),
            Figure::Output(at) => self.mission[at].gradients[0].clone(),
            Figure::Limit(at) => self.mission[at].gradients[1].clone(),
        }
    }

    fn value(&self, figure: Figure) -> Option<f64> {
        match figure {
            Figure::Quantity(quantity) => self.candidates.value(quantity),
            Figure::Value(slot) => Some(self.candidates.value_of(slot)),
            Figure::Output(at) => Some(self.mission[at].values[0]),
            Figure::Limit(at) => Some(self.mission[at].values[1]),
        }
    }

    /// Information about the free coordinates of so many tests of each candidate and of what is there already.
    fn of_plan(&self, numbers: &[f64]) -> DMatrix<f64> {
        let of = |(unit, n): (&DMatrix<f64>, &f64)| unit * *n;
        let made = self.candidates.units.iter().zip(numbers).filter(|(_, n)| **n > 0.0).map(of);
        self.free(&made.fold(self.so_far.clone(), |sum, one| sum + one))
    }

    /// An information in the user's units, about the free coordinates.
    fn free(&self, information: &DMatrix<f64>) -> DMatrix<f64> {
        let jacobian = &self.candidates.jacobian;
        jacobian.tr_mul(information) * jacobian
    }

    /// Standard error of each figure from an information about the free coordinates; `None` where it is not determined.
    pub fn std_errors(&self, information: &DMatrix<f64>, figures: &[Figure]) -> Vec<Option<f64>> {
        let range = Range::of(information);
        figures.iter().map(|&figure| range.variance(&self.gradient(figure)).map(f64::sqrt)).collect()
    }

    /// The coordinates that candidates inform, or that are known already. Each candidate counts by the size of its own
    /// information: how many tests of it there are makes no difference to what it informs.
    fn range(&self) -> Range {
        let one_of_each = self.of_plan(&vec![1.0; self.candidates.units.len()]);
        let sizes: Vec<f64> = one_of_each.diagonal().iter().map(|x| x.max(0.0).sqrt()).collect();
        let sized = |information: &DMatrix<f64>| {
            let of = |i: usize| if sizes[i] > 0.0 { information[(i, i)] / (sizes[i] * sizes[i]) } else { 0.0 };
            let largest = (0..sizes.len()).map(of).fold(0.0, f64::max);
            if largest > 0.0 { information / largest } else { information.clone() }
        };
        let all = self.candidates.units.iter().chain([&self.so_far]).map(|unit| sized(&self.free(unit)));
        Range::of(&all.fold(DMatrix::zeros(sizes.len(), sizes.len()), |sum, one| sum + one))
    }

    /// Standard errors that one test of each candidate, with what is there already, would give: sizes to compare figures
    /// with before there is a plan.
    pub fn one_of_each(&self, figures: &[Figure]) -> Vec<Option<f64>> {
        self.std_errors(&self.of_plan(&vec![1.0; self.candidates.units.len()]), figures)
    }

    /// For each figure, the candidate of which one more unit of cost after a plan lessens its variance most; where the plan
    /// does not determine it, a little information of all candidates is added.
    fn informed_by(&self, numbers: &[f64], kinds: &Kinds, figures: &[Figure]) -> Vec<Option<usize>> {
        let all: Vec<f64> = numbers.iter().map(|n| n + LITTLE).collect();
        let range = Range::of(&self.of_plan(&all));
        let inverse = range.inverse();
        let of = |&figure: &Figure| {
            let gradient = self.gradient(figure);
            range.variance(&gradient)?;
            let weights = &self.candidates.jacobian * (&inverse * gradient);
            let gain = |k: usize| weights.dot(&(&self.candidates.units[k] * &weights)) / kinds.costs[k];
            (0..kinds.costs.len()).max_by(|&a, &b| gain(a).total_cmp(&gain(b)).then(b.cmp(&a)))
        };
        figures.par_iter().map(of).collect()
    }

    /// Degrees of freedom of means and coefficients after a plan, ν = 2c²/(g'Vg), where tests are independent: with w the
    /// weights of the data in the estimate, g_a = Σ n_k w'F_k S_a F_k w (14.8). The tests of a fit, which are not here, count
    /// as equal to those of the plan: one degree of freedom less than tests. None where tests are in groups.
    fn degrees_of_freedom(&self, numbers: &[f64], figures: &[Figure]) -> Vec<Option<f64>> {
        if self.candidates.members.iter().any(|members| members.len() > 1) {
            return vec![None; figures.len()];
        }
        let (own, first) = (&self.candidates, self.candidates.values());
        let (means, p) = (own.means(), own.population().mean.len());
        let range = Range::of(&self.of_plan(numbers));
        let inverse = range.inverse();
        let by_coordinates = own.jacobian.rows(first, means);
        let of_sigma = own.jacobian.rows(first + means, own.jacobian.nrows() - first - means);
        let tests: f64 = numbers.iter().sum::<f64>() + self.made.len() as f64 + self.fitted;
        let of = |figure: &Figure| {
            let Figure::Quantity(Quantity::Mean(_) | Quantity::Coefficient(_)) = figure else { return None };
            let gradient = self.gradient(*figure);
            let c = range.variance(&gradient)?;
            if self.fitted > 0.0 {
                return Some(tests - 1.0).filter(|df| *df >= 1.0);
            }
            let weights = by_coordinates * (&inverse * gradient);
            let mut products = DMatrix::zeros(p, p);
            let made = self.made.iter().map(|unit| (unit, &1.0));
            for (unit, n) in own.units.iter().zip(numbers).filter(|(_, n)| **n > 0.0).chain(made) {
                let along = unit.view((first, first), (p, means)) * &weights;
                products.ger(*n, &along, &along, 1.0);
            }
            let slope = |(i, j): (usize, usize)| if i == j { products[(i, i)] } else { 2.0 * products[(i, j)] };
            let slopes = DVector::from_iterator(of_sigma.nrows(), own.elements().map(slope));
            let g = of_sigma.tr_mul(&slopes);
            let variance = g.dot(&(&inverse * &g));
            // V is that of maximum likelihood, which does not allow for the estimated mean
            Some(2.0 * c * c / variance * (tests - 1.0) / tests).filter(|df| *df < MANY_DEGREES)
        };
        figures.iter().map(of).collect()
    }
}

/// The information that estimates with a known covariance stand for, in the rows of the candidates': the inverse of their
/// covariance.
fn of_estimates(knowledge: &Knowledge, slots: &Slots, candidates: &UnitInformation) -> DMatrix<f64> {
    let (size, first, p) = (candidates.jacobian.nrows(), candidates.values(), candidates.population().mean.len());
    let elements: Vec<(usize, usize)> = candidates.elements().collect();
    // the row of an estimate, and its derivative by the coordinate there
    let place = |known: &Estimand| match known {
        Estimand::Population(Estimated::Mean(i)) => Some((first + i, 1.0)),
        Estimand::Population(Estimated::Coefficient(c)) => Some((first + p + c, 1.0)),
        Estimand::Population(Estimated::Covariance(i, j)) => {
            let at = elements.iter().position(|own| own == &(*i.max(j), *i.min(j)))?;
            Some((first + candidates.means() + at, 1.0))
        }
        Estimand::Parameter { parameter, level: None } => {
            slots.common(*parameter).map(|slot| (slot, candidates.gradient_of_value(slot)[slot]))
        }
        Estimand::Population(Estimated::Value(_)) | Estimand::Parameter { .. } => None,
    };
    let known: Vec<(usize, (usize, f64))> =
        knowledge.quantities.iter().enumerate().filter_map(|(at, one)| Some((at, place(one)?))).collect();
    let covariance = DMatrix::from_fn(known.len(), known.len(), |a, b| {
        let ((i, (_, by_i)), (j, (_, by_j))) = (known[a], known[b]);
        knowledge.covariance[(i, j)] / by_i / by_j
    });
    let precision = Range::of(&covariance).inverse();
    let mut information = DMatrix::zeros(size, size);
    for (a, (_, (row, _))) in known.iter().enumerate() {
        for (b, (_, (column, _))) in known.iter().enumerate() {
            information[(*row, *column)] += precision[(a, b)];
        }
    }
    information
}

/// The best plan of candidates. `scenarios`: the information at the parameters that are planned for, then at others that
/// they may be; figures are those of the first.
///
/// # Errors
/// Why there is no plan.
pub fn best_plan(
    scenarios: &[CandidateInformation],
    kinds: &Kinds,
    goal: &Goal,
    figures: &[Figure],
) -> Result<BestPlan, NoPlan> {
    let first = &scenarios[0];
    let cheapest = kinds.costs.iter().copied().fold(f64::INFINITY, f64::min);
    if cheapest > kinds.budget * (1.0 + 1e-12) {
        return Err(NoPlan::Budget { cheapest });
    }
    let range = first.range();
    let wanted: Vec<Figure> = match goal {
        Goal::All => {
            let is_of_model = |figure: &&Figure| matches!(figure, Figure::Quantity(_) | Figure::Value(_));
            figures.iter().filter(is_of_model).copied().collect()
        }
        Goal::Figures(own) => own.iter().map(|(figure, _)| *figure).collect(),
        Goal::FiguresTogether(own) => own.clone(),
    };
    if wanted.is_empty() || range.dimension() == 0 {
        return Err(NoPlan::NothingFree);
    }
    let gradients: Vec<DVector<f64>> = wanted.iter().map(|&figure| first.gradient(figure)).collect();
    if let Some(fixed) = gradients.iter().position(|gradient| gradient.amax() == 0.0).filter(|_| *goal != Goal::All) {
        return Err(NoPlan::Fixed(wanted[fixed]));
    }
    let is_uninformed = |at: &usize| gradients[*at].amax() > 0.0 && range.variance(&gradients[*at]).is_none();
    let uninformed: Vec<Figure> = (0..wanted.len()).filter(is_uninformed).map(|at| wanted[at]).collect();
    if !uninformed.is_empty() {
        return Err(NoPlan::Uninformed(uninformed));
    }
    if matches!(goal, Goal::FiguresTogether(_)) && !are_independent(&gradients) {
        return Err(NoPlan::Dependent);
    }
    let scenario = |own: &CandidateInformation| {
        let map = &own.candidates.jacobian * range.map();
        let reduced = |information: &DMatrix<f64>| map.tr_mul(information) * &map;
        Scenario {
            base: reduced(&own.so_far),
            kinds: Arc::new(own.candidates.units.par_iter().map(reduced).collect()),
            criterion: criterion(own, goal, &range),
        }
    };
    let problem = PlanProblem { kinds: kinds.clone(), scenarios: scenarios.iter().map(scenario).collect() }.regular();
    let relaxed = relax(&problem).ok_or(NoPlan::TooLittle)?;
    let whole = in_whole_numbers(&problem, &relaxed).ok_or(NoPlan::TooLittle)?;
    // log |I| in the user's units, whatever the free coordinates are
    let offset = match goal {
        Goal::All => {
            let gram = first.candidates.jacobian.tr_mul(&first.candidates.jacobian);
            -(Range::of(&gram).log_determinant() + range.log_volume()) / range.dimension() as f64
        }
        _ => 0.0,
    };
    let before = first.std_errors(&first.free(&first.so_far), figures);
    let after = first.std_errors(&first.of_plan(&whole.numbers), figures);
    let df = first.degrees_of_freedom(&whole.numbers, figures);
    let informed_by = first.informed_by(&whole.numbers, kinds, figures);
    let planned = |at: usize| PlannedFigure {
        figure: figures[at],
        value: first.value(figures[at]),
        before: before[at],
        after: after[at],
        df: df[at],
        informed_by: informed_by[at],
    };
    let sensitivity = |k: usize| relaxed.gains[k] * kinds.budget / kinds.costs[k];
    Ok(BestPlan {
        sensitivities: (0..kinds.costs.len()).map(sensitivity).collect(),
        figures: (0..figures.len()).map(planned).collect(),
        relaxed,
        whole,
        offset,
    })
}

/// Whether no combination of the derivatives of figures vanishes.
fn are_independent(gradients: &[DVector<f64>]) -> bool {
    let units: Vec<DVector<f64>> = gradients.iter().map(|gradient| gradient / gradient.norm()).collect();
    let columns = DMatrix::from_columns(&units);
    let values = columns.tr_mul(&columns).symmetric_eigenvalues();
    values.min() > DEPENDENT
}

/// The criterion at one set of parameters, in the coordinates of the range.
fn criterion(own: &CandidateInformation, goal: &Goal, range: &Range) -> Criterion {
    let columns = |figures: &[(Figure, f64)]| {
        let gradients: Vec<DVector<f64>> =
            figures.iter().map(|(figure, size)| range.map().tr_mul(&own.gradient(*figure)) / *size).collect();
        DMatrix::from_columns(&gradients)
    };
    match goal {
        Goal::All => Criterion::Determinant,
        Goal::Figures(figures) => Criterion::Variances(columns(figures)),
        Goal::FiguresTogether(figures) => {
            Criterion::FigureDeterminant(columns(&figures.iter().map(|&figure| (figure, 1.0)).collect::<Vec<_>>()))
        }
    }
}
