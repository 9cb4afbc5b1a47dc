//! Gradients, information and searches on a small bench of instruments: two noise levels that vary within a test, a drift.

use crate::joint::JointInformation;
use crate::profile_likelihood::ProfileLikelihood;
use crate::record::{Candidate, Origin};
use crate::sample::promising;
use crate::search_state::SearchState;
use crate::start::starts;
use crate::{DynamicFit, Method, Settings, fit};
use kalfit_estimate::{Criterion, Silent, Stop};
use kalfit_fixtures::bench::{NOISE, ensemble, model, scaled_model, twins};
use kalfit_fixtures::slope;
use kalfit_model::PhasedTest;
use kalfit_model::{Motion, PhasedModel, Slots, Value};

pub(super) fn settings(method: Method, criterion: Criterion) -> Settings {
    let mut settings = Settings { method, ..Settings::default() };
    settings.inner.criterion = criterion;
    settings
}

/// Checks that the gradient of both likelihoods at these values is that of differences.
pub(super) fn check_gradient((model, tests, slots): (&PhasedModel, &[PhasedTest], &Slots), values: &[f64]) {
    for criterion in [Criterion::Ml, Criterion::Reml] {
        let settings = settings(Method::Hybrid, criterion);
        let objective = ProfileLikelihood::new(model, tests, slots, &settings);
        let iterate = objective.solve(values, None).expect("defined");
        assert_eq!(iterate.gradient.len(), values.len());
        for (s, found) in iterate.gradient.iter().enumerate() {
            let at = |h: f64| {
                let mut moved = values.to_vec();
                moved[s] = objective.coordinates[s].moved(moved[s], h);
                objective.value(&moved).expect("defined")
            };
            let expected = slope(at, 1e-3);
            assert!((found - expected).abs() < 1e-7 * (1.0 + expected.abs()), "{criterion:?} {s}: {found} {expected}");
        }
    }
}

/// Checks that two fits end at one point.
pub(super) fn check_alike(one: &DynamicFit, other: &DynamicFit, what: &str) {
    let (a, b) = (one.estimate.log_likelihood, other.estimate.log_likelihood);
    assert!((a - b).abs() < 1e-8, "{what}: {a} {b}");
    for (a, b) in one.values.iter().zip(&other.values) {
        assert!((a - b).abs() < 1e-5 * (1.0 + a.abs()), "{what}: {a} {b}");
    }
}

#[test]
fn the_gradient_equals_differences_of_the_maximum_over_mean_and_covariance() {
    let model = model(false);
    let (labels, tests) = ensemble(&model, 8, 7);
    let slots = Slots::in_phases(&model, &labels, &tests);
    assert_eq!(slots.len(), 5, "tau, sigma_drift, sigma of A and of B, slope");
    check_gradient((&model, &tests, &slots), &[1.2, 0.6, 0.35, 0.5, 0.1]);
}

/// Tests of [`model`] in three groups, which stations of two levels and days of four cross.
fn crossed(model: &PhasedModel) -> (PhasedModel, Vec<PhasedTest>) {
    let (_, tests) = ensemble(model, 12, 5);
    let mut model = model.clone();
    let factor = |name: &str, column: usize, crossed: bool| kalfit_model::GroupLevel {
        name: name.to_owned(),
        column,
        crossed,
        covariance: kalfit_model::CovarianceStructure::full(),
        members: Vec::new(),
    };
    model.levels = vec![factor("station", 2, true), factor("day", 3, true), factor("unit", 4, false)];
    for name in ["station", "day", "unit"] {
        let column = kalfit_model::Column { name: name.to_owned(), used_in: String::new() };
        model.models_mut().for_each(|phase| phase.text_columns.push(column.clone()));
    }
    let grouped = |(j, test): (usize, &PhasedTest)| {
        let kalfit_model::Evidence::Rows(rows) = &test.phases[0] else { unreachable!("rows") };
        let mut own = kalfit_model::Test::new(test.id.clone(), 3, 5);
        let groups = [j % 2, (j * 5 + j / 4) % 4, j % 3].map(kalfit_model::Label::literal);
        for row in 0..rows.rows() {
            let texts = [rows.texts(row), &groups].concat();
            own.push(rows.numbers(row), &texts, rows.source(row));
        }
        PhasedTest::from(own)
    };
    let tests = tests.iter().enumerate().map(grouped).collect();
    (model, tests)
}

#[test]
fn the_gradient_equals_differences_where_groups_cross() {
    let (model, tests) = crossed(&model(false));
    let labels = kalfit_model::Labels::new(&model.shared().literals);
    let slots = Slots::in_phases(&model, &labels, &tests);
    check_gradient((&model, &tests, &slots), &[1.2, 0.6, 0.35, 0.5, 0.1]);
}

#[test]
fn a_scale_of_all_noise_moves_without_the_filters() {
    let model = scaled_model();
    let (labels, tests) = ensemble(&model, 9, 7);
    let slots = Slots::in_phases(&model, &labels, &tests);
    for criterion in [Criterion::Ml, Criterion::Reml] {
        let settings = settings(Method::Hybrid, criterion);
        let objective = ProfileLikelihood::new(&model, &tests, &slots, &settings);
        let filtered = ProfileLikelihood::new(&model, &tests, &slots, &settings).unscaled();
        for value in [0.4, 0.05, 3.0] {
            let (found, expected) = (objective.solve(&[value], None), filtered.solve(&[value], None));
            let (found, expected) = (found.expect("defined"), expected.expect("defined"));
            let (a, b) = (found.value(), expected.value());
            assert!((a - b).abs() < 1e-10 * b.abs(), "{criterion:?} {value}: {a} {b}");
            let (a, b) = (found.gradient[0], expected.gradient[0]);
            assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{criterion:?} {value}: {a} {b}");
            let [one, other] =
                [(&objective, &found), (&filtered, &expected)].map(|(objective, at)| objective.of_tests(at));
            for (one, other) in one.expect("defined").scores.iter().zip(&other.expect("defined").scores) {
                let (a, b) = (one[0].1, other[0].1);
                assert_eq!(one[0].0, other[0].0);
                assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{criterion:?} {value}: {a} {b}");
            }
        }
        assert_eq!(
            (objective.filter_passes(), objective.score_passes()),
            (1, 0),
            "the filters ran at one value, and never back"
        );
        assert_eq!((filtered.filter_passes(), filtered.score_passes()), (3, 3));
    }
}

/// Of random ensembles, over twelve powers of four: the bound holds, what is left out cannot be the best, nothing is tried
/// twice, and the restricted likelihood, which has no bound, leaves nothing out.
#[test]
fn a_noise_level_that_cannot_be_the_best_is_not_tried() {
    let model = scaled_model();
    let places: Vec<Vec<f64>> = (-6..=6).map(|k| vec![0.4 * 4_f64.powi(k)]).collect();
    for (seed, criterion) in [(7, Criterion::Ml), (8, Criterion::Ml), (9, Criterion::Ml), (7, Criterion::Reml)] {
        let (labels, tests) = ensemble(&model, 9, seed);
        let slots = Slots::in_phases(&model, &labels, &tests);
        let settings = settings(Method::Hybrid, criterion);
        let plain = ProfileLikelihood::new(&model, &tests, &slots, &settings).unscaled();
        let expected: Vec<f64> = places.iter().map(|place| plain.value(place).expect("defined")).collect();
        let best = expected.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let objective = ProfileLikelihood::new(&model, &tests, &slots, &settings);
        let found = objective.tried_values(&places, 1, &mut || true);
        let mut left_out = 0;
        for (found, expected) in found.iter().zip(&expected) {
            match found {
                Some(found) => assert!((found - expected).abs() < 1e-6 * expected.abs(), "{found} {expected}"),
                None => {
                    assert!(*expected < best, "{expected} of {best}");
                    left_out += 1;
                }
            }
        }
        assert!(if criterion == Criterion::Ml { left_out >= 6 } else { left_out == 0 }, "{criterion:?}: {left_out}");
        for (place, expected) in places.iter().zip(&expected) {
            let bound = objective.bounds(&[place])[0];
            assert!(bound >= *expected, "{place:?}: {expected} above {bound}");
        }
        let mut asked = 0;
        objective.tried_values(&places[6..7], 1, &mut || {
            asked += 1;
            true
        });
        assert!(found[6].is_none() || asked == 0, "it was tried before");
        assert!(objective.tried_values(&[vec![0.41]], 1, &mut || false) == [None], "nobody waits");
    }
}

#[test]
fn a_scale_far_from_where_the_filters_ran_has_them_run_again() {
    let model = scaled_model();
    let (labels, tests) = ensemble(&model, 9, 7);
    let slots = Slots::in_phases(&model, &labels, &tests);
    let settings = settings(Method::Hybrid, Criterion::Ml);
    let objective = ProfileLikelihood::new(&model, &tests, &slots, &settings);
    let filtered = ProfileLikelihood::new(&model, &tests, &slots, &settings).unscaled();
    // where all noise is 1e-8 of its size, half the digits of a constant would be those of the sum of squares
    for (value, runs) in [(5e-9, 1), (0.5, 2), (0.4, 2), (7e-3, 2), (4e-3, 3)] {
        let found = objective.solve(&[value], None).expect("defined").value();
        let expected = filtered.solve(&[value], None).expect("defined").value();
        assert!((found - expected).abs() < 1e-11 * expected.abs(), "{value}: {found} {expected}");
        assert_eq!(objective.filter_passes(), runs, "at {value}");
    }
}

#[test]
fn the_information_in_a_scale_of_all_noise_is_that_of_differences() {
    for positive in [true, false] {
        let mut model = scaled_model();
        model.phases[0].model.parameters[NOISE].positive = positive;
        let (labels, tests) = ensemble(&model, 9, 7);
        let slots = Slots::in_phases(&model, &labels, &tests);
        for criterion in [Criterion::Ml, Criterion::Reml] {
            let settings = settings(Method::Hybrid, criterion);
            let objective = ProfileLikelihood::new(&model, &tests, &slots, &settings);
            let filtered = ProfileLikelihood::new(&model, &tests, &slots, &settings).unscaled();
            for value in [0.3, 0.9] {
                let iterate = objective.solve(&[value], None).expect("defined");
                let by_filters = filtered.solve(&[value], None).expect("defined");
                let found = JointInformation::new(&objective, &iterate, &[true], false).undivided_matrix();
                let expected = JointInformation::new(&filtered, &by_filters, &[true], true).undivided_matrix();
                let off = (&found - &expected).amax() / expected.amax();
                assert!(off < 1e-6, "{criterion:?} {value} {positive}: {found} {expected}");
            }
            assert_eq!(objective.filter_passes(), 1, "the filters ran for the scale alone");
        }
    }
}

#[test]
fn what_scales_but_a_part_of_the_noise_runs_the_filters() {
    let mut model = scaled_model();
    model.phases[0].model.parameters[NOISE].lower = Some(0.0);
    if let Motion::Continuous { noise_variance, .. } = &mut model.phases[0].model.states[2].motion {
        *noise_variance = kalfit_fixtures::by_hand::number(0.1);
    }
    let (labels, tests) = ensemble(&model, 4, 5);
    let slots = Slots::in_phases(&model, &labels, &tests);
    let settings = settings(Method::Hybrid, Criterion::Ml);
    let objective = ProfileLikelihood::new(&model, &tests, &slots, &settings);
    let filtered = ProfileLikelihood::new(&model, &tests, &slots, &settings).unscaled();
    for value in [0.4, 0.8] {
        let (found, expected) = (objective.value(&[value]), filtered.value(&[value]));
        assert_eq!(found, expected);
    }
    assert_eq!(objective.filter_passes(), 2);
}

#[test]
fn the_joint_information_is_that_of_the_gradient_at_the_best_mean_and_covariance() {
    let model = model(false);
    let (labels, tests) = ensemble(&model, 14, 9);
    let slots = Slots::in_phases(&model, &labels, &tests);
    for criterion in [Criterion::Ml, Criterion::Reml] {
        let settings = settings(Method::Hybrid, criterion);
        let objective = ProfileLikelihood::new(&model, &tests, &slots, &settings);
        let values = fit(&model, &labels, &tests, &settings, &mut Silent).expect("a fit").values;
        let iterate = objective.solve(&values, None).expect("defined");
        let found = JointInformation::new(&objective, &iterate, &[true; 5], true).covariances();
        // the profile information, by differences of gradients that each come with their own mean and covariance
        let h = 1e-4;
        let information = nalgebra::DMatrix::from_fn(5, 5, |i, s| {
            let at = |sign: f64| {
                let mut moved = values.clone();
                moved[s] = objective.coordinates[s].moved(moved[s], sign * h);
                objective.solve(&moved, None).expect("defined").gradient[i]
            };
            -(at(1.0) - at(-1.0)) / (2.0 * h)
        });
        let expected = information.try_inverse().expect("regular");
        for s in 0..5 {
            let found = found.alpha[s].expect("determined");
            let off = (found / expected[(s, s)] - 1.0).abs();
            assert!(off < 1e-5, "{criterion:?} {s}: {found} {}", expected[(s, s)]);
        }
    }
}

#[test]
fn the_methods_end_at_one_point() {
    let model = model(false);
    let (labels, tests) = ensemble(&model, 12, 8);
    let run = |method| {
        let settings = settings(method, Criterion::Ml);
        let fit = fit(&model, &labels, &tests, &settings, &mut Silent).expect("a fit");
        assert_eq!(fit.stop, Stop::Certified, "{method:?}");
        fit
    };
    let hybrid = run(Method::Hybrid);
    for method in [Method::Innovations, Method::Em] {
        check_alike(&hybrid, &run(method), &format!("{method:?}"));
    }
}

#[test]
fn a_fit_has_the_same_bits_whatever_the_order_of_the_tests() {
    let model = model(false);
    let (labels, tests) = ensemble(&model, 9, 6);
    let run = |tests: &[PhasedTest]| {
        fit(&model, &labels, tests, &settings(Method::Hybrid, Criterion::Ml), &mut Silent).expect("a fit")
    };
    let (forward, backward) = (run(&tests), run(&tests.iter().rev().cloned().collect::<Vec<_>>()));
    assert_eq!(forward.values, backward.values);
    assert_eq!(forward.estimate.covariance, backward.estimate.covariance);
    assert_eq!(forward.trace, backward.trace);
}

#[test]
fn values_of_single_tests_are_eliminated_exactly() {
    let model = model(true);
    let (labels, tests) = ensemble(&model, 30, 16);
    let slots = Slots::in_phases(&model, &labels, &tests);
    assert_eq!(slots.len(), 33, "tau, sigma_drift, slope, and sigma of thirty tests");
    let settings = settings(Method::Hybrid, Criterion::Ml);
    let objective = ProfileLikelihood::new(&model, &tests, &slots, &settings);
    let values = fit(&model, &labels, &tests, &settings, &mut Silent).expect("a fit").values;
    let iterate = objective.solve(&values, None).expect("defined");
    let joint = JointInformation::new(&objective, &iterate, &[true; 33], true);
    assert_eq!(joint.shared().len(), 3, "the others are of single tests");
    let whole = joint.undivided();
    let inner = iterate.estimate.state.newton_iterate.tangent.gradient.clone();
    let (a, b) = (joint.step(&iterate.gradient, &inner, 0.0), whole.step(&iterate.gradient, &inner, 0.0));
    assert!(a.concave && b.concave, "at a maximum the curvature is positive");
    for (a, b) in a.alpha.iter().zip(&b.alpha) {
        assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} {b}");
    }
    let (a, b) = (joint.covariances(), whole.covariances());
    for (a, b) in a.alpha.iter().zip(&b.alpha) {
        let (a, b) = (a.expect("determined"), b.expect("determined"));
        assert!((a / b - 1.0).abs() < 1e-8, "{a} {b}");
    }
    let (k, m) = (a.shared.len(), a.whole.nrows() - a.shared.len());
    let (a, b) = (a.whole.view((k, k), (m, m)), b.whole.view((33, 33), (m, m)));
    assert!((a - b).amax() < 1e-8 * b.amax(), "{a} {b}");
}

#[test]
fn first_values_do_not_depend_on_the_order_of_the_tests() {
    let mut model = model(false);
    model.phases[0].model.parameters.iter_mut().for_each(|parameter| parameter.value = Value::Free { start: None });
    let (labels, tests) = ensemble(&model, 30, 16);
    // all tests in reverse order
    let shuffled: Vec<PhasedTest> = tests.chunks(10).rev().flat_map(|part| part.iter().rev().cloned()).collect();
    let settings = settings(Method::Hybrid, Criterion::Ml);
    let first = |tests: &[PhasedTest]| {
        let slots = Slots::in_phases(&model, &labels, tests);
        let starts = starts(&ProfileLikelihood::new(&model, tests, &slots, &settings), &mut Silent).expect("defined");
        starts.into_iter().next().expect("one at least")
    };
    let (one, other) = (first(&tests), first(&shuffled));
    let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
    assert_eq!(bits(&one.values), bits(&other.values), "{one:?} {other:?}");
}

#[test]
fn processes_that_coincide_become_one_in_a_search_unless_they_are_held() {
    let model = twins();
    let (labels, tests) = ensemble(&model, 8, 12);
    let slots = Slots::in_phases(&model, &labels, &tests);
    let settings = settings(Method::Hybrid, Criterion::Ml);
    let objective = ProfileLikelihood::new(&model, &tests, &slots, &settings);
    assert_eq!(objective.twins.len(), 1, "they may change places");
    let search = |values: [f64; 5], held: Option<usize>, silent: &mut Silent| {
        let iterate = objective.solve(&values, None).expect("defined");
        let before = iterate.value();
        let mut search = SearchState::new(&objective, silent, iterate);
        held.into_iter().for_each(|s| search.hold(s));
        (search.merge_pair(), search.iterate.value() - before, search.iterate.values.clone())
    };
    let (merge_pair, gain, values) = search([1.5, 0.3, 1.5, 0.4, 0.5], None, &mut Silent);
    assert!(merge_pair && gain.abs() < 1e-9, "ℓ rises by {gain}");
    assert!((values[1] - 0.5).abs() < 1e-12 && values[3] == 0.0, "one has the variance of both: {values:?}");
    let held = search([1.5, 0.3, 1.5, 0.4, 0.5], Some(3), &mut Silent);
    assert!(!held.0, "a value that is held stays: {:?}", held.2);
    // close processes are merged only where ℓ does not fall by it
    let mut outcomes = [0, 0];
    for tau in [0.05, 0.2, 0.8, 1.5, 4.0, 12.0] {
        for (sigma, spread) in [(0.3, 0.4), (0.4, 0.3), (1.2, 0.1), (0.1, 1.2)] {
            let values = [tau, sigma, 1.009 * tau, spread, 0.5];
            let one = objective.twins[0].merged(&values, &objective.coordinates).expect("they are close");
            let [gain, other] =
                [&one, &values.to_vec()].map(|values| objective.filtered_value(values).expect("defined"));
            let (merge_pair, rise, _) = search(values, None, &mut Silent);
            outcomes[usize::from(merge_pair)] += 1;
            assert_eq!(merge_pair, gain - other >= -5e-9, "{values:?}: ℓ rises by {:e}", gain - other);
            assert!(!merge_pair || (rise - (gain - other)).abs() < 1e-9, "{rise:e} and {:e}", gain - other);
        }
    }
    assert!(outcomes.iter().all(|many| *many > 0), "apart, joined: {outcomes:?}");
}

#[test]
fn a_start_that_leads_where_the_given_one_leads_on_a_part_is_no_other() {
    let model = model(false);
    let (labels, tests) = ensemble(&model, 40, 15);
    let slots = Slots::in_phases(&model, &labels, &tests);
    let settings = settings(Method::Hybrid, Criterion::Ml);
    let (objective, small) = (
        ProfileLikelihood::new(&model, &tests, &slots, &settings),
        ProfileLikelihood::new(&model, &tests[..20], &slots, &settings),
    );
    let best = fit(&model, &labels, &tests, &settings, &mut Silent).expect("a fit").values;
    let beside: Vec<f64> = best.iter().map(|value| 1.1 * value).collect();
    let start = |values: &Vec<f64>| Candidate { values: values.clone(), origin: Origin::FirstStart };
    let starts = promising((&objective, &small), Some(start(&best)), vec![start(&beside)], &mut Silent);
    // the maximum of all data, which is no maximum of the part, stays
    assert_eq!(starts.len(), 1, "{starts:?}");
    assert_eq!(starts[0].values, best);
}

#[test]
fn work_of_a_fit_is_as_recorded() {
    let small = model(false);
    let (labels, tests) = ensemble(&small, 12, 8);
    let by = |method| {
        let fit = fit(&small, &labels, &tests, &settings(method, Criterion::Ml), &mut Silent).expect("a fit");
        format!("{method:?}: {} filter passes, {} score passes", fit.filter_passes, fit.score_passes)
    };
    let own = model(true);
    let (labels, tests) = ensemble(&own, 60, 9);
    let levels = fit(&own, &labels, &tests, &settings(Method::Hybrid, Criterion::Ml), &mut Silent).expect("a fit");
    let levels = format!("63 values: {} filter passes, {} score passes", levels.filter_passes, levels.score_passes);
    let lines = [by(Method::Hybrid), by(Method::Innovations), levels].join("\n");
    insta::assert_snapshot!(lines, @"
    Hybrid: 380 filter passes, 359 score passes
    Innovations: 434 filter passes, 413 score passes
    63 values: 477 filter passes, 477 score passes
    ");
}
