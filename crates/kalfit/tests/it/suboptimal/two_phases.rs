//! The paper's section 4.1: two phases whose estimates are combined by Bayesian least squares, (56)-(59), against what the
//! reductions and terminals of each phase say.

use kalfit::reduce::{EstimateReducer, Estimates, Reduction, Terminal};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};

use super::drawn::{Drawn, Kind, draw, generator, matrix};

/// Eigenvalues are within a factor of 1e8.
fn invertible(a: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let values = a.clone().symmetric_eigen().eigenvalues;
    if values.min() > 1e-8 * values.max() { a.clone().try_inverse() } else { None }
}

/// D_1, D_2, Q_T, cov v and ŝ - s̄ of one phase, (53), (54).
struct Parts {
    d_1: DMatrix<f64>,
    d_2: DMatrix<f64>,
    q_t: DMatrix<f64>,
    v: DMatrix<f64>,
    left: DVector<f64>,
}

fn parts(estimates: &Estimates) -> Option<Parts> {
    let (n, m) = (estimates.transition.nrows(), estimates.estimates.len());
    let gamma = &estimates.root * estimates.root.transpose();
    let q_t = gamma.view((0, 0), (n, n)).into_owned();
    let d_2 = gamma.view((n, 0), (m, n)) * invertible(&q_t)?;
    let v = gamma.view((n, n), (m, m)) - &d_2 * &q_t * d_2.transpose();
    let left = &estimates.estimates - &estimates.offsets;
    Some(Parts { d_1: estimates.sensitivities.clone(), d_2, q_t, v, left })
}

/// The estimates without x̂_T.
fn first_alone(estimates: &Estimates) -> Estimates {
    let n = estimates.transition.nrows();
    let mut root = estimates.root.clone();
    root = root.remove_rows(n, n);
    Estimates {
        estimates: estimates.estimates.rows(n, n).into_owned(),
        offsets: estimates.offsets.rows(n, n).into_owned(),
        sensitivities: estimates.sensitivities.rows(n, n).into_owned(),
        root,
        ..estimates.clone()
    }
}

fn reduce(drawn: &Drawn, estimates: &Estimates) -> (DMatrix<f64>, DVector<f64>, Terminal) {
    let reducer = EstimateReducer::new(&drawn.phase, &drawn.alpha).expect("sound");
    let (Reduction { data, factor, .. }, terminal) = reducer.reduce("t", estimates).expect("sound");
    let r = DMatrix::from_fn(data.len(), data.len(), |i, k| if i <= k { factor[i + k * (k + 1) / 2] } else { 0.0 });
    let y = r.transpose() * DVector::from_vec(data);
    (r.transpose() * r, y, terminal)
}

/// Checks one pair of phases; `None` where something that the paper inverts has no inverse.
fn check(seed: u64) -> Option<()> {
    let (one, two) = (draw(seed, Kind::Wrong).free(), draw(seed + 100_000, Kind::Wrong).free());
    let (first, second) = (one.dense(), first_alone(&two.dense()));
    let (n, n_2) = (first.transition.nrows(), second.transition.nrows());
    let t = matrix(n_2, n, &mut generator(seed));
    let phase = parts(&first)?;
    let noise_2 = second.root.rows(n_2, n_2) * second.root.rows(n_2, n_2).transpose();
    let d_10 = &second.sensitivities;
    // (56): measurements of (y¹, w_T, y²)
    let mut h = DMatrix::zeros(2 * n + n_2, 2 * n + n_2);
    h.view_mut((0, 0), (2 * n, n)).copy_from(&phase.d_1);
    h.view_mut((0, n), (2 * n, n)).copy_from(&phase.d_2);
    h.view_mut((2 * n, 0), (n_2, n)).copy_from(&(d_10 * &t * &first.transition));
    h.view_mut((2 * n, n), (n_2, n)).copy_from(&(d_10 * &t));
    h.view_mut((2 * n, 2 * n), (n_2, n_2)).copy_from(d_10);
    let mut weight = DMatrix::zeros(2 * n + n_2, 2 * n + n_2);
    weight.view_mut((0, 0), (2 * n, 2 * n)).copy_from(&invertible(&phase.v)?);
    weight.view_mut((2 * n, 2 * n), (n_2, n_2)).copy_from(&invertible(&noise_2)?);
    let mut left = DVector::zeros(2 * n + n_2);
    left.rows_mut(0, 2 * n).copy_from(&phase.left);
    let beyond = &second.estimates - &second.offsets - d_10 * &t * &first.drift;
    left.rows_mut(2 * n, n_2).copy_from(&beyond);
    let prior = invertible(&phase.q_t)?;
    let mut information = h.transpose() * &weight * &h;
    let mut of_noise = information.view_mut((n, n), (n, n));
    of_noise += &prior;
    let covariance = invertible(&information)?;
    let joint = &covariance * h.transpose() * &weight * left;
    // the first two measurements by themselves: ŷ¹ and ŵ_T
    let own = h.view((0, 0), (2 * n, 2 * n)).into_owned();
    let own_weight = weight.view((0, 0), (2 * n, 2 * n)).into_owned();
    let mut own_information = own.transpose() * &own_weight * &own;
    let mut of_noise = own_information.view_mut((n, n), (n, n));
    of_noise += &prior;
    let p_yw = invertible(&own_information)?;
    let yw = &p_yw * own.transpose() * own_weight * &phase.left;
    near::matrices(
        format_args!("ŷ¹ and ŵ_T, seed {seed}"),
        &column(&joint.rows(0, 2 * n).into_owned()),
        &column(&yw),
        1e-5,
    );
    // (57): the third by itself
    let back = d_10.clone().try_inverse()?;
    let (y_s, p_s) = (&back * (&second.estimates - &second.offsets), &back * &noise_2 * back.transpose());
    // (58), (59)
    let mut both = DMatrix::zeros(n, 2 * n);
    both.columns_mut(0, n).copy_from(&first.transition);
    both.columns_mut(n, n).fill_with_identity();
    let y_2 = column(&(&y_s - &t * (&both * &yw + &first.drift)));
    let p_2 = &p_s + &t * &both * &p_yw * both.transpose() * t.transpose();
    near::matrices(format_args!("(58), seed {seed}"), &column(&joint.rows(2 * n, n_2).into_owned()), &y_2, 1e-5);
    near::matrices(
        format_args!("(59), seed {seed}"),
        &covariance.view((2 * n, 2 * n), (n_2, n_2)).into_owned(),
        &p_2,
        1e-5,
    );
    // the same from reductions and the terminal
    let (j_1, z_1, terminal) = reduce(&one, &first);
    let (j_2, z_2, _) = reduce(&two, &second);
    let (p_1, inverse_2) = (invertible(&j_1)?, invertible(&j_2)?);
    let last = &terminal.mean + &terminal.sensitivity * (&p_1 * z_1);
    let of_last = terminal.covariance() + &terminal.sensitivity * p_1 * terminal.sensitivity.transpose();
    near::matrices(format_args!("ŷ² of reductions, seed {seed}"), &column(&(&inverse_2 * z_2 - &t * last)), &y_2, 1e-5);
    near::matrices(
        format_args!("its covariance, seed {seed}"),
        &(inverse_2 + &t * of_last * t.transpose()),
        &p_2,
        1e-5,
    );
    Some(())
}

fn column(x: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(x.len(), 1, x.as_slice())
}

#[test]
fn the_two_phase_formulas_of_the_paper_are_what_reductions_and_terminals_give() {
    let checked = (0..2000).filter(|seed| check(*seed).is_some()).count();
    assert!(checked >= 20, "{checked} pairs of phases could be checked");
}
