//! A table that is in memory already, as Arrow lays it out.

use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_schema::{DataType, SchemaRef};
use bytes::Bytes;
use parquet::arrow::ArrowWriter;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;

use crate::error::DataError;

/// Record batches of one schema. A clone shares them, and equals what it was cloned from and nothing else.
#[derive(Debug, Clone)]
pub struct MemoryTable(Arc<SharedBatches>);

#[derive(Debug)]
struct SharedBatches {
    name: String,
    schema: SchemaRef,
    batches: Vec<RecordBatch>,
}

impl PartialEq for MemoryTable {
    fn eq(&self, other: &MemoryTable) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Eq for MemoryTable {}

impl MemoryTable {
    /// A table that messages call by `name`.
    ///
    /// # Errors
    /// A batch of another schema.
    pub fn new(name: String, schema: SchemaRef, batches: Vec<RecordBatch>) -> Result<MemoryTable, DataError> {
        let fits = |batch: &RecordBatch| {
            let (found, expected) = (batch.schema_ref().fields(), schema.fields());
            let same = |(a, b): (&Arc<_>, &Arc<_>)| same_column(a, b);
            found.len() == expected.len() && found.iter().zip(expected).all(same)
        };
        match batches.iter().all(fits) {
            true => Ok(MemoryTable(Arc::new(SharedBatches { name, schema, batches }))),
            false => Err(DataError::Crashed { file: name, format: "Arrow" }),
        }
    }

    /// What messages call it.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    pub(crate) fn schema(&self) -> &SchemaRef {
        &self.0.schema
    }

    pub(crate) fn batches(&self) -> &[RecordBatch] {
        &self.0.batches
    }

    /// What the schema says of the table under this key.
    pub(crate) fn metadata(&self, key: &str) -> Option<&str> {
        self.0.schema.metadata().get(key).map(String::as_str)
    }

    /// True when a column of this name has values of such a type.
    pub(crate) fn has(&self, name: &str, fits: impl Fn(&DataType) -> bool) -> bool {
        self.0.schema.column_with_name(name).is_some_and(|(_, field)| fits(field.data_type()))
    }

    /// The table as a Parquet file, with what the schema says of it, for readers that take nothing else.
    pub(crate) fn to_parquet(&self) -> Result<Bytes, DataError> {
        let mut pairs: Vec<(&String, &String)> = self.0.schema.metadata().iter().collect();
        pairs.sort();
        let pairs = pairs.into_iter().map(|(key, value)| KeyValue::new(key.clone(), value.clone())).collect();
        let properties = WriterProperties::builder().set_key_value_metadata(Some(pairs)).build();
        let written = || {
            let mut writer = ArrowWriter::try_new(Vec::new(), self.0.schema.clone(), Some(properties))?;
            self.0.batches.iter().try_for_each(|batch| writer.write(batch))?;
            writer.into_inner()
        };
        let failed = |source| DataError::Parquet { file: self.0.name.clone(), source: Box::new(source) };
        Ok(Bytes::from(written().map_err(failed)?))
    }
}

/// Whether cells may be missing, and what is noted beside, does not count.
fn same_column(found: &arrow_schema::Field, expected: &arrow_schema::Field) -> bool {
    found.name() == expected.name() && found.data_type() == expected.data_type()
}
