//! Choices of inference: `--intervals`, `--std-errors`, `--deletion`.

use crate::folder::{DATA, Folder, MODEL, shown};
use crate::unidentified::number;
use insta::assert_snapshot;
use serde_json::Value;

/// Fits the vaccine trials; what was printed, and fit.json.
fn fit(options: &str) -> (String, Value) {
    let folder = Folder::new(&[]);
    folder.copy("tests/data/vaccine.toml");
    folder.copy("tests/data/vaccine.csv");
    let text = shown(&folder.run(&format!("fit vaccine.toml vaccine.csv --innovations off --out fit.json {options}")));
    let json = std::fs::read_to_string(folder.path("fit.json")).unwrap_or_else(|error| panic!("{error}\n{text}"));
    (text, serde_json::from_str(&json).expect("fit.json is JSON"))
}

/// The section of a summary under this heading.
fn section(text: &str, heading: &str) -> String {
    let from = text.find(heading).map_or("", |at| &text[at..]);
    from.split("\n\n").next().unwrap_or_default().to_owned() + "\n"
}

#[test]
fn profile_intervals_have_a_section_of_their_own() {
    let (text, found) = fit("--intervals profile");
    assert_snapshot!(section(&text, "95 % intervals"), @"
    95 % intervals by profile likelihood
                                   estimate     from       to
      mean of effect                   0.28    -0.24     0.71
      mean of effect per latitude   -0.0295  -0.0423  -0.0154
      std dev of effect                0.19     0.00     0.50
    ");
    assert_eq!(found["intervals"], "profile");
    let (text, found) = fit("--intervals wald");
    assert_eq!(section(&text, "95 % intervals"), "\n", "standard errors already say it");
    assert_eq!(found["intervals"], "wald");
}

/// At the end of a profile interval the likelihood-ratio test of that value has χ²(1) at its 95 % point.
#[test]
fn the_ends_of_a_profile_interval_are_where_the_test_begins_to_reject() {
    let (_, found) = fit("--intervals profile");
    let folder = Folder::new(&[]);
    folder.copy("tests/data/vaccine.toml");
    folder.copy("tests/data/vaccine.csv");
    let lr = |hypothesis: String| {
        folder.write("h.toml", hypothesis.as_bytes());
        let output = folder.run("test vaccine.toml vaccine.csv --null h.toml --out t.json --quiet");
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        let text = std::fs::read_to_string(folder.path("t.json")).expect("t.json is written");
        number(&serde_json::from_str::<Value>(&text).expect("t.json is JSON")["lr"])
    };
    let phase = &found["phases"][0];
    for end in [0, 1] {
        let mean = number(&phase["mean"]["interval95"][0][end]);
        let found = lr(format!("[mean]\nfixed = {{ effect = {mean:e} }}\n"));
        assert!((found - 3.841_458_820_694).abs() < 1e-5, "mean {mean}: lr {found}");
    }
    // a standard deviation may end at zero, which the test rejects or not; the other end is a value
    let variance = number(&phase["std_dev"]["interval95"][0][1]).powi(2);
    let found = lr(format!("[covariance]\nfixed = {{ 'effect, effect' = {variance:e} }}\n"));
    assert!((found - 3.841_458_820_694).abs() < 1e-5, "variance {variance}: lr {found}");
}

#[test]
fn standard_errors_say_what_they_are_made_of() {
    let errors = |kind: &str| {
        let (_, found) = fit(&format!("--std-errors {kind}"));
        assert_eq!(found["std_errors"], kind);
        let phase = &found["phases"][0];
        format!(
            "{kind}: mean {:.4}, regression {:.5}, variance {:.5}, std dev {:.4}\n",
            number(&phase["mean"]["std_error"][0]),
            number(&phase["mean"]["regression"][0]["std_error"]),
            number(&phase["covariance"]["std_error"][0][0]),
            number(&phase["std_dev"]["std_error"][0])
        )
    };
    assert_snapshot!(["observed", "expected", "sandwich"].map(errors).concat(), @"
    observed: mean 0.1910, regression 0.00550, variance 0.04050, std dev 0.1093
    expected: mean 0.1872, regression 0.00549, variance 0.02801, std dev 0.0756
    sandwich: mean 0.1609, regression 0.00457, variance 0.04125, std dev 0.1113
    ");
    let summary = |kind: &str| section(&fit(&format!("--std-errors {kind}")).0, "Initial state over the tests");
    assert_snapshot!(summary("expected"), @"
    Initial state over the tests (± expected standard error)
      state   mean         std dev
      effect  0.28 ± 0.19    0.185 ± 0.076
      With 13 tests, ± 1.96 standard errors hold the mean about 91 % of the time;
        --criterion reml allows for that.
      Spread of effect between tests: I² = 49.3 % of the variance of typical
        estimates, H² = 1.97. Cochran's Q = 30.73 with 11 degrees of freedom: p =
        0.001.
    ");
    assert_snapshot!(summary("sandwich"), @"
    Initial state over the tests (± sandwich standard error)
      state   mean         std dev
      effect  0.28 ± 0.16     0.19 ± 0.11
      With 13 tests, ± 1.96 standard errors hold the mean about 91 % of the time;
        --criterion reml allows for that.
      Spread of effect between tests: I² = 49.3 % of the variance of typical
        estimates, H² = 1.97. Cochran's Q = 30.73 with 11 degrees of freedom: p =
        0.001.
    ");
}

#[test]
fn tests_are_deleted_when_asked() {
    let (text, found) = fit("--deletion all");
    assert_snapshot!(section(&text, "Influence of single tests"), @"
    Influence of single tests
      test  displacement  p-value without it
      6             13.3                3e-5
      Leaving this test out moves the estimates outside the 50 % confidence region
        of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.
    ");
    let deletion = &found["tests"][5]["deletion"];
    let keys: Vec<&String> = deletion.as_object().expect("an object").keys().collect();
    assert_snapshot!(format!("{keys:?}"), @r#"["displacement", "distance", "log_density", "p_value", "phases"]"#);
    let (auto, default) = fit("");
    assert_eq!(found["tests"], default["tests"], "it takes less than a second here");
    assert_eq!(section(&text, "The answer without"), section(&auto, "The answer without"));
    let (text, found) = fit("--deletion none");
    assert_eq!(section(&text, "Influence of single tests"), "\n");
    let tests = found["tests"].as_array().expect("a list");
    assert!(tests.iter().all(|t| t["deletion"].is_null()), "{:?}", tests[0]);
}

/// The estimates without a test are those of a fit to the other tests.
#[test]
fn a_deleted_test_is_a_fit_without_it() {
    let (_, all) = fit("--deletion all");
    let folder = Folder::new(&[]);
    folder.copy("tests/data/vaccine.toml");
    folder.copy("tests/data/vaccine.csv");
    let data = std::fs::read_to_string(folder.path("vaccine.csv")).expect("the data are there");
    let rest: String = data.lines().filter(|line| !line.starts_with("6,")).map(|line| format!("{line}\n")).collect();
    folder.write("rest.csv", rest.as_bytes());
    let output = folder.run("fit vaccine.toml rest.csv --out rest.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let text = std::fs::read_to_string(folder.path("rest.json")).expect("rest.json is written");
    let rest: Value = serde_json::from_str(&text).expect("rest.json is JSON");
    let tests = all["tests"].as_array().expect("a list");
    let deleted = &tests.iter().find(|t| t["id"] == "6").expect("test 6 is there")["deletion"];
    let (deleted, rest) = (&deleted["phases"][0], &rest["phases"][0]);
    for (found, expected) in [
        (&deleted["mean"][0], &rest["mean"]["estimate"][0]),
        (&deleted["regression"][0], &rest["mean"]["regression"][0]["estimate"]),
        (&deleted["covariance"][0][0], &rest["covariance"]["estimate"][0][0]),
    ] {
        let (found, expected) = (number(found), number(expected));
        assert!((found - expected).abs() < 1e-6 * expected.abs().max(1e-3), "found {found}, expected {expected}");
    }
}

#[test]
fn choices_that_are_not_known_are_refused() {
    let refused = |options: &str| {
        let output = Folder::new(&[]).run(&format!("fit m.toml d.csv {options}"));
        assert_eq!(output.status.code(), Some(2), "{}", shown(&output));
        shown(&output)
    };
    assert_snapshot!(refused("--intervals jackknife"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: invalid value 'jackknife' for '--intervals <INTERVALS>'
      [possible values: auto, wald, profile, bootstrap]

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("--std-errors robust"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: invalid value 'robust' for '--std-errors <STD_ERRORS>'
      [possible values: observed, expected, sandwich]

    For more information, try '--help'.
    ");
    assert_snapshot!(refused("--deletion some"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: invalid value 'some' for '--deletion <DELETION>'
      [possible values: auto, all, none]

    For more information, try '--help'.
    ");
}

#[test]
fn errors_that_the_restricted_likelihood_does_not_have_are_refused() {
    let output = Folder::new(&[]).run("fit m.toml d.csv --criterion reml --std-errors sandwich");
    assert_snapshot!(shown(&output), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `--std-errors expected` and `--std-errors sandwich` go with `--criterion ml` only

    hint: leave `--std-errors` out: the restricted likelihood has those of its own curvature
    ");
}

#[test]
fn expected_standard_errors_beside_free_parameters_are_said_and_are_others_than_observed_ones() {
    let free = MODEL.replace("noise = 0.1", "noise = \"s\"") + "[parameters]\ns = {}\n";
    // of tests that are all alike the two are one
    let data = format!("{DATA}d,0,1.4\nd,1,1.8\n");
    let folder = Folder::new(&[("free.toml", free.as_bytes()), ("d.csv", data.as_bytes())]);
    let [expected, observed] = ["expected", "observed"].map(|how| {
        let output = folder.run(&format!("fit free.toml d.csv --std-errors {how} --out {how}.json"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        let text = std::fs::read(folder.path(&format!("{how}.json"))).unwrap();
        let record: kalfit::FitRecord = serde_json::from_slice(&text).unwrap();
        record.parameters[0].std_error.unwrap()
    });
    assert!((expected / observed - 1.0).abs() > 1e-2, "expected {expected}, observed {observed}");
}
