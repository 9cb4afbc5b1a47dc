//! Predictions from few tests: limits of one new test and tolerance limits by the laws of the restricted likelihood,
//! against tables and against formulas with matrices of all measurements.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use std::collections::HashMap;

use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};
use serde_json::Value;

use crate::folder::{Folder, number, shown};

fn wave(seed: u32) -> f64 {
    (f64::from(seed) * 12.9898 + 0.3).sin()
}

/// The fit and the one row of its predictions for a new test.
fn predicted(model: &str, data: &str, options: &str) -> (Value, csv::StringRecord, csv::StringRecord) {
    let head = data.lines().next().unwrap();
    let design = format!("{head}\nnew,other,{}\n", if head.contains(",x,") { "0.5," } else { "" });
    let files = [("m.toml", model), ("d.csv", data), ("new.csv", &design)];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    for run in [
        "fit m.toml d.csv --criterion reml --out fit.json".to_owned(),
        format!("predict m.toml --from fit.json --design new.csv --out p.csv {options}"),
    ] {
        let output = folder.run(&run);
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    }
    let mut table = csv::Reader::from_path(folder.path("p.csv")).unwrap();
    let head = table.headers().unwrap().clone();
    let row = table.records().next().unwrap().unwrap();
    (serde_json::from_str(&std::fs::read_to_string(folder.path("fit.json")).unwrap()).unwrap(), head, row)
}

fn cell((head, row): (&csv::StringRecord, &csv::StringRecord), name: &str) -> f64 {
    row[head.iter().position(|own| own == name).unwrap()].parse().unwrap()
}

/// Five tests that determine their level: t with four degrees of freedom and (1 + 1/5)s², and the factor of noncentral t
/// for 95 % of all tests with confidence 90 %.
#[test]
fn five_exact_tests_have_the_limits_of_the_tables() {
    let values = [3.1, 4.7, 2.2, 5.9, 3.6];
    let data: String = values.iter().enumerate().map(|(j, y)| format!("t{j},u{j},{y}\n")).collect();
    let model = "[data]\ntest = \"test\"\n[states]\nlevel = {}\n[measurements.y]\ncolumn = \"y\"\nequation = \"level\"\n\
                 noise = 1e-4\n";
    let (_, head, row) = predicted(model, &format!("test,unit,y\n{data}"), "--one-sided");
    let row = (&head, &row);
    let mean = values.iter().sum::<f64>() / 5.0;
    let s = (values.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / 4.0).sqrt();
    near::relative("degrees of freedom", cell(row, "df"), 4.0, 1e-6);
    // t of 0.975 with 4 degrees of freedom
    near::relative("new test", cell(row, "prediction_upper") - mean, 2.776_445_105 * s * 1.2f64.sqrt(), 1e-6);
    near::relative("tolerance", cell(row, "tolerance_upper") - mean, 3.399_833_958 * s, 1e-5);
    // t of 0.95
    near::relative("mean", cell(row, "confidence_upper") - mean, 2.131_846_786 * s / 5f64.sqrt(), 1e-6);
}

/// A variance of zero: both the limits of the mean and tolerance limits allow for the variance that may be there.
#[test]
fn tests_that_do_not_seem_to_differ_have_limits() {
    let row = |(j, k): (u32, u32)| format!("t{j},u{j},{}\n", 2.0 + wave(90 + k) + 1e-3 * wave(7 * j + k));
    let data: String = (0..6).flat_map(|j| (0..4).map(move |k| (j, k))).map(row).collect();
    let model = "[data]\ntest = \"test\"\n[states]\nlevel = {}\n[measurements.y]\ncolumn = \"y\"\nequation = \"level\"\n\
                 noise = \"s\"\n[parameters]\ns = {}\n";
    let (fit, head, row) = predicted(model, &format!("test,unit,y\n{data}"), "");
    let row = (&head, &row);
    assert_eq!(fit["phases"][0]["covariance"]["estimate"][0][0], 0.0, "a case with a variance of zero");
    let error = cell(row, "std_dev_estimation");
    let half = |end: &str| cell(row, &format!("{end}_upper")) - cell(row, "mean");
    assert!(half("confidence") > 1.9 * error, "t of five degrees of freedom at 95 %: 2.02");
    assert!(half("tolerance") > half("confidence"));
}

/// With six tests the interval of the mean by a drawn quantile is wider than that by χ²; fits with free parameters refuse
/// such intervals.
#[test]
fn intervals_with_drawn_quantiles_are_wider_with_few_tests() {
    let model = |s: &str| {
        format!(
            "[data]\ntest = \"test\"\n[states]\nlevel = {{}}\n[measurements.y]\ncolumn = \"y\"\nequation = \"level\"\n\
             noise = \"s\"\n[parameters]\ns = {s}\n"
        )
    };
    let row = |(j, k): (u32, u32)| format!("t{j:02},{}\n", 2.0 + 1.3 * wave(j + 7) + 0.5 * wave(50 * j + k + 900));
    let rows: String = (0..6).flat_map(|j| (0..1 + j % 4).map(move |k| (j, k))).map(row).collect();
    let known = model("0.5");
    let free = model("{}");
    let data = format!("test,y\n{rows}");
    let files = [("m.toml", &known), ("free.toml", &free), ("d.csv", &data)];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    let fit = |kind: &str, more: &str| -> Value {
        let output = folder.run(&format!("fit m.toml d.csv --intervals {kind} --out fit.json {more}"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        let fit: Value = serde_json::from_str(&std::fs::read_to_string(folder.path("fit.json")).unwrap()).unwrap();
        assert_eq!(fit["intervals"], kind);
        fit["phases"][0].clone()
    };
    let [drawn, plain] = ["bootstrap", "profile"].map(|kind| fit(kind, ""));
    let ends = |phase: &Value, of: &str| [0, 1].map(|end| phase[of]["interval95"][0][end].as_f64().unwrap());
    let ([low, high], [lower, upper]) = (ends(&drawn, "mean"), ends(&plain, "mean"));
    assert!(low < lower && high > upper, "mean: {low} to {high} against {lower} to {upper}");
    let ([_, high], [_, upper]) = (ends(&drawn, "std_dev"), ends(&plain, "std_dev"));
    assert!((0.5..1.5).contains(&(high / upper)) && high != upper, "std dev: {high} against {upper}");
    assert_eq!(fit("bootstrap", "--threads 1"), drawn, "same bits for any number of threads");
    let output = folder.run("fit free.toml d.csv --intervals bootstrap");
    assert_eq!(output.status.code(), Some(2), "{}", shown(&output));
    assert!(
        shown(&output).contains("intervals by `bootstrap` are for known parameters: `s` is free"),
        "{}",
        shown(&output)
    );
}

/// Units of unequal tests with a covariate: h, ν_h and the error of the mean from matrices of all measurements.
#[test]
fn degrees_of_freedom_of_a_new_test_are_those_of_the_joint_gaussian() {
    let mut places = Vec::new();
    for j in 0..14u32 {
        (0..1 + j % 4).for_each(|k| places.push((j, j / 3, wave(10 * j + k + 400))));
    }
    let value = |(at, &(j, unit, x)): (usize, &(u32, u32, f64))| {
        1.5 + 0.4 * x + 1.1 * wave(unit + 31) + 0.8 * wave(j + 60) + 0.5 * wave(at as u32 + 200)
    };
    let y: Vec<f64> = places.iter().enumerate().map(value).collect();
    let line = |(&(j, unit, x), y): (&(u32, u32, f64), &f64)| format!("t{j:02},u{unit},{x:e},{y:e}\n");
    let data: String = places.iter().zip(&y).map(line).collect();
    let model = "[data]\ntest = \"test\"\nlevels = [\"unit\"]\n[states]\nlevel = {}\nb = { random = false }\n\
                 [measurements.y]\ncolumn = \"y\"\nequation = \"level + b * x\"\nnoise = \"s\"\n[parameters]\ns = {}\n";
    let (fit, head, row) = predicted(model, &format!("test,unit,x,y\n{data}"), "");
    let row = (&head, &row);
    let n = places.len();
    let same = |of: &dyn Fn(usize) -> u32| DMatrix::from_fn(n, n, |a, b| f64::from(u8::from(of(a) == of(b))));
    let slopes = [DMatrix::identity(n, n), same(&|a| places[a].0), same(&|a| places[a].1)];
    let s = fit["parameters"][0]["estimate"].as_f64().unwrap();
    let sigma = |block: &Value| block["covariance"]["estimate"][0][0].as_f64().unwrap();
    let [within, between] = [sigma(&fit["phases"][0]), sigma(&fit["levels"][0])];
    assert!(within > 0.0 && between > 0.0, "a case inside");
    let v = &slopes[0] * (s * s) + &slopes[1] * within + &slopes[2] * between;
    let w = v.try_inverse().unwrap();
    let x = DMatrix::from_fn(n, 2, |a, c| if c == 0 { 1.0 } else { places[a].2 });
    let c = (x.transpose() * &w * &x).try_inverse().unwrap();
    let p = &w - &w * &x * &c * x.transpose() * &w;
    let by: Vec<DMatrix<f64>> = slopes.iter().map(|slope| &p * slope).collect();
    let information = DMatrix::from_fn(3, 3, |a, b| 0.5 * by[a].dot(&by[b].transpose()));
    let v_theta = information.try_inverse().unwrap();
    let half = &c * x.transpose() * &w;
    let of_c = |a: usize| (&half * &slopes[a] * half.transpose())[(0, 0)];
    let g = DVector::from_fn(3, |a, _| of_c(a) + f64::from(u8::from(a > 0)));
    let h = within + between + c[(0, 0)];
    let freedom = 2.0 * h * h / g.dot(&(&v_theta * &g));
    near::relative("ν_h", cell(row, "df"), freedom, 1e-5);
    let error = fit["phases"][0]["mean"]["std_error"][0].as_f64().unwrap();
    near::relative("error of the mean", cell(row, "std_dev_estimation"), error, 1e-9);
    assert!(error * error > c[(0, 0)], "the error allows for that of the variances");
    let all = (within + between + error * error).sqrt();
    let quantile = (cell(row, "prediction_upper") - cell(row, "mean")) / all;
    assert!((2.0..3.5).contains(&quantile), "t with {freedom} degrees of freedom: {quantile}");
}

/// A fit.json whose laws have matrices of other sizes is used as one without laws, and read without a panic.
#[test]
fn laws_of_other_sizes_are_left_out() {
    let rows: String = (0..7).map(|j| format!("t{j},{}\n", 2.0 + wave(j))).collect();
    let model = "[data]\ntest = \"test\"\n[states]\nlevel = {}\n[measurements.y]\ncolumn = \"y\"\nequation = \"level\"\n\
                 noise = 0.1\n";
    let data = format!("test,y\n{rows}");
    let files = [("m.toml", model), ("d.csv", &data), ("new.csv", "test,y\nnew,\n")];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    let run = |command: &str| {
        let output = folder.run(command);
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    };
    let predict = "predict m.toml --from fit.json --design new.csv --out p.csv";
    let limits = || {
        run(predict);
        number(&folder.table("p.csv")[0], "confidence_upper")
    };
    run("fit m.toml d.csv --criterion reml --out fit.json");
    let whole = limits();
    let fit: Value = serde_json::from_str(&std::fs::read_to_string(folder.path("fit.json")).unwrap()).unwrap();
    for name in ["mean_covariance", "mean_covariance_plain", "covariance", "values", "powers", "mean_slopes"] {
        let mut damaged = fit.clone();
        damaged["estimates"]["few_tests"][name] = Value::Array(Vec::new());
        folder.write("fit.json", damaged.to_string().as_bytes());
        let without = limits();
        assert!(without.is_finite() && (without - whole).abs() < 1.0, "{name}: {without} against {whole}");
    }
}

/// The table of the predictions of known units, row by row, and the fit.
fn of_known(model: &str, data: &str, design: &str) -> (Value, Vec<HashMap<String, String>>) {
    let files = [("m.toml", model), ("d.csv", data), ("new.csv", design)];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    for run in [
        "fit m.toml d.csv --criterion reml --out fit.json",
        "predict m.toml --from fit.json --design new.csv --units known --out p.csv",
    ] {
        let output = folder.run(run);
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    }
    let fit = serde_json::from_str(&std::fs::read_to_string(folder.path("fit.json")).unwrap()).unwrap();
    (fit, folder.table("p.csv"))
}

/// Units that were measured on one of two stations each: what is not known of the station is not known of the unit.
#[test]
fn a_known_unit_shares_what_is_unknown_of_its_station() {
    let mut places = Vec::new();
    (0..8u32).for_each(|u| (0..6).for_each(|r| places.push((u, r))));
    let row = |&(u, r): &(u32, u32)| {
        let (station, shift) = if u < 4 { ("A", 0.0) } else { ("B", 1.5) };
        let y = 2.0 + shift + 2.5 * wave(u + 3) + 0.3 * wave(17 * u + r + 90);
        format!("u{u},{r},{station},{y:e}\n")
    };
    let data: String = std::iter::once("unit,run,station,y\n".to_owned()).chain(places.iter().map(row)).collect();
    let model = "[data]\ntest = \"run\"\nlevels = [\"unit\"]\n[states]\nbias = {}\nb = { random = false }\n\
                 [measurements.y]\ncolumn = \"y\"\nequation = \"bias + if(station == 'B', b, 0)\"\nnoise = 0.1\n";
    let (fit, table) = of_known(model, &data, "unit,run,station,y\nu7,99,A,\n");
    let sigma = |block: &Value| block["covariance"]["estimate"][0][0].as_f64().unwrap();
    let [within, between] = [sigma(&fit["phases"][0]), sigma(&fit["levels"][0])];
    let n = places.len();
    let v = DMatrix::from_fn(n, n, |a, b| {
        let [same_unit, same_run] = [places[a].0 == places[b].0, a == b].map(|same| f64::from(u8::from(same)));
        between * same_unit + (within + 0.01) * same_run
    });
    let w = v.try_inverse().unwrap();
    let x = DMatrix::from_fn(n, 2, |a, c| if c == 0 || places[a].0 >= 4 { 1.0 } else { 0.0 });
    let c = (x.transpose() * &w * &x).try_inverse().unwrap();
    let own = DVector::from_fn(n, |a, _| if places[a].0 == 7 { between } else { 0.0 });
    let by_mean = DVector::from_vec(vec![1.0, 0.0]) - x.transpose() * &w * &own;
    let plain = between - own.dot(&(&w * &own)) + by_mean.dot(&(c * &by_mean));
    let found = number(&table[0], "std_dev_estimation").powi(2);
    assert!(found >= plain * (1.0 - 1e-9) && found < 1.5 * plain, "{found} against {plain} at known variances");
}

/// The mean of a unit that is measured through noise alone has the degrees of freedom of the noise.
#[test]
fn a_known_unit_has_the_degrees_of_freedom_of_the_noise() {
    let row = |(u, t): (u32, u32)| format!("u{u},t{t},{:e}\n", 9.0 * wave(u + 5) + 0.4 * wave(5 * u + t + 40));
    let rows: String = (0..3).flat_map(|u| (0..2).map(move |t| (u, t))).map(row).collect();
    let model = "[data]\ntest = \"test\"\nlevels = [\"unit\"]\n[states]\nlevel = {}\n[measurements.y]\ncolumn = \"y\"\n\
                 equation = \"level\"\nnoise = \"s\"\n[parameters]\ns = {}\n[covariance]\nstates = []\n";
    let (_, table) = of_known(model, &format!("unit,test,y\n{rows}"), "unit,test,y\nu0,t9,\n");
    let df = number(&table[0], "df");
    assert!((2.9..3.2).contains(&df), "six values less three units: {df}");
}

/// Balanced one-way layouts with a maximum inside: the restricted likelihood is certified in every one.
#[test]
fn restricted_fits_of_few_units_end_at_their_maximum() {
    let model = "[data]\ntest = \"test\"\nlevels = [\"unit\"]\n[states]\nlevel = {}\n[measurements.y]\ncolumn = \"y\"\n\
                 equation = \"level\"\nnoise = \"s\"\n[parameters]\ns = {}\n[covariance]\nstates = []\n";
    let folder = Folder::new(&[("m.toml", model.as_bytes())]);
    for seed in 0..25 {
        let y = |u: u32, t: u32| 9.0 * wave(u + 50 * seed) + wave(100 * seed + 7 * u + t + 1000);
        let rows: String = (0..6).map(|k| format!("u{},t{k},{:e}\n", k / 2, y(k / 2, k))).collect();
        folder.write("d.csv", format!("unit,test,y\n{rows}").as_bytes());
        let output = folder.run("fit m.toml d.csv --criterion reml --out fit.json --innovations off");
        assert_eq!(output.status.code(), Some(0), "seed {seed}: {}", shown(&output));
        let fit: Value = serde_json::from_str(&std::fs::read_to_string(folder.path("fit.json")).unwrap()).unwrap();
        let within: f64 = (0..3).map(|u| (y(u, 2 * u) - y(u, 2 * u + 1)).powi(2)).sum::<f64>() / 6.0;
        if fit["levels"][0]["covariance"]["estimate"][0][0].as_f64().unwrap() > 0.0 {
            near::relative("s", fit["parameters"][0]["estimate"].as_f64().unwrap(), within.sqrt(), 1e-5);
        }
    }
}
