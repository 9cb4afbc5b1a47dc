//! Exceptions, with the same words as the command's messages.

use kalfit_data::DataError as Data;
use kalfit_job::{Failure, OutputError, TruthError};
use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt, PyOSError};

create_exception!(kalfit, Error, PyException, "What kalfit refuses, or cannot do.");
create_exception!(kalfit, ModelError, Error, "Something is wrong with a model or a hypothesis.");
create_exception!(kalfit, DataError, Error, "Something is wrong with the data.");
create_exception!(kalfit, FitError, Error, "The model does not work on the data, or an option does not go with them.");

/// A failure as an exception.
pub(crate) fn exception(failure: &Failure) -> PyErr {
    let text = kalfit_job::render(failure, false);
    let text = in_python(text.strip_prefix("error: ").unwrap_or(&text).trim_end());
    match failure {
        Failure::Interrupted => PyKeyboardInterrupt::new_err(()),
        Failure::Model { .. }
        | Failure::Set { .. }
        | Failure::NotNested(_)
        | Failure::DynamicRatio(_)
        | Failure::Export(_)
        | Failure::HypothesisParameter { .. } => ModelError::new_err(text),
        Failure::Data { .. }
        | Failure::Split { .. }
        | Failure::Reduce { .. }
        | Failure::NoFilter { .. }
        | Failure::NotEstimates { .. }
        | Failure::Compare(_)
        | Failure::Compared(_) => DataError::new_err(text),
        Failure::Truth(error) => match **error {
            TruthError::NoParameter { .. } | TruthError::Value { .. } => ModelError::new_err(text),
            _ => DataError::new_err(text),
        },
        Failure::Output(_)
        | Failure::Write { .. }
        | Failure::NotParquet { .. }
        | Failure::NoExportFormat { .. }
        | Failure::StepBesideData
        | Failure::NoRoom { .. }
        | Failure::Threads { .. }
        | Failure::ThreadsVariable { .. } => Error::new_err(text),
        _ => FitError::new_err(text),
    }
}

/// A file that could not be written.
pub(crate) fn not_written(error: &OutputError) -> PyErr {
    PyOSError::new_err(error.to_string())
}

/// Options that messages name as on the command line, and their names in Python.
const OPTIONS: [(&str, &str); 16] = [
    ("as", "format"),
    ("at", "at"),
    ("by", "by"),
    ("criterion", "criterion"),
    ("df", "df"),
    ("from", "source"),
    ("out", "out"),
    ("phase", "phase"),
    ("phases", "phases"),
    ("set", "set"),
    ("starts", "starts"),
    ("std-errors", "std_errors"),
    ("step", "step"),
    ("test", "test"),
    ("threads", "threads"),
    ("units", "units"),
];

/// A message with the options of the command line, which stand in backticks, in Python's words: `--phases chain` is
/// `phases="chain"`, `--set tau=VALUE` is `set={"tau": VALUE}`.
fn in_python(message: &str) -> String {
    let mut text = String::new();
    let mut rest = message;
    while let Some(start) = rest.find("`--") {
        let (before, quoted) = (&rest[..start], &rest[start + 1..]);
        text.push_str(before);
        let Some(end) = quoted.find('`') else { break };
        match argument(&quoted[2..end]) {
            Some(words) => text.push_str(&format!("`{words}`")),
            None => text.push_str(&rest[start..start + end + 2]),
        }
        rest = &quoted[end + 1..];
    }
    text + rest
}

/// An option with its value, if it has one, as an argument.
fn argument(option: &str) -> Option<String> {
    let (name, value) = option.split_once(' ').map_or((option, None), |(name, value)| (name, Some(value)));
    let name = OPTIONS.iter().find(|(known, _)| *known == name)?.1;
    Some(match value {
        None => name.to_owned(),
        Some(value) => match value.split_once('=') {
            Some((key, value)) => format!("{name}={{\"{key}\": {value}}}"),
            None if value.parse::<f64>().is_ok() => format!("{name}={value}"),
            None => format!("{name}=\"{value}\""),
        },
    })
}

/// Wrong data that are in memory.
pub(crate) fn data_exception(error: &Data) -> PyErr {
    DataError::new_err(error.to_string())
}
