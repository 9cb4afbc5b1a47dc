//! Sensitivity dℓ_max/d(value) and score test of each constraint (theory §4).

use nalgebra::DVector;

use crate::room::room;
use crate::score_test::{ScoreLaw, p_value};
use crate::small_sample::JointTest;
use kalfit_algebra::elements::Element;
use kalfit_algebra::symmetric::pair;
use kalfit_estimate::{CoordinateForm, Estimate, FinalState};
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
    /// Score statistic, from the expected information; `None` where freeing only this element makes no sense, or where
    /// the data have no information on the element.
    pub statistic: Option<f64>,
    /// p-value of the statistic: χ² with one degree of freedom, one-sided for a variance held at zero.
    pub p_value: Option<f64>,
    /// Change of the element when freed, to first order, no further than where Σ ceases to be positive semidefinite.
    pub expected_change: Option<f64>,
    /// The likelihood ratio -2 log λ of the constraint, by a fit with only this element freed; `None` where the score
    /// test does not speak against the constraint, or where there was no such fit.
    pub ratio: Option<f64>,
    /// p-value of the likelihood ratio, by the law of the score statistic.
    pub ratio_p_value: Option<f64>,
    /// F test of a fixed mean under the restricted likelihood, by the laws of few tests.
    pub f: Option<JointTest>,
}

impl Sensitivity {
    /// Whether only one side of the held value is possible: a variance of zero.
    pub(crate) fn is_one_sided(&self) -> bool {
        matches!(self.element, Element::Covariance(i, j) if i == j) && self.value == 0.0
    }
}

/// Sensitivities of all constrained elements: the mean first, then Σ by rows. Zero correlations between states of
/// different phases do not count as constraints.
pub fn sensitivities(estimate: &Estimate) -> Vec<Sensitivity> {
    let state = &estimate.state;
    if !holds_any(state) {
        return Vec::new();
    }
    let law = ScoreLaw::new(state);
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
fn of_mean(state: &FinalState, law: &ScoreLaw<'_>, elements: &[MeanElement], (i, value): (usize, f64)) -> Sensitivity {
    let scale = &state.problem.classes.frame.scale;
    let mut direction = law.no_direction();
    direction[i] = scale[i].recip();
    for (t, element) in elements.iter().enumerate() {
        if let MeanElement::Tied { terms, .. } = element {
            let weight: f64 = terms.iter().filter(|(k, _)| *k == i).map(|(_, w)| w).sum();
            direction[t] += weight / scale[t];
        }
    }
    let of_means = &state.newton_iterate.local.mean_score;
    let score = of_means.dot(&direction.rows(0, of_means.len()));
    let held = untested(Element::Mean(i), value, score);
    tested(held, law, &direction, [f64::NEG_INFINITY, f64::INFINITY])
}

fn of_covariance(estimate: &Estimate, law: &ScoreLaw<'_>, (i, j): (usize, usize), held: HeldElement) -> Sensitivity {
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
    let held = untested(Element::Covariance(i, j), estimate.covariance[(i, j)], score);
    let zero = |s: usize| estimate.covariance[(s, s)] == 0.0;
    let can_be_freed = i == j || !(zero(i) || zero(j)); // σ_ij cannot be freed while σ_ii or σ_jj is zero
    if !can_be_freed || matches!(state.problem.covariance.form_of(i), CoordinateForm::Fixed(_)) {
        return held;
    }
    let mut direction = law.no_direction();
    direction[local.mean_score.len() + state.problem.covariance.elements.index(i, j)] = unit;
    tested(held, law, &direction, room(&estimate.covariance, (i, j)))
}

/// The score test of a held element whose unit is `direction` in η: s² / information, with the information that is left
/// after the free coordinates have adapted; `room` bounds the change of the element.
fn tested(held: Sensitivity, law: &ScoreLaw<'_>, direction: &DVector<f64>, room: [f64; 2]) -> Sensitivity {
    let Some(information) = law.information(direction) else { return held };
    let score = held.sensitivity;
    let statistic = score * score / information;
    let one_sided = held.is_one_sided();
    Sensitivity {
        statistic: Some(statistic),
        p_value: Some(if one_sided && score <= 0.0 { 1.0 } else { p_value(statistic, one_sided) }),
        expected_change: Some((score / information).clamp(room[0], room[1])),
        ..held
    }
}

fn untested(element: Element, value: f64, score: f64) -> Sensitivity {
    Sensitivity {
        element,
        value,
        sensitivity: score,
        statistic: None,
        p_value: None,
        expected_change: None,
        ratio: None,
        ratio_p_value: None,
        f: None,
    }
}
