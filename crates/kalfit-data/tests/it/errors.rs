//! Every error: what it says, and what it advises.

#![expect(clippy::unwrap_used, reason = "also in what the tests share")]

use crate::support;

use std::fs;
use std::sync::Arc;

use arrow_array::types::Int64Type;
use arrow_array::{
    ArrayRef, BinaryArray, BooleanArray, Float64Array, Int64Array, ListArray, NullArray, StringArray,
    TimestampSecondArray,
};
use arrow_ipc::writer::IpcWriteOptions;
use insta::assert_snapshot;
use kalfit::{Layout, PhasedModel, TestKey};
use kalfit_data::{DataError, Input};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;
use support::*;

/// The message and the hint.
fn said(error: &DataError) -> String {
    match error.hint() {
        Some(hint) => format!("{error}\nhint: {hint}"),
        None => error.to_string(),
    }
}

/// What is said of bytes on standard input, read with a model of a number `y`, a text `lot` and a test column `id`.
fn refused(bytes: &[u8]) -> String {
    refused_by(&model(&["y"], &["lot"], None), bytes)
}

fn refused_by(model: &PhasedModel, bytes: &[u8]) -> String {
    said(&collect_stdin(model, &by("id"), bytes).expect_err("the data are wrong"))
}

/// What is said of a time column `t` in a test column `id`.
fn refused_times(bytes: &[u8], unit: Option<&str>) -> String {
    let mut model = model(&["t"], &[], Some("t"));
    model.phases[0].model.clock.unit = unit.map(str::to_owned);
    refused_by(&model, bytes)
}

fn refused_y(array: ArrayRef) -> String {
    let id = Arc::new(Int64Array::from_iter_values(0..array.len() as i64)) as ArrayRef;
    refused_by(&model(&["y"], &[], None), &arrow_stream(&batch(vec![("id", id), ("y", array)]), 2))
}

/// What is said of arguments, in a folder of a few files.
fn refused_args(args: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.csv", "b.csv", "sub/c.csv"] {
        write(folder.path(), name, b"id,y,lot\n1,2,A\n");
    }
    let root = folder.path().display().to_string();
    let args: Vec<String> = args.iter().map(|arg| arg.replace("ROOT", &root)).collect();
    let inputs = Input::expand(&args);
    let error = match inputs {
        Err(error) => error,
        Ok(inputs) => {
            let layout = Layout {
                test: TestKey::File,
                levels: Vec::new(),
                crossed: Vec::new(),
                missing: Vec::new(),
                comment: None,
            };
            collect(&model(&["y"], &[], None), &layout, &inputs, &mut std::io::empty()).expect_err("a bad argument")
        }
    };
    said(&error).replace(&root, "ROOT")
}

#[test]
fn arguments() {
    assert_snapshot!(refused_args(&[]), @"no data were given: expected a file, a pattern or `-`");
    assert_snapshot!(refused_args(&["ROOT/[a"]), @r"
    `ROOT/[a` is not a pattern of file names: invalid range pattern at character 17
    hint: give the file's whole name, or write `[*]` for a star and `[?]` for a question mark
    ");
    assert_snapshot!(refused_args(&["ROOT/*.parquet"]), @r"
    no file matches `ROOT/*.parquet`
    hint: `*` stands for any text, `?` for one character, `[ab]` for a or b, `**/` for any folders
    ");
    assert_snapshot!(refused_args(&["ROOT/none.csv"]), @"cannot read ROOT/none.csv: No such file or directory (os error 2)");
    assert_snapshot!(refused_args(&["ROOT/sub"]), @r"
    `ROOT/sub` is a directory, expected a file
    hint: give its files: `ROOT/sub/*.csv`
    ");
    assert_snapshot!(refused_args(&["ROOT/a.csv", "ROOT/*.csv"]), @r"
    the same data were given twice: `ROOT/a.csv` and `ROOT/a.csv`
    hint: give each file once: its rows would count twice
    ");
    assert_snapshot!(refused_args(&["-", "-"]), @r"
    the same data were given twice: `standard input` and `standard input`
    hint: give each file once: its rows would count twice
    ");
    let twice = [Input::Path("a.csv".into()), Input::Path("a.csv".into())];
    let layout =
        Layout { test: TestKey::File, levels: Vec::new(), crossed: Vec::new(), missing: Vec::new(), comment: None };
    let error = collect(&model(&["y"], &[], None), &layout, &twice, &mut std::io::empty()).unwrap_err();
    assert_snapshot!(said(&error), @r#"
    `a.csv` and `a.csv` would both be test `a.csv`
    hint: with `test = "@file"` each file needs a name of its own
    "#);
}

#[test]
fn patterns_are_sorted_and_existing_paths_win() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["b.csv", "a.csv", "[a].csv", "d.csv/x"] {
        write(folder.path(), name, b"y\n1\n");
    }
    let expand = |name: &str| {
        let inputs = Input::expand(&[folder.path().join(name).display().to_string()]).unwrap();
        inputs.iter().map(|i| i.name().rsplit('/').next().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(expand("*.csv"), ["[a].csv", "a.csv", "b.csv"]);
    assert_eq!(expand("[a].csv"), ["[a].csv"]);
    fs::remove_file(folder.path().join("[a].csv")).unwrap();
    assert_eq!(expand("[a].csv"), ["a.csv"]);
}

#[test]
fn kinds_of_files() {
    assert_snapshot!(refused(b""), @"standard input is empty, expected a header and rows");
    assert_snapshot!(refused(b"\x1f\x8b\x08\0\0\0\0\0\0\x03"), @r"
    standard input is compressed with gzip, expected CSV, Parquet or Arrow IPC
    hint: unpack it first, for instance `gunzip -c data.csv.gz | kalfit fit model.toml -`
    ");
    assert_snapshot!(refused(b"PK\x03\x04..........."), @r"
    standard input is a zip archive or an Excel workbook, expected CSV, Parquet or Arrow IPC
    hint: save the sheet as CSV
    ");
    assert_snapshot!(refused(b"FEA1\0\0\0\0"), @r"
    standard input is a Feather file of version 1, expected CSV, Parquet or Arrow IPC
    hint: write it again as Feather version 2, which is Arrow IPC, or as Parquet
    ");
    assert_snapshot!(refused(b"\xff\xfei\0d\0,\0y\0\n\0"), @r"
    standard input, row 1: found bytes that are not UTF-8 text
    hint: save the file as UTF-8
    ");
}

#[test]
fn headers() {
    assert_snapshot!(refused(b"id,y,lot\n"), @"standard input has no rows");
    assert_snapshot!(refused(b"\n\r\n\n"), @"standard input is empty, expected a header and rows");
    assert_snapshot!(refused(b"id,Y ,lot\n1,2,3\n"), @r"
    standard input has no column `y`, which is used in equation of measurement `m_y`
    hint: there is a column `Y`
    ");
    assert_snapshot!(refused(b"id,angle,lot\n1,2,3\n"), @r"
    standard input has no column `y`, which is used in equation of measurement `m_y`
    hint: its columns are `id`, `angle`, `lot`
    ");
    assert_snapshot!(refused(b"Id,y,lot\n1,2,3\n"), @r"
    standard input has no column `id`, which is used in `test` of `[data]`
    hint: there is a column `Id`
    ");
    assert_snapshot!(refused(b"id,y,lot,z,y\n1,2,3,4,5\n"), @r"
    standard input has two columns named `y`: its columns 2 and 5
    hint: rename one of them: the model cannot tell which is meant
    ");
    assert_snapshot!(refused(b"id,y,l\xf6t\n1,2,3\n"), @r"
    standard input, row 1: found bytes that are not UTF-8 text
    hint: save the file as UTF-8
    ");
    assert_snapshot!(refused(b"id,y,lot\r1,2,3\r4,5,6\r"), @r"
    standard input, row 1: found carriage returns alone, expected lines that end with LF or CRLF
    hint: save the file with the line ends of Unix or Windows
    ");
}

#[test]
fn rows() {
    assert_snapshot!(refused(b"id,y,lot\n1,2,A\n1,2\n"), @r"
    standard input, row 3: found 2 cells, expected 3 as in the header
    hint: a missing cell still needs its delimiter
    ");
    assert_snapshot!(refused(b"id,y,lot\n1,2,A\n\n1,0,5,B\n"), @r"
    standard input, row 4: found 4 cells, expected 3 as in the header
    hint: a cell that contains the delimiter needs quotes; a decimal comma needs another delimiter
    ");
    assert_snapshot!(refused(b"id,y,lot\n1,2,\"A\nB\n1,2,A\n1\",\"\"\n"), @r"
    standard input, row 2: found 4 cells, expected 3 as in the header
    hint: the row runs over 4 lines: a quote may not be closed
    ");
    assert_snapshot!(refused(b"id,y,lot,note\n1,2,A,\n1,2,B,\"never closed\n1,2,B,\n"), @r#"
    standard input, row 3: found a quote that is still open at the end of the file, expected another `"`
    hint: a quote opens a cell that ends at the next quote; write `""` for a quote inside it
    "#);
    assert_snapshot!(refused_by(&model(&["id"], &[], None), b"id\n1\n\n2\n"), @r"
    standard input, row 3: found a blank line in a file of one column, expected a value or `NA`
    hint: write `NA` for a missing cell, or remove the line
    ");
    assert_snapshot!(refused_by(&model(&["id"], &[], None), b"id\r\n1\r\n\r\n2\r\n"), @r"
    standard input, row 3: found a blank line in a file of one column, expected a value or `NA`
    hint: write `NA` for a missing cell, or remove the line
    ");
    assert_snapshot!(refused(b"id,y,lot\n1,2,\xff\n"), @r"
    standard input, row 2: found bytes that are not UTF-8 text in column `lot`
    hint: save the file as UTF-8
    ");
}

#[test]
fn blank_lines_at_the_end_of_one_column_are_nothing() {
    let (sink, _) = collect_stdin(&model(&["y"], &[], None), &Layout::default(), b"y\n1\nNA\n\"\"\n\n\n").unwrap();
    assert_eq!(sink.tests[0].rows(), 3);
}

#[test]
fn numbers() {
    let cell = |text: &str| refused(format!("id;y;lot\n1;1;A\n1;{text};A\n").as_bytes());
    assert_snapshot!(cell("1,5"), @r"
    standard input, row 3, column `y`: found `1,5`, expected a number
    hint: write the decimal comma as `.`
    ");
    assert_snapshot!(cell("1,500"), @r"
    standard input, row 3, column `y`: found `1,500`, expected a number
    hint: write a decimal comma as `.`, and leave out a separator of thousands
    ");
    assert_snapshot!(cell("-1,234,567.5"), @r"
    standard input, row 3, column `y`: found `-1,234,567.5`, expected a number
    hint: leave out the separators of thousands
    ");
    assert_snapshot!(cell("12'345"), @r"
    standard input, row 3, column `y`: found `12'345`, expected a number
    hint: leave out the separators of thousands
    ");
    assert_snapshot!(cell("5 deg"), @r"
    standard input, row 3, column `y`: found `5 deg`, expected a number
    hint: a cell holds a number and nothing else; units go into the model file
    ");
    assert_snapshot!(cell("bad"), @r"
    standard input, row 3, column `y`: found `bad`, expected a number
    hint: a text is compared, as in `if(y == 'bad', 1, 0)`; leave a missing cell empty, or add its text to `missing` of `[data]`
    ");
    assert_snapshot!(cell("TRUE"), @r"
    standard input, row 3, column `y`: found `TRUE`, expected a number
    hint: write 1 for true and 0 for false
    ");
    assert_snapshot!(cell("2024-01-01 10:00"), @r"
    standard input, row 3, column `y`: found `2024-01-01 10:00`, expected a number
    hint: date-times are read in the column that `time` of `[data]` names, and nowhere else
    ");
    assert_snapshot!(cell("-inf"), @r"
    standard input, row 3, column `y`: found `-inf`, expected a finite number
    hint: write `NA` where there is no measurement
    ");
    assert_snapshot!(cell("1e400"), @r"
    standard input, row 3, column `y`: found `1e400`, expected a finite number
    hint: write `NA` where there is no measurement
    ");
    assert_snapshot!(cell(&"\u{7}x".repeat(100)), @r"
    standard input, row 3, column `y`: found `\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x\u{7}x…`, expected a number
    hint: leave a missing cell empty, or add its text to `missing` of `[data]`
    ");
}

#[test]
fn numbers_in_record_batches() {
    assert_snapshot!(refused_y(Arc::new(Float64Array::from(vec![1.0, 2.0, f64::INFINITY]))), @r"
    standard input, row 3, column `y`: found `inf`, expected a finite number
    hint: write `NA` where there is no measurement
    ");
    assert_snapshot!(refused_y(Arc::new(StringArray::from(vec!["1", "2", "3,5"]))), @r"
    standard input, row 3, column `y`: found `3,5`, expected a number
    hint: write the decimal comma as `.`
    ");
    assert_snapshot!(refused_y(Arc::new(BinaryArray::from(vec![b"1".as_slice()]))), @r"
    standard input, column `y`: found values of type Binary, expected numbers (used in equation of measurement `m_y`)
    hint: write the column as text (UTF-8), not as bytes
    ");
    assert_snapshot!(refused_y(Arc::new(TimestampSecondArray::from(vec![1]))), @r"
    standard input, column `y`: found values of type Timestamp(s), expected numbers (used in equation of measurement `m_y`)
    hint: only the column that `time` of `[data]` names may hold date-times as times
    ");
    let lists = ListArray::from_iter_primitive::<Int64Type, _, _>(vec![Some(vec![Some(1)])]);
    assert_snapshot!(refused_y(Arc::new(lists)), @"standard input, column `y`: found values of type List(Int64), expected numbers (used in equation of measurement `m_y`)");
}

#[test]
fn test_ids() {
    assert_snapshot!(refused(b"id,y,lot\n1,2,A\nNA,2,A\n"), @r"
    standard input, row 3, column `id`: found a missing cell, expected the id of the row's test
    hint: every row needs the id of its test
    ");
    let batch = batch(vec![
        ("id", Arc::new(StringArray::from(vec![Some("a"), None])) as ArrayRef),
        ("y", Arc::new(BooleanArray::from(vec![true, false])) as ArrayRef),
    ]);
    assert_snapshot!(refused_by(&model(&["y"], &[], None), &parquet(&batch, 10)), @r"
    standard input, row 2, column `id`: found a missing cell, expected the id of the row's test
    hint: every row needs the id of its test
    ");
}

#[test]
fn times() {
    assert_snapshot!(refused_times(b"id,t\na,1\nb,0\nb,-0.5\n", None), @r"
    standard input, row 4, column `t`: found time -0.5 after time 0 in test `b`, expected times that do not decrease
    hint: sort the rows of each test by time; if these are two tests, give them two ids
    ");
    assert_snapshot!(refused_times(b"id,t\na,5\nb,0\na,4\n", None), @r"
    standard input, row 4, column `t`: found time 4 after time 5 in test `a`, expected times that do not decrease
    hint: sort the rows of each test by time; if these are two tests, give them two ids
    ");
    assert_snapshot!(refused_times(b"id,t\na,2024-01-02\na,2024-01-01\n", Some("s")), @r"
    standard input, row 3, column `t`: found time 2024-01-01T00:00:00 after time 2024-01-02T00:00:00 in test `a`, expected times that do not decrease
    hint: sort the rows of each test by time; if these are two tests, give them two ids
    ");
    assert_snapshot!(refused_times(b"id,t\na,2024-01-02\n", None), @r"
    standard input, row 2, column `t`: found date-times, expected a time unit for them in the model, which has none
    hint: date-times are read as time since the test's first row: set `time_unit` in `[data]` to `s`, `ms`, `us`, `ns`, `min`, `h` or `d`
    ");
    assert_snapshot!(refused_times(b"id,t\na,2024-01-02\n", Some("months")), @r"
    standard input, row 2, column `t`: found date-times, expected a time unit for them in the model, whose `time_unit` is `months`
    hint: date-times are read as time since the test's first row: set `time_unit` in `[data]` to `s`, `ms`, `us`, `ns`, `min`, `h` or `d`
    ");
    assert_snapshot!(refused_times(b"id,t\na,1\na,2024-01-02\n", Some("s")), @r"
    standard input, row 3, column `t`: found a date-time without an offset, expected a number as in standard input, row 2, column `t`
    hint: write the whole column one way
    ");
    assert_snapshot!(refused_times(b"id,t\na,2024-01-02T00:00:00\nb,2024-01-02T00:00:00Z\n", Some("s")), @r"
    standard input, row 3, column `t`: found a date-time with an offset, expected a date-time without an offset as in standard input, row 2, column `t`
    hint: write the whole column one way
    ");
    assert_snapshot!(refused_times(b"id,t\na,null\n", None), @r"
    standard input, row 2, column `t`: found a missing cell, expected the time of the row
    hint: every row needs a time when the model names a time column
    ");
    assert_snapshot!(refused_times(b"id,t\na,1\na,inf\n", None), @r"
    standard input, row 3, column `t`: found `inf`, expected a finite number
    hint: write `NA` where there is no measurement
    ");
    assert_snapshot!(refused_times(b"id,t\na,31/12/2024\n", Some("s")), @r"
    standard input, row 2, column `t`: found `31/12/2024`, expected a number or a date-time
    hint: write date-times as `2024-03-01T12:00:00` or `2024-03-01T12:00:00+01:00`
    ");
    assert_snapshot!(refused_times(b"id,t\na,\"0,5\"\n", Some("s")), @r"
    standard input, row 2, column `t`: found `0,5`, expected a number or a date-time
    hint: write the decimal comma as `.`
    ");
    let null = batch(vec![
        ("id", Arc::new(Int64Array::from(vec![1])) as ArrayRef),
        ("t", Arc::new(TimestampSecondArray::from(vec![None])) as ArrayRef),
    ]);
    assert_snapshot!(refused_times(&parquet(&null, 1), Some("s")), @r"
    standard input, row 1, column `t`: found a missing cell, expected the time of the row
    hint: every row needs a time when the model names a time column
    ");
    let bytes = batch(vec![
        ("id", Arc::new(Int64Array::from(vec![1])) as ArrayRef),
        ("t", Arc::new(BinaryArray::from(vec![b"1".as_slice()])) as ArrayRef),
    ]);
    assert_snapshot!(refused_times(&parquet(&bytes, 1), Some("s")), @r"
    standard input, column `t`: found values of type Binary, expected numbers or date-times (used in equation of measurement `m_t`)
    hint: write the column as text (UTF-8), not as bytes
    ");
}

fn columns() -> arrow_array::RecordBatch {
    batch(vec![
        ("id", Arc::new(Int64Array::from(vec![1, 1, 2, 2])) as ArrayRef),
        ("y", Arc::new(Float64Array::from(vec![1.0, 2.0, 3.0, 4.0])) as ArrayRef),
        ("lot", Arc::new(StringArray::from(vec!["A", "A", "B", "B"])) as ArrayRef),
    ])
}

#[test]
fn damaged_parquet() {
    let bytes = parquet(&columns(), 2);
    assert_snapshot!(refused(&bytes[..bytes.len() - 6]), @r"
    standard input is not a sound Parquet file: Parquet error: Invalid Parquet file. Corrupt footer
    hint: the file may be damaged, or not copied whole; if other programs read it, write it again with one of them
    ");
    let folder = tempfile::tempdir().unwrap();
    let input = write(folder.path(), "text.parquet", b"id,y,lot\n1,2,A\n");
    let model = model(&["y"], &[], None);
    let error = collect(&model, &by("id"), &[input], &mut std::io::empty()).unwrap_err();
    let root = folder.path().display().to_string();
    assert_snapshot!(said(&error).replace(&root, "ROOT"), @r"
    ROOT/text.parquet is not a sound Parquet file: Parquet error: Invalid Parquet file. Corrupt footer
    hint: the file may be damaged, or not copied whole; if other programs read it, write it again with one of them
    ");
}

#[test]
fn parquet_compression_that_is_not_read() {
    let properties = WriterProperties::builder().set_compression(Compression::UNCOMPRESSED).build();
    let mut bytes = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut bytes, columns().schema(), Some(properties)).unwrap();
    writer.write(&columns()).unwrap();
    writer.close().unwrap();
    assert!(collect_stdin(&model(&["y"], &[], None), &by("id"), &bytes).is_ok(), "no compression is read");
    // The library was built without gzip and cannot write it: the codec of the metadata says so instead. Field 4 of
    // ColumnMetaData follows path_in_schema; 0 is uncompressed, 4 (zigzag 2) is gzip.
    let path = b"\x19\x18\x01y\x15";
    let at = bytes.windows(path.len()).position(|window| window == path).expect("path_in_schema of y") + path.len();
    assert_eq!(bytes[at], 0);
    bytes[at] = 4;
    assert_snapshot!(refused(&bytes), @r"
    standard input, column `y`: found compression gzip, expected none, snappy or zstd
    hint: write the file again with snappy or zstd
    ");
}

/// Files of another library that are sound, and not to be read.
#[test]
fn parquet_that_says_why_it_cannot_be_read() {
    let of = |name: &str, time: Option<&str>| {
        let path = std::path::Path::new("tests/data").join(name);
        let columns: Vec<&str> = time.into_iter().chain(["y"]).collect();
        let input = [Input::Path(path)];
        said(&collect(&model(&columns, &[], time), &by("id"), &input, &mut std::io::empty()).unwrap_err())
    };
    for name in ["encrypted_column.parquet", "encrypted_footer.parquet"] {
        let said = of(name, None);
        assert!(said.contains("is encrypted, and encrypted Parquet files are not read"), "{said}");
    }
    let said = of("broken_utf8.parquet", None);
    assert!(said.contains("is not a sound Parquet file") && !said.contains("Arrow"), "{said}");
    let said = of("unknown_zone.parquet", Some("t"));
    assert!(said.contains("column `t`: the time zone `Mars/Olympus` is not known"), "{said}");
}

#[test]
fn damaged_arrow() {
    let file = arrow_file(&columns(), 1, IpcWriteOptions::default());
    assert_snapshot!(refused(&file[..file.len() - 1]), @r"
    standard input is not a sound Arrow IPC file: Parser error: Arrow file does not contain correct footer
    hint: the file may be damaged, or not copied whole; if other programs read it, write it again with one of them
    ");
    assert_snapshot!(refused(&file[..file.len() / 3]), @r"
    standard input is not a sound Arrow IPC file: Parser error: Arrow file does not contain correct footer
    hint: the file may be damaged, or not copied whole; if other programs read it, write it again with one of them
    ");
    let stream = arrow_stream(&columns(), 1);
    assert_snapshot!(refused(&stream[..stream.len() - 100]), @r"
    standard input is not a sound Arrow IPC file: Ipc error: it ends inside a message
    hint: the file may be damaged, or not copied whole; if other programs read it, write it again with one of them
    ");
    assert_snapshot!(refused(&stream[..6]), @r"
    standard input is not a sound Arrow IPC file: Ipc error: it ends inside a message
    hint: the file may be damaged, or not copied whole; if other programs read it, write it again with one of them
    ");
    let nothing = arrow_file(&columns().slice(0, 0), 1, IpcWriteOptions::default());
    assert_snapshot!(refused(&nothing), @"standard input has no rows");
}

#[test]
fn an_arrow_file_without_a_block_of_its_footer_is_refused() {
    let file = arrow_file(&columns(), 2, IpcWriteOptions::default());
    let frame = b"\xff\xff\xff\xff";
    let starts: Vec<usize> = (0..file.len() - 4).filter(|&at| &file[at..at + 4] == frame).collect();
    // Schema, two batches, end: drop the second batch.
    assert_eq!(starts.len(), 4, "{starts:?}");
    let cut = [&file[..starts[2]], &file[starts[3]..]].concat();
    assert_snapshot!(refused(&cut), @r"
    standard input is not a sound Arrow IPC file: Ipc error: its footer lists blocks that the file does not have
    hint: the file may be damaged, or not copied whole; if other programs read it, write it again with one of them
    ");
}

#[test]
fn rows_without_bytes() {
    let nulls = batch(vec![
        ("id", Arc::new(NullArray::new(1_000_000_000)) as ArrayRef),
        ("y", Arc::new(NullArray::new(1_000_000_000)) as ArrayRef),
    ]);
    assert_snapshot!(refused_by(&model(&["y"], &[], None), &arrow_stream(&nulls, 1_000_000_000)), @r"
    standard input: found 1000000000 rows declared by 0 bytes, expected at most 65536
    hint: the file is damaged, or made to exhaust memory; if it is sound, set the variable KALFIT_MOST_ROWS to the number of rows
    ");
}
