//! Tables in memory.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use kalfit::{Layout, TestKey};
use kalfit_data::exchange::{InputContent, sort};
use kalfit_data::{DataError, Datum, Input, MemoryTable};

use crate::support::{collect, collect_stdin, model, shown};

fn schema() -> SchemaRef {
    Arc::new(Schema::new(vec![Field::new("id", DataType::Utf8, true), Field::new("y", DataType::Float64, true)]))
}

fn batch(ids: &[&str], values: &[Option<f64>]) -> RecordBatch {
    let columns: [ArrayRef; 2] =
        [Arc::new(StringArray::from(ids.to_vec())), Arc::new(Float64Array::from(values.to_vec()))];
    RecordBatch::try_new(schema(), columns.to_vec()).expect("the columns are those of the schema")
}

fn table(name: &str, batches: Vec<RecordBatch>) -> MemoryTable {
    MemoryTable::new(name.to_owned(), schema(), batches).expect("the batches have the schema")
}

fn by(column: &str) -> Layout {
    Layout { test: TestKey::Column(column.to_owned()), ..Layout::default() }
}

#[test]
fn batches_in_memory_are_read_as_rows_of_a_file_are() {
    // `a` comes back in the second batch, so that everything is read twice
    let batches = vec![batch(&["a", "b"], &[Some(1.5), None]), batch(&["a", "c"], &[Some(-2.0), Some(0.1)])];
    let (model, layout) = (model(&["y"], &[], None), by("id"));
    let memory = [Input::Table(table("data", batches))];
    let (found, reading) = collect(&model, &layout, &memory, &mut std::io::empty()).unwrap();
    let (expected, text) = collect_stdin(&model, &layout, b"id,y\na,1.5\nb,\na,-2\nc,0.1\n").unwrap();
    assert_eq!(shown(&found.tests, &reading.labels), shown(&expected.tests, &text.labels));
    assert_eq!((reading.rows, reading.files, found.restarts), (4, vec!["data".to_owned()], 1));
}

#[test]
fn tables_and_files_stand_side_by_side_and_no_table_twice() {
    let one = table("one", vec![batch(&["a"], &[Some(1.0)])]);
    let other = table("one", vec![batch(&["b"], &[Some(2.0)])]);
    let both = [Datum::Table(one.clone()), Datum::Table(other.clone())];
    assert_eq!(Input::expand(&both).unwrap(), [Input::Table(one.clone()), Input::Table(other)]);
    let twice = Input::expand(&[Datum::Table(one.clone()), Datum::Table(one)]).unwrap_err();
    assert!(matches!(twice, DataError::SameFile { .. }), "{twice}");
}

#[test]
fn messages_name_the_table_the_row_and_the_column() {
    let wrong = table("rows", vec![batch(&["a"], &[Some(1.0)]), batch(&["a"], &[Some(f64::INFINITY)])]);
    let error = collect(&model(&["y"], &[], None), &by("id"), &[Input::Table(wrong)], &mut std::io::empty());
    assert_eq!(error.unwrap_err().to_string(), "rows, row 2, column `y`: found `inf`, expected a finite number");
    let empty = [Input::Table(table("rows", Vec::new()))];
    let error = collect(&model(&["y"], &[], None), &by("id"), &empty, &mut std::io::empty()).unwrap_err();
    assert_eq!(error.to_string(), "rows has no rows");
}

#[test]
fn batches_of_another_schema_are_refused() {
    let other = Arc::new(Schema::new(vec![Field::new("z", DataType::Float64, true)]));
    let refused = MemoryTable::new("rows".to_owned(), other, vec![batch(&["a"], &[None])]).unwrap_err();
    assert!(matches!(refused, DataError::Crashed { .. }), "{refused}");
}

#[test]
fn what_the_schema_says_tells_reductions_from_rows() {
    let of = |metadata: HashMap<String, String>| {
        let schema = Arc::new(schema().as_ref().clone().with_metadata(metadata));
        let batch = batch(&["a"], &[Some(1.0)]).with_schema(schema.clone()).unwrap();
        let table = MemoryTable::new("rows".to_owned(), schema, vec![batch]).unwrap();
        sort(&[Input::Table(table)], Box::new(std::io::empty())).map(|sorted| sorted.contents)
    };
    assert_eq!(of(HashMap::new()).unwrap(), [InputContent::Rows]);
    let says = |what: &str| HashMap::from([("kalfit.schema".to_owned(), what.to_owned())]);
    assert_eq!(of(says("kalfit-reductions/1")).unwrap(), [InputContent::Reductions]);
    assert!(of(says("kalfit-reductions/9")).unwrap_err().to_string().contains("kalfit-reductions/9"));
}
