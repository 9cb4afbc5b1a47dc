//! Broken input of every kind: exit status 2, a message that names what was found and what was expected, nothing written.

use crate::folder::{DATA, Folder, MODEL};
use insta::assert_snapshot;

/// Runs a command that must be refused; its message.
fn refused(args: &str, files: &[(&str, &str)]) -> String {
    let files: Vec<(&str, &[u8])> = files.iter().map(|(name, text)| (*name, text.as_bytes())).collect();
    refused_bytes(args, &files)
}

fn refused_bytes(args: &str, files: &[(&str, &[u8])]) -> String {
    let folder = Folder::new(files);
    folder.write("kept.json", b"from before");
    std::fs::create_dir(folder.path("folder")).expect("the folder is new");
    let before = folder.contents();
    let output = folder.run(args);
    let message = String::from_utf8(output.stderr).expect("messages are UTF-8");
    assert_eq!(output.status.code(), Some(2), "`kalfit {args}` says\n{message}");
    assert_eq!(String::from_utf8_lossy(&output.stdout), "", "standard output of `kalfit {args}`");
    assert!(!message.contains("panicked"), "`kalfit {args}` panicked:\n{message}");
    assert!(!message.contains('\u{1b}'), "colour outside a terminal:\n{message}");
    assert_eq!(before, folder.contents(), "`kalfit {args}` left the folder as it was");
    message
}

/// The sound model with one text replaced.
fn model(from: &str, to: &str) -> String {
    assert!(MODEL.contains(from), "`{from}` is in the model");
    MODEL.replacen(from, to, 1)
}

fn refused_model(from: &str, to: &str) -> String {
    refused("fit m.toml d.csv --out kept.json", &[("m.toml", &model(from, to))])
}

fn refused_data(from: &str, to: &str) -> String {
    assert!(DATA.contains(from), "`{from}` is in the data");
    refused("fit m.toml d.csv --out kept.json", &[("d.csv", &DATA.replacen(from, to, 1))])
}

#[test]
fn files_that_are_no_models() {
    assert_snapshot!(refused("fit no.toml d.csv", &[]), @"error: cannot read `no.toml`: No such file or directory (os error 2)");
    assert_snapshot!(refused("check no.toml", &[]), @"error: cannot read `no.toml`: No such file or directory (os error 2)");
    assert_snapshot!(refused("fit folder d.csv", &[]), @"error: cannot read `folder`: Is a directory (os error 21)");
    assert_snapshot!(refused("fit m.toml d.csv", &[("m.toml", "")]), @"
    error: the model has 0 states, expected 1 to 500

    hint: a state is a table in `[states]`, as in `intercept = {}`
    ");
    assert_snapshot!(refused("fit d.csv d.csv", &[]), @"
    error: not valid TOML: key with no value, expected `=`
      --> d.csv:1:3 | id,x,y
                    |   ^

    hint: the model file comes first, then the data
    ");
    assert_snapshot!(refused_bytes("fit m.toml d.csv", &[("m.toml", b"title = \"\xff\xfe\"")]), @"
    error: the file is not UTF-8 text: byte 9 is not part of a character

    hint: save the file as UTF-8 text
    ");
    assert_snapshot!(refused("check m.toml", &[("m.toml", &"[".repeat(100_000))]), @"
    error: not valid TOML: unquoted keys cannot be empty, expected letters, numbers, `-`, `_`
      --> m.toml:1:3 | [[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[...
                     |   ^
    ");
}

#[test]
fn wrong_keys_and_values_in_models() {
    assert_snapshot!(refused_model("noise = 0.1", "noize = 0.1"), @"
    error: unknown key `noize` in measurement `y`
      --> m.toml:10:1 | noize = 0.1
                      | ^^^^^

    hint: did you mean `noise`?
    ");
    assert_snapshot!(refused_model("noise = 0.1", ""), @"
    error: measurement `y` has neither `noise` nor `variance`, expected one of them
      --> m.toml:7:1 | [measurements.y]
                     | ^^^^^^^^^^^^^^^^

    hint: `noise` is a standard deviation, `variance` its square; 0 is legal
    ");
    assert_snapshot!(refused_model("noise = 0.1", "noise = -0.1"), @"
    error: `noise` of measurement `y` is -0.1, expected 0 or more
      --> m.toml:10:9 | noise = -0.1
                      |         ^^^^
    ");
    assert_snapshot!(refused_model("noise = 0.1", "noise = [1]"), @"
    error: `noise` of measurement `y` is an array, expected a number or an expression
      --> m.toml:10:9 | noise = [1]
                      |         ^^^ expected a number or an expression
    ");
    assert_snapshot!(refused_model("noise = 0.1", "noise = nan"), @"
    error: `noise` of measurement `y` is nan, expected a finite number
      --> m.toml:10:9 | noise = nan
                      |         ^^^
    ");
    assert_snapshot!(refused_model("[states.slope]", "[states.slope]\nprocess = \"gaus-markov\""), @r#"
    error: `process` of state `slope` is `gaus-markov`, expected `constant`, `random-walk`, `gauss-markov`, `gauss-markov-2` or `integral`
      --> m.toml:6:11 | process = "gaus-markov"
                      |           ^^^^^^^^^^^^^

    hint: did you mean `gauss-markov`?
    "#);
    assert_snapshot!(refused_model("[states.slope]", "[states.slope]\nprocess = \"random-walk\"\nnoise_density = 1"), @r#"
    error: state `slope` moves in continuous time, which needs `time` in `[data]`
      --> m.toml:6:11 | process = "random-walk"
                      |           ^^^^^^^^^^^^^

    hint: `time` names the column with the time of each row; `next` and `step_noise` need no time
    "#);
    assert_snapshot!(refused_model("[states.slope]", "[states.slope]\nsigma = 1"), @r#"
    error: `sigma` has no effect on a constant
      --> m.toml:6:1 | sigma = 1
                     | ^^^^^

    hint: write `process = "gauss-markov"`
    "#);
    assert_snapshot!(refused_model("[measurements.y]", "[parameters]\ntau = 3\n[measurements.y]"), @"
    error: parameter `tau` is not used
      --> m.toml:8:1 | tau = 3
                     | ^^^
    ");
    assert_snapshot!(refused_model("[data]", "[phases.one.states.a]\n[data]"), @"
    error: `states` has no effect when every phase has its own
      --> m.toml:5:2 | [states.level]
                     |  ^^^^^^
    ");
    assert_snapshot!(refused_model("[data]", "[filter]\nkind = \"kalman-schmidt\"\n[data]"), @"
    error: `[filter]` has no `covariance`
      --> m.toml:1:1 | [filter]
                     | ^^^^^^^^

    hint: the filter's own prior: a row and a column for every state, in the order level, slope
    ");
}

#[test]
fn wrong_equations_in_models() {
    assert_snapshot!(refused_model("slope * x", "slope * level"), @r#"
    error: state `slope` times state `level` is not linear in the states
      --> m.toml:9:21 | equation = "level + slope * level"
                      |                     ^^^^^^^^^^^^^
    "#);
    assert_snapshot!(refused_model("slope * x", "slope * (x"), @r#"
    error: the parenthesis is not closed, expected `)`
      --> m.toml:9:29 | equation = "level + slope * (x"
                      |                             ^
    "#);
    assert_snapshot!(refused_model("slope * x", "slope * sinus(x)"), @r#"
    error: unknown function `sinus`
      --> m.toml:9:29 | equation = "level + slope * sinus(x)"
                      |                             ^^^^^
    "#);
    assert_snapshot!(refused_model("slope * x", "slope * 'x'"), @r#"
    error: found a text, expected a number or a condition
      --> m.toml:9:29 | equation = "level + slope * 'x'"
                      |                             ^^^

    hint: texts are compared with columns, as in `sensor == 'A'`
    "#);
    assert_snapshot!(refused_model("slope * x", "slope / 0"), @r#"
    error: division by zero
      --> m.toml:9:21 | equation = "level + slope / 0"
                      |                     ^^^^^^^^^
    "#);
    let deep = format!("{}x{}", "(".repeat(5000), ")".repeat(5000));
    assert_snapshot!(refused_model("slope * x", &deep), @r#"
    error: the expression is nested deeper than 64 levels
      --> m.toml:9:84 | equation = "level + ((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((((...
                      |                                                                                    ^
    "#);
}

#[test]
fn wrong_constraints_in_models() {
    let with = |tail: &str| refused("check m.toml", &[("m.toml", &format!("{MODEL}\n{tail}"))]);
    assert_snapshot!(with("[mean]\nfixed = { scale = 0 }"), @"
    error: unknown state `scale` in `fixed` of `[mean]`
      --> m.toml:13:11 | fixed = { scale = 0 }
                       |           ^^^^^
    ");
    assert_snapshot!(with("[covariance]\nfixed = { \"level, slope\" = 1, \"slope,level\" = 2 }"), @r#"
    error: element `level, slope` is given twice in `fixed` of `[covariance]`: 1 and 2
      --> m.toml:13:31 | fixed = { "level, slope" = 1, "slope,level" = 2 }
                       |                               ^^^^^^^^^^^^^
    "#);
    assert_snapshot!(with("[covariance]\nstructure = \"fixed\"\nmatrix = [[1, 2], [2, 1]]"), @"
    error: the correlation of `level` and `slope` in `matrix` of `[covariance]` is 2.0000, expected -1 to 1
      --> m.toml:14:20 | matrix = [[1, 2], [2, 1]]
                       |                    ^
    ");
    assert_snapshot!(with("[covariance]\nstructure = \"fixed\"\nmatrix = [[1, 0]]"), @"
    error: `matrix` of `[covariance]` has 1 row, expected 2
      --> m.toml:14:10 | matrix = [[1, 0]]
                       |          ^^^^^^^^

    hint: a row and a column for every estimated state, in the order of Σ
    ");
    assert_snapshot!(with("[covariance]\nstructure = \"diagonal\"\nfixed = { \"level, slope\" = 1 }"), @r#"
    error: element `level, slope` in `fixed` of `[covariance]` is 1, but structure `diagonal` makes it 0
      --> m.toml:14:11 | fixed = { "level, slope" = 1 }
                       |           ^^^^^^^^^^^^^^
    "#);
    assert_snapshot!(with("[covariance]\nfixed = { \"level, level\" = 0, \"slope, slope\" = 1e-320 }\nequal = [[\"level, level\", \"slope, slope\"]]"), @r#"
    error: element `level, level` in `equal` is fixed at 0, so it has no value to share
      --> m.toml:14:11 | equal = [["level, level", "slope, slope"]]
                       |           ^^^^^^^^^^^^^^
    "#);
}

#[test]
fn wrong_arguments() {
    assert_snapshot!(refused("", &[]).lines().next().unwrap_or_default(), @"Error models from ensembles of non-identical tests, by maximum likelihood");
    assert_snapshot!(refused("frobnicate m.toml", &[]), @"
    error: unrecognized subcommand 'frobnicate'

    Usage: kalfit [OPTIONS] <COMMAND>

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fti m.toml", &[]), @"
    error: unrecognized subcommand 'fti'

    Usage: kalfit [OPTIONS] <COMMAND>

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fit m.toml", &[]), @"
    error: the following required arguments were not provided:
      <DATA>...

    Usage: kalfit fit <MODEL> <DATA>...

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fit m.toml d.csv --xyz fit.html", &[]), @"
    error: unexpected argument '--xyz' found

      tip: to pass '--xyz' as a value, use '-- --xyz'

    Usage: kalfit fit <MODEL> <DATA>...

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fit m.toml d.csv --tolerence 1", &[]), @"
    error: unexpected argument '--tolerence' found

      tip: a similar argument exists: '--tolerance'

    Usage: kalfit fit --tolerance <T> <MODEL> <DATA>...

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fit m.toml d.csv --phases marginal", &[]), @"
    error: `--phases marginal` has no effect: the model has one phase

    hint: leave it out
    ");
    assert_snapshot!(refused("fit m.toml d.csv --solver bfgs", &[]), @"
    error: invalid value 'bfgs' for '--solver <SOLVER>'
      [possible values: newton, em]

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fit m.toml d.csv --tolerance 0", &[]), @"
    error: invalid value '0' for '--tolerance <T>': expected a number above 0 and at most 1

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fit m.toml d.csv --tolerance nan", &[]), @"
    error: invalid value 'nan' for '--tolerance <T>': expected a number above 0 and at most 1

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fit m.toml d.csv --max-iterations 0", &[]), @"
    error: invalid value '0' for '--max-iterations <N>': 0 is not in 1..=4294967295

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fit m.toml d.csv --threads 0", &[]), @"
    error: invalid value '0' for '--threads <N>': 0 is not in 1..=1024

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fit m.toml d.csv --threads 99999999999", &[]), @"
    error: invalid value '99999999999' for '--threads <N>': 99999999999 is not in 1..=1024

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("fit m.toml d.csv --out a.json --out b.json", &[]), @"
    error: the argument '--out <FILE>' cannot be used multiple times

    Usage: kalfit fit [OPTIONS] <MODEL> <DATA>...

    For more information, try '--help'.
    ");
}

#[test]
fn wrong_assignments() {
    let set = |assignment: &str| {
        let text =
            format!("{}[parameters]\nsigma = {{ start = 1, upper = 5 }}\n", model("noise = 0.1", "noise = \"sigma\""));
        refused(&format!("fit m.toml d.csv --set {assignment}"), &[("m.toml", &text)])
    };
    assert_snapshot!(set("sigme=1"), @"
    error: unknown parameter `sigme` in the assignment `sigme=1`

    hint: did you mean `sigma`?
    ");
    assert_snapshot!(set("sigma"), @"error: `sigma` is not an assignment, expected `NAME=NUMBER` or `NAME[LEVEL]=NUMBER`");
    assert_snapshot!(set("sigma=x"), @"error: `sigma=x` is not an assignment, expected `NAME=NUMBER` or `NAME[LEVEL]=NUMBER`");
    assert_snapshot!(set("sigma=inf"), @"error: the value of `sigma=inf` is inf, expected a finite number");
    assert_snapshot!(set("sigma=-1"), @"error: standard deviation `sigma` is -1, expected 0 or more");
    assert_snapshot!(set("sigma=6"), @"error: standard deviation `sigma` is 6, expected at most 5, its `upper` bound");
    assert_snapshot!(set("sigma[A]=1"), @"
    error: `sigma[A]=1` has no effect on parameter `sigma`, which has no `per`

    hint: write `sigma=1`
    ");
}

#[test]
fn wrong_outputs_are_found_before_the_work_starts() {
    assert_snapshot!(refused("fit m.toml d.csv --out nowhere/fit.json", &[]), @"
    error: the folder `nowhere` for the output does not exist

    hint: name a folder that exists
    ");
    assert_snapshot!(refused("fit m.toml d.csv --out folder", &[]), @"
    error: the output `folder` is a folder, expected the name of a file

    hint: `--out` takes a file such as `fit.json`
    ");
    assert_snapshot!(refused("fit m.toml d.csv --out folder/..", &[]), @"
    error: the output `folder/..` is not a file name, expected the name of a file

    hint: `--out` takes a file such as `fit.json`
    ");
    assert_snapshot!(refused("fit m.toml d.csv --out d.csv", &[]), @"
    error: the output `d.csv` is one of the inputs

    hint: give the output a name of its own
    ");
    assert_snapshot!(refused("fit m.toml d.csv --out folder/../d.csv", &[]), @"
    error: the output `folder/../d.csv` is one of the inputs

    hint: give the output a name of its own
    ");
    assert_snapshot!(refused("fit m.toml *.csv --out ./m.toml", &[]), @"
    error: the output `./m.toml` is one of the inputs

    hint: give the output a name of its own
    ");
    assert_snapshot!(refused("reduce m.toml d.csv --out -", &[]), @"error: the output `-` is no name of a Parquet file, expected one that ends in `.parquet`");
    assert_snapshot!(refused("fit m.toml d.csv --out m.toml/fit.json", &[]), @"
    error: the folder `m.toml` for the output is not a folder

    hint: name a folder that exists
    ");
    #[cfg(unix)]
    assert_snapshot!(refused("fit m.toml d.csv --out /dev/null", &[]), @"
    error: the output `/dev/null` is a device or a pipe, expected the name of a file

    hint: `--out` takes a file such as `fit.json`
    ");
}

#[test]
fn files_that_are_no_data() {
    assert_snapshot!(refused("fit m.toml no.csv", &[]), @"error: cannot read no.csv: No such file or directory (os error 2)");
    assert_snapshot!(refused("fit m.toml no*.csv", &[]), @"
    error: no file matches `no*.csv`

    hint: `*` stands for any text, `?` for one character, `[ab]` for a or b, `**/` for any folders
    ");
    assert_snapshot!(refused("fit m.toml [.csv", &[]), @"
    error: `[.csv` is not a pattern of file names: invalid range pattern at character 1

    hint: give the file's whole name, or write `[*]` for a star and `[?]` for a question mark
    ");
    assert_snapshot!(refused("fit m.toml folder", &[]), @"
    error: `folder` is a directory, expected a file

    hint: give its files: `folder/*.csv`
    ");
    assert_snapshot!(refused("fit m.toml d.csv ./d.csv", &[]), @"
    error: the same data were given twice: `d.csv` and `./d.csv`

    hint: give each file once: its rows would count twice
    ");
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", "")]), @"error: d.csv is empty, expected a header and rows");
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", "id,x,y\n")]), @"error: d.csv has no rows");
    assert_snapshot!(refused("fit m.toml -", &[]), @"error: standard input is empty, expected a header and rows");
    assert_snapshot!(refused_bytes("fit m.toml d.csv.gz", &[("d.csv.gz", b"\x1f\x8b\x08\x00\x00\x00\x00\x00")]), @"
    error: d.csv.gz is compressed with gzip, expected CSV, Parquet or Arrow IPC

    hint: unpack it first, for instance `gunzip -c data.csv.gz | kalfit fit model.toml -`
    ");
    assert_snapshot!(refused_bytes("fit m.toml d.parquet", &[("d.parquet", b"PAR1 and then nothing good PAR1")]), @"
    error: d.parquet is not a sound Parquet file: EOF: Parquet file too small. Size is 31 but need 543453047

    hint: the file may be damaged, or not copied whole; if other programs read it, write it again with one of them
    ");
    assert_snapshot!(refused_bytes("fit m.toml d.arrow", &[("d.arrow", b"ARROW1\0\0\xff\xff\xff\xff\xff\xff\xff\x7f")]), @"
    error: d.arrow is not a sound Arrow IPC file: Parser error: Arrow file does not contain correct footer

    hint: the file may be damaged, or not copied whole; if other programs read it, write it again with one of them
    ");
    assert_snapshot!(refused_bytes("fit m.toml d.csv", &[("d.csv", b"id,x,y\na,1,\xff\n")]), @"
    error: d.csv, row 2: found bytes that are not UTF-8 text in column `y`

    hint: save the file as UTF-8
    ");
}

#[test]
fn wrong_cells_in_data() {
    assert_snapshot!(refused_data("id,x,y", "id,X,y"), @r#"
    error: d.csv has no column `x`, which is used in `equation` of measurement `y`
      --> m.toml:9:29 | equation = "level + slope * x"
                      |                             ^ this column is not in the data

    hint: there is a column `X`
    "#);
    assert_snapshot!(refused_data("id,x,y", "unit,x,y"), @r#"
    error: d.csv has no column `id`, which is used in `test` of `[data]`
      --> m.toml:2:8 | test = "id"
                     |        ^^^^ this column is not in the data

    hint: its columns are `unit`, `x`, `y`
    "#);
    assert_snapshot!(refused_data("id,x,y", "id,y,y"), @"
    error: d.csv has two columns named `y`: its columns 2 and 3

    hint: rename one of them: the model cannot tell which is meant
    ");
    assert_snapshot!(refused_data("a,1,2.0", "a,1,2.0 V"), @"
    error: d.csv, row 3, column `y`: found `2.0 V`, expected a number

    hint: a cell holds a number and nothing else; units go into the model file
    ");
    assert_snapshot!(refused_data("a,1,2.0", "a,1,\"2,0\""), @"
    error: d.csv, row 3, column `y`: found `2,0`, expected a number

    hint: write the decimal comma as `.`
    ");
    assert_snapshot!(refused_data("a,1,2.0", "a,1,2,0"), @"
    error: d.csv, row 3: found 4 cells, expected 3 as in the header

    hint: a cell that contains the delimiter needs quotes; a decimal comma needs another delimiter
    ");
    assert_snapshot!(refused_data("a,1,2.0", "a,1,inf"), @"
    error: d.csv, row 3, column `y`: found `inf`, expected a finite number

    hint: write `NA` where there is no measurement
    ");
    assert_snapshot!(refused_data("a,1,2.0", "a,,2.0"), @"
    error: d.csv, row 3 (test `a`): equation of measurement `y`: the cell of column `x` is empty, and it is needed

    hint: fill the cell, or leave the measured value empty too
    ");
    assert_snapshot!(refused_data("a,1,2.0", ",1,2.0"), @"
    error: d.csv, row 3, column `id`: found a missing cell, expected the id of the row's test

    hint: every row needs the id of its test
    ");
    assert_snapshot!(refused_data("a,1,2.0", "a,1,\"2.0"), @r#"
    error: d.csv, row 3: found a quote that is still open at the end of the file, expected another `"`

    hint: a quote opens a cell that ends at the next quote; write `""` for a quote inside it
    "#);
    assert_snapshot!(refused_data("a,1,2.0", "a,1,\u{1b}[31mred"), @r"
    error: d.csv, row 3, column `y`: found `\u{1b}[31mred`, expected a number

    hint: leave a missing cell empty, or add its text to `missing` of `[data]`
    ");
}

#[test]
fn data_that_do_not_fit_the_model() {
    let with = |from: &str, to: &str, data: &str| {
        refused("fit m.toml d.csv --out kept.json", &[("m.toml", &model(from, to)), ("d.csv", data)])
    };
    assert_snapshot!(with("[states.level]", "time = \"t\"\n[states.level]", "id,x,y,t\na,1,2,5\na,1,2,4\n"), @"
    error: d.csv, row 3, column `t`: found time 4 after time 5 in test `a`, expected times that do not decrease

    hint: sort the rows of each test by time; if these are two tests, give them two ids
    ");
    let moving = "[states.level]\nprocess = \"random-walk\"\nnoise_density = 1";
    let timed = |initial_time: &str| format!("time = \"t\"\ninitial_time = {initial_time}\n{moving}");
    assert_snapshot!(with("[states.level]", &timed("7"), "id,x,y,t\na,1,2,5\n"), @"
    error: d.csv, row 2 (test `a`): initial time: the initial time 7 is later than the first row's time 5

    hint: `initial_time` must not be later than the first row
    ");
    assert_snapshot!(with("[states.level]", &timed("\"s\""), "id,x,y,t,s\na,1,2,5,1\na,1,2,6,2\n"), @"
    error: d.csv, row 3 (test `a`): the test: column `s` varies within the test: 1 and 2

    hint: such a column must have one value per test
    ");
    assert_snapshot!(with("noise = 0.1", "variance = \"v\"", "id,x,y,v\na,1,2,1\na,1,2,-1\n"), @"
    error: d.csv, row 3 (test `a`): noise variance of measurement `y`: found a variance of -1, expected 0 or more

    hint: a `noise` is a standard deviation; `variance` must be 0 or more
    ");
    assert_snapshot!(with("noise = 0.1", "noise = \"1 / v\"", "id,x,y,v\na,1,2,1\na,1,2,0\n"), @"error: d.csv, row 3 (test `a`): noise variance of measurement `y`: the value is not a finite number");
    assert_snapshot!(with("noise = 0.1", "noise = 0", DATA), @"
    error: d.csv, row 4 (test `a`): measurement `y`: measured without any noise, the value is off by 3.000e-1, which is impossible

    hint: give the measurement or the process some noise, or correct the value
    ");
    assert_snapshot!(with("[states.slope]", "[states.slope]\nnext = \"2 * slope\"\nstep_noise = 1\ninitial = \"stationary\"", DATA), @r#"
    error: stationary start of state `slope`: the motion has no stationary distribution: it is not stable (slope)

    hint: give `initial = { mean, sigma }` or `initial = "estimated"`
    "#);
    assert_snapshot!(with("[states.level]", "time = \"t\"\n[states.level]", "id,x,y,t\na,1,2,2024-01-01\n"), @"
    error: d.csv, row 2, column `t`: found date-times, expected a time unit for them in the model, which has none

    hint: date-times are read as time since the test's first row: set `time_unit` in `[data]` to `s`, `ms`, `us`, `ns`, `min`, `h` or `d`
    ");
}

#[test]
fn check_refuses_exact_measurements_that_cannot_be_as_fit_does() {
    // a free parameter without a start, so that `check` has no values to run the filters at
    let model = MODEL.replace("noise = 0.1", "noise = 0")
        + "[measurements.w]\ncolumn = \"x\"\nequation = \"slope\"\nnoise = \"s\"\n[parameters]\ns = {}\n";
    let by = |command: &str| refused(&format!("{command} exact.toml d.csv"), &[("exact.toml", &model)]);
    assert_eq!(by("check"), by("fit"));
    assert_snapshot!(by("check"), @"
    error: d.csv, row 4 (test `a`): measurement `y`: measured without any noise, the value is off by 3.000e-1, which is impossible

    hint: give the measurement or the process some noise, or correct the value
    ");
}
