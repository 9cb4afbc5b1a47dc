//! What the data do not determine beside free parameters is named, and does not keep a fit from its end.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit_fixtures::near;
use serde_json::Value;

use crate::folder::{Folder, shown};

/// Fits a model of data; what was printed, and fit.json.
fn fit(model: &str, data: &str, options: &str) -> (String, Value) {
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
    let output = folder.run(&format!("fit m.toml d.csv --innovations off --out fit.json {options}"));
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let json = std::fs::read_to_string(folder.path("fit.json")).unwrap();
    (shown(&output), serde_json::from_str(&json).unwrap())
}

pub(crate) fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("a number expected, found {value}"))
}

/// A number in (-1, 1) that looks random.
fn noise(seed: u32) -> f64 {
    let mut x = seed.wrapping_mul(2_654_435_761).wrapping_add(97);
    for shift in [13, 17, 5] {
        x ^= if shift == 17 { x >> shift } else { x << shift };
    }
    f64::from(x % 20_001) / 10_000.0 - 1.0
}

/// Twelve tests of four rows.
fn rows(of: &dyn Fn(u32, u32) -> String) -> String {
    (0..12).flat_map(|j| (0..4).map(move |k| (j, k))).map(|(j, k)| of(j, k)).collect()
}

/// Of y = k a only k μ and k σ are known: none of the three has a standard error, and all are named.
#[test]
fn a_factor_of_a_state_is_not_told_from_its_mean_and_variance() {
    let data = rows(&|j, k| format!("t{j:02},{}\n", 2.0 + 1.7 * noise(j) + 0.3 * noise(100 + 4 * j + k)));
    let model = |equation: &str, parameter: &str| {
        format!(
            "[data]\ntest = \"test\"\n[states.a]\n[measurements.y]\ncolumn = \"y\"\nequation = \"{equation}\"\nnoise = \"s\"\n[parameters]\ns = {{ start = 0.3 }}\n{parameter}"
        )
    };
    let data = format!("test,y\n{data}");
    let (text, found) = fit(&model("k * a", "k = { start = 0.7 }\n"), &data, "");
    let (_, known) = fit(&model("a", ""), &data, "");
    near::mixed("ℓ", number(&found["log_likelihood"]), number(&known["log_likelihood"]), 1e-9);
    let phase = &found["phases"][0];
    assert_eq!(phase["mean"]["std_error"][0], Value::Null, "{text}");
    assert_eq!(phase["covariance"]["std_error"][0][0], Value::Null, "{text}");
    let named: Vec<&Value> = phase["unidentified"].as_array().unwrap().iter().map(|one| &one["what"]).collect();
    assert_eq!(named, ["mean", "covariance"], "{text}");
    let of = |name: &str| found["parameters"].as_array().unwrap().iter().find(|own| own["name"] == name).unwrap();
    assert_eq!((&of("k")["std_error"], &of("k")["standing"]), (&Value::Null, &Value::from("unidentified")), "{text}");
    let error = |found: &Value| number(&found["parameters"][0]["std_error"]);
    near::mixed("standard error of the noise", error(&found), error(&known), 1e-5);
    let kept = number(&of("k")["estimate"]) * number(&phase["mean"]["estimate"][0]);
    near::mixed("k μ", kept, number(&known["phases"][0]["mean"]["estimate"][0]), 1e-6);
}

/// No test sees a and b together: their covariance is open, and ℓ bends along it by what is left of the score alone.
#[test]
fn a_covariance_that_no_test_sees_does_not_keep_a_fit_from_its_end() {
    for seed in 0..10 {
        let data = rows(&|j, k| {
            let (own, rest) = (noise(1000 * seed + j), noise(1000 * seed + 100 + 4 * j + k));
            format!("t{j:02},{},{}\n", j % 2, 2.0 + 1.7 * own + 0.5 * rest)
        });
        let model = "[data]\ntest = \"test\"\n[states.a]\n[states.b]\n[measurements.y]\ncolumn = \"y\"\nequation = \"h * a + (1 - h) * b\"\nnoise = \"s\"\n[parameters]\ns = {}\n";
        let (text, found) = fit(model, &format!("test,h,y\n{data}"), "");
        assert_eq!(found["converged"], true, "{seed}: {text}");
        let phase = &found["phases"][0];
        assert_eq!(phase["unidentified"][0]["what"], "covariance", "{seed}: {text}");
    }
}

/// A model of `y` with parameters, and perhaps more.
pub(crate) fn of_y(equation: &str, noise: &str, parameters: &[&str], rest: &str) -> String {
    let parameters: String = parameters.iter().map(|name| format!("{name} = {{}}\n")).collect();
    format!(
        "[data]\ntest = \"test\"\ntime = \"t\"\n{rest}[measurements.y]\ncolumn = \"y\"\nequation = \"{equation}\"\nnoise = \"{noise}\"\n[parameters]\n{parameters}"
    )
}

pub(crate) fn parameter<'a>(found: &'a Value, name: &str) -> &'a Value {
    found["parameters"].as_array().unwrap().iter().find(|own| own["name"] == name).unwrap()
}

/// At zero a product has neither slope nor curvature along its factors, and yet it is no maximum.
#[test]
fn factors_that_start_at_zero_leave_it() {
    let rows = rows(&|j, k| format!("t{j:02},{k},{}\n", 6.0 + 1.7 * noise(j) + 0.3 * noise(100 + 4 * j + k)));
    let data = format!("test,t,y\n{rows}");
    let states = "[states.a]\n[mean]\nfixed = { a = 3 }\n";
    let (text, found) = fit(&of_y("k1 * k2 * a", "s", &["k1", "k2", "s"], states), &data, "");
    let (_, one) = fit(&of_y("k * a", "s", &["k", "s"], states), &data, "");
    near::mixed("ℓ", number(&found["log_likelihood"]), number(&one["log_likelihood"]), 1e-7);
    for name in ["k1", "k2"] {
        assert_eq!(parameter(&found, name)["standing"], "unidentified", "{text}");
    }
    let error = |found: &Value| number(&found["phases"][0]["covariance"]["std_error"][0][0]);
    near::mixed("error of the variance", error(&found), error(&one), 1e-4);
}

/// Of two factors of a noise only their product is known: of mean and variance all that is known without the second.
#[test]
fn factors_of_a_noise_are_no_matter_of_mean_and_variance() {
    let rows = rows(&|j, k| format!("t{j:02},{k},{}\n", 2.0 + 1.7 * noise(j) + 0.3 * noise(100 + 4 * j + k)));
    let data = format!("test,t,y\n{rows}");
    let (text, found) = fit(&of_y("a", "s * g", &["s", "g"], "[states.a]\n"), &data, "");
    let (_, one) = fit(&of_y("a", "s", &["s"], "[states.a]\n"), &data, "");
    near::mixed("ℓ", number(&found["log_likelihood"]), number(&one["log_likelihood"]), 1e-9);
    for name in ["s", "g"] {
        assert_eq!(parameter(&found, name)["standing"], "unidentified", "{text}");
    }
    for what in ["mean", "std_dev"] {
        let error = |found: &Value| number(&found["phases"][0][what]["std_error"][0]);
        near::mixed(what, error(&found), error(&one), 1e-4);
    }
    assert_eq!(found["phases"][0]["unidentified"], Value::Array(Vec::new()), "{text}");
}

/// The factor of a walk and its noise density: along a curve, not along a line.
#[test]
fn a_factor_of_a_process_is_not_told_from_its_noise() {
    let data = rows(&|j, k| {
        let walk: f64 = (0..=k).map(|i| 0.8 * noise(500 + 4 * j + i)).sum();
        format!("t{j:02},{k},{}\n", 2.0 + 1.7 * noise(j) + walk + 0.3 * noise(100 + 4 * j + k))
    });
    let states =
        "[states.a]\n[states.r]\nprocess = \"random-walk\"\nnoise_density = \"q\"\ninitial = { mean = 0, sigma = 0 }\n";
    let (text, found) = fit(&of_y("a + g * r", "0.2", &["q", "g"], states), &format!("test,t,y\n{data}"), "");
    for name in ["q", "g"] {
        assert_eq!(parameter(&found, name)["standing"], "unidentified", "{name}: {text}");
        assert_eq!(parameter(&found, name)["std_error"], Value::Null, "{name}: {text}");
    }
}

/// Values without a pattern.
fn scattered(k: usize) -> f64 {
    ((k * k * 7 + 3 * k) % 19) as f64 / 5.0
}

#[test]
fn check_knows_what_a_fit_would_not_identify_with_its_parameters() {
    let one_each = "[data]\ntest = \"unit\"\n[states.bias]\n[measurements.y]\ncolumn = \"y\"\nequation = \"bias\"\nnoise = \"sigma\"\n[parameters]\nsigma = {}\n";
    let long = one_each
        .replace("[states.bias]", "[states.bias]\n[states.gain]")
        .replace("equation = \"bias\"", "equation = \"if(which == 'a', bias, gain)\"");
    let wide = long.replace("column = \"y\"", "column = \"a\"").replace("if(which == 'a', bias, gain)", "bias")
        + "[measurements.z]\ncolumn = \"b\"\nequation = \"gain\"\nnoise = \"sigma\"\n";
    let table =
        |head: &str, row: &dyn Fn(usize) -> String| (0..12).map(row).fold(format!("{head}\n"), |all, row| all + &row);
    let cases = [
        ("one value each", one_each.to_owned(), table("unit,y", &|k| format!("u{k},{}\n", scattered(k)))),
        ("long", long, table("unit,which,y", &|k| format!("u{k},a,{}\nu{k},b,{}\n", scattered(k), scattered(k + 50)))),
        ("wide", wide, table("unit,a,b", &|k| format!("u{k},{},{}\n", scattered(k), scattered(k + 50)))),
    ];
    for (what, model, data) in cases {
        let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
        let said = shown(&folder.run("check m.toml d.csv")).split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(said.contains("Not identified: the "), "{what}: {said}");
        assert!(said.contains("Other values fit the data as well with another value of `sigma`."), "{what}: {said}");
        let twice = data.clone() + &data.lines().skip(1).map(|row| format!("{row}1\n")).collect::<String>();
        folder.write("twice.csv", twice.as_bytes());
        let said = shown(&folder.run("check m.toml twice.csv"));
        assert!(said.contains("The data identify all free elements"), "{what}, measured twice: {said}");
    }
}
