//! Start values worked out from the data lead to the best maximum of ℓ, of which noise levels have several.

use std::collections::BTreeMap;
use std::path::Path;

use kalfit::dynamic::{self, DynamicFit, Settings};
use kalfit::estimate::{Silent, Stop};
use kalfit::model::{
    Clock, Column, CovarianceStructure, Initial, Linear, MeanStructure, Measurement, Motion, Operator, Parameter,
    PhasedModel, State, Value,
};
use kalfit::reduce::PhasedTest;
use kalfit::{Expression, Labels, Model, Source, Test};

const SIGMA: usize = 0;
const WALK: usize = 1;
const TAU: usize = 2;

fn of(parameter: usize) -> Expression {
    Expression::Parameter(parameter)
}

fn binary(operator: Operator, a: Expression, b: Expression) -> Expression {
    Expression::Binary(operator, Box::new(a), Box::new(b))
}

fn square(parameter: usize) -> Expression {
    binary(Operator::Multiply, of(parameter), of(parameter))
}

fn linear(terms: Vec<(usize, Expression)>) -> Linear {
    Linear { terms, constant: Expression::Number(0.0) }
}

/// A bias and a drift, seen through white noise: a random walk from zero, or a stationary Gauss-Markov process. No start values.
fn model(gauss_markov: bool) -> PhasedModel {
    let parameter = |name: &str| Parameter {
        name: name.to_owned(),
        unit: None,
        value: Value::Free { start: None },
        per: None,
        fixed_levels: BTreeMap::new(),
        lower: None,
        upper: None,
        positive: true,
    };
    let state = |name: &str, motion, initial| State {
        name: name.to_owned(),
        unit: None,
        motion,
        initial,
        offset: None,
        random: true,
    };
    let (number, column) = (Expression::Number, |name: &str| Column { name: name.to_owned(), used_in: String::new() });
    let (motion, initial) = if gauss_markov {
        let rate = Expression::Negate(Box::new(binary(Operator::Divide, number(1.0), of(TAU))));
        let twice = binary(Operator::Multiply, number(2.0), square(WALK));
        let noise_variance = binary(Operator::Divide, twice, of(TAU));
        (Motion::Continuous { derivative: linear(vec![(1, rate)]), noise_variance }, Initial::Stationary)
    } else {
        let walk = Motion::Continuous { derivative: linear(vec![]), noise_variance: square(WALK) };
        (walk, Initial::Known { mean: number(0.0), variance: number(0.0) })
    };
    let names = ["sigma", "walk", "tau"];
    Model {
        title: String::new(),
        columns: vec![column("t"), column("z")],
        text_columns: vec![],
        literals: vec![],
        parameters: names[..2 + usize::from(gauss_markov)].iter().map(|name| parameter(name)).collect(),
        states: vec![state("bias", Motion::Constant, Initial::Estimated), state("drift", motion, initial)],
        process_noise_covariance: vec![],
        measurements: vec![Measurement {
            name: "z".to_owned(),
            column: 1,
            filter: None,
            equation: linear(vec![(0, number(1.0)), (1, number(1.0))]),
            noise_variance: square(SIGMA),
        }],
        noise_covariance: vec![],
        clock: Clock { time: Some(0), ..Clock::default() },
        group: None,
        estimated: vec![0],
        mean: MeanStructure::free(1),
        covariance: CovarianceStructure::full(),
    }
    .into()
}

/// The tests of a file with columns `test`, `t` and the one asked for.
fn tests(path: &Path, column: &str) -> Vec<PhasedTest> {
    let text = std::fs::read_to_string(path).expect("the example's data");
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let at = |name: &str| header.iter().position(|own| *own == name).expect("a column");
    let (id, t, z) = (at("test"), at("t"), at(column));
    let mut all: BTreeMap<String, Test> = BTreeMap::new();
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let test = all.entry(cells[id].to_owned()).or_insert_with(|| Test::new(cells[id], 2, 0));
        let number = |at: usize| cells[at].parse::<f64>().unwrap_or(f64::NAN);
        test.push(&[number(t), number(z)], &[], Source::default());
    }
    all.into_values().map(PhasedTest::from).collect()
}

fn example() -> Vec<PhasedTest> {
    tests(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/mimu4444/gyro_x.csv"), "gyro_x")
}

fn fit(model: &PhasedModel, tests: &[PhasedTest], starts: usize) -> DynamicFit {
    let settings = Settings { starts, ..Settings::default() };
    dynamic::fit(model, &Labels::new(&[]), tests, &settings, &mut Silent).expect("a fit")
}

#[test]
fn noise_is_shared_out_between_the_measurement_and_a_random_walk() {
    // the book's tutorial prints 12676.42, 0.02472 and 0.001660; with all noise in the walk there is a maximum at 11222.87
    let found = fit(&model(false), &example(), 0);
    assert_eq!(found.stop, Stop::Certified);
    assert!((found.estimate.log_likelihood - 12_676.42).abs() < 0.01, "ℓ {}", found.estimate.log_likelihood);
    let off = |p: usize, expected: f64| (found.values[p] / expected - 1.0).abs();
    assert!(off(SIGMA, 0.024_72) < 1e-3 && off(WALK, 0.001_660) < 1e-3, "{:?}", found.values);
}
