//! Models that are read, and what becomes of them.

use crate::Only as _;
use kalfit::model::{
    CovarianceKind, Expression, FixedElement, Initial, Linear, MeanElement, Motion, Operator, Regression, Value,
};
use kalfit::{Layout, TestKey};
use kalfit_spec::Spec;
use nalgebra::DMatrix;

fn read(text: &str) -> Spec {
    match Spec::parse("model.toml", text) {
        Ok(spec) => spec,
        Err(error) => panic!("{error} at {:?}, {:?}", error.span.clone().map(|span| &text[span]), error.hint),
    }
}

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

fn times(a: Expression, b: Expression) -> Expression {
    Expression::Binary(Operator::Multiply, Box::new(a), Box::new(b))
}

fn over(a: Expression, b: Expression) -> Expression {
    Expression::Binary(Operator::Divide, Box::new(a), Box::new(b))
}

fn minus(a: Expression) -> Expression {
    Expression::Negate(Box::new(a))
}

use Expression::{Column, Parameter};

const SLEEP: &str = r#"
title = "Reaction time under sleep deprivation"

[data]
test = "Subject"

[states]
intercept = {}
slope = {}

[measurements.reaction]
column = "Reaction"
equation = "intercept + slope * Days"
noise = "sigma"

[parameters]
sigma = { start = 20 }
"#;

#[test]
fn a_random_coefficient_model_is_two_constants_seen_through_a_column() {
    let spec = read(SLEEP);
    let model = spec.model.shared();
    assert_eq!(model.title, "Reaction time under sleep deprivation");
    assert_eq!(
        spec.layout,
        Layout {
            test: TestKey::Column("Subject".to_owned()),
            levels: Vec::new(),
            crossed: Vec::new(),
            missing: Vec::new(),
            comment: None
        }
    );
    assert_eq!(model.estimated_names(), ["intercept", "slope"]);
    assert!(model.states.iter().all(|s| s.motion == Motion::Constant && s.initial == Initial::Estimated && s.random));
    let [reaction] = model.measurements.as_slice() else { panic!("{:?}", model.measurements) };
    assert_eq!(model.columns[reaction.column].name, "Reaction");
    assert_eq!(model.columns[1].name, "Days");
    assert_eq!(model.columns[1].used_in, "`equation` of measurement `reaction`");
    let terms = vec![(0, number(1.0)), (1, Column(1))];
    assert_eq!(reaction.equation, Linear { terms, constant: number(0.0) });
    assert_eq!(reaction.noise_variance, times(Parameter(0), Parameter(0)));
    assert_eq!(model.parameters[0].value, Value::Free { start: Some(20.0) });
    assert!(model.parameters[0].positive, "a noise is not negative");
    assert_eq!((&model.covariance.kind, model.clock.time), (&CovarianceKind::Full, None));
}

#[test]
fn places_in_the_file_are_found_again() {
    let spec = read(SLEEP);
    let at = |span: Option<std::ops::Range<usize>>| span.map(|span| SLEEP[span].to_owned());
    assert_eq!(at(spec.column_span("Days")).as_deref(), Some("Days"));
    assert_eq!(at(spec.column_span("Subject")).as_deref(), Some("\"Subject\""));
    assert_eq!(at(spec.parameter_span("sigma")).as_deref(), Some("sigma"));
    assert_eq!(at(spec.state_span("slope")).as_deref(), Some("slope"));
    assert_eq!(at(spec.measurement_span("reaction")).as_deref(), Some("reaction"));
    assert_eq!(spec.column_span("Weeks"), None);
    let days = spec.column_span("Days").unwrap();
    assert_eq!(days.start, SLEEP.find("Days").unwrap());
}

#[test]
fn the_digest_is_the_sha_256_of_the_text() {
    let text = "[states]\na={}\n[measurements]\ny={column='y',equation='a',noise=1}\n";
    // sha256sum of these bytes.
    let expected = "sha256:9fc89f32df3eda338985f11e823f80fb78ebb07d1f53efdc8d75b0e4f24ed7be";
    assert_eq!(read(text).digest, expected);
}

const GYRO: &str = r#"
[data]
test = "unit"
time = "t"
time_unit = "s"
initial_time = 0.0
group = "lot"

[states.bias]
unit = "deg/h"
[states.scale]
unit = "ppm"
[states.drift]
process = "gauss-markov"
time_constant = "tau"
sigma = "sigma_drift"
[states.temperature_coefficient]
random = false
[states.angle]
derivative = "bias + 1e-6 * scale * rate_in + drift + temperature_coefficient * (T - 20)"
noise_density = "arw"
initial = { mean = 0, sigma = 0 }

[measurements.gyro]
column = "angle_out"
equation = "angle"
noise = "sigma_v"

[parameters]
tau = { start = 120, unit = "s", lower = 1 }
sigma_drift = { start = 0.02 }
sigma_v = { start = 0.1, per = "lot" }
arw = 0.003
"#;

#[test]
fn an_inertial_instrument_has_continuous_states_driven_by_a_table() {
    let model = read(GYRO).only();
    assert_eq!(model.estimated_names(), ["bias", "scale", "temperature_coefficient"]);
    assert_eq!(model.clock.time, Some(0));
    assert_eq!(model.clock.unit.as_deref(), Some("s"));
    assert_eq!(model.clock.initial_time, Some(number(0.0)));
    assert_eq!(model.group.map(|g| model.text_columns[g].name.as_str()), Some("lot"));
    assert_eq!(model.states[0].unit.as_deref(), Some("deg/h"));

    let drift = &model.states[2];
    let (tau, sigma, arw) = (Parameter(0), Parameter(1), Parameter(3));
    let derivative = Linear { terms: vec![(2, minus(over(number(1.0), tau.clone())))], constant: number(0.0) };
    let noise_variance = over(times(number(2.0), times(sigma.clone(), sigma)), tau);
    assert_eq!(drift.motion, Motion::Continuous { derivative, noise_variance });
    assert_eq!(drift.initial, Initial::Stationary);

    let angle = &model.states[4];
    let Motion::Continuous { derivative, noise_variance } = &angle.motion else { panic!("{:?}", angle.motion) };
    let column = |name: &str| Column(model.columns.iter().position(|c| c.name == name).unwrap());
    let warm = Expression::Binary(Operator::Subtract, Box::new(column("T")), Box::new(number(20.0)));
    let terms = vec![(0, number(1.0)), (1, times(number(1e-6), column("rate_in"))), (2, number(1.0)), (3, warm)];
    assert_eq!(*derivative, Linear { terms, constant: number(0.0) });
    assert_eq!(*noise_variance, times(arw.clone(), arw));
    assert_eq!(angle.initial, Initial::Known { mean: number(0.0), variance: number(0.0) });

    assert!(!model.states[3].random);
    assert_eq!(model.covariance.fixed, [FixedElement { i: 2, j: 2, value: 0.0 }]);
    let sigma_v = &model.parameters[2];
    assert_eq!(sigma_v.per.map(|c| model.text_columns[c].name.as_str()), Some("lot"));
    assert_eq!(model.parameters[3].value, Value::Fixed(0.003));
    assert_eq!(model.parameters[0].lower, Some(1.0));
}

const SUBJECTS: &str = r#"
[data]
test = "subject"
step_first = true

[states.x1]
next = "f * x1 + g * u"
step_noise = "s1"
[states.x2]
next = "0.8 * x2"
step_noise = "s2"
[process_noise_covariance]
"x1, x2" = "q12"

[measurements.y1]
column = "y"
where = "sensor == 'A'"
equation = "x1"
noise = 0.1
[measurements.y2]
column = "y"
where = "sensor == 'B'"
equation = "x2 + 0.5 * x1"
noise = 0.1
[noise_covariance]
"y1, y2" = 0.002

[parameters]
f = {}
g = {}
s1 = {}
s2 = {}
q12 = { start = 0 }
"#;

#[test]
fn a_discrete_model_has_next_values_inputs_and_covariances_of_noises() {
    let model = read(SUBJECTS).only();
    let u = Column(model.columns.iter().position(|c| c.name == "u").unwrap());
    let next = Linear { terms: vec![(0, Parameter(0))], constant: times(Parameter(1), u) };
    let noise_variance = times(Parameter(2), Parameter(2));
    assert_eq!(model.states[0].motion, Motion::Discrete { next, noise_variance });
    assert_eq!(model.process_noise_covariance, [(1, 0, Parameter(4))]);
    assert_eq!(model.noise_covariance, [(1, 0, number(0.002))]);
    assert_eq!(model.literals, ["A", "B"]);
    assert_eq!(model.measurements[1].filter, Some(Expression::TextEquals { column: 0, literal: 1 }));
    assert_eq!(model.measurements[0].column, model.measurements[1].column);
    let terms = vec![(0, number(0.5)), (1, number(1.0))];
    assert_eq!(model.measurements[1].equation, Linear { terms, constant: number(0.0) });
    assert_eq!(model.measurements[0].noise_variance, number(0.1 * 0.1));
    assert!(model.clock.step_first);
    let positive: Vec<bool> = model.parameters.iter().map(|p| p.positive).collect();
    assert_eq!(positive, [false, false, true, true, false]);
}

/// Three constants, one measurement, and more.
fn three(more: &str) -> Spec {
    let states = "[states]\na = {}\nb = {}\nc = {}\n";
    read(&format!("{states}[measurements.y]\ncolumn = 'y'\nequation = 'a + b * u + c * v'\nnoise = 1\n{more}"))
}

#[test]
fn constraints_on_the_mean_are_kept_by_element() {
    let mean = three(
        "[mean]\nfixed = { c = 0 }\nstart = { a = 1.5 }\ntied = { b = '0.5 * a + 0.25 * c + 1' }\n\
         regression = { a = ['temperature', 'lot_b'], c = ['temperature'] }",
    )
    .only()
    .mean;
    let tied = MeanElement::Tied { constant: 1.0, terms: vec![(0, 0.5), (2, 0.25)] };
    assert_eq!(mean.elements, [MeanElement::Free, tied, MeanElement::Fixed(0.0)]);
    assert_eq!(mean.start, [Some(1.5), None, None]);
    let regression = |element, column| Regression { element, column };
    assert_eq!(mean.regression, [regression(0, 3), regression(0, 4), regression(2, 3)]);

    let mean = three("[mean]\nproportional_to = { a = 1, c = 200 }").only().mean;
    assert_eq!(mean.elements, [MeanElement::Proportional(1.0), MeanElement::Free, MeanElement::Proportional(200.0)]);
}

#[test]
fn the_order_of_the_covariance_is_the_order_of_everything() {
    let model = three(
        "[mean]\nfixed = { a = 2 }\n[covariance]\norder = ['c', 'a', 'b']\n\
         fixed = { 'b, c' = 0, 'a,a' = 4 }\nstart = [[1, 0.5, 0], [0.5, 4, 0], [0, 0, 9]]",
    )
    .only();
    assert_eq!(model.estimated, [2, 0, 1]);
    assert_eq!(model.mean.elements[1], MeanElement::Fixed(2.0));
    let fixed = |i, j, value| FixedElement { i, j, value };
    assert_eq!(model.covariance.fixed, [fixed(1, 1, 4.0), fixed(2, 0, 0.0)]);
    assert_eq!(
        model.covariance.start,
        Some(DMatrix::from_row_slice(3, 3, &[1.0, 0.5, 0.0, 0.5, 4.0, 0.0, 0.0, 0.0, 9.0]))
    );
}

#[test]
fn all_structures_of_the_covariance_are_read() {
    let rho = "[parameters]\nrho = {}\n[covariance]\n";
    let kind = |text: &str| three(text).only().covariance.kind;
    let matrix = |corner: Expression| {
        vec![
            vec![number(1.0), corner.clone(), number(0.0)],
            vec![corner, number(1.0), number(0.0)],
            vec![number(0.0), number(0.0), number(1.0)],
        ]
    };
    let rows = "matrix = [[1, 'rho', 0], ['rho', 1, 0], [0, 0, 1]]";
    assert_eq!(kind("[covariance]\nstructure = 'full'"), CovarianceKind::Full);
    assert_eq!(kind("[covariance]\nstructure = 'diagonal'"), CovarianceKind::Diagonal);
    let blocks = CovarianceKind::Blocks(vec![vec![2, 0], vec![1]]);
    assert_eq!(kind("[covariance]\nstructure = 'blocks'\nblocks = [['c', 'a']]"), blocks);
    let expected = matrix(Parameter(0));
    assert_eq!(
        kind(&format!("{rho}structure = 'proportional'\n{rows}")),
        CovarianceKind::Proportional(expected.clone())
    );
    assert_eq!(kind(&format!("{rho}structure = 'correlation'\n{rows}")), CovarianceKind::Correlation(expected.clone()));
    assert_eq!(kind(&format!("{rho}structure = 'fixed'\n{rows}")), CovarianceKind::Fixed(expected));
}

#[test]
fn known_equal_and_fixed_elements_combine_with_a_diagonal() {
    let covariance = three(
        "[covariance]\nstructure = 'diagonal'\nfixed = { 'c, c' = 2, 'a, b' = 0 }\nequal = [['b, b', 'a, a']]\n\
         known = [[0.1, 0, 0], [0, 0, 0], [0, 0, '2 * 0.25']]",
    )
    .only()
    .covariance;
    assert_eq!(covariance.fixed, [FixedElement { i: 2, j: 2, value: 2.0 }]);
    assert_eq!(covariance.equal, [[(1, 1), (0, 0)]]);
    let known = covariance.known.unwrap();
    assert_eq!((&known[0][0], &known[2][2]), (&number(0.1), &number(0.5)));
}

#[test]
fn a_zero_variance_implies_its_covariances_and_may_be_said_twice() {
    let covariance =
        three("[covariance]\nfixed = { 'a, a' = 0, 'b, a' = 0, 'a, b' = 0, 'c,a' = 0.0 }").only().covariance;
    assert_eq!(covariance.fixed, [FixedElement { i: 0, j: 0, value: 0.0 }]);
}

#[test]
fn a_second_order_process_has_a_hidden_rate_after_its_owner() {
    let text = |initial: &str| {
        format!(
            "[data]\ntime = 't'\n[states.a]\nprocess = 'gauss-markov-2'\ntime_constant = 2\nsigma = 3\n{initial}\n\
             [states.b]\n[measurements.y]\ncolumn = 'y'\nequation = 'a + b'\nnoise = 1\n"
        )
    };
    let model = read(&text("")).only();
    let names: Vec<&str> = model.states.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["a", "a (rate)", "b"]);
    // β = 1/2: dv = -v·2β - x·β², noise 4β³σ² = 4.5, stationary variance of v β²σ² = 2.25.
    let rate = Motion::Continuous {
        derivative: Linear { terms: vec![(0, number(-0.25)), (1, number(-1.0))], constant: number(0.0) },
        noise_variance: number(4.5),
    };
    assert_eq!(model.states[1].motion, rate);
    let owner = Motion::Continuous {
        derivative: Linear { terms: vec![(1, number(1.0))], constant: number(0.0) },
        noise_variance: number(0.0),
    };
    assert_eq!(model.states[0].motion, owner);
    assert_eq!(model.states[0].initial, Initial::Stationary);
    assert_eq!(model.states[1].initial, Initial::Stationary);
    assert_eq!(model.estimated, [2]);

    for initial in ["initial = 'estimated'", "initial = { mean = 1, sigma = 2 }"] {
        let model = read(&text(initial)).only();
        let known = Initial::Known { mean: number(0.0), variance: number(2.25) };
        assert_eq!(model.states[1].initial, known, "{initial}");
    }
}

#[test]
fn random_walks_and_integrals_move_as_named() {
    let model = read(
        "[data]\ntime = 't'\n[states]\na = { process = 'random-walk', noise_density = 2 }\n\
         b = { process = 'random-walk', step_noise = 3 }\nc = { process = 'integral', of = 'a' }\n\
         d = { process = 'integral', of = 'a - 2 * u', offset = 'h + 1' }\n\
         [measurements.y]\ncolumn = 'y'\nequation = 'b + c + d'\nvariance = 'v'\n[parameters]\nv = {}\n",
    )
    .only();
    let still = Linear { terms: Vec::new(), constant: number(0.0) };
    let a = Motion::Continuous { derivative: still, noise_variance: number(4.0) };
    assert_eq!(model.states[0].motion, a);
    let keep = Linear { terms: vec![(1, number(1.0))], constant: number(0.0) };
    assert_eq!(model.states[1].motion, Motion::Discrete { next: keep, noise_variance: number(9.0) });
    let of_a = Linear { terms: vec![(0, number(1.0))], constant: number(0.0) };
    assert_eq!(model.states[2].motion, Motion::Continuous { derivative: of_a, noise_variance: number(0.0) });
    assert!(model.states[3].offset.is_some() && model.states[2].offset.is_none());
    assert_eq!(model.measurements[0].noise_variance, Parameter(0));
    assert!(model.parameters[0].positive, "a variance is not negative");
}

#[test]
fn data_options_reach_the_clock_and_the_layout() {
    let spec = read(
        "[data]\ntest = '@file'\ntime = 't'\ninitial_time = 't0'\ninputs = 'previous'\nmissing = ['.', '-99']\n\
         [states.a]\nderivative = 'u - a'\n[measurements.y]\ncolumn = 'y'\nequation = 'a'\nnoise = 0\n",
    );
    assert_eq!(spec.layout.test, TestKey::File);
    assert_eq!(spec.layout.missing, [".", "-99"]);
    let clock = &spec.model.shared().clock;
    assert_eq!(clock.initial_time, Some(Column(1)));
    assert_eq!(spec.model.shared().columns[1].name, "t0");
    assert!(clock.previous_inputs && !clock.step_first);
}

#[test]
fn states_and_parameters_hide_columns_unless_in_backticks() {
    let model = read(
        "[states]\na = {}\n[measurements.y]\ncolumn = 'y'\nequation = '`a` * a + k * `k` + `two words`'\nnoise = 1\n\
         [parameters]\nk = 2\n",
    )
    .only();
    let names: Vec<&str> = model.columns.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["y", "a", "k", "two words"]);
    assert_eq!(model.measurements[0].equation.terms, [(0, Column(1))]);
}

#[test]
fn levels_may_be_fixed_one_by_one() {
    let spec = read(
        "[states]\na = {}\n[measurements.y]\ncolumn = 'y'\nequation = 'a'\nnoise = 's'\n\
         [parameters]\ns = { start = 1, per = 'lot', fixed = { A = 0.7, B = 0 } }\n",
    );
    let s = &spec.model.shared().parameters[0];
    assert_eq!(spec.model.shared().literals, ["A", "B"]);
    assert_eq!(s.fixed_levels.iter().map(|(l, v)| (*l, *v)).collect::<Vec<_>>(), [(0, 0.7), (1, 0.0)]);
}

#[test]
fn conditions_choose_between_linear_forms() {
    let model = three("").only();
    assert_eq!(model.measurements[0].equation.terms.len(), 3);
    let model = read(
        "[states]\na = {}\nb = {}\n[measurements.y]\ncolumn = 'y'\nequation = \"if(s != 'A' and u > 1, a + b, 2 * a)\"\n\
         noise = 1\n",
    )
    .only();
    let terms = &model.measurements[0].equation.terms;
    let Expression::If(condition, one, two) = &terms[0].1 else { panic!("{terms:?}") };
    assert!(matches!(**condition, Expression::Binary(Operator::And, ..)));
    assert_eq!((&**one, &**two), (&number(1.0), &number(2.0)));
    assert_eq!(model.measurements[0].equation.constant, number(0.0));
}

#[test]
fn a_description_says_the_model_in_words() {
    insta::assert_snapshot!(read(GYRO).describe().join("\n"), @r#"
    tests: one for each value of column `unit`; reports are grouped by column `lot`
    steps: rows of equal time, column `t` [s]; x_0 is at time 0
    state `bias` [deg/h]: constant; start estimated
    state `scale` [ppm]: constant; start estimated
    state `drift`: d/dt = -1 / tau * drift + noise of variance 2 * sigma_drift^2 / tau per unit of time; start in its stationary distribution
    state `temperature_coefficient`: constant; start estimated, one value common to all tests
    state `angle`: d/dt = bias + 1e-6 * rate_in * scale + drift + (T - 20) * temperature_coefficient + noise of standard deviation arw per square root of a unit of time; start known, mean 0, variance 0
    measurement `gyro`: column `angle_out` reads angle; noise of standard deviation sigma_v
    parameter `tau` [s]: free, start 120, not negative, at least 1
    parameter `sigma_drift`: free, start 0.02, not negative
    parameter `sigma_v`: free, start 0.1, not negative, one value for each value of column `lot`
    parameter `arw`: fixed at 0.003, not negative
    order of μ and Σ: bias, scale, temperature_coefficient
    covariance Σ: full
    variance of `temperature_coefficient`: fixed at 0
    "#);
    insta::assert_snapshot!(read(SUBJECTS).describe().join("\n"), @r#"
    tests: one for each value of column `subject`
    steps: one for each row; one step from x_0 to the first row
    state `x1`: next = f * x1 + g * u + noise of standard deviation s1 per step; start estimated
    state `x2`: next = 0.8 * x2 + noise of standard deviation s2 per step; start estimated
    process noise of `x1` and `x2`: covariance q12
    measurement `y1`: column `y` (rows where sensor == 'A') reads x1; noise of standard deviation 0.1
    measurement `y2`: column `y` (rows where sensor == 'B') reads 0.5 * x1 + x2; noise of standard deviation 0.1
    measurement noise of `y1` and `y2`: covariance 0.002
    parameter `f`: free
    parameter `g`: free
    parameter `s1`: free, not negative
    parameter `s2`: free, not negative
    parameter `q12`: free, start 0
    order of μ and Σ: x1, x2
    covariance Σ: full
    "#);
    let constraints = "[covariance]\nfixed = { 'a, b' = 0 }\nequal = [['a, a', 'b, b']]\n\
                       known = [[0.1, 0, 0], [0, 0, 0], [0, 0, 0]]\nstart = [[1, 0, 0], [0, 1, 0], [0, 0, 4]]\n\
                       [mean]\nfixed = { c = 0 }\ntied = { b = '2 * a - 1' }\nregression = { a = ['T'] }";
    insta::assert_snapshot!(three(constraints).describe().join("\n"), @r#"
    tests: all rows are one test
    steps: one for each row; x_0 is at the first row
    state `a`: constant; start estimated
    state `b`: constant; start estimated
    state `c`: constant; start estimated
    measurement `y`: column `y` reads a + u * b + v * c; noise of variance 1
    order of μ and Σ: a, b, c
    mean of `b`: tied to 2 × mean of `a` - 1
    mean of `c`: fixed at 0
    mean of `a`: moves with column `T`
    covariance Σ: full
    covariance of `a, b`: fixed at 0
    covariances of `a, a` and `b, b`: equal
    known covariance added to Σ: [[0.1, 0, 0], [0, 0, 0], [0, 0, 0]]
    covariance Σ: starts at the given matrix
    "#);
}
