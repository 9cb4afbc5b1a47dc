//! Tests that stand in groups: how they are told apart, and what is refused of their groups.

#![expect(clippy::unwrap_used, reason = "also in what the tests share")]

use crate::support;

use arrow_ipc::writer::IpcWriteOptions;
use insta::assert_snapshot;
use kalfit::{Labels, Layout, PhasedModel, Source, Test, TestKey};
use kalfit_data::{TableFormat, TestWriter, WrittenIds};
use support::*;

/// Runs of serials of lots.
fn layout(test: TestKey) -> Layout {
    Layout {
        test,
        levels: vec!["lot".into(), "serial".into()],
        crossed: Vec::new(),
        missing: Vec::new(),
        comment: None,
    }
}

fn by_run() -> Layout {
    layout(TestKey::Column("run".into()))
}

/// A model that reads `y` and, as texts, the groups.
fn grouped() -> PhasedModel {
    model(&["y"], &["lot", "serial"], None)
}

/// A column of texts; an empty one is missing.
fn column(name: &str, texts: &[&str]) -> (String, Cells) {
    let cells = texts.iter().map(|text| Some((*text).to_owned()).filter(|text| !text.is_empty()));
    (name.to_owned(), Cells::Texts(cells.collect()))
}

/// Rows of (lot, serial, run), with their number from 1 as `y`.
fn table(rows: &[[&str; 3]]) -> Table {
    let of = |k: usize| rows.iter().map(|row| row[k]).collect::<Vec<_>>();
    let y = (1..).map(f64::from).take(rows.len()).map(Some).collect();
    let texts = [("lot", 0), ("serial", 1), ("run", 2)].map(|(name, k)| column(name, &of(k)));
    Table(texts.into_iter().chain([("y".to_owned(), Cells::Floats(y))]).collect())
}

/// The table as CSV, Parquet and Arrow IPC.
fn formats(table: &Table) -> [(&'static str, Vec<u8>); 4] {
    let batch = table.batch();
    [
        ("csv", table.csv(',', "\n")),
        ("tsv", table.csv('\t', "\r\n")),
        ("parquet", parquet(&batch, 2)),
        ("arrow", arrow_file(&batch, 3, IpcWriteOptions::default())),
    ]
}

/// Ids and numbers of the tests, the same in every format, and how often all was read again.
fn read(rows: &[[&str; 3]]) -> (Vec<(String, Vec<f64>)>, usize) {
    let mut all = formats(&table(rows)).into_iter().map(|(format, bytes)| {
        let (sink, reading) = collect_stdin(&grouped(), &by_run(), &bytes).unwrap_or_else(|e| panic!("{format}: {e}"));
        let numbers = |test: &Test| (0..test.rows()).map(|row| test.numbers(row)[0]).collect();
        for test in &sink.tests {
            let groups = test.texts(0).iter().map(|label| reading.labels.text(*label)).collect::<Vec<_>>().join("/");
            assert!(test.id.starts_with(&format!("{groups}/")), "{format}: test {} of {groups}", test.id);
        }
        (sink.tests.iter().map(|test| (test.id.to_string(), numbers(test))).collect(), sink.restarts)
    });
    let first = all.next().expect("a format");
    all.for_each(|other| assert_eq!(other, first));
    first
}

/// What is said of rows of a CSV file; of the other formats the same is said, but that they have no header to count.
fn refused(rows: &[[&str; 3]], layout: &Layout) -> String {
    let [csv, tsv, parquet, arrow] = formats(&table(rows)).map(|(format, bytes)| {
        let error = collect_stdin(&grouped(), layout, &bytes).expect_err(format);
        format!("{error}\nhint: {}", error.hint().unwrap_or_default())
    });
    assert_eq!((&csv, &parquet), (&tsv, &arrow));
    assert_eq!(without_header(&csv), parquet);
    csv
}

/// The message with the row counted from the one after the header.
fn without_header(said: &str) -> String {
    let (before, after) = said.split_once(", row ").expect("a message names its row");
    let (row, rest) = after.split_once([',', ':']).expect("something follows");
    let mark = &after[row.len()..after.len() - rest.len()];
    format!("{before}, row {}{mark}{rest}", row.parse::<usize>().expect("a number") - 1)
}

#[test]
fn a_run_is_told_apart_by_its_groups() {
    let rows = [["A", "1", "a"], ["A", "1", "a"], ["A", "2", "a"], ["B", "1", "a"], ["B", "1", "b"]];
    let (found, restarts) = read(&rows);
    let ids: Vec<&str> = found.iter().map(|(id, _)| id.as_str()).collect();
    assert_eq!((ids, restarts), (vec!["A/1/a", "A/2/a", "B/1/a", "B/1/b"], 0));
    assert_eq!(found[0].1, [1.0, 2.0]);
}

#[test]
fn rows_of_a_test_may_stand_anywhere() {
    let rows = [["A", "1", "a"], ["B", "1", "a"], ["A", "1", "a"], ["B", "1", "a"]];
    let expected = [("A/1/a".to_owned(), vec![1.0, 3.0]), ("B/1/a".to_owned(), vec![2.0, 4.0])];
    assert_eq!(read(&rows), (expected.to_vec(), 1));
}

#[test]
fn groups_may_be_numbers() {
    let integers = |values: &[i64]| Cells::Integers(values.iter().map(|&value| Some(value)).collect());
    let Table(mut columns) = table(&[["A", "", ""]; 3]);
    columns[1] = ("serial".to_owned(), integers(&[7, 7, 8]));
    columns[2] = ("run".to_owned(), integers(&[1, 2, 1]));
    for (format, bytes) in formats(&Table(columns)) {
        let (sink, _) = collect_stdin(&grouped(), &by_run(), &bytes).unwrap();
        let ids: Vec<&str> = sink.tests.iter().map(|test| test.id.as_str()).collect();
        assert_eq!(ids, ["A/7/1", "A/7/2", "A/8/1"], "{format}");
    }
}

#[test]
fn many_rows_of_few_groups_are_told_apart() {
    let runs: Vec<String> = (0..20_000).map(|run| format!("r{}", run / 2)).collect();
    let rows: Vec<[&str; 3]> = runs.iter().map(|run| ["lot", "serial", run.as_str()]).collect();
    let (found, _) = read(&rows);
    assert_eq!((found.len(), found[9_999].0.as_str()), (10_000, "lot/serial/r9999"));
}

#[test]
fn a_file_may_be_a_test_of_groups() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |lot: &str| format!("lot,serial,y\n{lot},1,2\n{lot},1,3\n").into_bytes();
    let inputs = [("a.csv", "A"), ("b.csv", "B")].map(|(name, lot)| write(folder.path(), name, &bytes(lot)));
    let (sink, reading) = collect(&grouped(), &layout(TestKey::File), &inputs, &mut std::io::empty()).unwrap();
    let found: Vec<(&str, &str)> =
        sink.tests.iter().map(|test| (test.id.as_str(), reading.labels.text(test.texts(0)[0]))).collect();
    assert_eq!(found, [("a", "A"), ("b", "B")], "ids stay those of files");
}

#[test]
fn a_missing_group_is_refused() {
    let rows = [["A", "1", "a"], ["A", "", "a"]];
    assert_snapshot!(refused(&rows, &by_run()), @"
    standard input, row 3, column `serial`: found a missing cell, expected the group of the row's test at level `serial`
    hint: every row needs the group of its test in every column of `levels` and `crossed` of `[data]`
    ");
    assert_eq!(refused(&rows, &layout(TestKey::File)), refused(&rows, &by_run()));
    assert_snapshot!(refused(&[["", "1", ""]], &by_run()), @"
    standard input, row 2, column `lot`: found a missing cell, expected the group of the row's test at level `lot`
    hint: every row needs the group of its test in every column of `levels` and `crossed` of `[data]`
    ");
    assert_snapshot!(refused(&[["A", "1", ""]], &by_run()), @"
    standard input, row 2, column `run`: found a missing cell, expected the id of the row's test
    hint: every row needs the id of its test
    ");
}

#[test]
fn a_file_of_two_groups_is_refused() {
    let rows = [["A", "1", ""], ["A", "1", ""], ["A", "2", ""], ["B", "1", ""]];
    assert_snapshot!(refused(&rows, &layout(TestKey::File)), @"
    standard input, row 4, column `serial`: found group `2` in a row of test `stdin`, expected `1` as in its first row
    hint: a test is of one group of each column of `levels` and `crossed` of `[data]`: split the test, or take the column out there
    ");
}

#[test]
fn names_that_look_like_one_when_joined_are_refused() {
    let (first, second) = (["A", "b/c", "d"], ["A/b", "c", "d"]);
    assert_snapshot!(refused(&[first, second], &by_run()), @"
    standard input, row 3, column `lot`: found group `A/b` in a row of test `A/b/c/d`, expected `A` as in its first row
    hint: names that hold a `/` make two tests look like one: write them with another character
    ");
    assert_snapshot!(refused(&[first, ["B", "b", "d"], second], &by_run()), @"
    standard input, row 4, column `lot`: found group `A/b` in a row of test `A/b/c/d`, expected `A` as in its first row
    hint: names that hold a `/` make two tests look like one: write them with another character
    ");
    assert_snapshot!(refused(&[["A", "1", "2/3"], ["A", "1/2", "3"]], &by_run()), @"
    standard input, row 3, column `serial`: found group `1/2` in a row of test `A/1/2/3`, expected `1` as in its first row
    hint: names that hold a `/` make two tests look like one: write them with another character
    ");
    let (alone, _) = read(&[first, ["A", "b", "d"]]);
    assert_eq!(alone[0].0, "A/b/c/d", "a slash is no harm by itself");
}

#[test]
fn a_column_of_groups_that_is_not_there() {
    let error = collect_stdin(&grouped(), &by_run(), b"lot,serail,run,y\nA,1,a,2\n").unwrap_err();
    assert_snapshot!(format!("{error}\nhint: {}", error.hint().unwrap_or_default()), @"
    standard input has no column `serial`, which is used in `levels` of `[data]`
    hint: there is a column `serail`
    ");
}

#[test]
fn a_row_of_units_is_seen_whatever_it_leaves_out() {
    let error = collect_stdin(&grouped(), &by_run(), b"lot,serial,run,y\n,,,mV\nA,1,a,2\n").unwrap_err();
    assert_snapshot!(error, @"standard input, row 2: found `mV` and no number in the first row after the header, expected numbers");
}

/// A test with two rows of a group.
fn test(id: &str, groups: [Option<&str>; 2], labels: &mut Labels) -> Test {
    let mut test = Test::new(id, 1, 2);
    let texts = groups.map(|text| text.map_or(kalfit::Label::MISSING, |text| labels.intern(text)));
    [1.0, 2.0].iter().for_each(|y| test.push(&[*y], &texts, Source::default()));
    test
}

fn written(tests: &[Test], labels: &Labels, layout: &Layout, format: TableFormat) -> Vec<u8> {
    let mut writer = TestWriter::new(grouped().shared(), layout, WrittenIds::Same, format, Vec::new()).unwrap();
    writer.write(tests, labels).unwrap();
    writer.finish().unwrap()
}

#[test]
fn what_is_written_of_groups_reads_back() {
    let mut labels = Labels::default();
    let groups = [("A/1/a", ["A", "1"]), ("A/1/b", ["A", "1"]), ("B/1/a", ["B", "1"]), ("A/b/c/d", ["A/b", "c"])];
    let tests = groups.map(|(id, groups)| test(id, groups.map(Some), &mut labels));
    let text = String::from_utf8(written(&tests, &labels, &by_run(), TableFormat::Csv)).unwrap();
    assert_snapshot!(text, @"
    lot,serial,run,y
    A,1,a,1
    A,1,a,2
    A,1,b,1
    A,1,b,2
    B,1,a,1
    B,1,a,2
    A/b,c,d,1
    A/b,c,d,2
    ");
    let folder = tempfile::tempdir().unwrap();
    for (format, extension) in [
        (TableFormat::Csv, "csv"),
        (TableFormat::Tsv, "tsv"),
        (TableFormat::Parquet, "parquet"),
        (TableFormat::Arrow, "arrow"),
    ] {
        let file = write(folder.path(), &format!("t.{extension}"), &written(&tests, &labels, &by_run(), format));
        let (sink, reading) = collect(&grouped(), &by_run(), &[file], &mut std::io::empty()).unwrap();
        assert_eq!(shown(&sink.tests, &reading.labels), shown(&tests, &labels), "{extension}");
    }
}

#[test]
fn an_id_that_does_not_begin_with_its_groups_is_written_whole() {
    let mut labels = Labels::default();
    let tests = [
        test("run 7", [Some("A"), Some("1")], &mut labels),
        test("A/1/c", [Some("A"), None], &mut labels),
        test("A/12/c", [Some("A"), Some("1")], &mut labels),
    ];
    let text = String::from_utf8(written(&tests, &labels, &by_run(), TableFormat::Csv)).unwrap();
    assert_snapshot!(text, @"
    lot,serial,run,y
    A,1,run 7,1
    A,1,run 7,2
    A,,A/1/c,1
    A,,A/1/c,2
    A,1,A/12/c,1
    A,1,A/12/c,2
    ");
    let tests = [test("A/1/c", [Some("A"), Some("1")], &mut labels)];
    let text = String::from_utf8(written(&tests, &labels, &layout(TestKey::File), TableFormat::Csv)).unwrap();
    assert_snapshot!(text, @"
    lot,serial,test,y
    A,1,A/1/c,1
    A,1,A/1/c,2
    ");
}
