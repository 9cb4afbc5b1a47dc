//! Sensitivity dℓ_max/d(value) and score test of each constraint (theory §4).

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::law::AsymptoticLaw;
use kalfit_algebra::elements::Element;
use kalfit_algebra::symmetric::pair;
use kalfit_estimate::{CoordinateForm, Estimate, FinalState, Mixed, Objective};
use kalfit_model::MeanElement;

/// Sensitivity of ℓ_max to the value at which one element is held, and the score (Lagrange multiplier) test of that
/// constraint.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensitivity {
    /// The element.
    pub element: Element,
    /// Value at which the element is held.
    pub value: f64,
    /// dℓ_max / d value; an off-diagonal element moves in both triangles.
    pub sensitivity: f64,
    /// Score statistic; `None` where freeing only this element makes no sense, or where the data have no information on
    /// the element.
    pub statistic: Option<f64>,
    /// p-value of the statistic: χ² with one degree of freedom, one-sided for a variance held at zero.
    pub p_value: Option<f64>,
    /// Change of the element when freed, to first order.
    pub expected_change: Option<f64>,
}

/// Sensitivities of all constrained elements: the mean first, then Σ by rows. Zero correlations between states of
/// different phases do not count as constraints.
pub fn sensitivities(estimate: &Estimate) -> Vec<Sensitivity> {
    let state = &estimate.state;
    if !holds_any(state) {
        return Vec::new();
    }
    let law = AsymptoticLaw::new(state);
    let mut found: Vec<Sensitivity> = Vec::new();
    let elements = state.structure().elements();
    let own = state.structure().reduced_dimension(); // the effects of groups have no mean
    for (i, element) in elements.iter().enumerate().take(own) {
        if let MeanElement::Fixed(value) = element {
            found.push(of_mean(state, &law, &elements, (i, *value)));
        }
    }
    for (i, j) in state.problem.covariance.elements.all() {
        if let Some(multiplier) = held(state, i, j) {
            found.push(of_covariance(estimate, &law, (i, j), multiplier));
        }
    }
    found
}

/// Whether a constraint holds some element of μ or Σ.
pub fn holds_any(state: &FinalState) -> bool {
    let fixed = |element: &MeanElement| matches!(element, MeanElement::Fixed(_));
    state.structure().elements().iter().any(fixed)
        || state.problem.covariance.elements.all().any(|(i, j)| held(state, i, j).is_some())
}

/// What holds an element of Σ.
enum HeldElement {
    /// A constraint, with the Lagrange multiplier in η.
    Multiplier(f64),
    /// The form of Σ: a fixed Σ, or a zero outside the blocks of Σ.
    Form,
}

/// Whether the structure holds element (i, j) of Σ.
pub fn is_held(state: &FinalState, i: usize, j: usize) -> bool {
    held(state, i, j).is_some()
}

fn held(state: &FinalState, i: usize, j: usize) -> Option<HeldElement> {
    let map = &state.problem.covariance;
    let constrained =
        map.constraints.iter().position(|c| c.terms.len() == 1 && pair(c.terms[0].0, c.terms[0].1) == pair(i, j));
    if let Some(k) = constrained {
        return Some(HeldElement::Multiplier(state.newton_iterate.tangent.multipliers[k]));
    }
    match map.form_of(i) {
        CoordinateForm::Fixed(_) => Some(HeldElement::Form),
        _ => map.is_structural_zero(i, j).then_some(HeldElement::Form),
    }
}

/// Sensitivity of a fixed element of the mean; elements tied to the fixed element move along.
fn of_mean(
    state: &FinalState,
    law: &AsymptoticLaw<'_>,
    elements: &[MeanElement],
    (i, value): (usize, f64),
) -> Sensitivity {
    let scale = &state.problem.classes.frame.scale;
    let local = &state.newton_iterate.local;
    let mut direction = DVector::zeros(local.mean_score.len());
    direction[i] = scale[i].recip();
    for (t, element) in elements.iter().enumerate() {
        if let MeanElement::Tied { terms, .. } = element {
            let weight: f64 = terms.iter().filter(|(k, _)| *k == i).map(|(_, w)| w).sum();
            direction[t] += weight / scale[t];
        }
    }
    let score = local.mean_score.dot(&direction);
    let own = direction.dot(&(&local.mean_information * &direction));
    let mean = &local.mean_information * &direction;
    let sigma = local.cross.transpose() * &direction;
    let lost_information =
        lost_information(state, law, (&mean, &sigma), &|mixed| mixed.columns(0, direction.len()) * &direction);
    let test = score_test(score, own, own - lost_information, false);
    Sensitivity { element: Element::Mean(i), value, sensitivity: score, ..test }
}

fn of_covariance(
    estimate: &Estimate,
    law: &AsymptoticLaw<'_>,
    (i, j): (usize, usize),
    held: HeldElement,
) -> Sensitivity {
    let state = &estimate.state;
    let scale = &state.problem.classes.frame.scale;
    let unit = (scale[i] * scale[j]).recip();
    let local = &state.newton_iterate.local;
    let multiplicity = if i == j { 1.0 } else { 2.0 };
    let score = unit
        * match held {
            HeldElement::Multiplier(multiplier) => multiplier,
            HeldElement::Form => multiplicity * local.score[(i, j)],
        };
    let k = state.problem.covariance.elements.index(i, j);
    let mean: DVector<f64> = local.cross.column(k) * unit;
    let sigma: DVector<f64> = local.information.column(k) * unit;
    let own = local.information[(k, k)] * unit * unit;
    let value = estimate.covariance[(i, j)];
    let zero = |s: usize| estimate.covariance[(s, s)] == 0.0;
    let can_be_freed = i == j || !(zero(i) || zero(j)); // σ_ij cannot be freed while σ_ii or σ_jj is zero
    let one_sided = i == j && value == 0.0;
    let column = local.mean_score.len() + k;
    let lost_information = lost_information(state, law, (&mean, &sigma), &|mixed| mixed.column(column) * unit);
    let test = score_test(score, own, own - lost_information, one_sided);
    let test = if can_be_freed && !matches!(state.problem.covariance.form_of(i), CoordinateForm::Fixed(_)) {
        test
    } else {
        without_test(score)
    };
    Sensitivity { element: Element::Covariance(i, j), value, sensitivity: score, ..test }
}

/// I_ez I_zz⁻¹ I_ze: information on an element that is lost because the free coordinates adapt: the coordinates of (μ,
/// Σ), and of α where the joint information is known. `mean` and `sigma` are the element's cross information with mean
/// coordinates and elements of Σ; `of_alpha` extracts the element's cross information with α.
fn lost_information(
    state: &FinalState,
    law: &AsymptoticLaw<'_>,
    (mean, sigma): (&DVector<f64>, &DVector<f64>),
    of_alpha: &dyn Fn(&DMatrix<f64>) -> DVector<f64>,
) -> f64 {
    let tangent = &state.newton_iterate.tangent;
    let along = tangent.pulled_back(state.problem.mean_jacobian(), mean, &tangent.jacobian.transposed_times(sigma));
    match state.joint.as_ref().and_then(|joint| joint.mixed.as_ref()) {
        None => along.dot(&(law.coordinates() * &along)),
        Some(Mixed { covariance, information }) => {
            let cross_alpha = of_alpha(information);
            let all = along.iter().chain(cross_alpha.iter()).copied();
            let cross = DVector::from_iterator(along.len() + cross_alpha.len(), all);
            cross.dot(&(covariance * &cross))
        }
    }
}

/// s² / (I_ee - I_ez I_zz⁻¹ I_ze): squared score of the element, divided by the variance of the score after the free
/// coordinates have adapted. `own` is I_ee, `information` is the denominator.
fn score_test(score: f64, own: f64, information: f64, one_sided: bool) -> Sensitivity {
    if information.is_nan() || information <= 1e-10 * own.abs() {
        return without_test(score);
    }
    let statistic = score * score / information;
    let chi = ChiSquared::new(1.0).expect("one degree of freedom is legal");
    let two_sided = chi.sf(statistic);
    let p_value = match (one_sided, score > 0.0) {
        (false, _) => two_sided,
        (true, true) => 0.5 * two_sided,
        (true, false) => 1.0,
    };
    let change = score / information;
    Sensitivity {
        statistic: Some(statistic),
        p_value: Some(p_value),
        expected_change: Some(if one_sided { change.max(0.0) } else { change }),
        ..without_test(score)
    }
}

fn without_test(score: f64) -> Sensitivity {
    Sensitivity {
        element: Element::Mean(0),
        value: 0.0,
        sensitivity: score,
        statistic: None,
        p_value: None,
        expected_change: None,
    }
}
