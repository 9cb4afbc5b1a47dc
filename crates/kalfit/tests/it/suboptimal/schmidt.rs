//! The public case schmidt-single: its numbers were found by stacking all noises of each test densely.

use kalfit::estimate::Structure;
use kalfit::model::{
    Alpha, Clock, Column, CovarianceStructure, Filter, FixedElement, Initial, Linear, MeanElement, MeanStructure,
    Measurement, Motion, Operator, Parameter, Phase, State, Value,
};
use kalfit::plan::{Quantity, information_lost};
use kalfit::reduce::{EstimateReducer, FilterRunner, Reducer, ReductionRef, Reductions, lost};
use kalfit::{Expression, Model, PhasedModel, Population, Source, Test};
use kalfit_fixtures::dense::{marginal, unpacked};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};

/// unit, t, g_in, output.
const DATA: &str = include_str!("../data/schmidt_single.csv");
/// Parameters: sigma_v, rw.
const SIGMA_V: usize = 0;
const RW: usize = 1;

fn tests() -> Vec<Test> {
    let mut tests: Vec<Test> = Vec::new();
    for (k, line) in DATA.lines().enumerate().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |c: usize| if cells[c].is_empty() { f64::NAN } else { cells[c].parse().expect("a number") };
        if tests.last().is_none_or(|test| test.id != cells[0]) {
            tests.push(Test::new(cells[0], 3, 0));
        }
        let test = tests.last_mut().expect("one was pushed");
        test.push(&[number(1), number(2), number(3)], &[], Source { file: 0, row: k as u64 + 1 });
    }
    tests
}

fn square(parameter: usize) -> Expression {
    let parameter = || Box::new(Expression::Parameter(parameter));
    Expression::Binary(Operator::Multiply, parameter(), parameter())
}

fn model() -> Model {
    let zero = || Expression::Number(0.0);
    let one = || Expression::Number(1.0);
    let state = |name: &str, motion: Motion| State {
        name: name.to_owned(),
        unit: None,
        motion,
        initial: Initial::Estimated,
        offset: None,
        random: true,
    };
    let parameter = |name: &str, value: f64| Parameter {
        name: name.to_owned(),
        unit: None,
        value: Value::Fixed(value),
        per: None,
        fixed_levels: Default::default(),
        lower: None,
        upper: None,
        positive: true,
    };
    let derivative = Linear { terms: vec![(1, one())], constant: zero() };
    let equation = Linear { terms: vec![(0, one()), (2, Expression::Column(1))], constant: zero() };
    Model {
        title: String::new(),
        columns: ["t", "g_in", "output"]
            .iter()
            .map(|name| Column { name: (*name).to_owned(), used_in: String::new() })
            .collect(),
        text_columns: vec![],
        literals: vec![],
        parameters: vec![parameter("sigma_v", 6.0), parameter("rw", 4.0)],
        states: vec![
            state("bias", Motion::Continuous { derivative, noise_variance: square(RW) }),
            state("trend", Motion::Constant),
            state("scale", Motion::Constant),
        ],
        process_noise_covariance: vec![],
        measurements: vec![Measurement {
            name: "output".to_owned(),
            column: 2,
            filter: None,
            equation,
            noise_variance: square(SIGMA_V),
        }],
        noise_covariance: vec![],
        clock: Clock { time: Some(0), ..Clock::default() },
        group: None,
        estimated: vec![0, 1, 2],
        mean: MeanStructure::free(3),
        covariance: CovarianceStructure::full(),
    }
}

fn phase(consider: &[usize], parameters: &[(usize, f64)]) -> Phase {
    let mut phase = PhasedModel::from(model()).phases.remove(0);
    phase.filter = Some(Filter {
        consider: consider.to_vec(),
        mean: vec![8.0, 0.0, 0.0],
        covariance: DMatrix::from_diagonal(&DVector::from_row_slice(&[100.0, 25.0, 1.0])),
        parameters: parameters.to_vec(),
    });
    phase
}

/// Reductions of the estimates, and the sum of ½ log |Γ|.
fn reduced(phase: &Phase) -> (Reductions, f64) {
    let alpha = Alpha::fixed(&phase.model.parameters).expect("all is fixed");
    let runner = FilterRunner::new(phase, &alpha).expect("sound");
    let reducer = EstimateReducer::new(phase, &alpha).expect("sound");
    let estimates = runner.run_all(&tests()).expect("sound");
    let both = tests().into_iter().zip(&estimates);
    let volumes = both.clone().map(|(test, estimates)| reducer.log_volume(&test.id, estimates).expect("sound"));
    let volume = volumes.sum();
    (both.map(|(test, estimates)| reducer.reduce(&test.id, estimates).expect("sound").0).collect(), volume)
}

fn factor(reduction: ReductionRef<'_>) -> DMatrix<f64> {
    unpacked(reduction.factor, reduction.data.len())
}

fn sum_of_information(reductions: &Reductions) -> DMatrix<f64> {
    reductions.iter().map(|r| factor(r).transpose() * factor(r)).sum()
}

fn covariance(bias: f64, both: f64, trend: f64) -> DMatrix<f64> {
    DMatrix::from_row_slice(3, 3, &[bias, both, 0.0, both, trend, 0.0, 0.0, 0.0, 4.0])
}

#[test]
fn the_schmidt_filter_of_the_public_case_gives_its_log_likelihood() {
    let (reductions, volume) = reduced(&phase(&[2], &[(SIGMA_V, 2.0), (RW, 0.5)]));
    let mean = DVector::from_row_slice(&[11.142155605, 1.5575300969, 0.0]);
    let sigma = covariance(17.428325996, 8.2177959005, 6.0236127164);
    let each: Vec<f64> = reductions.iter().map(|r| marginal(r, &mean, &sigma)).collect();
    near::absolute("ℓ", each.iter().sum(), -249.7113271845, 1e-9);
    near::absolute("whitened ℓ", each.iter().sum::<f64>() + volume, -120.9356119929, 1e-9);
    for (found, expected) in each.iter().zip([-8.4681946149, -7.2133488531, -7.7834166487]) {
        near::absolute("ℓ of a test", *found, expected, 1e-9);
    }
    let expected = [
        [1.7904712884, 1.7851159019, 0.48594830299],
        [1.7851159019, 11.472616481, 0.55547083469],
        [0.48594830299, 0.55547083469, 0.52092408574],
    ];
    let sum = sum_of_information(&reductions);
    for (i, row) in expected.iter().enumerate() {
        for (j, expected) in row.iter().enumerate() {
            near::absolute("Σ J", sum[(i, j)], *expected, 1e-9 * expected);
        }
    }
}

#[test]
fn a_filter_that_is_optimal_but_for_its_finite_prior_loses_nothing() {
    let (reductions, volume) = reduced(&phase(&[], &[]));
    let mean = DVector::from_row_slice(&[11.101698507, 1.4961022844, 0.0]);
    let sigma = covariance(13.01967194, 8.212585765, 6.1258288233);
    let each: Vec<f64> = reductions.iter().map(|r| marginal(r, &mean, &sigma)).collect();
    near::absolute("ℓ", each.iter().sum(), -265.0836734958, 1e-9);
    near::absolute("whitened ℓ", each.iter().sum::<f64>() + volume, -153.9639057576, 1e-9);
    let alpha = Alpha::fixed(&model().parameters).expect("all is fixed");
    let raw = Reducer::new(&model(), &alpha).expect("sound").reduce(&tests()).expect("sound");
    for (raw, own) in raw.iter().zip(&reductions) {
        let (r, s) = (factor(raw), factor(own));
        let (j, k) = (r.transpose() * &r, s.transpose() * &s);
        let (y, z) = (
            r.transpose() * DVector::from_column_slice(raw.data),
            s.transpose() * DVector::from_column_slice(own.data),
        );
        assert!((&j - &k).amax() <= 1e-11 * j.amax(), "test {}: J {j} {k}", raw.test);
        assert!((&y - &z).amax() <= 1e-11 * y.amax(), "test {}: y {y} {z}", raw.test);
    }
}

#[test]
fn what_the_schmidt_filter_loses_of_the_information_is_that_of_the_public_case() {
    let alpha = Alpha::fixed(&model().parameters).expect("all is fixed");
    let raw = Reducer::new(&model(), &alpha).expect("sound").reduce(&tests()).expect("sound");
    let (own, _) = reduced(&phase(&[2], &[(SIGMA_V, 2.0), (RW, 0.5)]));
    let mut mean = MeanStructure::free(3);
    mean.elements[2] = MeanElement::Fixed(0.0);
    let fixed = |i: usize, j: usize, value: f64| FixedElement { i, j, value };
    let mut structure = CovarianceStructure::full();
    structure.fixed = vec![fixed(2, 2, 4.0), fixed(2, 0, 0.0), fixed(2, 1, 0.0)];
    let population = Population {
        mean: vec![11.101698507, 1.4961022844, 0.0],
        coefficients: vec![],
        covariance: covariance(13.01967194, 8.212585765, 6.1258288233),
    };
    let structure = Structure::single(&mean, &structure, &alpha);
    let found = information_lost(&raw, &own, &structure, &population).expect("sound");
    let expected = [
        (Quantity::Mean(0), 1.045168),
        (Quantity::Mean(1), 1.006609),
        (Quantity::Covariance(0, 0), 1.089779),
        (Quantity::Covariance(1, 0), 1.045849),
        (Quantity::Covariance(1, 1), 1.012337),
    ];
    for (quantity, expected) in expected {
        let ratio = found.std_errors.iter().find(|ratio| ratio.quantity == quantity).expect("it is free").ratio;
        near::absolute(format_args!("{quantity:?}"), ratio, expected, 1e-6);
    }
    near::absolute("log |I|", found.log_determinant.expect("all is identified"), -0.48847525, 1e-8);
    let parts: Vec<(f64, f64)> = raw.iter().zip(&own).map(|(a, b)| lost(a, b).expect("less").range).collect();
    assert!(parts.iter().any(|(_, most)| *most > 0.05 && *most < 1.0), "nothing is lost: {parts:?}");
}
