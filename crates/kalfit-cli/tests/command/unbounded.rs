//! Data that fit a model exactly: ℓ has no maximum, and that is said in words. Ordinary levels at zero are another matter.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit::FitRecord;

use crate::folder::{Folder, shown};

/// Bias and drift of eight units.
const UNITS: [(f64, f64); 8] = [
    (1.37, 0.41),
    (-0.84, 0.12),
    (2.95, -0.33),
    (0.26, 0.78),
    (-1.61, 0.05),
    (3.48, 0.64),
    (0.93, -0.19),
    (1.12, 0.57),
];

/// Rows `unit,lot,t,z`, the value of each made by `z(unit, t)`.
fn rows(z: impl Fn(usize, f64) -> f64) -> String {
    let mut text = "unit,lot,t,z\n".to_owned();
    for unit in 0..UNITS.len() {
        for t in 0..8 {
            let lot = if unit < 4 { "A" } else { "B" };
            text += &format!("u{unit},{lot},{t},{}\n", z(unit, f64::from(t)));
        }
    }
    text
}

fn line(unit: usize, t: f64) -> f64 {
    UNITS[unit].0 + UNITS[unit].1 * t
}

/// Numbers without a pattern, of size one.
fn scatter(unit: usize, t: f64) -> f64 {
    2.0 * ((unit as f64 * 12.9898 + t * 78.233).sin() * 43758.5453).rem_euclid(1.0) - 1.0
}

fn model(states: &str, equation: &str, parameters: &str) -> String {
    format!(
        "[data]\ntest = \"unit\"\ntime = \"t\"\n{states}\n[measurements.z]\ncolumn = \"z\"\nequation = \"{equation}\"\nnoise = \"sigma\"\n[parameters]\n{parameters}\n"
    )
}

fn bias_and_drift(parameters: &str) -> String {
    model("[states.bias]\n[states.drift]", "bias + drift * t", parameters)
}

/// What is printed, and the record.
fn fitted(model: &str, data: &str, status: i32) -> (String, FitRecord) {
    fitted_by("hybrid", model, data, status)
}

fn fitted_by(method: &str, model: &str, data: &str, status: i32) -> (String, FitRecord) {
    let folder = Folder::new(&[("model.toml", model.as_bytes()), ("data.csv", data.as_bytes())]);
    let output = folder.run(&format!("fit model.toml data.csv --out fit.json --method {method}"));
    assert_eq!(output.status.code(), Some(status), "{}", shown(&output));
    (shown(&output), serde_json::from_slice(&std::fs::read(folder.path("fit.json")).unwrap()).unwrap())
}

/// The fit says that ℓ has no maximum with these levels.
fn is_unbounded(what: &str, model: &str, data: &str, levels: &str) {
    let (text, record) = fitted(model, data, 1);
    let expected = format!(
        "the log-likelihood has no maximum: it rises without bound as {levels}, because the data fit the model exactly"
    );
    assert!(!record.converged, "{what}: converged, {}", record.reason);
    assert_eq!(record.reason, expected, "{what}: {text}");
    assert!(record.notes.iter().any(|note| note.contains("noise-free data")), "{what}: {:?}", record.notes);
}

#[test]
fn a_fit_of_data_without_noise_has_no_maximum() {
    let exact = rows(line);
    is_unbounded("bias and drift", &bias_and_drift("sigma = {}"), &exact, "`sigma` goes to zero");
    is_unbounded("given start", &bias_and_drift("sigma = { start = 0.1 }"), &exact, "`sigma` goes to zero");
    is_unbounded("one constant", &bias_and_drift("sigma = {}"), &rows(|_, _| 3.25), "`sigma` goes to zero");
    let wander = "[states.bias]\n[states.drift]\n[states.wander]\nprocess = \"gauss-markov\"\ntime_constant = \"tau\"\nsigma = \"sigma_w\"";
    let with_process = model(wander, "bias + drift * t + wander", "sigma = {}\ntau = {}\nsigma_w = {}");
    is_unbounded("with a process", &with_process, &exact, "`sigma` and `sigma_w` go to zero together");
}

#[test]
fn no_method_certifies_a_slope() {
    // as a variance, EM stopped on the way to zero, where ℓ has a slope and no curvature
    let by_variance = bias_and_drift("sigma = {}").replace("noise =", "variance =");
    for method in ["hybrid", "innovations", "em"] {
        let (text, record) = fitted_by(method, &by_variance, &rows(line), 1);
        assert!(record.reason.starts_with("the log-likelihood has no maximum"), "{method}: {text}");
    }
}

#[test]
fn one_level_of_several_without_noise_is_named_alone() {
    let data = rows(|unit, t| line(unit, t) + if unit < 4 { 0.3 * scatter(unit, t) } else { 0.0 });
    is_unbounded(
        "a lot without noise",
        &bias_and_drift("sigma = { per = \"lot\" }"),
        &data,
        "`sigma` for lot B goes to zero",
    );
}

#[test]
fn all_levels_without_noise_are_named_at_once() {
    let is_still = |unit: usize| [2, 5, 7].contains(&unit);
    let data = rows(|unit, t| UNITS[unit].0 + if is_still(unit) { 0.0 } else { 0.3 * scatter(unit, t) });
    let model = model("[states.bias]", "bias", "sigma = { per = \"unit\" }");
    let levels = "`sigma` for unit u2, `sigma` for unit u5 and `sigma` for unit u7 go to zero together";
    is_unbounded("three units that never move", &model, &data, levels);
    let (text, _) = fitted(&model, &data, 1);
    let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains("a floor (`lower` in"), "{text}");
    assert!(!words.contains("diagonal covariance"), "{text}");
}

#[test]
fn offsets_beyond_the_digits_of_the_data_are_no_false_alarm() {
    // noise of a part in 10⁸ of the values, and of one in 10⁵ of how they differ
    for (offset, noise) in [(0.0, 1e-5), (1e4, 1e-4), (0.0, 1e-7)] {
        let data = rows(|unit, t| offset + line(unit, t) + noise * scatter(unit, t));
        let (_, record) = fitted(&bias_and_drift("sigma = {}"), &data, 0);
        let sigma = record.parameters[0].estimate;
        assert!(
            record.converged && (0.3..1.0).contains(&(sigma / noise)),
            "{offset} {noise}: {sigma}, {}",
            record.reason
        );
    }
}

#[test]
fn an_ordinary_level_at_zero_is_no_false_alarm() {
    let walk = "[states.bias]\n[states.wander]\nprocess = \"random-walk\"\nstep_noise = \"walk\"\ninitial = { mean = 0, sigma = 0 }";
    let data = rows(|unit, t| UNITS[unit].0 + scatter(unit, t));
    let (text, record) =
        fitted(&model(walk, "bias + wander", "sigma = {}\nwalk = {}").replace("time = \"t\"\n", ""), &data, 0);
    assert!(record.converged, "{text}");
    assert_eq!(record.parameters[1].estimate, 0.0, "{text}");
    let limit =
        "`walk` is estimated as zero: the data show no such effect; `--intervals profile` gives the upper limit";
    assert!(record.notes.iter().any(|note| note == limit), "{:?}", record.notes);
}
