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
    by_either_criterion(&folder());
}

/// What a test measures without noise informs the mean where there is no spread, which is where sums are asked what they inform.
#[test]
fn with_values_that_are_measured_without_noise() {
    let folder = folder();
    let text = std::fs::read_to_string(folder.path("sleepstudy.toml")).unwrap();
    let exact = text.replace("noise = \"sigma\"", "noise = \"if(Days == 0, 0, sigma)\"");
    assert!(exact != text);
    folder.write("sleepstudy.toml", exact.as_bytes());
    by_either_criterion(&folder);
}

fn by_either_criterion(folder: &Folder) {
    for criterion in ["ml", "reml"] {
        let fit = format!("fit sleepstudy.toml sleepstudy.csv --set sigma=25 --criterion {criterion}");
        ends_well(folder, &format!("{fit} --out pooled.json --quiet"));
        let options = format!("--set sigma=25|--set sigma=25 --criterion {criterion}");
        let rounds = rounds(folder, &options);
        assert!(rounds < 20, "{rounds} rounds");
        agree(folder, "pooled.json");
        std::fs::remove_file(folder.path("fit.json")).unwrap();
    }
}

/// Answers that no tests give, of a place that says nothing else that is wrong.
#[test]
fn sums_that_cannot_come_from_tests_are_refused_with_the_place() {
    let folder = folder();
    for place in PLACES {
        ends_well(&folder, &format!("sums sleepstudy.toml {place}.csv --set sigma=25 --out {place}.sums"));
    }
    let honest = json(&folder, "east.sums");
    let join = "join sleepstudy.toml north.sums east.sums south.sums --set sigma=25 --out theta.json";
    let states = 2;
    let (counts, information) = (0, 5 + 1);
    let informed = information + states * (states + 1) / 2;
    for (at, value, why) in [
        (counts, 1e18, "the number of tests in the sums is not that of the file"),
        (counts, -6.0, "the number of tests in the sums is not that of the file"),
        (counts, 5.5, "the number of tests in the sums is not that of the file"),
        (counts + 1, 1e17, "a number of rows or measurements is no whole number"),
        (counts + 2, 60.5, "a number of rows or measurements is no whole number"),
        (information, -1.0, "the information on the states is not positive semidefinite"),
        (information + 1, 1e9, "the information on the states is not positive semidefinite"),
        (informed, 7.0, "a number of tests is not among those of the tests"),
        (informed, 0.0, "there is information on a state that no test informs"),
    ] {
        let mut told = honest.clone();
        told["answers"][0][at] = value.into();
        folder.write("east.sums", told.to_string().as_bytes());
        let text = refused(&folder, join);
        assert!(
            text.contains(&format!("the sums of `east.sums` cannot come from tests: {why}")),
            "{at} {value}: {text}"
        );
        assert!(!folder.path("theta.json").exists());
    }
    folder.write("east.sums", honest.to_string().as_bytes());
    ends_well(&folder, join);
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
    assert!(text.contains("`east.sums` has the sums of round 1, and `north.sums` those of round 2"), "{text}");
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

const LOTS: &str = r#"
title = "Lots"

[data]
test = "unit"
levels = ["lot"]

[states]
level = {}
slope = {}

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = "sigma"

[parameters]
sigma = {}
"#;

/// 36 units in 12 lots, each lot in one of three places; units of different lots have the same names. The model has the name of the other.
fn lots() -> Folder {
    let folder = Folder::new(&[]);
    folder.write("sleepstudy.toml", LOTS.as_bytes());
    let wave = |seed: usize| (seed as f64 * 12.9898).sin() * 1.4;
    let header = "lot,unit,x,y\n";
    let mut places = [header, header, header].map(str::to_owned);
    for lot in 0..12 {
        for unit in 0..3 {
            let of = |state: usize| wave(lot * 17 + state) + 0.5 * wave(lot * 31 + unit * 7 + state + 3);
            for x in 0..6 {
                let y = 2.0 + of(0) + (0.5 + of(1)) * x as f64 + 0.2 * wave(lot * 101 + unit * 13 + x + 5);
                places[lot % 3].push_str(&format!("L{lot:02},u{unit},{x},{y}\n"));
            }
        }
    }
    let all: Vec<&str> = places.iter().map(|rows| rows.strip_prefix(header).unwrap()).collect();
    folder.write("all.csv", format!("{header}{}", all.concat()).as_bytes());
    PLACES.iter().zip(&places).for_each(|(place, rows)| folder.write(&format!("{place}.csv"), rows.as_bytes()));
    folder
}

#[test]
fn three_places_reach_the_fit_of_units_in_lots() {
    let folder = lots();
    ends_well(&folder, "fit sleepstudy.toml all.csv --out pooled.json --quiet");
    let rounds = rounds(&folder, "|");
    assert!(rounds < 40, "{rounds} rounds");
    let (found, expected) = (json(&folder, "fit.json"), json(&folder, "pooled.json"));
    let number = |record: &Value, at: &str| record.pointer(at).and_then(Value::as_f64).unwrap();
    let (a, b) = (number(&found, "/log_likelihood"), number(&expected, "/log_likelihood"));
    assert!((a - b).abs() <= 1e-10 * b.abs(), "{a} {b}");
    for at in ["/levels/0/groups", "/levels/1/groups", "/phases/0/tests", "/data/tests", "/free_parameters"] {
        assert_eq!(found.pointer(at), expected.pointer(at), "{at}");
    }
    for (level, i) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let part = format!("/levels/{level}/std_dev/");
        let error = number(&expected, &format!("{part}std_error/{i}"));
        for at in [format!("{part}estimate/{i}"), format!("{part}std_error/{i}")] {
            let (a, b) = (number(&found, &at), number(&expected, &at));
            assert!((a - b).abs() <= 1e-5 * error, "{at}: {a} {b}, standard error {error}");
        }
    }
    assert_eq!(found["converged"], true);
    let told = std::fs::read_to_string(folder.path("north.sums")).unwrap();
    assert!(!told.contains("L00"), "names of groups stay where they are");
    ends_well(&folder, "report fit.json --out fit.html");
}

#[test]
fn a_group_in_two_places_is_refused() {
    let folder = lots();
    let south = std::fs::read_to_string(folder.path("south.csv")).unwrap();
    folder.write("south.csv", format!("{south}L00,u9,0,1.5\nL00,u9,1,2.5\n").as_bytes());
    sums(&folder, "", "");
    let text = refused(&folder, "join sleepstudy.toml north.sums east.sums south.sums --out theta.json");
    let expected = "`south.sums` and `north.sums` both have tests of 1 of the groups of `lot`, expected all tests of a group in one place";
    assert!(text.contains(expected), "{text}");
    assert!(text.contains("move each of these groups to one place"), "{text}");
}
