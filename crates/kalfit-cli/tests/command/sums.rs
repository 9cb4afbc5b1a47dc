//! Fits by sums: three places that exchange nothing else reach the fit of all their tests.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use serde_json::Value;

use crate::folder::{Folder, shown};

const SLEEP: &str = "../../examples/random-coefficients/sleepstudy";
const PLACES: [&str; 3] = ["north", "east", "south"];

/// The people of the sleep study dealt out to three places.
fn folder() -> Folder {
    let folder = Folder::new(&[]);
    ["toml", "csv"].iter().for_each(|end| folder.copy(&format!("{SLEEP}.{end}")));
    let text = std::fs::read_to_string(folder.path("sleepstudy.csv")).unwrap();
    let (header, rows) = text.split_once('\n').unwrap();
    let column = header.split(',').position(|name| name == "Subject").unwrap();
    let mut ids: Vec<&str> = rows.lines().map(|row| row.split(',').nth(column).unwrap()).collect();
    ids.dedup();
    for (k, place) in PLACES.iter().enumerate() {
        let is_here = |row: &&str| ids.iter().position(|id| row.split(',').nth(column) == Some(id)).unwrap() % 3 == k;
        let own: Vec<&str> = rows.lines().filter(is_here).collect();
        folder.write(&format!("{place}.csv"), format!("{header}\n{}\n", own.join("\n")).as_bytes());
    }
    folder
}

fn ends_well(folder: &Folder, args: &str) -> String {
    let output = folder.run(args);
    let text = shown(&output);
    assert!(output.status.success(), "{args}\n{text}");
    text
}

fn refused(folder: &Folder, args: &str) -> String {
    let output = folder.run(args);
    let text = shown(&output);
    assert_eq!(output.status.code(), Some(2), "{args}\n{text}");
    text
}

fn json(folder: &Folder, name: &str) -> Value {
    serde_json::from_str(&std::fs::read_to_string(folder.path(name)).unwrap()).unwrap()
}

/// The sums of all places for a round.
fn sums(folder: &Folder, at: &str, options: &str) {
    for place in PLACES {
        ends_well(folder, &format!("sums sleepstudy.toml {place}.csv {at} --out {place}.sums {options}"));
    }
}

/// Rounds until there is a fit; how many they were.
fn rounds(folder: &Folder, options: &str) -> usize {
    let mut at = String::new();
    for round in 1..100 {
        sums(folder, &at, options.split('|').next().unwrap());
        let join = options.split('|').nth(1).unwrap();
        ends_well(folder, &format!("join sleepstudy.toml north.sums east.sums south.sums --out theta.json {join}"));
        if folder.path("fit.json").exists() {
            return round;
        }
        at = "--at theta.json".to_owned();
    }
    panic!("no end after 100 rounds");
}

fn agree(folder: &Folder, pooled: &str) {
    let (found, expected) = (json(folder, "fit.json"), json(folder, pooled));
    let number = |record: &Value, at: &str| record.pointer(at).and_then(Value::as_f64).unwrap();
    let (a, b) = (number(&found, "/log_likelihood"), number(&expected, "/log_likelihood"));
    assert!((a - b).abs() <= 1e-10 * b.abs(), "{a} {b}");
    let parts = ["/phases/0/mean/", "/phases/0/std_dev/"];
    for (part, i) in parts.iter().flat_map(|part| [(part, 0), (part, 1)]) {
        let error = number(&expected, &format!("{part}std_error/{i}"));
        for (at, unit) in [(format!("{part}estimate/{i}"), error), (format!("{part}std_error/{i}"), error)] {
            let (a, b) = (number(&found, &at), number(&expected, &at));
            assert!((a - b).abs() <= 1e-6 * unit, "{at}: {a} {b}, standard error {unit}");
        }
    }
    assert_eq!(found["converged"], true);
    assert_eq!(found["data"]["tests"], 18);
    assert_eq!(found["tests"], Value::Array(Vec::new()));
}

#[test]
fn three_places_reach_the_fit_of_all_tests() {
    let folder = folder();
    ends_well(&folder, "fit sleepstudy.toml sleepstudy.csv --out pooled.json --quiet");
    let rounds = rounds(&folder, "--at-least 6|");
    assert!(rounds < 40, "{rounds} rounds");
    agree(&folder, "pooled.json");
    let told = std::fs::read_to_string(folder.path("north.sums")).unwrap();
    assert!(!told.contains("\"308\""), "ids stay where they are");
    ends_well(&folder, "report fit.json --out fit.html");
}

#[test]
fn with_known_parameters_by_either_criterion() {
    let folder = folder();
    for criterion in ["ml", "reml"] {
        let fit = format!("fit sleepstudy.toml sleepstudy.csv --set sigma=25 --criterion {criterion}");
        ends_well(&folder, &format!("{fit} --out pooled.json --quiet"));
        let options = format!("--set sigma=25|--set sigma=25 --criterion {criterion}");
        let rounds = rounds(&folder, &options);
        assert!(rounds < 20, "{rounds} rounds");
        agree(&folder, "pooled.json");
        std::fs::remove_file(folder.path("fit.json")).unwrap();
    }
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let folder = folder();
    let join = "join sleepstudy.toml north.sums east.sums south.sums --out theta.json";
    let text = refused(&folder, "sums sleepstudy.toml north.csv --out north.sums --at-least 7");
    assert!(text.contains("there are 6 tests, and sums of fewer than 7 are not told"), "{text}");
    assert!(!folder.path("north.sums").exists());
    sums(&folder, "", "");
    let text = ends_well(&folder, join);
    assert!(text.contains("Wrote theta.json: round 1 of 18 tests in 3 places does not end the search"), "{text}");
    // another round
    ends_well(&folder, "sums sleepstudy.toml north.csv --at theta.json --out north.sums");
    let text = refused(&folder, join);
    assert!(text.contains("`east.sums` has the sums of round 0, and `north.sums` those of round 1"), "{text}");
    // a place missing, and one given twice
    sums(&folder, "--at theta.json", "");
    let text = refused(&folder, "join sleepstudy.toml north.sums east.sums --out theta.json");
    assert!(text.contains("found 12 tests in 2 files, expected 18 in 3 as in the rounds before"), "{text}");
    let text = refused(&folder, "join sleepstudy.toml north.sums east.sums north.sums --out theta.json");
    assert!(text.contains("`north.sums` and `north.sums` hold the same sums"), "{text}");
    // another model, other values, another version
    let model = std::fs::read_to_string(folder.path("sleepstudy.toml")).unwrap();
    folder.write("other.toml", (model + "# another\n").as_bytes());
    let text = refused(&folder, "sums other.toml north.csv --at theta.json --out north.sums");
    assert!(text.contains("`theta.json` was made with another version of `other.toml`"), "{text}");
    let text = refused(&folder, "sums sleepstudy.toml north.csv --set sigma=30 --at theta.json --out north.sums");
    assert!(text.contains("`sigma` is free in one of `theta.json` and the model"), "{text}");
    let theta = std::fs::read_to_string(folder.path("theta.json")).unwrap();
    folder.write("old.json", theta.replace("\"kalfit_version\": \"", "\"kalfit_version\": \"0.0.").as_bytes());
    let text = refused(&folder, "sums sleepstudy.toml north.csv --at old.json --out north.sums");
    assert!(text.contains("`old.json` was made by kalfit 0.0."), "{text}");
    let text = refused(&folder, "sums sleepstudy.toml north.csv --at north.sums --out north.sums");
    assert!(text.contains("north.sums"), "{text}");
}

#[test]
fn a_model_with_levels_is_refused_in_words() {
    let folder = Folder::new(&[]);
    let model = std::fs::read_to_string(folder.path("m.toml")).unwrap();
    let levels = model.replace("test = \"id\"", "test = \"id\"\nlevels = [\"lot\"]");
    folder.write("levels.toml", levels.as_bytes());
    folder.write("lots.csv", b"id,lot,x,y\na,1,0,1.1\na,1,1,2.0\nb,1,0,0.4\nb,1,1,0.9\nc,2,0,2.0\nc,2,1,2.1\n");
    let text = refused(&folder, "sums levels.toml lots.csv --out here.sums");
    assert!(text.contains("the model has levels of groups, which a fit by sums does not support"), "{text}");
}
