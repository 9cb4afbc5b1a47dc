//! Constraints and new tests judged by the laws of few tests: Dyestuff2 of lme4, whose variance between batches is
//! estimated as zero, with figures of pbkrtest.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit_fixtures::near;
use serde_json::Value;

use crate::folder::{Folder, shown};

/// The batches of Dyestuff2, five samples each.
const BATCHES: [[f64; 5]; 6] = [
    [7.298, 3.846, 2.434, 9.566, 7.99],
    [5.22, 6.556, 0.608, 11.788, -0.892],
    [0.11, 10.386, 13.434, 5.51, 8.166],
    [2.212, 4.852, 7.092, 9.288, 4.98],
    [0.282, 9.014, 4.458, 9.446, 7.198],
    [1.722, 4.782, 8.106, 0.758, 3.758],
];

fn model(mean: &str) -> String {
    format!(
        "[data]\ntest = \"batch\"\n[states]\nlevel = {{}}\n[measurements.y]\ncolumn = \"y\"\nequation = \"level\"\n\
         noise = \"sigma\"\n[mean]\n{mean}\n[parameters]\nsigma = {{ start = 2 }}\n"
    )
}

/// The batches, with names that start with `prefix`.
fn batches(prefix: &str) -> String {
    let rows = BATCHES.iter().enumerate().flat_map(|(j, all)| all.iter().map(move |y| format!("{prefix}{j},{y}\n")));
    "batch,y\n".to_owned() + &rows.collect::<String>()
}

fn folder() -> Folder {
    let files = [
        ("free.toml", model("start = { level = 5 }")),
        ("held.toml", model("fixed = { level = 4 }")),
        ("null.toml", "[mean]\nfixed = { level = 4 }\n".to_owned()),
        ("d.csv", batches("old")),
        ("new.csv", batches("new")),
    ];
    Folder::new(&files.each_ref().map(|(name, text)| (*name, text.as_bytes())))
}

fn run(folder: &Folder, args: &str) -> String {
    let output = folder.run(args);
    assert_eq!(output.status.code(), Some(0), "{args}: {}", shown(&output));
    String::from_utf8(output.stdout).unwrap()
}

fn json(folder: &Folder, name: &str) -> Value {
    serde_json::from_str(&std::fs::read_to_string(folder.path(name)).unwrap()).unwrap()
}

/// By the score test the data contradict the mean that is held at 4 (p = 0.046); by F with 5 degrees of freedom they do
/// not. The mean is 5.6656 with a standard error of 0.678388.
#[test]
fn a_held_mean_is_judged_by_f() {
    let folder = folder();
    let text = run(&folder, "fit held.toml d.csv --criterion reml --out fit.json");
    let constraint = &json(&folder, "fit.json")["constraints"][0];
    let number = |name: &str| constraint[name].as_f64().unwrap();
    near::relative("score", number("p_value"), 0.045_559_33, 1e-6);
    near::relative("F", number("f"), (1.6656f64 / 0.678_388).powi(2), 1e-5);
    near::relative("degrees of freedom", number("f_df"), 5.0, 1e-8);
    assert!(text.contains("but the F test of a fit\n    without it does not"), "{text}");
    run(&folder, "test free.toml d.csv --null null.toml --bootstrap 0 --out test.json");
    let f = &json(&folder, "test.json")["f"];
    near::relative("F of `kalfit test`", number("f"), f["value"].as_f64().unwrap(), 1e-9);
    near::relative("its p-value", number("f_p_value"), f["p_value"].as_f64().unwrap(), 1e-9);
    // with a known noise level, where nothing but Σ is estimated
    let known = model("fixed = { level = 4 }").replace("{ start = 2 }", "3.7");
    folder.write("known.toml", known.as_bytes());
    run(&folder, "fit known.toml d.csv --criterion reml --out known.json");
    let known = &json(&folder, "known.json")["constraints"][0];
    near::relative("F at known noise", known["f"].as_f64().unwrap(), 1.6656f64.powi(2) / (3.7 * 3.7 / 30.0), 1e-6);
    // by maximum likelihood there is a likelihood ratio instead
    run(&folder, "fit held.toml d.csv --out ml.json");
    assert_eq!(json(&folder, "ml.json")["constraints"][0].get("f"), None);
}

/// A spread that was estimated as zero from six batches is not known to be zero: distances of new batches follow F.
#[test]
fn a_spread_estimated_as_zero_is_uncertain_for_new_tests() {
    let folder = folder();
    run(&folder, "fit free.toml d.csv --criterion reml --out fit.json");
    let text = run(&folder, "apply free.toml new.csv --from fit.json");
    assert!(text.contains("freedom): p ="), "{text}");
    insta::assert_snapshot!(text);
}
