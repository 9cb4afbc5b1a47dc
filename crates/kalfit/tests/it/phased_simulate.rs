//! Ensembles of tests in phases against the joint Gaussian of the model, written down by hand.

use kalfit::Alpha;
use kalfit::reduce::{Evidence, PhasedTest};
use kalfit::simulate::{Designs, Drawn, SimulateError, Simulator};
use nalgebra::{DMatrix, DVector};

use crate::simulate::assert_law;
use crate::three_phases::{Row, law, model, population, roots, rows, test, values};

fn draw(design: PhasedTest, roots: [DMatrix<f64>; 3], seed: u64, count: u64) -> Vec<Drawn> {
    let simulator = Simulator::new(&model(), &Alpha::default(), population(roots), seed).expect("sound");
    simulator.draw(&Designs::new(vec![design]).expect("a test"), 0..count).expect("a sound design")
}

/// The rows of the first phases.
fn first(phases: usize) -> [Vec<Row>; 3] {
    let mut rows = rows();
    rows[phases..].iter_mut().for_each(Vec::clear);
    rows
}

#[test]
fn drawn_phases_have_the_law_of_the_joint_gaussian() {
    for (seed, phases) in [(0, 3), (1, 3), (2, 3), (4, 2), (5, 1)] {
        let rows = first(phases);
        let drawn = draw(test("a", &rows), roots(seed), 10 + seed as u64, 4000);
        let z: Vec<DVector<f64>> = drawn.iter().map(|drawn| values(&drawn.test)).collect();
        let population = population(roots(seed));
        let (mean, covariance) = law(&rows, &population);
        assert_law(&format!("seed {seed}, z"), &z, &mean, &covariance);
        let p = [2, 4, 5][phases - 1];
        let xi: Vec<DVector<f64>> = drawn.iter().map(|drawn| DVector::from_row_slice(&drawn.initial)).collect();
        let mut mu = DVector::from_row_slice(&population.mean[..p]);
        mu[1] += 0.6 * 1.5;
        assert_law(&format!("seed {seed}, xi"), &xi, &mu, &population.covariance.view((0, 0), (p, p)).into_owned());
    }
}

#[test]
fn a_test_without_later_phases_begins_as_one_with_them() {
    let (whole, short) = (draw(test("a", &rows()), roots(0), 7, 3), draw(test("a", &first(2)), roots(0), 7, 3));
    for (whole, short) in whole.iter().zip(&short) {
        let z = values(&short.test);
        assert_eq!(z.as_slice(), &values(&whole.test).as_slice()[..z.len()]);
        assert_eq!((short.test.phases.len(), z.len()), (2, 9));
        assert_eq!(short.initial[..], whole.initial[..4]);
    }
}

#[test]
fn only_rows_can_be_drawn_for() {
    let refusal = |design: PhasedTest| {
        let simulator = Simulator::new(&model(), &Alpha::default(), population(roots(0)), 1).expect("sound");
        simulator.draw(&Designs::new(vec![design]).expect("a test"), 0..1).expect_err("no design")
    };
    let mut many = test("a", &rows());
    many.phases.extend(many.phases.clone());
    assert_eq!(refusal(many), SimulateError::Phases { test: "a".into(), found: 6, expected: 3 });
    let mut none = test("a", &rows());
    none.phases.truncate(0);
    assert_eq!(refusal(none), SimulateError::Phases { test: "a".into(), found: 0, expected: 3 });
    let mut reduced = test("a", &rows());
    let reducer = kalfit::reduce::PhasedReducer::new(&model(), &Alpha::default()).expect("sound");
    let pieces = reducer.pieces(&[reduced.clone()]).expect("sound").remove(0);
    reduced.phases[1] = Evidence::Reduced(Box::new(pieces[1].clone()));
    let expected =
        "test `a`: phase `two` is given by a reduction, expected its rows: they tell times, inputs and missing values";
    assert_eq!(refusal(reduced).to_string(), expected);
}

#[test]
fn a_column_that_a_carry_reads_is_not_measured() {
    let mut model = model();
    model.phases[1].model.measurements[0].column = 3; // k, by which d inherits
    let refusal = Simulator::new(&model, &Alpha::default(), population(roots(0)), 1).expect_err("an input is drawn");
    assert_eq!(refusal, SimulateError::MeasuredInput { column: "k".into() });
}
