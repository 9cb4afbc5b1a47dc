//! Arrow tables for Python.

use std::fs::File;
use std::io::{Seek, SeekFrom};
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, StringBuilder};
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::{ArrayRef, Float64Array, RecordBatch, RecordBatchIterator, StringArray};
use arrow_ipc::reader::FileReader;
use arrow_schema::ArrowError;
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use crate::data::batches;
use crate::errors::Error;

/// Record batches that any Arrow library takes by their C stream.
#[pyclass(frozen, name = "Table", module = "kalfit._kalfit")]
pub(crate) struct PyTable {
    schema: SchemaRef,
    batches: Vec<RecordBatch>,
}

#[pymethods]
impl PyTable {
    /// Takes any table with `__arrow_c_stream__`; `metadata` is added to what its schema says of it.
    #[new]
    #[pyo3(signature = (table, metadata = Vec::new()))]
    fn new(table: &Bound<'_, PyAny>, metadata: Vec<(String, String)>) -> PyResult<PyTable> {
        let (schema, parts) = batches("the table", table)?;
        let mut known = schema.metadata().clone();
        known.extend(metadata);
        let schema = Arc::new(schema.as_ref().clone().with_metadata(known));
        let parts = parts.into_iter().map(|batch| batch.with_schema(schema.clone()));
        let batches = parts.collect::<Result<_, _>>().map_err(|error| failed(&error))?;
        Ok(PyTable { schema, batches })
    }

    #[pyo3(signature = (requested_schema = None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema; // the protocol lets a producer give what it has
        let all: Vec<Result<RecordBatch, ArrowError>> = self.batches.iter().cloned().map(Ok).collect();
        let reader = RecordBatchIterator::new(all, self.schema.clone());
        let stream = FFI_ArrowArrayStream::new(Box::new(reader));
        PyCapsule::new_with_value(py, stream, c"arrow_array_stream")
    }

    /// Of columns of texts, and columns of 64-bit floats in the machine's own order of bytes.
    #[staticmethod]
    fn columns(texts: Vec<(String, Vec<String>)>, numbers: Vec<(String, Vec<u8>)>) -> PyResult<PyTable> {
        let (mut fields, mut arrays): (Vec<Field>, Vec<ArrayRef>) = (Vec::new(), Vec::new());
        for (name, texts) in texts {
            fields.push(Field::new(name, DataType::Utf8, true));
            arrays.push(Arc::new(StringArray::from(texts)));
        }
        for (name, bytes) in numbers {
            let (values, _) = bytes.as_chunks::<8>();
            fields.push(Field::new(name, DataType::Float64, true));
            arrays
                .push(Arc::new(values.iter().map(|&bytes| Some(f64::from_ne_bytes(bytes))).collect::<Float64Array>()));
        }
        let schema = Arc::new(Schema::new(fields));
        let batch = RecordBatch::try_new(schema.clone(), arrays).map_err(|error| failed(&error))?;
        Ok(PyTable { schema, batches: vec![batch] })
    }

    /// Names of the columns.
    fn column_names(&self) -> Vec<String> {
        self.schema.fields().iter().map(|field| field.name().clone()).collect()
    }

    /// What the schema says of the table, by key.
    fn metadata(&self) -> Vec<(String, String)> {
        let mut pairs: Vec<_> =
            self.schema.metadata().iter().map(|(key, value)| (key.clone(), value.clone())).collect();
        pairs.sort();
        pairs
    }

    fn __len__(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }
}

impl PyTable {
    /// Of a Parquet file.
    pub(crate) fn parquet(file: File) -> PyResult<PyTable> {
        let read = || -> Result<PyTable, Box<dyn std::error::Error>> {
            let builder = ParquetRecordBatchReaderBuilder::try_new(file)?;
            let schema = builder.schema().clone();
            let batches = builder.build()?.map(|batch| batch?.with_schema(schema.clone())).collect::<Result<_, _>>()?;
            Ok(PyTable { schema: schema.clone(), batches })
        };
        read().map_err(|error| Error::new_err(format!("a temporary file could not be read back: {error}")))
    }

    /// Of an Arrow IPC file.
    pub(crate) fn ipc(mut file: File) -> PyResult<PyTable> {
        let mut read = || -> Result<PyTable, Box<dyn std::error::Error>> {
            file.seek(SeekFrom::Start(0))?;
            let reader = FileReader::try_new_buffered(&mut file, None)?;
            Ok(PyTable { schema: reader.schema(), batches: reader.collect::<Result<_, _>>()? })
        };
        read().map_err(|error| Error::new_err(format!("a temporary file could not be read back: {error}")))
    }

    /// One row a test: its id, and a number for each name, as far as there are any.
    pub(crate) fn of_rows(names: &[String], rows: &[(String, Vec<f64>)]) -> PyResult<PyTable> {
        let mut all = std::iter::once("test".to_owned()).chain((2_u32..).map(|k| format!("test_{k}")));
        let id = all.find(|name| !names.contains(name)).expect("one of so many names is free");
        let mut ids = StringBuilder::new();
        let mut columns: Vec<Float64Builder> = names.iter().map(|_| Float64Builder::new()).collect();
        for (test, values) in rows {
            ids.append_value(test);
            columns.iter_mut().enumerate().for_each(|(i, column)| column.append_option(values.get(i).copied()));
        }
        let numbers = names.iter().map(|name| Field::new(name, DataType::Float64, true));
        let fields: Vec<Field> = std::iter::once(Field::new(id, DataType::Utf8, true)).chain(numbers).collect();
        let schema = Arc::new(Schema::new(fields));
        let mut arrays: Vec<ArrayRef> = vec![Arc::new(ids.finish())];
        arrays.extend(columns.iter_mut().map(|column| Arc::new(column.finish()) as ArrayRef));
        let batch = RecordBatch::try_new(schema.clone(), arrays).map_err(|error| failed(&error))?;
        Ok(PyTable { schema, batches: vec![batch] })
    }
}

fn failed(error: &ArrowError) -> PyErr {
    Error::new_err(format!("the table could not be made: {error}"))
}
