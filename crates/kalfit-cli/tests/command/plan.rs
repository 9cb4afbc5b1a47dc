//! `kalfit plan`.

use crate::folder::{Folder, shown};
use insta::assert_snapshot;
use kalfit::record::PlanRecord;

fn example() -> Folder {
    let folder = Folder::new(&[]);
    folder.copy("../../examples/gyro-bench/bench.toml");
    folder.copy("../../examples/gyro-bench/bench.csv");
    folder.copy("tests/data/gyro.toml");
    folder.copy("tests/data/gyro.csv");
    assert_eq!(folder.run("fit bench.toml bench.csv --out fit.json --quiet").status.code(), Some(0));
    assert_eq!(folder.run("fit gyro.toml gyro.csv --set tau=200 --out gyro.json --quiet").status.code(), Some(0));
    folder
}

fn record(folder: &Folder) -> PlanRecord {
    let text = std::fs::read_to_string(folder.path("plan.json")).expect("a plan was written");
    serde_json::from_str(&text).expect("plan.json is a record")
}

#[test]
fn the_plan_of_an_example() {
    let folder = example();
    let output = folder.run("plan bench.toml --from fit.json --design bench.csv --tests 5,10,28,50 --out plan.json");
    assert_snapshot!(shown(&output), @"
    exit 0
    ----- stdout
    Gyros on two bench stations

    Design: 28 tests, 614 steps, 614 observations from bench.csv.
    Population: fit.json.

    Expected standard errors of the means
      state          unit     value  5 tests  10 tests  28 tests  50 tests
      bias           deg/h     0.62     0.35      0.25      0.15      0.11
      scale          ppm       47.5       15        11       6.4       4.8
      g_sensitivity  deg/h/g  0.271     0.18      0.13     0.076     0.057

    Expected standard errors of the standard deviations
      state          unit     value  5 tests  10 tests  28 tests  50 tests
      bias           deg/h    0.765     0.26      0.18      0.11     0.082
      scale          ppm       29.0       11       8.0       4.8       3.6
      g_sensitivity  deg/h/g  0.313     0.14     0.097     0.058     0.043

    Expected standard errors of the correlations
      state                 value  5 tests  10 tests  28 tests  50 tests
      bias, scale            0.49     0.43      0.30      0.18      0.14
      bias, g_sensitivity   -0.14     0.58      0.41      0.25      0.18
      scale, g_sensitivity  -0.62     0.47      0.33      0.20      0.15

    How to read this
      Standard errors come from the expected information at these values; N tests
        count as N/28 times the design. With few tests, estimates scatter more than
        this, and those of standard deviations are skewed.
    ----- stderr
    Wrote plan.json
    ");
    let plan = record(&folder);
    assert_eq!((plan.schema.as_str(), plan.tests.as_slice()), ("kalfit-plan/1", &[5, 10, 28, 50][..]));
    assert_eq!(plan.quantities.len(), 3 + 3 + 3 + 6);
    // at the number of tests of the fit, its own standard errors are near
    let text = std::fs::read_to_string(folder.path("fit.json")).expect("a fit was written");
    let fit: kalfit::FitRecord = serde_json::from_str(&text).expect("a record");
    for (i, planned) in plan.quantities[..3].iter().enumerate() {
        let (a, b) = (planned.std_error[2].expect("known"), fit.phases[0].mean.std_error[i].expect("known"));
        assert!((a / b - 1.0).abs() < 0.1, "mean of {:?}: {a} against {b}", planned.states);
    }
}

#[test]
fn what_is_fixed_and_what_is_taken_as_known_is_said() {
    let folder = example();
    let output = folder.run("plan gyro.toml --from gyro.json --design gyro.csv --tests 5,100 --out plan.json");
    assert_snapshot!(shown(&output), @"
    exit 0
    ----- stdout
    Gyros on a turntable

    Design: 6 tests, 60 steps, 57 observations from gyro.csv.
    Population: gyro.json.

    Expected standard errors of the means
      state                    unit     value  5 tests  100 tests
      bias                     deg/h   0.4010    0.039     0.0087
      scale                    ppm        300    fixed          -
      temperature_coefficient         0.00946   0.0011    0.00024

    Expected standard errors of the standard deviations
      state                    unit    value  5 tests  100 tests
      bias                     deg/h  0.0785    0.030     0.0067
      scale                    ppm      53.7       20        4.5
      temperature_coefficient              0    fixed          -

    How to read this
      Standard errors come from the expected information at these values; N tests
        count as N/6 times the design. With few tests, estimates scatter more than
        this, and those of standard deviations are skewed.
      tau is free in the model but is taken as known here, at its value in
        gyro.json; if it were estimated too, standard errors would be larger.
    ----- stderr
    Wrote plan.json
    ");
    let plan = record(&folder);
    assert_eq!(plan.parameters_taken_as_known, ["tau"]);
    let fixed: Vec<&str> = plan.quantities.iter().filter_map(|q| q.reason.as_deref()).collect();
    assert!(!fixed.is_empty() && fixed.iter().all(|reason| *reason == "fixed"), "{fixed:?}");
}

#[test]
fn measured_values_of_the_design_do_not_matter() {
    let folder = example();
    let text = std::fs::read_to_string(folder.path("bench.csv")).expect("the data");
    let other: String = text
        .lines()
        .enumerate()
        .map(|(k, line)| {
            let mut cells: Vec<&str> = line.split(',').collect();
            let place = text.lines().next().and_then(|h| h.split(',').position(|name| name == "rate"));
            if k > 0 && !cells[place.expect("a column `rate`")].is_empty() {
                cells[place.expect("a column `rate`")] = "123456";
            }
            cells.join(",") + "\n"
        })
        .collect();
    folder.write("other.csv", other.as_bytes());
    let tables = |design: &str| {
        let output = folder.run(&format!("plan bench.toml --from fit.json --design {design} --tests 5,1000000000"));
        let text = shown(&output);
        assert_eq!(output.status.code(), Some(0), "{text}");
        text.split("Expected").skip(1).collect::<String>()
    };
    assert_eq!(tables("bench.csv"), tables("other.csv"));
}

/// Twelve runs of four serials; `x` is the serial's own.
const SERIALS: &str = r#"
[data]
test = "run"
levels = ["serial"]
[states.a]
[measurements.y]
column = "y"
equation = "a"
noise = 0.1
[mean.regression]
a = ["x"]
[covariance]
structure = "fixed"
matrix = [[0.04]]
[levels.serial.covariance]
structure = "fixed"
matrix = [[1]]
"#;

#[test]
fn what_belongs_to_a_group_stays_with_it() {
    let row = |k: usize| format!("s{},r{},{},{}\n", k / 3, k % 3, k / 3 % 2, (k * 7 % 5) as f64 - 2.0);
    let data = "serial,run,x,y\n".to_owned() + &(0..12).map(row).collect::<String>();
    let folder = Folder::new(&[("s.toml", SERIALS.as_bytes()), ("s.csv", data.as_bytes())]);
    let output = folder.run("fit s.toml s.csv --out fit.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let counts = "--groups serial=4,40 --tests 1,2,3,4";
    let output = folder.run(&format!("plan s.toml --from fit.json --design s.csv {counts} --out plan.json"));
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let plan = record(&folder);
    let found = plan.quantities.iter().find(|q| q.quantity == "regression").expect("there is one");
    // half of G serials have x = 0 and half x = 1: the variance of a serial's mean of n runs, 2/G + 2/G times
    let cases = [4.0, 40.0].into_iter().flat_map(|groups| [1.0, 2.0, 3.0, 4.0].map(|tests| (groups, tests)));
    for ((groups, tests), error) in cases.zip(&found.std_error) {
        let (error, expected) = (error.expect("it is known"), ((1.0 + 0.05 / tests) * 4.0_f64 / groups).sqrt());
        assert!((error - expected).abs() < 1e-9 * expected, "{groups} of {tests}: {error} {expected}");
    }
}

/// A population without variance in one state is a population of the model without a word about it.
#[test]
fn a_variance_of_zero_is_no_other_by_rounding() {
    let zero = "[data]\ntest = \"test\"\n[states]\na = {}\nb = {}\nc = {}\n[measurements.y]\ncolumn = \"y\"\n\
                equation = \"a + b * u + c * w\"\nnoise = 0.3\n[mean]\nfixed = { a = 1, b = 2, c = 0 }\n\
                [covariance]\nstructure = \"fixed\"\nmatrix = [[1, 0, 0.1], [0, 0, 0], [0.1, 0, 0.6]]\n";
    let free = zero.split("[mean]").next().expect("the model without its population");
    let row = |k: usize| format!("t{},{},{},0\n", k / 6, (k as f64 * 0.7).sin(), (k as f64 * 1.3).cos());
    let data = "test,u,w,y\n".to_owned() + &(0..42).map(row).collect::<String>();
    let folder = Folder::new(&[("z.toml", zero.as_bytes()), ("f.toml", free.as_bytes()), ("d.csv", data.as_bytes())]);
    let output = folder.run("plan f.toml --from z.toml --design d.csv --tests 7");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
}
