//! One test in three phases, the rate of the second unobservable in it: the published figures, and what is refused.

use kalfit::model::{
    Carry, Clock, Column, CovarianceStructure, Function, Initial, Linear, MeanStructure, Measurement, Model, Motion,
    Operator, Parameter, Phase, PhasedModel, State, Value,
};
use kalfit::reduce::{Evidence, PhaseReduction, PhasedReducer, PhasedTest, ReduceError, Reduction, Reductions};
use kalfit::{Alpha, Expression, Label, Labels, Source, Test};
use kalfit_fixtures::dense::marginal;
use nalgebra::{DMatrix, DVector};

const EMPTY: f64 = f64::NAN;

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

fn linear(terms: &[(usize, f64)]) -> Linear {
    Linear { terms: terms.iter().map(|&(state, x)| (state, number(x))).collect(), constant: number(0.0) }
}

/// Columns t, bench, angle_rate; states bias and rate, d bias/dt = rate + white noise of density 0.02.
fn phase(at: usize, column: usize, noise: f64, carry: &[(usize, f64)], rate: Initial) -> Phase {
    let names = ["calibrate", "transfer", "use"];
    let rw = || Box::new(Expression::Parameter(0));
    let bias = Motion::Continuous {
        derivative: linear(&[(1, 1.0)]),
        noise_variance: Expression::Binary(Operator::Multiply, rw(), rw()),
    };
    let state = |name: &str, motion: Motion, initial: Initial| State {
        name: name.to_owned(),
        unit: None,
        motion,
        initial,
        offset: None,
        random: true,
    };
    let states = vec![state("bias", bias, Initial::Estimated), state("rate", Motion::Constant, rate)];
    let estimated: Vec<usize> = (0..2).filter(|&i| states[i].initial == Initial::Estimated).collect();
    let named = |name: &&str| Column { name: (*name).to_owned(), used_in: String::new() };
    let measurement = Measurement {
        name: "check".to_owned(),
        column,
        filter: None,
        equation: linear(&[(0, 1.0)]),
        noise_variance: number(noise * noise),
    };
    let model = Model {
        title: String::new(),
        columns: ["t", "bench", "angle_rate"].iter().map(named).collect(),
        text_columns: ["phase"].iter().map(named).collect(),
        literals: names.iter().map(|name| (*name).to_owned()).collect(),
        parameters: vec![Parameter {
            name: "rw".to_owned(),
            unit: None,
            value: Value::Fixed(0.02),
            per: None,
            fixed_levels: Default::default(),
            lower: None,
            upper: None,
            positive: true,
        }],
        process_noise_covariance: Vec::new(),
        measurements: vec![measurement],
        noise_covariance: Vec::new(),
        clock: Clock { time: Some(0), ..Clock::default() },
        group: None,
        mean: MeanStructure::free(estimated.len()),
        covariance: CovarianceStructure::full(),
        estimated,
        states,
    };
    let carry =
        carry.iter().enumerate().map(|(state, &(from, x))| Carry { state, from: linear(&[(from, x)]) }).collect();
    Phase { name: names[at].to_owned(), label: Some(at), model, carry, filter: None }
}

fn model() -> PhasedModel {
    let known = Initial::Known { mean: number(0.0), variance: number(0.0) };
    PhasedModel {
        phases: vec![
            phase(0, 1, 0.05, &[], Initial::Estimated),
            phase(1, 1, 0.05, &[(0, 1.0), (1, 1.0)], Initial::Estimated),
            phase(2, 2, 0.08, &[(0, 0.9), (1, 1.0)], known),
        ],
        column: Some(0),
        levels: Vec::new(),
    }
}

const ROWS: [(usize, [f64; 3]); 23] = [
    (0, [0.0, 0.921455, EMPTY]),
    (0, [1.0, 1.129033, EMPTY]),
    (0, [2.0, 1.149688, EMPTY]),
    (0, [3.0, 1.250909, EMPTY]),
    (0, [4.0, 1.373738, EMPTY]),
    (0, [5.0, 1.503738, EMPTY]),
    (0, [6.0, 1.588308, EMPTY]),
    (0, [7.0, 1.776611, EMPTY]),
    (0, [8.0, 1.969619, EMPTY]),
    (0, [9.0, 2.026813, EMPTY]),
    (0, [10.0, 2.067277, EMPTY]),
    (0, [11.0, 2.191384, EMPTY]),
    (1, [11.0, EMPTY, EMPTY]),
    (1, [14.0, 2.750351, EMPTY]),
    (1, [20.0, EMPTY, EMPTY]),
    (2, [20.0, EMPTY, 3.108399]),
    (2, [22.0, EMPTY, 3.120399]),
    (2, [24.0, EMPTY, 3.237948]),
    (2, [26.0, EMPTY, EMPTY]),
    (2, [28.0, EMPTY, 3.392201]),
    (2, [30.0, EMPTY, 3.624563]),
    (2, [32.0, EMPTY, 3.739269]),
    (2, [34.0, EMPTY, 3.674612]),
];

fn test(rows: &[(usize, [f64; 3])]) -> Test {
    let mut test = Test::new("S1", 3, 1);
    for (line, (phase, numbers)) in rows.iter().enumerate() {
        test.push(numbers, &[Label::literal(*phase)], Source { file: 0, row: line as u64 + 2 });
    }
    test
}

fn reduce(model: &PhasedModel, tests: &[PhasedTest]) -> Result<Reductions, ReduceError> {
    PhasedReducer::new(model, &Alpha::fixed(&model.shared().parameters).expect("all is fixed"))?.reduce(tests)
}

fn split(model: &PhasedModel, rows: &[(usize, [f64; 3])]) -> PhasedTest {
    model.split(test(rows), &Labels::new(&model.shared().literals)).expect("sound")
}

fn matrix(blocks: [&[f64]; 3]) -> DMatrix<f64> {
    let mut sigma = DMatrix::zeros(5, 5);
    sigma.view_mut((0, 0), (2, 2)).copy_from(&DMatrix::from_row_slice(2, 2, blocks[0]));
    sigma.view_mut((2, 2), (2, 2)).copy_from(&DMatrix::from_row_slice(2, 2, blocks[1]));
    sigma.view_mut((4, 4), (1, 1)).copy_from(&DMatrix::from_row_slice(1, 1, blocks[2]));
    sigma
}

/// The log-likelihoods of the public case phases-single: the mean known or at its maximum, the covariance known, zero, huge.
#[test]
fn one_test_in_three_phases_has_the_published_log_likelihoods() {
    let model = model();
    let reduction: Reduction = reduce(&model, &[split(&model, &ROWS)]).expect("sound").get(0).into();
    let known = matrix([&[4.0, 0.1, 0.1, 0.01], &[1.0, 0.0, 0.0, 0.01], &[0.25]]);
    let huge = DMatrix::identity(5, 5) * 1e6;
    let best =
        DVector::from_column_slice(&[0.94123504386, 0.11577801562, 0.39012630221, -0.067300854905, 0.32999039323]);
    let zero = DVector::zeros(5);
    let cases = [
        ("known-prior", &zero, &known, 13.35704638733),
        ("large-prior", &zero, &huge, -24.7225918505),
        ("known", &best, &known, 14.52801554679),
        ("zero", &best, &DMatrix::zeros(5, 5), 28.40722656723),
        ("large", &best, &huge, -24.72259126802),
    ];
    for (name, mu, sigma, expected) in cases {
        let found = marginal(reduction.view(), mu, sigma);
        assert!((found - expected).abs() < 1e-9, "{name}: {found} against {expected}");
    }
    assert_eq!((reduction.observations, reduction.steps), (20, 23));
}

fn refusal(model: &PhasedModel, test: PhasedTest) -> String {
    reduce(model, &[test]).expect_err("refused").to_string()
}

#[test]
fn messages_name_the_phase_and_the_row() {
    let sound = model();
    let mut model = sound.clone();
    model.phases[1].model.measurements[0].noise_variance = Expression::Column(2);
    insta::assert_snapshot!(refusal(&model, split(&model, &ROWS)), @"test `S1`, row 15: noise variance of measurement `check` of phase `transfer`: the cell of column `angle_rate` is empty, and it is needed");
    let mut model = sound.clone();
    model.phases[2].carry[1].from.terms[0].1 = Expression::Column(1);
    insta::assert_snapshot!(refusal(&model, split(&model, &ROWS)), @"test `S1`, row 17: carry of state `rate` of phase `use`: the cell of column `bench` is empty, and it is needed");
    let mut model = sound.clone();
    model.phases[2].carry[1].from.constant = Expression::Column(2);
    insta::assert_snapshot!(refusal(&model, split(&model, &ROWS)), @"test `S1`, row 18: phase `use`: column `angle_rate` varies within the test: 3.108399 and 3.120399");
    let mut model = sound.clone();
    model.phases[2].carry[0].from.constant = Expression::Call(Function::Log, vec![number(-1.0)]);
    insta::assert_snapshot!(refusal(&model, split(&model, &ROWS)), @"carry of state `bias` of phase `use`: the value is not a finite number");
    let mut rows = ROWS;
    rows[14].1[0] = 12.0;
    insta::assert_snapshot!(refusal(&sound, split(&sound, &rows)), @"test `S1`, row 16: time of a row of phase `transfer`: time 12 follows time 14");
    insta::assert_snapshot!(refusal(&sound, PhasedTest { id: "S1".into(), phases: Vec::new().into() }), @"test `S1`: the test: the test has no rows");
    insta::assert_snapshot!(refusal(&sound, split(&sound, &[])), @"test `S1`: phase `calibrate`: the test has no rows");
    let mut four = split(&sound, &ROWS);
    four.phases.extend([four.phases[2].clone()]);
    insta::assert_snapshot!(refusal(&sound, four), @"test `S1`: the test: found 4 phases, expected 3 at most");
}

#[test]
fn rows_that_are_of_no_phase_and_phases_without_the_one_before_are_refused() {
    let model = model();
    let mut labels = Labels::new(&model.shared().literals);
    let flight = labels.intern("flight");
    let refusal = |test: Test| model.split(test, &labels).expect_err("refused").to_string();
    let mut unknown = test(&ROWS[..3]);
    unknown.push(&[0.0; 3], &[flight], Source { file: 0, row: 99 });
    insta::assert_snapshot!(refusal(unknown), @"test `S1`, row 99: found phase `flight` in column `phase`, expected `calibrate`, `transfer`, `use`");
    let mut missing = test(&ROWS[..3]);
    missing.push(&[0.0; 3], &[Label::MISSING], Source { file: 0, row: 99 });
    insta::assert_snapshot!(refusal(missing), @"test `S1`, row 99: the cell of phase column `phase` is empty, expected `calibrate`, `transfer`, `use`");
    let gap: Vec<_> = ROWS.iter().copied().filter(|(phase, _)| *phase != 1).collect();
    insta::assert_snapshot!(refusal(test(&gap)), @"test `S1`, row 14: phase `use` follows phase `transfer`, of which the test has no row");
    insta::assert_snapshot!(refusal(test(&ROWS[12..])), @"test `S1`, row 2: phase `transfer` follows phase `calibrate`, of which the test has no row");
}

#[test]
fn reductions_made_before_must_have_the_shape_of_their_phase() {
    let model = model();
    let sound = split(&model, &ROWS);
    let alpha = Alpha::fixed(&model.shared().parameters).expect("all is fixed");
    let reducer = PhasedReducer::new(&model, &alpha).expect("sound");
    let pieces = reducer.pieces(std::slice::from_ref(&sound)).expect("sound").remove(0);
    let refused = |at: usize, change: &dyn Fn(&mut PhaseReduction)| {
        let mut pieces = pieces.clone();
        change(&mut pieces[at]);
        let phases = pieces.into_iter().map(|piece| Evidence::Reduced(Box::new(piece))).collect();
        refusal(&model, PhasedTest { id: "S1".into(), phases })
    };
    insta::assert_snapshot!(refused(0, &|piece| piece.reduction.data.truncate(1)), @"test `S1`: data of the reduction of phase `calibrate`: found 1 x 1, expected 2 x 1");
    insta::assert_snapshot!(refused(1, &|piece| piece.reduction.factor.push(1.0)), @"test `S1`: factor of the reduction of phase `transfer`: found 4 x 1, expected 3 x 1");
    insta::assert_snapshot!(refused(1, &|piece| piece.reduction.factor[2] = -1.0), @"test `S1`: factor of the reduction of phase `transfer`: found -1 on the diagonal of the factor, expected 0 or more");
    insta::assert_snapshot!(refused(0, &|piece| piece.reduction.constant = f64::INFINITY), @"test `S1`: constant of the reduction of phase `calibrate`: the value is not a finite number");
    insta::assert_snapshot!(refused(0, &|piece| piece.reduction.covariates.push(1.0)), @"test `S1`: covariates of the reduction of phase `calibrate`: found 1 x 1, expected 0 x 1");
    insta::assert_snapshot!(refused(0, &|piece| piece.terminal = None), @"test `S1`: phase `calibrate`: the last state is missing, and it is needed");
    let narrow = |piece: &mut PhaseReduction| piece.terminal.as_mut().expect("linked").root = DMatrix::zeros(1, 4);
    insta::assert_snapshot!(refused(0, &narrow), @"test `S1`: covariance root of the last state of phase `calibrate`: found 1 x 4, expected 2 x 4");
    insta::assert_snapshot!(refused(2, &|piece| piece.inherited = None), @"test `S1`: phase `use`: the transition from the phase before is missing, and it is needed");
    let other = |piece: &mut PhaseReduction| {
        piece.inherited = pieces[1].inherited.clone().map(|mut inherited| {
            inherited.transition = DMatrix::identity(2, 3);
            inherited
        })
    };
    insta::assert_snapshot!(refused(2, &other), @"test `S1`: transition from the phase before of phase `use`: found 2 x 3, expected 2 x 2");
}
