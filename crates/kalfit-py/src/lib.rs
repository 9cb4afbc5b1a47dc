//! `kalfit._kalfit`: the compiled part of the Python package, thin. Texts, numbers and Arrow tables go in, JSON and Arrow tables
//! come out; everything that people see is made of these in `python/kalfit`.

mod data;
mod errors;
mod fit;
mod jobs;
mod options;
mod run;
mod sums;
mod table;
mod text;

use pyo3::prelude::*;

#[pymodule]
mod _kalfit {
    #[pymodule_export]
    use crate::errors::{DataError, Error, FitError, ModelError};
    #[pymodule_export]
    use crate::fit::Results;
    #[pymodule_export]
    use crate::jobs::{
        apply, best_plan, check, compare, datasheet, exchange, export, fit, plan, predict, simulate, test, validate,
    };
    #[pymodule_export]
    use crate::sums::{PySite, first_theta, join};
    #[pymodule_export]
    use crate::table::PyTable;
    #[pymodule_export]
    use crate::text::{
        applied_summary, compared_summary, datasheet_summary, describe, exported_summary, plan_summary,
        predicted_summary, ratio_summary, read_model, student_quantile, validated_summary, version,
    };

    #[pymodule_init]
    fn init(_: &pyo3::Bound<'_, pyo3::types::PyModule>) -> pyo3::PyResult<()> {
        kalfit_data::keep_quiet_of_broken_files();
        kalfit_job::check_rows_variable().map_err(|failure| crate::errors::exception(&failure))?;
        kalfit_job::fix_instructions(None).map_err(|failure| crate::errors::exception(&failure))
    }
}
