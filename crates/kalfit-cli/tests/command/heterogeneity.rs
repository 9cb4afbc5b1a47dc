//! Cochran's Q, I² and H² of thirteen trials of the BCG vaccine, with the figures that metafor prints for the same models.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit_fixtures::near;
use serde_json::Value;

use crate::folder::{Folder, shown};

fn fit(folder: &Folder, model: &str, options: &str) -> (Value, String) {
    let output = folder.run(&format!("fit {model} moderators.csv {options} --out fit.json"));
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let record = serde_json::from_str(&std::fs::read_to_string(folder.path("fit.json")).unwrap()).unwrap();
    (record, String::from_utf8(output.stdout).unwrap())
}

#[test]
fn trials_differ_as_metafor_says() {
    let folder = Folder::new(&[]);
    folder.copy("templates/moderators.toml");
    folder.copy("templates/moderators.csv");
    let text = std::fs::read_to_string(folder.path("moderators.toml")).unwrap();
    let without: Vec<&str> =
        text.lines().filter(|line| !line.contains("latitude") && !line.starts_with("[mean]")).collect();
    folder.write("plain.toml", without.join("\n").as_bytes());
    for (model, q, degrees, i_squared, h_squared) in
        [("plain.toml", 152.233_0, 12, 92.22, 12.86), ("moderators.toml", 30.733_1, 11, 68.39, 3.16)]
    {
        let (record, summary) = fit(&folder, model, "--criterion reml");
        let found = &record["heterogeneity"];
        let number = |name: &str| found[name].as_f64().unwrap();
        near::absolute("Q", number("q"), q, 5e-5);
        assert_eq!(found["degrees_of_freedom"], degrees);
        near::absolute("I²", 100.0 * number("i_squared"), i_squared, 5e-3);
        near::absolute("H²", number("h_squared"), h_squared, 5e-3);
        assert!(summary.contains("Spread of effect between tests: I² ="), "{summary}");
    }
    // by maximum likelihood too: limits of a new trial are mean ± 1.96 √(τ² + se²), as metafor's
    let (record, summary) = fit(&folder, "plain.toml", "");
    let limits = &record["heterogeneity"]["prediction95"];
    near::absolute("lower", limits[0].as_f64().unwrap(), -1.8017, 5e-4);
    near::absolute("upper", limits[1].as_f64().unwrap(), 0.3793, 5e-4);
    assert!(summary.contains("The effect of a new test is between -1.80 and 0.38 with probability 95 %."), "{summary}");
    // with few tests they are those of `predict`
    let found = fit(&folder, "plain.toml", "--criterion reml").0["heterogeneity"].clone();
    let output = folder.run("predict plain.toml --from fit.json --design moderators.csv --out p.csv --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let row = &folder.table("p.csv")[0];
    let same = |column: &str, found: &Value| {
        near::absolute(column, found.as_f64().unwrap(), row[column].parse().unwrap(), 1e-6);
    };
    same("prediction_lower", &found["prediction95"][0]);
    same("prediction_upper", &found["prediction95"][1]);
    same("df", &found["prediction_df"]);
    // not where the spread is fixed
    folder.write(
        "fixed.toml",
        format!("{}\n[covariance]\nfixed = {{ \"effect, effect\" = 0 }}\n", without.join("\n")).as_bytes(),
    );
    assert_eq!(fit(&folder, "fixed.toml", "").0.get("heterogeneity"), None);
}

#[test]
fn a_forest_plot_has_every_trial_and_the_mean() {
    let folder = Folder::new(&[]);
    folder.copy("templates/moderators.toml");
    folder.copy("templates/moderators.csv");
    // a mean at latitude zero would mislead
    for (options, marks, words) in [("", 2 * 13, "depends on covariates"), ("--plain", 2 * 13 + 1, ">mean<")] {
        let text = std::fs::read_to_string(folder.path("moderators.toml")).unwrap();
        let kept = text
            .lines()
            .filter(|line| options.is_empty() || !(line.contains("latitude") || line.starts_with("[mean]")));
        folder.write("m.toml", kept.collect::<Vec<_>>().join("\n").as_bytes());
        fit(&folder, "m.toml", "");
        let output = folder.run("plot fit.json --what tests --out f.svg");
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        let figure = std::fs::read_to_string(folder.path("f.svg")).unwrap();
        assert_eq!(figure.matches("<circle").count(), marks, "{figure}");
        assert!(figure.contains(words) && !figure.contains("NaN"), "{figure}");
    }
}
