//! Linear forms in the states while they are built.

use kalfit::model::{Expression, Linear, Operator};

use crate::error::ExpressionProblem;
use crate::expression::fold::{self, ONE, ZERO};

/// Σ coefficient × state + constant; states ascend, and no coefficient is the constant zero.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LinearForm {
    pub(crate) terms: Vec<(usize, Expression)>,
    pub(crate) constant: Expression,
}

type LinearFormResult = Result<LinearForm, ExpressionProblem>;

impl LinearForm {
    pub(crate) fn state(state: usize) -> LinearForm {
        LinearForm { terms: vec![(state, ONE)], constant: ZERO }
    }

    pub(crate) fn first_state(&self) -> Option<usize> {
        self.terms.first().map(|(state, _)| *state)
    }

    pub(crate) fn negate(self) -> LinearForm {
        let terms = self.terms.into_iter().map(|(state, a)| (state, fold::negate(a))).collect();
        LinearForm { terms, constant: fold::negate(self.constant) }
    }

    /// a + b or a - b, as the operator says.
    pub(crate) fn join(self, operator: Operator, other: LinearForm) -> LinearFormResult {
        let constant = fold::binary(operator, self.constant, other.constant)?;
        let mut terms =
            merge(self.terms, other.terms, |a, b| fold::binary(operator, a.unwrap_or(ZERO), b.unwrap_or(ZERO)))?;
        terms.retain(|(_, coefficient)| !fold::is_zero(coefficient));
        Ok(LinearForm { terms, constant })
    }

    /// All of it times or over a factor; `before` when the factor stood on the left.
    pub(crate) fn scale(self, operator: Operator, factor: &Expression, before: bool) -> LinearFormResult {
        let times = |a: Expression| match before {
            true => fold::binary(operator, factor.clone(), a),
            false => fold::binary(operator, a, factor.clone()),
        };
        let stateless = self.terms.is_empty();
        let mut terms = Vec::with_capacity(self.terms.len());
        for (state, coefficient) in self.terms {
            let scaled = times(coefficient)?;
            if !fold::is_zero(&scaled) {
                terms.push((state, scaled));
            }
        }
        // Zero stays zero where it only says that a form has no constant.
        let constant = if !stateless && fold::is_zero(&self.constant) { ZERO } else { times(self.constant)? };
        Ok(LinearForm { terms, constant })
    }

    /// `yes` where the condition holds, else `no`.
    pub(crate) fn choose(condition: &Expression, yes: LinearForm, no: LinearForm) -> LinearForm {
        let constant = if yes.constant == no.constant && yes.constant.as_number().is_some() {
            yes.constant
        } else {
            fold::choose(condition, yes.constant, no.constant)
        };
        let picked =
            merge(yes.terms, no.terms, |a, b| Ok(fold::choose(condition, a.unwrap_or(ZERO), b.unwrap_or(ZERO))));
        let mut terms = picked.expect("choosing has no error");
        terms.retain(|(_, coefficient)| !fold::is_zero(coefficient));
        LinearForm { terms, constant }
    }

    pub(crate) fn into_linear(self) -> Linear {
        Linear { terms: self.terms, constant: self.constant }
    }
}

type LinearTerms = Vec<(usize, Expression)>;

/// Merges two ascending lists of terms.
fn merge(
    left: LinearTerms,
    right: LinearTerms,
    join: impl Fn(Option<Expression>, Option<Expression>) -> Result<Expression, ExpressionProblem>,
) -> Result<LinearTerms, ExpressionProblem> {
    let mut merged = Vec::with_capacity(left.len() + right.len());
    let (mut left, mut right) = (left.into_iter().peekable(), right.into_iter().peekable());
    loop {
        let state = match (left.peek(), right.peek()) {
            (None, None) => return Ok(merged),
            (Some((a, _)), None) => *a,
            (None, Some((b, _))) => *b,
            (Some((a, _)), Some((b, _))) => *a.min(b),
        };
        let a = left.next_if(|(s, _)| *s == state).map(|(_, coefficient)| coefficient);
        let b = right.next_if(|(s, _)| *s == state).map(|(_, coefficient)| coefficient);
        merged.push((state, join(a, b)?));
    }
}
