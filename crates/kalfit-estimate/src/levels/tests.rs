//! Results for tests in groups against the dense joint Gaussian of all tests of a unit.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::levels::{Units, each_unit, pass, posteriors};
use crate::order::Order;
use crate::order::SumsWanted;
use crate::point::Point;
use crate::{
    Combination, Criterion, Estimate, PhaseStructure, Problem, Settings, Silent, Solver, Stop, Structure, evidence, fit,
};
use kalfit_algebra::symmetric::pair;
use kalfit_filter::reduce::Reductions;
use kalfit_fixtures::dense::Linear;
use kalfit_fixtures::near;
use kalfit_model::Path;
use kalfit_model::Reduction;
use kalfit_model::{Alpha, CovarianceStructure, MeanElement, MeanStructure, Regression};
use kalfit_model::{Grouping, Label, Member, Selection};

/// A deterministic number between -1 and 1 that looks like noise.
fn wave(seed: usize) -> f64 {
    let x = (seed as f64 * 12.9898).sin() * 43758.5453;
    2.0 * (x - x.floor()) - 1.0
}

/// An ensemble of p states in groups.
struct Ensemble {
    p: usize,
    reductions: Reductions,
    grouping: Arc<Grouping>,
    mean: MeanStructure,
    covariances: Vec<CovarianceStructure>,
    alpha: Alpha,
}

/// An ensemble of p states; `members`: numbers of members of a group at each level from the outermost on, tests last;
/// every `shared`-th test has a unique design.
fn ensemble(p: usize, members: &[usize], (shared, regression): (usize, bool)) -> Ensemble {
    let depth = members.len() - 1;
    let mut paths: Vec<Vec<usize>> = vec![Vec::new()];
    for (level, &count) in members.iter().enumerate() {
        // groups differ in size
        let more = |path: &Vec<usize>| count + usize::from(level > 0 && path.last().is_some_and(|x| x % 3 == 1));
        paths = paths
            .iter()
            .flat_map(|path| (0..more(path)).map(move |k| path.iter().copied().chain([k]).collect::<Vec<usize>>()))
            .collect();
    }
    let test = |(j, path): (usize, &Vec<usize>)| {
        let design = if j.is_multiple_of(shared) { 1000 + j } else { j % 2 };
        let factor: Vec<f64> = (0..p)
            .flat_map(|k| (0..=k).map(move |i| (i, k)))
            .map(|(i, k)| match i == k {
                // some tests do not inform some states
                true if (design + k) % 7 == 3 => 0.0,
                true => 1.2 + 0.8 * wave(design * 31 + k),
                false => 0.7 * wave(design * 57 + 5 * i + k),
            })
            .collect();
        let group = |l: usize, i: usize| {
            wave(path[..=l].iter().fold(7 + l, |seed, x| seed * 13 + x) * 11 + i) * (1.0 + i as f64 * 0.3)
        };
        let xi: Vec<f64> = (0..p).map(|i| 0.5 + (0..=depth).map(|l| group(l, i)).sum::<f64>()).collect();
        let data = (0..p)
            .map(|i| (i..p).map(|k| factor[pair(k, 0) + i] * xi[k]).sum::<f64>() + 0.4 * wave(j * 91 + i))
            .collect();
        Reduction {
            test: format!("t{:03}", (j * 37) % 1000), // not in the order of the groups
            constant: wave(j),
            residual: None,
            data,
            factor,
            covariates: if regression { vec![wave(design * 3 + 1)] } else { Vec::new() },
            steps: 1,
            observations: p,
            path: Path::Information,
            design: design as u128,
            chain: None,
            exact: None,
        }
    };
    let reductions: Reductions = paths.iter().enumerate().map(test).collect();
    let label = |path: &Vec<usize>| path[..depth].iter().map(|&k| Label::literal(k)).collect();
    let named = reductions.iter().zip(&paths).map(|(r, path)| (r.test, label(path)));
    let grouping = Arc::new(Grouping::from_paths(depth, named));
    let regression = if regression { vec![Regression { element: 0, column: 0 }] } else { Vec::new() };
    Ensemble {
        p,
        reductions,
        grouping,
        mean: MeanStructure { regression, ..MeanStructure::free(p) },
        covariances: vec![CovarianceStructure::full(); depth + 1],
        alpha: Alpha::default(),
    }
}

/// An ensemble as [`ensemble`] makes, whose tests are also in groups of crossed factors with these numbers of levels;
/// with `apart`, tests of the first third of the units meet levels of their own.
fn crossed(
    p: usize,
    members: &[usize],
    (shared, regression): (usize, bool),
    factors: &[usize],
    apart: bool,
) -> Ensemble {
    let made = ensemble(p, members, (shared, regression));
    let depth = made.grouping.depth();
    let label = |j: usize| {
        let id = made.reductions.id(j);
        let number = made.grouping.number(id).expect("it was named");
        let unit = depth.checked_sub(1).map_or(j, |outermost| made.grouping.group_of(number, outermost));
        let of = |(f, levels): (usize, &usize)| {
            let level = (j * (f + 3) + f + unit * unit) % levels;
            if apart && unit.is_multiple_of(3) { 100 + level } else { level }
        };
        let mut names: Vec<Label> = factors.iter().enumerate().map(of).map(Label::literal).collect();
        let path =
            depth.checked_sub(1).map(|_| made.grouping.groups(0)[made.grouping.group_of(number, 0)].path.clone());
        names.extend(path.unwrap_or_default());
        (id, names)
    };
    let grouping = Grouping::crossed((factors.len(), depth), (0..made.reductions.len()).map(label));
    let covariances = vec![CovarianceStructure::full(); 1 + depth + factors.len()];
    Ensemble { grouping: Arc::new(grouping), covariances, ..made }
}

/// An ensemble as [`ensemble`] makes, whose tests hold two of `units` units in slots that `selections` says the states of,
/// and are in groups of `factors` as [`crossed`] makes them. Some slots are empty; with a `nested` level of none, and no
/// factors, nothing else is shared.
fn slotted(made: Ensemble, units: usize, selections: [&[(usize, usize)]; 2], factors: &[usize]) -> Ensemble {
    let nested = if factors.is_empty() { 0 } else { made.grouping.depth() };
    let slots = selections.map(|pairs| Arc::new(Selection::new(pairs.to_vec()))).to_vec();
    let label = |j: usize| {
        let id = made.reductions.id(j);
        let number = made.grouping.number(id).expect("it was named");
        let in_slots = [j % units, (j + 1 + j / units) % units].map(Label::literal);
        let mut names = if in_slots[0] == in_slots[1] { vec![in_slots[0], Label::MISSING] } else { in_slots.to_vec() };
        names.extend(factors.iter().enumerate().map(|(f, levels)| Label::literal((j * (f + 2) + f) % levels)));
        if nested > 0 {
            names.extend(made.grouping.groups(0)[made.grouping.group_of(number, 0)].path.iter());
        }
        (id, names)
    };
    let all = std::iter::once(slots).chain(factors.iter().map(|_| Vec::new())).collect();
    let grouping = Grouping::with_slots(all, nested, (0..made.reductions.len()).map(label));
    let covariances = vec![CovarianceStructure::full(); 1 + grouping.depth()];
    Ensemble { grouping: Arc::new(grouping), covariances, ..made }
}

impl Ensemble {
    fn structure(&self) -> Structure<'_> {
        let zero = MeanStructure { elements: vec![MeanElement::Fixed(0.0); self.p], ..MeanStructure::free(self.p) };
        let mean = |l: usize| std::borrow::Cow::Owned(if l == 0 { self.mean.clone() } else { zero.clone() });
        let of = |(l, covariance)| PhaseStructure { mean: mean(l), covariance };
        let phases = self.covariances.iter().enumerate().map(of).collect();
        Structure { phases, alpha: &self.alpha, grouping: Some(self.grouping.clone()) }
    }

    fn problem(&self, criterion: Criterion) -> Problem {
        let (structure, settings) = (self.structure(), Settings::default());
        let stacked = evidence(&self.reductions, &structure, &settings).expect("sound");
        Problem::new(&stacked, &structure, (criterion, Combination::Chain)).expect("sound")
    }

    fn estimate(&self, settings: &Settings) -> Estimate {
        fit(&self.reductions, &self.structure(), settings, &mut Silent).expect("a fit")
    }

    /// Tests of each group of the outermost level, all tests where groups cross.
    fn units(&self) -> Vec<Vec<usize>> {
        if self.grouping.is_crossed() {
            return vec![(0..self.reductions.len()).collect()];
        }
        let outermost = self.grouping.depth() - 1;
        let mut units = vec![Vec::new(); self.grouping.groups(outermost).len()];
        for (j, reduction) in self.reductions.iter().enumerate() {
            let number = self.grouping.number(reduction.test).expect("it was named");
            units[self.grouping.group_of(number, outermost)].push(j);
        }
        units
    }

    /// Covariance between ξ of test a and ξ of test b.
    fn between(&self, a: usize, b: usize, sigmas: &[DMatrix<f64>]) -> DMatrix<f64> {
        let number = |j: usize| self.grouping.number(self.reductions.id(j)).expect("it was named");
        let mut sum = if a == b { sigmas[0].clone() } else { DMatrix::zeros(self.p, self.p) };
        for l in 0..self.grouping.depth() {
            for one in self.grouping.members(number(a), l) {
                let same = self.grouping.members(number(b), l).filter(|other| other.group == one.group);
                same.for_each(|other| sum += self.places(one) * &sigmas[l + 1] * self.places(other).transpose());
            }
        }
        sum
    }

    /// E of a group that a test meets.
    fn places(&self, member: Member<'_>) -> DMatrix<f64> {
        let Some(selection) = member.selection else { return DMatrix::identity(self.p, self.p) };
        let mut places = DMatrix::zeros(self.p, self.p);
        selection.pairs().iter().for_each(|&pair| places[pair] = 1.0);
        places
    }

    fn mean_of(&self, j: usize, mean: &[f64], coefficients: &[f64]) -> DVector<f64> {
        let mut mu = DVector::from_column_slice(mean);
        for (r, x) in self.mean.regression.iter().zip(self.reductions.covariates(j)) {
            mu[r.element] += x * coefficients[0];
        }
        mu
    }

    /// Covariance of ξ of all tests of a unit.
    fn prior(&self, unit: &[usize], sigmas: &[DMatrix<f64>]) -> DMatrix<f64> {
        let p = self.p;
        let mut prior = DMatrix::zeros(unit.len() * p, unit.len() * p);
        for (a, &i) in unit.iter().enumerate() {
            for (b, &k) in unit.iter().enumerate() {
                prior.view_mut((a * p, b * p), (p, p)).copy_from(&self.between(i, k, sigmas));
            }
        }
        prior
    }

    /// d of all tests of a unit, given how far their ξ are from their means.
    fn law(&self, unit: &[usize], (mean, coefficients): (&[f64], &[f64])) -> Linear {
        let (p, n) = (self.p, unit.len() * self.p);
        let (mut factor, mut e) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (a, &i) in unit.iter().enumerate() {
            let own = Linear::of(self.reductions.get(i));
            e.rows_mut(a * p, p).copy_from(&own.error(&self.mean_of(i, mean, coefficients)));
            factor.view_mut((a * p, a * p), (p, p)).copy_from(&own.sensitivity);
        }
        Linear { residual: e, sensitivity: factor, covariance: DMatrix::identity(n, n) }
    }

    /// log p of a unit.
    fn dense_unit(&self, unit: &[usize], mean: (&[f64], &[f64]), sigmas: &[DMatrix<f64>]) -> f64 {
        let (law, n) = (self.law(unit, mean), unit.len() * self.p);
        let constant: f64 = unit.iter().map(|&j| self.reductions.get(j).constant).sum();
        let half = 0.5 * n as f64 * std::f64::consts::TAU.ln();
        constant + half + law.log_density(&DVector::zeros(n), &self.prior(unit, sigmas))
    }

    fn dense(&self, mean: (&[f64], &[f64]), sigmas: &[DMatrix<f64>]) -> f64 {
        self.units().iter().map(|unit| self.dense_unit(unit, mean, sigmas)).sum()
    }
}

/// A point of an ensemble, in the user's units, with Σ of the last level of rank one.
fn somewhere(ensemble: &Ensemble, levels: usize) -> (Vec<f64>, Vec<f64>, Vec<DMatrix<f64>>) {
    let p = ensemble.p;
    let mean = (0..p).map(|i| 0.4 + 0.1 * i as f64).collect();
    let sigma = |l: usize| {
        let rank = if l + 1 == levels { 1 } else { p };
        let root =
            DMatrix::from_fn(p, rank, |i, c| if i == c { 0.9 - 0.2 * l as f64 } else { 0.3 * wave(l * 7 + i * 3 + c) });
        &root * root.transpose()
    };
    (mean, vec![0.3; ensemble.mean.regression.len()], (0..levels).map(sigma).collect())
}

/// A point in the user's units, converted to the problem's coordinates.
fn point(problem: &Problem, (mean, coefficients, sigmas): &(Vec<f64>, Vec<f64>, Vec<DMatrix<f64>>)) -> Point {
    let (frame, p) = (&problem.classes.frame, mean.len());
    let all = p * sigmas.len();
    let mut root = DMatrix::zeros(all, all);
    for (l, sigma) in sigmas.iter().enumerate() {
        let scaled = DMatrix::from_fn(p, p, |i, k| sigma[(i, k)] / (frame.scale[i] * frame.scale[k]));
        root.view_mut((l * p, l * p), (p, p)).copy_from(&kalfit_algebra::symmetric::square_root(&scaled));
    }
    let value = |k: usize| if k < p { mean[k] } else { 0.0 };
    let mean: Vec<f64> = (0..all).map(value).collect();
    let (mean, coefficients) = problem.mean.in_eta(frame, &mean, coefficients);
    Point { mean, coefficients, root }
}

fn kinds() -> Vec<Ensemble> {
    vec![
        ensemble(1, &[5, 3], (1, false)),
        ensemble(2, &[4, 3], (3, false)),
        ensemble(3, &[3, 2], (1, true)),
        ensemble(2, &[3, 2, 2], (2, false)),
        ensemble(2, &[2, 2, 2, 2], (4, true)),
        crossed(1, &[14], (1, false), &[4, 3], false),
        crossed(2, &[4, 3], (2, false), &[3], false),
        crossed(2, &[6, 2], (1, true), &[2, 3], true),
        crossed(2, &[2, 2, 2], (2, true), &[3], false),
        slotted(ensemble(2, &[4, 3], (1, false)), 5, [&[(0, 0)], &[(1, 0)]], &[]),
        slotted(ensemble(3, &[3, 3], (1, true)), 4, [&[(0, 0)], &[(2, 0)]], &[3]),
        slotted(ensemble(4, &[8, 3], (2, false)), 7, [&[(0, 0), (1, 1)], &[(3, 1), (2, 0)]], &[2]),
    ]
}

#[test]
fn the_likelihood_and_its_derivatives_are_those_of_the_joint_gaussian() {
    for ensemble in kinds() {
        let levels = ensemble.grouping.depth() + 1;
        let problem = ensemble.problem(Criterion::Ml);
        let here = somewhere(&ensemble, levels);
        let mut sums = problem.likelihood(&point(&problem, &here), Order::Expected);
        let dense = |here: &(Vec<f64>, Vec<f64>, Vec<DMatrix<f64>>)| ensemble.dense((&here.0, &here.1), &here.2);
        let value = dense(&here);
        assert!((sums.value - value).abs() < 1e-10 * (1.0 + value.abs()), "{} {value}", sums.value);
        // derivatives by differences of the dense ℓ, in the user's units
        let (p, frame, h) = (ensemble.p, &problem.classes.frame, 1e-4);
        let moved = |x: &[f64]| {
            let mut there = here.clone();
            let mut x = x.iter();
            there.0.iter_mut().for_each(|m| *m += x.next().expect("as many"));
            for sigma in &mut there.2 {
                for i in 0..p {
                    for k in 0..=i {
                        let by = x.next().expect("as many");
                        sigma[(i, k)] += by;
                        sigma[(k, i)] = sigma[(i, k)];
                    }
                }
            }
            dense(&there)
        };
        let elements = &sums.elements.clone();
        let unit = |at: usize| match at.checked_sub(p) {
            None => frame.scale[at],
            Some(e) => {
                let (i, k) = elements.at(e).expect("an element");
                frame.scale[i] * frame.scale[k]
            }
        };
        let n = p + elements.count();
        let (score, observed) = (elements.pack_score(&sums.score()), sums.observed_information());
        let cross = sums.cross_information();
        for a in 0..n {
            let step = |by: &[(usize, f64)]| {
                let mut x = vec![0.0; n];
                by.iter().for_each(|&(at, h)| x[at] += h);
                moved(&x)
            };
            let slope = (step(&[(a, h)]) - step(&[(a, -h)])) / (2.0 * h) * unit(a);
            let found = if a < p { sums.mean_score[a] } else { score[a - p] };
            assert!((slope - found).abs() < 1e-5 * (1.0 + found.abs()), "score {a}: {found} {slope}");
            for b in 0..=a {
                let bend = step(&[(a, h), (b, h)]) - step(&[(a, h), (b, -h)]) - step(&[(a, -h), (b, h)])
                    + step(&[(a, -h), (b, -h)]);
                let bend = -bend / (4.0 * h * h) * unit(a) * unit(b);
                let found = match (a.checked_sub(p), b.checked_sub(p)) {
                    (None, _) => sums.mean_information[(a, b)],
                    (Some(e), None) => cross[(b, e)],
                    (Some(e), Some(f)) => observed[(e, f)],
                };
                assert!((bend - found).abs() < 2e-4 * (1.0 + found.abs()), "second {a} {b}: {found} {bend}");
            }
        }
    }
}

#[test]
fn the_expected_information_is_what_the_observed_one_is_on_average() {
    // expected: ½ tr(Ω⁻¹ dΩ Ω⁻¹ dΩ) of the joint Gaussian
    for ensemble in kinds() {
        let levels = ensemble.grouping.depth() + 1;
        let problem = ensemble.problem(Criterion::Ml);
        let here = somewhere(&ensemble, levels);
        let sums = problem.likelihood(&point(&problem, &here), Order::Expected);
        let (p, frame, elements) = (ensemble.p, &problem.classes.frame, &sums.elements);
        let mut expected = DMatrix::<f64>::zeros(elements.count(), elements.count());
        for unit in ensemble.units() {
            let law = ensemble.law(&unit, (&here.0, &here.1));
            let factor = &law.sensitivity;
            let total = law.total(&ensemble.prior(&unit, &here.2));
            let inverse = total.cholesky().expect("positive").inverse();
            let slopes: Vec<DMatrix<f64>> = elements
                .all()
                .map(|(i, k)| {
                    let mut sigmas = vec![DMatrix::zeros(p, p); levels];
                    let sigma = &mut sigmas[i / p];
                    sigma[(i % p, k % p)] = frame.scale[i] * frame.scale[k];
                    sigma[(k % p, i % p)] = frame.scale[i] * frame.scale[k];
                    let prior = ensemble.prior(&unit, &sigmas);
                    &inverse * factor * prior * factor.transpose()
                })
                .collect();
            for (a, one) in slopes.iter().enumerate() {
                for (b, other) in slopes.iter().enumerate() {
                    expected[(a, b)] += 0.5 * (one * other).trace();
                }
            }
        }
        let found = sums.expected_information();
        let off = (&found - &expected).amax();
        assert!(off < 1e-9 * expected.amax(), "{found} {expected}");
    }
}

#[test]
fn posteriors_are_those_of_the_joint_gaussian() {
    for ensemble in kinds() {
        let levels = ensemble.grouping.depth() + 1;
        let problem = ensemble.problem(Criterion::Ml);
        let here = somewhere(&ensemble, levels);
        let place = point(&problem, &here);
        let units: &Units = problem.classes.units.as_ref().expect("there are groups");
        let constants: Vec<f64> = ensemble.reductions.iter().map(|r| r.constant).collect();
        let found = posteriors(units, (&place, &problem.mean.regressors), Some(&constants), false);
        let (p, frame) = (ensemble.p, &problem.classes.frame);
        let mut log_density = 0.0;
        for unit in ensemble.units() {
            let value = ensemble.dense_unit(&unit, (&here.0, &here.1), &here.2);
            let (law, prior) = (ensemble.law(&unit, (&here.0, &here.1)), ensemble.prior(&unit, &here.2));
            let e = &law.residual;
            let quadratic = e.dot(&law.total(&prior).cholesky().expect("positive").solve(e));
            let (shift, covariance) = law.given(&DVector::zeros(e.len()), &prior);
            for (a, &j) in unit.iter().enumerate() {
                let own = &found.tests[ensemble.grouping.number(ensemble.reductions.id(j)).expect("it was named")];
                let mean = ensemble.mean_of(j, &here.0, &here.1);
                for i in 0..p {
                    let got = frame.centre[i] + frame.scale[i] * own.mean[i];
                    let want = mean[i] + shift[a * p + i];
                    assert!((got - want).abs() < 1e-9 * (1.0 + want.abs()), "mean {j} {i}: {got} {want}");
                    for k in 0..p {
                        let got = own.covariance[i * p + k] * frame.scale[i] * frame.scale[k];
                        let want = covariance[(a * p + i, a * p + k)];
                        assert!((got - want).abs() < 1e-9, "covariance {j} {i} {k}: {got} {want}");
                    }
                }
            }
            if ensemble.grouping.is_crossed() {
                log_density += value;
                continue;
            }
            let number = ensemble.grouping.number(ensemble.reductions.id(unit[0])).expect("it was named");
            let group = &found.groups[levels - 2][ensemble.grouping.group_of(number, levels - 2)];
            assert!((group.log_density - value).abs() < 1e-9, "{} {value}", group.log_density);
            let all = group.squared + group.within;
            assert!((all - quadratic).abs() < 1e-9 * (1.0 + quadratic), "squares {all} {quadratic}");
            log_density += group.log_density;
        }
        let all = ensemble.dense((&here.0, &here.1), &here.2);
        assert!((log_density - all).abs() < 1e-9 * (1.0 + all.abs()), "{log_density} {all}");
    }
}

/// Derivatives of the mean of a group against differences along each mean coordinate.
#[test]
fn means_of_groups_follow_mean_and_coefficients() {
    for ensemble in kinds() {
        let problem = ensemble.problem(Criterion::Ml);
        let here = somewhere(&ensemble, ensemble.grouping.depth() + 1);
        let units: &Units = problem.classes.units.as_ref().expect("there are groups");
        let at = |place: &Point| posteriors(units, (place, &problem.mean.regressors), None, true);
        let (place, p) = (point(&problem, &here), ensemble.p);
        let (found, width) = (at(&place), p + here.1.len());
        for c in 0..width {
            let side = |step: f64| {
                let mut place = place.clone();
                *if c < p { &mut place.mean[c] } else { &mut place.coefficients[c - p] } += step;
                at(&place)
            };
            let (low, high) = (side(-0.5), side(0.5)); // the mean is linear in the coordinates
            for (level, groups) in found.groups.iter().enumerate() {
                for (g, own) in groups.iter().enumerate() {
                    for i in 0..p {
                        let expected = high.groups[level][g].mean[i] - low.groups[level][g].mean[i];
                        let found = own.follows[i * width + c];
                        assert!((found - expected).abs() < 1e-9, "{level} {g}: {i} by {c}: {found} {expected}");
                    }
                }
            }
        }
    }
}

#[test]
fn what_all_tests_of_a_group_say_alike_has_its_own_rank() {
    // every test informs the same combination of two states; folding leaves rounding errors in the second row
    let mut ensemble = ensemble(2, &[4, 5], (1, false));
    let alike = |(j, r): (usize, kalfit_filter::reduce::ReductionRef<'_>)| {
        let size = 0.3 + 0.1 * j as f64;
        Reduction { factor: vec![size, size / 3.0, 0.0], data: vec![wave(j), 0.0], ..r.into() }
    };
    ensemble.reductions = ensemble.reductions.iter().enumerate().map(alike).collect();
    let problem = ensemble.problem(Criterion::Ml);
    let place = point(&problem, &somewhere(&ensemble, 2));
    let units: &Units = problem.classes.units.as_ref().expect("there are groups");
    let found = posteriors(units, (&place, &problem.mean.regressors), None, false);
    let ranks: Vec<usize> = found.groups[0].iter().map(|group| group.degrees_of_freedom).collect();
    assert_eq!(ranks, [1; 4]);
}

#[test]
fn both_solvers_come_to_a_certified_maximum() {
    for (number, ensemble) in kinds().into_iter().enumerate().filter(|(number, _)| *number != 4) {
        println!("kind {number}");
        for criterion in [Criterion::Ml, Criterion::Reml] {
            let newton = ensemble.estimate(&Settings { criterion, ..Settings::default() });
            assert_eq!(newton.stop, Stop::Certified, "{:?}", newton.certificate);
            let em = Settings { criterion, tolerance: 1e-2, max_passes: 2_000, ..Settings::of(Solver::Em) };
            let em = ensemble.estimate(&em);
            let (a, b) = (newton.log_likelihood, em.log_likelihood);
            // where Σ is singular EM may need very many steps
            let allowed = if em.stop == Stop::Certified { 1e-3 } else { 1e-1 };
            assert!(a >= b - 1e-6 && (a - b).abs() < allowed * (1.0 + a.abs()), "{criterion:?}: {a} {b} {:?}", em.stop);
        }
    }
}

/// The ensemble with some tests measured so many times as precisely.
fn precise(ensemble: Ensemble, times: f64) -> Ensemble {
    let scaled = |(j, r): (usize, kalfit_filter::reduce::ReductionRef<'_>)| {
        let by = if j.is_multiple_of(5) { times } else { 1.0 };
        let own: Reduction = r.into();
        Reduction {
            // the noise of [`ensemble`] stays what it was
            data: own.data.iter().enumerate().map(|(i, x)| x * by - (by - 1.0) * 0.4 * wave(j * 91 + i)).collect(),
            factor: own.factor.iter().map(|x| x * by).collect(),
            design: own.design + if by > 1.0 { 1 << 60 } else { 0 },
            ..own
        }
    };
    let reductions = ensemble.reductions.iter().enumerate().map(scaled).collect();
    Ensemble { reductions, ..ensemble }
}

#[test]
fn values_and_scores_are_right_where_some_tests_are_precise() {
    for times in [1e2, 1e3] {
        let ensemble = precise(crossed(2, &[14], (1, false), &[4, 3], false), times);
        let problem = ensemble.problem(Criterion::Ml);
        let (mean, coefficients, mut sigmas) = somewhere(&ensemble, 3);
        // the tests' own covariance has rank one
        let root = DMatrix::from_column_slice(2, 1, &[0.5, 0.2]);
        sigmas[0] = &root * root.transpose();
        let dense = ensemble.dense((&mean, &coefficients), &sigmas);
        let here = point(&problem, &(mean, coefficients, sigmas));
        let sums = problem.likelihood(&here, Order::First);
        near::mixed("value", sums.value, dense, 1e-9);
        let elements = sums.elements.clone();
        let (score, sigma) = (elements.pack_score(&sums.score()), here.covariance());
        let at = |e: usize, by: f64| {
            let (i, k) = elements.at(e).expect("an element");
            let mut sigma = sigma.clone();
            sigma[(i, k)] += by;
            sigma[(k, i)] = sigma[(i, k)];
            let mut moved = here.clone();
            let own = sigma.view((2, 2), (2, 2)).into_owned();
            moved.root.view_mut((2, 2), (2, 2)).copy_from(&kalfit_algebra::symmetric::square_root(&own));
            problem.likelihood(&moved, Order::First).value
        };
        for e in 3..6 {
            let (i, k) = elements.at(e).expect("an element");
            let h = 1e-3 * (sigma[(i, i)] * sigma[(k, k)]).sqrt();
            let slope = (8.0 * (at(e, h) - at(e, -h)) - (at(e, 2.0 * h) - at(e, -2.0 * h))) / (12.0 * h);
            assert!((score[e] - slope).abs() < 1e-5 * slope.abs(), "{times}, element {e}: {} {slope}", score[e]);
        }
    }
}

#[test]
fn a_factor_that_contains_all_units_says_what_a_level_says() {
    let nested = ensemble(2, &[3, 2, 3], (2, true));
    let label = |j: usize| {
        let id = nested.reductions.id(j);
        let number = nested.grouping.number(id).expect("it was named");
        let path = nested.grouping.groups(0)[nested.grouping.group_of(number, 0)].path.clone();
        // units are numbered within their lots
        let unit = Label::literal(nested.grouping.group_of(number, 0));
        (id, vec![path[0], unit])
    };
    let grouping = Arc::new(Grouping::crossed((1, 1), (0..nested.reductions.len()).map(label)));
    let crossed = Ensemble { grouping, ..ensemble(2, &[3, 2, 3], (2, true)) };
    let here = somewhere(&nested, 3);
    let all = |ensemble: &Ensemble, criterion: Criterion| {
        let problem = ensemble.problem(criterion);
        let at = point(&problem, &here);
        let first = problem.sums(&at, Order::Expected, None).expect("it is defined");
        let near = first.near().cloned();
        let mut sums = problem.sums(&at, Order::Expected, near.as_ref()).expect("it is defined");
        let matrices =
            [sums.score(), sums.mean_information.clone(), sums.expected_information(), sums.cross_information()];
        let observed = sums.observed_information();
        (sums.value, sums.mean_score.clone(), matrices.into_iter().chain([observed]).collect::<Vec<_>>())
    };
    for criterion in [Criterion::Ml, Criterion::Reml] {
        let (found, expected) = (all(&crossed, criterion), all(&nested, criterion));
        near::mixed("value", found.0, expected.0, 1e-12);
        assert!((&found.1 - &expected.1).amax() < 1e-10 * (1.0 + expected.1.amax()), "{} {}", found.1, expected.1);
        for (which, (a, b)) in found.2.iter().zip(&expected.2).enumerate() {
            assert!((a - b).amax() < 1e-9 * (1.0 + b.amax()), "{criterion:?} {which}: {a} {b}");
        }
    }
}

#[test]
fn with_one_test_in_each_group_the_answer_is_that_of_one_level() {
    let mut ensemble = ensemble(2, &[12, 1], (1, false));
    ensemble.covariances[1].fixed = (0..2)
        .map(|i| kalfit_model::FixedElement { i, j: i, value: 0.0 })
        .chain([kalfit_model::FixedElement { i: 1, j: 0, value: 0.0 }])
        .collect();
    let alone = ensemble.reductions.clone();
    let one = Structure::single(&ensemble.mean, &ensemble.covariances[0], &ensemble.alpha);
    for criterion in [Criterion::Ml, Criterion::Reml] {
        let settings = Settings { criterion, ..Settings::default() };
        let found = ensemble.estimate(&settings);
        let expected = fit(&alone, &one, &settings, &mut Silent).expect("a fit");
        let (a, b) = (found.log_likelihood, expected.log_likelihood);
        assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} {b}");
        let off = (found.covariance.view((0, 0), (2, 2)) - &expected.covariance).amax();
        assert!(off < 1e-6, "{} {}", found.covariance, expected.covariance);
    }
}

#[test]
fn units_in_lanes_say_what_they_say_one_by_one() {
    // lots with trees of different shapes: lanes without a unit, units without some groups and tests
    for ensemble in
        [ensemble(2, &[11, 3, 2], (1, true)), ensemble(3, &[2, 4], (2, false)), ensemble(1, &[9, 1], (1, false))]
    {
        let problem = ensemble.problem(Criterion::Ml);
        let here = somewhere(&ensemble, ensemble.grouping.depth() + 1);
        let point = point(&problem, &here);
        let units = problem.classes.units.as_ref().expect("they are in groups");
        let regressors = &problem.mean.regressors;
        let wanted = SumsWanted { elements: &problem.classes.elements, regressors, order: Order::First, flat: None };
        let together = pass(units, &point, wanted);
        let (mut value, mut score) = (units.constant, DVector::zeros(together.mean_score.len()));
        let (mut outer, mut weight) = (together.outer.clone() * 0.0, together.weight.clone() * 0.0);
        let mut tests = 0;
        each_unit(units, &point, wanted, &mut |reductions, sums| {
            value += sums.value;
            score += &sums.mean_score;
            outer += &sums.outer;
            weight += &sums.weight;
            tests += reductions.len();
        });
        assert_eq!(tests, ensemble.reductions.len());
        assert!((together.value - value).abs() < 1e-12 * value.abs(), "{} {value}", together.value);
        let check = |what: &str, found: &[f64], expected: &[f64]| {
            assert_eq!(found.len(), expected.len(), "{what}");
            found.iter().zip(expected).for_each(|(a, b)| near::mixed(what, *a, *b, 1e-11));
        };
        check("score of μ", together.mean_score.as_slice(), score.as_slice());
        check("outer products", together.outer.as_slice(), outer.as_slice());
        check("weight", together.weight.as_slice(), weight.as_slice());
    }
}
