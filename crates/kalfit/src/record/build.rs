//! From an estimate and its inference to the record.

use nalgebra::DMatrix;

use crate::estimate::{Criterion, Estimate, Solver, Stop};
use crate::infer::{Deletion, Element, Inference, IntervalKind, Sensitivity, StdErrors};
use crate::model::{Alpha, CovarianceKind, MeanElement, Model};
use crate::record::diagnosis::shortage_notes;
use crate::record::parameters;
use crate::record::{
    BoundaryRecord, CertificateRecord, ConstraintRecord, CovarianceRecord, DataRecord, DeletedRecord, DeletionRecord,
    FitRecord, Interval, MatrixRecord, MeanRecord, ObservabilityRecord, ParameterRecord, PhaseRecord, PosteriorRecord,
    RegressionRecord, ScaleRecord, SolverRecord, TestRecord, UnidentifiedRecord, VectorRecord, WeakRecord,
};
use crate::reduce::{Path, Reduction};

/// Name of the only phase of a single-phase model.
const MAIN: &str = "main";

/// What the core does not know about a fit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Provenance {
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// Data files, as named by the user.
    pub files: Vec<String>,
    /// Wall time.
    pub seconds: f64,
}

impl FitRecord {
    /// The record of a fit of μ and Σ at a known α.
    pub fn new(
        model: &Model,
        alpha: &Alpha,
        reductions: &[Reduction],
        estimate: &Estimate,
        inference: &Inference,
        provenance: Provenance,
    ) -> FitRecord {
        let parameters = parameters::fixed(model, alpha);
        FitRecord::at(model, reductions, estimate, inference, parameters, provenance)
    }

    /// The record of μ and Σ, with the parameters given as they are.
    pub(super) fn at(
        model: &Model,
        reductions: &[Reduction],
        estimate: &Estimate,
        inference: &Inference,
        parameters: Vec<ParameterRecord>,
        provenance: Provenance,
    ) -> FitRecord {
        let data = data(reductions, provenance.files);
        let free = estimate.declared_mean() + estimate.declared_covariance(); // as lme4 counts them
        let log_likelihood = estimate.log_likelihood;
        let penalty = |per: f64| Some(free as f64 * per - 2.0 * log_likelihood);
        FitRecord {
            schema: "kalfit-fit/1".to_owned(),
            kalfit_version: env!("CARGO_PKG_VERSION").to_owned(),
            title: model.title.clone(),
            model_digest: provenance.model_digest,
            criterion: match estimate.criterion {
                Criterion::Ml => "ml".to_owned(),
                Criterion::Reml => "reml".to_owned(),
            },
            log_likelihood_kind: "measurements".to_owned(),
            log_likelihood,
            free_parameters: free,
            aic: penalty(2.0),
            bic: if data.observations > 0 { penalty((data.observations as f64).ln()) } else { None },
            converged: estimate.stop == Stop::Certified,
            reason: reason(estimate),
            certificate: CertificateRecord {
                mean: estimate.certificate.mean,
                covariance: estimate.certificate.covariance,
                null_space: estimate.certificate.null_space,
                parameters: 0.0,
            },
            solver: solver(estimate, provenance.seconds),
            std_errors: std_errors(inference).to_owned(),
            intervals: intervals(inference).to_owned(),
            phases: vec![phase(model, estimate, inference)],
            parameters,
            starts: Vec::new(),
            methods: Vec::new(),
            constraints: inference.sensitivities.iter().map(|s| constraint(model, s)).collect(),
            tests: tests(reductions, inference),
            notes: notes(model, estimate, inference),
            data,
        }
    }
}

impl DataRecord {
    /// Counts of the data behind reductions.
    pub fn of(reductions: &[Reduction], files: Vec<String>) -> DataRecord {
        data(reductions, files)
    }
}

fn data(reductions: &[Reduction], files: Vec<String>) -> DataRecord {
    let mut designs: Vec<u128> = reductions.iter().map(|r| r.design).collect();
    designs.sort_unstable();
    designs.dedup();
    DataRecord {
        tests: reductions.len(),
        steps: reductions.iter().map(|r| r.steps).sum(),
        observations: reductions.iter().map(|r| r.observations).sum(),
        design_classes: designs.len(),
        square_root_tests: reductions.iter().filter(|r| r.path == Path::SquareRoot).count(),
        files,
    }
}

pub(super) fn reason(estimate: &Estimate) -> String {
    let far = estimate.certificate.decrement;
    match estimate.stop {
        Stop::Certified => format!("the optimality certificate holds: within {far:.1e} standard errors of the optimum"),
        Stop::PassLimit => format!(
            "the search ran out of passes ({}) about {far:.1e} standard errors from the optimum",
            estimate.passes
        ),
        Stop::Stalled => format!(
            "no step raises the log-likelihood, but the optimality certificate does not hold ({far:.1e} standard errors away)"
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
        phases: "chain".to_owned(),
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
        IntervalKind::Wald => "wald",
        IntervalKind::Profile => "profile",
    }
}

fn phase(model: &Model, estimate: &Estimate, inference: &Inference) -> PhaseRecord {
    let states = model.estimated_names();
    let names = |elements: &[usize]| elements.iter().map(|&i| states[i].clone()).collect::<Vec<_>>();
    let boundary = |b: &crate::infer::Boundary| BoundaryRecord {
        what: "covariance".to_owned(),
        rank: b.rank,
        of: b.states.len(),
        states: names(&b.states),
        zero_variances: names(&b.zero_variances),
    };
    PhaseRecord {
        name: MAIN.to_owned(),
        units: model.estimated.iter().map(|&s| model.states[s].unit.clone()).collect(),
        mean: mean(model, estimate, inference),
        covariance: covariance(model, estimate, inference),
        std_dev: VectorRecord {
            estimate: estimate.covariance.diagonal().iter().map(|v| v.max(0.0).sqrt()).collect(),
            std_error: inference.uncertainty.std_dev.clone(),
            interval95: inference.intervals.std_dev.clone(),
        },
        correlation: MatrixRecord {
            estimate: correlations(&estimate.covariance),
            std_error: inference.uncertainty.correlation.clone(),
            interval95: inference.intervals.correlation.clone(),
        },
        boundary: inference.uncertainty.boundary.iter().map(boundary).collect(),
        unidentified: UnidentifiedRecord::all(model, &inference.unidentified, &inference.explanations),
        observability: ObservabilityRecord::all(model, &inference.observability),
        weakly_determined: WeakRecord::all(&inference.observability),
        states,
    }
}

fn mean(model: &Model, estimate: &Estimate, inference: &Inference) -> MeanRecord {
    let structure = &model.mean;
    let errors = &inference.uncertainty.mean;
    let proportional = structure.elements.iter().enumerate().find_map(|(i, e)| match e {
        MeanElement::Proportional(weight) if *weight != 0.0 => Some((i, *weight)),
        _ => None,
    });
    let regression = |(c, r): (usize, &crate::model::Regression)| RegressionRecord {
        state: model.states[model.estimated[r.element]].name.clone(),
        column: model.columns[r.column].name.clone(),
        estimate: estimate.coefficients[c],
        std_error: inference.uncertainty.coefficients[c],
        interval95: inference.intervals.coefficients[c],
    };
    MeanRecord {
        estimate: estimate.mean.clone(),
        std_error: errors.clone(),
        interval95: inference.intervals.mean.clone(),
        fixed: structure.elements.iter().map(|e| matches!(e, MeanElement::Fixed(_))).collect(),
        scale: proportional.map(|(i, weight)| ScaleRecord {
            estimate: estimate.mean[i] / weight,
            std_error: errors[i].map(|e| e / weight.abs()),
            interval95: inference.intervals.mean[i].map(|ends| scaled(ends, weight.recip())),
        }),
        regression: structure.regression.iter().enumerate().map(regression).collect(),
    }
}

fn covariance(model: &Model, estimate: &Estimate, inference: &Inference) -> CovarianceRecord {
    let p = estimate.mean.len();
    let mut fixed = vec![vec![false; p]; p];
    for sensitivity in &inference.sensitivities {
        if let Element::Covariance(i, j) = sensitivity.element {
            fixed[i][j] = true;
            fixed[j][i] = true;
        }
    }
    let scale = matches!(model.covariance.kind, CovarianceKind::Proportional(_)).then(|| estimate.covariance_scale(0));
    CovarianceRecord {
        estimate: rows(&estimate.covariance),
        std_error: inference.uncertainty.covariance.clone(),
        interval95: inference.intervals.covariance.clone(),
        fixed,
        scale: scale.map(|beta| ScaleRecord {
            estimate: beta,
            std_error: inference.uncertainty.scale[0].map(|relative| relative * beta),
            interval95: scale_interval(estimate, inference, beta),
        }),
    }
}

/// The interval of β from that of the largest variance, which is in proportion.
fn scale_interval(estimate: &Estimate, inference: &Inference, beta: f64) -> Interval {
    let diagonal = estimate.covariance.diagonal();
    let i = (0..diagonal.len()).max_by(|&a, &b| diagonal[a].total_cmp(&diagonal[b]))?;
    let ends = inference.intervals.covariance[i][i]?;
    (diagonal[i] > 0.0).then(|| scaled(ends, beta / diagonal[i]))
}

/// Both ends times a factor, the lower one first.
fn scaled(ends: [Option<f64>; 2], factor: f64) -> [Option<f64>; 2] {
    let [a, b] = ends.map(|end| end.map(|x| x * factor));
    if factor < 0.0 { [b, a] } else { [a, b] }
}

fn correlations(sigma: &DMatrix<f64>) -> Vec<Vec<Option<f64>>> {
    let p = sigma.nrows();
    let entry = |i: usize, j: usize| {
        let unit = (sigma[(i, i)] * sigma[(j, j)]).sqrt();
        let inside = |r: f64| r.clamp(-1.0, 1.0);
        (unit > 0.0).then(|| if i == j { 1.0 } else { inside(sigma[(i, j)] / unit) })
    };
    (0..p).map(|i| (0..p).map(|j| entry(i, j)).collect()).collect()
}

fn constraint(model: &Model, sensitivity: &Sensitivity) -> ConstraintRecord {
    let name = |i: usize| &model.states[model.estimated[i]].name;
    ConstraintRecord {
        element: match sensitivity.element {
            Element::Mean(i) => format!("mean[{}]", name(i)),
            Element::Covariance(i, j) => format!("covariance[{}, {}]", name(j), name(i)),
        },
        phase: MAIN.to_owned(),
        value: sensitivity.value,
        sensitivity: Some(sensitivity.sensitivity),
        score_statistic: sensitivity.statistic,
        p_value: sensitivity.p_value,
        expected_change: sensitivity.expected_change,
    }
}

fn tests(reductions: &[Reduction], inference: &Inference) -> Vec<TestRecord> {
    let mut order: Vec<usize> = (0..reductions.len()).collect();
    order.sort_by(|&a, &b| reductions[a].test.cmp(&reductions[b].test));
    let record = |j: usize| {
        let (reduction, posterior) = (&reductions[j], &inference.posteriors[j]);
        let distance = posterior.distance;
        TestRecord {
            id: reduction.test.clone(),
            log_likelihood: posterior.log_likelihood,
            observations: reduction.observations,
            phases: vec![PosteriorRecord {
                name: MAIN.to_owned(),
                mean: posterior.mean.clone(),
                covariance: rows(&posterior.covariance),
            }],
            distance: (distance.degrees_of_freedom > 0).then_some(distance.squared),
            degrees_of_freedom: distance.degrees_of_freedom,
            p_value: distance.p_value,
            deletion: inference.deletions.as_ref().and_then(|all| all[j].as_ref()).map(deletion),
            innovations: None,
        }
    };
    order.into_iter().map(record).collect()
}

fn deletion(deletion: &Deletion) -> DeletionRecord {
    let Deletion { estimate, log_density, distance, displacement } = deletion;
    DeletionRecord {
        log_density: *log_density,
        distance: (distance.degrees_of_freedom > 0).then_some(distance.squared),
        p_value: distance.p_value,
        displacement: *displacement,
        phases: vec![DeletedRecord {
            name: MAIN.to_owned(),
            mean: estimate.mean.clone(),
            regression: estimate.coefficients.clone(),
            covariance: rows(&estimate.covariance),
        }],
    }
}

/// What a reader should be told that no single figure shows.
fn notes(model: &Model, estimate: &Estimate, inference: &Inference) -> Vec<String> {
    let mut notes = shortage_notes(model, &inference.observability);
    for (i, name) in model.estimated_names().iter().enumerate() {
        let variance = estimate.covariance[(i, i)];
        if let Some(error) = inference.uncertainty.covariance[i][i].filter(|e| *e >= variance) {
            notes.push(format!(
                "the variance of `{name}` is weakly determined: its standard error ({error:.3e}) is no smaller than the variance itself ({variance:.3e})"
            ));
        }
    }
    notes
}

fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}
