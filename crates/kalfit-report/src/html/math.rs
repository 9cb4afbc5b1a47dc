//! Equations as MathML, which browsers show without help.

use maud::{Markup, PreEscaped, html};

use crate::number::plain;

/// A part of an equation.
pub(super) struct EquationPart(String);

fn element(tag: &str, inner: &str) -> EquationPart {
    EquationPart(format!("<{tag}>{inner}</{tag}>"))
}

fn escaped(text: &str) -> String {
    html! { (text) }.into_string()
}

/// A quantity named by a letter.
pub(super) fn letter(text: &str) -> EquationPart {
    element("mi", &escaped(text))
}

/// A word set upright.
pub(super) fn text(text: &str) -> EquationPart {
    row([element("mtext", &escaped(text)), space()])
}

/// A number.
pub(super) fn number(text: &str) -> EquationPart {
    element("mn", &escaped(text))
}

/// An operator or a bracket.
pub(super) fn op(text: &str) -> EquationPart {
    element("mo", &escaped(text))
}

/// A gap.
pub(super) fn space() -> EquationPart {
    EquationPart("<mspace width=\"0.6em\"></mspace>".to_owned())
}

/// One after the other.
pub(super) fn row(parts: impl IntoIterator<Item = EquationPart>) -> EquationPart {
    element("mrow", &parts.into_iter().map(|part| part.0).collect::<String>())
}

/// With an index.
pub(super) fn sub(base: EquationPart, index: EquationPart) -> EquationPart {
    element("msub", &(base.0 + &index.0))
}

/// An estimate.
pub(super) fn hat(base: &str) -> EquationPart {
    EquationPart(format!("<mover accent=\"true\">{}<mo>^</mo></mover>", letter(base).0))
}

/// The sum over an index.
pub(super) fn sum(index: EquationPart) -> EquationPart {
    EquationPart(format!("<munder><mo>∑</mo>{}</munder>", index.0))
}

/// A matrix of numbers.
pub(super) fn matrix(rows: &[Vec<f64>], digits: usize) -> EquationPart {
    let cell = |x: &f64| element("mtd", &number(&minus(&plain(*x, digits))).0).0;
    let line = |row: &Vec<f64>| element("mtr", &row.iter().map(cell).collect::<String>()).0;
    // the style sheet draws its brackets: few fonts have brackets that grow
    element("mtable", &rows.iter().map(line).collect::<String>())
}

/// A minus as it is printed.
fn minus(number: &str) -> String {
    number.replace('-', "−")
}

/// The equation in a line of text.
pub(super) fn equation(math: EquationPart) -> Markup {
    html! { (PreEscaped(format!("<math>{}</math>", math.0))) }
}
