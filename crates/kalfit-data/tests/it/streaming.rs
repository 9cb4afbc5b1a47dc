//! Tests are handed over as they are completed, and gathered when their rows are scattered.

use crate::support;

use std::io::Read;

use kalfit::{Labels, Layout, Test};
use kalfit_data::{Input, ReadError, TestSink, read_from};
use support::*;

fn csv_of(rows: impl Iterator<Item = (usize, f64)>) -> Vec<u8> {
    let mut text = "id,y\n".to_owned();
    rows.for_each(|(id, y)| text += &format!("t{id},{y}\n"));
    text.into_bytes()
}

/// Gives its bytes a few at a time, and says how many it gave.
struct Slow<'a> {
    bytes: &'a [u8],
    given: &'a std::cell::Cell<usize>,
}

impl Read for Slow<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let length = buffer.len().min(1000);
        let read = self.bytes.read(&mut buffer[..length])?;
        self.given.set(self.given.get() + read);
        Ok(read)
    }
}

/// Notes how many bytes had been read when each batch came.
struct Watch<'a> {
    given: &'a std::cell::Cell<usize>,
    batches: Vec<(usize, usize)>,
}

impl TestSink for Watch<'_> {
    type Error = std::convert::Infallible;

    fn tests(&mut self, tests: Vec<Test>, _: &Labels) -> Result<(), Self::Error> {
        self.batches.push((tests.len(), self.given.get()));
        Ok(())
    }

    fn restart(&mut self) {
        panic!("the rows of each test stand together");
    }
}

#[test]
fn contiguous_tests_are_handed_over_long_before_the_end() {
    let bytes = csv_of((0..50_000).map(|row| (row / 5, row as f64)));
    let given = std::cell::Cell::new(0);
    let mut sink = Watch { given: &given, batches: Vec::new() };
    let mut stdin = Slow { bytes: &bytes, given: &given };
    let reading = read_from(&model(&["y"], &[], None), &by("id"), &[Input::Stdin], &mut sink, &mut stdin).unwrap();
    assert_eq!((reading.rows, reading.tests), (50_000, 10_000));
    assert_eq!(sink.batches.iter().map(|(tests, _)| tests).sum::<usize>(), 10_000);
    let (first, at) = sink.batches[0];
    assert_eq!(first, 1024, "tests of the first batch");
    assert!(at < bytes.len() / 5, "the first batch came after {at} of {} bytes", bytes.len());
    assert!(sink.batches.iter().all(|&(tests, _)| tests <= 1024), "{:?}", sink.batches);
}

#[test]
fn long_tests_are_handed_over_one_by_one() {
    let model = model(&["y"; 1], &[], None);
    let bytes = csv_of((0..2_100_000).map(|row| (row / 1_050_000, 0.0)));
    let (sink, _) = collect_stdin(&model, &by("id"), &bytes).unwrap();
    assert_eq!(sink.batches, [1, 1]);
}

#[test]
fn scattered_rows_restart_and_equal_the_sorted_table() {
    let rows: Vec<(usize, f64)> = (0..3000).map(|row| (row * 7919 % 101, f64::from(row as u32))).collect();
    let mut sorted = rows.clone();
    let first = |id: usize| rows.iter().position(|(other, _)| *other == id);
    sorted.sort_by_key(|(id, _)| first(*id));
    let (model, layout) = (model(&["y"], &["id"], None), by("id"));
    let (expected, expected_reading) = collect_stdin(&model, &layout, &csv_of(sorted.into_iter())).unwrap();
    assert_eq!(expected.restarts, 0);
    let bytes = csv_of(rows.into_iter());
    let folder = tempfile::tempdir().unwrap();
    let file = write(folder.path(), "scattered.csv", &bytes);
    for (inputs, stdin) in [([Input::Stdin], &bytes[..]), ([file], &[][..])] {
        let mut stdin = stdin;
        let (sink, reading) = collect(&model, &layout, &inputs, &mut stdin).unwrap();
        assert_eq!(sink.restarts, 1);
        assert_eq!((reading.rows, reading.tests), (3000, 101));
        assert_eq!(shown(&sink.tests, &reading.labels), shown(&expected.tests, &expected_reading.labels));
    }
}

#[test]
fn a_test_may_be_scattered_over_files_and_standard_input() {
    let folder = tempfile::tempdir().unwrap();
    let batch = Table(vec![
        ("y".into(), Cells::Floats(vec![Some(2.0), Some(3.0)])),
        ("id".into(), Cells::Texts(vec![Some("b".into()), Some("a".into())])),
    ]);
    let inputs = [
        write(folder.path(), "1.csv", b"id,y\na,1\n"),
        Input::Stdin,
        write(folder.path(), "2.csv", b"id,y\nb,4\na,5\nb,6\n"),
    ];
    let stdin = arrow_stream(&batch.batch(), 1);
    let (sink, reading) = collect(&model(&["y"], &[], None), &by("id"), &inputs, &mut stdin.as_slice()).unwrap();
    let text = shown(&sink.tests, &reading.labels);
    assert_eq!(text, "a\n  [1.0] []\n  [3.0] []\n  [5.0] []\nb\n  [2.0] []\n  [4.0] []\n  [6.0] []\n");
    assert_eq!((sink.restarts, reading.rows), (1, 6));
}

/// Refuses the first test.
struct Refuse;

impl TestSink for Refuse {
    type Error = kalfit::Source;

    fn tests(&mut self, tests: Vec<Test>, _: &Labels) -> Result<(), Self::Error> {
        Err(tests[0].source(1))
    }

    fn restart(&mut self) {}
}

#[test]
fn an_error_of_the_sink_comes_with_what_turns_its_source_into_a_place() {
    let stdin = b"id,lot,y\na,B,1\na,B,2\nb,B,3\n";
    let model = model(&["y"], &["lot"], None);
    match read_from(&model, &Layout::default(), &[Input::Stdin], &mut Refuse, &mut &stdin[..]) {
        Err(ReadError::Sink { error, reading }) => {
            assert_eq!(reading.place(error), "standard input, row 3");
            assert_eq!(reading.labels.text(kalfit::Label::literal(2)), "B");
        }
        other => panic!("{other:?}"),
    }
}
