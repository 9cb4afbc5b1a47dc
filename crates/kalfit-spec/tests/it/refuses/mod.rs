//! What is refused, and what the message says: the problem, the text that its span covers, and the hint.

mod covariance;
mod expressions;
mod files_and_data;
mod filter;
mod levels;
mod mean;
mod measurements;
mod parameters;
mod phases;
mod states;

use kalfit_spec::Spec;

/// Two constants, where a model says nothing of states.
const STATES: &str = "[states]\na = {}\nb = {}\n";
/// One measurement, where a model says nothing of measurements.
const MEASUREMENTS: &str = "[measurements.y]\ncolumn = \"y\"\nequation = \"a\"\nnoise = 1\n";

/// The message about a model, which is completed by what it does not speak of.
fn refusal(text: &str) -> String {
    let mut text = text.to_owned();
    for (header, rest) in [("[states", STATES), ("[measurements", MEASUREMENTS)] {
        if !text.contains(header) && !text.contains("phases") {
            text.push_str(rest);
        }
    }
    let error = match Spec::parse("model.toml", &text) {
        Ok(_) => return "accepted".to_owned(),
        Err(error) => error,
    };
    let mut lines = vec![error.message];
    lines.extend(error.span.map(|span| format!("at   {:?}", &text[span])));
    lines.extend(error.hint.map(|hint| format!("hint {hint}")));
    lines.join("\n")
}

/// The message, its parts in one line: what is wrong | at "the text" | hint what helps.
fn refusal_in_one_line(text: &str) -> String {
    refusal(text).replace("\nat   ", " | at ").replace("\nhint ", " | hint ")
}
