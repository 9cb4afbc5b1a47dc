//! `kalfit compare` through the built command.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use insta::assert_snapshot;
use serde_json::Value;

use crate::folder::{Folder, shown};

/// Random coefficients; the same without correlation, and without spread of the slope.
fn fitted() -> Folder {
    let folder = Folder::new(&[]);
    for path in ["sleepstudy.toml", "sleepstudy.csv"] {
        folder.copy(&format!("../../examples/random-coefficients/{path}"));
    }
    let model = std::fs::read_to_string(folder.path("sleepstudy.toml")).unwrap();
    let variants = [
        ("full", ""),
        ("apart", "\n[covariance]\nstructure = \"diagonal\"\n"),
        ("parallel", "\n[covariance]\nfixed = { \"slope, slope\" = 0 }\n"),
    ];
    for (name, added) in variants {
        folder.write(&format!("{name}.toml"), format!("{model}{added}").as_bytes());
        let output = folder.run(&format!("fit {name}.toml sleepstudy.csv --out {name}.json --quiet"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    }
    folder
}

#[test]
fn fits_stand_side_by_side_with_tests_of_one_within_another() {
    let folder = fitted();
    assert_snapshot!(shown(&folder.run("compare full.json apart.json parallel.json --out c.json")), @"");
    let record: Value = serde_json::from_slice(&std::fs::read(folder.path("c.json")).unwrap()).unwrap();
    assert_eq!(record["schema"], "kalfit-compare/1");
    // lme4 on the same data: -875.9697 with 6 free, -876.0016 with 5; anova gives χ² = 0.0639 with 1, p = 0.8004
    let test = record["nested"].as_array().unwrap().iter().find(|test| test["null"] == 1).unwrap();
    let near = |what: &str, found: &Value, expected: f64| {
        let found = found.as_f64().unwrap();
        assert!((found - expected).abs() < 1e-4, "{what}: {found} against {expected}");
    };
    near("-2 log λ", &test["lr"], 0.0639);
    near("p", &test["p_value"], 0.8004);
    assert_eq!((test["df"].as_u64(), test["p_value_kind"].as_str()), (Some(1), Some("large-sample")));
    // and `kalfit test` on the same hypothesis
    folder.write("null.toml", b"[covariance]\nstructure = \"diagonal\"\n");
    let output = folder.run("test full.toml sleepstudy.csv --null null.toml --out t.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let own: Value = serde_json::from_slice(&std::fs::read(folder.path("t.json")).unwrap()).unwrap();
    let difference = own["lr"].as_f64().unwrap() - test["lr"].as_f64().unwrap();
    assert!(difference.abs() < 1e-6, "{} against {}", own["lr"], test["lr"]);
}

#[test]
fn fits_of_other_data_and_files_that_are_no_fits_are_refused() {
    let folder = fitted();
    let data = std::fs::read_to_string(folder.path("sleepstudy.csv")).unwrap();
    let short: Vec<&str> = data.lines().take(data.lines().count() - 1).collect();
    folder.write("short.csv", short.join("\n").as_bytes());
    let output = folder.run("fit full.toml short.csv --out short.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    assert_snapshot!(shown(&folder.run("compare full.json short.json")), @"");
    assert_snapshot!(shown(&folder.run("compare full.json full.json")), @"");
    assert_snapshot!(shown(&folder.run("compare full.json full.toml")), @"");
    assert_snapshot!(shown(&folder.run("compare full.json none.json")), @"");
    assert_snapshot!(shown(&folder.run("compare full.json apart.json --out full.json")), @"");
    let output = folder.run("fit full.toml sleepstudy.csv --criterion reml --out reml.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    assert_snapshot!(shown(&folder.run("compare full.json reml.json")), @"");
}
