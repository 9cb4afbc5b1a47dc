//! From trees to linear forms in the states, with types checked and constants folded.

use std::ops::Range;

use kalfit::model::{Expression, Function, Linear, Operator};

use crate::error::{ExpressionProblem as Wrong, Result, Span, SpecError};
use crate::expression::fold::{self, ONE, ZERO};
use crate::expression::form::LinearForm;
use crate::expression::scope::ExpressionScope;
use crate::expression::snippet::ExpressionSnippet;
use crate::expression::syntax::{SyntaxKind, SyntaxNode};
use crate::names::{NameContext, ParameterRole};
use crate::suggest::suggest;
use crate::vocabulary::{function_called, functions, is_reserved, symbol};

/// Turns one tree into its meaning.
pub(crate) struct ExpressionLowering<'c, 't> {
    pub(crate) context: &'c mut NameContext<'t>,
    pub(crate) scope: ExpressionScope<'c>,
    pub(crate) snippet: &'c ExpressionSnippet,
}

/// A number, linear in states, or a truth value without states.
enum ExpressionMeaning {
    Number(LinearForm),
    Truth(Expression),
}

const NUMBER: &str = "a number";
const TRUTH: &str = "a condition";

impl ExpressionLowering<'_, '_> {
    /// The meaning of a tree that must be a number.
    pub(crate) fn form(&mut self, node: &SyntaxNode) -> Result<LinearForm> {
        match self.any(node)? {
            ExpressionMeaning::Number(form) => Ok(form),
            ExpressionMeaning::Truth(_) => Err(self
                .wrong(Wrong::Type { found: TRUTH, expected: NUMBER }, &node.span)
                .hint("`if(condition, 1, 0)` makes a number of a condition")),
        }
    }

    /// The meaning of a tree that must be a condition.
    pub(crate) fn truth(&mut self, node: &SyntaxNode) -> Result<Expression> {
        match self.any(node)? {
            ExpressionMeaning::Truth(expression) => Ok(expression),
            ExpressionMeaning::Number(_) => {
                let hint = format!("write `{} != 0`", self.snippet.text_at(&node.span));
                Err(self.wrong(Wrong::Type { found: NUMBER, expected: TRUTH }, &node.span).hint(hint))
            }
        }
    }

    /// A number without states.
    pub(crate) fn scalar(&mut self, node: &SyntaxNode) -> Result<Expression> {
        let form = self.form(node)?;
        debug_assert!(self.scope.states || form.terms.is_empty(), "no state has got past its scope");
        Ok(form.constant)
    }

    fn any(&mut self, node: &SyntaxNode) -> Result<ExpressionMeaning> {
        self.context.spend(1).map_err(|problem| self.wrong(problem, &node.span))?;
        match &node.kind {
            SyntaxKind::Number(x) => Ok(number(Expression::Number(*x))),
            SyntaxKind::Name(name) => self.name(name, &node.span),
            SyntaxKind::Column(name) => self.column(name, &node.span),
            SyntaxKind::Text(_) => Err(self
                .wrong(Wrong::Type { found: "a text", expected: "a number or a condition" }, &node.span)
                .hint("texts are compared with columns, as in `sensor == 'A'`")),
            SyntaxKind::Negate(a) => Ok(ExpressionMeaning::Number(self.form(a)?.negate())),
            SyntaxKind::Not(a) => Ok(ExpressionMeaning::Truth(fold::not(self.truth(a)?))),
            SyntaxKind::Binary(operator, a, b) => match operator {
                Operator::And | Operator::Or => self.connective_chain(node),
                Operator::Power => self.power(a, b, &node.span),
                Operator::Add | Operator::Subtract | Operator::Multiply | Operator::Divide => {
                    self.arithmetic_chain(node)
                }
                _ => self.comparison(*operator, a, b, &node.span),
            },
            SyntaxKind::Call(name, arguments) => self.call(name, arguments, &node.span),
        }
    }

    fn name(&mut self, name: &str, span: &Range<usize>) -> Result<ExpressionMeaning> {
        if let Some(state) = self.context.states.get(name) {
            self.allow(self.scope.states, || format!("state `{name}`"), span)?;
            return Ok(ExpressionMeaning::Number(LinearForm::state(state)));
        }
        if let Some(index) = self.context.parameters.get(name) {
            return self.parameter(name, index, span);
        }
        match name {
            "pi" => Ok(number(Expression::Number(std::f64::consts::PI))),
            "dt" => {
                self.allow(self.scope.step, || "`dt`".to_owned(), span)?;
                if self.context.time {
                    Ok(number(Expression::Step))
                } else {
                    Err(self.wrong(Wrong::StepWithoutTime, span))
                }
            }
            _ if is_reserved(name) => Err(self
                .wrong(Wrong::NoArguments { name: name.to_owned() }, span)
                .hint(format!("a column of this name is written `` `{name}` ``"))),
            _ => self.column(name, span),
        }
    }

    fn parameter(&mut self, name: &str, index: usize, span: &Range<usize>) -> Result<ExpressionMeaning> {
        self.allow(self.scope.parameters, || format!("parameter `{name}`"), span)?;
        if let Some(column) = self.context.levels[index]
            && !self.scope.columns
        {
            let per = self.context.text_columns[column].name.clone();
            let place = self.scope.place.to_owned();
            return Err(self.wrong(Wrong::LevelInCommon { name: name.to_owned(), per, place }, span));
        }
        self.context.use_parameter(index, ParameterRole::Coefficient);
        Ok(number(Expression::Parameter(index)))
    }

    fn column(&mut self, name: &str, span: &Range<usize>) -> Result<ExpressionMeaning> {
        if !self.scope.columns {
            let states = self.context.states.names().filter(|_| self.scope.states);
            let parameters = self.context.parameters.names().filter(|_| self.scope.parameters);
            let hint = suggest(name, states.chain(parameters));
            let wrong = Wrong::NotAllowed { what: format!("column `{name}`"), place: self.scope.place.to_owned() };
            return Err(self.wrong(wrong, span).maybe_hint(hint));
        }
        let file_span = self.snippet.locate(span);
        Ok(number(Expression::Column(self.context.column(name, file_span, self.scope.place))))
    }

    /// Walks a left spine of + - * / without recursion.
    fn arithmetic_chain(&mut self, node: &SyntaxNode) -> Result<ExpressionMeaning> {
        let mut chain = Vec::new();
        let mut first = node;
        while let SyntaxKind::Binary(operator, left, right) = &first.kind
            && matches!(operator, Operator::Add | Operator::Subtract | Operator::Multiply | Operator::Divide)
        {
            chain.push((*operator, right, &first.span));
            first = left;
        }
        let mut total = self.form(first)?;
        for (operator, right, span) in chain.into_iter().rev() {
            let right = self.form(right)?;
            total = self.combine(operator, total, right, span)?;
        }
        Ok(ExpressionMeaning::Number(total))
    }

    fn combine(&mut self, operator: Operator, a: LinearForm, b: LinearForm, span: &Range<usize>) -> Result<LinearForm> {
        let folded = match operator {
            Operator::Add | Operator::Subtract => a.join(operator, b),
            _ => match (a.first_state(), b.first_state()) {
                (Some(first), Some(second)) => {
                    let (first, second) = (self.state_name(first), self.state_name(second));
                    return Err(self.wrong(
                        match operator {
                            Operator::Multiply => Wrong::Product { first, second },
                            _ => Wrong::Quotient { first, second },
                        },
                        span,
                    ));
                }
                (None, Some(state)) if operator == Operator::Divide => {
                    return Err(self.wrong(Wrong::DivisionByState { name: self.state_name(state) }, span));
                }
                (None, Some(_)) => {
                    self.spend(&b, &a.constant, span)?;
                    b.scale(Operator::Multiply, &a.constant, true)
                }
                _ => {
                    self.spend(&a, &b.constant, span)?;
                    a.scale(operator, &b.constant, false)
                }
            },
        };
        folded.map_err(|problem| self.wrong(problem, span))
    }

    /// Accounts for copies of a factor that goes to every term.
    fn spend(&mut self, form: &LinearForm, factor: &Expression, span: &Range<usize>) -> Result<()> {
        let copies = form.terms.len().saturating_mul(fold::size(factor));
        self.context.spend(copies).map_err(|problem| self.wrong(problem, span))
    }

    fn power(&mut self, base: &SyntaxNode, exponent: &SyntaxNode, span: &Range<usize>) -> Result<ExpressionMeaning> {
        let (base, exponent) = (self.form(base)?, self.form(exponent)?);
        if let Some(state) = exponent.first_state() {
            return Err(self.wrong(Wrong::StateInExponent { name: self.state_name(state) }, span));
        }
        if let Some(state) = base.first_state() {
            if exponent.constant == ONE {
                return Ok(ExpressionMeaning::Number(base));
            }
            return Err(self.wrong(Wrong::PowerOfState { name: self.state_name(state) }, span));
        }
        let folded = fold::binary(Operator::Power, base.constant, exponent.constant);
        folded.map(number).map_err(|problem| self.wrong(problem, span))
    }

    /// Walks a left spine of `and` and `or` without recursion.
    fn connective_chain(&mut self, node: &SyntaxNode) -> Result<ExpressionMeaning> {
        let mut chain = Vec::new();
        let mut first = node;
        while let SyntaxKind::Binary(operator @ (Operator::And | Operator::Or), left, right) = &first.kind {
            chain.push((*operator, right, &first.span));
            first = left;
        }
        let mut total = self.truth(first)?;
        for (operator, right, span) in chain.into_iter().rev() {
            let right = self.truth(right)?;
            total = fold::binary(operator, total, right).map_err(|problem| self.wrong(problem, span))?;
        }
        Ok(ExpressionMeaning::Truth(total))
    }

    fn comparison(
        &mut self,
        operator: Operator,
        a: &SyntaxNode,
        b: &SyntaxNode,
        span: &Range<usize>,
    ) -> Result<ExpressionMeaning> {
        match (&a.kind, &b.kind) {
            (SyntaxKind::Text(text), _) => return self.text_comparison(operator, b, text, span),
            (_, SyntaxKind::Text(text)) => return self.text_comparison(operator, a, text, span),
            _ => {}
        }
        let (a, b) = (self.form(a)?, self.form(b)?);
        if let Some(state) = a.first_state().or(b.first_state()) {
            return Err(self.wrong(Wrong::ConditionOnState { name: self.state_name(state) }, span));
        }
        let folded = fold::binary(operator, a.constant, b.constant);
        folded.map(ExpressionMeaning::Truth).map_err(|problem| self.wrong(problem, span))
    }

    fn text_comparison(
        &mut self,
        operator: Operator,
        other: &SyntaxNode,
        text: &str,
        span: &Range<usize>,
    ) -> Result<ExpressionMeaning> {
        let negated = match operator {
            Operator::Equal => false,
            Operator::NotEqual => true,
            _ => return Err(self.wrong(Wrong::TextOrder { found: symbol(operator) }, span)),
        };
        let (column, quoted) = match &other.kind {
            SyntaxKind::Column(name) => (name, true),
            SyntaxKind::Name(name) => (name, false),
            _ => {
                let found = format!("`{}`", self.snippet.text_at(&other.span));
                return Err(self.wrong(Wrong::TextComparedWith { found }, &other.span));
            }
        };
        if !quoted && let Some(what) = self.what_hides(column) {
            let wrong = Wrong::TextComparedWith { found: format!("{what} `{column}`") };
            return Err(self.wrong(wrong, &other.span).hint(format!("the column is written `` `{column}` ``")));
        }
        self.allow(self.scope.columns, || format!("column `{column}`"), &other.span)?;
        let file_span = self.snippet.locate(&other.span);
        let column = self.context.text_column(column, file_span, self.scope.place);
        let equals = Expression::TextEquals { column, literal: self.context.literals.add(text) };
        Ok(ExpressionMeaning::Truth(if negated { fold::not(equals) } else { equals }))
    }

    /// What a bare name is when it is not a column.
    fn what_hides(&self, name: &str) -> Option<&'static str> {
        if self.context.states.get(name).is_some() {
            Some("the state")
        } else if self.context.parameters.get(name).is_some() {
            Some("the parameter")
        } else if is_reserved(name) {
            Some("the word")
        } else {
            None
        }
    }

    fn call(&mut self, name: &str, arguments: &[SyntaxNode], span: &Range<usize>) -> Result<ExpressionMeaning> {
        if name == "if" {
            return self.choice(arguments, span);
        }
        let function = function_called(name).ok_or_else(|| self.unknown_function(name, span))?;
        let many = matches!(function, Function::Min | Function::Max);
        if arguments.is_empty() || (!many && arguments.len() > 1) {
            let expected = if many { "1 or more" } else { "1" };
            return Err(self.wrong(Wrong::Arguments { name: name.to_owned(), found: arguments.len(), expected }, span));
        }
        let mut scalars = Vec::with_capacity(arguments.len());
        for argument in arguments {
            let form = self.form(argument)?;
            if let Some(state) = form.first_state() {
                let wrong = Wrong::FunctionOfState { function: name.to_owned(), name: self.state_name(state) };
                return Err(self.wrong(wrong, span));
            }
            scalars.push(form.constant);
        }
        fold::call(function, scalars).map(number).map_err(|problem| self.wrong(problem, span))
    }

    fn choice(&mut self, arguments: &[SyntaxNode], span: &Range<usize>) -> Result<ExpressionMeaning> {
        let [condition, yes, no] = arguments else {
            let wrong = Wrong::Arguments { name: "if".to_owned(), found: arguments.len(), expected: "3" };
            return Err(self.wrong(wrong, span).hint("write `if(condition, value, other_value)`"));
        };
        let condition = self.truth(condition)?;
        let (yes, no) = (self.form(yes)?, self.form(no)?);
        let copies = (yes.terms.len() + no.terms.len()).saturating_mul(fold::size(&condition));
        self.context.spend(copies).map_err(|problem| self.wrong(problem, span))?;
        Ok(ExpressionMeaning::Number(LinearForm::choose(&condition, yes, no)))
    }

    fn unknown_function(&self, name: &str, span: &Range<usize>) -> SpecError {
        let name_span = span.start..span.start + name.len();
        let hint = match name {
            "ln" => Some("the natural logarithm is `log`".to_owned()),
            "pow" => Some("`^` raises to a power".to_owned()),
            _ if self.what_hides(name).is_some() => Some(format!("write `{name} * (`")),
            _ => suggest(name, functions()),
        };
        self.wrong(Wrong::UnknownFunction { name: name.to_owned() }, &name_span).maybe_hint(hint)
    }

    fn allow(&self, allowed: bool, what: impl FnOnce() -> String, span: &Range<usize>) -> Result<()> {
        if allowed {
            return Ok(());
        }
        Err(self.wrong(Wrong::NotAllowed { what: what(), place: self.scope.place.to_owned() }, span))
    }

    fn state_name(&self, state: usize) -> String {
        self.context.states.name(state).to_owned()
    }

    fn wrong(&self, problem: Wrong, span: &Range<usize>) -> SpecError {
        SpecError::new(problem).at(self.locate(span))
    }

    fn locate(&self, span: &Range<usize>) -> Span {
        self.snippet.locate(span)
    }
}

fn number(constant: Expression) -> ExpressionMeaning {
    ExpressionMeaning::Number(LinearForm { terms: Vec::new(), constant })
}

/// The form of a plain number.
pub(crate) fn constant(value: f64) -> Linear {
    Linear { terms: Vec::new(), constant: if value == 0.0 { ZERO } else { Expression::Number(value) } }
}
