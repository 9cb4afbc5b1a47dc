//! `--set`.

use kalfit::model::Value;
use kalfit_spec::Spec;

const MODEL: &str = "
[data]
time = 't'
[states.a]
process = 'gauss-markov'
time_constant = 'tau'
sigma = 's'
[measurements.y]
column = 'y'
equation = 'k * a'
noise = 'noise'
[parameters]
tau = { lower = 1, upper = 1000 }
s = {}
k = {}
noise = { per = 'lot', fixed = { A = 0.7 } }
";

fn set(assignments: &[&str]) -> Result<Spec, String> {
    let mut spec = Spec::parse("model.toml", MODEL).expect("the model is whole");
    for assignment in assignments {
        spec.set(assignment).map_err(|error| match error.hint {
            Some(hint) => format!("{}\nhint {hint}", error.message),
            None => error.message,
        })?;
    }
    Ok(spec)
}

#[test]
fn an_assignment_fixes_a_parameter_at_all_levels() {
    let spec = set(&["tau=90", " noise = 0.5 ", "k=-1e-3"]).unwrap();
    let values: Vec<Value> = spec.model.shared().parameters.iter().map(|p| p.value).collect();
    assert_eq!(values, [Value::Fixed(90.0), Value::Free { start: None }, Value::Fixed(-1e-3), Value::Fixed(0.5)]);
    assert!(spec.model.shared().parameters[3].fixed_levels.is_empty());
}

#[test]
fn a_level_is_fixed_beside_others() {
    let spec = set(&["noise[B 2]=0", "noise[A]=0.9"]).unwrap();
    assert_eq!(spec.model.shared().literals, ["A", "B 2"]);
    let levels: Vec<(usize, f64)> =
        spec.model.shared().parameters[3].fixed_levels.iter().map(|(l, v)| (*l, *v)).collect();
    assert_eq!(levels, [(0, 0.9), (1, 0.0)]);
    assert_eq!(spec.model.shared().parameters[3].value, Value::Free { start: None });
}

#[test]
fn assignments_that_cannot_be_are_refused() {
    let refused = |assignment: &str| set(&[assignment]).expect_err(assignment);
    insta::assert_snapshot!(refused("tua=3"), @r#"
    unknown parameter `tua` in the assignment `tua=3`
    hint did you mean `tau`?
    "#);
    insta::assert_snapshot!(refused("tau=0.5"), @"time constant `tau` is 0.5, expected at least 1, its `lower` bound");
    insta::assert_snapshot!(refused("tau=2000"), @"time constant `tau` is 2000, expected at most 1000, its `upper` bound");
    insta::assert_snapshot!(refused("s=-1"), @"standard deviation `s` is -1, expected 0 or more");
    insta::assert_snapshot!(refused("tau[A]=3"), @r#"
    `tau[A]=3` has no effect on parameter `tau`, which has no `per`
    hint write `tau=3`
    "#);
    insta::assert_snapshot!(refused("tau"), @"`tau` is not an assignment, expected `NAME=NUMBER` or `NAME[LEVEL]=NUMBER`");
    insta::assert_snapshot!(refused("noise[A=3"), @"`noise[A=3` is not an assignment, expected `NAME=NUMBER` or `NAME[LEVEL]=NUMBER`");
    insta::assert_snapshot!(refused("tau=inf"), @"the value of `tau=inf` is inf, expected a finite number");
    insta::assert_snapshot!(refused("tau=a lot"), @"`tau=a lot` is not an assignment, expected `NAME=NUMBER` or `NAME[LEVEL]=NUMBER`");
}
