//! Reductions and estimates files wherever data stand.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use serde_json::Value;

use crate::folder::{Folder, shown};

/// Two phases: the first measures the level, the second inherits it and measures what it adds, one sensor less precise.
const TWO: &str = r#"[data]
test = "id"
phase = "part"

[phases.rest.states]
level = {}
[phases.rest.measurements.y]
column = "y"
equation = "level"
noise = "sigma"

[phases.move.states]
level = {}
rate = {}
[phases.move.carry]
level = "level"
[phases.move.measurements.y]
column = "y"
equation = "level + rate * x"
noise = 0.2

[parameters]
sigma = 0.1
"#;

/// The filter of the second phase neglects the rate.
const FILTER: &str = "
[phases.move.filter]
kind = \"kalman-schmidt\"
consider = [\"rate\"]
covariance = [[4, 0], [0, 1]]
";

/// Six tests; the last one ends with its first phase.
fn data() -> (String, String) {
    let (mut rest, mut moved) = (String::new(), String::new());
    for (k, id) in ["a", "b", "c", "d", "e", "f"].iter().enumerate() {
        let level = [1.0, -0.4, 0.3, 2.2, -1.3, 0.6][k];
        let rate = [0.2, 0.5, -0.1, 0.3, 0.9, 0.0][k];
        let added = [0.3, -0.2, 0.4, 0.1, -0.5, 0.0][k];
        for x in 0..3 {
            let wiggle = f64::from((x * 7 + k as i32 * 5) % 4) * 0.05;
            rest += &format!("{id},rest,{x},{}\n", level + wiggle);
        }
        for x in 0..if k == 5 { 0 } else { 4 } {
            let wiggle = f64::from((x * 3 + k as i32) % 5) * 0.07;
            moved += &format!("{id},move,{x},{}\n", level + added + rate * f64::from(x) + wiggle);
        }
    }
    (rest, moved)
}

const HEADER: &str = "id,part,x,y\n";

fn folder() -> Folder {
    let (rest, moved) = data();
    let file = |rows: &[&str]| (HEADER.to_owned() + &rows.concat()).into_bytes();
    Folder::new(&[
        ("two.toml", TWO.as_bytes()),
        ("filter.toml", (TWO.to_owned() + FILTER).as_bytes()),
        ("all.csv", &file(&[&rest, &moved])),
        ("rest.csv", &file(&[&rest])),
        ("move.csv", &file(&[&moved])),
    ])
}

/// Runs a command that must end well.
fn ends_well(folder: &Folder, args: &str) -> String {
    let output = folder.run(args);
    let text = shown(&output);
    assert!(output.status.success(), "{args}\n{text}");
    text
}

/// Results without what differs from run to run, or says where they are from.
fn results(folder: &Folder, name: &str) -> Value {
    let mut record: Value = serde_json::from_slice(&std::fs::read(folder.path(name)).unwrap()).unwrap();
    record["solver"]["seconds"] = Value::Null;
    record["data"]["files"] = Value::Null;
    record["model_digest"] = Value::Null;
    record["model"] = Value::Null;
    record["notes"] = Value::Null;
    // a model without `[filter]` has none to name, and without measurements there is nothing to say what it lost
    let phases = record["phases"].as_array_mut();
    phases.into_iter().flatten().for_each(|phase| phase["filter"] = Value::Null);
    record
}

fn fit(folder: &Folder, model: &str, data: &str, out: &str) -> Value {
    ends_well(folder, &format!("fit {model} {data} --out {out} --innovations off"));
    results(folder, out)
}

/// Every number of two records, side by side.
fn numbers<'v>(one: &'v Value, other: &'v Value, at: String, all: &mut Vec<(String, f64, f64)>) {
    match (one, other) {
        (Value::Array(one), Value::Array(other)) => {
            assert_eq!(one.len(), other.len(), "{at}");
            one.iter().zip(other).enumerate().for_each(|(k, (a, b))| numbers(a, b, format!("{at}[{k}]"), all));
        }
        (Value::Object(one), Value::Object(other)) => {
            assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>(), "{at}");
            one.iter().zip(other).for_each(|((key, a), (_, b))| numbers(a, b, format!("{at}.{key}"), all));
        }
        (Value::Number(a), Value::Number(b)) => all.push((at, a.as_f64().unwrap(), b.as_f64().unwrap())),
        _ => assert_eq!(one, other, "{at}"),
    }
}

fn same_bits(one: &Value, other: &Value) {
    let mut all = Vec::new();
    numbers(one, other, String::new(), &mut all);
    assert!(all.len() > 20, "{} numbers", all.len());
    for (at, a, b) in all {
        assert!(a.to_bits() == b.to_bits(), "{at}: {a:?} and {b:?}");
    }
}

#[test]
fn fitting_from_reductions_gives_the_bits_of_fitting_from_data() {
    let folder = folder();
    let said = ends_well(&folder, "reduce m.toml d.csv --out r.parquet");
    assert!(said.contains("Wrote r.parquet: 3 reductions of 3 tests"), "{said}");
    same_bits(&fit(&folder, "m.toml", "r.parquet", "r.json"), &fit(&folder, "m.toml", "d.csv", "d.json"));

    let said = ends_well(&folder, "reduce two.toml all.csv --out all.parquet");
    assert!(said.contains("Wrote all.parquet: 11 reductions of 6 tests"), "{said}");
    let expected = fit(&folder, "two.toml", "all.csv", "all.json");
    same_bits(&fit(&folder, "two.toml", "all.parquet", "r.json"), &expected);

    // and whoever has only one of the phases
    ends_well(&folder, "reduce two.toml rest.csv --out rest.parquet");
    ends_well(&folder, "reduce two.toml move.csv --out move.parquet");
    for given in ["rest.parquet move.parquet", "rest.parquet move.csv", "move.parquet rest.csv"] {
        same_bits(&fit(&folder, "two.toml", given, "r.json"), &expected);
    }
    // constraints may change, and files go into one
    ends_well(&folder, "reduce two.toml rest.parquet move.csv --out again.parquet");
    same_bits(&fit(&folder, "two.toml", "again.parquet", "r.json"), &expected);
    folder.write("zero.toml", (TWO.to_owned() + "[phases.move.mean]\nfixed = { level = 0 }\n").as_bytes());
    let zero = fit(&folder, "zero.toml", "again.parquet", "r.json");
    same_bits(&zero, &fit(&folder, "zero.toml", "all.csv", "zero.json"));
}

#[test]
fn fitting_from_estimates_gives_the_bits_of_filtering_the_data() {
    let folder = folder();
    let said = ends_well(&folder, "estimates filter.toml move.csv --out move.parquet");
    assert!(said.contains("Wrote move.parquet: 5 estimates of 5 tests"), "{said}");
    let expected = fit(&folder, "filter.toml", "all.csv", "all.json");
    assert_eq!(expected["log_likelihood_kind"], "estimates");
    same_bits(&fit(&folder, "filter.toml", "rest.csv move.parquet", "r.json"), &expected);
    // a model that knows nothing of the filter takes its estimates all the same
    same_bits(&fit(&folder, "two.toml", "rest.csv move.parquet", "r.json"), &expected);
    // and a reduction of them is as good
    ends_well(&folder, "reduce two.toml rest.csv move.parquet --out reduced.parquet");
    same_bits(&fit(&folder, "two.toml", "reduced.parquet", "r.json"), &expected);
}

#[test]
fn what_does_not_go_together_is_refused() {
    let folder = folder();
    ends_well(&folder, "reduce two.toml all.csv --out all.parquet");
    ends_well(&folder, "reduce two.toml move.csv --out move.parquet");
    ends_well(&folder, "reduce two.toml rest.csv --set sigma=0.11 --out other.parquet");
    let said = |args: &str| shown(&folder.run(args));
    insta::assert_snapshot!(said("fit two.toml all.parquet rest.csv"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: phase `rest` of test `a` is given twice: rest.csv, row 2 and all.parquet, row 1

    hint: leave one of them out: it would count twice
    ");
    insta::assert_snapshot!(said("fit two.toml move.parquet"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: move.parquet, row 1: found phase `move` of test `a`, expected phase `rest` too, which comes before it

    hint: a test may end early, but it must begin with the first phase
    ");
    insta::assert_snapshot!(said("fit two.toml move.parquet other.parquet"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: other.parquet was made with `sigma` = 0.11, expected 0.1 as in two.toml

    hint: filters ran at one value of each parameter: leave `--set` out, or run them again at the value you want
    ");
    insta::assert_snapshot!(said("fit two.toml all.parquet --set sigma=0.2"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: all.parquet was made with `sigma` = 0.1, expected 0.2 as in two.toml

    hint: filters ran at one value of each parameter: leave `--set` out, or run them again at the value you want
    ");
    insta::assert_snapshot!(said("estimates filter.toml all.csv --out e.parquet"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: all.csv, row 2: found rows of phase `rest`, which has no `[filter]`, expected rows of phases with one

    hint: leave these rows out, they may stand beside the estimates as they are; or use `kalfit reduce`, which takes any phase
    ");
    insta::assert_snapshot!(said("estimates filter.toml all.parquet --out e.parquet"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: all.parquet holds reductions of another model: found reduction digest sha256:e60b3a001ec48c5712948516680314b85c2e434244532a2dc5e729a886beb662, expected sha256:297448c6c5536f8e794dab69af17b284342e339608ed6a47d46e01704098f98a

    hint: reduce the data again with this model; only `[mean]`, `[covariance]` and labels may change after `kalfit reduce`
    ");
    insta::assert_snapshot!(said("reduce two.toml all.csv --out all.csv"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the output `all.csv` is no name of a Parquet file, expected one that ends in `.parquet`
    ");
    insta::assert_snapshot!(said("reduce two.toml all.parquet --out all.parquet"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the output `all.parquet` is one of the inputs

    hint: give the output a name of its own
    ");
    folder.write("other.toml", TWO.replace("rate * x", "2 * rate * x").as_bytes());
    let digests = said("fit other.toml all.parquet");
    assert!(digests.contains("reductions of another model: found reduction digest sha256:"), "{digests}");
    assert!(digests.matches("sha256:").count() == 2, "{digests}");
    assert!(!folder.path("e.parquet").exists(), "nothing is written");
}

#[test]
fn free_parameters_are_held_where_the_filters_ran() {
    let folder = folder();
    folder.write("free.toml", TWO.replace("sigma = 0.1", "sigma = { start = 0.1 }").as_bytes());
    let said = shown(&folder.run("reduce free.toml all.csv --out r.parquet"));
    assert!(said.contains("no value is given for parameter `sigma`"), "{said}");
    let free = fit(&folder, "free.toml", "all.csv", "free.json");
    let sigma = free["parameters"][0]["estimate"].as_f64().unwrap();
    ends_well(&folder, "reduce free.toml all.csv --at free.json --out r.parquet");
    let held = fit(&folder, "free.toml", "r.parquet", "held.json");
    let parameter = &held["parameters"][0];
    assert_eq!((parameter["estimate"].as_f64(), parameter["fixed"].as_bool()), (Some(sigma), Some(true)));
    let record: Value = serde_json::from_slice(&std::fs::read(folder.path("held.json")).unwrap()).unwrap();
    assert_eq!(record["notes"][0], "`sigma` is held at the value at which filters made `r.parquet`");
    let (held, free) = (held["log_likelihood"].as_f64().unwrap(), free["log_likelihood"].as_f64().unwrap());
    assert!((held - free).abs() < 1e-6, "at the optimum: {held} held, {free} free");
}

#[test]
fn standard_input_may_be_an_exchange_file() {
    let folder = folder();
    ends_well(&folder, "reduce two.toml all.csv --out r.parquet");
    let bytes = std::fs::read(folder.path("r.parquet")).unwrap();
    let output = folder.run_with_input("fit two.toml - --out r.json --innovations off", &bytes);
    assert!(output.status.success(), "{}", shown(&output));
    let csv = std::fs::read(folder.path("all.csv")).unwrap();
    let output = folder.run_with_input("fit two.toml - --out d.json --innovations off", &csv);
    assert!(output.status.success(), "{}", shown(&output));
    same_bits(&results(&folder, "r.json"), &results(&folder, "d.json"));
}

#[test]
fn other_commands_take_exchange_files_too() {
    let folder = folder();
    ends_well(&folder, "reduce two.toml all.csv --out r.parquet");
    folder.write("null.toml", b"[phases.move.mean]\nfixed = { rate = 0 }\n");
    for data in ["all.csv", "r.parquet"] {
        ends_well(&folder, &format!("test two.toml {data} --null null.toml --out {data}.json"));
    }
    let mut read = ["all.csv.json", "r.parquet.json"].map(|name| results(&folder, name));
    read.iter_mut().for_each(|record| record["files"] = Value::Null);
    same_bits(&read[0], &read[1]);
    let (rows, reduced) =
        (ends_well(&folder, "check two.toml all.csv"), ends_well(&folder, "check two.toml r.parquet"));
    assert!(rows.contains("6 tests") && reduced.contains("6 tests"), "{rows}{reduced}");
}

#[test]
fn scattered_rows_and_any_number_of_threads_write_the_same_rows() {
    let folder = folder();
    let (rest, moved) = data();
    // every second row first: tests come back after others began
    let mut rows: Vec<&str> = rest.lines().chain(moved.lines()).collect();
    rows.sort_by_key(|row| row.split(',').nth(2).unwrap().parse::<u32>().unwrap());
    folder.write("scattered.csv", (HEADER.to_owned() + &rows.join("\n") + "\n").as_bytes());
    ends_well(&folder, "reduce two.toml scattered.csv --out s.parquet --threads 1");
    let expected = fit(&folder, "two.toml", "all.csv", "all.json");
    same_bits(&fit(&folder, "two.toml", "s.parquet", "s.json"), &expected);
}

#[test]
fn without_the_single_tests_the_fit_is_the_same() {
    let folder = folder();
    ends_well(&folder, "reduce m.toml d.csv --out r.parquet");
    let mut expected = fit(&folder, "m.toml", "d.csv", "d.json");
    assert!(!expected["tests"].as_array().unwrap().is_empty());
    expected["tests"] = Value::Array(Vec::new());
    expected["model_check"] = serde_json::json!({ "verdict": "not checked", "findings": [], "remarks": [] });
    for data in ["d.csv", "r.parquet"] {
        ends_well(&folder, &format!("fit m.toml {data} --out n.json --report n.html --no-tests"));
        let text = std::fs::read_to_string(folder.path("n.json")).unwrap();
        assert!(text.contains("what each test says was not asked for"), "{text}");
        same_bits(&results(&folder, "n.json"), &expected);
    }
    let refused = shown(&folder.run("fit m.toml d.csv --no-tests --deletion all"));
    assert!(refused.contains("--no-tests") && refused.contains("--deletion"), "{refused}");
}

#[test]
fn a_test_that_two_reductions_files_have_is_refused_with_both_places() {
    let folder = folder();
    ends_well(&folder, "reduce m.toml d.csv --out r.parquet");
    std::fs::copy(folder.path("r.parquet"), folder.path("again.parquet")).unwrap();
    let output = folder.run("fit m.toml r.parquet again.parquet --out n.json");
    let text = shown(&output);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("r.parquet, row 1") && text.contains("again.parquet, row 1"), "{text}");
    assert!(!folder.path("n.json").exists(), "nothing is written");
}

/// `by_hand.parquet` is what the program in book/src/guide/exchange.md writes. Least squares loses nothing of what was measured.
#[test]
fn a_file_made_by_hand_says_what_the_measurements_say() {
    let model = "[data]\ntest = \"unit\"\n[states.bias]\n[states.drift]\n[measurements.z]\ncolumn = \"z\"\nequation = \"bias + k * drift\"\nnoise = 0.2\n[covariance]\nstructure = \"fixed\"\nmatrix = [[0.1, 0], [0, 0.01]]\n";
    let data = "unit,k,z\nA,0,1.2\nA,1,1.4\nA,2,1.3\nB,0,0.7\nB,1,0.6\nB,2,0.9\n";
    let folder = Folder::new(&[("hand.toml", model.as_bytes()), ("hand.csv", data.as_bytes())]);
    folder.copy("tests/data/by_hand.parquet");
    let estimates = fit(&folder, "hand.toml", "by_hand.parquet", "e.json");
    let rows = fit(&folder, "hand.toml", "hand.csv", "d.json");
    assert_eq!((&estimates["log_likelihood_kind"], &estimates["aic"]), (&"estimates".into(), &Value::Null));
    assert_eq!(estimates["data"]["observations"], rows["data"]["observations"]);
    let mut all = Vec::new();
    for key in ["mean", "covariance"] {
        numbers(&estimates["phases"][0][key], &rows["phases"][0][key], key.to_owned(), &mut all);
    }
    numbers(&estimates["tests"][1]["phases"], &rows["tests"][1]["phases"], "tests[1]".to_owned(), &mut all);
    assert!(all.len() > 10, "{} numbers", all.len());
    for (at, a, b) in all {
        assert!((a - b).abs() < 1e-11, "{at}: {a} from estimates, {b} from rows: off by {:.1e}", a - b);
    }
}
