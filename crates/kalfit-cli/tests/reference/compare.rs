//! A fit.json against the reference: every figure in units of its tolerance.

use serde_json::Value;

/// Standard errors are second derivatives: they need not hold as closely as the estimates, and the references have
/// them with 6 digits at the least.
const STD_ERROR_REL: f64 = 1e-3;
/// Sensitivities are slopes at the optimum: they shift with the last digits of the estimates and of the set parameters.
const SENSITIVITY_REL: f64 = 1e-4;
/// Nothing is measured in units of zero.
const LEAST: f64 = 1e-300;

/// One figure beside its reference.
struct Figure {
    what: String,
    found: f64,
    expected: f64,
    /// The error that is just tolerated.
    tolerance: f64,
}

/// All figures of one fit, and what could not be compared at all or is not a matter of tolerance.
#[derive(Default)]
pub(super) struct Comparison {
    figures: Vec<Figure>,
    mismatches: Vec<String>,
}

impl Comparison {
    /// Compares a fit.json with an entry of expected.json.
    pub(super) fn of(fit: &Value, want: &Value) -> Comparison {
        let mut all = Comparison::default();
        let rel = number(&want["tolerance"]["params_rel"]);
        let absolute = number(&want["tolerance"]["loglik_abs"]);
        all.walk("log_likelihood", &fit["log_likelihood"], &want["log_likelihood"], &Value::Null, &|_, _| absolute);
        let (found, expected) = (&fit["composite_log_likelihood"], &want["composite_log_likelihood"]);
        all.walk("composite_log_likelihood", found, expected, &Value::Null, &|_, _| absolute);
        all.same("free_parameters", &fit["free_parameters"], &want["free_parameters"]);
        if want["phases"].is_null() {
            all.phase("", &fit["phases"][0], want, rel);
        } else {
            all.same("phases", &names(&fit["phases"]), &names(&want["phases"]));
            for (found, want) in list(&fit["phases"]).iter().zip(list(&want["phases"])) {
                all.phase(&format!("{}: ", text(&want["name"])), found, want, rel);
            }
        }
        all.levels(fit, want, rel);
        all.constraints(fit, want, rel);
        all.parameters(fit, want);
        all.estimates(fit, want, rel);
        all.tests(fit, want, rel, absolute);
        all
    }

    /// What was found of one phase; `of` stands before the names of its figures.
    fn phase(&mut self, of: &str, phase: &Value, want: &Value, rel: f64) {
        self.same(&format!("{of}states"), &phase["states"], &want["states"]);
        for kind in ["mean", "covariance"] {
            let (found, expected) = (&phase[kind], &want[kind]);
            self.scaled(&format!("{of}{kind}"), &found["estimate"], expected, &want["scale"][kind], rel);
            let errors = &want["std_error"][kind];
            let what = format!("{of}std_error of {kind}");
            // references have the errors of generalised least squares
            let own = found.get("std_error_plain").unwrap_or(&found["std_error"]);
            self.walk(&what, own, errors, &Value::Null, &|expected, _| (STD_ERROR_REL * expected.abs()).max(LEAST));
        }
        self.boundary(of, phase, want);
    }

    /// What was found of the groups of each level.
    fn levels(&mut self, fit: &Value, want: &Value, rel: f64) {
        for (name, want) in want["levels"].as_object().into_iter().flatten() {
            let Some(found) = list(&fit["levels"]).iter().find(|level| text(&level["name"]) == name) else {
                self.mismatches.push(format!("level {name} is not in fit.json"));
                continue;
            };
            let (found, expected) = (&found["covariance"]["estimate"], &want["covariance"]);
            self.scaled(&format!("covariance of level {name}"), found, expected, &want["scale"], rel);
        }
    }

    /// One line for each figure that is off by more than `limit` tolerances, the worst first, and for each mismatch.
    pub(super) fn failures(&self, limit: f64) -> Vec<String> {
        let error = |f: &Figure| (f.found - f.expected).abs() / f.tolerance;
        let mut beyond: Vec<&Figure> = self.figures.iter().filter(|f| error(f) > limit).collect();
        beyond.sort_by(|a, b| error(b).total_cmp(&error(a)));
        let line = |f: &Figure| {
            format!("{}: found {}, expected {}: {:.3e} x tolerance", f.what, f.found, f.expected, error(f))
        };
        self.mismatches.iter().cloned().chain(beyond.into_iter().map(line)).collect()
    }

    /// Something that is equal or not.
    fn same(&mut self, what: &str, found: &Value, expected: &Value) {
        if found != expected {
            self.mismatches.push(format!("{what}: found {found}, expected {expected}"));
        }
    }

    /// Nested lists of one shape; null in `expected` is not compared.
    /// `tolerance` makes the tolerated error of an element from its reference and its scale, if it has one.
    fn walk(
        &mut self,
        what: &str,
        found: &Value,
        expected: &Value,
        scale: &Value,
        tolerance: &dyn Fn(f64, Option<f64>) -> f64,
    ) {
        match expected {
            Value::Null => {}
            Value::Array(entries) if found.as_array().is_some_and(|list| list.len() == entries.len()) => {
                for (i, entry) in entries.iter().enumerate() {
                    let scale = if scale.is_array() { &scale[i] } else { scale };
                    self.walk(&format!("{what}[{i}]"), &found[i], entry, scale, tolerance);
                }
            }
            Value::Number(_) if found.is_number() => {
                let (found, expected) = (number(found), number(expected));
                let tolerance = tolerance(expected, scale.as_f64());
                self.figures.push(Figure { what: what.to_owned(), found, expected, tolerance });
            }
            _ => self.mismatches.push(format!("{what}: found {found}, expected {expected}")),
        }
    }

    /// Elements that are zero or ill determined are held relative to their scale: that of the reference,
    /// or a hundredth of the largest element.
    fn scaled(&mut self, what: &str, found: &Value, expected: &Value, scale: &Value, rel: f64) {
        let small = largest(expected) / 100.0;
        self.walk(what, found, expected, scale, &|expected, scale| {
            rel * expected.abs().max(scale.unwrap_or(small)).max(LEAST)
        });
    }

    fn constraints(&mut self, fit: &Value, want: &Value, rel: f64) {
        for constraint in list(&want["constraints"]) {
            let name = text(&constraint["element"]);
            let Some(found) = list(&fit["constraints"]).iter().find(|c| element(text(&c["element"])) == element(name))
            else {
                self.mismatches.push(format!("constraint {name} is not in fit.json"));
                continue;
            };
            self.walk(&format!("value of {name}"), &found["value"], &constraint["value"], &Value::Null, &|value, _| {
                if value == 0.0 { 1e-12 } else { rel * value.abs() }
            });
            let (sensitivity, scale) = (&constraint["sensitivity"], &constraint["scale"]);
            self.walk(&format!("sensitivity of {name}"), &found["sensitivity"], sensitivity, scale, &|value, scale| {
                SENSITIVITY_REL * value.abs().max(scale.unwrap_or(0.0)).max(1e-9)
            });
        }
    }

    fn boundary(&mut self, of: &str, phase: &Value, want: &Value) {
        let ranks = |of: &Value| list(of).iter().map(|b| (b["rank"].as_u64(), b["of"].as_u64())).collect::<Vec<_>>();
        let (found, expected) = (ranks(&phase["boundary"]), ranks(&want["boundary"]));
        if found != expected {
            self.mismatches.push(format!("{of}boundary (rank, of): found {found:?}, expected {expected:?}"));
        }
    }

    /// What was set is what was used.
    fn parameters(&mut self, fit: &Value, want: &Value) {
        for set in list(&want["set"]) {
            let (name, value) = text(set).split_once('=').expect("a setting is NAME=VALUE");
            let expected: f64 = value.parse().expect("a setting is a number");
            let found = list(&fit["parameters"]).iter().find(|p| written(p) == name);
            let found = found.map(|p| (p["estimate"].clone(), p["fixed"].clone()));
            if found != Some((Value::from(expected), Value::from(true))) {
                self.mismatches.push(format!("{name}: found {found:?}, expected {expected} fixed"));
            }
        }
    }

    /// Parameters that were estimated, and their standard errors.
    fn estimates(&mut self, fit: &Value, want: &Value, rel: f64) {
        for estimate in list(&want["estimates"]) {
            let name = text(&estimate["name"]);
            let Some(found) = list(&fit["parameters"]).iter().find(|p| written(p) == name && p["fixed"] == false)
            else {
                self.mismatches.push(format!("{name} is not among the estimates"));
                continue;
            };
            let scale = &estimate["scale"];
            self.walk(name, &found["estimate"], &estimate["value"], scale, &|expected, scale| {
                rel * expected.abs().max(scale.unwrap_or(0.0)).max(LEAST)
            });
            let what = format!("std_error of {name}");
            self.walk(
                &what,
                &found["std_error"],
                &want["std_error"]["parameters"][name],
                &Value::Null,
                &|expected, _| (STD_ERROR_REL * expected.abs()).max(LEAST),
            );
        }
    }

    fn tests(&mut self, fit: &Value, want: &Value, rel: f64, absolute: f64) {
        for test in list(&want["tests"]) {
            let id = text(&test["id"]);
            let Some(found) = list(&fit["tests"]).iter().find(|t| t["id"] == test["id"]) else {
                self.mismatches.push(format!("test {id} is not in fit.json"));
                continue;
            };
            let what = format!("log_likelihood of test {id}");
            self.walk(&what, &found["log_likelihood"], &test["log_likelihood"], &Value::Null, &|expected, _| {
                absolute.max(rel * expected.abs())
            });
            if test["phases"].is_null() {
                self.posterior(&format!("test {id}"), &found["phases"][0], test, rel);
                continue;
            }
            self.same(&format!("phases of test {id}"), &names(&found["phases"]), &names(&test["phases"]));
            for (found, want) in list(&found["phases"]).iter().zip(list(&test["phases"])) {
                self.posterior(&format!("phase {} of test {id}", text(&want["name"])), found, want, rel);
            }
        }
    }

    fn posterior(&mut self, of: &str, found: &Value, want: &Value, rel: f64) {
        for kind in ["mean", "covariance"] {
            self.scaled(&format!("{kind} of {of}"), &found[kind], &want[kind], &Value::Null, rel);
        }
    }
}

/// Names of phases.
fn names(phases: &Value) -> Value {
    list(phases).iter().map(|phase| phase["name"].clone()).collect()
}

/// What an entry with `set` says of the fit without it: the same optimum, the parameters among the estimates.
pub(super) fn freed(want: &Value) -> Value {
    let mut want = want.clone();
    let Value::Array(set) = want["set"].take() else { panic!("no parameters are set") };
    let free = want["free_parameters"].as_u64().expect("a count") + set.len() as u64;
    want["free_parameters"] = Value::from(free);
    want["std_error"] = want.get("free_std_error").cloned().unwrap_or_default();
    let scales = want["std_error"]["scale"].clone();
    let estimate = |set: &Value| {
        let (name, value) = text(set).split_once('=').expect("a setting is NAME=VALUE");
        let value: f64 = value.parse().expect("a setting is a number");
        serde_json::json!({ "name": name, "value": value, "scale": scales[name] })
    };
    want["estimates"] = set.iter().map(estimate).collect();
    want
}

/// `name`, or `name[level]`.
fn written(parameter: &Value) -> String {
    match parameter["level"].as_str() {
        Some(level) => format!("{}[{level}]", text(&parameter["name"])),
        None => text(&parameter["name"]).to_owned(),
    }
}

/// The entries of a list; none where there is no list.
pub(super) fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// A text that must be there.
pub(super) fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_else(|| panic!("a text expected, found {value}"))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("a number expected, found {value}"))
}

fn largest(value: &Value) -> f64 {
    let inner = list(value).iter().map(largest).fold(0.0, f64::max);
    value.as_f64().map_or(inner, f64::abs)
}

/// `covariance[b, a]` and `covariance[a,b]` are the same element.
fn element(name: &str) -> (&str, Vec<&str>) {
    let (kind, rest) = name.split_once('[').unwrap_or((name, ""));
    let mut states: Vec<&str> = rest.trim_end_matches(']').split(',').map(str::trim).collect();
    states.sort_unstable();
    (kind, states)
}

/// What a comparison must notice, each by changing one figure of a fit that is as expected.
mod notices {
    use super::Comparison;
    use serde_json::{Value, json};

    fn expected() -> Value {
        json!({
            "set": ["r[A]=2"], "estimates": [{"name": "q", "value": 5.0, "scale": null}], "log_likelihood": -10.0, "free_parameters": 3, "states": ["a", "b"],
            "mean": [1.0, 0.0], "covariance": [[4.0, null], [null, 0.0]],
            "scale": {"covariance": [[1.0, 1.0], [1.0, 0.5]]}, "std_error": {"mean": [0.1, null], "parameters": {"q": 0.5}},
            "constraints": [{"element": "covariance[b, b]", "value": 0, "sensitivity": -3.0}],
            "boundary": [{"rank": 1, "of": 2}],
            "tests": [{"id": "x", "log_likelihood": -10.0, "mean": [1.0, 0.0], "covariance": [[4.0, 0.0], [0.0, 1.0]]}],
            "tolerance": {"loglik_abs": 1e-6, "params_rel": 1e-5},
        })
    }

    fn found() -> Value {
        json!({
            "log_likelihood": -10.0, "free_parameters": 3,
            "phases": [{
                "states": ["a", "b"], "mean": {"estimate": [1.0, 0.0], "std_error": [0.1, 7.0]},
                "covariance": {"estimate": [[4.0, 7.0], [7.0, 0.0]]}, "boundary": [{"what": "covariance", "rank": 1, "of": 2}],
            }],
            "parameters": [{"name": "r", "level": "A", "estimate": 2.0, "fixed": true},
                           {"name": "q", "level": null, "estimate": 5.0, "std_error": 0.5, "fixed": false}],
            "constraints": [{"element": "covariance[b,b]", "value": 0.0, "sensitivity": -3.0}],
            "tests": [{"id": "x", "log_likelihood": -10.0, "phases": [{"mean": [1.0, 0.0], "covariance": [[4.0, 0.0], [0.0, 1.0]]}]}],
        })
    }

    #[test]
    fn nothing_where_all_is_as_expected() {
        assert_eq!(Comparison::of(&found(), &expected()).failures(1.0), Vec::<String>::new());
    }

    #[test]
    fn each_figure_that_is_off_by_more_than_its_tolerance() {
        let mean = "/phases/0/mean/estimate";
        let covariance = "/phases/0/covariance/estimate";
        let off = [
            ("/log_likelihood".to_owned(), -10.0, 1e-6),
            (format!("{mean}/0"), 1.0, 1e-5),
            (format!("{mean}/1"), 0.0, 1e-7),
            (format!("{covariance}/0/0"), 4.0, 4e-5),
            (format!("{covariance}/1/1"), 0.0, 5e-6),
            ("/phases/0/mean/std_error/0".to_owned(), 0.1, 1e-4),
            ("/parameters/1/estimate".to_owned(), 5.0, 5e-5),
            ("/parameters/1/std_error".to_owned(), 0.5, 5e-4),
            ("/constraints/0/value".to_owned(), 0.0, 1e-12),
            ("/constraints/0/sensitivity".to_owned(), -3.0, 3e-4),
            ("/tests/0/log_likelihood".to_owned(), -10.0, 1e-4),
            ("/tests/0/phases/0/covariance/0/1".to_owned(), 0.0, 4e-7),
        ];
        for (place, value, tolerance) in off {
            for (by, failures) in [(0.9, 0), (1.1, 1)] {
                let mut fit = found();
                *fit.pointer_mut(&place).unwrap() = Value::from(value + by * tolerance);
                let lines = Comparison::of(&fit, &expected()).failures(1.0);
                assert_eq!(lines.len(), failures, "{place} off by {by} tolerances: {lines:?}");
                assert!(Comparison::of(&fit, &expected()).failures(2.0).is_empty(), "{place}");
            }
        }
    }

    #[test]
    fn whatever_is_missing_or_not_the_same() {
        let wrong = [
            ("/free_parameters", json!(4)),
            ("/phases/0/states", json!(["b", "a"])),
            ("/phases/0/mean/estimate", json!([1.0])),
            ("/phases/0/mean/std_error/0", Value::Null),
            ("/phases/0/boundary", json!([])),
            ("/parameters/0/fixed", json!(false)),
            ("/parameters/0/estimate", json!(2.5)),
            ("/parameters/1/fixed", json!(true)),
            ("/constraints", json!([])),
            ("/tests/0/id", json!("y")),
        ];
        for (place, value) in wrong {
            let mut fit = found();
            *fit.pointer_mut(place).unwrap() = value;
            let lines = Comparison::of(&fit, &expected()).failures(100.0);
            assert_eq!(lines.len(), 1, "{place}: {lines:?}");
        }
    }
}
