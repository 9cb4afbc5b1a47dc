//! Models and results as texts: read, checked, summed up.

use kalfit::TestKey;
use kalfit::compare::ComparedRecord;
use kalfit::record::{AppliedRecord, DatasheetRecord, ExportRecord, PlanRecord, PredictedRecord, RatioRecord};
use kalfit::validate::ValidatedRecord;
use kalfit_job::Document;
use kalfit_report::TextStyle;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde::de::DeserializeOwned;

use crate::errors::exception;
use crate::options::NamedText;

/// Version of the package.
#[pyfunction]
pub(crate) fn version() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

/// The quantile of Student's t with `df` degrees of freedom; none where its size exceeds all use.
#[pyfunction]
pub(crate) fn student_quantile(p: f64, df: f64) -> Option<f64> {
    kalfit::infer::student_quantile(df, p)
}

/// The text of a model file, which is sound.
#[pyfunction]
pub(crate) fn read_model(path: std::path::PathBuf) -> PyResult<String> {
    let spec = kalfit_job::read_model(&Document::File(path)).map_err(|failure| exception(&failure))?;
    Ok(spec.text)
}

/// (title, digest, the model in words, the names of its parameters, the column that tells tests apart, the column of time, the
/// columns of groups, the outermost first) of a model's text, which is sound.
type ModelDescription = (String, String, Vec<String>, Vec<String>, Option<String>, Option<String>, Vec<String>);

/// What a model's text says.
#[pyfunction]
pub(crate) fn describe(model: NamedText) -> PyResult<ModelDescription> {
    let spec = kalfit_job::read_model(&model.into()).map_err(|failure| exception(&failure))?;
    let shared = spec.model.shared();
    let names = shared.parameters.iter().map(|parameter| parameter.name.clone()).collect();
    let test = match &spec.layout.test {
        TestKey::Column(name) => Some(name.clone()),
        TestKey::Single | TestKey::File | TestKey::Row => None,
    };
    let time = shared.clock.time.map(|column| shared.columns[column].name.clone());
    let levels = spec.layout.levels.clone();
    Ok((shared.title.clone(), spec.digest.clone(), spec.describe(), names, test, time, levels))
}

/// Summary of the JSON of a likelihood-ratio test.
#[pyfunction]
pub(crate) fn ratio_summary(json: &str, width: usize, color: bool) -> PyResult<String> {
    Ok(kalfit_report::ratio_summary(&read::<RatioRecord>(json)?, &TextStyle { width, color }))
}

/// Summary of the JSON of a fitted model that was applied.
#[pyfunction]
pub(crate) fn applied_summary(json: &str, width: usize, color: bool) -> PyResult<String> {
    Ok(kalfit_report::applied_summary(&read::<AppliedRecord>(json)?, &TextStyle { width, color }))
}

/// Summary of the JSON of fits side by side.
#[pyfunction]
pub(crate) fn compared_summary(json: &str, width: usize, color: bool) -> PyResult<String> {
    Ok(kalfit_report::compared_summary(&read::<ComparedRecord>(json)?, &TextStyle { width, color }))
}

/// Summary of the JSON of a datasheet.
#[pyfunction]
pub(crate) fn datasheet_summary(json: &str, width: usize, color: bool) -> PyResult<String> {
    Ok(kalfit_report::datasheet_summary(&read::<DatasheetRecord>(json)?, &TextStyle { width, color }))
}

/// Summary of the JSON of a filter.
#[pyfunction]
pub(crate) fn exported_summary(json: &str, width: usize, color: bool) -> PyResult<String> {
    Ok(kalfit_report::exported_summary(&read::<ExportRecord>(json)?, &TextStyle { width, color }))
}

/// Summary of the JSON of a plan.
#[pyfunction]
pub(crate) fn plan_summary(json: &str, width: usize, color: bool) -> PyResult<String> {
    Ok(kalfit_report::plan_summary(&read::<PlanRecord>(json)?, &TextStyle { width, color }))
}

/// Summary of the JSON of predictions.
#[pyfunction]
pub(crate) fn predicted_summary(json: &str, width: usize, color: bool) -> PyResult<String> {
    Ok(kalfit_report::predicted_summary(&read::<PredictedRecord>(json)?, &TextStyle { width, color }))
}

/// Summary of the JSON of a validation.
#[pyfunction]
pub(crate) fn validated_summary(json: &str, width: usize, color: bool) -> PyResult<String> {
    Ok(kalfit_report::validated_summary(&read::<ValidatedRecord>(json)?, &TextStyle { width, color }))
}

fn read<T: DeserializeOwned>(json: &str) -> PyResult<T> {
    serde_json::from_str(json).map_err(|error| PyValueError::new_err(format!("these are no such results: {error}")))
}

/// A record as the command writes it to a file.
pub(crate) fn written(record: &impl serde::Serialize) -> PyResult<String> {
    text(record).map(|text| text + "\n")
}

/// A record as JSON.
pub(crate) fn text(record: &impl serde::Serialize) -> PyResult<String> {
    kalfit_job::json::to_string(record).map_err(|error| PyValueError::new_err(error.to_string()))
}
