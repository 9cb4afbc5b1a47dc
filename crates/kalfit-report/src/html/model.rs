//! The model: what is common to all, in equations, and this one in words.

use kalfit::FitRecord;
use maud::{Markup, html};

use crate::html::math::equation;
use crate::html::math::{self, EquationPart};
use crate::html::section::PageSection;
use crate::page::coded;
use crate::summary::places;
use crate::words::{clean, list};

/// No more facts than this; the model file has them all.
const MOST_FACTS: usize = 400;

pub(super) fn section(record: &FitRecord) -> Option<PageSection> {
    let facts = &record.model[..record.model.len().min(MOST_FACTS)];
    let left = record.model.len() - facts.len();
    let body = html! {
        (equations(record))
        @if facts.is_empty() { p { "These results were written by an earlier version and do not describe the model." } }
        @else {
            h3 { "This model" }
            ul.facts { @for fact in facts { li { (coded(&clean(fact))) } } }
            @if left > 0 { p { "… and " (left) " more facts." } }
        }
    };
    PageSection::new("model", "Model", body)
}

/// What every model is.
fn equations(record: &FitRecord) -> Markup {
    use math::{hat, letter, op, row, sub};
    let phased = record.phases.len() > 1;
    let regression = record.phases.iter().any(|phase| !phase.mean.regression.is_empty());
    let x = |k: EquationPart| sub(letter("x"), k);
    let j = || letter("j");
    let normal =
        |mean: EquationPart, variance: EquationPart| row([letter("N"), op("("), mean, op(","), variance, op(")")]);
    let mean =
        if regression { row([letter("μ"), op("+"), sub(letter("D"), j()), letter("β")]) } else { letter("μ") };
    let step = || row([letter("k"), op("−"), math::number("1")]);
    html! {
        p {
            "Each test " (equation(j())) " starts from its own random initial state, and then follows the model of a Kalman filter. \
             The fit finds the mean " (equation(letter("μ"))) " and the covariance "
            (equation(letter("Σ"))) " of the initial states"
            @if record.parameters.iter().any(|p| !p.fixed) { ", and the dynamic parameters " (equation(letter("α"))) }
            " that maximise the likelihood of all measurements"
            @if record.criterion == "reml" { " (restricted likelihood: that of the residuals of the mean)" }
            "."
        }
        div.equations {
            (equation(row([x(row([math::number("0"), op(","), j()])), op("~"), normal(mean, letter("Σ"))])))
            (equation(row([x(letter("k")), op("="), letter("Φ"), x(step()), op("+"), sub(letter("w"), letter("k")), op(","),
                math::space(), sub(letter("w"), letter("k")), op("~"), normal(math::number("0"), letter("Q"))])))
            (equation(row([sub(letter("z"), letter("k")), op("="), letter("H"), x(letter("k")), op("+"),
                sub(letter("v"), letter("k")), op(","), math::space(), sub(letter("v"), letter("k")), op("~"),
                normal(math::number("0"), letter("R"))])))
            (equation(row([op("("), hat("μ"), op(","), hat("Σ"), op(","), hat("α"), op(")"), op("="), math::text("arg max"),
                math::sum(j()), math::text("log"), letter("p"), op("("), sub(letter("z"), j()), op("∣"),
                letter("μ"), op(","), letter("Σ"), op(","), letter("α"), op(")")])))
        }
        @if let Some(unit) = places::innermost(record) {
            p { "Tests belong to groups. " (equation(letter("Σ"))) " is the covariance within one " (unit) "; each group adds its own \
                 random contribution to the initial states of its tests, with mean zero and the covariance of its level." }
        }
        @if !record.crossed.is_empty() {
            p { "Tests that meet one level of a crossed factor (" (factors(record)) ") share its effect on their initial states, which \
                 has mean zero and the covariance of the factor." }
        }
        @if phased {
            p { "A test has several phases, each with its own random initial state; a later phase inherits from the end of the one \
                 before it as the model defines." }
        }
    }
}

/// The names of the crossed factors.
fn factors(record: &FitRecord) -> String {
    let names: Vec<String> = record.crossed.iter().map(|factor| clean(&factor.level.name)).collect();
    list(&names, usize::MAX)
}
