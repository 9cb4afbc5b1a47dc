//! Exchange files: what is written is read back to the last bit, and nothing in them is trusted.

#![expect(clippy::unwrap_used, reason = "also in what the tests share")]

use crate::support;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, LargeListBuilder};
use arrow_array::builder::{ListBuilder, StringBuilder};
use arrow_array::{ArrayRef, Float32Array, Float64Array, RecordBatch, StringArray};
use arrow_array::{FixedSizeListArray, Int64Array};
use arrow_schema::{DataType, Field};
use insta::assert_snapshot;
use kalfit::model::{
    Carry, CovarianceStructure, Expression, GroupLevel, Initial, Linear, MeanStructure, Motion, Phase, State,
};
use kalfit::reduce::{Estimates, Inherited, Path as Arithmetic, PhaseReduction, Terminal};
use kalfit::{Evidence, Labels, Layout, Model, PhasedModel, Reduction, Source as Row, Test};
use kalfit_data::exchange::{
    EstimatesWriter, ExchangeEntry, ExchangeMetadata, InputContent, ParameterValue, ReductionWriter, SortedInputs,
    TestAssembly, read_estimates, read_reductions, sort,
};
use kalfit_data::{DataError, Input};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use support::{batch, by, parquet};

fn state(name: &str, initial: Initial) -> State {
    State { name: name.into(), unit: None, motion: Motion::Constant, initial, offset: None, random: true }
}

/// Columns t, x, steps; texts phase, lot, unit. `align` has v and tilt, `flight` v, tilt and bias; v and tilt are carried, and
/// tilt has no part of its own.
fn two_phases() -> PhasedModel {
    let mut align = support::model(&["t", "x", "steps"], &["phase", "lot", "unit"], Some("t")).phases.remove(0).model;
    align.literals = vec!["align".into(), "flight".into()];
    align.states = vec![state("v", Initial::Estimated), state("tilt", Initial::Estimated)];
    align.estimated = vec![1, 0];
    align.mean = MeanStructure::free(2);
    let known = Initial::Known { mean: Expression::Number(0.0), variance: Expression::Number(0.0) };
    let states = vec![state("v", Initial::Estimated), state("tilt", known), state("bias", Initial::Estimated)];
    let flight = Model { states, estimated: vec![0, 2], ..align.clone() };
    let from =
        |state: usize| Linear { terms: vec![(state, Expression::Number(1.0))], constant: Expression::Number(0.0) };
    let carry = vec![Carry { state: 0, from: from(0) }, Carry { state: 1, from: from(1) }];
    let phase = |name: &str, label: usize, model: Model, carry: Vec<Carry>| Phase {
        name: name.into(),
        label: Some(label),
        model,
        carry,
        filter: None,
    };
    let phases = vec![phase("align", 0, align, Vec::new()), phase("flight", 1, flight, carry)];
    PhasedModel { phases, column: Some(0), levels: Vec::new() }
}

fn one_phase() -> PhasedModel {
    let mut model = two_phases().phases.remove(0).model;
    model.text_columns.remove(0);
    model.into()
}

/// Numbers that are easily lost.
fn awkward(k: usize) -> f64 {
    [0.1, -0.0, 5e-324, f64::MAX, 1.0 / 3.0, -1e-300, f64::MIN_POSITIVE][k % 7]
}

fn vector(n: usize, salt: usize) -> DVector<f64> {
    DVector::from_fn(n, |i, _| awkward(i + salt))
}

fn matrix(n: usize, m: usize, salt: usize) -> DMatrix<f64> {
    DMatrix::from_fn(n, m, |i, j| awkward(3 * i + j + salt))
}

fn reduction(test: &str, q: usize, salt: usize) -> Reduction {
    let factor = (0..q * (q + 1) / 2).map(|k| awkward(k + salt).abs()).collect();
    Reduction {
        test: test.into(),
        constant: awkward(salt),
        residual: None,
        data: vector(q, salt).as_slice().to_vec(),
        factor,
        covariates: Vec::new(),
        steps: 7 + salt,
        observations: 11,
        path: if salt.is_multiple_of(2) { Arithmetic::Information } else { Arithmetic::SquareRoot },
        design: u128::MAX / 3 + salt as u128,
        chain: None,
        exact: None,
    }
}

fn pieces(test: &str, salt: usize) -> Vec<PhaseReduction> {
    let terminal = Terminal {
        mean: vector(2, salt),
        sensitivity: matrix(2, 2, salt + 1),
        root: matrix(2, 1 + salt % 3, salt + 2),
    };
    let inherited = Inherited { transition: matrix(3, 2, salt + 4), input: vector(3, salt) };
    vec![
        PhaseReduction {
            reduction: reduction(test, 2, salt),
            terminal: Some(terminal),
            inherited: None,
            groups: Vec::new(),
        },
        PhaseReduction {
            reduction: reduction(test, 3, salt + 1),
            terminal: None,
            inherited: Some(inherited),
            groups: Vec::new(),
        },
    ]
}

/// n states, m estimates, k columns of the root.
fn estimates(id: &str, labels: &mut Labels, (n, m, k): (usize, usize, usize), phase: usize) -> Estimates {
    let mut constants = Test::new(id, 3, 3);
    let texts = [kalfit::Label::literal(phase), labels.intern("µ lot"), labels.intern(id)];
    constants.push(&[f64::NAN, 0.1, 1e300], &texts, Row::default());
    Estimates {
        estimates: vector(m, 1),
        offsets: vector(m, 2),
        sensitivities: matrix(m, n, 3),
        transition: matrix(n, n, 4),
        drift: vector(n, 5),
        root: matrix(n + m, k, 6),
        constants,
        steps: 3,
        observations: 17,
    }
}

fn metadata() -> ExchangeMetadata {
    let value = |name: &str, value: f64| ParameterValue {
        name: name.into(),
        per: None,
        levels: Default::default(),
        value: Some(value),
    };
    ExchangeMetadata {
        version: "0.1.0".into(),
        title: "a µ".into(),
        model_digest: "sha256:1".into(),
        reduction_digest: "sha256:2".into(),
        parameters: vec![value("tau", 0.1), value("sigma", 1.0 / 3.0)],
        files: vec!["a \"b\".csv".into()],
        of_estimates: true,
    }
}

fn sorted(bytes: &[u8]) -> SortedInputs<'_> {
    sort(&[Input::Stdin], Box::new(bytes)).unwrap()
}

fn entries_of(
    bytes: &[u8],
    model: &PhasedModel,
    layout: &Layout,
    labels: &mut Labels,
) -> Result<Vec<ExchangeEntry>, DataError> {
    let sorted = sort(&[Input::Stdin], Box::new(bytes))?;
    let mut entries = Vec::new();
    for source in &sorted.reductions {
        read_reductions(source, model, labels, &mut |entry| {
            entries.push(entry);
            Ok(())
        })?;
    }
    for source in &sorted.estimates {
        read_estimates(source, (model, layout), labels, &mut |entry| {
            entries.push(entry);
            Ok(())
        })?;
    }
    Ok(entries)
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|x| x.to_bits()).collect()
}

/// Every number of a piece.
fn piece_bits(piece: &PhaseReduction) -> Vec<u64> {
    let reduction = &piece.reduction;
    let mut all = bits(&[reduction.constant]);
    all.extend(bits(&reduction.data));
    all.extend(bits(&reduction.factor));
    if let Some(terminal) = &piece.terminal {
        all.extend(bits(terminal.mean.as_slice()));
        all.extend(bits(terminal.sensitivity.as_slice()));
        all.extend(bits(terminal.root.as_slice()));
    }
    if let Some(inherited) = &piece.inherited {
        all.extend(bits(inherited.transition.as_slice()));
        all.extend(bits(inherited.input.as_slice()));
    }
    all
}

fn written_reductions(tests: &[(&str, Vec<PhaseReduction>)]) -> Vec<u8> {
    let mut writer = ReductionWriter::new(&two_phases(), &metadata(), Vec::new()).unwrap();
    for (id, pieces) in tests {
        pieces.iter().enumerate().for_each(|(phase, piece)| writer.write(id, phase, piece, &[]).unwrap());
    }
    writer.finish().unwrap()
}

#[test]
fn reductions_come_back_to_the_last_bit() {
    let tests: Vec<(String, Vec<PhaseReduction>)> =
        (0..600).map(|k| (format!("t{k}"), pieces(&format!("t{k}"), k))).collect();
    let given: Vec<(&str, Vec<PhaseReduction>)> =
        tests.iter().map(|(id, pieces)| (id.as_str(), pieces[..1 + id.len() % 2].to_vec())).collect();
    let bytes = written_reductions(&given);
    let model = two_phases();
    assert_eq!(sorted(&bytes).contents, [InputContent::Reductions]);
    assert_eq!(sorted(&bytes).reductions[0].metadata().unwrap(), Some(metadata()));
    let found = entries_of(&bytes, &model, &by("unit"), &mut Labels::default()).unwrap();
    let expected: Vec<(&str, usize, &PhaseReduction)> = given
        .iter()
        .flat_map(|(id, pieces)| pieces.iter().enumerate().map(move |(phase, piece)| (*id, phase, piece)))
        .collect();
    assert_eq!(found.len(), expected.len());
    for (row, (entry, (id, phase, piece))) in found.iter().zip(expected).enumerate() {
        assert_eq!((entry.test.as_str(), entry.phase, entry.at.row), (id, phase, row as u64 + 1));
        let Evidence::Reduced(back) = &entry.evidence else { panic!("{:?}", entry.evidence) };
        assert_eq!(**back, *piece, "test {id}, phase {phase}");
        assert_eq!(piece_bits(back), piece_bits(piece), "test {id}, phase {phase}: signs of zeros too");
    }
}

#[test]
fn estimates_come_back_to_the_last_bit_with_their_constants() {
    let model = two_phases();
    let mut labels = Labels::new(&model.shared().literals);
    let given: Vec<(usize, Estimates)> =
        vec![(0, estimates("u\"1", &mut labels, (2, 4, 6), 0)), (1, estimates("u\"1", &mut labels, (3, 2, 0), 1))];
    let mut writer = EstimatesWriter::new(&model, &metadata(), Vec::new()).unwrap();
    for (phase, estimates) in &given {
        writer.write("u\"1", *phase, estimates, &labels).unwrap();
    }
    let bytes = writer.finish().unwrap();
    // other texts come first, so labels have other numbers
    let mut others = Labels::new(&model.shared().literals);
    others.intern("something else");
    let found = entries_of(&bytes, &model, &by("unit"), &mut others).unwrap();
    for (entry, (phase, given)) in found.iter().zip(&given) {
        let Evidence::Estimates(back) = &entry.evidence else { panic!("{:?}", entry.evidence) };
        assert_eq!(entry.phase, *phase);
        let parts = |e: &Estimates| {
            let matrices = [&e.sensitivities, &e.transition, &e.root].map(|a| (a.shape(), bits(a.as_slice())));
            (matrices, [&e.estimates, &e.offsets, &e.drift].map(|v| bits(v.as_slice())), e.steps, e.observations)
        };
        assert_eq!(parts(back), parts(given));
        let spelt = |e: &Estimates, labels: &Labels| {
            let texts: Vec<String> = e.constants.texts(0).iter().map(|&l| labels.text(l).to_owned()).collect();
            (e.constants.id.clone(), bits(&e.constants.numbers(0)[1..]), texts)
        };
        assert_eq!(spelt(back, &others), spelt(given, &labels));
    }
    assert_eq!(found.len(), 2);
}

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// What `write.py` wrote: v and tilt in the opposite order, three estimates.
#[test]
fn files_by_other_programs_are_read() {
    let model = one_phase();
    let covariance = DMatrix::from_row_slice(
        5,
        5,
        &[
            0.0, 0.0, 0.0, 0.0, 0.0, //
            0.0, 4.0, 0.5, 0.0, 1.0, //
            0.0, 0.5, 1.0, 0.0, 0.25, //
            0.0, 0.0, 0.0, 9.0, 0.0, //
            0.0, 1.0, 0.25, 0.0, 0.5,
        ],
    );
    let mut answers = Vec::new();
    for name in
        ["estimates_pyarrow.parquet", "estimates_large.parquet", "estimates_polars.parquet", "estimates_single.parquet"]
    {
        let inputs = [Input::Path(data(name))];
        let sorted = sort(&inputs, Box::new(std::io::empty())).unwrap();
        assert_eq!(sorted.contents, [InputContent::Estimates], "{name}");
        let mut labels = Labels::new(&model.shared().literals);
        let mut entries = Vec::new();
        let found = read_estimates(&sorted.estimates[0], (&model, &by("unit")), &mut labels, &mut |entry| {
            entries.push(entry);
            Ok(())
        });
        assert_eq!(found.unwrap_or_else(|error| panic!("{name}: {error}")), None, "{name}");
        assert_eq!(entries.iter().map(|e| e.test.as_str()).collect::<Vec<_>>(), ["007", "8"], "{name}");
        let Evidence::Estimates(first) = &entries[0].evidence else { panic!("{name}") };
        assert_eq!(first.sensitivities, DMatrix::from_row_slice(3, 2, &[2.0, 1.0, 4.0, 3.0, 6.0, 5.0]), "{name}");
        assert_eq!(first.transition, DMatrix::from_row_slice(2, 2, &[4.0, 3.0, 2.0, 1.0]), "{name}");
        assert_eq!((first.steps, first.observations), (5, 3), "{name}");
        let lots: Vec<&str> = first.constants.texts(0).iter().map(|&label| labels.text(label)).collect();
        assert_eq!(lots, ["A", "007"], "{name}: the lot, and the id in the model's own column of ids");
        assert_eq!(first.constants.numbers(0)[1], 1.5, "{name}");
        let own = [1, 0, 2, 3, 4];
        let expected = covariance.select_rows(&own).select_columns(&own);
        let error = (&first.root * first.root.transpose() - &expected).amax();
        let tolerance = if name.contains("single") { 1e-6 } else { 1e-13 };
        assert!(error < tolerance, "{name}: DD' is off by {error:.1e}: {}", &first.root * first.root.transpose());
        assert!(first.root.ncols() <= 4, "{name}: {} columns of rank 4", first.root.ncols());
        answers.push(entries.len());
    }
    assert_eq!(answers, [2, 2, 2, 2]);
}

fn numbers(rows: &[Option<&[f64]>]) -> ArrayRef {
    let mut list = ListBuilder::new(Float64Builder::new());
    rows.iter().for_each(|row| list.append_option(row.map(|row| row.iter().map(|&x| (x != 77.0).then_some(x)))));
    Arc::new(list.finish())
}

fn words(rows: &[&[&str]]) -> ArrayRef {
    let mut list = ListBuilder::new(StringBuilder::new());
    rows.iter().for_each(|row| list.append_value(row.iter().map(|&word| Some(word))));
    Arc::new(list.finish())
}

/// A sound estimates file of one test for [`one_phase`], n = 2, m = 1.
fn sound() -> Vec<(&'static str, ArrayRef)> {
    vec![
        ("test", Arc::new(StringArray::from(vec!["a"])) as ArrayRef),
        ("states", words(&[&["v", "tilt"]])),
        ("estimates", numbers(&[Some(&[1.0])])),
        ("offsets", numbers(&[Some(&[0.0])])),
        ("sensitivities", numbers(&[Some(&[1.0, 0.0])])),
        ("covariance_root", numbers(&[Some(&[0.0, 0.0, 1.0])])),
        ("transition", numbers(&[Some(&[1.0, 0.0, 0.0, 1.0])])),
        ("unit", Arc::new(StringArray::from(vec!["a"])) as ArrayRef),
        ("x", Arc::new(Float64Array::from(vec![1.0])) as ArrayRef),
    ]
}

/// What is said when one column is another.
fn refused(name: &'static str, array: Option<ArrayRef>) -> String {
    let mut columns = sound();
    columns.retain(|(other, _)| *other != name);
    columns.extend(array.map(|array| (name, array)));
    said(&parquet(&batch(columns), 10), &one_phase())
}

fn said(bytes: &[u8], model: &PhasedModel) -> String {
    match entries_of(bytes, model, &by("unit"), &mut Labels::default()) {
        Ok(entries) => panic!("{} entries", entries.len()),
        Err(error) => format!("{error}{}", error.hint().map_or(String::new(), |hint| format!("\nhint: {hint}"))),
    }
}

#[test]
fn a_sound_file_is_accepted() {
    let bytes = parquet(&batch(sound()), 10);
    let found = entries_of(&bytes, &one_phase(), &by("unit"), &mut Labels::default()).unwrap();
    assert_eq!((found.len(), found[0].test.as_str(), found[0].phase), (1, "a", 0));
}

#[test]
fn columns_that_are_missing_or_of_another_type() {
    assert_snapshot!(refused("states", None), @"
    standard input has no column `states`, which estimates need
    hint: its columns are `test`, `estimates`, `offsets`, `sensitivities`, `covariance_root`, `transition`, `unit`, `x`
    ");
    assert_snapshot!(refused("transition", None), @"
    standard input has no column `transition`, which estimates need
    hint: its columns are `test`, `states`, `estimates`, `offsets`, `sensitivities`, `covariance_root`, `unit`, `x`
    ");
    assert_snapshot!(refused("transition", Some(Arc::new(Float64Array::from(vec![1.0])))), @"standard input, column `transition`: found values of type Float64, expected lists of numbers (used in estimates)");
    assert_snapshot!(refused("states", Some(numbers(&[Some(&[1.0])]))), @"standard input, column `states`: found values of type List(Float64), expected lists of texts (used in estimates)");
    assert_snapshot!(refused("test", Some(Arc::new(StringArray::from(vec![None::<&str>])))), @"
    standard input, row 1, column `test`: found a missing cell, expected the id of the row's test
    hint: every row needs the id of its test
    ");
    assert_snapshot!(refused("phase", Some(Arc::new(StringArray::from(vec!["flight"])))), @"
    standard input, row 1, column `phase`: found `flight`, expected a phase of the model: `main`
    hint: `phase` may be left out where the model has but one
    ");
    assert_snapshot!(refused("x", Some(numbers(&[None]))), @"standard input, column `x`: found values of type List(Float64), expected numbers (used in estimates)");
    assert_snapshot!(refused("x", Some(Arc::new(Float64Array::from(vec![f64::INFINITY])))), @"
    standard input, row 1, column `x`: found `inf`, expected a finite number
    hint: write `NA` where there is no measurement
    ");
}

#[test]
fn lists_of_the_wrong_length_or_with_holes() {
    assert_snapshot!(refused("offsets", Some(numbers(&[Some(&[1.0, 2.0])]))), @"
    standard input, row 1, column `offsets`: found a list of 2 numbers, expected 1: one for each of the 1 estimates
    hint: matrices are flat lists, row after row; the book (Exchange files) has all lengths
    ");
    assert_snapshot!(refused("sensitivities", Some(numbers(&[Some(&[1.0])]))), @"
    standard input, row 1, column `sensitivities`: found a list of 1 numbers, expected 2: m × n with m = 1 estimates and n = 2 states
    hint: matrices are flat lists, row after row; the book (Exchange files) has all lengths
    ");
    assert_snapshot!(refused("transition", Some(numbers(&[Some(&[1.0, 2.0])]))), @"
    standard input, row 1, column `transition`: found a list of 2 numbers, expected 4: n × n with n = 2 states
    hint: matrices are flat lists, row after row; the book (Exchange files) has all lengths
    ");
    assert_snapshot!(refused("transition", Some(numbers(&[None]))), @"standard input, row 1, column `transition`: found a missing value, expected a list of numbers");
    assert_snapshot!(refused("drift", Some(numbers(&[Some(&[1.0])]))), @"
    standard input, row 1, column `drift`: found a list of 1 numbers, expected 2: one for each of the 2 states
    hint: matrices are flat lists, row after row; the book (Exchange files) has all lengths
    ");
    assert_snapshot!(refused("covariance_root", Some(numbers(&[Some(&[1.0, 2.0])]))), @"
    standard input, row 1, column `covariance_root`: found a list of 2 numbers, expected a multiple of 3: (n + m) × any number of columns with n = 2 states and m = 1 estimates
    hint: matrices are flat lists, row after row; the book (Exchange files) has all lengths
    ");
    assert_snapshot!(refused("covariance_root", None), @"standard input, row 1, column `covariance_root`: found a missing value, expected a list of numbers, here or in `covariance`");
    assert_snapshot!(refused("estimates", Some(numbers(&[Some(&[f64::NAN])]))), @"standard input, row 1, column `estimates`: found NaN as element 1 of the list, expected a finite number");
    assert_snapshot!(refused("transition", Some(numbers(&[Some(&[1.0, 77.0, 0.0, 1.0])]))), @"standard input, row 1, column `transition`: found NaN as element 2 of the list, expected a finite number");
    assert_snapshot!(refused("offsets", Some(numbers(&[Some(&[f64::NEG_INFINITY])]))), @"standard input, row 1, column `offsets`: found -inf as element 1 of the list, expected a finite number");
}

#[test]
fn states_counts_and_covariances_that_cannot_be() {
    assert_snapshot!(refused("states", Some(words(&[&["v", "tlit"]]))), @"
    standard input, row 1, column `states`: found `v`, `tlit`, expected the states of phase `main`: `v`, `tilt`
    hint: name every state of the phase once, in the order in which the file's vectors have them
    ");
    assert_snapshot!(refused("states", Some(words(&[&["v", "v"]]))), @"
    standard input, row 1, column `states`: found `v`, `v`, expected the states of phase `main`: `v`, `tilt`
    hint: name every state of the phase once, in the order in which the file's vectors have them
    ");
    assert_snapshot!(refused("states", Some(words(&[&["v"]]))), @"
    standard input, row 1, column `states`: found `v`, expected the states of phase `main`: `v`, `tilt`
    hint: name every state of the phase once, in the order in which the file's vectors have them
    ");
    assert_snapshot!(refused("steps", Some(Arc::new(Float64Array::from(vec![-1.0])))), @"standard input, row 1, column `steps`: found -1, expected a count: 0, 1, 2 and so on");
    assert_snapshot!(refused("observations", Some(Arc::new(Float32Array::from(vec![0.5])))), @"standard input, row 1, column `observations`: found 0.5, expected a count: 0, 1, 2 and so on");
    assert_snapshot!(refused("covariance", Some(numbers(&[Some(&[0.0; 9])]))), @"standard input, row 1, column `covariance`: found a covariance beside `covariance_root`, expected one of the two");
    let covariance = |elements: [f64; 9]| {
        let mut columns = sound();
        columns.retain(|(name, _)| *name != "covariance_root");
        columns.push(("covariance", numbers(&[Some(&elements)])));
        said(&parquet(&batch(columns), 10), &one_phase())
    };
    assert_snapshot!(covariance([1.0, 0.0, 2.0, 0.0, 1.0, 0.0, 2.0, 0.0, 1.0]), @"
    standard input, row 1, column `covariance`: not positive semidefinite: smallest eigenvalue -1.000e0, largest 3.000e0 (scaled to a diagonal of ones)
    hint: give `covariance_root` in its place: a square root has no negative eigenvalues
    ");
    assert_snapshot!(covariance([1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0]), @"
    standard input, row 1, column `covariance`: not positive semidefinite: smallest eigenvalue -1.000e0, largest 1.000e0 (scaled to a diagonal of ones)
    hint: give `covariance_root` in its place: a square root has no negative eigenvalues
    ");
    assert_snapshot!(covariance([1.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.25, 0.0, 1.0]), @"standard input, row 1, column `covariance`: not symmetric: found 0.25 at (3, 1) and 0.5 across the diagonal");
    assert_snapshot!(covariance([0.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.5, 0.0, 1.0]), @"
    standard input, row 1, column `covariance`: not positive semidefinite: smallest eigenvalue -6.180e-1, largest 1.618e0 (scaled to a diagonal of ones)
    hint: give `covariance_root` in its place: a square root has no negative eigenvalues
    ");
}

#[test]
fn reductions_that_do_not_fit_the_model() {
    let bytes = written_reductions(&[("a", pieces("a", 0))]);
    assert_snapshot!(said(&bytes, &one_phase()), @"
    standard input, row 1, column `phase`: found `align`, expected a phase of the model: `main`
    hint: `phase` may be left out where the model has but one
    ");
    let mut renamed = two_phases();
    renamed.phases[1].model.states[2].name = "drift".into();
    assert_snapshot!(said(&bytes, &renamed), @"standard input, row 2, column `states`: found `v`, `bias`, `tilt`, expected the states of phase `flight` in this order: `v`, `drift`, `tilt`");
    let mut more = two_phases();
    more.phases[1].carry.pop();
    assert_snapshot!(said(&bytes, &more), @"standard input, row 2, column `states`: found `v`, `bias`, `tilt`, expected the states of phase `flight` in this order: `v`, `bias`");
    let mut pieces = pieces("a", 0);
    pieces[0].reduction.factor[2] = -1.0;
    assert_snapshot!(said(&written_reductions(&[("a", pieces.clone())]), &two_phases()), @"standard input, row 1, column `factor`: found -1, expected a diagonal that is not negative");
    pieces[0].reduction.factor[2] = f64::NAN;
    assert_snapshot!(said(&written_reductions(&[("a", pieces)]), &two_phases()), @"standard input, row 1, column `factor`: found NaN as element 3 of the list, expected a finite number");
    assert_snapshot!(said(&written_reductions(&[]), &two_phases()), @"standard input has no rows");
}

/// Reductions of one test of a model with these levels, with the names of its groups.
fn reductions_of(model: &PhasedModel, groups: &[&str]) -> Vec<u8> {
    let groups: Vec<String> = groups.iter().map(|&name| name.to_owned()).collect();
    let mut writer = ReductionWriter::new(model, &metadata(), Vec::new()).unwrap();
    let piece = PhaseReduction { terminal: None, ..pieces("a", 1).remove(0) };
    writer.write("a", 0, &piece, &groups).unwrap();
    writer.finish().unwrap()
}

fn with_levels(names: &[&str]) -> PhasedModel {
    let mut model = one_phase();
    let level = |(column, name): (usize, &&str)| GroupLevel {
        name: (*name).into(),
        column,
        crossed: false,
        covariance: CovarianceStructure::full(),
        members: Vec::new(),
    };
    model.levels.extend(names.iter().enumerate().map(level));
    model
}

#[test]
fn reductions_say_the_groups_of_their_tests() {
    let model = with_levels(&["lot", "serial"]);
    let bytes = reductions_of(&model, &["L 1", "7/8"]);
    let mut labels = Labels::default();
    let found = entries_of(&bytes, &model, &by("unit"), &mut labels).unwrap();
    let Evidence::Reduced(piece) = &found[0].evidence else { panic!("it is a reduction") };
    let names: Vec<&str> = piece.groups.iter().map(|name| labels.text(*name)).collect();
    assert_eq!(names, ["L 1", "7/8"]);
    // whoever has no levels needs no groups
    assert_eq!(entries_of(&bytes, &one_phase(), &by("unit"), &mut Labels::default()).unwrap().len(), 1);
    assert_snapshot!(said(&reductions_of(&model, &["L 1"]), &model), @r#"standard input, row 1, column `groups`: found ["L 1"], expected the name of a group for each level of the model"#);
    assert_snapshot!(said(&reductions_of(&model, &["L 1", ""]), &model), @r#"standard input, row 1, column `groups`: found ["L 1", ""], expected the name of a group for each level of the model"#);
}

#[test]
fn files_that_do_not_say_the_groups_are_refused() {
    let model = with_levels(&["lot"]);
    assert_snapshot!(said(&reductions_of(&model, &[]), &model), @"
    standard input has reductions without the groups of tests, but the model has levels of groups
    hint: reduce the data again with this model: reductions then say the groups
    ");
    assert_snapshot!(said(&parquet(&batch(sound()), 1), &model), @"
    standard input has estimates without the groups of tests, but the model has levels of groups
    hint: give the rows that the file was made of
    ");
    let written = EstimatesWriter::new(&model, &metadata(), Vec::new()).err();
    assert_snapshot!(written.unwrap(), @"the model has levels of groups, and files of estimates do not say the groups of tests");
}

#[test]
fn digests_that_differ_are_both_shown() {
    let error = metadata().check_digest("a.parquet", "sha256:3").unwrap_err();
    assert_snapshot!(error, @"a.parquet holds reductions of another model: found reduction digest sha256:2, expected sha256:3");
    assert!(metadata().check_digest("a.parquet", "sha256:2").is_ok());
}

fn entry(test: &str, phase: usize, row: u64) -> ExchangeEntry {
    let piece = pieces(test, 0).swap_remove(phase);
    ExchangeEntry {
        test: test.into(),
        phase,
        evidence: Evidence::Reduced(Box::new(piece)),
        at: Row { file: (row > 9).into(), row },
    }
}

#[test]
fn phases_of_a_test_may_come_from_several_places_once_each() {
    let (model, files) = (two_phases(), ["first.parquet".to_owned(), "second.parquet".to_owned()]);
    let mut assembly = TestAssembly::new(&model, &files);
    for (test, phase, row) in [("b", 1, 1), ("a", 0, 2), ("b", 0, 11)] {
        assembly.add(entry(test, phase, row)).unwrap();
    }
    let tests = assembly.finish().unwrap();
    let found: Vec<(&str, usize)> = tests.iter().map(|test| (test.id.as_str(), test.phases.len())).collect();
    assert_eq!(found, [("b", 2), ("a", 1)]);

    let mut assembly = TestAssembly::new(&model, &files);
    assembly.add(entry("b", 1, 3)).unwrap();
    assert_snapshot!(assembly.add(entry("b", 1, 12)).unwrap_err(), @"phase `flight` of test `b` is given twice: first.parquet, row 3 and second.parquet, row 12");
    assert_snapshot!(assembly.finish().unwrap_err(), @"first.parquet, row 3: found phase `flight` of test `b`, expected phase `align` too, which comes before it");
}

#[test]
fn a_table_of_rows_with_such_names_is_a_table_of_rows() {
    let columns = batch(vec![
        ("id", Arc::new(Int64Array::from(vec![1, 1])) as ArrayRef),
        ("estimates", Arc::new(Float64Array::from(vec![1.0, 2.0])) as ArrayRef),
        ("sensitivities", Arc::new(Float64Array::from(vec![1.0, 2.0])) as ArrayRef),
    ]);
    let bytes = parquet(&columns, 10);
    let mut sorted = sorted(&bytes);
    assert_eq!((sorted.contents, sorted.rows), (vec![InputContent::Rows], vec![Input::Stdin]));
    let mut found = Vec::new();
    std::io::Read::read_to_end(&mut sorted.stdin, &mut found).unwrap();
    assert!(found == bytes, "standard input begins again: {} of {} bytes", found.len(), bytes.len());
    let csv = b"id,y\n1,2\n";
    let mut sorted = self::sorted(csv);
    let mut found = Vec::new();
    std::io::Read::read_to_end(&mut sorted.stdin, &mut found).unwrap();
    assert_eq!(found, csv);
}

#[test]
fn another_version_of_the_schema_is_refused() {
    use parquet::arrow::ArrowWriter;
    use parquet::file::metadata::KeyValue;
    let columns: RecordBatch = batch(sound());
    let written = |pairs: &[(&str, &str)]| {
        let mut bytes = Vec::new();
        let mut writer = ArrowWriter::try_new(&mut bytes, columns.schema(), None).unwrap();
        writer.write(&columns).unwrap();
        for (key, value) in pairs {
            writer.append_key_value_metadata(KeyValue::new((*key).to_owned(), (*value).to_owned()));
        }
        writer.close().unwrap();
        bytes
    };
    assert_snapshot!(said(&written(&[("kalfit.schema", "kalfit-estimates/2")]), &one_phase()), @"
    standard input is of schema `kalfit-estimates/2`, expected `kalfit-reductions/1` or `kalfit-estimates/1`
    hint: write the file again with this version of kalfit
    ");
    assert_snapshot!(said(&written(&[("kalfit.schema", "kalfit-estimates/1")]), &one_phase()), @"
    standard input: metadata `kalfit.version` cannot be used: it is missing
    hint: write the file again; metadata other than kalfit's own may be left out altogether
    ");
    let pairs = [
        ("kalfit.schema", "kalfit-estimates/1"),
        ("kalfit.version", "0"),
        ("kalfit.model_digest", "?"),
        ("kalfit.reduction_digest", "?"),
        ("kalfit.log_likelihood_kind", "estimates"),
        ("kalfit.parameters", "[{\"name\":1}]"),
    ];
    assert_snapshot!(said(&written(&pairs), &one_phase()), @"
    standard input: metadata `kalfit.parameters` cannot be used: invalid type: integer `1`, expected a string at line 1 column 10
    hint: write the file again; metadata other than kalfit's own may be left out altogether
    ");
}

#[test]
fn lists_that_declare_billions_in_a_few_bytes_are_refused() {
    // one list of many equal numbers: run lengths make it tiny
    let values = Arc::new(Float64Array::from(vec![0.0; 8_000_000]));
    let field = Arc::new(Field::new_list_field(DataType::Float64, true));
    let list = FixedSizeListArray::new(field, 8_000_000, values, None);
    let said = refused("transition", Some(Arc::new(list)));
    assert!(said.contains("values declared by"), "{said}");
}

#[test]
fn large_and_fixed_size_lists_are_lists() {
    let mut large = LargeListBuilder::new(Float64Builder::new());
    large.append_value([Some(1.0)]);
    let fixed = FixedSizeListArray::new(
        Arc::new(Field::new_list_field(DataType::Float32, true)),
        4,
        Arc::new(Float32Array::from(vec![1.0, 0.0, 0.5, 1.0])),
        None,
    );
    let mut columns = sound();
    columns.retain(|(name, _)| !["estimates", "transition"].contains(name));
    columns.push(("estimates", Arc::new(large.finish())));
    columns.push(("transition", Arc::new(fixed)));
    let found = entries_of(&parquet(&batch(columns), 10), &one_phase(), &by("unit"), &mut Labels::default()).unwrap();
    let Evidence::Estimates(estimates) = &found[0].evidence else { panic!("{:?}", found[0].evidence) };
    assert_eq!(estimates.transition, DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.5, 1.0]));
}

/// Reads bytes as every kind of exchange file; the outcome does not matter, that there is one does.
fn survives(bytes: &[u8]) {
    for model in [one_phase(), two_phases()] {
        let _ = entries_of(bytes, &model, &by("unit"), &mut Labels::default());
    }
}

fn sound_file(kind: usize) -> Vec<u8> {
    match kind {
        0 => parquet(&batch(sound()), 10),
        1 => written_reductions(&[("a", pieces("a", 0)), ("b", pieces("b", 1))]),
        _ => {
            let model = two_phases();
            let mut labels = Labels::new(&model.shared().literals);
            let mut writer = EstimatesWriter::new(&model, &metadata(), Vec::new()).unwrap();
            let given = estimates("a", &mut labels, (2, 4, 6), 0);
            writer.write("a", 0, &given, &labels).unwrap();
            writer.finish().unwrap()
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn files_with_bytes_changed(
        kind in 0..3_usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let mut bytes = sound_file(kind);
        for (index, value) in changes {
            let length = bytes.len();
            bytes[index.index(length)] = value;
        }
        survives(&bytes);
    }

    #[test]
    fn files_with_numbers_made_huge(
        kind in 0..3_usize,
        at in any::<prop::sample::Index>(),
        value in prop::sample::select(vec![i64::MAX, i64::MIN, -1, 1 << 40, i64::from(i32::MAX), 1 << 31]),
    ) {
        let mut bytes = sound_file(kind);
        let last = bytes.len() - 8;
        let at = at.index(last);
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        survives(&bytes);
    }

    #[test]
    fn any_lists_at_all(
        lists in prop::collection::vec(prop::collection::vec(any::<f64>(), 0..12), 7),
        states in prop::collection::vec(prop::sample::select(vec!["v", "tilt", "bias", ""]), 0..4),
    ) {
        let names = ["estimates", "offsets", "sensitivities", "covariance_root", "covariance", "transition", "drift"];
        let mut columns = vec![("states", words(&[&states]))];
        columns.extend(names.iter().zip(&lists).map(|(&name, list)| (name, numbers(&[Some(list)]))));
        columns.push(("test", Arc::new(StringArray::from(vec!["a"])) as ArrayRef));
        survives(&parquet(&batch(columns), 10));
    }
}
