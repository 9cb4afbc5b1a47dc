//! The law of the likelihood ratio on the boundary, against projections onto the tangent cone that are drawn and found naively.

#![expect(clippy::print_stdout, reason = "tests print both numbers")]

use kalfit::estimate::{self, Estimate, Settings, Silent, Structure};
use kalfit::infer::{LikelihoodRatio, likelihood_ratio};
use kalfit::model::{Alpha, CovarianceKind, CovarianceStructure, MeanElement, MeanStructure};
use kalfit::reduce::Reductions;
use kalfit_fixtures::dense::unpacked;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::simulated::structures::{numbers, of};
use crate::simulated::{Recipe, changed, ensemble, fixed, normal};

/// Draws of the naive projections.
const DRAWS: usize = 60_000;
/// Four standard errors of a frequency.
const ERROR: f64 = 8e-3;

fn recipe(p: usize) -> Recipe {
    Recipe { p, tests: 60, rank: p, observed: p - 1, strength: 1.5, designs: 60, regressors: 0, mild: false }
}

fn fit(data: &Reductions, mean: &MeanStructure, covariance: &CovarianceStructure) -> Estimate {
    let alpha = Alpha::default();
    let structure = Structure::single(mean, covariance, &alpha);
    estimate::fit(data, &structure, &Settings::default(), &mut Silent).expect("a legal problem")
}

/// The hypothesis on Σ within the model, both with free means; and Σ under the hypothesis.
fn ratio(
    data: &Reductions,
    model: &CovarianceStructure,
    null: &CovarianceStructure,
) -> (LikelihoodRatio, DMatrix<f64>) {
    let mean = MeanStructure::free(data.get(0).data.len());
    let narrow = fit(data, &mean, null);
    let ratio = likelihood_ratio(&narrow, &fit(data, &mean, model)).expect("nested");
    (ratio, narrow.covariance)
}

/// ½ Σ_j tr(W_j D W_j E) over the directions.
fn information(data: &Reductions, sigma: &DMatrix<f64>, directions: &[DMatrix<f64>]) -> DMatrix<f64> {
    let (p, n) = (sigma.nrows(), directions.len());
    let mut sum = DMatrix::zeros(n, n);
    for test in data {
        let r = unpacked(test.factor, p);
        let s = DMatrix::identity(p, p) + &r * sigma * r.transpose();
        let w = r.transpose() * s.try_inverse().expect("S is positive definite") * r;
        let each: Vec<DMatrix<f64>> = directions.iter().map(|d| &w * d).collect();
        sum += DMatrix::from_fn(n, n, |a, b| 0.5 * (&each[a] * &each[b]).trace());
    }
    sum
}

/// Directions in which the elements of blocks of Σ move.
fn elements(p: usize, blocks: &[Vec<usize>]) -> Vec<DMatrix<f64>> {
    let unit = |i: usize, j: usize| {
        DMatrix::from_fn(p, p, |a, b| if (a, b) == (i, j) || (a, b) == (j, i) { 1.0 } else { 0.0 })
    };
    let of = |block: &Vec<usize>| -> Vec<DMatrix<f64>> {
        let pairs = (0..block.len()).flat_map(|k| (0..=k).map(move |l| (k, l)));
        pairs.map(|(k, l)| unit(block[k], block[l])).collect()
    };
    blocks.iter().flat_map(of).collect()
}

/// The coordinates of a symmetric matrix along directions that each have entries of their own.
fn along(matrix: &DMatrix<f64>, directions: &[DMatrix<f64>]) -> DVector<f64> {
    let part = |d: &DMatrix<f64>| d.component_mul(matrix).sum() / d.norm_squared();
    DVector::from_iterator(directions.len(), directions.iter().map(part))
}

/// Of draws w ~ N(0, I) and the cone c_k·w ≥ 0 (the columns): how often the projection onto it lies within so many of the half-spaces.
fn frequencies(cone: &DMatrix<f64>) -> Vec<f64> {
    let (n, m) = cone.shape();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut counts = vec![0.0; m + 1];
    for _ in 0..DRAWS {
        let w = DVector::from_fn(n, |_, _| normal(&mut random));
        let (inside, _) = projection(cone, &w);
        counts[inside] += 1.0 / DRAWS as f64;
    }
    counts
}

/// The nearest point of the cone, by trying every face: how many half-spaces it lies within, and the point.
fn projection(cone: &DMatrix<f64>, w: &DVector<f64>) -> (usize, DVector<f64>) {
    let m = cone.ncols();
    let face = |active: u32| {
        let columns: Vec<usize> = (0..m).filter(|k| active >> k & 1 == 1).collect();
        let normals = cone.select_columns(&columns);
        let gram = (normals.transpose() * &normals).try_inverse().expect("independent half-spaces");
        let at = w - &normals * gram * normals.transpose() * w;
        (m - columns.len(), at)
    };
    let legal = |at: &DVector<f64>| (cone.transpose() * at).iter().all(|x| *x >= -1e-9);
    let faces = (0..1u32 << m).map(face).filter(|(_, at)| legal(at));
    faces.min_by(|a, b| (&a.1 - w).norm().total_cmp(&(&b.1 - w).norm())).expect("the apex is legal")
}

/// Half-spaces n'Dn ≥ 0 over directions, where N(0, I⁻¹) is N(0, 1): c = L⁻¹ (n'D_a n)_a with I = LL'.
fn cone(information: &DMatrix<f64>, directions: &[DMatrix<f64>], lines: &[DVector<f64>]) -> DMatrix<f64> {
    let l = information.clone().cholesky().expect("all directions are informed").l();
    let normals = DMatrix::from_fn(directions.len(), lines.len(), |a, k| {
        (lines[k].transpose() * &directions[a] * &lines[k])[(0, 0)]
    });
    l.solve_lower_triangular(&normals).expect("L is invertible")
}

fn weights(found: &LikelihoodRatio) -> Vec<f64> {
    found.law.components.iter().map(|c| c.weight).collect()
}

fn degrees(found: &LikelihoodRatio) -> Vec<usize> {
    found.law.components.iter().map(|c| c.degrees_of_freedom).collect()
}

fn compare(what: &str, found: &[f64], drawn: &[f64]) {
    println!("{what}: weights {found:.4?}, drawn {drawn:.4?}");
    assert_eq!(found.len(), drawn.len(), "{what}");
    let worst = found.iter().zip(drawn).map(|(f, d)| (f - d).abs()).fold(0.0, f64::max);
    assert!(worst < ERROR, "{what}: weights {found:?}, drawn {drawn:?}");
}

/// The lines with the sign of their second element turned: what a wrong sign would give.
fn mirrored(lines: &[DVector<f64>]) -> Vec<DVector<f64>> {
    let turn = |line: &DVector<f64>| {
        let at = (0..line.len()).rfind(|&i| line[i] != 0.0).expect("a line");
        DVector::from_fn(line.len(), |i, _| if i == at { -line[i] } else { line[i] })
    };
    lines.iter().map(turn).collect()
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Σ is known and singular along a slanted direction of each of two blocks.
#[test]
fn two_slanted_null_directions_of_a_known_covariance() {
    let blocks = vec![vec![0, 1], vec![2, 3]];
    let (first, second) = ([1.0, 0.6], [0.5, -1.2]);
    let sigma = DMatrix::from_fn(4, 4, |i, j| match (i, j) {
        (0..2, 0..2) => first[i] * first[j],
        (2.., 2..) => second[i - 2] * second[j - 2],
        _ => 0.0,
    });
    let lines = [DVector::from_vec(vec![0.6, -1.0, 0.0, 0.0]), DVector::from_vec(vec![0.0, 0.0, 1.2, 0.5])];
    let directions = elements(4, &blocks);
    let (model, null) =
        (of(CovarianceKind::Blocks(blocks)), of(CovarianceKind::Fixed(numbers(4, |i, j| sigma[(i, j)]))));
    for seed in [4, 11] {
        let data = ensemble(recipe(4), seed);
        let (found, _) = ratio(&data, &model, &null);
        assert_eq!((found.degrees_of_freedom, degrees(&found)), (6, vec![4, 5, 6]), "seed {seed}");
        let information = information(&data, &sigma, &directions);
        let drawn = frequencies(&cone(&information, &directions, &lines));
        compare(&format!("seed {seed}"), &weights(&found), &drawn);
        let wrong = frequencies(&cone(&information, &directions, &mirrored(&lines)));
        assert!(largest_difference(&wrong, &drawn) > 2.5 * ERROR, "the sign must matter: {drawn:?} {wrong:?}");
    }
}

/// One null direction in a block of three: n is known up to its length, and the weights are one half each.
#[test]
fn one_slanted_null_direction_halves() {
    let root = DMatrix::from_row_slice(3, 2, &[1.0, 0.2, -0.7, 0.9, 0.4, 1.1]);
    let sigma = &root * root.transpose();
    let data = ensemble(recipe(3), 2);
    let null = of(CovarianceKind::Fixed(numbers(3, |i, j| sigma[(i, j)])));
    let (found, _) = ratio(&data, &CovarianceStructure::full(), &null);
    assert_eq!((degrees(&found), weights(&found)), (vec![5, 6], vec![0.5, 0.5]));
    assert!(!found.law.is_bound && !found.null_on_boundary, "{found:?}");
    // nearly singular is not singular
    let null = of(CovarianceKind::Fixed(numbers(3, |i, j| if i == j { 1.0 } else { 0.95 })));
    assert_eq!(ratio(&data, &CovarianceStructure::full(), &null).0.law.components.len(), 1);
    // rank one of three: two null directions in one block have no such law
    let line = DVector::from_vec(vec![1.0, -0.7, 0.4]);
    let null = of(CovarianceKind::Fixed(numbers(3, |i, j| line[i] * line[j])));
    assert!(ratio(&data, &CovarianceStructure::full(), &null).0.law.is_bound);
}

/// Perfect correlations with standard deviations that are estimated: the null directions are those of the estimates.
#[test]
fn null_directions_follow_the_standard_deviations_of_the_hypothesis() {
    let blocks = vec![vec![0, 1], vec![2, 3]];
    let perfect = numbers(4, |i, j| match (i.min(j), i.max(j)) {
        (0, 1) => 1.0,
        (2, 3) => -1.0,
        (i, j) => f64::from(u8::from(i == j)),
    });
    let (model, null) = (of(CovarianceKind::Blocks(blocks.clone())), of(CovarianceKind::Correlation(perfect)));
    let root = DMatrix::from_row_slice(4, 2, &[4.0, 0.0, 0.7, 0.0, 0.0, 0.8, 0.0, -5.0]);
    let data = spread_by(&root, 21);
    let (found, sigma) = ratio(&data, &model, &null);
    let sd: Vec<f64> = sigma.diagonal().iter().map(|v| v.sqrt()).collect();
    println!("standard deviations {sd:.3?}");
    assert!(sd[0] > 3.0 * sd[1] && sd[3] > 3.0 * sd[2] && sd[1] > 0.1 && sd[2] > 0.1, "far from alike: {sd:?}");
    let lines = [
        DVector::from_vec(vec![sd[0].recip(), -sd[1].recip(), 0.0, 0.0]),
        DVector::from_vec(vec![0.0, 0.0, sd[2].recip(), sd[3].recip()]),
    ];
    let directions = elements(4, &blocks);
    let information = information(&data, &sigma, &directions);
    // what is left of the model beside the hypothesis: directions orthogonal to those of the standard deviations
    let own: Vec<DVector<f64>> = (0..4)
        .map(|k| {
            let moved = DMatrix::from_fn(4, 4, |i, j| {
                (f64::from(u8::from(i == k)) + f64::from(u8::from(j == k))) * sigma[(i, j)]
            });
            along(&moved, &directions)
        })
        .collect();
    assert_eq!((found.degrees_of_freedom, degrees(&found)), (2, vec![0, 1, 2]));
    let normals = cone(&information, &directions, &lines);
    let l = information.clone().cholesky().expect("informed").l();
    for own in &own {
        let inward = (normals.transpose() * (l.transpose() * own)).amax();
        assert!(
            inward < 1e-9 * normals.amax() * (l.transpose() * own).norm(),
            "the hypothesis lies on both planes: {inward}"
        );
    }
    compare("perfect correlations", &weights(&found), &frequencies(&normals));
    let alike = [DVector::from_vec(vec![1.0, -1.0, 0.0, 0.0]), DVector::from_vec(vec![0.0, 0.0, 1.0, 1.0])];
    let wrong = frequencies(&cone(&information, &directions, &alike));
    assert!(largest_difference(&wrong, &weights(&found)) > 3.0 * ERROR, "standard deviations must matter: {wrong:?}");
}

/// Tests of the designs of a recipe, drawn from N(1, FF').
fn spread_by(root: &DMatrix<f64>, seed: u64) -> Reductions {
    let p = root.nrows();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    changed(&ensemble(recipe(p), seed), |_, test| {
        let r = unpacked(&test.factor, p);
        let xi = DVector::from_element(p, 1.0) + root * DVector::from_fn(root.ncols(), |_, _| normal(&mut random));
        let told = |i: usize| f64::from(u8::from(r.row(i).norm() > 0.0));
        test.data = (0..p).map(|i| (r.row(i) * &xi)[0] + told(i) * normal(&mut random)).collect();
    })
}

/// Rows that see the last two of three states together.
fn coupled(random: &mut ChaCha8Rng) -> DMatrix<f64> {
    let rows: Vec<[f64; 3]> = (0..3)
        .map(|_| {
            let (a, b, c) = (normal(random), normal(random), normal(random));
            [a, b, b + 0.5 * c]
        })
        .collect();
    DMatrix::from_fn(3, 3, |i, k| rows[i][k])
}

/// R of these rows, packed, its diagonal not negative.
fn packed(rows: &DMatrix<f64>) -> Vec<f64> {
    let r = rows.clone().qr().r();
    let places = (0..r.ncols()).flat_map(|k| (0..=k).map(move |i| (i, k)));
    places.map(|(i, k)| r[(i, k)] * r[(i, i)].signum()).collect()
}

/// Three and four variances at zero, whose estimates are not equally correlated.
#[test]
fn variances_at_zero_whose_estimates_are_correlated() {
    let diagonal = of(CovarianceKind::Diagonal);
    for p in [3, 4] {
        let zeros: Vec<(usize, usize, f64)> = (0..p).map(|i| (i, i, 0.0)).collect();
        let null = CovarianceStructure { kind: CovarianceKind::Diagonal, ..fixed(&zeros) };
        let mut data = ensemble(recipe(p), 9);
        if p == 3 {
            // the last two states are mostly seen as their sum
            let mut random = ChaCha8Rng::seed_from_u64(2);
            data = changed(&data, |_, test| test.factor = packed(&coupled(&mut random)));
        }
        let (found, sigma) = ratio(&data, &diagonal, &null);
        let directions = elements(p, &(0..p).map(|i| vec![i]).collect::<Vec<_>>());
        let lines: Vec<DVector<f64>> = (0..p).map(|i| DMatrix::identity(p, p).column(i).into_owned()).collect();
        let drawn = frequencies(&cone(&information(&data, &sigma, &directions), &directions, &lines));
        assert_eq!(degrees(&found), (0..=p).collect::<Vec<_>>());
        compare(&format!("{p} variances"), &weights(&found), &drawn);
        let independent: Vec<f64> = found.law.independent.iter().map(|c| c.weight).collect();
        assert!(largest_difference(&independent, &drawn) > 3.0 * ERROR, "correlation must matter: {drawn:?}");
    }
}

/// Directions that the data tell apart badly count as degrees of freedom; those that they do not tell apart do not, though rounding
/// gives them some information.
#[test]
fn degrees_of_freedom_are_the_directions_that_are_identified() {
    let known = of(CovarianceKind::Fixed(numbers(3, |i, j| if i == j { 0.5 } else { 0.0 })));
    let held = MeanStructure { elements: vec![MeanElement::Fixed(0.0); 3], ..MeanStructure::free(3) };
    for (apart, expected) in [(1.0, 3), (1e-2, 3), (1e-4, 3), (0.0, 2)] {
        for seed in 0..6 {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            // the third state is seen as the sum of the others
            let mut design = || {
                let rows: Vec<[f64; 3]> = (0..4)
                    .map(|_| {
                        let (a, b) = (normal(&mut random), normal(&mut random));
                        [a, b, a + b + apart * normal(&mut random)]
                    })
                    .collect();
                packed(&DMatrix::from_fn(4, 3, |i, k| rows[i][k]))
            };
            let data = changed(&ensemble(recipe(3), 1), |_, test| test.factor = design());
            let (narrow, wide) = (fit(&data, &held, &known), fit(&data, &MeanStructure::free(3), &known));
            let found = likelihood_ratio(&narrow, &wide).expect("nested");
            assert_eq!(found.degrees_of_freedom, expected, "apart by {apart:e}, seed {seed}: {:?}", found.law);
        }
    }
}
