//! `kalfit datasheet` through the built command.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use insta::assert_snapshot;
use kalfit_fixtures::near;
use serde_json::Value;

use crate::folder::{Folder, shown};

/// Two units of three runs each: levels, noise by unit, a gap in the records.
const MODEL: &str = r#"
title = "Gyros"

[data]
test = "run"
levels = ["serial"]
time = "t"
time_unit = "s"
[states.bias]
unit = "deg/h"
[states.scale]
unit = "ppm"
random = false
[measurements.gyro]
column = "y"
equation = "bias + 1e-6 * rate * scale + rate"
noise = "sigma"
[parameters]
sigma = { start = 0.3, unit = "deg/h" }
"#;

fn data() -> String {
    let wave = |k: i32| f64::from((k * 7919 + 13) % 101 - 50) / 50.0;
    let mut text = "serial,run,t,y,rate\n".to_owned();
    for unit in 0..6 {
        for run in 0..3 {
            for k in 0..40 {
                let rate = if k < 20 { 100.0 } else { -100.0 };
                let bias = 3.0 * wave(unit * 11 + 3) + wave(unit * 17 + run * 5 + 1);
                let y = bias + rate * (1.0 + 2e-3) + 0.5 * wave(unit * 31 + run * 57 + k * 3);
                let t = if k < 30 { 0.5 * f64::from(k) } else { 0.5 * f64::from(k) + 4.0 };
                text += &format!("s{unit},s{unit}r{run},{t},{y},{rate}\n");
            }
        }
    }
    text
}

fn fitted() -> Folder {
    let folder = Folder::new(&[("m.toml", MODEL.as_bytes()), ("d.csv", data().as_bytes())]);
    let fit = folder.run("fit m.toml d.csv --out fit.json --quiet");
    assert!(fit.status.success(), "{}", shown(&fit));
    folder
}

fn read(folder: &Folder, file: &str) -> Value {
    serde_json::from_slice(&std::fs::read(folder.path(file)).unwrap()).unwrap()
}

#[test]
fn the_numbers_are_those_of_the_fit() {
    let folder = fitted();
    let output = folder.run("datasheet m.toml d.csv --from fit.json --out sheet.json");
    assert!(output.status.success(), "{}", shown(&output));
    let (fit, sheet) = (read(&folder, "fit.json"), read(&folder, "sheet.json"));
    let entry = |name: &str, of: &str| {
        let all = sheet["entries"].as_array().unwrap();
        all.iter()
            .find(|entry| entry["name"] == name && entry["of"] == of)
            .unwrap_or_else(|| panic!("{name}: {all:#?}"))
    };
    let check = |what: &str, found: &Value, expected: f64| {
        near::relative(what, found.as_f64().unwrap(), expected, 1e-9);
    };
    let sigma = &fit["parameters"][0];
    let factor = (0.5_f64 / 3600.0).sqrt();
    let walk = entry("angle random walk", "gyro");
    assert_eq!(walk["unit"], "deg/sqrt(h)");
    check("N", &walk["value"], sigma["estimate"].as_f64().unwrap() * factor);
    for end in 0..2 {
        check("its end", &walk["interval95"][end], sigma["interval95"][end].as_f64().unwrap() * factor);
    }
    for (name, level) in [("turn-on repeatability, unit to unit (serial)", 0), ("turn-on repeatability, run to run", 1)]
    {
        let spread = &fit["levels"][level]["std_dev"];
        check(name, &entry(name, "bias")["value"], spread["estimate"][0].as_f64().unwrap());
        assert_eq!(entry(name, "bias")["interval95"], spread["interval95"][0], "{name}");
    }
    let scale = entry("scale factor mean", "scale");
    check("scale", &scale["value"], fit["phases"][0]["mean"]["estimate"][1].as_f64().unwrap());
    let curve = &sheet["allan"][0];
    assert_eq!((&curve["step"], &curve["tests"]), (&Value::from(0.5), &Value::from(18)));
    // the gap after 30 values leaves two spans of 10, and of no more than 15
    let values: Vec<u64> = curve["points"].as_array().unwrap().iter().map(|p| p["values"].as_u64().unwrap()).collect();
    assert_eq!(values, [1, 2, 5, 10]);
}

#[test]
fn it_is_shown_as_a_table() {
    let folder = fitted();
    assert_snapshot!(shown(&folder.run("datasheet m.toml d.csv --from fit.json")), @r"
    exit 0
    ----- stdout
    Gyros

    All values follow from fit.json.

    Datasheet
      quantity                of        value  95 % interval        unit
      angle random walk       gyro   0.003466  0.00329 to 0.003652  deg/sqrt(h)
      turn-on mean            bias    -0.2704  -1.448 to 0.9072     deg/h
      turn-on repeatability,  bias      1.471  0.8353 to 2.592      deg/h
      unit to unit (serial)
      turn-on repeatability,  bias    0.04289  0.01792 to 0.1026    deg/h
      run to run
      scale factor mean       scale      1968  1753 to 2182         ppm

    Allan deviation of gyro in deg/h
      time, s  values    model  records  95 % interval
          0.5       1   0.2941   0.2967  0.2787 to 0.3173
            1       2    0.208   0.2693  0.2461 to 0.2973
          2.5       5   0.1315   0.1323  0.1144 to 0.1569
            5      10  0.09301   0.1701  0.1328 to 0.2367

    Definitions
      Angle random walk: N: standard deviation of the integrated white noise of the
        rate, per square root of time; for a measurement, its standard deviation
        times the square root of the step.
      Mean: mean over the population of tests.
      Repeatability, unit to unit (serial): standard deviation, from one `serial` to
        the next, of the part that its tests share; it is a spread of the
        population, no repeatability in the sense of IEEE 528 and 647.
      Repeatability, run to run: standard deviation from test to test of one unit,
        the repeatability of IEEE 528 and 647 if the tests are under the same
        conditions.

    Notes
      The curve of the model is that of a new test from its start, with all inputs
        zero.
      Taken as zero for the curve of the model: `rate`; `--at COLUMN=VALUE` gives
        them another value.
      The records contain what these columns add through states: where a column
        varies within a test, the records lie above the curve of the model.
      The curve of the records uses measured values minus known inputs, and all
        pairs of adjacent spans without a gap in all tests; its interval follows
        from the number of independent spans.
    ----- stderr
    ");
}

#[test]
fn bad_wishes_are_refused() {
    let folder = fitted();
    let refused = |arguments: &str| {
        let output = folder.run(&format!("datasheet m.toml --from fit.json --out sheet.json {arguments}"));
        let text = shown(&output);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(!folder.path("sheet.json").exists(), "{text}");
        text
    };
    let both = refused("d.csv --step 1");
    assert!(both.contains("cannot be used with"), "{both}");
    let column = refused("--step 1 --at nothing=1");
    assert!(column.contains("a value of column `nothing` has no effect"), "{column}");
    let step = refused("--step 0");
    assert!(step.contains("expected a number above 0"), "{step}");
    let ending = folder.run("datasheet m.toml --from fit.json --step 1 --out sheet.csv");
    assert!(shown(&ending).contains("would hold JSON"), "{}", shown(&ending));
}

const BY_CHIP: &str = r#"
[data]
test = "run"
time = "t"
time_unit = "s"
[states.bias]
unit = "deg/h"
[states.drift]
unit = "deg/h"
process = "random-walk"
noise_density = "walk"
initial = { mean = 0, sigma = 0 }
[measurements.gyro]
column = "y"
equation = "bias + drift"
noise = "sigma"
[mean]
fixed = { bias = 0 }
[covariance]
structure = "fixed"
matrix = [[1.0]]
[parameters]
sigma = { per = "chip", unit = "deg/h", fixed = { c1 = 0.3, c2 = 0.6 } }
walk = 0.02
"#;

/// Of noise that each chip has a value of its own for there is a number for each; of what is common there is one.
#[test]
fn parameters_by_level_have_an_entry_each() {
    let folder = Folder::new(&[("m.toml", BY_CHIP.as_bytes())]);
    let output = folder.run("datasheet m.toml --from m.toml --step 0.5 --out sheet.json");
    assert!(output.status.success(), "{}", shown(&output));
    let sheet = read(&folder, "sheet.json");
    let of = |name: &str| -> Vec<(Value, f64)> {
        let all = sheet["entries"].as_array().unwrap().iter().filter(|entry| entry["name"] == name);
        all.map(|entry| (entry["at"].clone(), entry["value"].as_f64().unwrap())).collect()
    };
    // sigma times the square root of half a second, in hours
    let root = (0.5_f64 / 3600.0).sqrt();
    let noise = of("angle random walk");
    assert_eq!(noise.iter().map(|(at, _)| at.clone()).collect::<Vec<_>>(), ["chip=c1", "chip=c2"]);
    for ((_, found), sigma) in noise.iter().zip([0.3, 0.6]) {
        assert!((found - sigma * root).abs() < 1e-12, "{found} and {}", sigma * root);
    }
    let walk = of("rate random walk");
    assert_eq!(walk.len(), 1);
    assert!(walk[0].0.is_null() && (walk[0].1 - 0.02 * 60.0).abs() < 1e-12, "{walk:?}");
    assert!(shown(&output).contains("gyro, chip=c2"), "{}", shown(&output));
    let one = folder.run("datasheet m.toml --from m.toml --step 0.5 --at chip=c2");
    assert!(!shown(&one).contains("chip=c1") && shown(&one).contains("where chip=c2"), "{}", shown(&one));
}
