//! A model of three phases, of different dimension, and the joint Gaussian of a test's measurements, written down by hand.

use kalfit::model::{
    Carry, Clock, Column, CovarianceStructure, Initial, Linear, MeanStructure, Measurement, Motion, Operator, Phase,
    PhasedModel, Regression, State,
};
use kalfit::reduce::{Evidence, PhasedTest};
use kalfit::{Expression, Label, Model, Population, Source, Test};
use nalgebra::{DMatrix, DVector, SymmetricEigen};

pub(crate) const EMPTY: f64 = f64::NAN;

/// z1, z2, u, k, w of a row.
pub(crate) type Row = [f64; 5];

/// Rows of the three phases of a test.
pub(crate) fn rows() -> [Vec<Row>; 3] {
    [
        vec![[9.0, 9.0, 0.5, EMPTY, 1.5], [9.0, EMPTY, -1.0, EMPTY, 1.5], [EMPTY, 9.0, 0.2, EMPTY, 1.5]],
        vec![
            [9.0, 9.0, 0.3, 0.6, EMPTY],
            [EMPTY, EMPTY, 0.1, 0.6, EMPTY],
            [9.0, 9.0, -0.7, 0.6, EMPTY],
            [EMPTY, 9.0, 0.4, 0.6, EMPTY],
        ],
        vec![[9.0, EMPTY, EMPTY, EMPTY, EMPTY], [9.0, EMPTY, EMPTY, EMPTY, EMPTY]],
    ]
}

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

fn linear(terms: &[(usize, f64)], constant: Expression) -> Linear {
    Linear { terms: terms.iter().map(|&(state, x)| (state, number(x))).collect(), constant }
}

fn scaled(factor: f64, column: usize) -> Expression {
    Expression::Binary(Operator::Multiply, Box::new(number(factor)), Box::new(Expression::Column(column)))
}

fn state(name: &str, motion: Motion, initial: Initial) -> State {
    State { name: name.to_owned(), unit: None, motion, initial, offset: None, random: true }
}

fn moving(terms: &[(usize, f64)], constant: Expression, variance: f64) -> Motion {
    Motion::Discrete { next: linear(terms, constant), noise_variance: number(variance) }
}

fn known(mean: f64, variance: f64) -> Initial {
    Initial::Known { mean: number(mean), variance: number(variance) }
}

fn meter(name: &str, column: usize, equation: Linear, noise: f64) -> Measurement {
    Measurement { name: name.to_owned(), column, filter: None, equation, noise_variance: number(noise) }
}

fn phase(name: &str, states: Vec<State>, measurements: Vec<Measurement>, carry: Vec<Carry>) -> Phase {
    let estimated: Vec<usize> = (0..states.len()).filter(|&i| states[i].initial == Initial::Estimated).collect();
    let column = |name: &&str| Column { name: (*name).to_owned(), used_in: String::new() };
    let names = ["one", "two", "three"];
    let model = Model {
        title: String::new(),
        columns: ["z1", "z2", "u", "k", "w"].iter().map(column).collect(),
        text_columns: vec![column(&"phase")],
        literals: names.map(str::to_owned).to_vec(),
        parameters: Vec::new(),
        states,
        process_noise_covariance: Vec::new(),
        measurements,
        noise_covariance: Vec::new(),
        clock: Clock::default(),
        group: None,
        mean: MeanStructure::free(estimated.len()),
        covariance: CovarianceStructure::full(),
        estimated,
    };
    let label = names.iter().position(|other| *other == name);
    Phase { name: name.to_owned(), label, model, carry, filter: None }
}

/// Phase one: a' = 0.9a + 0.2b + 0.5u + noise, b and s constant, s ~ N(0.4, 0.3) not estimated; the mean of b moves with w.
/// Phase two: c' = 0.8c + 0.3d + noise, before the first row too, d and e constant; c starts at N(0.2, 0.1) + 1.1a - 0.4s + 0.7, d at
/// its own part + k b, e afresh; noises of its measurements are correlated.
/// Phase three: f at its own part + d + 0.5e, g' = 0.7g at c.
pub(crate) fn model() -> PhasedModel {
    let one = || number(1.0);
    let mut first = phase(
        "one",
        vec![
            state("a", moving(&[(0, 0.9), (1, 0.2)], scaled(0.5, 2), 0.05), Initial::Estimated),
            state("b", Motion::Constant, Initial::Estimated),
            state("s", Motion::Constant, known(0.4, 0.3)),
        ],
        vec![
            meter("m1", 0, linear(&[(0, 1.0), (2, 0.3)], number(0.1)), 0.04),
            meter("m2", 1, Linear { terms: vec![(0, Expression::Column(2)), (1, one())], constant: number(0.0) }, 0.09),
        ],
        Vec::new(),
    );
    first.model.mean.regression.push(Regression { element: 1, column: 4 });
    let mut second = phase(
        "two",
        vec![
            state("c", moving(&[(0, 0.8), (1, 0.3)], number(0.0), 0.02), known(0.2, 0.1)),
            state("d", Motion::Constant, Initial::Estimated),
            state("e", Motion::Constant, Initial::Estimated),
        ],
        vec![
            meter("m1", 0, linear(&[(0, 1.0), (2, 1.0)], number(0.0)), 0.04),
            meter("m2", 1, linear(&[(1, 1.0)], scaled(-1.0, 2)), 0.25),
        ],
        vec![
            Carry { state: 0, from: linear(&[(0, 1.1), (2, -0.4)], number(0.7)) },
            Carry { state: 1, from: Linear { terms: vec![(1, Expression::Column(3))], constant: number(0.0) } },
        ],
    );
    second.model.clock.step_first = true;
    second.model.noise_covariance.push((0, 1, number(0.03)));
    let third = phase(
        "three",
        vec![
            state("f", Motion::Constant, Initial::Estimated),
            state("g", moving(&[(1, 0.7)], number(0.0), 0.0), known(0.0, 0.0)),
        ],
        vec![meter("m", 0, linear(&[(0, 1.0), (1, 1.0)], number(0.0)), 0.01)],
        vec![
            Carry { state: 0, from: linear(&[(1, 1.0), (2, 0.5)], number(0.0)) },
            Carry { state: 1, from: linear(&[(0, 1.0)], number(0.0)) },
        ],
    );
    PhasedModel { phases: vec![first, second, third], column: Some(0), levels: Vec::new() }
}

/// The test with these rows, phases missing from the first empty one on.
pub(crate) fn test(id: &str, rows: &[Vec<Row>; 3]) -> PhasedTest {
    let of = |(phase, rows): (usize, &Vec<Row>)| {
        let mut test = Test::new(id, 5, 1);
        rows.iter().for_each(|row| test.push(row, &[Label::literal(phase)], Source::default()));
        Evidence::Rows(test)
    };
    let phases = rows.iter().take_while(|rows| !rows.is_empty()).enumerate().map(of).collect();
    PhasedTest { id: id.into(), phases }
}

/// A population of (a, b), (d, e), f with roots of Σ of these phases.
pub(crate) fn population(roots: [DMatrix<f64>; 3]) -> Population {
    let mut covariance = DMatrix::zeros(5, 5);
    for (at, root) in [0, 2, 4].into_iter().zip(roots) {
        covariance.view_mut((at, at), (root.nrows(), root.nrows())).copy_from(&(&root * root.transpose()));
    }
    Population { mean: vec![1.0, -0.5, 0.3, 2.0, 0.8], coefficients: vec![0.6], covariance }
}

/// Measured values in the order of phases, rows and columns.
pub(crate) fn values(test: &PhasedTest) -> DVector<f64> {
    let mut values = Vec::new();
    for evidence in &test.phases {
        let Evidence::Rows(rows) = evidence else { continue };
        let cells = (0..rows.rows()).flat_map(|row| [rows.numbers(row)[0], rows.numbers(row)[1]]);
        values.extend(cells.filter(|z| !z.is_nan()));
    }
    DVector::from_vec(values)
}

/// Jointly normal quantities: means, and what multiplies each of a row of independent N(0, 1).
struct Normal {
    mean: DVector<f64>,
    root: DMatrix<f64>,
}

impl Normal {
    /// More independent N(0, 1): columns that nothing depends on yet.
    fn widen(&mut self, more: usize) {
        let columns = self.root.ncols();
        self.root = self.root.clone().resize_horizontally(columns + more, 0.0);
    }

    /// x ← Fx + b + root × fresh N(0, 1).
    fn step(&mut self, f: &DMatrix<f64>, b: &DVector<f64>, root: &DMatrix<f64>) {
        (self.mean, self.root) = (f * &self.mean + b, f * &self.root);
        self.widen(root.ncols());
        let first = self.root.ncols() - root.ncols();
        self.root.columns_mut(first, root.ncols()).copy_from(root);
    }
}

fn square_root(a: &DMatrix<f64>) -> DMatrix<f64> {
    let eigen = SymmetricEigen::new(a.clone());
    eigen.eigenvectors * DMatrix::from_diagonal(&eigen.eigenvalues.map(|x| x.max(0.0).sqrt()))
}

fn diagonal(x: &[f64]) -> DMatrix<f64> {
    DMatrix::from_diagonal(&DVector::from_row_slice(x))
}

/// Mean and covariance of [`values`] of a test with these rows.
pub(crate) fn law(rows: &[Vec<Row>; 3], population: &Population) -> (DVector<f64>, DMatrix<f64>) {
    let (mean, root) = law_root(rows, population);
    (mean, &root * root.transpose())
}

/// The same with a root of the covariance, as the values come about.
pub(crate) fn law_root(rows: &[Vec<Row>; 3], population: &Population) -> (DVector<f64>, DMatrix<f64>) {
    let (mu, sigma) = (&population.mean, &population.covariance);
    let part = |at: usize, p: usize| square_root(&sigma.view((at, at), (p, p)).into_owned());
    let mut z: Vec<(f64, DVector<f64>)> = Vec::new();
    let mut x = Normal { mean: DVector::zeros(0), root: DMatrix::zeros(0, 0) };
    for (phase, rows) in rows.iter().enumerate().take_while(|(_, rows)| !rows.is_empty()) {
        let k = rows[0][3];
        let (carry, b, mut own, p0) = match phase {
            0 => {
                let b = vec![mu[0], mu[1] + population.coefficients[0] * rows[0][4], 0.4];
                (DMatrix::zeros(3, 0), b, part(0, 2).resize(3, 2, 0.0), diagonal(&[0.0, 0.0, 0.3f64.sqrt()]))
            }
            1 => {
                let carry = DMatrix::from_row_slice(3, 3, &[1.1, 0.0, -0.4, 0.0, k, 0.0, 0.0, 0.0, 0.0]);
                let own = part(2, 2).insert_rows(0, 1, 0.0);
                (carry, vec![0.2 + 0.7, mu[2], mu[3]], own, diagonal(&[0.1f64.sqrt(), 0.0, 0.0]))
            }
            _ => {
                let carry = DMatrix::from_row_slice(2, 3, &[0.0, 1.0, 0.5, 1.0, 0.0, 0.0]);
                (carry, vec![mu[4], 0.0], part(4, 1).resize(2, 1, 0.0), DMatrix::zeros(2, 0))
            }
        };
        let first = own.ncols();
        own = own.resize_horizontally(first + p0.ncols(), 0.0);
        own.columns_mut(first, p0.ncols()).copy_from(&p0);
        x.step(&carry, &DVector::from_vec(b), &own);
        for (step, &[z1, z2, u, ..]) in rows.iter().enumerate() {
            match phase {
                0 if step > 0 => {
                    let f = DMatrix::from_row_slice(3, 3, &[0.9, 0.2, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
                    let noise = DMatrix::from_column_slice(3, 1, &[0.05f64.sqrt(), 0.0, 0.0]);
                    x.step(&f, &DVector::from_vec(vec![0.5 * u, 0.0, 0.0]), &noise);
                }
                1 => {
                    let f = DMatrix::from_row_slice(3, 3, &[0.8, 0.3, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
                    let noise = DMatrix::from_column_slice(3, 1, &[0.02f64.sqrt(), 0.0, 0.0]);
                    x.step(&f, &DVector::zeros(3), &noise);
                }
                2 if step > 0 => x.step(&diagonal(&[1.0, 0.7]), &DVector::zeros(2), &DMatrix::zeros(2, 0)),
                _ => {}
            }
            let (h, d, r) = match phase {
                0 => (vec![1.0, 0.0, 0.3, u, 1.0, 0.0], [0.1, 0.0], [0.04, 0.0, 0.09]),
                1 => (vec![1.0, 0.0, 1.0, 0.0, 1.0, 0.0], [0.0, -u], [0.04, 0.03, 0.25]),
                _ => (vec![1.0, 1.0, 0.0, 0.0], [0.0, 0.0], [0.01, 0.0, 1.0]),
            };
            let h = DMatrix::from_row_slice(2, x.mean.len(), &h);
            let noise = square_root(&DMatrix::from_row_slice(2, 2, &[r[0], r[1], r[1], r[2]]));
            x.widen(2);
            let mut root = &h * &x.root;
            let last = root.ncols() - 2;
            root.columns_mut(last, 2).copy_from(&noise);
            for (i, _) in [z1, z2].iter().enumerate().filter(|(_, z)| !z.is_nan()) {
                z.push(((&h * &x.mean)[i] + d[i], root.row(i).transpose()));
            }
        }
    }
    let columns = x.root.ncols();
    let root = DMatrix::from_fn(z.len(), columns, |i, c| z[i].1.get(c).copied().unwrap_or(0.0));
    (DVector::from_fn(z.len(), |i, _| z[i].0), root)
}

/// Roots of Σ: full, of rank one, zero, and huge.
pub(crate) fn roots(seed: usize) -> [DMatrix<f64>; 3] {
    let wave = |k: f64| (12.9898 * (seed as f64 + 1.0) + 78.233 * k).sin();
    let root =
        |p: usize, columns: usize, at: f64| DMatrix::from_fn(p, columns, |i, c| wave(at + i as f64 + 10.0 * c as f64));
    match seed % 4 {
        0 => [root(2, 2, 0.0), root(2, 2, 30.0), root(1, 1, 60.0)],
        1 => [root(2, 1, 0.0), root(2, 2, 30.0), DMatrix::zeros(1, 1)],
        2 => [DMatrix::zeros(2, 2), root(2, 1, 30.0), root(1, 1, 60.0)],
        _ => [root(2, 2, 0.0) * 1e4, root(2, 2, 30.0) * 1e4, DMatrix::zeros(1, 1)],
    }
}
