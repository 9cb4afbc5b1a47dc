//! What is written reads back: ids, texts and numbers, bit for bit, in every format.

use crate::support;

use kalfit::{Labels, Layout, PhasedModel, Source, Test, TestKey};
use kalfit_data::{Input, TableFormat, TestWriter, WriteError, WrittenIds, added_id_column, read};
use proptest::prelude::*;
use support::{Collect, by, model};

const FORMATS: [(TableFormat, &str); 4] = [
    (TableFormat::Csv, "csv"),
    (TableFormat::Tsv, "tsv"),
    (TableFormat::Parquet, "parquet"),
    (TableFormat::Arrow, "arrow"),
];

/// One row: two numbers and two texts; `None` is missing.
type Row = (f64, f64, Option<String>, Option<String>);

fn tests(rows: &[(&str, Vec<Row>)], labels: &mut Labels) -> Vec<Test> {
    let one = |(id, rows): &(&str, Vec<Row>)| {
        let mut test = Test::new(*id, 2, 2);
        for (a, b, s, t) in rows {
            let mut label = |text: &Option<String>| text.as_ref().map_or(kalfit::Label::MISSING, |t| labels.intern(t));
            let texts = [label(s), label(t)];
            test.push(&[*a, *b], &texts, Source::default());
        }
        test
    };
    rows.iter().map(one).collect()
}

/// Writes tests in a format, and reads them.
fn back(
    model: &PhasedModel,
    layout: &Layout,
    tests: &[Test],
    labels: &Labels,
    format: (TableFormat, &str),
) -> (Vec<Test>, Labels) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(format!("t.{}", format.1));
    let mut writer = TestWriter::new(model.shared(), layout, WrittenIds::Same, format.0, Vec::new()).expect("a table");
    writer.write(tests, labels).expect("rows");
    std::fs::write(&path, writer.finish().expect("an end")).expect("a file");
    let mut sink = Collect::default();
    let reading =
        read(model, layout, &[Input::Path(path)], &mut sink).unwrap_or_else(|error| panic!("{}: {error}", format.1));
    (sink.tests, reading.labels)
}

/// A row: the id of its test, its numbers as bits, its texts.
type Spelt = (String, Vec<Option<u64>>, Vec<Option<String>>);

/// Everything in tests, texts spelt out and numbers as bits.
fn spelt(tests: &[Test], labels: &Labels) -> Vec<Spelt> {
    let mut rows = Vec::new();
    for test in tests {
        for row in 0..test.rows() {
            let bits = |x: &f64| (!x.is_nan()).then(|| x.to_bits());
            let text = |label: &kalfit::Label| (!label.is_missing()).then(|| labels.text(*label).to_owned());
            let (numbers, texts) = (test.numbers(row).iter(), test.texts(row).iter());
            rows.push((test.id.to_string(), numbers.map(bits).collect(), texts.map(text).collect()));
        }
    }
    rows
}

fn some(text: &str) -> Option<String> {
    Some(text.to_owned())
}

#[test]
fn awkward_cells_read_back_in_every_format() {
    let model = model(&["a;b", "c, d"], &["quoted \"name\"", "t"], None);
    let rows = [
        ("007", vec![(0.1, f64::NAN, some("x,y"), None), (-0.0, 1e300, some("say \"no\""), some("1.0"))]),
        ("7", vec![(5e-324, f64::MAX, some(" spaces "), some("007"))]),
        ("a;b,c\td", vec![(1.0 / 3.0, -1e-7, some("two\nlines"), some("#"))]),
        ("é", vec![(f64::NAN, f64::NAN, None, None)]),
    ];
    let mut labels = Labels::new(&model.shared().literals);
    let tests = tests(&rows, &mut labels);
    for format in FORMATS {
        let (found, found_labels) = back(&model, &by("unit"), &tests, &labels, format);
        assert_eq!(spelt(&found, &found_labels), spelt(&tests, &labels), "{}", format.1);
    }
}

#[test]
fn a_table_of_one_column_keeps_its_missing_cells() {
    let model = model(&["z"], &[], None);
    let mut test = Test::new("all", 1, 0);
    [1.5, f64::NAN, 2.5, f64::NAN].iter().for_each(|z| test.push(&[*z], &[], Source::default()));
    let layout =
        Layout { test: TestKey::Single, levels: Vec::new(), crossed: Vec::new(), missing: Vec::new(), comment: None };
    for format in FORMATS {
        let (found, labels) = back(&model, &layout, std::slice::from_ref(&test), &Labels::default(), format);
        assert_eq!(spelt(&found, &labels), spelt(std::slice::from_ref(&test), &labels), "{}", format.1);
    }
}

#[test]
fn many_rows_pass_from_batch_to_batch() {
    let model = model(&["z"], &[], None);
    let many: Vec<Test> = (0..3)
        .map(|k| {
            let mut test = Test::new(k.to_string(), 1, 0);
            (0..50_000).for_each(|row| test.push(&[f64::from(row) + 0.1 * f64::from(k)], &[], Source::default()));
            test
        })
        .collect();
    for format in [FORMATS[2], FORMATS[3]] {
        let (found, labels) = back(&model, &by("unit"), &many, &Labels::default(), format);
        assert!(spelt(&found, &labels) == spelt(&many, &labels), "{}", format.1);
    }
}

#[test]
fn a_column_with_several_uses_is_written_once() {
    // `k` is a number and a text, `unit` the id and a text
    let model = model(&["k", "z"], &["k", "unit"], None);
    let mut labels = Labels::new(&model.shared().literals);
    let tests = tests(&[("u1", vec![(7.0, 1.0, some("007"), some("u1"))])], &mut labels);
    for format in FORMATS {
        let (found, found_labels) = back(&model, &by("unit"), &tests, &labels, format);
        assert_eq!(spelt(&found, &found_labels), spelt(&tests, &labels), "{}", format.1);
    }
    let refusal = TestWriter::new(model.shared(), &by("unit"), WrittenIds::New, TableFormat::Csv, Vec::new())
        .err()
        .expect("refused");
    assert!(matches!(&refusal, WriteError::IdInUse { column, .. } if column == "unit"), "{refusal}");
}

#[test]
fn a_column_of_ids_is_added_where_the_layout_has_none() {
    let layout =
        |test: TestKey| Layout { test, levels: Vec::new(), crossed: Vec::new(), missing: Vec::new(), comment: None };
    let plain = model(&["z"], &[], None);
    let taken = model(&["z", "test"], &["test_2"], None);
    let name =
        |model: &PhasedModel, test: TestKey, ids: WrittenIds| added_id_column(model.shared(), &layout(test), ids);
    assert_eq!(name(&plain, TestKey::Single, WrittenIds::Same), None);
    assert_eq!(name(&plain, TestKey::Single, WrittenIds::New).as_deref(), Some("test"));
    assert_eq!(name(&taken, TestKey::File, WrittenIds::Same).as_deref(), Some("test_3"));
    assert_eq!(name(&plain, TestKey::Column("unit".into()), WrittenIds::New), None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_number_reads_back(numbers in prop::collection::vec(any::<f64>().prop_filter("finite", |x| x.is_finite()), 1..40)) {
        let model = model(&["z"], &[], None);
        let mut test = Test::new("u", 1, 0);
        numbers.iter().for_each(|z| test.push(&[*z], &[], Source::default()));
        let (found, labels) = back(&model, &by("unit"), std::slice::from_ref(&test), &Labels::default(), FORMATS[0]);
        prop_assert_eq!(spelt(&found, &labels), spelt(std::slice::from_ref(&test), &labels));
    }
}
