//! What the data determine, and how well, does not hang on the units of columns, nor on where they count from.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use std::collections::BTreeSet;

use kalfit_fixtures::near;
use serde_json::Value;

use crate::folder::{Folder, shown};
use crate::unidentified::{self, number, parameter};

/// Fits a model of data with the columns test, t, x and y; what was printed, and fit.json.
fn fit(model: &str, data: &str) -> (String, Value) {
    let data = format!("test,t,x,y\n{data}");
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
    let output = folder.run("fit m.toml d.csv --out fit.json");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let json = std::fs::read_to_string(folder.path("fit.json")).unwrap();
    (shown(&output), serde_json::from_str(&json).unwrap())
}

fn of_y(equation: &str, states: &str, parameters: &[&str]) -> String {
    unidentified::of_y(equation, "s", parameters, states)
}

/// Cosines of different frequencies: numbers that look random.
fn wave(j: u32, k: u32) -> f64 {
    (f64::from(j) * 2.7 + f64::from(k) * 11.3 + 0.2).cos()
}

/// Rows of x and y in these units, y = a + 0.7 x + noise.
fn rows(tests: u32, each: u32, x: &dyn Fn(u32, u32) -> f64, (of_x, of_y): (f64, f64)) -> String {
    let row = |(j, k): (u32, u32)| {
        let y = 3.0 + 1.3 * wave(j, 50) + 0.7 * x(j, k) + 0.3 * wave(j, k + 1);
        format!("t{j:02},{k},{:e},{:e}\n", x(j, k) * of_x, y * of_y)
    };
    (0..tests).flat_map(|j| (0..each).map(move |k| (j, k))).map(row).collect()
}

/// Elements that take part in what is not identified.
fn named(found: &Value) -> BTreeSet<(String, String)> {
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let one = |direction: &Value| {
        let (elements, weights) = (&direction["elements"], &direction["direction"]);
        let both = elements.as_array().unwrap().iter().zip(weights.as_array().unwrap());
        let taking_part = both.filter(|(_, weight)| number(weight) != 0.0);
        taking_part.map(|(element, _)| (text(&direction["what"]), text(element))).collect::<Vec<_>>()
    };
    found["phases"][0]["unidentified"].as_array().unwrap().iter().flat_map(one).collect()
}

/// An input that is the same in all rows: neither state has a known mean, whatever one of them is measured in.
#[test]
fn two_states_that_are_not_told_apart_are_both_named_in_any_unit() {
    let model = of_y("a + q * x", "[states.a]\n[states.q]\nrandom = false\n", &["s"]);
    let both: BTreeSet<(String, String)> = ["a", "q"].map(|state| ("mean".to_owned(), state.to_owned())).into();
    for unit in [1.0, 1e6, 1e-6, 1e12] {
        let (text, found) = fit(&model, &rows(12, 4, &|_, _| 2.0, (unit, 1.0)));
        assert_eq!(named(&found), both, "{unit:e}: {text}");
        assert_eq!(found["phases"][0]["mean"]["std_error"], serde_json::json!([null, null]), "{unit:e}: {text}");
    }
}

/// One row a test: of the noise and the variance of the state only the sum is known, of either by itself nothing. What is known of the means is what
/// least squares know.
#[test]
fn noise_and_variance_of_one_row_a_test_are_one_sum_in_any_unit() {
    let model = of_y("a + q * x", "[states.a]\n", &["s", "q"]);
    for (of_y, of_x) in [(1.0, 1.0), (1.0, 1e6), (1e-4, 1.0), (1e-4, 1e6), (1e5, 1.0), (1e5, 1e6)] {
        let data = rows(20, 1, &|j, _| wave(j, 31), (of_x, of_y));
        let (text, found) = fit(&model, &data);
        assert_eq!(parameter(&found, "s")["standing"], "unidentified", "{of_y:e} {of_x:e}: {text}");
        let phase = &found["phases"][0];
        assert_eq!(phase["covariance"]["std_error"][0][0], Value::Null, "{of_y:e} {of_x:e}: {text}");
        let errors = [&phase["mean"]["std_error"][0], &parameter(&found, "q")["std_error"]].map(number);
        for (error, expected) in errors.into_iter().zip(least_squares(&data)) {
            assert!((error / expected - 1.0).abs() < 1e-8, "{of_y:e} {of_x:e}: {error} against {expected}\n{text}");
        }
    }
}

/// Standard errors of a and q in y = a + q x + noise of a maximum-likelihood variance.
fn least_squares(data: &str) -> [f64; 2] {
    let cells = |line: &str| line.split(',').skip(2).map(|cell| cell.parse().unwrap()).collect::<Vec<f64>>();
    let rows: Vec<Vec<f64>> = data.lines().map(cells).collect();
    let mean = |of: &dyn Fn(&[f64]) -> f64| rows.iter().map(|row| of(row)).sum::<f64>() / rows.len() as f64;
    let (x, y) = (mean(&|row| row[0]), mean(&|row| row[1]));
    let spread = mean(&|row| (row[0] - x).powi(2));
    let slope = mean(&|row| (row[0] - x) * (row[1] - y)) / spread;
    let noise = mean(&|row| (row[1] - y - slope * (row[0] - x)).powi(2));
    let of_slope = noise / spread / rows.len() as f64;
    [(of_slope * mean(&|row| row[0].powi(2))).sqrt(), of_slope.sqrt()]
}

/// Years, days, epochs: a coefficient of x + 2000 has the value and the error of that of x, up to what the digits of x + 10⁵ allow.
#[test]
fn a_coefficient_does_not_hang_on_where_its_column_counts_from() {
    let model = of_y("a + q * x", "[states.a]\n", &["s", "q"]);
    let (text, about_zero) = fit(&model, &rows(12, 5, &wave, (1.0, 1.0)));
    let known = parameter(&about_zero, "q");
    for (offset, digits) in [(500.0, 1e-3), (2000.0, 1e-3), (1e4, 1e-3), (3e4, 1e-3), (1e5, 5e-3)] {
        let shifted = rows(12, 5, &wave, (1.0, 1.0));
        let shifted: String = shifted
            .lines()
            .map(|line| {
                let cells: Vec<&str> = line.split(',').collect();
                let x: f64 = cells[2].parse().unwrap();
                format!("{},{},{:.15e},{}\n", cells[0], cells[1], x + offset, cells[3])
            })
            .collect();
        let (shown, found) = fit(&model, &shifted);
        let own = parameter(&found, "q");
        near::mixed("ℓ", number(&found["log_likelihood"]), number(&about_zero["log_likelihood"]), 1e-6);
        near::mixed("q", number(&own["estimate"]), number(&known["estimate"]), 1e-2 * digits);
        let (error, expected) = (number(&own["std_error"]), number(&known["std_error"]));
        assert!((error / expected - 1.0).abs() < digits, "{offset}: {error} against {expected}\n{shown}\n{text}");
    }
}

/// Beyond what digits allow the maximum is found, and what to write instead is said.
#[test]
fn a_column_far_from_zero_is_named() {
    let states = "[states.a]\n[states.q]\nrandom = false\n";
    let data = |offset: f64| rows(12, 5, &|j, k| wave(j, k) + offset, (1.0, 1.0));
    let centred = fit(&of_y("a + q * (x - 10000000)", states, &["s"]), &data(1e7)).1;
    let (text, found) = fit(&of_y("a + q * x", states, &["s"]), &data(1e7));
    near::mixed("ℓ", number(&found["log_likelihood"]), number(&centred["log_likelihood"]), 1e-4);
    assert_eq!(found["phases"][0]["mean"]["std_error"], serde_json::json!([null, null]), "{text}");
    let notes = found["notes"].to_string();
    assert!(notes.contains("column `x` lies") && notes.contains("`(x - 1e7)`"), "{notes}");
    assert!(!centred["notes"].to_string().contains("column `x`"), "{}", centred["notes"]);
    let folder = Folder::new(&[
        ("m.toml", of_y("a + q * x", states, &["s"]).as_bytes()),
        ("d.csv", format!("test,t,x,y\n{}", data(1e7)).as_bytes()),
    ]);
    let checked = shown(&folder.run("check m.toml d.csv"));
    assert!(checked.contains("(x - 1e7)"), "{checked}");
}

/// Of y = a + q x + k z with related x and z, and of y = a + q x with a free noise, wherever x counts from: errors are those about zero, or
/// there are none, and the noise is always known.
#[test]
fn errors_beside_a_coefficient_do_not_hang_on_where_its_column_counts_from() {
    let states = "[states.a]\n[states.q]\nrandom = false\n";
    let related = |j: u32, k: u32| 0.8 * wave(j, k) + 0.6 * (f64::from(j) * 1.9 + f64::from(k) * 4.1).sin();
    let data = |offset: f64| -> String {
        let row = |(j, k): (u32, u32)| {
            let (x, z) = (wave(j, k), related(j, k));
            let y = 3.0 + 1.3 * wave(j, 50) + 0.7 * x + 0.4 * z + 0.3 * wave(j + 40, k + 1);
            format!("t{j:02},{k},{z:.15e},{:.15e},{y:.15e}\n", x + offset)
        };
        (0..20).flat_map(|j| (0..5).map(move |k| (j, k))).map(row).collect()
    };
    let fit = |equation: &str, parameters: &[&str], offset: f64| {
        let model = of_y(equation, states, parameters);
        let data = format!("test,t,z,x,y\n{}", data(offset));
        let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
        let output = folder.run("fit m.toml d.csv --innovations off --out fit.json");
        // scores may be made of rounding, so that there is no certificate
        assert!(matches!(output.status.code(), Some(0 | 1)), "{}", shown(&output));
        let json = std::fs::read_to_string(folder.path("fit.json")).unwrap();
        (shown(&output), serde_json::from_str::<Value>(&json).unwrap())
    };
    for (equation, parameters) in [("a + q * x + k * z", &["s", "k"][..]), ("a + q * x", &["s"])] {
        let known = fit(equation, parameters, 0.0).1;
        for offset in [200.0, 2015.0, 3000.0, 5e3, 1e4, 5e4] {
            let (text, found) = fit(equation, parameters, offset);
            assert!(found["converged"] == true || offset > 200.0, "{text}");
            if found["converged"] == false {
                continue;
            }
            for name in parameters {
                let error = |found: &Value| number(&parameter(found, name)["std_error"]);
                assert!((error(&found) / error(&known) - 1.0).abs() < 0.02, "{name} at {offset}: {text}");
            }
            let slope = |found: &Value| found["phases"][0]["mean"]["std_error"][1].clone();
            if slope(&found) != Value::Null {
                let (own, expected) = (number(&slope(&found)), number(&slope(&known)));
                assert!((own / expected - 1.0).abs() < 0.02, "q at {offset}: {own} for {expected}\n{text}");
            }
        }
    }
}

/// Of y = a + q x + b z with random a and b: where x counts from 1000, ℓ over (q, noise) is a narrow ridge that bends, along which a search
/// went by small steps until its limit.
#[test]
fn the_top_of_a_narrow_ridge_is_found() {
    let model = of_y("a + q * x + b * z", "[states.a]\n[states.b]\n", &["s", "q"]);
    let fit = |offset: f64| {
        let row = |(j, k): (u32, u32)| {
            let sine = |of_test: f64, of_row: f64| (f64::from(j) * of_test + f64::from(k) * of_row).sin();
            let (x, z) = (0.5 * wave(j, k), 0.8 * wave(j, k) + 0.6 * sine(1.9, 4.1));
            let of_states = 3.0 + 0.9 * wave(j, 50) + (0.4 + 0.05 * wave(j, 70)) * z;
            let y = of_states + 0.7 * x + 0.4 * sine(5.3, 3.7);
            format!("t{j:02},{k},{z:.15e},{:.15e},{y:.15e}\n", x + offset)
        };
        let rows: String = (0..30).flat_map(|j| (0..4).map(move |k| (j, k))).map(row).collect();
        let data = format!("test,t,z,x,y\n{rows}");
        let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
        let output = folder.run("fit m.toml d.csv --innovations off --out fit.json");
        assert_eq!(output.status.code(), Some(0), "{offset}: {}", shown(&output));
        serde_json::from_str::<Value>(&std::fs::read_to_string(folder.path("fit.json")).unwrap()).unwrap()
    };
    let error = |found: &Value| number(&parameter(found, "q")["std_error"]);
    let about_zero = fit(0.0);
    for offset in [300.0, 1000.0, 2015.0, 2e4] {
        let found = fit(offset);
        near::mixed("ℓ", number(&found["log_likelihood"]), number(&about_zero["log_likelihood"]), 1e-6);
        let (own, expected) = (error(&found), error(&about_zero));
        assert!((own / expected - 1.0).abs() < 1e-2, "q at {offset}: {own} for {expected}");
    }
}

/// A walk that is measured all but exactly: its noise ends near zero, where ℓ has fewer digits than elsewhere. Errors of the means by a
/// Hessian of numpy.
#[test]
fn errors_beside_a_vanishing_noise_are_those_of_its_hessian() {
    let model = of_y(
        "a + q * x",
        "[states.a]\nprocess = \"random-walk\"\nnoise_density = \"g\"\n[states.q]\nrandom = false\n",
        &["s", "g"],
    );
    let (text, found) = fit(&model, WALKS);
    assert_eq!(parameter(&found, "s")["standing"], "lower", "{text}");
    for (k, expected) in [(0, 0.717_539_7), (1, 0.070_118_11)] {
        near::mixed("mean", number(&found["phases"][0]["mean"]["std_error"][k]), expected, 1e-5);
    }
    near::mixed("g", number(&parameter(&found, "g")["std_error"]), 0.052_885_57, 1e-3);
}

const WALKS: &str = "\
t00,0,9.63939163110073,2.746354911894156\n\
t00,1,10.421131137462407,3.1321087138275407\n\
t00,2,10.613993062468861,3.0719025567359215\n\
t00,3,9.993238459653478,2.824093464753813\n\
t01,0,9.483105847410725,2.662013995240471\n\
t01,1,9.795233883166134,2.932209180186114\n\
t01,2,9.535755408362519,2.7444707208627745\n\
t01,3,9.480240227629821,2.8107117554190983\n\
t02,0,11.901187200033256,4.504699041112115\n\
t02,1,11.733529585613107,4.158815595323261\n\
t02,2,10.90704895768581,3.3682631336764253\n\
t02,3,9.366491074566383,1.91272017118011\n\
t03,0,9.67494790119362,3.2193557764773106\n\
t03,1,8.78540936702015,2.7727657886690555\n\
t03,2,8.940743900172155,2.459716673645208\n\
t03,3,10.43386341120017,3.6513433277930436\n\
t04,0,10.296561246917825,3.6848565260951585\n\
t04,1,10.488005675680709,4.161624261767566\n\
t04,2,10.12947113235561,3.6504236278331583\n\
t04,3,9.66229521423913,3.238088759316419\n\
t05,0,10.010473028918684,3.033141290366327\n\
t05,1,11.09289281055875,4.145581876264584\n\
t05,2,10.032402798779083,3.3417803075246377\n\
t05,3,9.491096166006232,3.933856273081021\n\
";
