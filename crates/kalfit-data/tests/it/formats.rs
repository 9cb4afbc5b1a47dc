//! One table, every format: the same tests.

use crate::support;

use std::sync::Arc;

use arrow_array::types::Int8Type;
use arrow_array::{
    ArrayRef, BooleanArray, Date32Array, Decimal128Array, DictionaryArray, Float32Array, Int8Array, Int64Array,
    LargeStringArray, NullArray, StringArray, StringViewArray, TimestampMicrosecondArray, UInt64Array,
};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::IpcWriteOptions;
use kalfit::Layout;
use kalfit_data::Input;
use support::*;

fn table() -> Table {
    let texts = |v: &[&str]| Cells::Texts(v.iter().map(|t| (!t.is_empty()).then(|| (*t).to_owned())).collect());
    Table(vec![
        ("unit".into(), texts(&["007", "007", "007", "7", "7", "a, \"b\"", "a, \"b\""])),
        ("t".into(), Cells::Floats([0.0, 0.5, 0.5, -1.0, 2.0, 0.1, 0.2].map(Some).to_vec())),
        ("unused".into(), texts(&["x", "", "not a number", "é", "x", "x", "x"])),
        ("n".into(), Cells::Integers(vec![Some(1), None, Some(-3), Some(4), Some(5), Some(6), Some(7)])),
        (
            "y".into(),
            Cells::Floats(vec![Some(0.1), Some(1e300), None, Some(-0.0), Some(5e-324), None, Some(1.0 / 3.0)]),
        ),
        ("lot".into(), texts(&["B", "B", "A", "", "µ", "A", "B"])),
    ])
}

const EXPECTED: &str = r#"007
  [0.0, 0.1, 1.0] ["B", "1"]
  [0.5, 1e300, NaN] ["B", "-"]
  [0.5, NaN, -3.0] ["A", "-3"]
7
  [-1.0, -0.0, 4.0] ["-", "4"]
  [2.0, 5e-324, 5.0] ["µ", "5"]
a, "b"
  [0.1, NaN, 6.0] ["A", "6"]
  [0.2, 0.3333333333333333, 7.0] ["B", "7"]
"#;

#[test]
fn the_same_table_gives_the_same_tests_in_every_format() {
    let model = model(&["t", "y", "n"], &["lot", "n"], Some("t"));
    let (table, reversed) = (table(), table().reversed());
    let lz4 = || IpcWriteOptions::default().try_with_compression(Some(CompressionType::LZ4_FRAME)).unwrap();
    let narrow = || IpcWriteOptions::try_new(8, false, arrow_ipc::MetadataVersion::V5).unwrap();
    let bom = [b"\xef\xbb\xbf".to_vec(), table.csv(',', "\n")].concat();
    let mut unended = table.csv(',', "\n");
    unended.pop();
    let forms: Vec<(&str, Vec<u8>)> = vec![
        ("a.csv", table.csv(',', "\n")),
        ("reversed.csv", reversed.csv(',', "\r\n")),
        ("semicolon.txt", table.csv(';', "\n")),
        ("tab.tsv", reversed.csv('\t', "\r\n")),
        ("tab.csv", table.csv('\t', "\n")),
        ("bom.csv", bom),
        ("unended.csv", unended),
        ("groups.parquet", parquet(&table.batch(), 2)),
        ("reversed.pq", parquet(&reversed.batch(), 3)),
        ("file.arrow", arrow_file(&table.batch(), 3, IpcWriteOptions::default())),
        ("narrow.feather", arrow_file(&table.batch(), 2, narrow())),
        ("packed.ipc", arrow_file(&reversed.batch(), 100, lz4())),
        ("stream.arrows", arrow_stream(&table.batch(), 2)),
        ("stream.arrow", arrow_stream(&reversed.batch(), 1)),
        ("parquet_by_its_bytes", parquet(&table.batch(), 100)),
        ("file_by_its_bytes.dat", arrow_file(&table.batch(), 100, IpcWriteOptions::default())),
        ("stream_by_its_bytes.dat", arrow_stream(&table.batch(), 100)),
    ];
    let folder = tempfile::tempdir().unwrap();
    let (reference, _) = collect_stdin(&model, &by("unit"), &forms[0].1).unwrap();
    for (name, bytes) in &forms {
        let input = write(folder.path(), name, bytes);
        let (sink, reading) = collect(&model, &by("unit"), &[input], &mut std::io::empty()).unwrap();
        assert_eq!(shown(&sink.tests, &reading.labels), EXPECTED, "{name}");
        assert_eq!((reading.rows, reading.tests, sink.restarts), (7, 3, 0), "{name}");
        for (test, same) in sink.tests.iter().zip(&reference.tests) {
            for row in 0..test.rows() {
                assert_eq!(test.texts(row), same.texts(row), "{name}: labels have the same numbers");
            }
        }
        if !name.starts_with("tab.tsv") {
            let (sink, reading) = collect_stdin(&model, &by("unit"), bytes).unwrap();
            assert_eq!(shown(&sink.tests, &reading.labels), EXPECTED, "{name} on standard input");
        }
    }
}

/// `data/write.py` tells how these were made.
#[test]
fn files_of_other_programs_give_the_same_tests() {
    let model = model(&["t", "y", "n"], &["lot", "n"], Some("t"));
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/");
    for name in [
        "pyarrow.parquet",
        "pyarrow_v2.parquet",
        "pyarrow.feather",
        "pyarrow.arrows",
        "polars.parquet",
        "polars.arrow",
        "polars.arrows",
        "polars.csv",
    ] {
        let input = Input::Path([folder, name].concat().into());
        let (sink, reading) = collect(&model, &by("unit"), &[input], &mut std::io::empty())
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(shown(&sink.tests, &reading.labels), EXPECTED, "{name}");
    }
}

#[test]
fn rows_know_where_they_came_from() {
    let model = model(&["y"], &[], None);
    let folder = tempfile::tempdir().unwrap();
    let csv = write(folder.path(), "a.csv", b"\n\"y\",\"long\nname\"\r\n1,x\r\n\r\n2,\"two\nlines\"\n3,\"\"\"\"\n");
    let batch = batch(vec![("y", Arc::new(Int64Array::from_iter_values(0..20_000)) as ArrayRef)]);
    let parquet = write(folder.path(), "b.parquet", &parquet(&batch, 7_000));
    let (sink, reading) = collect(&model, &Layout::default(), &[csv, parquet], &mut std::io::empty()).unwrap();
    let rows: Vec<(u32, u64)> = sources(&sink.tests).iter().map(|s| (s.file, s.row)).collect();
    assert_eq!(rows[..4], [(0, 4), (0, 6), (0, 8), (1, 1)]);
    assert_eq!(rows.last(), Some(&(1, 20_000)));
    assert_eq!(sink.tests[0].numbers(3 + 12_345), [12_345.0]);
    let place = reading.place(sink.tests[0].source(1));
    assert!(place.ends_with("a.csv, row 6"), "{place}");
}

#[test]
fn every_arrow_type_that_holds_numbers_or_texts_is_read_as_both() {
    let dictionary: DictionaryArray<Int8Type> = vec![Some("1.5"), None, Some("2")].into_iter().collect();
    let numbers =
        DictionaryArray::new(Int8Array::from(vec![Some(1), None, Some(0)]), Arc::new(Int64Array::from(vec![8, 9])));
    let decimal = Decimal128Array::from(vec![Some(150), None, Some(700)]).with_precision_and_scale(5, 2).unwrap();
    let cases: Vec<(&str, ArrayRef, [f64; 3], [&str; 3])> = vec![
        ("i8", Arc::new(Int8Array::from(vec![Some(-1), None, Some(3)])), [-1.0, f64::NAN, 3.0], ["-1", "-", "3"]),
        (
            "u64",
            Arc::new(UInt64Array::from(vec![Some(u64::MAX), None, Some(0)])),
            [u64::MAX as f64, f64::NAN, 0.0],
            ["18446744073709551615", "-", "0"],
        ),
        (
            "f32",
            Arc::new(Float32Array::from(vec![Some(0.5), Some(f32::NAN), Some(-0.0)])),
            [0.5, f64::NAN, -0.0],
            ["0.5", "-", "0"],
        ),
        (
            "f64",
            Arc::new(arrow_array::Float64Array::from(vec![Some(7.0), None, Some(0.1)])),
            [7.0, f64::NAN, 0.1],
            ["7", "-", "0.1"],
        ),
        (
            "bool",
            Arc::new(BooleanArray::from(vec![Some(true), None, Some(false)])),
            [1.0, f64::NAN, 0.0],
            ["true", "-", "false"],
        ),
        ("decimal", Arc::new(decimal), [1.5, f64::NAN, 7.0], ["1.5", "-", "7"]),
        ("null", Arc::new(NullArray::new(3)), [f64::NAN; 3], ["-"; 3]),
        ("text", Arc::new(StringArray::from(vec![" 1 ", "NA", "2e3"])), [1.0, f64::NAN, 2000.0], [" 1 ", "-", "2e3"]),
        (
            "large",
            Arc::new(LargeStringArray::from(vec![Some("1"), None, Some("x2").map(|x| &x[1..])])),
            [1.0, f64::NAN, 2.0],
            ["1", "-", "2"],
        ),
        (
            "view",
            Arc::new(StringViewArray::from(vec![Some("1"), None, Some("2.0000000000000000")])),
            [1.0, f64::NAN, 2.0],
            ["1", "-", "2.0000000000000000"],
        ),
        ("dictionary", Arc::new(dictionary), [1.5, f64::NAN, 2.0], ["1.5", "-", "2"]),
        ("dictionary of integers", Arc::new(numbers), [9.0, f64::NAN, 8.0], ["9", "-", "8"]),
    ];
    for (name, array, numbers, texts) in cases {
        let batch = batch(vec![("x", Arc::clone(&array))]);
        let model = model(&["x"], &["x"], None);
        let mut forms = vec![("arrow", arrow_stream(&batch, 2))];
        if !matches!(name, "dictionary of integers") {
            forms.push(("parquet", parquet(&batch, 2)));
        }
        for (format, bytes) in forms {
            let (sink, reading) = collect_stdin(&model, &Layout::default(), &bytes)
                .unwrap_or_else(|error| panic!("{name} in {format}: {error}"));
            let test = &sink.tests[0];
            assert_eq!(test.rows(), 3, "{name} in {format}");
            for row in 0..3 {
                let (found, expected) = (test.numbers(row)[0], numbers[row]);
                assert!(
                    found == expected || (found.is_nan() && expected.is_nan()),
                    "{name}, {format}: {found} {expected}"
                );
                let label = test.texts(row)[0];
                let found = if label.is_missing() { "-" } else { reading.labels.text(label) };
                assert_eq!(found, texts[row], "{name}, {format}");
            }
        }
    }
}

#[test]
fn dates_and_timestamps_print_as_iso_texts() {
    let batch = batch(vec![
        ("y", Arc::new(Int64Array::from(vec![1, 2])) as ArrayRef),
        ("day", Arc::new(Date32Array::from(vec![19_723, -1])) as ArrayRef),
        ("at", Arc::new(TimestampMicrosecondArray::from(vec![1_500_000, 0]).with_timezone("UTC")) as ArrayRef),
    ]);
    let model = model(&["y"], &["day", "at"], None);
    let (sink, reading) = collect_stdin(&model, &Layout::default(), &parquet(&batch, 10)).unwrap();
    let texts = |row: usize| sink.tests[0].texts(row).iter().map(|&l| reading.labels.text(l)).collect::<Vec<_>>();
    assert_eq!(texts(0), ["2024-01-01", "1970-01-01T00:00:01.5Z"]);
    assert_eq!(texts(1), ["1969-12-31", "1970-01-01T00:00:00Z"]);
}

#[test]
fn integers_and_whole_floats_are_the_same_test_id() {
    let ints = batch(vec![
        ("id", Arc::new(Int64Array::from(vec![7, 8])) as ArrayRef),
        ("y", Arc::new(Int64Array::from(vec![1, 2])) as ArrayRef),
    ]);
    let floats = batch(vec![
        ("id", Arc::new(arrow_array::Float64Array::from(vec![8.0, 9.5])) as ArrayRef),
        ("y", Arc::new(Int64Array::from(vec![3, 4])) as ArrayRef),
    ]);
    let folder = tempfile::tempdir().unwrap();
    let inputs = [
        write(folder.path(), "a.parquet", &parquet(&ints, 10)),
        write(folder.path(), "b.arrow", &arrow_stream(&floats, 10)),
        write(folder.path(), "c.csv", b"y;id\n5;007\n"),
    ];
    let (sink, _) = collect(&model(&["y"], &[], None), &by("id"), &inputs, &mut std::io::empty()).unwrap();
    let found: Vec<(&str, usize)> = sink.tests.iter().map(|t| (t.id.as_str(), t.rows())).collect();
    assert_eq!(found, [("7", 1), ("8", 2), ("9.5", 1), ("007", 1)]);
    assert_eq!(sink.restarts, 0, "a test may go on from one file to the next");
}

#[test]
fn each_file_can_be_a_test() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["day1/a.csv", "day2/a.csv", "day2/b.csv"] {
        write(folder.path(), name, b"y\n1\n2\n");
    }
    let pattern = folder.path().join("*").join("*.csv").display().to_string();
    let inputs = Input::expand(&[pattern, "-".into()]).unwrap();
    let layout = Layout {
        test: kalfit::TestKey::File,
        levels: Vec::new(),
        crossed: Vec::new(),
        missing: Vec::new(),
        comment: None,
    };
    let (sink, reading) = collect(&model(&["y"], &[], None), &layout, &inputs, &mut &b"y\n3\n"[..]).unwrap();
    let ids: Vec<String> = sink.tests.iter().map(|t| t.id.replace(&folder.path().display().to_string(), "")).collect();
    assert_eq!(ids, ["/day1/a.csv", "/day2/a.csv", "b", "stdin"]);
    assert_eq!((reading.rows, reading.tests), (7, 4));
}

#[test]
fn without_a_test_column_all_rows_of_all_files_are_one_test() {
    let folder = tempfile::tempdir().unwrap();
    let inputs = [write(folder.path(), "a.csv", b"y\n1\n2\n"), write(folder.path(), "b.csv", b"x,y\nq,3\n")];
    let (sink, _) = collect(&model(&["y"], &[], None), &Layout::default(), &inputs, &mut std::io::empty()).unwrap();
    assert_eq!((sink.tests.len(), sink.tests[0].rows(), sink.tests[0].id.as_str()), (1, 3, kalfit_data::SINGLE_TEST));
}

#[test]
fn missing_tokens_hold_in_numbers_texts_and_every_format() {
    let layout = Layout {
        test: kalfit::TestKey::Single,
        levels: Vec::new(),
        crossed: Vec::new(),
        missing: vec![".".into(), "-99".into()],
        comment: None,
    };
    let model = model(&["x"], &["x"], None);
    let csv = b"x,z\n.,1\n-99,1\n-99.0,1\nNULL,1\nnan,1\n\"NA\",1\n,1\n1,1\n";
    let (sink, reading) = collect_stdin(&model, &layout, csv).unwrap();
    let expected = "all\n  [NaN] [\"-\"]\n  [NaN] [\"-\"]\n  [NaN] [\"-99.0\"]\n".to_owned()
        + &"  [NaN] [\"-\"]\n".repeat(4)
        + "  [1.0] [\"1\"]\n";
    assert_eq!(shown(&sink.tests, &reading.labels), expected);
    let batch = batch(vec![("x", Arc::new(Int64Array::from(vec![Some(-99), None, Some(1)])) as ArrayRef)]);
    let (sink, reading) = collect_stdin(&model, &layout, &parquet(&batch, 10)).unwrap();
    assert_eq!(shown(&sink.tests, &reading.labels), "all\n  [NaN] [\"-\"]\n  [NaN] [\"-\"]\n  [1.0] [\"1\"]\n");
}

#[test]
fn a_column_may_be_test_id_number_and_text_at_once() {
    let model = model(&["x"], &["x"], None);
    let (sink, reading) = collect_stdin(&model, &by("x"), b" x ,y\n2,\n2,\n10,\n").unwrap();
    assert_eq!(shown(&sink.tests, &reading.labels), "2\n  [2.0] [\"2\"]\n  [2.0] [\"2\"]\n10\n  [10.0] [\"10\"]\n");
}

#[test]
fn labels_of_literals_come_first() {
    let (sink, reading) = collect_stdin(&model(&[], &["lot"], None), &Layout::default(), b"lot\nB\nA\nB\n").unwrap();
    let found: Vec<usize> = (0..3).map(|row| sink.tests[0].texts(row)[0].index()).collect();
    assert_eq!(found, [2, 0, 2]);
    assert_eq!(reading.labels.text(sink.tests[0].texts(0)[0]), "B");
}

#[test]
fn dictionary_arrays_are_not_unfolded() {
    // one text of 64 kB in 200 000 rows: unfolding it would take 13 GB; the writer of Parquet goes over each of them, so it gets fewer
    let read = |length: usize| {
        let batch = |rows: usize| {
            let long = "x".repeat(length);
            let keys = Int8Array::from(vec![0; rows]);
            let values: ArrayRef = Arc::new(StringArray::from(vec![long.as_str()]));
            batch(vec![("lot", Arc::new(DictionaryArray::new(keys, values)) as ArrayRef)])
        };
        let files = [(200_000, arrow_stream(&batch(200_000), 200_000)), (20_000, parquet(&batch(20_000), 20_000))];
        files.map(|(rows, bytes)| (rows, collect_stdin(&model(&[], &["lot"], None), &Layout::default(), &bytes)))
    };
    for (rows, found) in read(1 << 16) {
        assert_eq!(found.unwrap().0.tests[0].rows(), rows);
    }
    for (_, refused) in read((1 << 16) + 1) {
        let message = "standard input, row 1, column `lot`: found a text of 65537 bytes, expected at most 65536";
        assert_eq!(refused.unwrap_err().to_string(), message);
    }
}
