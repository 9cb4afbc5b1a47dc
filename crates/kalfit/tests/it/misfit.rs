//! Misfit that tests have in common, against the joint Gaussian law of all measurements of a unit.

use kalfit::build::{Columns, constant, measurement, name};
use kalfit::infer::misfit::{FittedEnsemble, Misfit, TermKind, misfit};
use kalfit::model::{CovarianceStructure, GroupLevel};
use kalfit::{Alpha, Ensemble, PhasedModel, Population};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};

const NOISE: f64 = 0.3;
const UNITS: usize = 5;
const RUNS: usize = 3;
const ROWS: usize = 14;

/// y = bias + scale x, with runs of units.
struct Bench {
    model: PhasedModel,
    ensemble: Ensemble,
    population: Population,
}

fn x(unit: usize, run: usize, row: usize) -> f64 {
    ((5 * unit + 3 * run + 7 * row) % 13) as f64 / 6.5 - 1.0 + 0.01 * row as f64
}

fn noise(k: usize) -> f64 {
    ((k * k * 31 + 17 * k) % 101) as f64 / 101.0 - 0.5
}

impl Bench {
    /// `change`: what is added to the measurement, by unit, run and row.
    fn new(change: impl Fn(usize, usize, usize) -> f64) -> Bench {
        let equation = name("bias") + name("scale") * name("x");
        let built = kalfit::Model::builder("bench").state(constant("bias")).state(constant("scale"));
        let mut model = built.group("unit").measurement(measurement("y", equation, NOISE)).build().expect("a model");
        let covariance = CovarianceStructure::full();
        model.levels.push(GroupLevel {
            name: "unit".to_owned(),
            column: 0,
            crossed: false,
            covariance,
            members: Vec::new(),
        });
        let test = |k: usize| {
            let (unit, run) = (k / RUNS, k % RUNS);
            let x: Vec<f64> = (0..ROWS).map(|row| x(unit, run, row)).collect();
            let bias = 1.0 + 2.0 * noise(unit + 50) + 0.4 * noise(k);
            let y = |row: usize| bias + 0.5 * x[row] + 0.9 * noise(ROWS * k + row) + change(unit, run, row);
            let y: Vec<f64> = (0..ROWS).map(y).collect();
            let names = vec![format!("u{unit}"); ROWS];
            Columns::new(format!("u{unit}/{run}")).numbers("x", x).numbers("y", y).texts("unit", names)
        };
        let tests: Vec<Columns> = (0..UNITS * RUNS).map(test).collect();
        let ensemble = Ensemble::new(&model, &tests).expect("columns of the model");
        let within = [0.04, 0.01, 0.01, 0.02];
        let between = [0.5, 0.1, 0.1, 0.09];
        let mut covariance = DMatrix::zeros(4, 4);
        covariance.view_mut((0, 0), (2, 2)).copy_from_slice(&within);
        covariance.view_mut((2, 2), (2, 2)).copy_from_slice(&between);
        let population = Population { mean: vec![1.1, 0.4, 0.0, 0.0], coefficients: Vec::new(), covariance };
        Bench { model, ensemble, population }
    }

    fn found(&self) -> Misfit {
        let alpha = Alpha::default();
        let grouping = kalfit::reduce::grouping(&self.model, self.ensemble.tests()).expect("groups");
        let of = FittedEnsemble {
            model: &self.model,
            alpha: &alpha,
            population: &self.population,
            tests: self.ensemble.tests(),
            grouping: grouping.as_ref(),
        };
        misfit(&of, &mut |_| true).expect("innovations")
    }

    /// Measurement of a row.
    fn y(&self, k: usize, row: usize) -> f64 {
        let kalfit::Evidence::Rows(rows) = &self.ensemble.tests()[k].phases[0] else { panic!("rows") };
        rows.numbers(row)[self.model.shared().measurements[0].column]
    }

    /// (X, r, V) of all tests.
    fn dense(&self) -> (DMatrix<f64>, DVector<f64>, DMatrix<f64>) {
        let n = UNITS * RUNS * ROWS;
        let place = |i: usize| (i / ROWS / RUNS, i / ROWS % RUNS, i % ROWS);
        let design = DMatrix::from_fn(n, 2, |i, k| {
            let (unit, run, row) = place(i);
            if k == 0 { 1.0 } else { x(unit, run, row) }
        });
        let mean = &design * DVector::from_row_slice(&self.population.mean[..2]);
        let residual = DVector::from_fn(n, |i, _| self.y(i / ROWS, i % ROWS) - mean[i]);
        let of = |from: usize| &design * self.population.covariance.view((from, from), (2, 2)) * design.transpose();
        let (within, between) = (of(0), of(2));
        let law = DMatrix::from_fn(n, n, |i, k| {
            let shared = |same: bool, covariance: &DMatrix<f64>| if same { covariance[(i, k)] } else { 0.0 };
            let own = if i == k { NOISE * NOISE } else { 0.0 };
            own + shared(i / ROWS == k / ROWS, &within) + shared(place(i).0 == place(k).0, &between)
        });
        (design, residual, law)
    }
}

fn inverse(law: &DMatrix<f64>) -> DMatrix<f64> {
    law.clone().cholesky().expect("positive definite").inverse()
}

/// Part of r'V⁻¹r that columns explain.
fn explained(columns: &DMatrix<f64>, residual: &DVector<f64>, inverse: &DMatrix<f64>) -> f64 {
    let score = columns.transpose() * inverse * residual;
    let information = columns.transpose() * inverse * columns;
    score.dot(&(information.cholesky().expect("independent columns").solve(&score)))
}

#[test]
fn terms_are_tested_under_the_law_of_the_whole_model() {
    let bench = Bench::new(|_, _, _| 0.0);
    let found = bench.found();
    let (design, residual, law) = bench.dense();
    let inverse = inverse(&law);
    let n = residual.len();
    let square = residual.dot(&(&inverse * &residual));
    assert_eq!((found.tests, found.count), (UNITS * RUNS, n));
    near::mixed("r'V⁻¹r", found.nis, square, 1e-7);
    let (least, largest) = (design.column(1).min(), design.column(1).max());
    let centre = 0.5 * (least + largest);
    let curved = DMatrix::from_fn(n, 3, |i, k| if k < 2 { design[(i, k)] } else { (design[(i, 1)] - centre).powi(2) });
    let without = explained(&design, &residual, &inverse);
    let term = found.terms.iter().find(|term| matches!(term.kind, TermKind::Square(_))).expect("a square");
    let part = explained(&curved, &residual, &inverse) - without;
    near::mixed("F of the square", term.statistic, part / ((square - without - part) / (n - 3) as f64), 1e-7);
    assert_eq!(term.degrees_of_freedom, [1, n - 3]);
    let by_test: f64 = found.by_test.iter().map(|(.., nis)| nis).sum();
    near::mixed("sum over tests", by_test, square, 1e-7);
}

#[test]
fn tests_are_compared_with_the_others_of_their_unit() {
    let bench = Bench::new(|unit, run, _| if (unit, run) == (2, 1) { 1.5 } else { 0.0 });
    let found = bench.found();
    let (design, residual, law) = bench.dense();
    let inverse = inverse(&law);
    let one = found.unlike.iter().find(|one| &*one.test == "u2/1").expect("the test");
    let own = |i: usize, k: usize| if i / ROWS == 2 * RUNS + 1 { design[(i, k)] } else { 0.0 };
    let shift = DMatrix::from_fn(residual.len(), 2, own);
    let information = shift.transpose() * &inverse * &shift;
    let covariance = information.clone().cholesky().expect("both states are seen").inverse();
    let estimate = &covariance * (shift.transpose() * &inverse * &residual);
    assert_eq!(one.state, 0);
    near::mixed("deviation", one.deviation, estimate[0] / covariance[(0, 0)].sqrt(), 1e-7);
    let least = found.unlike.iter().min_by(|a, b| a.p_value.total_cmp(&b.p_value)).expect("tests");
    assert_eq!(&*least.test, "u2/1");
    assert!(least.p_value < 1e-3, "{}", least.p_value);
}

#[test]
fn one_wrong_cell_leads_to_that_cell() {
    for row in [0, 5, ROWS - 1] {
        let bench = Bench::new(|unit, run, at| if (unit, run, at) == (3, 2, row) { 4.0 } else { 0.0 });
        let found = bench.found();
        let (_, residual, law) = bench.dense();
        let test = 3 * RUNS + 2;
        let inverse = inverse(&law.view((test * ROWS, test * ROWS), (ROWS, ROWS)).into());
        let own = residual.rows(test * ROWS, ROWS);
        let wrong = found.wrong_rows.iter().find(|wrong| &*wrong.test == "u3/2").expect("the test");
        let statistic = (&inverse * own)[row] / inverse[(row, row)].sqrt();
        near::mixed("auxiliary residual", wrong.deviation / wrong.std_dev, statistic, 1e-7);
        near::mixed("its size", wrong.std_dev, inverse[(row, row)].sqrt().recip(), 1e-7);
        assert!(wrong.p_value < 1e-12, "row {row}: {}", wrong.p_value);
    }
}

#[test]
fn a_response_that_bends_is_found_in_all_tests_together() {
    let bend = |unit, run, row| 0.25 * f64::powi(x(unit, run, row), 2);
    let found = Bench::new(bend).found();
    let term = found.terms.iter().find(|term| matches!(term.kind, TermKind::Square(_))).expect("a square");
    assert!(term.p_value < 1e-3, "{}", term.p_value);
}

#[test]
fn tests_that_share_a_disturbance_are_found() {
    let shared = |found: &Misfit| {
        let term = found.terms.iter().find(|term| term.kind == TermKind::Shared).expect("common steps");
        assert_eq!(term.degrees_of_freedom, [UNITS * RUNS * (UNITS * RUNS - 1) / 2, ROWS]);
        (term.statistic, term.p_value)
    };
    let (alone, p_value) = shared(&Bench::new(|_, _, _| 0.0).found());
    assert!(alone < 1.3 && p_value > 0.01, "{alone}, {p_value}");
    // two stations, so that the mean of each step stays small
    let station = |_, run, row| if run == 0 { 0.0 } else { (run as f64 * 2.0 - 3.0) * 2.0 * noise(5 * row + 3) };
    let (disturbed, p_value) = shared(&Bench::new(station).found());
    assert!(disturbed > 1.5 && p_value < 1e-6, "{disturbed}, {p_value}");
}

#[test]
fn an_input_that_is_late_is_found_by_its_changes() {
    let late = |unit, run, row: usize| 0.8 * (x(unit, run, (row + 1).min(ROWS - 1)) - x(unit, run, row));
    let found = Bench::new(late).found();
    let least = found.terms.iter().min_by(|a, b| a.p_value.total_cmp(&b.p_value)).expect("terms");
    assert!(matches!(least.kind, TermKind::Change(_)) && least.p_value < 1e-9, "{least:?}");
    assert_eq!(least.degrees_of_freedom[0], 2);
}

#[test]
fn a_fit_with_levels_is_checked_as_a_whole() {
    let bench = Bench::new(|unit, run, at| if (unit, run, at) == (3, 2, 5) { 4.0 } else { 0.0 });
    let record = bench.ensemble.fit().expect("a fit").record;
    assert!(record.tests.iter().all(|test| test.innovations.is_some()), "{:?}", record.notes);
    let misfit = record.misfit.as_ref().expect("misfit");
    assert_eq!(
        (misfit.tests, misfit.innovations, misfit.unlike.len()),
        (UNITS * RUNS, record.data.observations, UNITS * RUNS)
    );
    assert_eq!(misfit.wrong_rows.first().map(|row| row.test.as_str()), Some("u3/2"));
    let check = record.model_check.expect("a check");
    assert!(check.findings.iter().any(|finding| finding.kind == "row"), "{check:?}");
}
