//! Adjoints against differences of the likelihood, and every way through a record against the plain one.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::*;
use crate::estimate::InitialLaw;
use crate::reduce::{DENSE, Data, DataWork, Frame, GainsWork, Path, Pattern, Reduction, information_gains, outcome};
use crate::score::moments::moments;

/// A test by hand: four states, the first two noisy, three unknowns; every number of it is its own.
#[derive(Debug, Clone)]
struct Numbers {
    phi: Vec<Vec<f64>>,
    q: Vec<Vec<f64>>,
    h: Vec<f64>,
    noise: Vec<f64>,
    values: Vec<f64>,
    inputs: Vec<f64>,
    start: Vec<f64>,
    variance: Vec<f64>,
}

const STEPS: usize = 5;

fn design(numbers: &Numbers) -> (Design, Data) {
    let mut pattern = Pattern::default();
    pattern.push(0, 2, [0, 1, 3].into_iter());
    pattern.push(1, 2, [0, 1].into_iter());
    pattern.push(2, 2, [2, 3].into_iter());
    pattern.pairs = vec![(0, 0), (1, 0), (1, 1)];
    let pattern = Arc::new(pattern.seal());
    let mut sensitivity = vec![0.0; 12];
    sensitivity[0] = 1.0;
    sensitivity[2 * 3 + 1] = 1.0;
    sensitivity[3 * 3 + 2] = 1.0;
    let frame = Frame { n: 4, p: 3, r: 2, rows: vec![DENSE; 4], sensitivity, driven: vec![0, 2], digest: 0 };
    let mut design = Design::new(Arc::new(frame.seal()));
    design.variance.copy_from_slice(&numbers.variance);
    for k in 0..STEPS {
        let (phi, q) = (numbers.phi[k].clone(), numbers.q[k].clone());
        let transition = (k > 0).then(|| Arc::new(Transition::new(pattern.clone(), phi, q)));
        for row in 2 * k..2 * k + 2 {
            design.states.extend(if row % 2 == 0 { vec![0, 1, 2] } else { vec![0, 3] });
            design.ends.push(design.states.len());
        }
        design.push_step(transition);
    }
    design.h.clone_from(&numbers.h);
    design.noise.clone_from(&numbers.noise);
    let sizes = vec![1.0; numbers.values.len()];
    (
        design,
        Data {
            start: numbers.start.clone(),
            inputs: numbers.inputs[2..].to_vec(),
            values: numbers.values.clone(),
            sizes,
        },
    )
}

fn reduced(numbers: &Numbers) -> (Design, Data, Gains, Reduction) {
    let (design, data) = design(numbers);
    let gains = information_gains(&design, &mut GainsWork::default()).expect("well conditioned");
    let found = outcome(&design, &gains, &data, &mut DataWork::default()).expect("possible");
    let reduction = Reduction {
        test: String::new(),
        constant: found.constant,
        data: found.data,
        factor: gains.factor.clone(),
        covariates: Vec::new(),
        steps: STEPS,
        observations: 10,
        path: Path::Information,
        design: 0,
    };
    (design, data, gains, reduction)
}

fn prior() -> (DVector<f64>, DMatrix<f64>) {
    let root = DMatrix::from_row_slice(3, 2, &[0.8, 0.1, -0.3, 0.9, 0.4, 0.2]);
    (DVector::from_vec(vec![0.3, -0.2, 0.5]), root)
}

/// ℓ = log ∫ p(z | ξ) N(ξ; μ, FF') dξ, densely.
fn likelihood(numbers: &Numbers) -> f64 {
    let (_, _, _, reduction) = reduced(numbers);
    let (mean, root) = prior();
    let factor = crate::estimate::unpack(&reduction.factor, 3);
    let residual = DVector::from_vec(reduction.data) - &factor * mean;
    let rf = factor * root;
    let spread = DMatrix::identity(3, 3) + &rf * rf.transpose();
    let cholesky = spread.cholesky().expect("positive definite");
    reduction.constant - 0.5 * cholesky.determinant().ln() - 0.5 * residual.dot(&cholesky.solve(&residual))
}

#[derive(Default)]
struct Kept {
    noise: Vec<(usize, f64)>,
    value: Vec<(usize, f64)>,
    h: Vec<(usize, Vec<f64>)>,
    moved: Vec<(usize, MovedBar)>,
    mean: Vec<f64>,
    variance: Vec<f64>,
}

impl Sink for Kept {
    type Error = std::convert::Infallible;
    fn sums(&mut self, _: Range<usize>) -> bool {
        false
    }
    fn measured(&mut self, k: usize, bar: &MeasuredBar) -> Result<(), Self::Error> {
        for i in 0..2 {
            self.noise.push((2 * k + i, bar.noise[i]));
            self.value.push((2 * k + i, bar.value[i]));
            self.h.push((2 * k + i, bar.h[i * 4..][..4].to_vec()));
        }
        Ok(())
    }
    fn moved(&mut self, k: usize, bar: &MovedBar) -> Result<(), Self::Error> {
        self.moved.push((k, bar.clone()));
        Ok(())
    }
    fn started(&mut self, mean: &[f64], variance: &[f64]) -> Result<(), Self::Error> {
        (self.mean, self.variance) = (mean.to_vec(), variance.to_vec());
        Ok(())
    }
}

fn numbers() -> Numbers {
    let mut seed = 7u64;
    let mut next = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 40) as f64 / f64::from(1 << 24) - 0.5
    };
    let mut list = |n: usize| (0..n).map(|_| next()).collect::<Vec<f64>>();
    Numbers {
        phi: (0..STEPS).map(|_| list(7)).collect(),
        q: (0..STEPS).map(|_| list(3).iter().zip([1.0, 0.1, 1.0]).map(|(x, m)| m * (x + 0.8)).collect()).collect(),
        h: list(5 * STEPS),
        noise: list(2 * STEPS).iter().map(|x| x + 0.7).collect(),
        values: list(2 * STEPS),
        inputs: list(2 * STEPS),
        start: list(4),
        variance: vec![0.5, 0.0, 0.1, 0.4],
    }
}

#[test]
fn adjoints_equal_differences_of_the_likelihood() {
    let all = numbers();
    let (design, data, gains, reduction) = reduced(&all);
    let (mean, root) = prior();
    let moments = moments(&reduction, &InitialLaw::known(mean, root));
    let wanted = Wanted { motion: true, equation: true };
    let run = Run {
        design: &design,
        gains: &gains,
        start: &data.start,
        inputs: &data.inputs,
        values: &data.values,
        moments: &moments,
        wanted,
    };
    let mut kept = Kept::default();
    let Ok(()) = run.backward(&mut BackwardWork::default(), &mut kept);
    let check = |what: &str, found: f64, change: &dyn Fn(&mut Numbers, f64)| {
        let at = |x: f64| {
            let mut moved = all.clone();
            change(&mut moved, x);
            likelihood(&moved)
        };
        let h = 1e-4;
        let expected = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
        assert!((found - expected).abs() <= 2e-9 * (1.0 + expected.abs()), "{what}: {found} against {expected}");
    };
    for &(row, bar) in &kept.noise {
        check(&format!("R of {row}"), bar, &|n, x| n.noise[row] += x);
    }
    for &(row, bar) in &kept.value {
        check(&format!("z of {row}"), bar, &|n, x| n.values[row] += x);
    }
    for (row, bar) in &kept.h {
        let (states, _) = design.terms(*row);
        let first = design.ends[*row] - states.len();
        for (i, &state) in states.iter().enumerate() {
            check(&format!("h of {row} on {state}"), bar[state as usize], &|n, x| n.h[first + i] += x);
        }
    }
    for (k, bar) in &kept.moved {
        for (i, &phi) in bar.phi.iter().enumerate() {
            check(&format!("φ {i} of step {k}"), phi, &|n, x| n.phi[*k][i] += x);
        }
        for (i, &q) in bar.q.iter().enumerate() {
            check(&format!("Q {i} of step {k}"), q, &|n, x| n.q[*k][i] += x);
        }
        for (i, &b) in bar.input.iter().enumerate() {
            check(&format!("b {i} of step {k}"), b, &|n, x| n.inputs[2 * k + i] += x);
        }
    }
    for (i, &a) in kept.mean.iter().enumerate() {
        check(&format!("a {i}"), a, &|n, x| n.start[i] += x);
    }
    for (i, j) in [(0, 0), (1, 0), (1, 1)] {
        let both = if i == j { kept.variance[i * 2 + j] } else { 2.0 * kept.variance[i * 2 + j] };
        check(&format!("P0 {i} {j}"), both, &|n, x| n.variance[i * 2 + j] += x);
    }
}
