//! Means with few tests, from data to record, against formulas with matrices of all measurements and published figures.

use kalfit::build::{Columns, constant, free, measurement, name, variance};
use kalfit::estimate::{Criterion, Silent};
use kalfit::infer::{Choices, DfChoice, MeanTest};
use kalfit::model::{Model, PhasedModel};
use kalfit::{Ensemble, Fit, Options};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};

/// Rows (test, x, z).
type Row = (usize, f64, f64);

fn columns(rows: &[Row], tests: usize) -> Vec<Columns> {
    let one = |j: usize| {
        let own = || rows.iter().filter(move |row| row.0 == j);
        let high = own().map(|row| f64::from(u8::from(row.1 > 2.0)));
        Columns::new(format!("t{j:02}"))
            .numbers("x", own().map(|row| row.1))
            .numbers("high", high)
            .numbers("z", own().map(|row| row.2))
    };
    (0..tests).map(one).collect()
}

fn fitted(model: &PhasedModel, data: &[Columns], df: DfChoice) -> Fit {
    let ensemble = Ensemble::new(model, data).expect("columns of the model");
    let choices = Choices { df, ..Choices::default() };
    let mut options = Options { choices, innovations: false, ..Options::default() };
    options.settings.criterion = Criterion::Reml;
    let fit = ensemble.fit_with(&options, &mut Silent).expect("a fit");
    assert!(fit.converged(), "{}", fit.record.reason);
    fit
}

/// Some uneven numbers.
fn wave(j: usize, k: usize) -> f64 {
    (3.7 * j as f64 + 1.3 * k as f64 + 0.4 * (j * k) as f64).sin()
}

fn uneven(tests: usize, z: &dyn Fn(usize, f64) -> f64) -> Vec<Row> {
    let of = |j: usize| (0..3 + 2 * (j % 4)).map(move |k| (j, k as f64 * (1.0 + 0.1 * (j % 3) as f64)));
    let row = |(n, (j, x)): (usize, (usize, f64))| (j, x, z(j, x) + 0.5 * wave(j + 11, n));
    (0..tests).flat_map(of).enumerate().map(row).collect()
}

/// log-likelihood pieces with V, X and z of all measurements.
struct Dense {
    x: DMatrix<f64>,
    z: DVector<f64>,
}

impl Dense {
    fn c(&self, v: &DMatrix<f64>) -> DMatrix<f64> {
        let w = v.clone().try_inverse().expect("noise is positive");
        (self.x.transpose() * w * &self.x).try_inverse().expect("identified")
    }

    /// -2ℓ_R without constants.
    fn deviance(&self, v: &DMatrix<f64>) -> f64 {
        let w = v.clone().try_inverse().expect("noise is positive");
        let r = &self.z - &self.x * self.beta(v);
        v.determinant().ln() - self.c(v).determinant().ln() + r.dot(&(w * &r))
    }

    fn beta(&self, v: &DMatrix<f64>) -> DVector<f64> {
        let w = v.clone().try_inverse().expect("noise is positive");
        self.c(v) * self.x.transpose() * w * &self.z
    }
}

fn test_of(fit: &Fit, i: usize) -> MeanTest {
    let found = fit.inference.few_tests.as_ref().expect("asked for").as_ref().expect("possible");
    found.mean[i].expect("a test")
}

/// sleepstudy of lme4 with rows left out: 9 subjects with 1 to 10 rows.
#[rustfmt::skip]
const SLEEP: [Row; 48] = [
    (0, 0.0, 249.56), (0, 1.0, 258.7047), (0, 2.0, 250.8006), (0, 3.0, 321.4398), (0, 4.0, 356.8519), (0, 5.0,
    414.6901), (0, 6.0, 382.2038), (0, 7.0, 290.1486), (0, 8.0, 430.5853), (0, 9.0, 466.3535), (1, 0.0,
    222.7339), (1, 1.0, 205.2658), (1, 2.0, 202.9778), (2, 0.0, 199.0539), (2, 1.0, 194.3322), (3, 0.0,
    321.5426), (3, 1.0, 300.4002), (3, 2.0, 283.8565), (3, 3.0, 285.133), (3, 4.0, 285.7973), (3, 5.0,
    297.5855), (4, 0.0, 287.6079), (4, 1.0, 285.0), (4, 2.0, 301.8206), (4, 3.0, 320.1153), (4, 4.0, 316.2773),
    (4, 5.0, 293.3187), (4, 6.0, 290.075), (4, 7.0, 334.8177), (4, 8.0, 293.7469), (4, 9.0, 371.5811), (5, 0.0,
    234.8606), (6, 0.0, 283.8424), (6, 1.0, 289.555), (6, 2.0, 276.7693), (6, 3.0, 299.8097), (7, 0.0,
    265.4731), (7, 1.0, 276.2012), (8, 0.0, 241.6083), (8, 1.0, 273.9472), (8, 2.0, 254.4907), (8, 3.0,
    270.8021), (8, 4.0, 251.4519), (8, 5.0, 254.6362), (8, 6.0, 245.4523), (8, 7.0, 235.311), (8, 8.0,
    235.7541), (8, 9.0, 237.2466),
];

fn line() -> PhasedModel {
    let equation = name("a") + name("b") * name("x");
    let model = Model::builder("").state(constant("a")).state(constant("b"));
    model.measurement(measurement("z", equation, "s")).parameter(free("s")).build().expect("a model")
}

#[test]
fn means_of_sleepstudy_are_those_of_pbkrtest_and_lmertest() {
    let fit = fitted(&line(), &columns(&SLEEP, 9), DfChoice::Auto);
    near::relative("ℓ_R", fit.log_likelihood(), -233.03054658216385, 1e-9);
    let expected =
        [(254.628695, 7.809783, 12.625916, 12.475575, 7.097931), (5.608265, 4.355194, 5.312451, 4.718873, 5.687454)];
    for (i, (estimate, df, error, plain, face)) in expected.into_iter().enumerate() {
        let found = test_of(&fit, i);
        near::relative("estimate", fit.estimate.mean[i], estimate, 1e-6);
        near::relative("df", found.df.expect("some"), df, 2e-6);
        near::relative("standard error", found.std_error, error, 1e-6);
        near::relative("plain standard error", found.std_error_plain, plain, 1e-6);
        near::relative("df on the face", found.df_face.expect("some"), face, 1e-5);
        assert_eq!(fit.record.phases[0].mean.std_error[i], Some(found.std_error));
        assert_eq!(fit.record.phases[0].mean.interval95[i], Some(found.interval.map(Some)));
    }
    assert_eq!(fit.record.df_method.as_deref(), Some("kenward-roger"));
    near::relative("p", test_of(&fit, 1).p_value, 0.3461186343727284, 1e-5);
    let other = fitted(&line(), &columns(&SLEEP, 9), DfChoice::Satterthwaite);
    near::relative("standard error", test_of(&other, 0).std_error, 12.475575, 1e-6);
    near::relative("df", test_of(&other, 0).df.expect("some"), 7.809783, 2e-6);
    let none = fitted(&line(), &columns(&SLEEP, 9), DfChoice::None);
    assert!(none.inference.few_tests.is_none() && none.record.df_method.is_none());
}

#[test]
fn units_order_and_origin_change_nothing() {
    let rows = uneven(9, &|j, x| 2.0 + wave(j, 1) + (0.7 + 0.6 * wave(j, 2)) * x);
    let home = fitted(&line(), &columns(&rows, 9), DfChoice::Auto);
    let scaled: Vec<Row> = rows.iter().map(|(j, x, z)| (*j, x * 1e-4, 1e3 * z + 5e4)).collect();
    let reversed: Vec<Row> = rows.iter().map(|(j, x, z)| (8 - j, *x, *z)).collect();
    let mut turned = columns(&rows, 9);
    turned.reverse();
    let scaled = fitted(&line(), &columns(&scaled, 9), DfChoice::Auto);
    let (reversed, turned) =
        (fitted(&line(), &columns(&reversed, 9), DfChoice::Auto), fitted(&line(), &turned, DfChoice::Auto));
    for i in 0..2 {
        let own = test_of(&home, i);
        let unit = [1e3, 1e7][i];
        for (other, unit) in [(&scaled, unit), (&reversed, 1.0), (&turned, 1.0)] {
            let other = test_of(other, i);
            near::relative("df", other.df.expect("some"), own.df.expect("some"), 1e-6);
            near::relative("standard error", other.std_error, own.std_error * unit, 1e-6);
        }
        assert_eq!(test_of(&turned, i), own, "same bits in any order");
    }
}

#[test]
fn two_free_variances_of_noise_are_those_of_the_joint_gaussian() {
    let equation = name("a") + name("b") * name("x");
    let noise = variance(name("s") * name("s") + name("high") * name("q"));
    let model =
        Model::builder("").state(constant("a")).state(constant("b")).measurement(measurement("z", equation, noise));
    let model = model.parameter(free("s")).parameter(free("q")).build().expect("a model");
    let bend = |j: usize, x: f64| if x > 2.0 { 2.5 * wave(j, (10.0 * x) as usize) } else { 0.0 };
    let rows = uneven(10, &|j, x| 2.0 + 2.0 * wave(j, 1) + (0.7 + 0.9 * wave(j, 2)) * x + bend(j, x));
    let fit = fitted(&model, &columns(&rows, 10), DfChoice::Auto);
    let n = rows.len();
    let regressor = |i: usize, k: usize| if k == 0 { 1.0 } else { rows[i].1 };
    let dense = Dense { x: DMatrix::from_fn(n, 2, regressor), z: DVector::from_fn(n, |i, _| rows[i].2) };
    let block = |s: [[f64; 2]; 2]| {
        DMatrix::from_fn(n, n, |i, j| {
            let of = |k: usize, l: usize| regressor(i, k) * s[k][l] * regressor(j, l);
            if rows[i].0 == rows[j].0 { of(0, 0) + of(0, 1) + of(1, 0) + of(1, 1) } else { 0.0 }
        })
    };
    let high = DMatrix::from_fn(n, n, |i, j| f64::from(u8::from(i == j && rows[i].1 > 2.0)));
    let slopes = [
        block([[1.0, 0.0], [0.0, 0.0]]),
        block([[0.0, 1.0], [1.0, 0.0]]),
        block([[0.0, 0.0], [0.0, 1.0]]),
        DMatrix::identity(n, n),
        high,
    ];
    let (sigma, s, q) =
        (&fit.estimate.covariance, fit.parameter("s").expect("s").estimate, fit.parameter("q").expect("q").estimate);
    assert!(q > 0.1 && sigma.determinant() > 1e-3, "inside: {q} {sigma}");
    let theta = [sigma[(0, 0)], sigma[(1, 0)], sigma[(1, 1)], s * s, q];
    let v = slopes.iter().zip(theta).fold(DMatrix::zeros(n, n), |sum, (slope, x)| sum + slope * x);
    let (w, c) = (v.clone().try_inverse().expect("positive"), dense.c(&v));
    let half = &w * &dense.x;
    let projected = &w - &half * &c * half.transpose();
    let turned: Vec<DMatrix<f64>> = slopes.iter().map(|slope| &projected * slope).collect();
    let information = DMatrix::from_fn(5, 5, |a, b| 0.5 * turned[a].dot(&turned[b].transpose()));
    let law = information.try_inverse().expect("identified");
    let m: Vec<DMatrix<f64>> = slopes.iter().map(|slope| -(half.transpose() * slope * &half)).collect();
    let mut added = DMatrix::zeros(2, 2);
    for (a, b) in (0..5).flat_map(|a| (0..5).map(move |b| (a, b))) {
        let square = half.transpose() * &slopes[a] * &w * &slopes[b] * &half;
        added += (square - &m[a] * &c * &m[b]) * law[(a, b)];
    }
    let adjusted = &c + &c * added * &c * 2.0;
    assert_eq!(fit.record.df_method.as_deref(), Some("kenward-roger"));
    for i in 0..2 {
        let g = DVector::from_fn(5, |a, _| -(&c * &m[a] * &c)[(i, i)]);
        let found = test_of(&fit, i);
        near::relative("standard error", found.std_error, adjusted[(i, i)].sqrt(), 1e-6);
        near::relative("df", found.df.expect("some"), 2.0 * c[(i, i)].powi(2) / g.dot(&(&law * &g)), 1e-6);
    }
}

#[test]
fn a_parameter_that_moves_the_mean_has_satterthwaites_degrees_of_freedom() {
    // z = a (1 + k x) + noise: k moves what is measured of a
    let model = Model::builder("").state(constant("a"));
    let equation = name("a") * (name("k") * name("x") + 1.0);
    let model = model.measurement(measurement("z", equation, "s")).parameter(free("s")).parameter(free("k"));
    let model = model.build().expect("a model");
    let rows = uneven(8, &|j, x| (3.0 + 1.2 * wave(j, 1)) * (1.0 + 0.4 * x));
    let fit = fitted(&model, &columns(&rows, 8), DfChoice::Auto);
    let n = rows.len();
    let value = |what: &str| fit.parameter(what).expect("a parameter").estimate;
    let theta = [fit.estimate.covariance[(0, 0)], value("s").ln(), value("k").ln()];
    let at = |theta: &[f64]| {
        let k = theta[2].exp();
        let h = DVector::from_fn(n, |i, _| 1.0 + k * rows[i].1);
        let same = |i: usize, j: usize| rows[i].0 == rows[j].0;
        let v = DMatrix::from_fn(n, n, |i, j| {
            let spread = if same(i, j) { theta[0] * h[i] * h[j] } else { 0.0 };
            if i == j { spread + (2.0 * theta[1]).exp() } else { spread }
        });
        (Dense { x: DMatrix::from_column_slice(n, 1, h.as_slice()), z: DVector::from_fn(n, |i, _| rows[i].2) }, v)
    };
    let moved = |steps: [f64; 3]| -> Vec<f64> { theta.iter().zip(steps).map(|(x, step)| x + step).collect() };
    let sizes = [3e-3 * theta[0], 3e-3, 3e-3];
    let unit = |a: usize, sign: f64| std::array::from_fn::<f64, 3, _>(|b| if a == b { sign * sizes[b] } else { 0.0 });
    let deviance = |steps: [f64; 3]| {
        let (dense, v) = at(&moved(steps));
        dense.deviance(&v)
    };
    let hessian = DMatrix::from_fn(3, 3, |a, b| {
        let sum = |x: f64, y: f64| {
            let (one, other) = (unit(a, x), unit(b, y));
            deviance(std::array::from_fn(|k| one[k] + other[k]))
        };
        (sum(1.0, 1.0) - sum(1.0, -1.0) - sum(-1.0, 1.0) + sum(-1.0, -1.0)) / (4.0 * sizes[a] * sizes[b])
    });
    let law = (hessian * 0.5).try_inverse().expect("identified");
    let slope = |of: &dyn Fn(&Dense, &DMatrix<f64>) -> f64| {
        DVector::from_fn(3, |a, _| {
            let side = |sign: f64| {
                let (dense, v) = at(&moved(unit(a, sign)));
                of(&dense, &v)
            };
            (side(1.0) - side(-1.0)) / (2.0 * sizes[a])
        })
    };
    let (dense, v) = at(&theta);
    let c = dense.c(&v)[(0, 0)];
    let (g, moves) = (slope(&|dense, v| dense.c(v)[(0, 0)]), slope(&|dense, v| dense.beta(v)[0]));
    let found = test_of(&fit, 0);
    assert_eq!(fit.record.df_method.as_deref(), Some("satterthwaite"));
    near::relative("df", found.df.expect("some"), 2.0 * c * c / g.dot(&(&law * &g)), 1e-3);
    near::relative("standard error", found.std_error, (c + moves.dot(&(&law * &moves))).sqrt(), 1e-3);
}
