//! Conversion of an estimate and its inference to the record.

use rayon::prelude::*;

use crate::cut::{BlockCut, phases_of};
use crate::diagnosis::shortage_notes;
use crate::directions::crossing_notes;
use crate::few_tests;
use crate::heterogeneity::HeterogeneityRecord;
use crate::number::plain;
use crate::own::{MOST_SINGLE_ESTIMATES, TestEstimate};
use crate::phases::phases_and_levels;
use crate::test::TestFigures;
use crate::{
    CertificateRecord, ConstraintRecord, DataRecord, DeletedRecord, DeletionRecord, EstimatesRecord, FitRecord,
    ParameterRecord, SolverRecord, TestRecords, parameters,
};
use kalfit_algebra::elements::Element;
use kalfit_estimate::{Certificate, Combination, Counts, Criterion, Estimate, Solver, Stop};
use kalfit_filter::reduce::Reductions;
use kalfit_infer::{Deletion, Distance, Inference, IntervalKind, Sensitivity, StdErrors, heterogeneity};
use kalfit_model::Labels;
use kalfit_model::{Alpha, PhasedModel, Slots};

/// Number of significant digits of figures in notes.
const NOTE_DIGITS: usize = 4;

/// Facts about a fit that the core does not know.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Provenance {
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// The model in words and equations, one fact a line.
    pub model: Vec<String>,
    /// Data files, as named by the user.
    pub files: Vec<String>,
    /// Wall time.
    pub seconds: f64,
    /// Whether estimates of some filter replace the measurements of a phase, so that ℓ is not of the measurements.
    pub of_estimates: bool,
}

impl FitRecord {
    /// The record of a fit of μ and Σ at a known α.
    pub fn new(
        model: &PhasedModel,
        alpha: &Alpha,
        reductions: &Reductions,
        estimate: &Estimate,
        inference: &Inference,
        provenance: Provenance,
    ) -> FitRecord {
        let parameters = parameters::fixed(model.shared(), alpha);
        FitRecord::at(model, reductions, estimate, inference, (parameters, None), provenance)
    }

    /// The record of a fit of μ and Σ. `parameters`: records of the dynamic parameters; `slots`: slots of the free
    /// parameters, with the labels of the levels.
    pub(super) fn at(
        model: &PhasedModel,
        reductions: &Reductions,
        estimate: &Estimate,
        inference: &Inference,
        (parameters, slots): (Vec<ParameterRecord>, Option<(&Slots, &Labels)>),
        provenance: Provenance,
    ) -> FitRecord {
        let data = data(reductions, provenance.files);
        let free = estimate.declared_mean() + estimate.declared_covariance(); // as lme4 counts them
        let log_likelihood = estimate.log_likelihood;
        let of_estimates = provenance.of_estimates || has_filter_estimates(model, reductions);
        let comparable = !of_estimates && estimate.composite.is_none();
        let penalty = |per: f64| comparable.then_some(free as f64 * per - 2.0 * log_likelihood);
        let (phases, levels, crossed) = phases_and_levels(model, estimate, inference, reductions);
        let estimates = estimates(model, inference, slots);
        FitRecord {
            schema: "kalfit-fit/1".to_owned(),
            kalfit_version: env!("CARGO_PKG_VERSION").to_owned(),
            title: model.shared().title.clone(),
            model_digest: provenance.model_digest,
            model: provenance.model,
            criterion: match estimate.criterion {
                Criterion::Ml => "ml".to_owned(),
                Criterion::Reml => "reml".to_owned(),
            },
            log_likelihood_kind: if of_estimates { "estimates" } else { "measurements" }.to_owned(),
            log_likelihood,
            composite_log_likelihood: estimate.composite.filter(|x| x.is_finite()),
            free_parameters: free,
            aic: penalty(2.0),
            bic: if data.observations > 0 { penalty((data.observations as f64).ln()) } else { None },
            converged: estimate.stop == Stop::Certified,
            reason: reason(estimate),
            certificate: certificate(estimate),
            model_check: None,
            misfit: None,
            search: None,
            solver: solver(estimate, provenance.seconds),
            std_errors: std_errors(inference).to_owned(),
            intervals: intervals(inference).to_owned(),
            df_method: few_tests::method(inference).map(str::to_owned),
            heterogeneity: match (slots, phases.first()) {
                (None, Some(phase)) => {
                    let law = estimates.as_ref().and_then(|known| known.few_tests.as_ref());
                    heterogeneity(estimate, reductions).map(|found| HeterogeneityRecord::new(&found, phase, law))
                }
                _ => None,
            },
            phases,
            levels,
            crossed,
            groups: Vec::new(),
            parameters,
            estimates,
            starts: Vec::new(),
            methods: Vec::new(),
            constraints: constraints(model, &inference.sensitivities),
            tests: tests(model, reductions, inference),
            group_column: None,
            by_group: Vec::new(),
            group_test: None,
            notes: notes(model, estimate, inference),
            data,
        }
    }
}

impl DataRecord {
    /// Counts of the data behind reductions.
    pub fn of(reductions: &Reductions, files: Vec<String>) -> DataRecord {
        data(reductions, files)
    }
}

fn data(reductions: &Reductions, files: Vec<String>) -> DataRecord {
    let Counts { tests, steps, observations, square_root_tests, designs } = Counts::of(reductions);
    DataRecord { tests, steps, observations, design_classes: designs, square_root_tests, files }
}

/// The record of the certificate. A score below the rounding error has no meaning, so the rounding error is recorded
/// instead.
/// The covariance of all estimates, with the laws of few tests.
fn estimates(model: &PhasedModel, inference: &Inference, slots: Option<(&Slots, &Labels)>) -> Option<EstimatesRecord> {
    let few_tests = inference.few_tests.as_ref().and_then(|found| found.as_ref().ok()?.law.exported());
    Some(EstimatesRecord::new(model, inference.estimates.as_ref()?, few_tests, slots))
}

fn certificate(estimate: &Estimate) -> CertificateRecord {
    let Certificate { mean, covariance, null_space, rounding, .. } = estimate.certificate;
    let least = |score: f64, free: usize| if free > 0 { score.max(rounding) } else { score };
    CertificateRecord {
        mean: least(mean, estimate.declared_mean()),
        covariance: least(covariance, estimate.declared_covariance()),
        null_space,
        parameters: 0.0,
        rounding,
    }
}

pub(super) fn reason(estimate: &Estimate) -> String {
    let far = estimate.certificate.distance();
    match estimate.stop {
        Stop::Certified => format!("the optimality conditions hold: within {far:.1e} standard errors of the optimum"),
        Stop::PassLimit => format!(
            "the search reached its limit of iterations ({}) about {far:.1e} standard errors from the optimum",
            estimate.passes
        ),
        Stop::Interrupted => format!(
            "the search was interrupted after {} iterations, about {far:.1e} standard errors from the optimum",
            estimate.passes
        ),
        Stop::Stalled if !estimate.certificate.is_precise() => {
            format!(
                "rounding errors of up to about {:.1e} standard errors remain in the estimates",
                estimate.certificate.rounding
            )
        }
        Stop::Stalled => format!(
            "no step increases the log-likelihood, but the optimality conditions do not hold ({far:.1e} standard errors away)"
        ),
    }
}

fn solver(estimate: &Estimate, seconds: f64) -> SolverRecord {
    SolverRecord {
        method: "hybrid".to_owned(),
        solver: match estimate.solver {
            Solver::Newton => "newton".to_owned(),
            Solver::Em => "em".to_owned(),
        },
        phases: match estimate.state.settings.phases {
            Combination::Chain => "chain".to_owned(),
            Combination::Stacked => "stacked".to_owned(),
            Combination::Marginal => "marginal".to_owned(),
        },
        iterations: estimate.passes,
        filter_passes: 1,
        score_passes: 0,
        trace: estimate.trace.clone(),
        seconds,
    }
}

fn std_errors(inference: &Inference) -> &'static str {
    match inference.std_errors {
        StdErrors::Observed => "observed",
        StdErrors::Expected => "expected",
        StdErrors::Sandwich => "sandwich",
    }
}

fn intervals(inference: &Inference) -> &'static str {
    match inference.intervals.kind {
        IntervalKind::Auto | IntervalKind::Wald => "wald",
        IntervalKind::Profile => "profile",
        IntervalKind::Bootstrap => "bootstrap",
    }
}

fn constraints(model: &PhasedModel, sensitivities: &[Sensitivity]) -> Vec<ConstraintRecord> {
    let cuts = BlockCut::blocks(model);
    let of = |sensitivity: &Sensitivity| {
        let (Element::Mean(first) | Element::Covariance(first, _)) = sensitivity.element;
        let cut = cuts.iter().find(|cut| cut.element(first).is_some()).expect("an element is of some phase");
        constraint(cut, sensitivity)
    };
    // that an effect does not exist is no constraint
    let exists = |sensitivity: &&Sensitivity| {
        let Element::Covariance(i, k) = sensitivity.element else { return true };
        let cut = cuts.iter().find(|cut| cut.element(i).is_some());
        let level = cut.and_then(|cut| Some((cut, cut.level?)));
        level.is_none_or(|(cut, level)| [i, k].iter().all(|e| level.has_effect(e - cut.elements.start)))
    };
    sensitivities.iter().filter(exists).map(of).collect()
}

fn constraint(cut: &BlockCut<'_>, sensitivity: &Sensitivity) -> ConstraintRecord {
    let names = cut.states();
    let name = |i: usize| &names[i - cut.elements.start];
    ConstraintRecord {
        element: match sensitivity.element {
            Element::Mean(i) => format!("mean[{}]", name(i)),
            Element::Covariance(i, j) => format!("covariance[{}, {}]", name(j), name(i)),
        },
        phase: cut.phase.name.clone(),
        level: cut.level.map(|level| level.name.clone()),
        value: sensitivity.value,
        sensitivity: Some(sensitivity.sensitivity),
        score_statistic: sensitivity.statistic,
        p_value: sensitivity.p_value,
        expected_change: sensitivity.expected_change,
        likelihood_ratio: sensitivity.ratio,
        likelihood_ratio_p_value: sensitivity.ratio_p_value,
        f: sensitivity.f.map(|f| f.value),
        f_df: sensitivity.f.and_then(|f| f.df_den),
        f_p_value: sensitivity.f.map(|f| f.p_value),
    }
}

fn tests(model: &PhasedModel, reductions: &Reductions, inference: &Inference) -> TestRecords {
    if inference.posteriors.is_empty() {
        return TestRecords::default(); // not requested
    }
    let cuts = BlockCut::all(model);
    let mut order: Vec<usize> = (0..reductions.len()).collect();
    order.par_sort_by(|&a, &b| reductions.id(a).cmp(reductions.id(b)));
    let classes = DesignClasses::new(reductions, &order);
    let with_estimates = if order.len() <= MOST_SINGLE_ESTIMATES { &order[..] } else { &[] };
    let own: Vec<TestEstimate> = with_estimates.par_iter().map(|&j| TestEstimate::of(reductions.get(j))).collect();
    let mut tests = TestRecords::with_room(order.len(), cuts.iter().map(|cut| cut.elements.len()));
    for (place, j) in order.into_iter().enumerate() {
        let (reduction, posterior) = (reductions.get(j), inference.posteriors.get(j));
        let Distance { squared, degrees_of_freedom, p_value } = posterior.distance;
        let figures = TestFigures {
            log_likelihood: posterior.log_likelihood,
            observations: reduction.observations,
            steps: Some(reduction.steps),
            design_class: classes.number(reduction.design),
            distance: (degrees_of_freedom > 0).then_some(squared),
            degrees_of_freedom,
            p_value,
        };
        let deletion = inference.deletions.as_ref().and_then(|all| all[j].as_ref());
        tests.push(reduction.test, figures, deletion.map(|without| DeletionRecord::new(model, without)));
        for cut in &cuts[..phases_of(reduction, model)] {
            let (mean, covariance) = (&posterior.mean[cut.elements.clone()], posterior.covariance_rows(cut.index));
            let own = own.get(place).and_then(|own| own.part(cut));
            tests.phases.push(&cut.phase.name, (mean, covariance), own);
        }
    }
    tests
}

/// Whether a test has a phase in which estimates of a filter replace the measurements.
fn has_filter_estimates(model: &PhasedModel, reductions: &Reductions) -> bool {
    let has = |phase: usize| {
        reductions.remote().is_some() || reductions.iter().any(|reduction| phases_of(reduction, model) > phase)
    };
    model.phases.iter().enumerate().any(|(i, phase)| phase.filter.is_some() && has(i))
}

/// (Digest of the design, number of the class) of each design class, sorted by digest. Numbers start at 1, in the order
/// of the tests.
struct DesignClasses(Vec<(u128, usize)>);

impl DesignClasses {
    fn new(reductions: &Reductions, order: &[usize]) -> DesignClasses {
        let mut first: Vec<(u128, usize)> =
            order.par_iter().map(|&j| reductions.get(j).design).zip(0..order.len()).collect();
        first.par_sort_unstable();
        first.dedup_by_key(|(design, _)| *design); // the first test of each class remains
        let mut places: Vec<usize> = first.iter().map(|(_, place)| *place).collect();
        places.par_sort_unstable();
        let number = |place: usize| places.partition_point(|other| *other < place) + 1;
        DesignClasses(first.into_par_iter().map(|(design, place)| (design, number(place))).collect())
    }

    fn number(&self, design: u128) -> Option<usize> {
        let at = self.0.binary_search_by_key(&design, |(known, _)| *known).ok()?;
        Some(self.0[at].1)
    }
}

impl DeletionRecord {
    /// The record of a fit without a test or a group.
    pub(super) fn new(model: &PhasedModel, deletion: &Deletion) -> DeletionRecord {
        let Deletion { estimate, log_density, distance, displacement } = deletion;
        let of = |cut: &BlockCut<'_>| DeletedRecord {
            name: cut.name().to_owned(),
            mean: if cut.level.is_none() { cut.list(&estimate.mean) } else { Vec::new() },
            regression: estimate.coefficients[cut.regressions.clone()].to_vec(),
            covariance: cut.block(&estimate.covariance),
        };
        DeletionRecord {
            log_density: *log_density,
            distance: (distance.degrees_of_freedom > 0).then_some(distance.squared),
            p_value: distance.p_value,
            displacement: *displacement,
            phases: BlockCut::blocks(model).iter().map(of).collect(),
        }
    }
}

/// Notes for the reader on facts that no single figure shows.
fn notes(model: &PhasedModel, estimate: &Estimate, inference: &Inference) -> Vec<String> {
    let Inference { unidentified, explanations, observability, uncertainty, .. } = inference;
    let mut notes: Vec<String> = rounding_note(model, estimate).into_iter().collect();
    notes.extend(crossing_notes(model, unidentified, explanations, observability));
    notes.extend(shortage_notes(model, observability));
    for (i, name) in model.element_names().iter().enumerate() {
        let variance = estimate.covariance[(i, i)];
        if let Some(error) = uncertainty.errors.covariance[i][i].filter(|e| *e >= variance) {
            notes.push(format!(
                "the variance of `{name}` is weakly determined: its standard error ({}) is no smaller than the variance itself ({})",
                plain(error, NOTE_DIGITS),
                plain(variance, NOTE_DIGITS)
            ));
        }
    }
    notes.extend(few_tests::notes(model, estimate, inference));
    let without = inference.intervals.unprofiled;
    if without > 0 {
        let come = if without == 1 { "interval comes" } else { "intervals come" };
        notes.push(format!(
            "{without} {come} from standard errors instead of the profile likelihood: with free parameters, profiles are limited to 60 quantities of mean and covariance with up to 24 free values, and to 40 free values themselves; covariances that depend on a parameter and covariances of noises have none"
        ));
    }
    notes
}

/// Note on rounding errors that are larger than the error of the search; `None` where the rounding errors are smaller.
fn rounding_note(model: &PhasedModel, estimate: &Estimate) -> Option<String> {
    let certificate = &estimate.certificate;
    if !certificate.is_limited_by_rounding() {
        return None;
    }
    let parts = estimate.state.rounding();
    let worst = (0..parts.len()).max_by(|&a, &b| parts[a].total_cmp(&parts[b]).then(b.cmp(&a)))?;
    let (names, p) = (model.element_names(), estimate.mean.len());
    let cause = match worst.checked_sub(p) {
        None => format!(
            "the mean of `{}`, {:.1e}, is very large compared with its standard error, so digits are lost by cancellation; subtract a constant from the measured column",
            names[worst], estimate.mean[worst]
        ),
        Some(c) => format!(
            "the regression of `{}` adds very large numbers that cancel; subtract a constant from its column",
            names[estimate.state.problem.mean.regressors[c]]
        ),
    };
    Some(format!(
        "rounding errors of up to about {:.1e} standard errors remain in mean and covariance: {cause}",
        certificate.rounding
    ))
}
