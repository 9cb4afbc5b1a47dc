//! The expression language of model files; its grammar stands in the documentation of the crate.

mod fold;
mod form;
mod lower;
mod scope;
mod snippet;
mod syntax;

use kalfit::model::{Expression, Linear};

use crate::error::{Result, SpecError};
use crate::names::NameContext;
use crate::table::TomlField;
use lower::ExpressionLowering;
use snippet::ExpressionSnippet;
use syntax::SyntaxNode;

pub(crate) use fold::{ONE, ZERO, binary, is_zero, negate, size, square};
pub(crate) use scope::ExpressionScope;

fn read(context: &NameContext<'_>, field: &TomlField<'_>) -> Result<(ExpressionSnippet, SyntaxNode)> {
    let text = field.as_text().ok_or_else(|| field.wrong_type("a number or an expression"))?;
    let snippet = ExpressionSnippet::new(context.source, text, field.span.clone());
    match syntax::parse(text) {
        Ok(node) => Ok((snippet, node)),
        Err(fault) => {
            let span = if fault.span.is_empty() { snippet.end() } else { snippet.locate(&fault.span) };
            Err(SpecError::new(fault.problem).at(span).maybe_hint(fault.hint))
        }
    }
}

/// A linear form in the states: a number or an expression.
pub(crate) fn linear(
    context: &mut NameContext<'_>,
    field: &TomlField<'_>,
    scope: ExpressionScope<'_>,
) -> Result<Linear> {
    if field.is_number() {
        return Ok(lower::constant(field.number()?));
    }
    let (snippet, node) = read(context, field)?;
    Ok(ExpressionLowering { context, scope, snippet: &snippet }.form(&node)?.into_linear())
}

/// A number without states: a number or an expression.
pub(crate) fn scalar(
    context: &mut NameContext<'_>,
    field: &TomlField<'_>,
    scope: ExpressionScope<'_>,
) -> Result<Expression> {
    if field.is_number() {
        return Ok(lower::constant(field.number()?).constant);
    }
    let (snippet, node) = read(context, field)?;
    ExpressionLowering { context, scope, snippet: &snippet }.scalar(&node)
}

/// A condition.
pub(crate) fn condition(
    context: &mut NameContext<'_>,
    field: &TomlField<'_>,
    scope: ExpressionScope<'_>,
) -> Result<Expression> {
    field.text()?;
    let (snippet, node) = read(context, field)?;
    ExpressionLowering { context, scope, snippet: &snippet }.truth(&node)
}
