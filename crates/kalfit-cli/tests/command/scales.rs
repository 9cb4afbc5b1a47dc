//! States of very different scales, and states that the data say nothing about.

use crate::folder::{Folder, shown};
use kalfit::FitRecord;

const TWO: &str = r#"
[data]
test = "id"
[states]
a = {}
b = {}
[measurements.y]
column = "y"
equation = "a"
noise = NOISE
[measurements.z]
column = "z"
equation = "b"
noise = 1
"#;

const ROWS: [(f64, f64, f64); 6] =
    [(2.0, 1.4, 2.9), (-1.0, 0.2, -0.9), (0.5, 2.0, 1.1), (4.0, 3.7, 1.2), (1.0, -1.8, 0.1), (-0.5, 0.4, 1.6)];

/// y is in units of `unit`; two rows a test.
fn rows(unit: f64) -> String {
    let of = |(j, (y, z, w)): (usize, &(f64, f64, f64))| format!("{j},{},{z}\n{j},{},{w}\n", y * unit, y * unit);
    "id,y,z\n".to_owned() + &ROWS.iter().enumerate().map(of).collect::<String>()
}

fn fit(model: &str, data: &str) -> FitRecord {
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
    let output = folder.run("fit m.toml d.csv --out fit.json");
    let text = std::fs::read_to_string(folder.path("fit.json")).unwrap_or_else(|_| panic!("{}", shown(&output)));
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    serde_json::from_str(&text).expect("fit.json is a record")
}

#[test]
fn a_spread_that_is_much_larger_than_the_noise_is_identified() {
    let variance = |values: [f64; 6]| {
        let mean = values.iter().sum::<f64>() / 6.0;
        values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 6.0
    };
    let expected = variance(ROWS.map(|row| row.0));
    for noise in ["1e-2", "1e-4", "1e-6", "1e-8"] {
        let record = fit(&TWO.replace("NOISE", noise), &rows(1.0));
        let phase = &record.phases[0];
        assert!(phase.unidentified.is_empty(), "{noise}: {:?}", phase.unidentified);
        let found = phase.covariance.estimate[0][0];
        assert!((found / expected - 1.0).abs() < 1e-4, "{noise}: {found} {expected}");
        let (error, asymptotic) = (phase.covariance.std_error[0][0].unwrap_or(0.0), expected * (2.0_f64 / 6.0).sqrt());
        assert!((error / asymptotic - 1.0).abs() < 1e-3, "{noise}: {error} {asymptotic}");
    }
}

#[test]
fn standard_errors_follow_the_units() {
    let (plain, tiny) =
        (fit(&TWO.replace("NOISE", "0.1"), &rows(1.0)), fit(&TWO.replace("NOISE", "1e-10"), &rows(1e-9)));
    let errors = |record: &FitRecord| {
        let phase = &record.phases[0];
        [phase.mean.std_error[0], phase.covariance.std_error[0][0], phase.covariance.std_error[0][1]]
            .map(|error| error.expect("every quantity is identified"))
    };
    for ((found, plain), unit) in errors(&tiny).iter().zip(errors(&plain)).zip([1e-9, 1e-18, 1e-9]) {
        assert!((found / (plain * unit) - 1.0).abs() < 1e-5, "{found} {}", plain * unit);
    }
}

#[test]
fn a_mean_without_information_is_named_and_stays() {
    // the one free mean is that of a state that nothing measures
    let model =
        TWO.replace("NOISE", "0.1").replace("b = {}", "b = {}\nunseen = {}").replace("\"b\"", "\"b + 0.3 * a\"")
            + "[mean]\nfixed = { a = 1, b = 1 }\nstart = { unseen = 1.5 }\n";
    let phase = &fit(&model, &rows(1.0)).phases[0];
    assert_eq!(phase.mean.estimate, [1.0, 1.0, 1.5]);
    assert_eq!(phase.mean.std_error, [None, None, None]);
    let named = phase.unidentified.iter().filter(|found| found.what == "mean").count();
    assert_eq!(named, 1, "{:?}", phase.unidentified);
}

#[test]
fn fixed_variances_leave_the_others_in_their_place() {
    let model = TWO.replace("NOISE", "0.1").replace("b = {}", "b = {}\nunseen = {}\ncommon = { random = false }")
        + "[covariance]\nfixed = { \"b, b\" = 1 }\n";
    let phase = &fit(&model.replace("\"b\"", "\"b + common * y\""), &rows(1.0)).phases[0];
    assert_eq!(phase.covariance.estimate[1][1], 1.0);
    let unseen = phase.covariance.estimate[2][2];
    assert!(unseen < 1e3, "a variance that nothing is known of: {unseen}");
}

#[test]
fn equal_variances_that_are_both_zero_are_certified_together() {
    // b varies less from test to test than its noise, a a little more: together, nothing is left
    let model = TWO.replace("NOISE", "1") + "[covariance]\nstructure = \"diagonal\"\nequal = [[\"a, a\", \"b, b\"]]\n";
    let data = "id,y,z\n0,1.2,0.1\n1,-1.3,0\n2,0.2,-0.1\n3,0.9,0.1\n";
    let phase = &fit(&model, data).phases[0];
    assert_eq!(phase.covariance.estimate, [[0.0, 0.0], [0.0, 0.0]]);
}

#[test]
fn standard_deviations_of_zero_are_left_when_the_data_say_so() {
    let model =
        TWO.replace("NOISE", "1") + "[covariance]\nstructure = \"correlation\"\nmatrix = [[1, -0.7], [-0.7, 1]]\n";
    // both spreads are a little above what the noise explains, with the other sign of correlation; b alone is best left at 0
    let data = "id,y,z\n0,1.5,0.4\n1,-1.5,-0.4\n2,1.1,0.3\n3,-1.1,-0.3\n";
    let phase = &fit(&model, data).phases[0];
    let expected = (1.5_f64.powi(2) + 1.1_f64.powi(2)) / 2.0 - 1.0;
    assert!(
        (phase.covariance.estimate[0][0] - expected).abs() < 1e-6,
        "{} {expected}",
        phase.covariance.estimate[0][0]
    );
    assert_eq!(phase.covariance.estimate[1][1], 0.0);
}
