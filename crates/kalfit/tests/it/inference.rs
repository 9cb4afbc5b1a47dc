//! Deletion, intervals, standard errors and likelihood ratios on random ensembles, against refits and dense algebra.

use kalfit::estimate::{self, Estimate, Likelihood, Settings, Silent, Stop, Structure};
use kalfit::infer::{
    self, Bootstrap, Choices, DeletionChoice, Inference, IntervalKind, NotNested, StdErrors, bootstrap, fit_null,
    likelihood_ratio,
};
use kalfit::model::{
    Alpha, CovarianceKind, CovarianceStructure, FixedElement, MeanElement, MeanStructure, Population, Regression,
};
use kalfit::reduce::{Path, Reduction, ReductionRef, Reductions};
use kalfit_fixtures::dense::{marginal, unpacked};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Tests of p states with a design each, some of which observe fewer, drawn from N(μ, FF').
fn ensemble(tests: usize, root: &DMatrix<f64>, covariates: usize, seed: u64) -> Reductions {
    let p = root.nrows();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..tests)
        .map(|j| {
            let rows = 1 + (j + 1) % (p + 2);
            let a = DMatrix::from_fn(rows.max(p), p, |i, _| if i < rows { rng.sample(StandardNormal) } else { 0.0 });
            let x: Vec<f64> = (0..covariates).map(|_| rng.sample(StandardNormal)).collect();
            let r: DMatrix<f64> = (a * 2.0).qr().r();
            let mut normal = |n: usize| DVector::<f64>::from_fn(n, |_, _| rng.sample(StandardNormal));
            let mut xi = DVector::from_element(p, 1.0) + root * normal(root.ncols());
            x.iter().for_each(|x| xi[0] += 0.5 * x);
            let noise = normal(p);
            let told = |i: usize| r.row(i).norm() > 0.0;
            let d = &r * xi + DVector::from_fn(p, |i, _| if told(i) { noise[i] } else { 0.0 });
            Reduction {
                test: format!("t{j:03}"),
                constant: 0.0,
                residual: None,
                data: d.as_slice().to_vec(),
                factor: (0..p).flat_map(|k| (0..=k).map(move |i| (i, k))).map(|(i, k)| r[(i, k)]).collect(),
                covariates: x,
                steps: 1,
                observations: rows,
                path: Path::Information,
                design: j as u128,
                chain: None,
                exact: None,
            }
        })
        .collect()
}

fn spread() -> DMatrix<f64> {
    DMatrix::from_row_slice(2, 2, &[1.2, 0.0, 0.6, 0.8])
}

fn fit(data: &Reductions, mean: &MeanStructure, covariance: &CovarianceStructure) -> Estimate {
    let alpha = Alpha::default();
    let structure = Structure::single(mean, covariance, &alpha);
    let found = estimate::fit(data, &structure, &Settings::default(), &mut Silent).expect("a legal problem");
    assert_eq!(found.stop, Stop::Certified, "{:?}", found.certificate);
    found
}

fn free_fit(data: &Reductions, p: usize) -> Estimate {
    fit(data, &MeanStructure::free(p), &CovarianceStructure::full())
}

fn inferred(estimate: &Estimate, data: &Reductions, choices: Choices) -> Inference {
    infer::infer(estimate, data, choices)
}

fn fixed(elements: &[(usize, usize, f64)]) -> CovarianceStructure {
    let fixed = elements.iter().map(|&(i, j, value)| FixedElement { i, j, value }).collect();
    CovarianceStructure { fixed, ..CovarianceStructure::full() }
}

fn regression(p: usize, covariates: usize) -> MeanStructure {
    let regression = (0..covariates).map(|column| Regression { element: 0, column }).collect();
    MeanStructure { regression, ..MeanStructure::free(p) }
}

#[test]
fn deletion_equals_refitting_without_the_test() {
    let structures = [
        (MeanStructure::free(2), CovarianceStructure::full()),
        (MeanStructure::free(2), CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() }),
        (MeanStructure::free(2), fixed(&[(1, 0, 0.1)])),
        (MeanStructure::free(2), fixed(&[(1, 1, 0.0)])),
        (regression(2, 1), CovarianceStructure::full()),
        (
            MeanStructure { elements: vec![MeanElement::Fixed(1.1), MeanElement::Free], ..MeanStructure::free(2) },
            CovarianceStructure::full(),
        ),
    ];
    for (root, seed) in [(spread(), 1), (DMatrix::from_column_slice(2, 1, &[0.9, -0.7]), 2)] {
        for (mean, covariance) in &structures {
            let data = ensemble(14, &root, mean.regression.len(), seed);
            let all = fit(&data, mean, covariance);
            let inference = inferred(&all, &data, Choices { deletion: DeletionChoice::All, ..Choices::default() });
            let deletions = inference.deletions.expect("asked for");
            for (j, deletion) in deletions.iter().enumerate() {
                let deletion = deletion.as_ref().expect("the other tests have an optimum");
                let others: Vec<usize> = (0..data.len()).filter(|other| *other != j).collect();
                let (out, others) = (data.get(j), data.select(&others));
                let again = fit(&others, mean, covariance);
                for (found, expected) in deletion.estimate.mean.iter().zip(&again.mean) {
                    near::mixed("mean", *found, *expected, 1e-6);
                }
                for (found, expected) in deletion.estimate.covariance.iter().zip(again.covariance.iter()) {
                    near::mixed("covariance", *found, *expected, 1e-5);
                }
                for (found, expected) in deletion.estimate.coefficients.iter().zip(&again.coefficients) {
                    near::mixed("coefficient", *found, *expected, 1e-6);
                }
                let density = predictive(&again, mean, out);
                near::mixed("log predictive density", deletion.log_density, density, 1e-6);
                let at_all = predictive(&again, mean, out) + again.log_likelihood;
                near::mixed("displacement", deletion.displacement, 2.0 * (all.log_likelihood - at_all), 1e-6);
            }
        }
    }
}

/// log p of a test at an estimate, by dense algebra.
fn predictive(estimate: &Estimate, mean: &MeanStructure, test: ReductionRef<'_>) -> f64 {
    let mut mu = DVector::from_column_slice(&estimate.mean);
    for (c, regression) in mean.regression.iter().enumerate() {
        mu[regression.element] += estimate.coefficients[c] * test.covariates[c];
    }
    marginal(test, &mu, &estimate.covariance)
}

/// An end of a profile interval is where a fit with the quantity fixed there has lost half the square of 1.96.
#[test]
fn profile_intervals_end_where_a_refit_loses_half_the_squared_quantile() {
    let data = ensemble(25, &spread(), 1, 5);
    let (mean, covariance) = (regression(2, 1), CovarianceStructure::full());
    let all = fit(&data, &mean, &covariance);
    let choices = Choices { intervals: IntervalKind::Profile, ..Choices::default() };
    let intervals = inferred(&all, &data, choices).intervals;
    let lost = |held: Estimate| 2.0 * (all.log_likelihood - held.log_likelihood);
    let quantile = 1.959_963_984_540_054_f64.powi(2);
    for i in 0..2 {
        for end in intervals.ends.mean[i].expect("free").map(|end| end.expect("finite")) {
            let mut held = mean.clone();
            held.elements[i] = MeanElement::Fixed(end);
            near::mixed("mean", lost(fit(&data, &held, &covariance)), quantile, 1e-5);
        }
        for end in intervals.ends.std_dev[i].expect("free").map(|end| end.expect("finite")) {
            near::mixed("standard deviation", lost(fit(&data, &mean, &fixed(&[(i, i, end * end)]))), quantile, 1e-5);
        }
    }
    for end in intervals.ends.covariance[1][0].expect("free").map(|end| end.expect("finite")) {
        near::mixed("covariance", lost(fit(&data, &mean, &fixed(&[(1, 0, end)]))), quantile, 1e-5);
    }
    for end in intervals.ends.correlation[1][0].expect("free").map(|end| end.expect("finite")) {
        let number = |x: f64| kalfit::Expression::Number(x);
        let matrix = vec![vec![number(1.0), number(end)], vec![number(end), number(1.0)]];
        let held = CovarianceStructure { kind: CovarianceKind::Correlation(matrix), ..CovarianceStructure::full() };
        near::mixed("correlation", lost(fit(&data, &mean, &held)), quantile, 1e-5);
    }
    // a regression coefficient is held by moving its part of the data over
    for end in intervals.ends.coefficients[0].expect("free").map(|end| end.expect("finite")) {
        let moved: Reductions = data.iter().map(|r| moved(r, end)).collect();
        near::mixed("coefficient", lost(fit(&moved, &MeanStructure::free(2), &covariance)), quantile, 1e-5);
    }
}

/// The test without its covariate, whose effect on element 0 is taken off the data.
fn moved(test: ReductionRef<'_>, coefficient: f64) -> Reduction {
    let mut data = test.data.to_vec();
    data[0] -= test.factor[0] * coefficient * test.covariates[0];
    Reduction { data, covariates: Vec::new(), ..test.into() }
}

#[test]
fn a_profile_interval_on_the_boundary_begins_there() {
    let data = ensemble(12, &DMatrix::from_column_slice(2, 1, &[0.0, 0.8]), 0, 3);
    let covariance = CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() };
    let all = fit(&data, &MeanStructure::free(2), &covariance);
    assert_eq!(all.covariance[(0, 0)], 0.0, "the ensemble was chosen for a zero variance");
    let choices = Choices { intervals: IntervalKind::Profile, ..Choices::default() };
    let inference = inferred(&all, &data, choices);
    assert_eq!(inference.uncertainty.errors.std_dev[0], None);
    let [lower, upper] = inference.intervals.ends.std_dev[0].expect("a free variance has an interval");
    assert_eq!(lower, Some(0.0));
    let upper = upper.expect("the data limit it");
    let mut held = fixed(&[(0, 0, upper * upper)]);
    held.kind = CovarianceKind::Diagonal;
    let lost = 2.0 * (all.log_likelihood - fit(&data, &MeanStructure::free(2), &held).log_likelihood);
    near::mixed("upper end", lost, 1.959_963_984_540_054_f64.powi(2), 1e-5);
}

/// Expected information of (μ, σ_00, σ_10, σ_11) and the outer products of scores, by difference quotients and dense sums.
#[test]
fn expected_and_sandwich_errors_equal_dense_ones() {
    let data = ensemble(60, &spread(), 0, 8);
    let all = free_fit(&data, 2);
    let errors = |kind| inferred(&all, &data, Choices { std_errors: kind, ..Choices::default() }).uncertainty.errors;
    let (expected, observed) = (dense_expected(&all, &data), dense_observed(&all, &data));
    let meat = scores(&all, &data);
    let inverse = |m: &DMatrix<f64>| m.clone().try_inverse().expect("informative");
    let sandwich = inverse(&observed) * meat * inverse(&observed);
    for (kind, law) in [
        (StdErrors::Expected, inverse(&expected)),
        (StdErrors::Observed, inverse(&observed)),
        (StdErrors::Sandwich, sandwich),
    ] {
        let found = errors(kind);
        let flat =
            [found.mean[0], found.mean[1], found.covariance[0][0], found.covariance[1][0], found.covariance[1][1]];
        for (k, found) in flat.iter().enumerate() {
            near::mixed(format_args!("{kind:?} {k}"), found.expect("identified"), law[(k, k)].sqrt(), 1e-5);
        }
    }
}

const UNITS: [(usize, usize); 3] = [(0, 0), (1, 0), (1, 1)];

fn unit(k: usize) -> DMatrix<f64> {
    let (i, j) = UNITS[k];
    let mut d = DMatrix::zeros(2, 2);
    d[(i, j)] = 1.0;
    d[(j, i)] = 1.0;
    d
}

fn weight(estimate: &Estimate, test: ReductionRef<'_>) -> (DMatrix<f64>, DVector<f64>) {
    let r = unpacked(test.factor, 2);
    let inverse = (DMatrix::identity(2, 2) + &r * &estimate.covariance * r.transpose()).try_inverse().expect("regular");
    let e = DVector::from_column_slice(test.data) - &r * DVector::from_column_slice(&estimate.mean);
    (r.transpose() * &inverse * &r, r.transpose() * inverse * e)
}

fn dense_expected(estimate: &Estimate, data: &Reductions) -> DMatrix<f64> {
    let mut sum = DMatrix::zeros(5, 5);
    for test in data {
        let (w, _) = weight(estimate, test);
        for a in 0..2 {
            for b in 0..2 {
                sum[(a, b)] += w[(a, b)];
            }
        }
        for k in 0..3 {
            for l in 0..3 {
                sum[(2 + k, 2 + l)] += 0.5 * (&w * unit(k) * &w * unit(l)).trace();
            }
        }
    }
    sum
}

fn scores(estimate: &Estimate, data: &Reductions) -> DMatrix<f64> {
    let mut sum = DMatrix::zeros(5, 5);
    for test in data {
        let (w, r) = weight(estimate, test);
        let sigma = |k: usize| 0.5 * ((&r * r.transpose() - &w) * unit(k)).trace();
        let s = DVector::from_column_slice(&[r[0], r[1], sigma(0), sigma(1), sigma(2)]);
        sum += &s * s.transpose();
    }
    sum
}

fn dense_observed(estimate: &Estimate, data: &Reductions) -> DMatrix<f64> {
    let likelihood = Likelihood::new(data, 2);
    let gradient = |theta: &DVector<f64>| {
        let sigma = DMatrix::from_row_slice(2, 2, &[theta[2], theta[3], theta[3], theta[4]]);
        let at = likelihood.at(&[theta[0], theta[1]], &sigma, estimate::Derivatives::First);
        let g = &at.covariance_score;
        DVector::from_column_slice(&[at.mean_score[0], at.mean_score[1], g[(0, 0)], 2.0 * g[(1, 0)], g[(1, 1)]])
    };
    let s = &estimate.covariance;
    let centre = DVector::from_column_slice(&[estimate.mean[0], estimate.mean[1], s[(0, 0)], s[(1, 0)], s[(1, 1)]]);
    let mut information = DMatrix::zeros(5, 5);
    for k in 0..5 {
        let h = 1e-5;
        let (mut up, mut down) = (centre.clone(), centre.clone());
        up[k] += h;
        down[k] -= h;
        information.set_column(k, &((gradient(&down) - gradient(&up)) / (2.0 * h)));
    }
    information
}

type Pair<'a> = (&'a MeanStructure, &'a CovarianceStructure);

fn ratio(
    data: &Reductions,
    alternative: (&MeanStructure, &CovarianceStructure),
    null: (&MeanStructure, &CovarianceStructure),
) -> Result<infer::LikelihoodRatio, NotNested> {
    let alpha = Alpha::default();
    let structure = Structure::single(null.0, null.1, &alpha);
    let within = Structure::single(alternative.0, alternative.1, &alpha);
    let narrow = fit_null(data, &within, &structure, &Settings::default(), &mut Silent)
        .ok_or(NotNested::Mean)?
        .expect("a legal problem");
    likelihood_ratio(&narrow, &fit(data, alternative.0, alternative.1))
}

fn shape(law: &infer::ReferenceLaw) -> Vec<(usize, f64)> {
    law.components.iter().map(|c| (c.degrees_of_freedom, c.weight)).collect()
}

#[test]
fn the_law_follows_from_what_the_hypothesis_puts_on_the_boundary() {
    let data = ensemble(40, &spread(), 1, 11);
    let (mean, full) = (regression(2, 1), CovarianceStructure::full());
    let diagonal = CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() };
    let known = |mean: &MeanStructure| {
        let mut known = mean.clone();
        known.elements = vec![MeanElement::Fixed(1.0), MeanElement::Fixed(1.0)];
        known
    };
    let law = |alternative: Pair<'_>, null: Pair<'_>| ratio(&data, alternative, null).expect("nested");
    assert_eq!(shape(&law((&mean, &full), (&mean, &diagonal)).law), [(1, 1.0)]);
    assert_eq!(shape(&law((&mean, &full), (&known(&mean), &diagonal)).law), [(3, 1.0)]);
    assert_eq!(shape(&law((&mean, &full), (&MeanStructure::free(2), &full)).law), [(1, 1.0)]);
    // a variance at zero takes its covariance with it
    assert_eq!(shape(&law((&mean, &full), (&mean, &fixed(&[(1, 1, 0.0)]))).law), [(1, 0.5), (2, 0.5)]);
    let both = law((&mean, &full), (&known(&mean), &fixed(&[(1, 1, 0.0)])));
    assert_eq!(shape(&both.law), [(3, 0.5), (4, 0.5)]);
    // two variances of a diagonal: three components; of a full Σ: only a bound is known
    let mut none = fixed(&[(0, 0, 0.0), (1, 1, 0.0)]);
    let two = law((&mean, &full), (&mean, &none));
    assert!(two.law.is_bound && shape(&two.law) == [(2, 0.5), (3, 0.5)], "{two:?}");
    none.kind = CovarianceKind::Diagonal;
    let two = law((&mean, &diagonal), (&mean, &none));
    assert_eq!(two.law.components.len(), 3);
    assert!((two.law.components.iter().map(|c| c.weight).sum::<f64>() - 1.0).abs() < 1e-12, "{two:?}");
}

#[test]
fn what_is_not_nested_is_refused() {
    let data = ensemble(30, &spread(), 1, 12);
    let (mean, full) = (regression(2, 1), CovarianceStructure::full());
    let diagonal = CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() };
    let refused = |alternative: Pair<'_>, null: Pair<'_>| ratio(&data, alternative, null).expect_err("not nested");
    assert_eq!(refused((&mean, &diagonal), (&mean, &full)), NotNested::Covariance);
    assert_eq!(refused((&mean, &full), (&mean, &full)), NotNested::Same);
    assert_eq!(refused((&MeanStructure::free(2), &full), (&mean, &diagonal)), NotNested::Mean);
    assert_eq!(refused((&mean, &fixed(&[(1, 0, 0.2)])), (&mean, &fixed(&[(1, 0, 0.1)]))), NotNested::Covariance);
    let held = |value| MeanStructure { elements: vec![MeanElement::Fixed(value), MeanElement::Free], ..mean.clone() };
    assert_eq!(refused((&held(1.0), &full), (&held(1.5), &diagonal)), NotNested::Mean);
}

/// With many tests the bootstrap p-value and that of the large-sample law agree, also on the boundary.
#[test]
fn the_bootstrap_agrees_with_the_large_sample_law() {
    let root = DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, 0.0]);
    let data = ensemble(80, &root, 1, 21);
    let (mean, full) = (regression(2, 1), CovarianceStructure::full());
    let null = fixed(&[(1, 1, 0.0)]);
    let alpha = Alpha::default();
    let narrow_mean = MeanStructure::free(2);
    let structure = Structure::single(&narrow_mean, &null, &alpha);
    let within = Structure::single(&mean, &full, &alpha);
    let narrow =
        fit_null(&data, &within, &structure, &Settings::default(), &mut Silent).expect("nested").expect("legal");
    let wide = fit(&data, &mean, &full);
    let ratio = likelihood_ratio(&narrow, &wide).expect("nested");
    assert_eq!(shape(&ratio.law), [(2, 0.5), (3, 0.5)]);
    // at the 80 % point of the law
    let point = (0..2000).map(|k| 0.005 * f64::from(k)).find(|x| ratio.law.tail(*x) < 0.2).expect("below 10");
    let drawn = bootstrap(&narrow, &wide, &data, point, Bootstrap { replicates: 1500, seed: 4 });
    assert_eq!(drawn.failed, 0);
    assert!(
        (drawn.p_value - 0.2).abs() < 4.0 * drawn.std_error + 0.01,
        "law 0.2, bootstrap {drawn:.3?}",
        drawn = drawn.p_value
    );
    let again = bootstrap(&narrow, &wide, &data, point, Bootstrap { replicates: 1500, seed: 4 });
    assert_eq!(drawn, again);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let single = pool.install(|| bootstrap(&narrow, &wide, &data, point, Bootstrap { replicates: 1500, seed: 4 }));
    assert_eq!(drawn, single, "threads change no bit");
}

#[test]
fn a_fit_from_values_nearby_ends_where_a_fit_from_scratch_does() {
    for seed in 0..20 {
        let data = ensemble(30, &spread(), 0, seed);
        let all = free_fit(&data, 2);
        let start = Population { mean: vec![0.5, 2.0], coefficients: Vec::new(), covariance: DMatrix::identity(2, 2) };
        let (mean, covariance, alpha) = (MeanStructure::free(2), CovarianceStructure::full(), Alpha::default());
        let structure = Structure::single(&mean, &covariance, &alpha);
        let near = estimate::fit_from(&data, &structure, &start, &Settings::default(), &mut Silent).expect("legal");
        assert_eq!(near.stop, Stop::Certified);
        near::mixed("ℓ", near.log_likelihood, all.log_likelihood, 1e-10);
    }
}
