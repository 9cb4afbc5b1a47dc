//! The chain pass: value, score and information are those of the stacked reductions, and ℓ is the joint density of all data.

use kalfit::estimate::{Combination, Derivatives, Evaluation, Likelihood};
use kalfit::reduce::{Path, ReductionRef, Reductions};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

use super::{Joint, Recipe, ensemble};
use crate::simulated::normal;

/// Both ways at a point, and the dense log-likelihood.
fn evaluate(recipe: &Recipe, data: &Reductions, mean: &[f64], sigma: &DMatrix<f64>) -> (Evaluation, Evaluation, f64) {
    let way =
        |combination| Likelihood::of_phases(data, recipe.ranges(), combination).at(mean, sigma, Derivatives::Second);
    let mu = DVector::from_column_slice(mean);
    let dense = |r: ReductionRef<'_>| Joint::of(r.chain.expect("made so"), &recipe.own).log_density(&mu, sigma);
    (way(Combination::Chain), way(Combination::Stacked), data.iter().map(dense).sum())
}

/// A root of a block-diagonal Σ of these ranks by phase.
fn root(recipe: &Recipe, ranks: &[usize], size: f64, seed: u64) -> DMatrix<f64> {
    use rand::SeedableRng;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut root = DMatrix::zeros(recipe.states(), recipe.states());
    for (range, &rank) in recipe.ranges().into_iter().zip(ranks) {
        for i in range.clone() {
            (0..rank.min(range.len())).for_each(|c| root[(i, range.start + c)] = size * normal(&mut rng));
        }
    }
    root
}

/// The largest difference beside the size of the elements, as the information scales them.
fn apart(found: &DMatrix<f64>, expected: &DMatrix<f64>, rows: &[f64], columns: &[f64]) -> f64 {
    let relative = |i: usize, k: usize| (found[(i, k)] - expected[(i, k)]).abs() / (rows[i] * columns[k]);
    (0..found.nrows())
        .flat_map(|i| (0..found.ncols()).map(move |k| (i, k)))
        .map(|(i, k)| relative(i, k))
        .fold(0.0, f64::max)
}

fn compare(recipe: &Recipe, data: &Reductions, mean: &[f64], sigma: &DMatrix<f64>, tolerance: f64) {
    let (chain, stacked, dense) = evaluate(recipe, data, mean, sigma);
    let what = format!("{recipe:?} Σ {sigma}");
    let size = 1.0 + dense.abs();
    let rounding = |r: ReductionRef<'_>| Joint::of(r.chain.expect("made so"), &recipe.own).rounding(sigma);
    let of_dense = data.iter().map(rounding).fold(tolerance, f64::max);
    assert!((chain.log_likelihood - dense).abs() <= of_dense * size, "{} {dense}; {what}", chain.log_likelihood);
    let apart_by = (chain.log_likelihood - stacked.log_likelihood).abs();
    assert!(apart_by <= tolerance * size, "{} {}; {what}", chain.log_likelihood, stacked.log_likelihood);
    let unit: Vec<f64> = stacked.mean_information.diagonal().iter().map(|x| x.max(1e-12).sqrt()).collect();
    let pairs: Vec<f64> = recipe
        .ranges()
        .into_iter()
        .flat_map(|range| {
            let start = range.start;
            range.flat_map(move |i| (start..=i).map(move |j| (i, j)))
        })
        .map(|(i, j)| unit[i] * unit[j])
        .collect();
    let score = |e: &Evaluation| DMatrix::from_column_slice(e.mean_score.len(), 1, e.mean_score.as_slice());
    // scores are sums of terms that may cancel: their size is that of the terms
    let many = data.len() as f64 * (1.0 + stacked.mean_score.amax() / unit.iter().fold(1e-300, |a: f64, b| a.max(*b)));
    for (name, a, b, rows, columns) in [
        ("score of μ", score(&chain), score(&stacked), &unit[..], &[1.0][..]),
        ("score of Σ", chain.covariance_score.clone(), stacked.covariance_score.clone(), &unit, &unit),
        ("information of μ", chain.mean_information.clone(), stacked.mean_information.clone(), &unit, &unit),
        (
            "information of Σ",
            chain.covariance_information.clone().expect("asked for"),
            stacked.covariance_information.clone().expect("asked for"),
            &pairs,
            &pairs,
        ),
        (
            "cross information",
            chain.cross_information.clone().expect("asked for"),
            stacked.cross_information.clone().expect("asked for"),
            &unit,
            &pairs,
        ),
    ] {
        let worst = apart(&a, &b, rows, columns);
        assert!(worst <= tolerance * many, "{name}: {a} {b} {worst:.1e}; {what}");
    }
}

fn recipes() -> impl Strategy<Value = (Recipe, Vec<usize>, u64)> {
    let phases = prop::collection::vec((0_usize..=3, 0_usize..=2), 1..=4);
    (phases, 1_usize..=6, 0_usize..=2, prop::bool::ANY, prop::bool::ANY, prop::bool::ANY, 0_u64..1_000_000).prop_map(
        |(phases, observed, noise, missing, shared, careful, seed)| {
            let mut own: Vec<usize> = phases.iter().map(|(p, _)| *p).collect();
            own[0] = own[0].max(1);
            // a phase without coordinates says nothing and passes nothing on
            let mut heirs: Vec<usize> =
                phases.iter().zip(&own).map(|((_, h), p)| if *p == 0 { (*h).max(1) } else { *h }).collect();
            heirs[0] = 0;
            let p = own.iter().sum();
            let recipe = Recipe {
                tests: 12,
                designs: if shared { 2 } else { 12 },
                missing: missing && own.len() > 1,
                path: if careful { Path::SquareRoot } else { Path::Information },
                root: DMatrix::identity(p, p),
                own: own.clone(),
                heirs,
                observed,
                noise,
                ..Recipe::two()
            };
            let ranks = own.iter().enumerate().map(|(f, p)| (seed as usize >> f) % (p + 1)).collect();
            (recipe, ranks, seed)
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_chain_gives_what_the_stacked_reduction_gives((recipe, ranks, seed) in recipes()) {
        let data = ensemble(&recipe, seed);
        let root = root(&recipe, &ranks, 1.0, seed);
        let mean: Vec<f64> = (0..recipe.states()).map(|i| 1.1 + 0.9 * i as f64).collect();
        compare(&recipe, &data, &mean, &(&root * root.transpose()), 1e-9);
    }
}

#[test]
fn a_covariance_of_zero_and_a_huge_one_are_borne() {
    for seed in 0..6 {
        for (noise, strength) in [(2, 1.0), (0, 1.0), (2, 1e3), (1, 1e-4)] {
            let recipe = Recipe {
                own: vec![2, 1, 2],
                heirs: vec![0, 1, 0],
                root: DMatrix::identity(5, 5),
                noise,
                strength,
                ..Recipe::two()
            };
            let data = ensemble(&recipe, seed);
            let mean = [1.0, 2.0, 3.0, 4.0, 5.0];
            compare(&recipe, &data, &mean, &DMatrix::zeros(5, 5), 1e-9);
            // up to 1e6 standard errors: information between phases is what is left of a difference from one
            compare(&recipe, &data, &mean, &(DMatrix::identity(5, 5) * 1e6), 1e-6);
            let mut mixed = DMatrix::identity(5, 5) * 1e6;
            (2..5).for_each(|i| mixed[(i, i)] = 0.0);
            compare(&recipe, &data, &mean, &mixed, 1e-6);
        }
    }
}

#[test]
fn tests_of_one_design_cost_as_one_and_count_as_many() {
    let recipe = Recipe {
        tests: 200,
        designs: 1,
        missing: true,
        own: vec![2, 3, 1],
        heirs: vec![0, 0, 1],
        root: DMatrix::identity(6, 6),
        ..Recipe::two()
    };
    let data = ensemble(&recipe, 5);
    let likelihood = Likelihood::of_phases(&data, recipe.ranges(), Combination::Chain);
    // those with one, two and all three phases
    assert_eq!(likelihood.classes(), 3);
    compare(&recipe, &data, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], &(DMatrix::identity(6, 6) * 0.8), 1e-10);
}
