//! `kalfit fit --report` and `kalfit report`.

use crate::folder::{DATA, Folder, MODEL, shown};
use insta::assert_snapshot;

const NULL: &str = "[mean]\nfixed = { level = 1, slope = 0.5 }\n";

/// A folder with a fit and its report, and a test of a hypothesis.
fn folder() -> Folder {
    let folder = Folder::new(&[("null.toml", NULL.as_bytes())]);
    let fitted = folder.run("fit m.toml d.csv --out fit.json --report fit.html --quiet");
    assert_eq!(fitted.status.code(), Some(0), "{}", shown(&fitted));
    let tested = folder.run("test m.toml d.csv --null null.toml --out test.json --quiet");
    assert_eq!(tested.status.code(), Some(0), "{}", shown(&tested));
    folder
}

fn read(folder: &Folder, name: &str) -> String {
    std::fs::read_to_string(folder.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

#[test]
fn the_report_of_results_alone_is_that_of_the_fit() {
    let folder = folder();
    assert_snapshot!(shown(&folder.run("report fit.json --out again.html")), @r"
    exit 0
    ----- stdout
    ----- stderr
    Wrote again.html
    ");
    let page = read(&folder, "fit.html");
    assert!(page == read(&folder, "again.html"), "the pages differ");
    assert!(page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>"), "it is a whole page");
    for part in ["measurement <code>y</code>", "Innovations of one test", "Population and tests", "level", "d.csv"] {
        assert!(page.contains(part), "the page lacks {part}");
    }
}

#[test]
fn a_tested_hypothesis_stands_beside_the_fit() {
    let folder = folder();
    let done = folder.run("report fit.json --test test.json --out compared.html --quiet");
    assert_eq!(shown(&done), "exit 0\n----- stdout\n----- stderr\n");
    let page = read(&folder, "compared.html");
    assert!(page.contains("Comparison with the a-priori model") && page.contains("null.toml"));
    assert!(!page.contains("another version of the model"), "it is the same model");
    assert!(!read(&folder, "fit.html").contains("Comparison with the a-priori model"));
}

/// Six units of forty rows, half a second apart.
const TIMED: &str = r#"
[data]
test = "unit"
time = "t"
time_unit = "s"
[states.bias]
unit = "deg/h"
[states.walk]
process = "random-walk"
noise_density = 0.3
initial = { mean = 0, sigma = 0 }
[measurements.rate]
column = "y"
equation = "bias + walk"
noise = "sigma"
[parameters]
sigma = { start = 0.3 }
"#;

fn timed() -> Folder {
    let mut text = "unit,t,y\n".to_owned();
    for j in 0..6 {
        let mut walk = f64::from((j * 23) % 31 - 15) / 8.0;
        for k in 0..40 {
            walk += f64::from((11 * j + 5 * k) % 23 - 11) / 50.0;
            let y = walk + f64::from((13 * j + 7 * k) % 19 - 9) / 18.0;
            text.push_str(&format!("u{j},{},{y}\n", 0.5 * f64::from(k)));
        }
    }
    let folder = Folder::new(&[("m.toml", TIMED.as_bytes()), ("d.csv", text.as_bytes())]);
    let fitted = folder.run("fit m.toml d.csv --out fit.json --report fit.html --quiet");
    assert_eq!(fitted.status.code(), Some(0), "{}", shown(&fitted));
    folder
}

/// The data of the charts of a page.
fn charts(page: &str) -> Vec<serde_json::Value> {
    let data = page.split("id=\"charts\">").nth(1).and_then(|rest| rest.split("</script>").next()).expect("charts");
    serde_json::from_str(data).expect("the data of the charts are JSON")
}

#[test]
fn records_over_time_are_on_the_page_that_is_made_with_the_data() {
    let folder = timed();
    let page = read(&folder, "fit.html");
    let charts = charts(&page);
    let of = |kind: &str| charts.iter().find(|chart| chart["kind"] == kind).unwrap_or_else(|| panic!("no {kind}"));
    let sheet = folder.run("datasheet m.toml d.csv --from fit.json --out sheet.json --quiet");
    assert!(sheet.status.success(), "{}", shown(&sheet));
    let sheet: serde_json::Value = serde_json::from_str(&read(&folder, "sheet.json")).unwrap();
    let (drawn, expected) = (&of("allan")["data"]["curves"][0], &sheet["allan"][0]);
    let points = expected["points"].as_array().unwrap();
    assert!(points.len() >= 4, "{points:?}");
    for (k, point) in points.iter().enumerate() {
        let found = &drawn["points"][k];
        for (name, expected) in [
            ("time", &point["time"]),
            ("model", &point["model"]),
            ("data", &point["data"]),
            ("low", &point["interval95"][0]),
            ("high", &point["interval95"][1]),
        ] {
            assert_eq!(&found[name], expected, "{name} of point {k}");
        }
    }
    let record = &of("record")["data"]["tests"];
    let fit: kalfit::FitRecord = serde_json::from_str(&read(&folder, "fit.json")).unwrap();
    let least = |test: &kalfit::record::TestRecord<'_>| {
        let own = test.innovations.as_ref().expect("it has innovations");
        let all = [test.p_value, own.nis_p_value, own.whiteness.as_ref().map(|w| w.p_value)];
        all.into_iter().flatten().fold(2.0, f64::min)
    };
    let first = fit.tests.iter().min_by(|a, b| least(a).total_cmp(&least(b))).unwrap();
    assert_eq!((record.as_array().unwrap().len(), record[0]["id"].as_str()), (6, Some(first.id)));
    assert_eq!(record[0]["measurements"][0]["measured"].as_array().unwrap().len(), 40);
    assert_eq!(record[0]["states"].as_array().unwrap().len(), 2);
    let alone = folder.run("report fit.json --out again.html --quiet");
    assert!(alone.status.success(), "{}", shown(&alone));
    let again = read(&folder, "again.html");
    assert!(page.contains("id=\"records\"") && !again.contains("id=\"records\""), "results alone hold no records");
}

#[test]
fn both_files_of_a_fit_are_named() {
    let folder = Folder::new(&[]);
    let said = shown(&folder.run("fit m.toml d.csv --out fit.json --report fit.html"));
    assert!(said.ends_with("Wrote fit.json\nWrote fit.html\n"), "{said}");
}

#[test]
fn series_of_innovations_are_bounded_whatever_the_data() {
    // one test of 3000 rows and 120 of three
    let mut rows = String::from("id,x,y\n");
    (0..3000).for_each(|k| rows.push_str(&format!("long,{},{}\n", k % 5, (k * 37) % 11)));
    (0..120).for_each(|j| rows.push_str(&DATA.replace("id,x,y\n", "").replace(['a', 'b', 'c'], &format!("t{j}"))));
    let folder = Folder::new(&[("m.toml", MODEL.as_bytes()), ("many.csv", rows.as_bytes())]);
    let fitted = folder.run("fit m.toml many.csv --out fit.json --report fit.html --quiet");
    assert!(matches!(fitted.status.code(), Some(0 | 1)), "{}", shown(&fitted));
    let record: kalfit::FitRecord = serde_json::from_str(&read(&folder, "fit.json")).unwrap();
    let kept: Vec<_> = record.tests.iter().filter_map(|t| t.innovations.as_ref()?.series.as_ref()).collect();
    assert_eq!(kept.len(), 100, "the least probable tests have their series");
    assert!(kept.iter().all(|s| s.at.len() <= 1000 && s.windows.len() <= 40), "none is long");
    let long = record.tests.iter().find(|t| t.id == "long").and_then(|t| t.innovations).unwrap();
    let series = long.series.as_ref().expect("its noise is far from the model's");
    assert!(series.at.is_empty() && series.windows.iter().map(|w| w.count).sum::<usize>() == long.count);
    let nis: f64 = series.windows.iter().map(|w| w.nis).sum();
    assert!((nis / long.nis.unwrap() - 1.0).abs() < 1e-12, "windows add up: {nis} {:?}", long.nis);
    assert_eq!(series.autocorrelation[0].lags.len(), 20);
}

/// Runs a command that must be refused and leave all as it was.
fn refused(args: &str, files: &[(&str, &str)]) -> String {
    let folder = folder();
    files.iter().for_each(|(name, text)| folder.write(name, text.as_bytes()));
    let before = folder.contents();
    let output = folder.run(args);
    let said = shown(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert_eq!(before, folder.contents(), "`kalfit {args}` left the folder as it was");
    String::from_utf8(output.stderr).expect("messages are UTF-8")
}

#[test]
fn what_is_no_result_is_refused() {
    assert_snapshot!(refused("report no.json --out new.html", &[]), @"error: cannot read `no.json`: No such file or directory (os error 2)");
    assert_snapshot!(refused("report d.csv --out new.html", &[]), @"
    error: `d.csv` is not a result of `kalfit fit`: it is not JSON (expected value at line 1 column 1)

    hint: give a file that `kalfit fit --out` wrote
    ");
    assert_snapshot!(refused("report half.json --out new.html", &[("half.json", r#"{"schema": "kalfit-fit/1"}"#)]), @"
    error: `half.json` is not a result of `kalfit fit`: missing field `kalfit_version` at line 1 column 26

    hint: give a file that `kalfit fit --out` wrote
    ");
    assert_snapshot!(refused("report test.json --out new.html", &[]), @"
    error: `test.json`: the schema is `kalfit-test/1`, expected `kalfit-fit/1`

    hint: give a file that `kalfit fit --out` wrote
    ");
    assert_snapshot!(refused("report fit.json --test fit.json --out new.html", &[]), @"
    error: `fit.json`: the schema is `kalfit-fit/1`, expected `kalfit-test/1`

    hint: `--test` takes what `kalfit test --out` writes
    ");
    assert_snapshot!(refused("report fit.json --out fit.json", &[]), @"
    error: the output `fit.json` is one of the inputs

    hint: give the output a name of its own
    ");
    assert_snapshot!(refused("fit m.toml d.csv --out x --report x", &[]), @"
    error: both outputs are `x`, expected two files

    hint: give the output a name of its own
    ");
    assert_snapshot!(refused("fit m.toml d.csv --report no/such/folder.html", &[]), @"
    error: the folder `no/such` for the output does not exist

    hint: name a folder that exists
    ");
}

#[test]
fn broken_results_never_panic() {
    let folder = folder();
    let whole = read(&folder, "fit.json");
    // numbers and lists all over the record, replaced in turn
    let value: serde_json::Value = serde_json::from_str(&whole).unwrap();
    let mut broken: Vec<String> = [0, 1, 7, whole.len() / 2, whole.len() - 3].map(|n| whole[..n].to_owned()).to_vec();
    let places = pointers(&value);
    for pointer in places.iter().step_by(places.len() / 30 + 1) {
        for other in [serde_json::json!(1e308), serde_json::json!(0), serde_json::json!([]), serde_json::json!(null)] {
            let mut changed = value.clone();
            *changed.pointer_mut(pointer).unwrap() = other;
            broken.push(changed.to_string());
        }
    }
    for text in &broken {
        folder.write("broken.json", text.as_bytes());
        let output = folder.run("report broken.json --out broken.html --quiet");
        assert!(matches!(output.status.code(), Some(0 | 2)), "{}\n{text}", shown(&output));
    }
}

/// Where every number and list of numbers stands.
fn pointers(value: &serde_json::Value) -> Vec<String> {
    let mut all = Vec::new();
    let mut next = vec![(String::new(), value)];
    while let Some((at, value)) = next.pop() {
        match value {
            serde_json::Value::Array(items) => {
                all.push(at.clone());
                next.extend(items.iter().enumerate().map(|(i, item)| (format!("{at}/{i}"), item)));
            }
            serde_json::Value::Object(items) => {
                next.extend(items.iter().map(|(key, item)| (format!("{at}/{key}"), item)));
            }
            serde_json::Value::Number(_) => all.push(at),
            _ => {}
        }
    }
    all
}
