//! Where estimates are certain, contradict themselves, or start from more than ξ.

use kalfit::model::{
    Alpha, Clock, Column, CovarianceStructure, Filter, Initial, Linear, MeanStructure, Measurement, Motion, Phase,
    Regression, State,
};
use kalfit::reduce::{EstimateReducer, Estimates, FilterRunner, ReduceErrorKind, Reducer, Reduction};
use kalfit::{Expression, Model, PhasedModel, Source, Test};
use nalgebra::{DMatrix, DVector};

use super::drawn::{Kind, draw, generator, uniform};

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

fn linear(terms: &[(usize, f64)]) -> Linear {
    Linear { terms: terms.iter().map(|&(state, x)| (state, number(x))).collect(), constant: number(0.0) }
}

fn state(motion: Motion, initial: Initial) -> State {
    State { name: "x".to_owned(), unit: None, motion, initial, offset: None, random: true }
}

fn known(variance: f64) -> Initial {
    Initial::Known { mean: number(0.5), variance: number(variance) }
}

fn meter(column: usize, terms: &[(usize, f64)], variance: f64) -> Measurement {
    let (equation, noise_variance) = (linear(terms), number(variance));
    Measurement { name: format!("z{column}"), column, filter: None, equation, noise_variance }
}

/// Columns: 0 time, 1 and 2 measured, 3 a constant of the test. The filter's prior has unit covariance.
fn phase(states: Vec<State>, measurements: Vec<Measurement>, consider: &[usize]) -> Phase {
    let estimated: Vec<usize> = (0..states.len()).filter(|&i| states[i].initial == Initial::Estimated).collect();
    let n = states.len();
    let model = Model {
        title: String::new(),
        columns: (0..4).map(|c| Column { name: format!("c{c}"), used_in: String::new() }).collect(),
        text_columns: vec![],
        literals: vec![],
        parameters: vec![],
        process_noise_covariance: vec![],
        measurements,
        noise_covariance: vec![],
        clock: Clock { time: Some(0), ..Clock::default() },
        group: None,
        mean: MeanStructure::free(estimated.len()),
        covariance: CovarianceStructure::full(),
        estimated,
        states,
    };
    let mut phase = PhasedModel::from(model).phases.remove(0);
    let (mean, covariance) = (vec![3.0; n], DMatrix::identity(n, n));
    phase.filter = Some(Filter { consider: consider.to_vec(), mean, covariance, parameters: vec![] });
    phase
}

fn test(rows: &[[f64; 4]]) -> Test {
    let mut test = Test::new("t", 4, 0);
    rows.iter().enumerate().for_each(|(k, row)| test.push(row, &[], Source { file: 0, row: k as u64 + 2 }));
    test
}

fn run(phase: &Phase, test: &Test) -> Estimates {
    FilterRunner::new(phase, &Alpha::default()).expect("sound").run(test).expect("sound")
}

fn reduce(phase: &Phase, estimates: &Estimates) -> Result<Reduction, ReduceErrorKind> {
    let reducer = EstimateReducer::new(phase, &Alpha::default()).expect("sound");
    reducer.reduce("t", estimates).map(|(reduction, _)| reduction).map_err(|error| *error.kind)
}

fn raw(phase: &Phase, test: &Test) -> Reduction {
    let reducer = Reducer::new(&phase.model, &Alpha::default());
    reducer.expect("sound").reduce(std::slice::from_ref(test)).expect("sound").get(0).into()
}

fn information(reduction: &Reduction) -> (DVector<f64>, DMatrix<f64>) {
    let q = reduction.data.len();
    let r = DMatrix::from_fn(q, q, |i, k| if i <= k { reduction.factor[i + k * (k + 1) / 2] } else { 0.0 });
    (r.transpose() * DVector::from_column_slice(&reduction.data), r.transpose() * r)
}

#[track_caller]
fn assert_same(own: &Reduction, raw: &Reduction) {
    let ((y, j), (raw_y, raw_j)) = (information(own), information(raw));
    assert!((&j - &raw_j).amax() <= 1e-11 * raw_j.amax(), "J {j} against {raw_j}");
    assert!((&y - &raw_y).amax() <= 1e-11 * raw_y.amax(), "y {y} against {raw_y}");
    assert_eq!(own.covariates, raw.covariates);
}

const EMPTY: f64 = f64::NAN;

#[test]
fn starts_with_offsets_stationary_laws_known_variances_and_regressions_are_those_of_the_model() {
    let drift = Motion::Continuous { derivative: linear(&[(1, -0.5)]), noise_variance: number(0.3) };
    let mut states = vec![state(Motion::Constant, Initial::Estimated), state(drift, Initial::Stationary)];
    states.push(state(Motion::Constant, known(0.4)));
    states[0].offset = Some(Expression::Column(3));
    let mut phase =
        phase(states, vec![meter(1, &[(0, 1.0), (1, 2.0)], 0.1), meter(2, &[(1, 1.0), (2, 1.0)], 0.2)], &[]);
    phase.model.mean.regression = vec![Regression { element: 0, column: 3 }];
    phase.model.covariance.known = Some(vec![vec![number(0.7)]]);
    let rows = [[0.0, 1.0, EMPTY, 2.5], [0.5, 2.0, 0.3, EMPTY], [1.5, EMPTY, EMPTY, 2.5], [2.5, 1.4, -0.2, 2.5]];
    let test = test(&rows);
    let estimates = run(&phase, &test);
    assert_eq!(estimates.constants.numbers(0)[3], 2.5);
    assert_same(&reduce(&phase, &estimates).expect("sound"), &raw(&phase, &test));
}

#[test]
fn a_measurement_without_noise_informs_through_the_law_of_a_known_start() {
    let of = |variance: f64| {
        let states = vec![state(Motion::Constant, Initial::Estimated), state(Motion::Constant, known(variance))];
        phase(states, vec![meter(1, &[(0, 1.0), (1, 2.0)], 0.0)], &[])
    };
    let test = test(&[[0.0, 4.0, EMPTY, EMPTY], [1.0, 4.0, EMPTY, EMPTY]]);
    let phase = of(0.25);
    let own = reduce(&phase, &run(&phase, &test)).expect("ζ makes it random");
    assert_same(&own, &raw(&phase, &test));
    // ŝ moves along (1, 2, 1, 2)/5, of length √10/5, times z
    let expected = raw(&phase, &test).constant - (10.0_f64.sqrt() / 5.0).ln();
    assert!((own.constant - expected).abs() < 1e-12, "{} against {expected}", own.constant);
    let phase = of(0.0);
    assert_eq!(reduce(&phase, &run(&phase, &test)), Err(ReduceErrorKind::ExactMeasurement));
}

#[test]
fn what_is_certain_must_agree_with_itself() {
    let states = vec![state(Motion::Constant, Initial::Estimated), state(Motion::Constant, Initial::Estimated)];
    let phase = phase(states, vec![meter(1, &[(0, 1.0), (1, 1.0)], 1.0)], &[1]);
    let estimates = run(&phase, &test(&[[0.0, 4.0, EMPTY, EMPTY], [1.0, 3.0, EMPTY, EMPTY]]));
    assert!(reduce(&phase, &estimates).is_ok());
    for (element, what) in [(1, "a considered state that moved"), (2, "x̂_0 of a constant that is not its x̂_K")] {
        let mut wrong = estimates.clone();
        wrong.estimates[element] += 0.1;
        let found = reduce(&phase, &wrong);
        assert!(matches!(found, Err(ReduceErrorKind::Inconsistent { .. })), "{what}: {found:?}");
    }
    let mut rounded = estimates.clone();
    rounded.estimates.iter_mut().for_each(|x| *x *= 1.0 + 1e-12);
    assert!(reduce(&phase, &rounded).is_ok(), "files keep so many digits");
}

#[test]
fn all_rows_of_one_time_are_one_step_of_the_filter() {
    let of = |rows: &[[f64; 4]]| {
        let drift = Motion::Continuous { derivative: linear(&[(1, 1.0)]), noise_variance: number(0.3) };
        let states = vec![state(drift, Initial::Estimated), state(Motion::Constant, Initial::Estimated)];
        let mut phase = phase(states, vec![meter(1, &[(0, 1.0), (1, 1.0)], 0.5), meter(2, &[(0, 1.0)], 0.2)], &[1]);
        phase.model.noise_covariance = vec![(0, 1, number(0.1))];
        run(&phase, &test(rows))
    };
    let wide = of(&[[0.0, 1.0, 2.0, EMPTY], [1.0, 3.0, 2.5, EMPTY], [2.0, EMPTY, EMPTY, EMPTY]]);
    let rows = [[0.0, 1.0, EMPTY], [0.0, EMPTY, 2.0], [1.0, 3.0, EMPTY], [1.0, EMPTY, 2.5], [2.0, EMPTY, EMPTY]];
    let long = of(&rows.map(|[t, a, b]| [t, a, b, EMPTY]));
    assert_eq!(format!("{wide:?}"), format!("{long:?}"));
    assert_eq!((wide.steps, wide.observations), (3, 4));
}

#[test]
fn estimates_are_the_same_bits_alone_and_among_others() {
    let drawn = draw(11, Kind::Wrong);
    let random = &mut generator(3);
    let width = drawn.phase.model.columns.len();
    let tests: Vec<Test> = (0..40)
        .map(|j| {
            let mut test = Test::new(format!("t{j}"), width, 0);
            for row in 0..8 {
                let missing = |c: usize| c > 0 && (j % 3 + row as usize + c).is_multiple_of(4);
                let cells: Vec<f64> = (0..width).map(|c| if missing(c) { EMPTY } else { uniform(random) }).collect();
                test.push(&cells, &[], Source { file: 0, row });
            }
            test
        })
        .collect();
    let new = || FilterRunner::new(&drawn.phase, &drawn.alpha).expect("sound");
    let together = new().run_all(&tests).expect("sound");
    let reducer = EstimateReducer::new(&drawn.phase, &drawn.alpha).expect("sound");
    let mut designs = std::collections::BTreeSet::new();
    for (test, shared) in tests.iter().zip(&together) {
        let alone = new().run(test).expect("sound");
        assert_eq!(format!("{alone:?}"), format!("{shared:?}"), "test {}", test.id);
        let fresh = EstimateReducer::new(&drawn.phase, &drawn.alpha).expect("sound").reduce(&test.id, &alone);
        let kept = reducer.reduce(&test.id, shared).expect("sound");
        assert_eq!(fresh.expect("sound"), kept);
        designs.insert(kept.0.design);
    }
    assert_eq!(designs.len(), 3, "design classes");
}

#[test]
fn units_change_neither_the_information_nor_the_whitened_density() {
    for seed in 0..40 {
        let drawn = draw(seed, Kind::Wrong).free();
        let (reducer, estimates) = (EstimateReducer::new(&drawn.phase, &drawn.alpha).expect("sound"), drawn.dense());
        let n = estimates.transition.nrows();
        // state i in units of 1e-6, 1, 1e6, …
        let unit = DVector::from_fn(n, |i, _| 1e6_f64.powi(i as i32 % 3 - 1));
        let (to, back) = (DMatrix::from_diagonal(&unit), DMatrix::from_diagonal(&unit.map(f64::recip)));
        let mut all = DMatrix::zeros(3 * n, 3 * n);
        (0..3).for_each(|k| all.view_mut((k * n, k * n), (n, n)).copy_from(&to));
        let both = all.view((n, n), (2 * n, 2 * n)).into_owned();
        let scaled = Estimates {
            estimates: &both * &estimates.estimates,
            offsets: &both * &estimates.offsets,
            sensitivities: both * &estimates.sensitivities * &back,
            transition: &to * &estimates.transition * &back,
            drift: &to * &estimates.drift,
            root: all * &estimates.root,
            ..estimates.clone()
        };
        let one = |estimates: &Estimates| {
            let (reduction, _) = reducer.reduce("t", estimates).expect("sound");
            (information(&reduction), reduction.constant + reducer.log_volume("t", estimates).expect("sound"))
        };
        let (((y, j), density), ((scaled_y, scaled_j), scaled_density)) = (one(&estimates), one(&scaled));
        let (scaled_j, scaled_y) = (&to * scaled_j * &to, to * scaled_y);
        assert!((&j - &scaled_j).amax() <= 1e-9 * (1.0 + j.amax()), "seed {seed}: J {j} against {scaled_j}");
        assert!((&y - &scaled_y).amax() <= 1e-9 * (1.0 + y.amax()), "seed {seed}: y {y} against {scaled_y}");
        let off = (density - scaled_density).abs();
        assert!(off <= 1e-8 * (1.0 + density.abs()), "seed {seed}: {density} against {scaled_density}");
    }
}

#[test]
fn estimates_of_any_shape_and_with_any_number_are_taken_or_refused() {
    let drawn = draw(5, Kind::Wrong);
    let reducer = EstimateReducer::new(&drawn.phase, &drawn.alpha).expect("sound");
    let sound = drawn.dense();
    let n = sound.transition.nrows();
    let cut: [fn(&mut Estimates); 7] = [
        |e| e.estimates = DVector::zeros(1),
        |e| e.offsets = DVector::zeros(0),
        |e| e.sensitivities = DMatrix::zeros(1, 1),
        |e| e.transition = DMatrix::zeros(0, 0),
        |e| e.drift = DVector::zeros(9),
        |e| e.root = DMatrix::zeros(1, 4),
        |e| e.constants = Test::new("t", 1, 5),
    ];
    for (k, cut) in cut.iter().enumerate() {
        let mut wrong = sound.clone();
        cut(&mut wrong);
        let error = reducer.reduce("t", &wrong).expect_err("refused");
        assert!(matches!(*error.kind, ReduceErrorKind::Shape { .. }), "{k}: {error}");
    }
    let empty = Estimates {
        estimates: DVector::zeros(0),
        offsets: DVector::zeros(0),
        sensitivities: DMatrix::zeros(0, n),
        root: sound.root.rows(0, n).into_owned(),
        ..sound.clone()
    };
    let (reduction, terminal) = reducer.reduce("t", &empty).expect("no estimates say nothing");
    assert!(reduction.factor.iter().all(|x| *x == 0.0) && reduction.constant == 0.0, "{reduction:?}");
    assert!(terminal.mean.iter().all(|x| x.is_finite()));
    for huge in [f64::NAN, f64::INFINITY, 1e308, -1e300, 1e-320, 0.0] {
        for at in 0..sound.root.len() + sound.sensitivities.len() + sound.estimates.len() {
            let mut wrong = sound.clone();
            let (a, b) = (wrong.root.len(), wrong.sensitivities.len());
            match at {
                at if at < a => wrong.root[at] = huge,
                at if at < a + b => wrong.sensitivities[at - a] = huge,
                at => wrong.estimates[at - a - b] = huge,
            }
            if let Ok((reduction, _)) = reducer.reduce("t", &wrong) {
                let numbers = reduction.factor.iter().chain(&reduction.data).chain([&reduction.constant]);
                assert!(numbers.into_iter().all(|x| x.is_finite()), "{huge} at {at}: {reduction:?}");
            }
        }
    }
}
