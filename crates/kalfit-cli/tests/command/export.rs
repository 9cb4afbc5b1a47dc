//! `kalfit export` through the built command: a filter written in C gives kalfit's own predictions.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use std::io::Write;
use std::process::{Command, Stdio};

use insta::assert_snapshot;
use kalfit_fixtures::near;
use serde_json::Value;

use crate::folder::{Folder, shown};

const MODEL: &str = r#"
title = "Turntable"

[data]
test = "unit"
time = "t"
time_unit = "s"
[states.bias]
unit = "deg/s"
[states.drift]
process = "gauss-markov"
time_constant = 3
sigma = 0.4
[states.angle]
derivative = "bias + drift + 0.5 * (rate - 1)"
noise_density = 0.1
initial = { mean = 0, sigma = 0.2 }
[measurements.encoder]
column = "y"
equation = "angle"
noise = "sigma"
[measurements.gyro]
column = "z"
equation = "bias + drift + 0.3 * rate"
noise = 0.2
[noise_covariance]
"encoder, gyro" = 0.02
[parameters]
sigma = { start = 0.3 }
"#;

/// Where the sensitivity to temperature multiplies a state, and each lot has a noise level of its own.
const WARM: &str = r#"
[data]
test = "unit"
[states.bias]
[states.slope]
[measurements.gyro]
column = "z"
equation = "bias + rate * slope + 0.3"
noise = "sigma"
[parameters]
sigma = { start = 0.3, per = "lot" }
"#;

/// Eight units of twelve rows, half a second apart, a value missing now and then.
fn rows() -> Vec<(String, [f64; 4])> {
    let wave = |k: i32| f64::from(k % 23 - 11) / 10.0;
    let mut rows = Vec::new();
    for j in 0..8 {
        let (bias, mut angle) = (wave(j * 17 + 3), 0.1 * wave(j * 5));
        for k in 0..12 {
            let rate = 1.0 + wave(j * 3 + k * 7);
            let drift = 0.4 * wave(j * 11 + k);
            angle += 0.5 * (bias + drift + 0.5 * (rate - 1.0));
            let y = if (j + k) % 5 == 3 { f64::NAN } else { angle + 0.3 * wave(j * 7 + k * 13) };
            let z = if (j * 2 + k) % 7 == 1 { f64::NAN } else { bias + drift + 0.3 * rate + 0.2 * wave(j + k * 19) };
            rows.push((format!("u{j}"), [0.5 * f64::from(k), rate, y, z]));
        }
    }
    rows
}

/// The rows as a table, with `missing` for what was not measured.
fn table(separator: &str, missing: &str) -> String {
    let cell = |x: &f64| if x.is_nan() { missing.to_owned() } else { x.to_string() };
    let line = |(unit, cells): &(String, [f64; 4])| {
        let cells: Vec<String> = cells.iter().map(cell).collect();
        let lot = if unit.as_str() < "u4" { "A" } else { "B" };
        format!("{unit}{separator}{}{separator}{lot}\n", cells.join(separator))
    };
    rows().iter().map(line).collect()
}

fn fitted() -> Folder {
    let data = format!("unit,t,rate,y,z,lot\n{}", table(",", ""));
    let folder =
        Folder::new(&[("m.toml", MODEL.as_bytes()), ("warm.toml", WARM.as_bytes()), ("d.csv", data.as_bytes())]);
    for model in ["m", "warm"] {
        let output = folder.run(&format!("fit {model}.toml d.csv --out {model}.json --quiet"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    }
    folder
}

/// (value, standard deviation) of each measured value as kalfit predicts it, in the order of the data.
fn predicted(folder: &Folder) -> Vec<(f64, f64)> {
    let output = folder.run("apply m.toml d.csv --from m.json --states s.csv --kind predicted --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let mut reader = csv::Reader::from_path(folder.path("s.csv")).unwrap();
    let rows: Vec<std::collections::HashMap<String, String>> = reader.deserialize().map(|row| row.unwrap()).collect();
    let number = |text: &String| text.parse().unwrap();
    let measured = rows.iter().filter(|row| row["what"] == "measurement");
    measured.map(|row| (number(&row["value"]), number(&row["std_dev"]))).collect()
}

/// A Kalman filter from a textbook, for up to two measurements of a step.
const FILTER: &str = r#"
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "turntable.h"
#define N TURNTABLE_STATES
#define M TURNTABLE_MEASUREMENTS
#define K TURNTABLE_INPUTS
static double x[N], P[N][N];
static void step(const double *u) {
    double y[N], A[N][N];
    int i, j, k;
    for (i = 0; i < N; i++) {
        y[i] = 0;
        for (k = 0; k < N; k++) y[i] += turntable_F[i * N + k] * x[k];
        for (k = 0; k < K; k++) y[i] += turntable_B[i * K + k] * u[k];
    }
    memcpy(x, y, sizeof x);
    for (i = 0; i < N; i++) for (j = 0; j < N; j++)
        for (A[i][j] = 0, k = 0; k < N; k++) A[i][j] += turntable_F[i * N + k] * P[k][j];
    for (i = 0; i < N; i++) for (j = 0; j < N; j++)
        for (P[i][j] = turntable_Q[i * N + j], k = 0; k < N; k++) P[i][j] += A[i][k] * turntable_F[j * N + k];
}
int main(void) {
    char unit[64], last[64] = "", lot[64];
    double t, z[M], u[K], rate;
    while (scanf("%63s %lf %lf %lf %lf %63s", unit, &t, &rate, &z[0], &z[1], lot) == 6) {
        double e[M], T[M][N], S[M][M], G[N][M];
        int seen[M], m = 0, i, j, k;
        for (k = 0; k < K; k++) u[k] = strcmp(turntable_inputs[k], "1") ? rate : 1;
        if (strcmp(unit, last)) {
            memcpy(x, turntable_x0, sizeof x);
            memcpy(P, turntable_P0, sizeof P);
            strcpy(last, unit);
        } else step(u);
        for (i = 0; i < M; i++) if (!isnan(z[i])) seen[m++] = i;
        for (i = 0; i < m; i++) {
            const double *h = turntable_H + seen[i] * N;
            double value = 0;
            for (k = 0; k < N; k++) value += h[k] * x[k];
            for (k = 0; k < K; k++) value += turntable_D[seen[i] * K + k] * u[k];
            e[i] = z[seen[i]] - value;
            for (j = 0; j < N; j++) for (T[i][j] = 0, k = 0; k < N; k++) T[i][j] += h[k] * P[k][j];
        }
        for (i = 0; i < m; i++) for (j = 0; j < m; j++)
            for (S[i][j] = turntable_R[seen[i] * M + seen[j]], k = 0; k < N; k++) S[i][j] += T[i][k] * turntable_H[seen[j] * N + k];
        for (i = 0; i < m; i++) printf("%.17g %.17g\n", z[seen[i]] - e[i], sqrt(S[i][i]));
        for (k = 0; k < N; k++) {
            if (m == 1) G[k][0] = T[0][k] / S[0][0];
            if (m == 2) {
                double d = S[0][0] * S[1][1] - S[0][1] * S[1][0];
                G[k][0] = (T[0][k] * S[1][1] - T[1][k] * S[1][0]) / d;
                G[k][1] = (T[1][k] * S[0][0] - T[0][k] * S[0][1]) / d;
            }
        }
        for (k = 0; k < N; k++) for (i = 0; i < m; i++) {
            x[k] += G[k][i] * e[i];
            for (j = 0; j < N; j++) P[k][j] -= G[k][i] * T[i][j];
        }
    }
    return 0;
}
"#;

fn there_is(program: &str) -> bool {
    let found = Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success());
    if !found {
        let _ = writeln!(std::io::stderr(), "left out: there is no `{program}`");
    }
    found
}

#[test]
fn a_filter_in_c_gives_the_predictions_of_kalfit() {
    let folder = fitted();
    let output = folder.run("export m.toml --from m.json --step 0.5 --as c --out turntable.h");
    assert_snapshot!(shown(&output), @"
    exit 0
    ----- stdout
    Turntable

    The filter at a step of 0.5 s, all parameters as in m.json: 3 states, 2
    measurements and 2 inputs.

    States of a new test
      state  unit          x0  std. dev.  of a step
      bias   deg/s  -0.037654    0.68188          0
      drift                 0        0.4    0.21297
      angle                 0        0.2   0.094497

    Measurements
      measurement  column   noise
      encoder      y       0.2329
      gyro         z          0.2

    Inputs
      input  goes to
      rate   angle, gyro
      1      angle

    How to use it
      x = F x + B u + w with w ~ N(0, Q) from step to step; z = H x + D u + v with v
        ~ N(0, R).
      x0 is at: first row. A step takes u from the row that it leads to, a
        measurement from its own.
    ----- stderr
    Wrote turntable.h
    ");
    if !there_is("cc") {
        return;
    }
    folder.write("filter.c", FILTER.as_bytes());
    let cc = |arguments: &str| {
        let arguments = format!("-std=c99 -pedantic -Wall -Wextra -Werror {arguments}");
        let output = Command::new("cc").args(arguments.split(' ')).current_dir(folder.path("")).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    cc("filter.c -o filter -lm");
    let mut filter = Command::new(folder.path("filter")).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    filter.stdin.take().unwrap().write_all(table(" ", "nan").as_bytes()).unwrap();
    let output = filter.wait_with_output().unwrap();
    let numbers = |line: &str| -> Vec<f64> { line.split(' ').map(|x| x.parse().unwrap()).collect() };
    let found: Vec<Vec<f64>> = String::from_utf8_lossy(&output.stdout).lines().map(numbers).collect();
    let expected = predicted(&folder);
    assert_eq!(found.len(), expected.len(), "measured values");
    assert!(expected.len() > 150, "{} measured values", expected.len());
    for (k, (found, (value, deviation))) in found.iter().zip(expected).enumerate() {
        for (what, found, expected) in [("value", found[0], value), ("deviation", found[1], deviation)] {
            assert!((found - expected).abs() < 1e-9 * (1.0 + expected.abs()), "{what} {k}: {found} against {expected}");
        }
    }
    if there_is("c++") {
        folder.write(
            "other.cpp",
            b"#include \"turntable.h\"\nint main() { return turntable_F[0] > 2 || !turntable_states[0]; }\n",
        );
        let mut arguments = "-Wall -Wextra -pedantic -Werror -Wno-unused -fsyntax-only other.cpp".split(' ');
        let output = Command::new("c++").args(&mut arguments).current_dir(folder.path("")).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}

/// Whatever a model says, a header is a header, and two files of similar names are two.
#[test]
fn hostile_texts_stay_comments() {
    let folder = fitted();
    let model = std::fs::read_to_string(folder.path("m.toml")).unwrap();
    for title in ["Runs of runs/*.csv", "*/ int x; /*", "what ??/", r"/\* *\/ \\", "\u{202e} reversed", "/*/ //*"] {
        let model = model.replace("title = \"Turntable\"", &format!("title = '{title}'"));
        folder.write("h.toml", model.as_bytes());
        for out in ["a-b.h", "a_b.h"] {
            let output = folder
                .run(&format!("export h.toml --from m.json --step 0.5 --as c --out {out} --quiet --set sigma=0.3"));
            assert!(matches!(output.status.code(), Some(0)), "{title}: {}", shown(&output));
        }
        let [one, other] = ["a-b.h", "a_b.h"].map(|name| std::fs::read_to_string(folder.path(name)).unwrap());
        let guard = |text: &str| text.lines().find(|line| line.starts_with("#ifndef")).map(str::to_owned);
        assert!(guard(&one).is_some() && guard(&one) != guard(&other), "{:?}", guard(&one));
        assert!(!one.contains('\u{202e}'), "{one}");
        ["a-b.h", "a_b.h"].iter().for_each(|name| std::fs::remove_file(folder.path(name)).unwrap());
        if there_is("cc") {
            folder.write("a.h", one.as_bytes());
            folder.write("main.c", b"#include \"a.h\"\nint main(void) { return a_b_F[0] > 2; }\n");
            let arguments = "-std=c99 -pedantic -Wall -Wextra -Werror -Wno-unused-variable -fsyntax-only main.c";
            let output = Command::new("cc").args(arguments.split(' ')).current_dir(folder.path("")).output().unwrap();
            assert!(output.status.success(), "{title}: {}", String::from_utf8_lossy(&output.stderr));
        }
    }
}

#[test]
fn json_has_the_keys_that_scripts_rely_on() {
    let folder = fitted();
    let output = folder.run("export m.toml --from m.json --step 0.5 --out f.json --quiet");
    assert_eq!(shown(&output), "exit 0\n----- stdout\n----- stderr\n");
    let record: Value = serde_json::from_slice(&std::fs::read(folder.path("f.json")).unwrap()).unwrap();
    for key in ["step", "states", "measurements", "F", "Q", "B", "inputs", "H", "R", "x0", "P0", "units"] {
        assert!(record.get(key).is_some_and(|value| !value.is_null()), "{key}");
    }
    assert_eq!(record["states"], serde_json::json!(["bias", "drift", "angle"]));
    assert_eq!(record["inputs"], serde_json::json!(["rate", "1"]));
    // by hand: exp(-0.5/3), and what a rate of 1 moves the angle in half a second
    let check = |what: &str, found: &Value, expected: f64| {
        near::absolute(what, found.as_f64().unwrap(), expected, 1e-12);
    };
    check("F of the drift", &record["F"][1][1], (-0.5_f64 / 3.0).exp());
    check("Q of the drift", &record["Q"][1][1], 0.16 * (1.0 - (-1.0_f64 / 3.0).exp()));
    check("B of the angle", &record["B"][2][0], 0.25);
    check("of the constant", &record["B"][2][1], -0.25);
    check("D of the gyro", &record["D"][1][0], 0.3);
    check("R", &record["R"][0][1], 0.02);
    check("P0 of the angle", &record["P0"][2][2], 0.04);
    check("P0 of the drift", &record["P0"][1][1], 0.16);
    // from the values of a model, too
    let fixed = MODEL.replace(
        "sigma = { start = 0.3 }",
        "sigma = 0.3\n[mean]\nfixed = { bias = 1 }\n[covariance]\nfixed = { \"bias, bias\" = 4 }",
    );
    folder.write("truth.toml", fixed.as_bytes());
    let output = folder.run("export m.toml --from truth.toml --step 0.5 --out t.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let record: Value = serde_json::from_slice(&std::fs::read(folder.path("t.json")).unwrap()).unwrap();
    check("x0", &record["x0"][0], 1.0);
    check("P0", &record["P0"][0][0], 4.0);
}

#[test]
fn what_has_no_constant_matrices_is_refused_with_a_way_out() {
    let folder = fitted();
    assert_snapshot!(shown(&folder.run("export warm.toml --from warm.json --out f.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the filter has no constant matrices: equation of measurement `gyro` depends on column `rate`; noise variance of measurement `gyro` depends on column `lot`, of which parameter `sigma` has levels

    hint: fix what they depend on: `--at lot=VALUE`, `--at rate=VALUE`
    ");
    assert_snapshot!(shown(&folder.run("export warm.toml --from warm.json --at rate=2 --at lot=C --out f.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: parameter `sigma` has no value where `lot` is `C`, expected one of `A`, `B`
    ");
    assert_snapshot!(shown(&folder.run("export warm.toml --from warm.json --at rate=2 --at lot=A --at y=1 --out f.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: a value of column `y` has no effect: the filter depends on `rate`, `lot`

    hint: leave it out
    ");
    assert_snapshot!(shown(&folder.run("export warm.toml --from warm.json --at rate=2 --at lot=A --step 1 --out f.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: a step of 1 has no effect: the rows of the model have no times, each is a step

    hint: leave it out
    ");
    assert_snapshot!(shown(&folder.run("export m.toml --from m.json --out f.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: derivative of state `drift` depends on the length of a step, which is not given

    hint: give it in the model's unit of time: `--step 0.01`
    ");
    assert_snapshot!(shown(&folder.run("export m.toml --from m.json --step 0.5 --phase coast --out f.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the model has no phase `coast`, expected `main`
    ");
    assert_snapshot!(shown(&folder.run("export m.toml --from m.json --step 0.5 --out filter")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: what `filter` is to hold is not said

    hint: say it by `--as json`, `npz`, `mat`, `c` or `python`, or by an ending: `.json`, `.npz`, `.mat`, `.h`, `.py`
    ");
    assert_snapshot!(shown(&folder.run("export m.toml --from m.json --step 0.5 --as mat --out f.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the output `f.json` would hold variables of Matlab, which its ending does not say

    hint: the endings are `.json`, `.npz`, `.mat`, `.h` and `.py`: give the file that of its format, or leave `--as` out
    ");
    assert_snapshot!(shown(&folder.run("export m.toml --from m.json --step 0.5 --out m.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the output `m.json` is one of the inputs

    hint: give the output a name of its own
    ");
    assert!(!folder.path("f.json").exists(), "nothing is written");
    assert_snapshot!(shown(&folder.run("export warm.toml --from warm.json --at rate=2 --at lot=A --out f.json")), @"
    exit 0
    ----- stdout
    The filter from row to row, where rate=2, lot=A, all parameters as in warm.json:
    2 states, 1 measurement and 1 input.

    States of a new test
      state       x0  std. dev.  of a step
      bias   -0.3498    0.80527          0
      slope  0.31379    0.05803          0

    Measurements
      measurement  column    noise
      gyro         z       0.19906

    Inputs
      input  goes to
      1      gyro

    How to use it
      x = F x + B u + w with w ~ N(0, Q) from step to step; z = H x + D u + v with v
        ~ N(0, R).
      x0 is at: first row. A step takes u from the row that it leads to, a
        measurement from its own.
    ----- stderr
    Wrote f.json
    ");
}
