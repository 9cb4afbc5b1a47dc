//! What rows show of themselves is said before any result, and nothing is said of sound rows.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit_fixtures::near;
use serde_json::Value;

use crate::folder::{DATA, Folder, MODEL, shown};

/// The notes of a fit that `check` has, too, since they need no fit; and fit.json.
fn notes(model: &str, data: &str) -> (Vec<String>, Value) {
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
    let said = shown(&folder.run("fit m.toml d.csv --out fit.json"));
    let text = std::fs::read_to_string(folder.path("fit.json")).unwrap_or_else(|_| panic!("{said}"));
    let found: Value = serde_json::from_str(&text).unwrap();
    let flat = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ").replace('`', "");
    let checked = flat(&shown(&folder.run("check m.toml d.csv")));
    let is_checked = |note: &String| checked.contains(&flat(note).chars().skip(1).take(60).collect::<String>());
    let notes = found["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap().to_owned());
    (notes.filter(is_checked).collect(), found)
}

fn only(notes: &[String]) -> &str {
    assert_eq!(notes.len(), 1, "{notes:#?}");
    &notes[0]
}

fn file(name: &str) -> String {
    std::fs::read_to_string(format!("{}/tests/data/{name}", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

/// Numbers between -1 and 1 that look random.
fn wave(j: u32, k: u32) -> f64 {
    (f64::from(j) * 2.7 + f64::from(k) * 11.3 + 0.2).cos()
}

#[test]
fn sound_rows_have_no_notes() {
    let (found, _) = notes(MODEL, DATA);
    assert!(found.is_empty(), "{found:#?}");
}

/// A rate table that goes further than the gyros.
#[test]
fn values_that_pile_up_at_their_ends() {
    let model = "[data]\ntest = \"unit\"\n[states.bias]\n[states.scale]\nunit = \"ppm\"\n[measurements.gyro]\ncolumn = \"gyro\"\n\
                 equation = \"bias + (1 + 1e-6 * scale) * rate_in\"\nnoise = \"sigma\"\n[parameters]\nsigma = {}\n";
    let (found, _) = notes(model, &file("clipped.csv"));
    assert!(
        found.iter().any(|note| note.starts_with("20 of 90 values in column `gyro` are exactly -250 or 250")
            && note.contains("`abs(gyro) < 250` as `where`")),
        "{found:#?}"
    );
    let cured = model.replace("equation", "where = \"abs(gyro) < 250\"\nequation");
    let (found, fit) = notes(&cured, &file("clipped.csv"));
    assert!(found.iter().all(|note| !note.contains("exactly")), "{found:#?}");
    near::mixed("scale", fit["phases"][0]["mean"]["estimate"][1].as_f64().unwrap(), 2287.0, 1e-3);
}

/// Accelerometers at rest: whole steps of a converter, three of eight constant.
#[test]
fn values_on_steps_and_constant_records() {
    let model = "[data]\ntest = \"unit\"\ntime = \"t\"\n[states.bias]\n[measurements.acc]\ncolumn = \"acc\"\nequation = \"bias\"\n\
                 noise = \"sigma\"\n[parameters]\nsigma = {}\n";
    let (found, _) = notes(model, &file("rounded.csv"));
    assert!(
        found.iter().any(|note| note.contains("whole steps of 76.49187") && note.contains("`lower = 22.08`")),
        "{found:#?}"
    );
    let constant = "column `acc` is constant in tests `s1`, `s2` and `s7`";
    assert!(found.iter().any(|note| note.starts_with(constant) && note.contains("`lower = 22.08`")), "{found:#?}");
    for cured in [
        model.replace("sigma = {}", "sigma = { per = \"unit\", lower = 22.08 }"),
        model.replace("noise = \"sigma\"", "variance = \"sigma^2 + 76.49187^2 / 12\""),
    ] {
        let (found, _) = notes(&cured, &file("rounded.csv"));
        assert!(!found.iter().any(|note| note.contains("steps of") || note.contains("constant in")), "{found:#?}");
    }
}

/// A recursion from night to night where nights are missing.
#[test]
fn recursions_over_steps_of_unequal_length() {
    let model = "[data]\ntest = \"ID\"\ntime = \"night\"\n[states.level]\n[states.k]\nrandom = false\n[states.x]\nnext = \"rho * x\"\n\
                 step_noise = \"s * sqrt(1 - rho^2)\"\ninitial = \"stationary\"\n[measurements.y]\ncolumn = \"y\"\n\
                 equation = \"level + k * beep + x\"\nnoise = 0\n[parameters]\nrho = { lower = -0.999, upper = 0.999 }\ns = {}\n";
    let (found, _) = notes(model, &file("nights.csv"));
    let note = only(&found);
    assert!(note.starts_with("state `x` takes one step from each row to the next, however long"), "{note}");
    assert!(note.contains("`next = \"rho^dt * x\"`") && note.contains("`sqrt(1 - rho^(2 * dt))`"), "{note}");
    let cured = model
        .replace("rho * x", "rho^dt * x")
        .replace("s * sqrt(1 - rho^2)", "s * sqrt(1 - rho^(2 * dt))")
        .replace("initial = \"stationary\"", "initial = { mean = 0, sigma = \"s\" }")
        .replace("lower = -0.999", "lower = 0.001");
    let (found, fit) = notes(&cured, &file("nights.csv"));
    assert!(found.is_empty(), "{found:#?}");
    let rho = &fit["parameters"].as_array().unwrap().iter().find(|one| one["name"] == "rho").unwrap()["estimate"];
    near::mixed("rho", rho.as_f64().unwrap(), 0.6660, 1e-4);
    near::mixed("log-likelihood", fit["log_likelihood"].as_f64().unwrap(), -140.181_570_844, 1e-8);
}

fn drifting(rows: &str) -> (Vec<String>, Value) {
    let model = "[data]\ntest = \"id\"\ntime = \"t\"\ntime_unit = \"d\"\n[states.level]\n[states.memory]\nprocess = \"gauss-markov\"\n\
                 time_constant = 6\nsigma = 0.7\n[measurements.y]\ncolumn = \"y\"\nequation = \"level + memory\"\nnoise = 0.3\n";
    notes(model, &format!("id,t,y\n{rows}"))
}

#[test]
fn dates_of_eight_digits() {
    let rows = |date: &dyn Fn(u32) -> String| -> String {
        let days = (0..4).flat_map(|j| (27..33).map(move |day| (j, day)));
        days.map(|(j, day)| format!("u{j},{},{:.4}\n", date(day), wave(j, day))).collect()
    };
    let day = |day: u32| if day <= 30 { (11, day) } else { (12, day - 30) };
    let (found, _) = drifting(&rows(&|d| format!("2021{:02}{:02}", day(d).0, day(d).1)));
    let note = only(&found);
    assert!(note.contains("from 20211130 to 20211201 is a step of 71, but 1 day in the calendar"), "{note}");
    assert!(note.contains("`2021-11-30`"), "{note}");
    let (found, of_dates) = drifting(&rows(&|d| format!("2021-{:02}-{:02}", day(d).0, day(d).1)));
    assert!(found.is_empty(), "{found:#?}");
    let (found, of_numbers) = drifting(&rows(&|d| d.to_string()));
    assert!(found.is_empty(), "{found:#?}");
    assert_eq!(of_dates["log_likelihood"], of_numbers["log_likelihood"]);
}

#[test]
fn several_values_at_one_time() {
    let row = |(j, k): (u32, u32)| format!("u{j},{},{:.4}\n", k / 2, wave(j, k));
    let rows: String = (0..4).flat_map(|j| (0..12).map(move |k| (j, k))).map(row).collect();
    let (found, _) = drifting(&rows);
    let note = only(&found);
    let expected = "measurement `y` has several values at one time of a test, up to 2, at 24 of 24 times in column `t`";
    assert!(note.starts_with(expected) && note.contains("state `memory`"), "{note}");
}

#[test]
fn rows_that_stand_twice() {
    let rows = |copies: usize| -> String {
        let row = |(j, k): (u32, u32)| format!("u{j},{k},{:.4}\n", wave(j, k));
        let once: Vec<String> = (0..4).flat_map(|j| (0..6).map(move |k| (j, k))).map(row).collect();
        once.iter().chain(&once[..copies]).cloned().collect()
    };
    let model = MODEL.replace("0.1", "0.5");
    let (found, _) = notes(&model, &format!("id,x,y\n{}", rows(5)));
    assert!(only(&found).starts_with("5 of 29 rows equal another row of the same test"), "{found:#?}");
    let (found, _) = notes(&model, &format!("id,x,y\n{}", rows(0)));
    assert!(found.is_empty(), "{found:#?}");
    // two values of few digits at one x are equal by chance
    let row = |(j, k): (u32, u32)| format!("u{j},{},{:.0}\n", k / 4, 2.0 * wave(j, k));
    let coarse: String = (0..8).flat_map(|j| (0..12).map(move |k| (j, k))).map(row).collect();
    let (found, _) = notes(&model, &format!("id,x,y\n{coarse}"));
    assert!(!found.iter().any(|note| note.contains("another row")), "{found:#?}");
}

#[test]
fn values_that_are_missing_and_rows_that_are_sums() {
    let (found, _) = notes(MODEL, &format!("{DATA}d,0,\nd,1,NA\n"));
    assert_eq!(only(&found), "test `d` has no value of any measurement and says nothing");
    let (found, _) = notes(MODEL, &format!("{DATA}Total,9,15.2\n"));
    assert!(only(&found).starts_with("test `Total` of one row is named as if summing up others"), "{found:#?}");
    let two = format!("{MODEL}\n[measurements.z]\ncolumn = \"z\"\nequation = \"level\"\nnoise = 1\n");
    let with_z: String =
        DATA.lines().map(|line| format!("{line},{}\n", if line == "id,x,y" { "z" } else { "" })).collect();
    let (found, _) = notes(&two, &with_z);
    assert_eq!(only(&found), "column `z` has no value at all: measurement `z` says nothing");
    let nothing = "id,x,y\na,0,\na,1,\nb,0,\n";
    let (found, _) = notes(MODEL, nothing);
    let expected = "no row has a value of any measurement: these data say nothing of the model";
    assert!(found.iter().any(|note| note == expected), "{found:#?}");
    let folder = Folder::new(&[("d.csv", nothing.as_bytes())]);
    let said = shown(&folder.run("fit m.toml d.csv"));
    assert!(said.contains("Nothing was estimated: no row has a value") && !said.contains("Converged"), "{said}");
}

/// Rows without times correlate from row to row.
#[test]
fn correlation_without_times() {
    let walk = |j: u32, k: u32| (0..=k).map(|i| wave(j, i)).sum::<f64>();
    let smooth = |j: u32, k: u32| (f64::from(k) * 0.15 + f64::from(j)).sin() + 0.1 * walk(j, k);
    let row = |(j, k): (u32, u32)| format!("u{j},{k},{:.4}\n", smooth(j, k));
    let rows: String = (0..6).flat_map(|j| (0..60).map(move |k| (j, k))).map(row).collect();
    let model = |time: &str| {
        format!(
            "[data]\ntest = \"id\"\n{time}[states.level]\n[measurements.y]\ncolumn = \"y\"\nequation = \"level\"\nnoise = \"s\"\n\
             [parameters]\ns = {{}}\n"
        )
    };
    for (time, says, never) in [("", "from row to row", "in time"), ("time = \"x\"\n", "in time", "from row to row")] {
        let data = format!("id,x,y\n{rows}");
        let folder = Folder::new(&[("m.toml", model(time).as_bytes()), ("d.csv", data.as_bytes())]);
        let said = shown(&folder.run("fit m.toml d.csv"));
        assert!(
            said.contains(&format!("correlated {says}")) && !said.contains(&format!("correlated {never}")),
            "{said}"
        );
    }
}
