//! Data that are asked for: names of files, and tables in memory by Arrow's C stream, without a copy.

use arrow_array::ffi_stream::RecordBatchStreamReader;
use arrow_array::{RecordBatch, RecordBatchReader};
use arrow_pyarrow::FromPyArrow;
use arrow_schema::SchemaRef;
use kalfit_data::{Datum, MemoryTable};
use pyo3::prelude::*;

use crate::errors::{DataError, data_exception};

/// Each datum is the name of a file or a pattern, or a pair: what messages call a table, and the table.
#[derive(FromPyObject)]
pub(crate) enum PyDatum<'py> {
    Named(String),
    Table(String, Bound<'py, PyAny>),
}

/// The data for a job.
pub(crate) fn data(given: Vec<PyDatum<'_>>) -> PyResult<Vec<Datum>> {
    given.into_iter().map(datum).collect()
}

fn datum(given: PyDatum<'_>) -> PyResult<Datum> {
    let (name, table) = match given {
        PyDatum::Named(name) => return Ok(Datum::Named(name)),
        PyDatum::Table(name, table) => (name, table),
    };
    let (schema, batches) = batches(&name, &table)?;
    Ok(Datum::Table(MemoryTable::new(name, schema, batches).map_err(|error| data_exception(&error))?))
}

/// The batches of whatever has `__arrow_c_stream__`.
pub(crate) fn batches(name: &str, table: &Bound<'_, PyAny>) -> PyResult<(SchemaRef, Vec<RecordBatch>)> {
    let reader = RecordBatchStreamReader::from_pyarrow_bound(table)?;
    let schema = reader.schema();
    let batches: Result<Vec<RecordBatch>, _> = reader.collect();
    let batches = batches.map_err(|error| DataError::new_err(format!("{name} is not a sound Arrow table: {error}")))?;
    Ok((schema, batches))
}
