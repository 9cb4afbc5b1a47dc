//! All phases of a test as one square-root array in (ξ_1, …, ξ_I): the states between phases are integrated out.
//!
//! Phases are joined backward from the last one. The rows R on (σ_{i+1}, ξ_{i+2}, …) become, with the link σ_{i+1} =
//! [ξ_{i+1}; 0] + g + Gσ_i + Cu, u ~ N(0, I), rows on (u, σ_i, ξ_{i+1}, …). Plane rotations fold the rows on (u, σ_i,
//! ξ_{i+1}, …) into the rows [I 0] of u and the rows of phase i. The result has the rows of u on top, of which only the
//! diagonal is used: the product of the diagonal is |I + RCC'R'|^½. Below the rows of u are the rows on (σ_i, ξ_{i+1},
//! …). Nothing is inverted, and R, P_K and Σ may be singular.
//!
//! Tests of one shape are stacked in lanes, together with the data of the tests ([`Stacked`]).

mod join;
mod phase;
mod square;
mod together;

use kalfit_lanes::Lanes;
use nalgebra::DMatrix;

use crate::reduce::gains::RankOperation;
use crate::reduce::root::{UNINFORMED, settle};
use join::{JoinedPhase, per_test};

pub(crate) use phase::{StackPhase, StackShape, shape};
pub(crate) use together::Stacked;

/// The phases of tests of one shape, with one test in each lane.
#[inline(always)]
fn given<T: Lanes>(tests: &[&[StackPhase<'_>]]) -> Vec<JoinedPhase<T>> {
    let mut phases = Vec::with_capacity(tests[0].len());
    for at in 0..tests[0].len() {
        phases.push(JoinedPhase::new(tests, at));
    }
    phases
}

/// Sets negligible information of a packed factor to zero; the operations are appended to `settled`.
fn settle_packed(factor: &mut [f64], width: usize, settled: &mut Vec<RankOperation>) {
    let mut entries = vec![0.0; width * width];
    let places = || (0..width).flat_map(|k| (0..=k).map(move |i| i * width + k));
    places().zip(&*factor).for_each(|(place, x)| entries[place] = *x);
    settle(&mut entries, width, UNINFORMED, settled);
    places().zip(factor).for_each(|(place, x)| *x = entries[place]);
}

/// (G, C) of each link of each test.
#[inline(always)]
fn links<T: Lanes>(phases: &[JoinedPhase<T>], tests: usize) -> Vec<Vec<(DMatrix<f64>, DMatrix<f64>)>> {
    let mut all = vec![Vec::with_capacity(phases.len() - 1); tests];
    for phase in phases {
        if let Some(link) = &phase.link {
            for (own, pair) in all.iter_mut().zip(link.G.per_test(tests).into_iter().zip(link.C.per_test(tests))) {
                own.push(pair);
            }
        }
    }
    all
}

/// ½ Σ log|I + RCC'R'| of each test, from the diagonals of the rows of u.
#[inline(always)]
fn half_log_determinants<T: Lanes>(diagonals: &[Vec<T>], tests: usize) -> Vec<f64> {
    let mut sums = vec![0.0; tests];
    for diagonal in diagonals {
        for (sum, diagonal) in sums.iter_mut().zip(per_test(diagonal, tests)) {
            *sum += diagonal.iter().map(|x| x.ln()).sum::<f64>();
        }
    }
    sums
}

/// Σ (constant of a phase) - ½ Σ log|I + RCC'R'| - ½ residual: the constant of all phases together.
fn constant(phases: &[StackPhase<'_>], half_log_determinant: f64, residual: f64) -> f64 {
    phases.iter().map(|phase| phase.constant).sum::<f64>() - half_log_determinant - 0.5 * residual
}

#[cfg(test)]
mod tests {
    use nalgebra::DVector;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::together::StackKernel;
    use super::*;
    use kalfit_lanes::Isa;

    /// A phase of a test: R packed, d, and Ψ, C, T, g of the link that leads to the phase.
    struct TestPhase {
        factor: Vec<f64>,
        data: Vec<f64>,
        link: Option<([DMatrix<f64>; 3], DVector<f64>)>,
    }

    /// Random phases of given sizes (p, q, states before, columns of C); some numbers are zero, in some lanes whole rows.
    fn phases(sizes: &[(usize, usize, usize, usize)], random: &mut ChaCha8Rng) -> Vec<TestPhase> {
        let sparse = random.random_bool(0.5);
        let number = |random: &mut ChaCha8Rng| {
            if sparse && random.random_bool(0.4) {
                0.0
            } else {
                random.random_range(-1.5..1.5) * 10f64.powi(random.random_range(-3..3))
            }
        };
        let mut before = 0;
        let mut all = Vec::new();
        for (at, &(_, q, n, u)) in sizes.iter().enumerate() {
            let mut factor = Vec::new();
            for k in 0..q {
                (0..k).for_each(|_| factor.push(number(random)));
                factor.push(number(random).abs());
            }
            let mut matrix = |rows: usize, columns: usize| DMatrix::from_fn(rows, columns, |_, _| number(random));
            let link = (at > 0).then(|| [matrix(n, before), matrix(n, u), matrix(q, n)]);
            let link = link.map(|link| (link, DVector::from_fn(q, |_, _| number(random))));
            let data = (0..q).map(|_| number(random)).collect();
            all.push(TestPhase { factor, data, link });
            before = q;
        }
        all
    }

    fn inputs<'a>(phases: &'a [TestPhase], sizes: &[(usize, usize, usize, usize)]) -> Vec<StackPhase<'a>> {
        let phase = |(own, size): (&'a TestPhase, &(usize, usize, usize, usize))| StackPhase {
            own: size.0,
            factor: &own.factor,
            data: &own.data,
            constant: 0.25,
            link: own.link.as_ref().map(|(link, _)| link.each_ref()),
            mean: own.link.as_ref().map(|(_, mean)| mean),
        };
        phases.iter().zip(sizes).map(phase).collect()
    }

    fn bits(numbers: &[f64]) -> Vec<u64> {
        numbers.iter().map(|x| x.to_bits()).collect()
    }

    #[test]
    fn tests_side_by_side_are_stacked_to_the_bits_of_each_alone() {
        let shapes: [&[(usize, usize, usize, usize)]; 5] = [
            &[(2, 2, 0, 0), (2, 2, 2, 1)],
            &[(3, 3, 0, 0), (1, 4, 3, 3), (0, 2, 4, 0)],
            &[(0, 0, 0, 0), (2, 3, 1, 5)],
            &[(2, 2, 0, 0), (0, 0, 2, 2), (1, 1, 0, 0)],
            &[(6, 6, 0, 0), (6, 6, 6, 2), (6, 6, 6, 8)],
        ];
        let mut random = ChaCha8Rng::seed_from_u64(11);
        for sizes in shapes {
            for count in [1, 2, 4, 8, 11] {
                let tests: Vec<Vec<TestPhase>> = (0..count).map(|_| phases(sizes, &mut random)).collect();
                let inputs: Vec<Vec<StackPhase<'_>>> = tests.iter().map(|test| inputs(test, sizes)).collect();
                let inputs: Vec<&[StackPhase<'_>]> = inputs.iter().map(|phases| &**phases).collect();
                for isa in Isa::all() {
                    let found = isa.run(StackKernel(&inputs));
                    assert_eq!(found.len(), count);
                    for (lane, found) in found.iter().enumerate() {
                        let alone = &Stacked::all(&inputs[lane..=lane])[0];
                        let about = format!("{isa:?}, {sizes:?}, test {lane} of {count}");
                        assert_eq!(bits(&found.factor), bits(&alone.factor), "R: {about}");
                        assert_eq!(found.links, alone.links, "links: {about}");
                        assert_eq!(found.constant.to_bits(), alone.constant.to_bits(), "ℓ: {about}");
                        assert_eq!(bits(&found.data), bits(&alone.data), "d: {about}");
                    }
                }
            }
        }
    }

    #[test]
    fn stacked_rows_are_those_of_the_joint_law() {
        // compares log p(z | ξ) = constant - ½ ‖d - Rξ‖² with z_2 | ξ by hand, for one state and one number per phase
        let (r, d, constant) = ([2.0, 3.0], [1.0, -0.5], 0.25);
        let (psi, root, transition, g) = (0.75, 0.5, 1.5, 0.125);
        let one = |x: f64| DMatrix::from_element(1, 1, x);
        let own = |at: usize, link| TestPhase { factor: vec![r[at]], data: vec![d[at]], link };
        let link = ([one(psi), one(root), one(transition)], DVector::from_element(1, g));
        let test = vec![own(0, None), own(1, Some(link))];
        let sizes = [(1, 1, 0, 0), (1, 1, 1, 1)];
        let found = &Stacked::all(&[&inputs(&test, &sizes)])[0];
        let spread: f64 = 1.0 + r[1] * r[1] * (transition * root) * (transition * root);
        for xi in [[0.0, 0.0], [1.0, -2.0], [0.3, 0.8]] {
            let first = d[0] - r[0] * xi[0];
            let second = d[1] - r[1] * (xi[1] + g + transition * psi * xi[0]);
            let expected = 2.0 * constant - 0.5 * (first * first + second * second / spread) - 0.5 * spread.ln();
            let rows = [
                found.data[0] - found.factor[0] * xi[0] - found.factor[1] * xi[1],
                found.data[1] - found.factor[2] * xi[1],
            ];
            let value = found.constant - 0.5 * (rows[0] * rows[0] + rows[1] * rows[1]);
            assert!((value - expected).abs() < 1e-13, "at {xi:?}: {value}, by hand {expected}");
        }
    }
}
