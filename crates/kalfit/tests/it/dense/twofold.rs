//! The same oracle in twice the precision (pairs of doubles, 32 digits): for tests so ill-conditioned that the joint
//! covariance in plain doubles would be the one that is wrong.

use std::ops::{Add, Div, Mul, Neg, Sub};

use kalfit::reduce::Plain;
use nalgebra::{DMatrix, DVector};

/// An unevaluated sum high + low.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Twofold {
    high: f64,
    low: f64,
}

fn pair(a: f64, b: f64) -> Twofold {
    let high = a + b;
    let part = high - a;
    Twofold { high, low: (a - (high - part)) + (b - part) }
}

impl From<f64> for Twofold {
    fn from(high: f64) -> Twofold {
        Twofold { high, low: 0.0 }
    }
}

impl Add for Twofold {
    type Output = Twofold;
    fn add(self, other: Twofold) -> Twofold {
        let (sum, rest) = (pair(self.high, other.high), pair(self.low, other.low));
        let sum = pair(sum.high, sum.low + rest.high);
        pair(sum.high, sum.low + rest.low)
    }
}

impl Neg for Twofold {
    type Output = Twofold;
    fn neg(self) -> Twofold {
        Twofold { high: -self.high, low: -self.low }
    }
}

impl Sub for Twofold {
    type Output = Twofold;
    fn sub(self, other: Twofold) -> Twofold {
        self + -other
    }
}

impl Mul for Twofold {
    type Output = Twofold;
    fn mul(self, other: Twofold) -> Twofold {
        let high = self.high * other.high;
        let low = self.high.mul_add(other.high, -high) + (self.high * other.low + self.low * other.high);
        pair(high, low)
    }
}

impl Div for Twofold {
    type Output = Twofold;
    fn div(self, other: Twofold) -> Twofold {
        let first = Twofold::from(self.high / other.high);
        let rest = self - first * other;
        let second = Twofold::from(rest.high / other.high);
        let rest = rest - second * other;
        first + second + Twofold::from(rest.high / other.high)
    }
}

impl Twofold {
    fn sqrt(self) -> Twofold {
        let first = Twofold::from(self.high.sqrt());
        first + (self - first * first) / (first + first)
    }

    fn ln(self) -> f64 {
        self.high.ln() + self.low / self.high
    }
}

type Matrix = Vec<Vec<Twofold>>;

fn lift(a: &DMatrix<f64>) -> Matrix {
    (0..a.nrows()).map(|i| (0..a.ncols()).map(|j| a[(i, j)].into()).collect()).collect()
}

fn zeros(rows: usize, columns: usize) -> Matrix {
    vec![vec![0.0.into(); columns]; rows]
}

fn times(a: &Matrix, b: &Matrix, columns: usize) -> Matrix {
    let dot = |row: &Vec<Twofold>, j: usize| row.iter().zip(b).fold(Twofold::from(0.0), |sum, (x, y)| sum + *x * y[j]);
    a.iter().map(|row| (0..columns).map(|j| dot(row, j)).collect()).collect()
}

fn transposed(a: &Matrix, columns: usize) -> Matrix {
    (0..columns).map(|j| a.iter().map(|row| row[j]).collect()).collect()
}

fn plus(a: &Matrix, b: &Matrix) -> Matrix {
    a.iter().zip(b).map(|(a, b)| a.iter().zip(b).map(|(x, y)| *x + *y).collect()).collect()
}

/// log p(z | ξ) of a test, and the least pivot of its scaled covariance; `None` when that covariance is singular.
pub(crate) fn log_likelihood(test: &Plain, xi: &DVector<f64>) -> Option<(f64, f64)> {
    let n = test.offset.len();
    let start = plus(&lift(&column(&test.offset)), &times(&lift(&test.sensitivity), &lift(&column(xi)), 1));
    let (mut mean, mut own) = (start, lift(&test.covariance));
    let mut cross: Vec<Matrix> = Vec::new(); // n x 1 each
    let (mut residual, mut omega): (Vec<Twofold>, Matrix) = (Vec::new(), Vec::new());
    for step in &test.steps {
        if let Some(phi) = &step.transition {
            let phi = lift(phi);
            mean = times(&phi, &mean, 1);
            own = times(&times(&phi, &own, n), &transposed(&phi, n), n);
            cross = cross.iter().map(|c| times(&phi, c, 1)).collect();
        }
        if let Some(input) = &step.input {
            mean = plus(&mean, &lift(&column(input)));
        }
        if let Some(q) = &step.process_noise {
            own = plus(&own, &lift(q));
        }
        let measured: Vec<usize> = (0..step.values.len()).filter(|&i| !step.values[i].is_nan()).collect();
        let first = residual.len();
        for (k, &i) in measured.iter().enumerate() {
            let h = lift(&step.measurement.rows(i, 1).into_owned());
            let predicted = times(&h, &mean, 1)[0][0] + step.constant[i].into();
            residual.push(Twofold::from(step.values[i]) - predicted);
            let mut row: Vec<Twofold> = cross[..first].iter().map(|c| times(&h, c, 1)[0][0]).collect();
            let spread = times(&own, &transposed(&h, n), 1);
            for &j in &measured[..=k] {
                let other = lift(&step.measurement.rows(j, 1).into_owned());
                row.push(times(&other, &spread, 1)[0][0] + step.noise[(i, j)].into());
            }
            cross.push(spread);
            omega.push(row);
        }
    }
    density(&residual, &omega)
}

fn column(v: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(v.len(), 1, v.as_slice())
}

/// log N(r; 0, Ω), Ω by lower-triangular rows.
fn density(r: &[Twofold], omega: &Matrix) -> Option<(f64, f64)> {
    let m = r.len();
    let mut l = zeros(m, m);
    let mut white: Vec<Twofold> = Vec::new();
    let (mut sum, mut log_determinant, mut least) = (Twofold::from(0.0), 0.0, f64::INFINITY);
    for i in 0..m {
        for j in 0..=i {
            let inner = (0..j).fold(omega[i][j], |left, k| left - l[i][k] * l[j][k]);
            if i > j {
                l[i][j] = inner / l[j][j];
                continue;
            }
            let pivot = inner.high / omega[i][i].high;
            if pivot.is_nan() || pivot < 1e-27 {
                return None;
            }
            least = least.min(pivot);
            l[i][i] = inner.sqrt();
            log_determinant += inner.ln();
        }
        let left = (0..i).fold(r[i], |left, k| left - l[i][k] * white[k]) / l[i][i];
        white.push(left);
        sum = sum + left * left;
    }
    Some((-0.5 * (m as f64 * std::f64::consts::TAU.ln() + log_determinant + sum.high), least))
}
