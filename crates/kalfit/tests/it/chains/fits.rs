//! Whole fits over phases: chain = stacked = the same said in one phase with blocks; phases of different structures; inference.

use std::collections::BTreeMap;

use kalfit::estimate::{
    self, Combination, Criterion, Estimate, PhaseStructure, Settings, Silent, Solver, Stop, Structure,
};
use kalfit::infer::{self, Choices, DeletionChoice, Element, Inference, Posterior};
use kalfit::model::{
    Alpha, CovarianceKind, CovarianceStructure, Expression, FixedElement, MeanElement, MeanStructure, Regression,
};
use kalfit::reduce::{ReductionRef, Reductions};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};

use super::{Joint, Recipe, ensemble};

pub(super) type Phases = Vec<(MeanStructure, CovarianceStructure)>;

pub(super) fn structure<'a>(phases: &'a Phases, alpha: &'a Alpha) -> Structure<'a> {
    let one = |(mean, covariance): &'a (MeanStructure, CovarianceStructure)| PhaseStructure {
        mean: std::borrow::Cow::Borrowed(mean),
        covariance,
    };
    Structure { phases: phases.iter().map(one).collect(), alpha, grouping: None }
}

pub(super) fn fit(data: &Reductions, phases: &Phases, settings: &Settings) -> Estimate {
    let alpha = Alpha::default();
    estimate::fit(data, &structure(phases, &alpha), settings, &mut Silent).expect("a legal problem")
}

pub(super) fn by(phases: Combination) -> Settings {
    Settings { phases, ..Settings::default() }
}

pub(super) fn kind(kind: CovarianceKind) -> CovarianceStructure {
    CovarianceStructure { kind, ..CovarianceStructure::full() }
}

pub(super) fn matrix(sigma: &DMatrix<f64>) -> Vec<Vec<Expression>> {
    sigma.row_iter().map(|row| row.iter().map(|x| Expression::Number(*x)).collect()).collect()
}

fn full(p: usize) -> (MeanStructure, CovarianceStructure) {
    (MeanStructure::free(p), CovarianceStructure::full())
}

fn alike(what: &str, a: &Estimate, b: &Estimate, tolerance: f64) {
    assert_eq!((a.stop, b.stop), (Stop::Certified, Stop::Certified), "{what}: {:?} {:?}", a.certificate, b.certificate);
    near::mixed(format_args!("{what}: ℓ"), a.log_likelihood, b.log_likelihood, 1e-10);
    for (name, a, b) in [("μ", &a.mean, &b.mean), ("coefficients", &a.coefficients, &b.coefficients)] {
        assert_eq!(a.len(), b.len(), "{what}: {name}");
        a.iter().zip(b).for_each(|(x, y)| near::mixed(format_args!("{what}: {name}"), *x, *y, tolerance));
    }
    a.covariance.iter().zip(&b.covariance).for_each(|(x, y)| near::mixed(format_args!("{what}: Σ"), *x, *y, tolerance));
}

/// The structures of two phases of two and three states.
fn structures() -> Vec<(&'static str, Phases)> {
    let wide = DMatrix::from_row_slice(3, 3, &[1.0, 0.3, 0.1, 0.3, 1.5, -0.2, 0.1, -0.2, 0.8]);
    let correlated = DMatrix::from_row_slice(2, 2, &[1.0, 0.4, 0.4, 1.0]);
    let tied = MeanStructure {
        elements: vec![
            MeanElement::Free,
            MeanElement::Tied { constant: 0.5, terms: vec![(0, 1.0)] },
            MeanElement::Fixed(5.0),
        ],
        ..MeanStructure::free(3)
    };
    let proportional = |n: usize, from: f64| MeanStructure {
        elements: (0..n).map(|i| MeanElement::Proportional(from + i as f64)).collect(),
        ..MeanStructure::free(n)
    };
    let fixed = CovarianceStructure {
        fixed: vec![FixedElement { i: 1, j: 0, value: 0.2 }, FixedElement { i: 2, j: 2, value: 1.0 }],
        ..CovarianceStructure::full()
    };
    let equal = CovarianceStructure { equal: vec![vec![(0, 0), (1, 1)]], ..CovarianceStructure::full() };
    vec![
        ("full, full", vec![full(2), full(3)]),
        ("full, diagonal", vec![full(2), (MeanStructure::free(3), kind(CovarianceKind::Diagonal))]),
        ("full, fixed", vec![full(2), (MeanStructure::free(3), kind(CovarianceKind::Fixed(matrix(&wide))))]),
        (
            "diagonal, proportional",
            vec![
                (MeanStructure::free(2), kind(CovarianceKind::Diagonal)),
                (MeanStructure::free(3), kind(CovarianceKind::Proportional(matrix(&wide)))),
            ],
        ),
        (
            "correlation, full",
            vec![(MeanStructure::free(2), kind(CovarianceKind::Correlation(matrix(&correlated)))), full(3)],
        ),
        ("full, mean constrained", vec![full(2), (tied, CovarianceStructure::full())]),
        (
            "both means proportional",
            vec![
                (proportional(2, 1.0), CovarianceStructure::full()),
                (proportional(3, 3.0), CovarianceStructure::full()),
            ],
        ),
        ("equal, fixed elements", vec![(MeanStructure::free(2), equal), (MeanStructure::free(3), fixed)]),
    ]
}

fn data(seed: u64) -> (Recipe, Reductions) {
    let recipe = Recipe { tests: 60, designs: 60, missing: true, ..Recipe::two() };
    let data = ensemble(&recipe, seed);
    (recipe, data)
}

#[test]
fn every_structure_has_one_maximum_by_chain_and_stacked_and_by_em() {
    for (name, phases) in structures() {
        let (recipe, data) = data(7);
        let chain = fit(&data, &phases, &by(Combination::Chain));
        let stacked = fit(&data, &phases, &by(Combination::Stacked));
        alike(name, &chain, &stacked, 1e-7);
        let em = fit(&data, &phases, &Settings { tolerance: 1e-5, ..Settings::of(Solver::Em) });
        assert_eq!(em.stop, Stop::Certified, "{name}: {:?}", em.certificate);
        near::mixed(format_args!("{name}: ℓ of EM"), em.log_likelihood, chain.log_likelihood, 1e-9);
        for range in recipe.ranges() {
            let outside = (0..5).filter(|k| !range.contains(k)).flat_map(|k| range.clone().map(move |i| (i, k)));
            outside.for_each(|at| assert_eq!(chain.covariance[at], 0.0, "{name}: Σ between phases"));
        }
        let mu = DVector::from_column_slice(&chain.mean);
        let dense =
            |r: ReductionRef<'_>| Joint::of(r.chain.expect("made so"), &recipe.own).log_density(&mu, &chain.covariance);
        near::mixed(format_args!("{name}: dense ℓ"), chain.log_likelihood, data.iter().map(dense).sum(), 1e-10);
    }
}

/// Blocks in one phase are the same problem: the estimate, its errors, its certificate and what each test says agree.
#[test]
fn phases_are_blocks_of_one_phase_to_whom_the_stacked_reductions_are_given() {
    let (_, data) = data(3);
    let apart: Reductions = data.iter().map(|r| ReductionRef { chain: None, exact: None, ..r }).collect();
    for (blocks, phases) in [
        (vec![vec![0, 1], vec![2, 3, 4]], vec![full(2), full(3)]),
        (
            vec![vec![0, 1], vec![2], vec![3], vec![4]],
            vec![full(2), (MeanStructure::free(3), kind(CovarianceKind::Diagonal))],
        ),
    ] {
        let one = vec![(MeanStructure::free(5), kind(CovarianceKind::Blocks(blocks)))];
        let expected = fit(&apart, &one, &Settings::default());
        let expected_inference = inferred(&expected, &apart);
        for (name, combination, data) in [
            ("chain", Combination::Chain, &data),
            ("stacked", Combination::Stacked, &data),
            ("chain without chains", Combination::Chain, &apart),
        ] {
            let found = fit(data, &phases, &by(combination));
            alike(name, &found, &expected, 1e-7);
            assert_eq!(found.declared_covariance(), expected.declared_covariance(), "{name}");
            same_inference(name, &inferred(&found, data), &expected_inference);
        }
    }
}

fn inferred(estimate: &Estimate, data: &Reductions) -> Inference {
    infer::infer(estimate, data, Choices { deletion: DeletionChoice::All, ..Choices::default() })
}

fn same_inference(name: &str, found: &Inference, expected: &Inference) {
    let both = |what: &str, a: Option<f64>, b: Option<f64>| {
        assert_eq!(a.is_some(), b.is_some(), "{name}: {what}");
        a.zip(b).into_iter().for_each(|(a, b)| near::mixed(format_args!("{name}: {what}"), a, b, 1e-6));
    };
    let (a, b) = (&found.uncertainty.errors, &expected.uncertainty.errors);
    a.mean.iter().zip(&b.mean).for_each(|(a, b)| both("error of μ", *a, *b));
    a.std_dev.iter().zip(&b.std_dev).for_each(|(a, b)| both("error of a standard deviation", *a, *b));
    a.covariance.iter().flatten().zip(b.covariance.iter().flatten()).for_each(|(a, b)| both("error of Σ", *a, *b));
    a.correlation.iter().flatten().zip(b.correlation.iter().flatten()).for_each(|(a, b)| both("ρ", *a, *b));
    assert_eq!(found.uncertainty.boundary, expected.uncertainty.boundary, "{name}");
    for (a, b) in found.posteriors.iter().zip(expected.posteriors.iter()) {
        near::mixed(format_args!("{name}: ℓ_j"), a.log_likelihood, b.log_likelihood, 1e-8);
        a.mean.iter().zip(b.mean).for_each(|(a, b)| near::mixed(format_args!("{name}: posterior"), *a, *b, 1e-6));
        near::mixed(format_args!("{name}: distance"), a.distance.squared, b.distance.squared, 1e-6);
        assert_eq!(a.distance.degrees_of_freedom, b.distance.degrees_of_freedom, "{name}");
        // covariances between phases are not told, where there are phases
        let told = |posterior: Posterior<'_>| -> Vec<((usize, usize), f64)> {
            let mut start = 0;
            let mut all = Vec::new();
            for own in posterior.covariances() {
                let places = (0..own.nrows()).flat_map(|i| (0..own.ncols()).map(move |k| (i, k)));
                all.extend(places.map(|(i, k)| ((start + i, start + k), own[(i, k)])));
                start += own.nrows();
            }
            all
        };
        let all: BTreeMap<(usize, usize), f64> = told(b).into_iter().collect();
        for (at, a) in told(a) {
            near::mixed(format_args!("{name}: posterior covariance"), a, all[&at], 1e-6);
        }
    }
    let (a, b) = (found.deletions.as_ref().expect("asked for"), expected.deletions.as_ref().expect("asked for"));
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a.as_ref().expect("certified"), b.as_ref().expect("certified"));
        a.estimate.mean.iter().zip(&b.estimate.mean).for_each(|(a, b)| near::mixed("μ without a test", *a, *b, 1e-5));
        near::mixed(format_args!("{name}: predictive density"), a.log_density, b.log_density, 1e-6);
        near::mixed(format_args!("{name}: displacement"), a.displacement, b.displacement, 1e-5);
    }
    // zeros between phases are no constraints, those of blocks are
    let within = |e: &Element| match e {
        Element::Covariance(i, j) => (*i < 2) == (*j < 2),
        Element::Mean(_) => true,
    };
    let expected: Vec<_> = expected.sensitivities.iter().filter(|s| within(&s.element)).collect();
    assert_eq!(found.sensitivities.len(), expected.len(), "{name}");
    for (a, b) in found.sensitivities.iter().zip(expected) {
        assert_eq!(a.element, b.element, "{name}");
        near::mixed(format_args!("{name}: sensitivity of {:?}", a.element), a.sensitivity, b.sensitivity, 1e-5);
        both("score statistic", a.statistic, b.statistic);
    }
}

#[test]
fn the_restricted_likelihood_and_regressions_do_not_see_how_phases_are_put_together() {
    let recipe = Recipe { tests: 40, designs: 40, missing: true, regressors: 2, ..Recipe::two() };
    let data = ensemble(&recipe, 11);
    let regressed = |p: usize, column: usize| MeanStructure {
        regression: vec![Regression { element: 0, column }],
        ..MeanStructure::free(p)
    };
    let phases: Phases =
        vec![(regressed(2, 0), CovarianceStructure::full()), (regressed(3, 1), CovarianceStructure::full())];
    for criterion in [Criterion::Ml, Criterion::Reml] {
        let with = |phases, solver| Settings { phases, criterion, ..Settings::of(solver) };
        let chain = fit(&data, &phases, &with(Combination::Chain, Solver::Newton));
        let stacked = fit(&data, &phases, &with(Combination::Stacked, Solver::Newton));
        alike(&format!("{criterion:?}"), &chain, &stacked, 1e-6);
        assert_eq!(chain.coefficients.len(), 2);
        let em = Settings { tolerance: 1e-4, ..with(Combination::Chain, Solver::Em) };
        let em = fit(&data, &phases, &em);
        near::mixed(format_args!("{criterion:?}: ℓ of EM"), em.log_likelihood, chain.log_likelihood, 1e-7);
    }
}

/// At the maximum over each structure, ℓ by the joint density of all data is flat in the structure's own coordinates.
#[test]
fn the_joint_density_is_flat_at_the_estimate_of_each_structure() {
    let (recipe, data) = data(5);
    let wide = DMatrix::from_row_slice(3, 3, &[1.0, 0.3, 0.1, 0.3, 1.5, -0.2, 0.1, -0.2, 0.8]);
    let correlated = DMatrix::from_row_slice(2, 2, &[1.0, 0.4, 0.4, 1.0]);
    let phases: Phases = vec![
        (MeanStructure::free(2), kind(CovarianceKind::Correlation(matrix(&correlated)))),
        (MeanStructure::free(3), kind(CovarianceKind::Proportional(matrix(&wide)))),
    ];
    let found = fit(&data, &phases, &Settings::default());
    assert_eq!(found.stop, Stop::Certified);
    let scale = found.covariance_scale(1);
    assert_eq!(found.covariance_scale(0), 0.0);
    // five means, two standard deviations and the factor
    let theta: Vec<f64> = found
        .mean
        .iter()
        .copied()
        .chain([found.covariance[(0, 0)].sqrt(), found.covariance[(1, 1)].sqrt(), scale])
        .collect();
    let density = |theta: &[f64]| {
        let mut sigma = DMatrix::zeros(5, 5);
        let own = DMatrix::from_fn(2, 2, |i, k| theta[5 + i] * correlated[(i, k)] * theta[5 + k]);
        sigma.view_mut((0, 0), (2, 2)).copy_from(&own);
        sigma.view_mut((2, 2), (3, 3)).copy_from(&(&wide * theta[7]));
        let mu = DVector::from_column_slice(&theta[..5]);
        let one = |r: ReductionRef<'_>| Joint::of(r.chain.expect("made so"), &recipe.own).log_density(&mu, &sigma);
        data.iter().map(one).sum::<f64>()
    };
    let at = density(&theta);
    near::mixed("ℓ", found.log_likelihood, at, 1e-11);
    for k in 0..theta.len() {
        let moved = |h: f64| {
            let mut theta = theta.clone();
            theta[k] += h;
            density(&theta)
        };
        let h = 1e-4 * theta[k].abs().max(0.1);
        let (up, down) = (moved(h), moved(-h));
        let (slope, curvature) = ((up - down) / (2.0 * h), (up + down - 2.0 * at) / (h * h));
        let away = slope / curvature.abs().sqrt();
        assert!(curvature < 0.0 && away.abs() < 1e-5, "coordinate {k}: slope {slope}, {away} standard errors");
    }
}

/// The cost of a first-order step does not grow with the square of the number of phases: see `passes`. Here: a certified optimum with
/// a singular Σ in one phase and a phase that is never observed alone.
#[test]
fn singular_optima_and_blind_phases_are_certified_alike() {
    for seed in 0..4 {
        let mut root = DMatrix::zeros(6, 6);
        (0..2).for_each(|i| root[(i, 0)] = 1.0 - 0.4 * i as f64);
        root[(2, 2)] = 0.8;
        let recipe = Recipe {
            tests: 50,
            designs: 50,
            own: vec![2, 2, 2],
            heirs: vec![0, 0, 0],
            observed: 2,
            root,
            ..Recipe::two()
        };
        let data = ensemble(&recipe, seed);
        let phases = vec![full(2), full(2), full(2)];
        let chain = fit(&data, &phases, &by(Combination::Chain));
        let stacked = fit(&data, &phases, &by(Combination::Stacked));
        assert_eq!((chain.stop, stacked.stop), (Stop::Certified, Stop::Certified), "seed {seed}");
        near::mixed("ℓ", chain.log_likelihood, stacked.log_likelihood, 1e-9);
        chain.mean.iter().zip(&stacked.mean).for_each(|(a, b)| near::mixed("μ", *a, *b, 1e-5));
        chain.covariance.iter().zip(&stacked.covariance).for_each(|(a, b)| near::mixed("Σ", *a, *b, 1e-4));
    }
}
