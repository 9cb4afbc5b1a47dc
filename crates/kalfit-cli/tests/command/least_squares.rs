//! One regression written in three ways, measured with little noise: predictions are those of least squares.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit::FitRecord;
use kalfit_fixtures::near;

use crate::folder::{Folder, shown};

const X: [f64; 7] = [0.3, 1.9, 0.8, 1.4, 0.1, 1.1, 1.7];
const Y: [f64; 7] = [2.9, 7.6, 5.2, 4.1, 3.4, 5.9, 5.8];
/// Where it is predicted.
const AT: f64 = 1.5;
/// The 95 % point of Student's t with five degrees of freedom.
const QUANTILE: f64 = 2.015_048_372_669_157;

/// The same line: its slope as a regression, as a state that is the same in all tests, and as a parameter.
const WAYS: [(&str, &str); 3] = [
    ("a", "[states.a]\n[mean.regression]\na = [\"x\"]\n"),
    ("a + b * x", "[states.a]\n[states.b]\nrandom = false\n"),
    ("a + b * x", "[states.a]\n[parameters]\nb = { start = 1 }\n"),
];

/// (mean, its 90 % limits) at `AT`, and the record of the fit.
fn predicted((equation, states): (&str, &str), criterion: &str) -> ([f64; 3], FitRecord) {
    let rows = X.iter().zip(&Y).enumerate();
    let data: String =
        std::iter::once("test,x,y\n".to_owned()).chain(rows.map(|(j, (x, y))| format!("t{j},{x},{y}\n"))).collect();
    let model = format!(
        "[data]\ntest = \"test\"\n{states}[measurements.y]\ncolumn = \"y\"\nequation = \"{equation}\"\nnoise = 1e-3\n"
    );
    let outputs = format!("[outputs.v]\nequation = \"{equation}\"\n");
    let design = format!("test,x\nm,{AT}\n");
    let files = [("m.toml", &model), ("d.csv", &data), ("o.toml", &outputs), ("n.csv", &design)];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    for line in [
        format!("fit m.toml d.csv --criterion {criterion} --out fit.json --quiet"),
        "predict m.toml --from fit.json --design n.csv --outputs o.toml --out p.csv --confidence 0.9".to_owned(),
    ] {
        let output = folder.run(&line);
        assert_eq!(output.status.code(), Some(0), "{line}: {}", shown(&output));
    }
    let table = std::fs::read_to_string(folder.path("p.csv")).unwrap();
    let cells: Vec<Vec<&str>> = table.lines().map(|line| line.split(',').collect()).collect();
    let place = |name: &str| cells[0].iter().position(|cell| *cell == name).unwrap();
    let row = cells.iter().find(|row| row[place("name")] == "v").unwrap();
    let found = ["mean", "confidence_lower", "confidence_upper"].map(|name| row[place(name)].parse().unwrap());
    let json = std::fs::read_to_string(folder.path("fit.json")).unwrap();
    (found, serde_json::from_str(&json).unwrap())
}

/// Mean and its standard error at `AT`, with the variance of the residuals over so many degrees of freedom.
fn least_squares(degrees: f64) -> (f64, f64) {
    let n = X.len() as f64;
    let (mx, my) = (X.iter().sum::<f64>() / n, Y.iter().sum::<f64>() / n);
    let sxx: f64 = X.iter().map(|x| (x - mx).powi(2)).sum();
    let slope = X.iter().zip(&Y).map(|(x, y)| (x - mx) * (y - my)).sum::<f64>() / sxx;
    let residual = |(x, y): (&f64, &f64)| (y - my - slope * (x - mx)).powi(2);
    let variance = X.iter().zip(&Y).map(residual).sum::<f64>() / degrees;
    (my + slope * (AT - mx), (variance * (1.0 / n + (AT - mx).powi(2) / sxx)).sqrt())
}

#[test]
fn limits_of_the_mean_are_those_of_students_t() {
    let (mean, error) = least_squares(X.len() as f64 - 2.0);
    let expected = [mean, mean - QUANTILE * error, mean + QUANTILE * error];
    for (way, criterion) in [(0, "ml"), (1, "ml"), (2, "ml"), (0, "reml"), (1, "reml")] {
        let (found, _) = predicted(WAYS[way], criterion);
        for (found, expected) in found.into_iter().zip(expected) {
            near::mixed(format_args!("{} by {criterion}", WAYS[way].1), found, expected, 1e-6);
        }
    }
}

/// A parameter is no mean that the restricted likelihood allows for, but the mean follows it.
#[test]
fn a_mean_follows_a_parameter_under_the_restricted_likelihood() {
    let (found, record) = predicted(WAYS[2], "reml");
    let (mean, error) = least_squares(X.len() as f64 - 1.0);
    near::mixed("mean", found[0], mean, 1e-6);
    let estimates = record.estimates.expect("there are not many");
    let names = &estimates.names;
    let place = |what: &str| names.iter().position(|name| name == what).unwrap_or_else(|| panic!("{names:?}"));
    let covariance = |i: usize, k: usize| estimates.covariance[i][k];
    let (a, b) = (place("mean[a]"), place("b"));
    let variance = covariance(a, a) + 2.0 * AT * covariance(a, b) + AT * AT * covariance(b, b);
    near::mixed("standard error of a + b x", variance.sqrt(), error, 1e-5);
    let of_mean = record.phases[0].mean.std_error[0].expect("it has one");
    near::mixed("standard error of a", of_mean, covariance(a, a).sqrt(), 1e-5); // derivatives by b are differences
}
