//! Tests whose groups cross: units on stations, plates and samples.

use crate::folder::{Folder, shown};
use insta::assert_snapshot;
use kalfit::FitRecord;
use kalfit::record::RatioRecord;

fn folder() -> Folder {
    let folder = Folder::new(&[]);
    for name in ["penicillin.toml", "penicillin.csv", "stations.toml", "stations.csv"] {
        folder.copy(&format!("tests/data/crossed/{name}"));
    }
    folder
}

fn fit(folder: &Folder, command: &str) -> FitRecord {
    let output = folder.run(&format!("fit {command} --out fit.json --quiet"));
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    serde_json::from_str(&std::fs::read_to_string(folder.path("fit.json")).expect("it was written")).expect("a record")
}

fn close(found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < tolerance * (1.0 + expected.abs()), "{found} {expected}");
    }
}

fn variances(record: &FitRecord) -> Vec<f64> {
    record.all_levels().flat_map(|level| level.covariance.estimate.iter().flatten().copied()).collect()
}

/// lme4 1.1-31: `diameter ~ 1 + (1 | plate) + (1 | sample)`.
#[test]
fn plates_and_samples_are_those_of_lme4() {
    let folder = folder();
    let found = fit(&folder, "penicillin.toml penicillin.csv");
    assert!(found.converged);
    close(&[found.log_likelihood, found.phases[0].mean.estimate[0]], &[-166.094174334, 22.972222222], 1e-9);
    let deviations: Vec<f64> = variances(&found).iter().map(|v| v.sqrt()).collect();
    close(&deviations, &[0.845572307, 1.770646909, 0.0], 1e-6);
    close(&[found.parameters[0].estimate], &[0.549932329], 1e-6);
    let names: Vec<(&str, usize)> =
        found.crossed.iter().map(|factor| (factor.level.name.as_str(), factor.effects.len())).collect();
    assert_eq!(names, [("plate", 24), ("sample", 6)]);
    let samples: Vec<f64> = found.crossed[1].effects.iter().map(|one| one.mean[0]).collect();
    close(&samples, &[2.185659766, -1.009830145, 1.936660552, -0.096833028, -0.01383329, -3.001823855], 1e-6);
    let restricted = fit(&folder, "penicillin.toml penicillin.csv --criterion reml");
    close(&[restricted.log_likelihood], &[-165.4302945], 1e-8);
    let deviations: Vec<f64> = variances(&restricted).iter().map(|v| v.sqrt()).collect();
    close(&deviations, &[0.8467, 1.9316, 0.0], 3e-5); // as lme4 rounds them
    // pbkrtest 0.5.2, at lme4's optimum
    let mean = &restricted.phases[0].mean;
    close(&[mean.std_error[0].expect("known")], &[0.8085953614], 3e-5);
    close(&[mean.few_tests.df[0].expect("known")], &[5.48706186], 1e-5);
}

/// An independent maximisation of the dense likelihood, with the time constant and both noises free; the covariance from
/// run to run has rank one there.
#[test]
fn units_on_stations_with_free_dynamics_are_those_of_the_dense_likelihood() {
    let folder = folder();
    let found = fit(&folder, "stations.toml stations.csv");
    assert!(found.converged);
    close(&[found.log_likelihood], &[-326.108235328], 1e-9);
    let parameters: Vec<f64> = found.parameters.iter().map(|one| one.estimate).collect();
    close(&parameters, &[3.361123697, 0.748924683, 0.242154311], 1e-6);
    close(&found.phases[0].mean.estimate, &[1.186911734, -0.196543145], 1e-6);
    let station = [0.383877838, 0.0, 0.0, 0.0];
    let serial = [1.012331327, -0.036951313, -0.036951313, 0.075998154];
    let run = [0.007539422, 0.008700046, 0.008700046, 0.010039339];
    close(&variances(&found), &[station, serial, run].concat(), 2e-6);
    let fixed_at_start = found.levels[1].boundary.iter().map(|one| (one.rank, one.of)).collect::<Vec<_>>();
    assert_eq!(fixed_at_start, [(1, 2)]);
}

#[test]
fn the_summary_shows_factors_beside_levels() {
    let folder = folder();
    let summary = shown(&folder.run("fit stations.toml stations.csv"));
    let (from, to) = (summary.find("Levels:").expect("counts"), summary.find("Dynamic").expect("parameters"));
    assert_snapshot!(&summary[from..to], @"
    Levels: 10 groups of `serial`; 40 tests within them. Crossed: 5 levels of
    `station`.

    Initial state: mean, and standard deviation at each level (± standard error)
      state            mean  station to station  serial to serial
      bias      1.19 ± 0.43         0.62 ± 0.23       1.01 ± 0.25
      scale  -0.197 ± 0.093                         0.276 ± 0.070

      state       within one serial
      bias     0.09 ± 0.19 boundary
      scale  0.100 ± 0.043 boundary
      With 5 levels of station, ± 1.96 standard errors hold the mean about 85 % of
        the time; --criterion reml allows for that.

    Correlations within one serial (± standard error)
              bias
      scale  1.000

    What the data cannot determine
      Within one serial, Σ is singular: rank 1 of 2; no variation from test to test
        was found in one combination of these states.

    Spread by level (share: part of the variance of the states)
      state  spread      number  std dev                  95 % interval      share
      bias   station to       5     0.62 ± 0.23           0.30 to 1.28      27.3 %
             station
             serial to       10     1.01 ± 0.25           0.62 to 1.65      72.1 %
             serial
             within one      40     0.09 ± 0.19 boundary  0.00 to 5.81     0.537 %
             serial
      scale  serial to       10    0.276 ± 0.070          0.168 to 0.452    88.3 %
             serial
             within one      40    0.100 ± 0.043          0.043 to 0.233    11.7 %
             serial                      boundary

    Correlations from serial to serial (± standard error)
                     bias
      scale  -0.13 ± 0.34

    Effect of each station (± posterior standard deviation)
      station  tests   bias
      s0           9   0.63 ± 0.29
      s1           5   0.06 ± 0.31
      s2          11  -1.00 ± 0.28
      s3          10   0.28 ± 0.29
      s4           5   0.03 ± 0.31

    Outlying groups
      No group is an outlier: the smallest of 15 p-values is 0.09 (serial 0), or 1
        after Bonferroni correction.
    ");
}

#[test]
fn a_factor_without_effect_is_a_hypothesis() {
    let folder = folder();
    std::fs::write(folder.path("null.toml"), "[crossed.station.covariance]\nstates = []\n").expect("a file");
    let output = folder.run("test stations.toml stations.csv --null null.toml --out test.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let text = std::fs::read_to_string(folder.path("test.json")).expect("it was written");
    let found: RatioRecord = serde_json::from_str(&text).expect("a record");
    // the same as the model without the factor
    let model = std::fs::read_to_string(folder.path("stations.toml")).expect("it was copied");
    let without: String = model
        .lines()
        .filter(|line| !line.contains("crossed") && *line != "states = [\"bias\"]")
        .map(|line| format!("{line}\n"))
        .collect();
    std::fs::write(folder.path("without.toml"), without).expect("a file");
    let alone = fit(&folder, "without.toml stations.csv");
    close(&[found.null.log_likelihood], &[alone.log_likelihood], 1e-8);
}

/// Laboratories that share no station: a station that all units of a laboratory meet, and no other unit, is a level
/// around the units, and both spellings are one model.
#[test]
fn a_factor_around_all_units_is_a_level() {
    let folder = folder();
    let model = std::fs::read_to_string(folder.path("stations.toml")).expect("it was copied");
    let data = std::fs::read_to_string(folder.path("stations.csv")).expect("it was copied");
    let (head, rows) = data.split_once('\n').expect("a header");
    let lab = |line: &str| {
        let serial: usize = line.split(',').next().expect("a serial").parse().expect("a number");
        format!("{line},lab{}\n", serial % 4)
    };
    let labs = format!("{head},lab\n{}", rows.lines().map(lab).collect::<String>());
    std::fs::write(folder.path("labs.csv"), labs).expect("a file");
    let crossed = model.replace("station", "lab").replace("Gyros on labs", "labs");
    std::fs::write(folder.path("crossed.toml"), &crossed).expect("a file");
    let nested = crossed.replace("crossed = [\"lab\"]\n", "").replace("[\"serial\"]", "[\"lab\", \"serial\"]");
    std::fs::write(folder.path("nested.toml"), nested.replace("[crossed.lab", "[levels.lab")).expect("a file");
    let (one, other) = (fit(&folder, "crossed.toml labs.csv"), fit(&folder, "nested.toml labs.csv"));
    close(&[one.log_likelihood], &[other.log_likelihood], 1e-9);
    close(&variances(&one), &variances(&other), 1e-5);
    assert!(one.notes.iter().any(|note| note.contains("`lab` does not cross `serial`")), "{:?}", one.notes);
}

#[test]
fn what_is_not_a_factor_is_refused_in_words() {
    let folder = folder();
    let model = std::fs::read_to_string(folder.path("stations.toml")).expect("it was copied");
    let refused = |changed: String| {
        assert_ne!(model, changed);
        std::fs::write(folder.path("wrong.toml"), changed).expect("a file");
        let output = folder.run("fit wrong.toml stations.csv");
        assert_eq!(output.status.code(), Some(2));
        shown(&output)
    };
    let listed = |to: &str| refused(model.replace("crossed = [\"station\"]", to));
    let all = [
        listed("crossed = []"),
        listed("crossed = [\"serial\"]"),
        listed("crossed = [\"run\"]"),
        listed(""),
        refused(model.replace("[crossed.station.", "[crossed.bench.")),
        refused(model.replace("\"station\"", "\"rate\"").replace("crossed.station", "crossed.rate")),
        refused(model.replace("station", "bench")),
    ];
    assert_snapshot!(all.join("\n"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: the model has 0 crossed factors, expected 1 to 10
      --> wrong.toml:8:11 | crossed = []
                          |           ^^

    hint: without groups leave `crossed` out; with them, as in `crossed = ["station"]`

    exit 2
    ----- stdout
    ----- stderr
    error: `serial` stands twice in `levels` and `crossed` of `[data]`
      --> wrong.toml:8:12 | crossed = ["serial"]
                          |            ^^^^^^^^

    hint: a column nests (`levels`) or crosses (`crossed`): take it out of one of them

    exit 2
    ----- stdout
    ----- stderr
    error: column `run` tells tests apart, so it cannot be a level of groups of them
      --> wrong.toml:8:12 | crossed = ["run"]
                          |            ^^^^^

    hint: a level is a column of what has several tests, such as the unit that is tested

    exit 2
    ----- stdout
    ----- stderr
    error: `[crossed]` has no effect without `crossed` in `[data]`
      --> wrong.toml:22:2 | [crossed.station.covariance]
                          |  ^^^^^^^

    hint: `crossed` there names the columns of factors that cross, as in `crossed = ["station"]`

    exit 2
    ----- stdout
    ----- stderr
    error: unknown crossed factor `bench` in `[crossed]`
      --> wrong.toml:22:10 | [crossed.bench.covariance]
                           |          ^^^^^

    hint: `crossed` of `[data]` names `station`

    exit 2
    ----- stdout
    ----- stderr
    error: stations.csv, row 3, column `rate`: found group `1.557` in a row of test `0/0-0`, expected `1.551` as in its first row

    hint: a test is of one group of each column of `levels` and `crossed` of `[data]`: split the test, or take the column out there

    exit 2
    ----- stdout
    ----- stderr
    error: stations.csv has no column `bench`, which is used in `crossed` of `[data]`
      --> wrong.toml:8:12 | crossed = ["bench"]
                          |            ^^^^^^^ this column is not in the data

    hint: its columns are `serial`, `run`, `station`, `t`, `rate`, `y`
    "#);
}

/// The order of rows of different tests changes no bit.
#[test]
fn the_order_of_tests_changes_no_bit() {
    let folder = folder();
    let data = std::fs::read_to_string(folder.path("stations.csv")).expect("it was copied");
    let (head, rows) = data.split_once('\n').expect("a header");
    let mut tests: Vec<(String, Vec<&str>)> = Vec::new();
    for row in rows.lines() {
        let id: String = row.split(',').nth(1).expect("a run").to_owned();
        match tests.last_mut() {
            Some((last, own)) if *last == id => own.push(row),
            _ => tests.push((id, vec![row])),
        }
    }
    tests.reverse();
    let reversed: Vec<&str> = tests.iter().flat_map(|(_, rows)| rows.iter().copied()).collect();
    std::fs::write(folder.path("reversed.csv"), format!("{head}\n{}\n", reversed.join("\n"))).expect("a file");
    let (one, other) = (fit(&folder, "stations.toml stations.csv"), fit(&folder, "stations.toml reversed.csv"));
    assert_eq!(one.log_likelihood.to_bits(), other.log_likelihood.to_bits());
    assert_eq!(variances(&one), variances(&other));
    assert_eq!(one.phases[0].mean.estimate, other.phases[0].mean.estimate);
    let effects = |record: &FitRecord| {
        let mut all: Vec<(String, Vec<f64>)> =
            record.crossed[0].effects.iter().map(|one| (one.id.clone(), one.mean.clone())).collect();
        all.sort_by(|a, b| a.0.cmp(&b.0));
        all
    };
    assert_eq!(effects(&one), effects(&other));
}

/// A dense joint Gaussian maximised by Newton steps on differences, and degrees of freedom from its second derivatives.
#[test]
fn two_members_of_a_factor_in_one_test_are_those_of_the_dense_likelihood() {
    let folder = Folder::new(&[]);
    folder.copy("../../examples/crossed/pairs.toml");
    folder.copy("../../examples/crossed/pairs.csv");
    let found = fit(&folder, "pairs.toml pairs.csv --criterion reml");
    assert!(found.converged);
    let mean = &found.phases[0].mean;
    close(&[found.log_likelihood, mean.estimate[0]], &[6.801595760943526, 1.057842536609245], 1e-9);
    close(&[mean.few_tests.std_error_plain[0].expect("known")], &[0.16076460765895514], 1e-7);
    close(&[mean.few_tests.df[0].expect("known")], &[12.8356337], 1e-6);
    let factor = &found.crossed[0];
    assert_eq!((factor.level.states[0].as_str(), factor.level.slots.len(), factor.effects.len()), ("bias", 2, 10));
    let spreads = [factor.level.std_dev.estimate[0], found.phases[0].std_dev.estimate[1]];
    close(&spreads, &[0.45344795, 0.11819272], 1e-6);
    let values: Vec<f64> = found.parameters.iter().map(|one| one.estimate).collect();
    close(&values, &[23.13870751, 0.50992937, 0.09318138], 1e-6);
    assert!(found.constraints.iter().all(|one| one.level.is_none()), "an effect that does not exist is no constraint");
    // what is simulated from the fit has the same design, and reductions the same likelihood
    let done = |command: &str| {
        let output = folder.run(command);
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    };
    done("simulate pairs.toml --from fit.json --design pairs.csv --out drawn.csv --seed 1 --quiet");
    done("reduce pairs.toml pairs.csv --from fit.json --out reduced.parquet --quiet");
    let reduced = fit(&folder, "pairs.toml reduced.parquet --criterion reml");
    close(&[reduced.log_likelihood], &[6.801595760943526], 1e-9);
    assert!(fit(&folder, "pairs.toml drawn.csv").converged);
    // the slots may be named the other way round, and the factor listed
    let text = std::fs::read_to_string(folder.path("pairs.toml")).expect("it is there");
    let other = text
        .replace("{ A = \"serial_a\", B = \"serial_b\" }", "{ B = \"serial_b\", A = \"serial_a\" }")
        .replace("test = \"run\"", "test = \"run\"\ncrossed = [\"serial\"]");
    folder.write("other.toml", other.as_bytes());
    close(&[fit(&folder, "other.toml pairs.csv --criterion reml").log_likelihood], &[found.log_likelihood], 1e-12);
}

#[test]
fn slots_that_cannot_be_are_refused_in_words() {
    let folder = Folder::new(&[]);
    folder.copy("../../examples/crossed/pairs.toml");
    folder.copy("../../examples/crossed/pairs.csv");
    let text = std::fs::read_to_string(folder.path("pairs.toml")).expect("it is there");
    let slots = "as = { A = \"serial_a\", B = \"serial_b\" }";
    for (from, to, expected) in [
        (slots, "as = { A = \"serial_a\" }", "has fewer than two slots"),
        (slots, "as = { A = \"serial_a\", C = \"serial_b\" }", "no estimated state is named `bias_C`"),
        (slots, "as = { A = \"serial_a\", B = \"serial_a\" }", "`serial_a` stands twice"),
        ("states = [\"bias\"]", "states = [\"bias_B\"]", "here it is `bias`, in whatever slot"),
        ("[states.bias_B]\nunit = \"deg/h\"", "[states.bias_B]\nunit = \"rad/s\"", "but their units differ"),
    ] {
        assert!(text.contains(from), "{from}");
        folder.write("wrong.toml", text.replace(from, to).as_bytes());
        let output = folder.run("check wrong.toml pairs.csv");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && said.contains(expected), "{to}: {said}");
    }
    let rows = std::fs::read_to_string(folder.path("pairs.csv")).expect("it is there");
    folder.write("twice.csv", rows.replace(",G07,G03,", ",G07,G07,").as_bytes());
    let said = String::from_utf8_lossy(&folder.run("check pairs.toml twice.csv").stderr).into_owned();
    assert!(said.contains("has one name in two slots of `serial`"), "{said}");
}

/// Two instruments of a known serial in slots, on stations and days; all values are known, so that what is left open of a
/// new test is its posterior.
const SLOTS: &str = r#"
[data]
test = "run"
time = "t"
crossed = ["station", "day"]
[states.bias_A]
[states.bias_B]
[states.scale]
[measurements.A]
column = "ya"
equation = "bias_A + scale"
noise = 0.3
[measurements.B]
column = "yb"
equation = "bias_B - 0.5 * scale"
noise = 0.4
[mean]
fixed = { bias_A = 1.0, bias_B = 1.0, scale = 0.2 }
[covariance]
structure = "fixed"
matrix = [[0.2, 0.05, 0], [0.05, 0.3, 0.1], [0, 0.1, 0.4]]
[crossed.serial]
as = { A = "serial_a", B = "serial_b" }
[crossed.serial.covariance]
structure = "fixed"
matrix = [[0.5, 0, 0], [0, 0, 0], [0, 0, 0]]
[crossed.station.covariance]
structure = "fixed"
matrix = [[0.3, 0.1, 0], [0.1, 0.3, 0.05], [0, 0.05, 0.2]]
[crossed.day.covariance]
structure = "fixed"
matrix = [[0.1, 0, 0], [0, 0.2, 0.0], [0, 0.0, 0.0]]
"#;

/// A test without a measured value has the posterior of the next test of its units on its station and day.
#[test]
fn tests_of_known_units_are_predicted_as_their_posteriors_say() {
    let folder = Folder::new(&[]);
    folder.write("model.toml", SLOTS.as_bytes());
    let wave = |seed: usize| (seed as f64 * 12.9898).sin() * 1.5;
    let mut rows = "run,serial_a,serial_b,station,day,t,ya,yb\n".to_owned();
    for (run, (a, b)) in [(1, 2), (2, 3), (3, 4), (4, 1), (1, 3), (4, 2), (3, 1), (2, 4)].into_iter().enumerate() {
        let (station, day) = (run % 3 + 1, run * run % 2 + 1);
        for t in 0..2 {
            let [ya, yb] = [0, 1].map(|slot| 1.0 + wave(run * 7 + slot * 3 + t));
            rows += &format!("r{run},U{a},U{b},S{station},D{day},{t},{ya:.3},{yb:.3}\n");
        }
    }
    let designs = "known,U1,U3,S2,D1,0,,\nnew,U1,U9,S7,D1,0,,\nempty,U2,,S1,D2,0,,\n";
    folder.write("data.csv", (rows.clone() + designs).as_bytes());
    folder.write("design.csv", ("run,serial_a,serial_b,station,day,t,ya,yb\n".to_owned() + designs).as_bytes());
    let of_all = fit(&folder, "model.toml data.csv");
    // the levels U9 and S7 are new to this one
    folder.write("without.csv", rows.as_bytes());
    fit(&folder, "model.toml without.csv");
    let output = folder.run("predict model.toml --from fit.json --design design.csv --units known --out p.csv --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let predicted = folder.table("p.csv");
    assert_eq!(predicted.len(), 9);
    for row in &predicted {
        let test = of_all.tests.iter().find(|test| test.id == row["test"]).expect("it is in the fit");
        let part = test.phases.iter().next().expect("one phase");
        let state = ["bias_A", "bias_B", "scale"].iter().position(|name| *name == row["name"]).expect("a state");
        let number = |column: &str| row[column].parse::<f64>().expect("a number");
        let variance = part.covariance.rows().nth(state).expect("a row")[state];
        // an instrument in the empty slot is of no population of serials
        close(&[number("mean"), number("std_dev")], &[part.mean[state], variance.sqrt()], 1e-9);
    }
}

/// Two tests of two units at a time, on a clock of dates: they may share a platform.
#[test]
fn tests_of_one_time_are_named_by_check() {
    let folder = Folder::new(&[]);
    folder.write(
        "model.toml",
        br#"
        [data]
        test = "run"
        time = "at"
        time_unit = "s"
        [states.bias]
        [measurements.gyro]
        column = "gyro"
        equation = "bias"
        noise = "sigma"
        [parameters]
        sigma = {}
        "#,
    );
    let rows = |apart: bool| {
        let mut rows = "run,at,gyro\n".to_owned();
        for second in 0..6 {
            for run in 0..4 {
                let day = if apart { run } else { run / 2 } + 1;
                rows +=
                    &format!("r{run},2026-03-0{day}T10:00:0{second}Z,{}\n", 1.0 + f64::from(run * second % 5) / 10.0);
            }
        }
        rows
    };
    let said = |rows: &str| {
        folder.write("data.csv", rows.as_bytes());
        let output = folder.run("check model.toml data.csv");
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        String::from_utf8_lossy(&output.stdout).split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let together = said(&rows(false));
    assert!(together.contains("Tests `r0` and `r1` were made at the same time, and 4 tests in all"), "{together}");
    assert!(!said(&rows(true)).contains("at the same time"));
}

/// In a whole table of U units × B stations the mean has the variance σ_u²/U + σ_s²/B + σ²/(UB), and the expected
/// information on a standard deviation is that of a balanced analysis of variance.
#[test]
fn plans_of_more_stations_or_more_units_are_those_of_a_balanced_table() {
    let folder = Folder::new(&[]);
    folder.write(
        "model.toml",
        br#"
        [data]
        test = "run"
        levels = ["unit"]
        crossed = ["station"]
        [states.bias]
        [measurements.z]
        column = "z"
        equation = "bias"
        noise = 0.6
        [covariance]
        states = []
        "#,
    );
    folder.write(
        "truth.toml",
        br#"
        [data]
        test = "run"
        levels = ["unit"]
        crossed = ["station"]
        [states.bias]
        [measurements.z]
        column = "z"
        equation = "bias"
        noise = 0.6
        [mean]
        fixed = { bias = 1 }
        [covariance]
        states = []
        [levels.unit.covariance]
        fixed = { "bias, bias" = 0.25 }
        [crossed.station.covariance]
        fixed = { "bias, bias" = 0.09 }
        "#,
    );
    folder.write("design.csv", b"run,unit,station,z\na,U1,S1,0\n");
    let command = "plan model.toml --from truth.toml --design design.csv --groups unit=8,16 --groups station=4,12 --tests 4 --out plan.json --quiet";
    let output = folder.run(command);
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let text = std::fs::read_to_string(folder.path("plan.json")).expect("it was written");
    let record: kalfit::record::PlanRecord = serde_json::from_str(&text).expect("a plan");
    let (units, stations, noise) = (0.25_f64, 0.09_f64, 0.36_f64);
    for (k, one) in record.arrangements.iter().enumerate() {
        let [(_, levels), (_, groups)] = one.groups[..] else { panic!("{one:?}") };
        assert_eq!((one.crossed, record.tests[k]), (1, 4 * groups));
        if levels != 4 {
            continue; // units meet a part of the stations
        }
        let (u, s) = (groups as f64, levels as f64);
        let of = |quantity: &str, level: Option<&str>| {
            let own = |q: &&kalfit::record::PlannedRecord| q.quantity == quantity && q.level.as_deref() == level;
            record.quantities.iter().find(own).and_then(|q| q.std_error[k]).expect("known")
        };
        close(&[of("mean", None)], &[(units / u + stations / s + noise / (u * s)).sqrt()], 1e-9);
        // information about (σ_u², σ_s²) by the strata of the table: units, stations, and the mean
        let (of_units, of_stations) = (noise + s * units, noise + u * stations);
        let both = noise + s * units + u * stations;
        let matrix = [
            0.5 * s * s * ((u - 1.0) / of_units.powi(2) + 1.0 / both.powi(2)),
            0.5 * u * s / both.powi(2),
            0.5 * u * u * ((s - 1.0) / of_stations.powi(2) + 1.0 / both.powi(2)),
        ];
        let determinant = matrix[0] * matrix[2] - matrix[1].powi(2);
        let errors = [(matrix[2] / determinant).sqrt(), (matrix[0] / determinant).sqrt()];
        let expected = [errors[0] / (2.0 * units.sqrt()), errors[1] / (2.0 * stations.sqrt())];
        close(&[of("std_dev", Some("unit")), of("std_dev", Some("station"))], &expected, 1e-8);
    }
}

#[test]
fn slots_without_a_name_are_named() {
    let folder = Folder::new(&[]);
    folder.copy("../../examples/crossed/pairs.toml");
    folder.copy("../../examples/crossed/pairs.csv");
    let rows = std::fs::read_to_string(folder.path("pairs.csv")).expect("it is there");
    let emptied = |run: &str, cells: &[usize]| {
        let row = |line: &str| {
            let mut all: Vec<&str> = line.split(',').collect();
            if all[0] == run {
                cells.iter().for_each(|&cell| all[cell] = "");
            }
            all.join(",") + "\n"
        };
        rows.lines().map(row).collect::<String>()
    };
    let said = |rows: String| {
        folder.write("data.csv", rows.as_bytes());
        let output = folder.run("check pairs.toml data.csv");
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        String::from_utf8_lossy(&output.stdout).split_whitespace().collect::<Vec<_>>().join(" ")
    };
    // a gyro whose serial number was forgotten
    let forgotten = said(emptied("r06", &[3]));
    assert!(forgotten.contains("lot `B` of `serial` has no name in test `r06`, but is measured there"), "{forgotten}");
    // an empty slot, and two: the platform alone tells nothing of gyros
    assert!(!said(emptied("r06", &[3, 5])).contains("has no name"));
    assert!(!said(emptied("r06", &[2, 3, 4, 5])).contains("has no name"));
    // in long form a name may stand on the rows of its slot alone
    let sparse: String = rows
        .lines()
        .map(|line| {
            line.strip_prefix("r07,5,").map_or(line.to_owned(), |rest| {
                let cells: Vec<&str> = rest.split(',').collect();
                format!("r07,5,,,{},{}", cells[2], cells[3])
            }) + "\n"
        })
        .collect();
    assert!(sparse.contains("r07,5,,,"), "{sparse}");
    assert_eq!(said(sparse), said(rows.clone()));
    // what is not in the results is no new level
    fit(&folder, "pairs.toml pairs.csv --no-tests");
    folder.write("design.csv", b"run,t,serial_a,serial_b\nx,0,G01,G99\n");
    let predict = "predict pairs.toml --from fit.json --design design.csv --units known";
    let output = folder.run(predict);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && text.contains("written without what is known of each unit"), "{text}");
    fit(&folder, "pairs.toml pairs.csv");
    let output = folder.run(predict);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(0) && text.contains("does not know serial `G99`"), "{}", shown(&output));
    let output = folder.run("plan pairs.toml --from fit.json --design pairs.csv --groups serial=1 --tests 30");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains("found a number of levels of 1 of a factor of which a test has 2"), "{text}");
}
