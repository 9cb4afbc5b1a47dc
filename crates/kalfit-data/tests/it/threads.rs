//! Whatever the number of threads, the same tests come in the same batches, and of many errors the first.

#![expect(clippy::unwrap_used, reason = "also in what the tests share")]

use crate::support;

use std::fmt::Write as _;

use kalfit::Test;
use kalfit_data::{DataReading, Input};
use support::*;

/// Rows of tests of one to seven rows each, more than a few chunks of them; some texts are quoted and have line ends in them.
fn csv(rows: usize) -> String {
    let mut text = "t,id,y,lot\n".to_owned();
    for row in 0..rows {
        let lot = if row % 1000 == 3 { format!("\"lot {row}\r\n\"\"q\"") } else { format!("L{}", row / 5000) };
        writeln!(text, "{},unit {},{},{lot}", row % 5, row / 5, row as f64 * 0.37).unwrap();
        if row % 7777 == 0 {
            text += "\n\r\n";
        }
    }
    text
}

type Outcome = Result<(Vec<Test>, Vec<usize>, Vec<String>, u64), String>;

/// What comes of some inputs with so many threads.
fn outcome(inputs: &[Input], threads: usize) -> Outcome {
    let model = model(&["t", "y"], &["lot"], Some("t"));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let read = pool.install(|| collect(&model, &by("id"), inputs, &mut std::io::empty()));
    read.map_err(|error| error.to_string()).map(|(sink, reading)| {
        let DataReading { labels, rows, .. } = reading;
        let tests = sink.tests.into_iter().map(comparable).collect();
        (tests, sink.batches, labels.texts().to_vec(), rows)
    })
}

/// A number that equals itself in the place of a missing one.
fn comparable(mut test: Test) -> Test {
    for row in 0..test.rows() {
        for column in 0..test.numbers(row).len() {
            if test.numbers(row)[column].is_nan() {
                test.set_number(row, column, f64::MIN);
            }
        }
    }
    test
}

fn same_for_any_threads(inputs: &[Input], what: &str) -> Outcome {
    let alone = outcome(inputs, 1);
    for threads in [2, 3] {
        assert!(outcome(inputs, threads) == alone, "{what}: {threads} threads give something else than one");
    }
    alone
}

#[test]
fn csv_files_in_many_chunks() {
    let folder = tempfile::tempdir().unwrap();
    let text = csv(200_000);
    assert!(text.len() > 4 << 20, "{} bytes", text.len());
    let input = write(folder.path(), "large.csv", text.as_bytes());
    let (tests, _, _, rows) = same_for_any_threads(&[input], "a sound file").unwrap();
    assert_eq!((tests.len(), rows), (40_000, 200_000));
    let lines = tests.iter().flat_map(|test| (0..test.rows()).map(|row| test.source(row).row));
    let expected =
        text.lines().enumerate().filter(|(_, line)| line.contains(",unit ")).map(|(line, _)| line as u64 + 1);
    assert!(lines.eq(expected), "every row remembers its line");
}

#[test]
fn the_first_error_of_many() {
    let folder = tempfile::tempdir().unwrap();
    let sound = csv(200_000);
    let lines: Vec<&str> = sound.split_inclusive('\n').collect();
    for (at, bad) in
        [(150, "0,u,one,L\n"), (90_010, "1,unit x,1,L,\n"), (150_003, "0,unit y,1\n"), (120_000, "0,,1,L\n")]
    {
        let at = (at..).find(|&at| lines[at].contains(",unit ")).unwrap();
        let later: String = lines[at..].iter().map(|line| line.replace(",L3", ",L3,\"")).collect();
        let text = format!("{}{bad}{later}", lines[..at].concat());
        let input = write(folder.path(), "bad.csv", text.as_bytes());
        let error = same_for_any_threads(&[input], bad).unwrap_err();
        assert!(error.contains(&format!("row {}", at + 1)), "{bad}: {error}");
    }
}

#[test]
fn rows_that_come_back_and_times_that_go_back_deep_in_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let back = write(folder.path(), "back.csv", format!("{}0,unit 7,1,L\n", csv(150_000)).as_bytes());
    let error = same_for_any_threads(&[back], "a time that goes back").unwrap_err();
    assert!(error.contains("found time 0 after time 4 in test `unit 7`"), "{error}");
    let again = write(folder.path(), "again.csv", format!("{}9,unit 7,1,L\n", csv(150_000)).as_bytes());
    let (tests, ..) = same_for_any_threads(&[again], "a test that comes back").unwrap();
    assert_eq!((tests.len(), tests[7].rows()), (30_000, 6));
}

#[test]
fn parquet_files_of_any_row_groups() {
    let folder = tempfile::tempdir().unwrap();
    let rows = 150_000;
    let table = |bad: Option<usize>| {
        let y = |row: usize| if bad == Some(row) { f64::INFINITY } else { row as f64 * 0.37 };
        Table(vec![
            ("id".to_owned(), Cells::Integers((0..rows).map(|row| Some((row / 5) as i64)).collect())),
            ("t".to_owned(), Cells::Floats((0..rows).map(|row| Some((row % 5) as f64)).collect())),
            ("y".to_owned(), Cells::Floats((0..rows).map(|row| (row % 11 > 0).then(|| y(row))).collect())),
            ("lot".to_owned(), Cells::Texts((0..rows).map(|row| Some(format!("L{}", row / 9000))).collect())),
        ])
    };
    let sound = table(None).batch();
    let mut outcomes = Vec::new();
    for group in [7_000, 1_000_000] {
        let input = write(folder.path(), &format!("g{group}.parquet"), &parquet(&sound, group));
        outcomes.push(same_for_any_threads(&[input], &format!("groups of {group} rows")).unwrap());
    }
    assert_eq!((outcomes[0].0.len(), outcomes[0].3), (30_000, 150_000));
    assert!(outcomes.iter().all(|outcome| *outcome == outcomes[0]), "row groups do not change what is read");
    let bad = write(folder.path(), "bad.parquet", &parquet(&table(Some(140_001)).batch(), 1_000_000));
    let error = same_for_any_threads(&[bad], "an infinite cell").unwrap_err();
    assert!(error.contains("row 140002, column `y`"), "{error}");
}
