//! Reports grouped by a column, and whether groups differ, through the built command.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit_fixtures::near;
use serde_json::Value;

use crate::folder::{Folder, shown};

const MODEL: &str = r#"
[data]
test = "id"
group = "lot"
[states.level]
[measurements.y]
column = "y"
equation = "level"
noise = 1
"#;

/// 30 tests of four rows in each of two lots; the levels of lot B lie `shift` higher and its noise is `noise` times as large.
fn data(shift: f64, noise: f64) -> String {
    let mut text = "id,lot,y\n".to_owned();
    for j in 0..60 {
        let (lot, second) = if j % 2 == 0 { ("A", 0.0) } else { ("B", 1.0) };
        let level = f64::from((j * 23) % 31 - 15) / 5.0 + shift * second;
        for k in 0..4 {
            let wave = f64::from((13 * j + 7 * k) % 19 - 9) / 5.5;
            text.push_str(&format!("t{j:02},{lot},{}\n", level + wave * (1.0 + (noise - 1.0) * second)));
        }
    }
    text
}

fn fitted(folder: &Folder, options: &str) -> Value {
    let output = folder.run(&format!("fit group.toml d.csv --out fit.json {options}"));
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    serde_json::from_slice(&std::fs::read(folder.path("fit.json")).unwrap()).unwrap()
}

#[test]
fn figures_of_groups_are_those_of_their_tests_together() {
    let folder = Folder::new(&[("group.toml", MODEL.as_bytes()), ("d.csv", data(0.0, 3.0).as_bytes())]);
    let fit = fitted(&folder, "");
    assert_eq!(fit["group_column"], "lot");
    let groups = fit["by_group"].as_array().unwrap();
    assert_eq!(groups.iter().map(|g| g["group"].as_str().unwrap()).collect::<Vec<_>>(), ["A", "B"]);
    for group in groups {
        let tests = || fit["tests"].as_array().unwrap().iter().filter(|test| test["group"] == group["group"]);
        assert_eq!((group["tests"].as_u64(), tests().count()), (Some(30), 30));
        let sum = |of: &dyn Fn(&Value) -> f64| tests().map(of).sum::<f64>();
        let check = |what: &str, expected: f64| near::mixed(what, group[what].as_f64().unwrap(), expected, 1e-9);
        check("log_likelihood", sum(&|test| test["log_likelihood"].as_f64().unwrap()));
        check("distance", sum(&|test| test["distance"].as_f64().unwrap()));
        check("innovations_mean_square", sum(&|test| test["innovations"]["nis"].as_f64().unwrap()) / 120.0);
        assert_eq!(group["innovations"], 120);
        // the second lot has three times the noise
        let p = group["innovations_p_value"].as_f64().unwrap();
        assert_eq!(p < 1e-6, group["group"] == "B", "{group}");
    }
    let text = shown(&folder.run("fit group.toml d.csv --report r.html"));
    assert!(text.contains("Groups by lot") && !text.contains("difference"), "{text}");
    let page = std::fs::read_to_string(folder.path("r.html")).unwrap();
    assert!(page.contains("Groups by lot"));
}

#[test]
fn groups_differ_where_their_means_do() {
    let compare = |shift: f64| -> (Value, String) {
        let folder = Folder::new(&[("group.toml", MODEL.as_bytes()), ("d.csv", data(shift, 1.0).as_bytes())]);
        (fitted(&folder, "--group-test")["group_test"].clone(), shown(&folder.run("fit group.toml d.csv --group-test")))
    };
    let (same, said) = compare(0.0);
    assert!(
        same["p_value"].as_f64().unwrap() > 0.05 && said.contains("No difference between the groups"),
        "{same} {said}"
    );
    let (apart, said) = compare(4.0);
    assert!(apart["p_value"].as_f64().unwrap() < 1e-6 && said.contains("The groups differ: p = "), "{apart} {said}");
    assert_eq!((&apart["groups"], &apart["degrees_of_freedom"]), (&2.into(), &2.into()));
    // each lot by itself, as separate files
    let mut alone = 0.0;
    for lot in ["A", "B"] {
        let all = data(4.0, 1.0);
        let rows: Vec<&str> =
            all.lines().filter(|line| line.starts_with("id") || line.contains(&format!(",{lot},"))).collect();
        let folder = Folder::new(&[("group.toml", MODEL.as_bytes()), ("d.csv", (rows.join("\n") + "\n").as_bytes())]);
        alone += fitted(&folder, "")["log_likelihood"].as_f64().unwrap();
    }
    let found = apart["log_likelihood"].as_f64().unwrap();
    assert!((found - alone).abs() < 1e-6, "{found} {alone}");
}

#[test]
fn what_has_no_group_is_refused() {
    let plain = MODEL.replace("group = \"lot\"\n", "");
    let mixed = data(0.0, 1.0).replacen("t00,A", "t00,B", 1);
    let folder = Folder::new(&[
        ("group.toml", MODEL.as_bytes()),
        ("plain.toml", plain.as_bytes()),
        ("d.csv", data(0.0, 1.0).as_bytes()),
        ("mixed.csv", mixed.as_bytes()),
    ]);
    for (args, said) in [
        ("fit plain.toml d.csv --group-test", "names no column to group by"),
        ("fit group.toml mixed.csv", "test `t00` has `B` and `A` in column `lot`"),
        ("fit group.toml d.csv --group-test --criterion reml", "restricted likelihoods"),
    ] {
        let output = folder.run(args);
        assert_eq!(output.status.code(), Some(2), "{args}: {}", shown(&output));
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(error.contains(said) && error.contains("hint"), "{args}: {error}");
    }
}
