//! Settings of a search, reports of its progress, and the reasons why it stops.

/// The algorithm that estimates μ and Σ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Solver {
    /// Fisher scoring, then Newton's method with the exact Hessian in (μ, L), EM as safeguard.
    #[default]
    Newton,
    /// The paper's DL algorithm, (8)-(11), with its constrained forms.
    Em,
}

/// What is maximised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Criterion {
    /// ℓ(μ, Σ).
    #[default]
    Ml,
    /// The restricted log-likelihood ℓ_R(Σ) = ℓ(μ̂(Σ), Σ) - ½ log|Σ_j B'W_jB| + ½ q log 2π, with μ = m0 + Bβ in the
    /// user's units and q = dim β, regression coefficients included; μ̂ is that of generalised least squares.
    /// Directions of β that no test informs are left out of the determinant (the product of its non-zero eigenvalues is
    /// meant) and of q.
    Reml,
}

/// How the phases of a test are combined (theory §7). For tests in one phase all three are identical.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Combination {
    /// Phase by phase, at a cost linear in the number of phases. Exact.
    #[default]
    Chain,
    /// All phases as one big test: the reference. Exact.
    Stacked,
    /// Each phase by its least-squares differences from the phase before, with their correlation over phases ignored:
    /// the paper's quick analysis. It discards information but approximates nothing.
    Marginal,
}

/// Settings of a fit of μ and Σ.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The algorithm.
    pub solver: Solver,
    /// What is maximised.
    pub criterion: Criterion,
    /// How the phases of a test are combined.
    pub phases: Combination,
    /// Newton decrement at which the search stops: the distance to the optimum in standard errors. Where rounding keeps
    /// every step from raising ℓ, a hundred times as much is accepted.
    pub tolerance: f64,
    /// Largest number of passes over the reductions.
    pub max_passes: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            solver: Solver::Newton,
            criterion: Criterion::Ml,
            phases: Combination::Chain,
            tolerance: 1e-8,
            max_passes: 200,
        }
    }
}

impl Settings {
    /// Default settings of a solver: EM needs many more passes than Newton's method.
    pub fn of(solver: Solver) -> Settings {
        let max_passes = match solver {
            Solver::Newton => 200,
            Solver::Em => 20_000,
        };
        Settings { solver, max_passes, ..Settings::default() }
    }
}

/// The state of the search after an accepted step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Passes over the reductions so far.
    pub passes: usize,
    /// Log-likelihood after the step.
    pub log_likelihood: f64,
    /// Newton decrement, if known: distance to the optimum in standard errors.
    pub decrement: Option<f64>,
}

/// Work of a search between its steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stage<'a> {
    /// Start values of free parameters are sought.
    StartValues {
        /// Filter runs spent on start values so far.
        filter_runs: usize,
    },
    /// The filters run over all data, at new values of free parameters.
    Filters {
        /// Filter runs of the search so far.
        filter_runs: usize,
    },
    /// EM over free parameters gains slowly, and another method would take far fewer filter runs.
    Slow,
    /// An end of an interval by profile likelihood is sought.
    Interval {
        /// The quantity that the interval is for: `` `tau` ``, or ``the mean of `bias` ``.
        of: &'a str,
        /// Whether the upper end is sought, not the lower one.
        is_upper: bool,
        /// Filter runs since the search ended; zero where α is known.
        filter_runs: usize,
    },
}

/// Receives the progress of the search and of the inference after it, the latter in whichever thread does the work.
pub trait Progress: Send {
    /// Called when something begins that may take long, before the first step and between steps.
    fn stage(&mut self, _: Stage<'_>) {}

    /// Called after each accepted step.
    fn step(&mut self, step: Step);

    /// True once the search is to stop, with `Stop::Interrupted`. It is called
    /// between steps; before each filter run for intervals by profile likelihood, which intervals from standard errors
    /// then replace; and while the expected information is computed, which the observed information then replaces.
    fn stops(&self) -> bool {
        false
    }
}

/// Ignores all reports.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn step(&mut self, _: Step) {}
}

/// Why the search stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The certificate holds.
    Certified,
    /// The limit of passes was reached first.
    PassLimit,
    /// `Progress::stops` returned true.
    Interrupted,
    /// No step raises ℓ, yet the certificate does not hold.
    Stalled,
}
