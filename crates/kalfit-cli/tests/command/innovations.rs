//! Innovations in fit.json, and which tests say what, through the built command.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use serde_json::Value;

use crate::folder::{Folder, MODEL, shown};

fn fitted(folder: &Folder, args: &str, input: Option<&[u8]>) -> Value {
    let output = match input {
        Some(bytes) => folder.run_with_input(args, bytes),
        None => folder.run(args),
    };
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    serde_json::from_slice(&std::fs::read(folder.path("fit.json")).unwrap()).unwrap()
}

/// 12 tests of 10 rows; the last has noise five times the others', its values alternate around its line.
fn data() -> String {
    let mut text = "id,x,y\n".to_owned();
    for j in 0..12 {
        for k in 0..10 {
            let (x, wave) = (f64::from(k), f64::from((7 * j + 3 * k) % 11 - 5) / 50.0);
            let noise = if j == 11 { 0.5 * f64::from(1 - 2 * (k % 2)) } else { wave };
            let y = f64::from((j * 5) % 7) + x * (1.0 + 0.1 * f64::from((j * 3) % 5)) + noise;
            text.push_str(&format!("t{j:02},{x},{y}\n"));
        }
    }
    text
}

#[test]
fn each_test_has_its_innovations_and_improbable_ones_are_named() {
    let folder = Folder::new(&[("d.csv", data().as_bytes())]);
    let fit = fitted(&folder, "fit m.toml d.csv --out fit.json", None);
    let tests = fit["tests"].as_array().unwrap();
    for test in tests {
        let found = &test["innovations"];
        assert_eq!(found["count"], 10, "{test}");
        assert_eq!(found["whiteness"]["lags"], 2, "{test}");
        let p = found["nis_p_value"].as_f64().unwrap();
        assert_eq!(p < 1e-6, test["id"] == "t11", "{test}");
        let (nis, mean) = (found["nis"].as_f64().unwrap(), found["mean"].as_f64().unwrap());
        assert!(nis > 0.0 && mean * mean <= nis / 10.0, "{test}");
    }
    let output = folder.run("fit m.toml d.csv");
    let text = shown(&output);
    let row = text.lines().find(|line| line.contains("larger than modelled")).unwrap_or_default();
    assert!(row.trim_start().starts_with("t11"), "{text}");
}

#[test]
fn standard_input_has_the_same_innovations_as_a_file() {
    let data = data();
    // rows of all tests mixed: the reader starts again
    let mut lines: Vec<&str> = data.lines().collect();
    let header = lines.remove(0);
    let mixed: Vec<&str> = (0..10).flat_map(|k| lines.iter().skip(k).step_by(10).copied()).collect();
    let mixed = format!("{header}\n{}\n", mixed.join("\n"));
    let folder = Folder::new(&[("d.csv", data.as_bytes())]);
    let file = fitted(&folder, "fit m.toml d.csv --out fit.json", None);
    let piped = fitted(&folder, "fit m.toml - --out fit.json", Some(mixed.as_bytes()));
    assert_eq!(file["tests"], piped["tests"]);
    assert!(file["tests"][0]["innovations"].is_object());
}

#[test]
fn innovations_can_be_left_out() {
    let folder = Folder::new(&[]);
    let fit = fitted(&folder, "fit m.toml d.csv --out fit.json --innovations off", None);
    assert!(fit["tests"].as_array().unwrap().iter().all(|test| test["innovations"].is_null()));
    assert!(!shown(&folder.run("fit m.toml d.csv --innovations off")).contains("Innovations"));
    let short = fitted(&folder, "fit m.toml d.csv --out fit.json", None);
    assert_eq!(short["tests"][0]["innovations"]["count"], 3);
    assert!(short["tests"][0]["innovations"]["whiteness"].is_null(), "three are too short");
}

#[test]
fn what_is_not_identified_has_a_reason_and_its_tests() {
    // level and slope in different tests; the third state in none
    let model = format!("{MODEL}\n[measurements.z]\ncolumn = \"z\"\nequation = \"slope + 0 * other\"\nnoise = 0.2\n")
        .replace("level + slope * x", "level")
        .replace("[states.slope]", "[states.slope]\n[states.other]");
    let data = "id,y,z\na,1,\na,2,\nb,3,\nb,1,\nc,,4\nc,,5\nd,,2\nd,,3\n";
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
    let fit = fitted(&folder, "fit m.toml d.csv --out fit.json", None);
    let phase = &fit["phases"][0];
    assert_eq!(phase["observability"][1]["tests"], serde_json::json!(["c", "d"]));
    assert_eq!(phase["observability"][2]["informed_by"], 0);
    assert!(phase["mean"]["std_error"][2].is_null() && phase["mean"]["std_error"][1].is_number(), "{phase}");
    let unidentified = phase["unidentified"].as_array().unwrap();
    let reasons: Vec<&str> = unidentified.iter().map(|u| u["reason"].as_str().unwrap()).collect();
    assert_eq!(reasons.iter().filter(|r| **r == "no test observes `other`").count(), 4, "{reasons:?}");
    assert!(reasons.contains(&"`level` and `slope` are never observed in one test"), "{reasons:?}");
    let text = shown(&folder.run("check m.toml d.csv"));
    for part in
        ["other     none", "2 of 4", "never observed in one test", "Only 2 tests contain information on slope: c and d"]
    {
        assert!(
            text.split_whitespace()
                .collect::<Vec<_>>()
                .join(" ")
                .contains(&part.split_whitespace().collect::<Vec<_>>().join(" ")),
            "`{part}` in:\n{text}"
        );
    }
}
