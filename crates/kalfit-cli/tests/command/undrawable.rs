//! What `simulate` and `plan` refuse: exit status 2, a message, nothing written.

use crate::folder::{Folder, MODEL};
use insta::assert_snapshot;

/// Values for the sound model.
const TRUTH: &str = "\n[mean]\nstart = { level = 1, slope = 0.5 }\n[covariance]\nstart = [[1, 0.2], [0.2, 0.25]]\n";

/// A folder with the sound model and data, values for them in `t.toml` and a fit of them in `fit.json`; then other files.
fn folder(files: &[(&str, &str)]) -> Folder {
    let folder = Folder::new(&[("t.toml", format!("{MODEL}{TRUTH}").as_bytes())]);
    assert_eq!(folder.run("fit m.toml d.csv --out fit.json --quiet").status.code(), Some(0));
    files.iter().for_each(|(name, text)| folder.write(name, text.as_bytes()));
    folder
}

/// Runs a command that must be refused; its message.
fn refused(args: &str, files: &[(&str, &str)]) -> String {
    let folder = folder(files);
    let before = folder.contents();
    let output = folder.run(args);
    let message = String::from_utf8(output.stderr).expect("messages are UTF-8");
    assert_eq!(output.status.code(), Some(2), "`kalfit {args}` says\n{message}");
    assert_eq!(String::from_utf8_lossy(&output.stdout), "", "standard output of `kalfit {args}`");
    assert!(!message.contains("panicked"), "`kalfit {args}` panicked:\n{message}");
    assert_eq!(before, folder.contents(), "`kalfit {args}` left the folder as it was");
    without_last_digits(&message)
}

/// Numbers to nine decimals: the last ones are rounding, which depends on the instructions that a machine has.
fn without_last_digits(text: &str) -> String {
    let mut decimals = None; // since a point
    let kept = |c: &char| {
        decimals = match (*c, decimals) {
            ('.', _) => Some(0),
            ('0'..='9', Some(count)) => Some(count + 1),
            _ => None,
        };
        decimals.is_none_or(|count| count <= 9)
    };
    text.chars().filter(kept).collect()
}

/// `simulate` with its options.
fn simulate(from: &str, more: &str, files: &[(&str, &str)]) -> String {
    refused(&format!("simulate m.toml --from {from} --design d.csv --seed 1 {more}"), files)
}

fn plan(from: &str, more: &str, files: &[(&str, &str)]) -> String {
    refused(&format!("plan m.toml --from {from} --design d.csv --tests 5 {more}"), files)
}

#[test]
fn truths_that_are_none() {
    assert_snapshot!(simulate("no.json", "--out new.csv", &[]), @"error: cannot read `no.json`: No such file or directory (os error 2)");
    assert_snapshot!(simulate("m.toml", "--out new.csv", &[]), @"
    error: `m.toml`: no value is given for mean[level], mean[slope], covariance[level, level], covariance[level, slope], covariance[slope, slope]

    hint: fix it or give it a start value in `[mean]` and `[covariance]`, or take a fit
    ");
    assert_snapshot!(simulate("d.csv", "--out new.csv", &[]), @"
    error: `d.csv` is not a result of `kalfit fit`: it is not JSON (expected value at line 1 column 1)

    hint: `--from` takes what `kalfit fit --out` writes, or a model file that ends in `.toml`
    ");
    assert_snapshot!(simulate("f.json", "--out new.csv", &[("f.json", "[1, 2]")]), @"
    error: `f.json` is not a result of `kalfit fit`: invalid type: sequence, expected the object of a result at line 1 column 0

    hint: `--from` takes what `kalfit fit --out` writes, or a model file that ends in `.toml`
    ");
    assert_snapshot!(simulate("f.json", "--out new.csv", &[("f.json", r##"{"schema": "kalfit-plan/1"}"##)]), @"
    error: `f.json`: the schema is `kalfit-plan/1`, expected `kalfit-fit/1`

    hint: `--from` takes what `kalfit fit --out` writes, or a model file that ends in `.toml`
    ");
    assert_snapshot!(simulate("f.json", "--out new.csv", &[("f.json", r##"{"a": 1}"##)]), @"
    error: `f.json` is not a result of `kalfit fit`: it has no `schema`

    hint: `--from` takes what `kalfit fit --out` writes, or a model file that ends in `.toml`
    ");
    assert_snapshot!(simulate("f.json", "--out new.csv", &[("f.json", r##"{"schema": "kalfit-fit/1", "title": 3}"##)]), @"
    error: `f.json` is not a result of `kalfit fit`: invalid type: integer `3`, expected a string at line 1 column 37

    hint: `--from` takes what `kalfit fit --out` writes, or a model file that ends in `.toml`
    ");
    assert_snapshot!(simulate("t.toml", "--out new.csv", &[("t.toml", r##"[data]
test = "id"

[states.level]
[states.rate]

[measurements.y]
column = "y"
equation = "level + rate * x"
noise = 0.1

[mean]
start = { level = 1, rate = 0.5 }
[covariance]
start = [[1, 0.2], [0.2, 0.25]]
"##)]), @"
    error: `t.toml`: the estimated states are `level`, `rate`, expected `level`, `slope` as in the model

    hint: it is of another model: phases, states, regressions and parameters must have the same names
    ");
    assert_snapshot!(simulate("t.toml", "--out new.csv", &[("t.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = 0.1

[mean]
start = { level = 1, slope = 0.5 }
[covariance]
start = [[1, 0.9], [0.9, 0.25]]
"##)]), @"
    error: the correlation of `level` and `slope` in `start` of `[covariance]` is 1.8000, expected -1 to 1
      --> t.toml:15:21 | start = [[1, 0.9], [0.9, 0.25]]
                       |                     ^^^
    ");
}

#[test]
fn parameters_without_a_value() {
    assert_snapshot!(simulate("t.toml", "--out new.csv", &[("m.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = "s"
[parameters]
s = {}
"##)]), @"
    error: no value is given for parameter `s`

    hint: give it: `--set s=VALUE`
    ");
    assert_snapshot!(plan("t.toml", "", &[("m.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = "s"
[parameters]
s = {}
"##)]), @"
    error: no value is given for parameter `s`

    hint: give it: `--set s=VALUE`
    ");
    assert_snapshot!(simulate("t.toml", "--out new.csv", &[("t.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = "s"

[mean]
start = { level = 1, slope = 0.5 }
[covariance]
start = [[1, 0.2], [0.2, 0.25]]
[parameters]
s = {}
"##)]), @"
    error: no value is given for parameter `s`

    hint: give it: `--set s=VALUE`
    ");
    assert_snapshot!(simulate("t.toml", "--out new.csv --set q=1", &[("m.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = "s"
[parameters]
s = {}
"##)]), @"error: unknown parameter `q` in the assignment `q=1`");
}

#[test]
fn fits_of_other_models() {
    assert_snapshot!(simulate("fit.json", "--out new.csv", &[("m.toml", r##"[data]
test = "id"

[states.level]
[states.rate]

[measurements.y]
column = "y"
equation = "level + rate * x"
noise = 0.1
"##)]), @"
    error: `fit.json`: the estimated states are `level`, `slope`, expected `level`, `rate` as in the model

    hint: it is of another model: phases, states, regressions and parameters must have the same names
    ");
    assert_snapshot!(simulate("fit.json", "--out new.csv", &[("m.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = 0.1
[mean.regression]
level = ["x"]
"##)]), @"
    error: `fit.json`: the regressions are none, expected `level on x` as in the model

    hint: it is of another model: phases, states, regressions and parameters must have the same names
    ");
    assert_snapshot!(plan("fit.json", "", &[("m.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = 0.1
[covariance]
structure = "diagonal"
"##)]), @"
    error: covariance[level, slope] is -0.086851851 in the population, and the model makes it 0

    hint: plan with values that obey the model, such as a fit of this very model
    ");
    assert_snapshot!(plan("fit.json", "", &[("m.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = 0.1
[mean]
fixed = { slope = 0 }
"##)]), @"
    error: mean[slope] is 0.533333333 in the population, and the model makes it 0

    hint: plan with values that obey the model, such as a fit of this very model
    ");
}

#[test]
fn designs_that_cannot_be_drawn() {
    assert_snapshot!(simulate("t.toml", "--out new.csv", &[("m.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = 0.1
[measurements.z]
column = "y"
equation = "level"
noise = 1
"##)]), @r#"
    error: measurements `y` and `z` both read every row of column `y`
      --> m.toml:12:10 | column = "y"
                       |          ^^^

    hint: `where` says which rows a measurement is read from
    "#);
    assert_snapshot!(simulate("t.toml", "--out new.csv", &[("m.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x + 0.1 * y"
noise = 0.1
"##)]), @"
    error: column `y` contains measurements and is also used as an input: a drawn value would change the model that it is drawn from

    hint: read the input from a column of its own
    ");
    assert_snapshot!(simulate("t.toml", "--out new.csv", &[("d.csv", "id,x,y\na,0,1.1\na,1,2.0\na,2,3.2\nb,0,0.4\nb,,0.9\nb,2,1.2\nc,0,2.0\nc,1,2.1\nc,2,2.3\n")]), @"
    error: d.csv, row 6 (test `b`): equation of measurement `y`: the cell of column `x` is empty, and it is needed

    hint: fill the cell, or leave the measured value empty too
    ");
    assert_snapshot!(simulate("t.toml", "--out new.csv", &[("d.csv", "id,u,y\na,0,1.1\na,1,2.0\na,2,3.2\nb,0,0.4\nb,1,0.9\nb,2,1.2\nc,0,2.0\nc,1,2.1\nc,2,2.3\n")]), @r#"
    error: d.csv has no column `x`, which is used in `equation` of measurement `y`
      --> m.toml:9:29 | equation = "level + slope * x"
                      |                             ^ this column is not in the data

    hint: its columns are `id`, `u`, `y`
    "#);
    assert_snapshot!(simulate("t.toml", "--out new.csv --tests 4", &[("m.toml", r##"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = "if(id == 'a', 0.1, 0.2)"
"##)]), @"
    error: column `id` tells tests apart and is used in `noise` of measurement `y` too, so a test cannot have a new id

    hint: ask for no more tests than the design has
    ");
}

#[test]
fn outputs_that_cannot_be() {
    assert_snapshot!(simulate("t.toml", "--out new.xlsx", &[]), @"error: cannot tell the format of `new.xlsx`: found `.xlsx`, expected one of `.csv`, `.tsv`, `.parquet`, `.arrow`");
    assert_snapshot!(simulate("t.toml", "--out new", &[]), @"error: cannot tell the format of `new`: found no extension, expected one of `.csv`, `.tsv`, `.parquet`, `.arrow`");
    assert_snapshot!(simulate("t.toml", "--out d.csv", &[]), @"
    error: the output `d.csv` is one of the inputs

    hint: give the output a name of its own
    ");
    assert_snapshot!(simulate("t.toml", "--out t.toml.csv --truth ./t.toml.csv", &[]), @"
    error: both outputs are `./t.toml.csv`, expected two files

    hint: give the output a name of its own
    ");
    assert_snapshot!(simulate("t.toml", "--out no/new.csv", &[]), @"
    error: the folder `no` for the output does not exist

    hint: name a folder that exists
    ");
    assert_snapshot!(plan("t.toml", "--out t.toml", &[]), @"
    error: the output `t.toml` is one of the inputs

    hint: give the output a name of its own
    ");
}
