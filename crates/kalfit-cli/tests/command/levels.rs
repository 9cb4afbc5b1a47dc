//! Tests of one unit: fits, hypotheses, draws and plans of models with levels.

use crate::folder::{Folder, shown};
use insta::assert_snapshot;
use kalfit::FitRecord;
use kalfit::record::{PlanRecord, RatioRecord};

fn oxide() -> Folder {
    let folder = Folder::new(&[]);
    folder.copy("tests/reference/lmm-nested/oxide.toml");
    folder.copy("tests/reference/lmm-nested/oxide.csv");
    folder
}

fn text(folder: &Folder, name: &str) -> String {
    std::fs::read_to_string(folder.path(name)).expect("it was written")
}

fn fit(folder: &Folder, name: &str) -> FitRecord {
    serde_json::from_str(&text(folder, name)).expect("a record of a fit")
}

#[test]
fn a_fit_of_tests_of_one_unit() {
    let folder = oxide();
    let output = folder.run("fit oxide.toml oxide.csv --out fit.json --quiet");
    assert_eq!(output.status.code(), Some(0));
    let record = fit(&folder, "fit.json");
    assert!(record.converged);
    let names: Vec<(&str, Option<&str>, usize)> =
        record.levels.iter().map(|level| (level.name.as_str(), level.column.as_deref(), level.groups)).collect();
    assert_eq!(names, [("Lot", Some("Lot"), 8), ("tests", None, 24)]);
    assert_eq!(record.levels[1].covariance, record.phases[0].covariance);
    assert_eq!((record.groups.len(), record.tests.len(), record.tests.get(0).groups.len()), (8, 24, 1));
    let all: f64 = record.groups.iter().map(|group| group.log_likelihood).sum();
    assert!((all - record.log_likelihood).abs() < 1e-9, "{all} {}", record.log_likelihood);
    // the fit without a lot is that of the others
    let left_out = record.groups.iter().find(|group| group.id == ["6"]).expect("there is such a lot");
    let without = left_out.deletion.as_ref().expect("it has an optimum");
    let others: String = text(&folder, "oxide.csv")
        .lines()
        .filter(|line| !line.starts_with("6,"))
        .fold(String::new(), |sum, line| sum + line + "\n");
    std::fs::write(folder.path("others.csv"), others).expect("a file");
    let sigma = record.parameters[0].estimate;
    let again = folder.run(&format!("fit oxide.toml others.csv --set sigma={sigma} --out others.json --quiet"));
    assert_eq!(again.status.code(), Some(0));
    let others = fit(&folder, "others.json");
    let found = [without.phases[0].mean[0], without.phases[0].covariance[0][0], without.phases[1].covariance[0][0]];
    let expected = [
        others.phases[0].mean.estimate[0],
        others.phases[0].covariance.estimate[0][0],
        others.levels[0].covariance.estimate[0][0],
    ];
    for (found, expected) in found.into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-6 * expected.abs(), "{found} {expected}");
    }
}

/// The summary from one heading to another.
fn between(summary: &str, from: &str, to: &str) -> String {
    let (start, end) = (summary.find(from).expect("it begins"), summary.find(to).expect("it ends"));
    summary[start..end].to_owned()
}

#[test]
fn the_summary_says_how_much_is_from_unit_to_unit() {
    let folder = oxide();
    let summary = shown(&folder.run("fit oxide.toml oxide.csv"));
    assert_snapshot!(between(&summary, "Initial state", "Dynamic parameters"), @r#"
    Initial state: mean, and standard deviation at each level (± standard error)
      state              mean  Lot to Lot  within one Lot
      thickness  2000.2 ± 4.0  10.6 ± 3.0       6.0 ± 1.2
      With 8 groups of Lot, ± 1.96 standard errors hold the mean about 88 % of the
        time; --criterion reml allows for that.

    Spread by level (share: part of the variance of the states)
      state      spread          number  std dev        95 % interval   share
      thickness  Lot to Lot           8     10.6 ± 3.0  6.1 to 18.3    75.7 %
                 within one Lot      24      6.0 ± 1.2  4.1 to 8.8     24.3 %

    Outlying groups
      No group is an outlier: the smallest of 8 p-values is 0.06 (Lot 6), or 0.45
        after Bonferroni correction.
    "#);
    let profiled = shown(&folder.run("fit oxide.toml oxide.csv --intervals profile"));
    assert_snapshot!(between(&profiled, "95 % intervals by profile", "Outlying groups"), @"
    95 % intervals by profile likelihood
                            spread          estimate    from      to
      mean of thickness                       2000.2  1991.4  2008.9
      std dev of thickness  within one Lot       6.0     4.1     9.1
      std dev of thickness  Lot to Lot          10.6     6.3    19.8

    Spread by level (share: part of the variance of the states)
      state      spread          number  std dev        95 % interval   share
      thickness  Lot to Lot           8     10.6 ± 3.0  6.3 to 19.8    75.7 %
                 within one Lot      24      6.0 ± 1.2  4.1 to 9.1     24.3 %
    ");
}

#[test]
fn reductions_hold_the_groups_of_tests() {
    let folder = oxide();
    let reduced = folder.run("reduce oxide.toml oxide.csv --set sigma=3.5 --out reductions.parquet --quiet");
    assert_eq!(reduced.status.code(), Some(0), "{}", shown(&reduced));
    let known = "fit oxide.toml oxide.csv --set sigma=3.5 --innovations off --out rows.json --quiet";
    assert_eq!(folder.run(known).status.code(), Some(0));
    assert_eq!(folder.run("fit oxide.toml reductions.parquet --out fit.json --quiet").status.code(), Some(0));
    let (rows, found) = (fit(&folder, "rows.json"), fit(&folder, "fit.json"));
    assert_eq!((found.log_likelihood, &found.levels), (rows.log_likelihood, &rows.levels));
    assert_eq!((&found.groups, found.tests.get(0).groups), (&rows.groups, rows.tests.get(0).groups));
    // half of the lots here, half of them there
    let text = text(&folder, "oxide.csv");
    let (first, rest): (Vec<&str>, Vec<&str>) = text.lines().skip(1).partition(|line| line < &"5");
    for (name, lines) in [("first.csv", first), ("rest.csv", rest)] {
        let header = text.lines().next().expect("a header");
        std::fs::write(folder.path(name), format!("{header}\n{}\n", lines.join("\n"))).expect("a file");
    }
    let reduced = folder.run("reduce oxide.toml first.csv --set sigma=3.5 --out first.parquet --quiet");
    assert_eq!(reduced.status.code(), Some(0), "{}", shown(&reduced));
    assert_eq!(folder.run("fit oxide.toml first.parquet rest.csv --out both.json --quiet").status.code(), Some(0));
    let both = fit(&folder, "both.json");
    let gap = (both.log_likelihood - rows.log_likelihood).abs();
    assert!(gap < 1e-9 && both.groups.len() == 8, "{} {}", both.log_likelihood, rows.log_likelihood);
}

#[test]
fn estimates_of_a_model_with_levels_are_refused_before_all_else() {
    assert_snapshot!(shown(&oxide().run("estimates oxide.toml oxide.csv --out estimates.parquet")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot write `estimates.parquet`: the model has levels of groups, and files of estimates do not say the groups of tests
    ");
}

#[test]
fn check_counts_the_groups_of_each_level() {
    let output = oxide().run("check oxide.toml oxide.csv");
    let said = shown(&output);
    assert!(said.contains("Level `Lot`: 8 groups of 3 tests."), "{said}");
}

#[test]
fn one_test_of_each_unit_tells_no_levels_apart() {
    let folder = oxide();
    let first: Vec<String> = text(&folder, "oxide.csv")
        .lines()
        .filter(|line| line.starts_with("Lot") || line.split(',').nth(1) == Some("1"))
        .map(str::to_owned)
        .collect();
    std::fs::write(folder.path("first.csv"), first.join("\n") + "\n").expect("a file");
    assert_eq!(folder.run("fit oxide.toml first.csv --out fit.json --quiet").status.code(), Some(0));
    let record = fit(&folder, "fit.json");
    for level in &record.levels {
        assert!(!level.unidentified.is_empty(), "{}", level.name);
        assert_eq!(level.covariance.std_error[0][0], None, "{}", level.name);
    }
    assert!(record.notes.iter().any(|note| note.contains("var(Lot.thickness)")), "{:?}", record.notes);
}

#[test]
fn whether_anything_varies_from_unit_to_unit_is_a_hypothesis() {
    let folder = oxide();
    std::fs::write(folder.path("same.toml"), "[levels.Lot.covariance]\nstates = []\n").expect("a file");
    let output = folder.run("test oxide.toml oxide.csv --null same.toml --out test.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let record: RatioRecord = serde_json::from_str(&text(&folder, "test.json")).expect("a record");
    let without = folder.run("fit oxide.toml oxide.csv --out fit.json --quiet");
    assert_eq!(without.status.code(), Some(0));
    let gap = 2.0 * (fit(&folder, "fit.json").log_likelihood - record.null.log_likelihood);
    assert!((record.lr - gap).abs() < 1e-6, "{} {gap}", record.lr);
    assert_eq!(record.mixture.as_deref(), Some("0.5 chi2_0; 0.5 chi2_1"));
    let few = |note: &String| note.starts_with("with 8 groups of level `Lot` the large-sample");
    assert!(record.notes.iter().any(few), "{:?}", record.notes);
}

#[test]
fn drawn_units_are_fitted_again() {
    let folder = oxide();
    assert_eq!(folder.run("fit oxide.toml oxide.csv --out fit.json --quiet").status.code(), Some(0));
    let draw = "simulate oxide.toml --from fit.json --design oxide.csv --seed 7 --out drawn.csv --quiet";
    assert_eq!(folder.run(draw).status.code(), Some(0));
    assert_eq!(folder.run("fit oxide.toml drawn.csv --out again.json --quiet").status.code(), Some(0));
    let (first, again) = (fit(&folder, "fit.json"), fit(&folder, "again.json"));
    let ids = |record: &FitRecord| record.tests.iter().map(|test| test.id.to_owned()).collect::<Vec<_>>();
    assert_eq!(ids(&first), ids(&again));
    // lots differ by 10.6, wafers of a lot by 6
    assert!(again.levels[0].std_dev.estimate[0] > 3.0 && again.levels[0].std_dev.estimate[0] < 25.0);
    let more = folder.run("simulate oxide.toml --from fit.json --design oxide.csv --seed 7 --tests 100 --out more.csv");
    assert_snapshot!(shown(&more), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: found 100 tests to draw, expected at most the 24 of the design: the model has levels of groups

    hint: give a design with as many groups and tests as are wanted: new groups need names of their own
    "#);
}

#[test]
fn more_units_or_more_runs_are_planned() {
    let folder = oxide();
    assert_eq!(folder.run("fit oxide.toml oxide.csv --out fit.json --quiet").status.code(), Some(0));
    let plan = "plan oxide.toml --from fit.json --design oxide.csv --groups Lot=8,16 --tests 1,3 --out plan.json";
    assert_snapshot!(shown(&folder.run(plan)), @"
    exit 0
    ----- stdout
    Thickness of oxide: wafers of lots

    Design: 24 tests, 72 steps, 72 observations from oxide.csv.
    Population: fit.json.
    Column 8 × 1: 8 groups of `Lot`, 1 test in each.

    Expected standard errors of the means
      state       value  8 × 1  8 × 3  16 × 1  16 × 3
      thickness  2000.2    4.4    4.0     3.1     2.8

    Expected standard errors of the standard deviations
      state          value  8 × 1  8 × 3  16 × 1  16 × 3
      thickness       5.99      -    1.2       -    0.84
      Lot.thickness   10.6      -    3.0       -     2.1

    How to read this
      Standard errors come from the expected information at these values; groups and
        tests are like those of the design, one after the other. With few tests,
        estimates scatter more than this, and those of standard deviations are
        skewed.
      A dash: not identified by so few groups and tests.
      sigma is free in the model but is taken as known here, at its value in
        fit.json; if it were estimated too, standard errors would be larger.
    ----- stderr
    Wrote plan.json
    ");
    let record: PlanRecord = serde_json::from_str(&text(&folder, "plan.json")).expect("a record");
    assert_eq!(record.tests, [8, 24, 16, 48]);
    // balanced: the variance of the mean is (Σ_B + (Σ_W + σ²/3)/3)/8
    let fit = fit(&folder, "fit.json");
    let [between, within, sigma] =
        [fit.levels[0].covariance.estimate[0][0], fit.levels[1].covariance.estimate[0][0], fit.parameters[0].estimate];
    let expected = ((between + (within + sigma * sigma / 3.0) / 3.0) / 8.0).sqrt();
    let found = record.quantities[0].std_error[1].expect("it is identified");
    assert!((found - expected).abs() < 1e-9 * expected, "{found} {expected}");
    for (groups, message) in [
        ("", "how many groups of level `Lot` is not said"),
        ("--groups Wafer=3 --groups Lot=2", "found groups of `Wafer`, expected those of `Lot`"),
        ("--groups Lot=0", "0"),
        ("--groups Lot=8 --groups Lot=4", "numbers of groups of level `Lot` are given more than once"),
    ] {
        let output = folder.run(&format!("plan oxide.toml --from fit.json --design oxide.csv {groups} --tests 3"));
        let said = shown(&output);
        assert!(output.status.code() == Some(2) && said.contains(message), "{groups}: {said}");
    }
}

#[test]
fn expected_standard_errors_of_a_balanced_design_are_observed_ones() {
    // its sums of squares say all of the variances: one law of them for each level
    let folder = oxide();
    let [expected, observed] = ["expected", "observed"].map(|how| {
        let output = folder.run(&format!("fit oxide.toml oxide.csv --std-errors {how} --out {how}.json"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        let of = |record: &kalfit::FitRecord| [record.parameters[0].std_error, record.levels[0].std_dev.std_error[0]];
        of(&fit(&folder, &format!("{how}.json"))).map(|error| error.expect("it is identified"))
    });
    for (expected, observed) in expected.into_iter().zip(observed) {
        assert!((expected / observed - 1.0).abs() < 1e-5, "expected {expected}, observed {observed}");
    }
}

/// A run widens the spread that it is judged by, and in units of two runs each differs from the other alone.
#[test]
fn a_run_that_is_far_from_the_other_run_of_its_unit_is_named() {
    let scatter = |k: u32| f64::from((k.wrapping_mul(2_654_435_761) >> 8) % 2001) / 1000.0 - 1.0;
    let mut text = "run,unit,y\n".to_owned();
    for unit in 0..12 {
        for run in 0..2 {
            let shift = if (unit, run) == (4, 1) { 1.2 } else { 0.0 };
            let level = 3.0 * scatter(unit + 1) + 0.17 * scatter(100 + 2 * unit + run) + shift;
            for row in 0..4 {
                text.push_str(&format!(
                    "r{run},u{unit:02},{}\n",
                    level + 0.05 * scatter(1000 + 8 * unit + 4 * run + row)
                ));
            }
        }
    }
    let model = "[data]\ntest = \"run\"\nlevels = [\"unit\"]\n[states.level]\n[measurements.y]\ncolumn = \"y\"\nequation = \"level\"\nnoise = \"sigma\"\n[parameters]\nsigma = {}\n";
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", text.as_bytes())]);
    let said = shown(&folder.run("fit m.toml d.csv")).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(said.contains("Model check doubtful"), "{said}");
    assert!(said.contains("is unlike the other tests of its groups") && said.contains("u04/r"), "{said}");
}
