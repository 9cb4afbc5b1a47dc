//! Small-sample inference against formulas with matrices of all measurements, and published cases.

mod cases;
mod dense;

use nalgebra::{DMatrix, DVector};

use crate::small_sample::information::{self, MeanSums, ThetaLaw};
use crate::small_sample::mean_law::MeanLaw;
use crate::small_sample::pass::Pass;
use dense::{Dense, Shape};
use kalfit_fixtures::near;

fn close(what: &str, found: &DMatrix<f64>, expected: &DMatrix<f64>, tolerance: f64) {
    let (off, size) = ((found - expected).amax(), expected.amax());
    assert!(off <= tolerance * size.max(1e-2), "{what}: {off:e} of {size:e}\n{found}{expected}");
}

#[test]
fn derivatives_and_laws_are_those_of_the_joint_gaussian() {
    let shapes = [
        (0, 0, 1, 0),
        (0, 0, 2, 1),
        (0, 0, 3, 2),
        (1, 0, 1, 1),
        (1, 0, 2, 2),
        (2, 0, 2, 1),
        (0, 1, 1, 0),
        (0, 2, 2, 1),
        (1, 1, 2, 1),
        (2, 2, 1, 1),
    ];
    for (seed, (depth, factors, p, regressors)) in shapes.into_iter().enumerate() {
        for rank in p - 1..=p {
            let shape = Shape { depth, factors, p, regressors, rank };
            let dense = Dense::drawn(shape, seed as u64);
            let (forest, theta, roots) = dense.forest();
            let pass = Pass::of(&forest, &theta, &roots).expect("finite");
            let totals = pass.totals().expect("finite");
            let mean = MeanSums::of(&totals, pass.first_mean(), dense.means());
            close("C", &mean.covariance, &dense.c(), 1e-10);
            for a in 0..theta.len() {
                close("M_a", &mean.slopes[a], &dense.m(a), 1e-10);
                let moved = dense.moved(a);
                close("dβ", &(&mean.covariance * DMatrix::from_columns(&[mean.moves[a].clone()])), &moved, 1e-8);
            }
            let expected = information::expected(&pass, &mean).expect("finite");
            close("expected information", &expected, &dense.expected(), 1e-9);
            let observed = information::observed(&pass, &mean).expect("finite");
            close("observed information", &observed, &dense.observed(), 1e-8);
            let Some(inverse) = expected.clone().try_inverse() else { continue };
            let law = ThetaLaw::of(&pass, &expected).expect("a law");
            close("V", &law.covariance, &inverse, 1e-6);
            let bent = pass.contracted(&law.covariance).expect("finite");
            let (first, q) = (pass.first_mean(), dense.means());
            let law = MeanLaw::kenward_roger(&mean, law, &bent.view((first, first), (q, q)).into_owned());
            close("C_A", &law.adjusted, &dense.adjusted(&inverse), 1e-9);
        }
    }
}

#[test]
fn equal_designs_are_evaluated_once_in_any_order() {
    let shape = Shape { depth: 1, factors: 0, p: 2, regressors: 1, rank: 2 };
    let dense = Dense::drawn(shape, 3);
    let (forest, theta, roots) = dense.forest();
    let reversed = dense.reversed();
    let (other, ..) = reversed.forest();
    let of = |forest: &crate::small_sample::forest::Forest| {
        let pass = Pass::of(forest, &theta, &roots).expect("finite");
        let mean = MeanSums::of(&pass.totals().expect("finite"), 2, dense.means());
        information::expected(&pass, &mean).expect("finite")
    };
    assert_eq!(of(&forest), of(&other), "same bits in another order");
    // without data, tests of one design are one class
    let equal = Dense::balanced(8);
    let (forest, ..) = equal.forest_without_data();
    assert_eq!((forest.leaves.len(), forest.units.len(), forest.units[0].1), (1, 1, 8));
}

#[test]
fn balanced_tests_give_students_t_and_hotellings_t_squared() {
    let n = 7;
    let equal = Dense::balanced(n);
    let (forest, theta, roots) = equal.forest_without_data();
    let pass = Pass::of(&forest, &theta, &roots).expect("finite");
    let mean = MeanSums::of(&pass.totals().expect("finite"), 2, 2);
    let law = ThetaLaw::of(&pass, &information::expected(&pass, &mean).expect("finite")).expect("a law");
    let bent = pass.contracted(&law.covariance).expect("finite").view((2, 2), (2, 2)).into_owned();
    let law = MeanLaw::kenward_roger(&mean, law, &bent);
    for l in [[1.0, 0.0], [0.3, -2.0]] {
        let row = law.row(&DVector::from_column_slice(&l), 1.0).expect("a row");
        near::relative("degrees of freedom", row.df.expect("some"), n as f64 - 1.0, 1e-9);
        near::relative("standard error", row.std_error, row.std_error_plain, 1e-9);
    }
    let joint = law.joint(&DMatrix::identity(2, 2), &DVector::from_column_slice(&[1.0, 0.5])).expect("an F test");
    near::relative("denominator", joint.df_den.expect("some"), n as f64 - 2.0, 1e-8);
    near::relative("scale", joint.scale, (n as f64 - 2.0) / (n as f64 - 1.0), 1e-8);
}
