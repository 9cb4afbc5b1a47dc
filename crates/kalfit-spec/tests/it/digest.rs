//! The digest of what reductions depend on.

use kalfit_spec::Spec;

const MODEL: &str = r#"
title = "bench"
[data]
test = "id"
time = "t"
time_unit = "s"
phase = "leg"
[states]
a = { derivative = "-k * a + u", noise_density = "s", offset = "h" }
b = { initial = "estimated" }
[measurements.y]
column = "y"
where = "sensor == 'A'"
equation = "a + b"
noise = "noise"
[measurements.z]
column = "z"
equation = "b"
noise = 1
[noise_covariance]
"y, z" = 0.05
[mean]
fixed = { a = 1 }
regression = { b = ["warm"] }
[covariance]
known = [[0.5, 0], [0, 0]]
[phases.one]
[phases.two.carry]
b = "2 * b"
[phases.two.filter]
kind = "kalman-schmidt"
covariance = [[1, 0], [0, 2]]
parameters = { k = 3, s = 1 }
[parameters]
k = { start = 2 }
s = 0.1
noise = { per = "lot", value = 0.5, fixed = { A = 0.7 } }
"#;

fn digest(text: &str) -> String {
    match Spec::parse("model.toml", text) {
        Ok(spec) => spec.reduction_digest(),
        Err(error) => panic!("{error} at {:?}", error.span.clone().map(|span| &text[span])),
    }
}

fn changed(from: &str, to: &str) -> String {
    assert_eq!(MODEL.matches(from).count(), 1, "{from}");
    digest(&MODEL.replace(from, to))
}

#[test]
fn what_reductions_do_not_depend_on_leaves_the_digest() {
    let whole = digest(MODEL);
    assert_eq!(whole.len(), "sha256:".len() + 64);
    for (from, to) in [
        ("\"bench\"", "\"flight\""),
        ("test = \"id\"", "test = \"unit\""),
        ("fixed = { a = 1 }", "start = { a = 7 }"),
        ("known =", "structure = \"diagonal\"\nknown ="),
        ("known =", "fixed = { \"a, a\" = 2 }\nknown ="),
        ("{ start = 2 }", "{ value = 5, unit = \"1/s\" }"),
        ("{ start = 2 }", "{ lower = 1, upper = 9 }"),
        ("s = 0.1\n", "s = 0.2\n"),
        ("{ A = 0.7 }", "{ B = 0.8 }"),
        ("[parameters]\nk = { start = 2 }\ns = 0.1", "[parameters]\ns = 0.1\nk = { start = 2 }"),
        ("a = { derivative", "a = { unit = \"V\", derivative"),
        ("[measurements.z]", "[measurements.second]"),
    ] {
        let text = MODEL.replace(from, to).replace("y, z", if to.contains("second") { "y, second" } else { "y, z" });
        assert_eq!(digest(&text), whole, "{from} -> {to}");
    }
}

#[test]
fn values_that_are_set_leave_the_digest() {
    let mut spec = Spec::parse("model.toml", MODEL).expect("the model is whole");
    for assignment in ["k=4", "noise[C]=2"] {
        spec.set(assignment).expect("it can be set");
    }
    assert_eq!(spec.reduction_digest(), digest(MODEL));
}

#[test]
fn what_reductions_depend_on_changes_the_digest() {
    let mut seen = vec![digest(MODEL)];
    for (from, to) in [
        ("time = \"t\"", "time = \"clock\""),
        ("time_unit = \"s\"", "time_unit = \"h\""),
        ("phase = \"leg\"", "phase = \"leg\"\ninputs = \"previous\""),
        ("-k * a + u", "-k * a - u"),
        ("-k * a + u", "-k * a + v"),
        ("noise_density = \"s\"", "noise_density = \"2 * s\""),
        (", offset = \"h\"", ""),
        ("initial = \"estimated\"", "process = \"random-walk\", step_noise = 1"),
        ("sensor == 'A'", "sensor == 'B'"),
        ("sensor == 'A'", "kind == 'A'"),
        ("column = \"z\"", "column = \"w\""),
        ("\"a + b\"", "\"b + 2 * a\""),
        ("noise = 1\n", "noise = 2\n"),
        ("= 0.05", "= 0.06"),
        ("[\"warm\"]", "[\"cold\"]"),
        ("known =", "order = [\"b\", \"a\"]\nknown ="),
        ("[[0.5, 0], [0, 0]]", "[[0.5, 0], [0, 1]]"),
        ("[phases.one]", "[phases.first]"),
        ("[phases.one]", "[phases.one]\ninitial_time = 0"),
        ("\"2 * b\"", "\"3 * b\""),
        ("b = \"2 * b\"", "a = \"2 * b\""),
        ("[[1, 0], [0, 2]]", "[[1, 0], [0, 3]]"),
        ("covariance = [[1, 0], [0, 2]]\n", "covariance = [[1, 0], [0, 2]]\nconsider = [\"a\"]\n"),
        ("covariance = [[1, 0], [0, 2]]\n", "covariance = [[1, 0], [0, 2]]\nmean = { a = 1 }\n"),
        ("{ k = 3, s = 1 }", "{ k = 3, s = 2 }"),
        ("per = \"lot\"", "per = \"batch\""),
    ] {
        let found = changed(from, to);
        assert!(!seen.contains(&found), "{from} -> {to} gives a digest that was there before");
        seen.push(found);
    }
}
