//! Laws of test results, compared with the laws of Hotelling and Fisher.

use nalgebra::{DMatrix, DVector};

use crate::apply::{Applied, Law, Laws, Said, Trust};
use kalfit_fixtures::near;
use kalfit_infer::{Estimand, Estimated, Knowledge};
use kalfit_model::Labels;
use kalfit_model::PhasedTest;
use kalfit_model::build::{Columns, ModelBuilder, constant, fixed, measurement, name};
use kalfit_model::{Alpha, Model, PhasedModel, Population};

const ROWS: usize = 5;
const SIGMA: f64 = 0.5;
/// The size of the correlated errors of Σ̂ and σ̂, as a part: closer the laws need not be.
const CORRELATED: f64 = 1e-3;

/// y = bias + u slope with noise `sigma`.
fn model() -> PhasedModel {
    let builder: ModelBuilder = Model::builder("lines")
        .parameter(fixed("sigma", SIGMA))
        .state(constant("bias"))
        .state(constant("slope"))
        .measurement(measurement("y", name("bias") + name("u") * name("slope"), name("sigma")));
    builder.build().expect("a model")
}

fn tests(model: &PhasedModel, number: usize) -> Vec<PhasedTest> {
    let one = |test: usize| {
        let mut labels = Labels::new(&model.shared().literals);
        let y = (0..ROWS).map(|row| ((7 * test + 3 * row) % 11) as f64 / 4.0 - 1.2).collect::<Vec<f64>>();
        let u = (0..ROWS).map(|row| row as f64 - 2.0).collect::<Vec<f64>>();
        Columns::new(format!("t{test}")).numbers("u", u).numbers("y", y).test(model, &mut labels).expect("a test")
    };
    (0..number).map(one).collect()
}

fn population() -> Population {
    let covariance = DMatrix::from_row_slice(2, 2, &[1.2, 0.4, 0.4, 0.7]);
    Population { mean: vec![0.5, -0.3], coefficients: vec![], covariance }
}

/// Maximum-likelihood knowledge from N tests: errors of mean and covariance by Wishart's law, of σ by 3N residuals.
fn knowledge(fitted: f64) -> Knowledge {
    let own = population().covariance;
    let noise = SIGMA * SIGMA * DMatrix::from_diagonal(&DVector::from_vec(vec![1.0 / ROWS as f64, 0.1]));
    let seen = own + noise;
    let elements = [(0, 0), (1, 0), (1, 1)];
    let mut covariance = DMatrix::zeros(6, 6);
    covariance.view_mut((0, 0), (2, 2)).copy_from(&(&seen / fitted));
    for (a, &(i, j)) in elements.iter().enumerate() {
        for (b, &(k, l)) in elements.iter().enumerate() {
            let product = seen[(i, k)] * seen[(j, l)] + seen[(i, l)] * seen[(j, k)];
            covariance[(2 + a, 2 + b)] = product / fitted;
        }
    }
    // σ is determined by residuals alone, and Σ̂ is the observed covariance less the noise according to σ̂
    let of_sigma = SIGMA * SIGMA / (2.0 * 3.0 * fitted);
    let by_sigma = [-2.0 * SIGMA / ROWS as f64, 0.0, -2.0 * SIGMA * 0.1];
    covariance[(5, 5)] = of_sigma;
    for a in 0..3 {
        (covariance[(2 + a, 5)], covariance[(5, 2 + a)]) = (by_sigma[a] * of_sigma, by_sigma[a] * of_sigma);
        (0..3).for_each(|b| covariance[(2 + a, 2 + b)] += by_sigma[a] * by_sigma[b] * of_sigma);
    }
    let mean = [0, 1].map(|i| Estimand::Population(Estimated::Mean(i)));
    let sigma = elements.map(|(i, j)| Estimand::Population(Estimated::Covariance(i, j)));
    let quantities = mean.into_iter().chain(sigma).chain([Estimand::Parameter { parameter: 0, level: None }]);
    Knowledge {
        quantities: quantities.collect(),
        covariance,
        open: vec![],
        at_zero: vec![],
        tests: fitted,
        few_tests: None,
        is_restricted: false,
    }
}

fn laws(number: usize, trust: &Trust<'_>) -> (Said, Laws) {
    let (model, population) = (model(), population());
    let alpha = Alpha::fixed(&model.shared().parameters).expect("all are fixed");
    let tests = tests(&model, number);
    let applied = Applied::new(&model, &alpha, &population, &tests).expect("it applies");
    let said = applied.said().expect("it applies");
    let laws = applied.laws(&said, trust).expect("it applies");
    (said, laws)
}

#[test]
fn each_test_has_the_law_of_hotelling_and_all_that_of_the_trace() {
    let fitted = 12.0;
    let (_, found) = laws(7, &Trust::Estimates(&knowledge(fitted)));
    for law in &found.tests {
        let law = law.expect("there are enough tests");
        near::relative("scale", law.scale, 2.0 * (fitted + 1.0) / (fitted - 2.0), CORRELATED);
        near::relative("a", law.numerator, 2.0, CORRELATED);
        near::relative("b", law.denominator, fitted - 2.0, CORRELATED);
    }
    // E: N n p (1 + 1/N) / (N - 1 - p - 1)
    let sum = found.distance.expect("there are enough tests");
    near::relative("mean", sum.mean(), fitted * 7.0 * 2.0 * (1.0 + 1.0 / fitted) / (fitted - 4.0), CORRELATED);
}

#[test]
fn residuals_have_the_law_of_fisher() {
    let fitted = 12.0;
    let (_, found) = laws(7, &Trust::Estimates(&knowledge(fitted)));
    let expected = |degrees: f64| Law { denominator: 3.0 * fitted, ..Law::chi_squared(degrees) };
    let own = found.residuals.iter().map(|law| (law, expected(3.0))).chain([(&found.residual, expected(21.0))]);
    for (found, expected) in own {
        let found = found.expect("there are residuals");
        assert_eq!((found.scale, found.numerator), (expected.scale, expected.numerator));
        near::relative("b", found.denominator, expected.denominator, CORRELATED);
    }
}

#[test]
fn exact_parameters_leave_chi_squared() {
    let exact = Knowledge::exact();
    let (said, found) = laws(5, &Trust::Estimates(&exact));
    assert_eq!(found, Laws::known(&said));
}

#[test]
fn a_number_of_tests_stands_for_tests_that_tell_all() {
    let (_, found) = laws(1, &Trust::Tests(12));
    let law = found.tests[0].expect("there are enough tests");
    near::relative("scale", law.scale, 2.0 * 13.0 / 10.0, CORRELATED);
    near::relative("b", law.denominator, 10.0, CORRELATED);
}

#[test]
fn what_is_not_determined_has_no_law() {
    let open = vec![Estimand::Population(Estimated::Covariance(1, 1))];
    let (_, found) = laws(5, &Trust::Estimates(&Knowledge { open, ..knowledge(12.0) }));
    assert_eq!((found.distance, found.tests[0]), (None, None));
    assert!(found.residual.is_some());
}
