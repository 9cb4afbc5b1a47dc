use super::*;
use crate::build::{
    Formula, StateBuilder, constant, dt, free, gauss_markov, gauss_markov_2, measurement, moving, name, stepping,
    variance, when,
};
use crate::build::{ModelBuilder, Noise};
use crate::model::GroupLevel;

const STANDARD_DEVIATION: Role = Role::Scale { power: 2 };
const VARIANCE: Role = Role::Scale { power: 1 };

/// Roles of the named parameters, which are added to the model as free ones.
fn found(builder: ModelBuilder, names: &[&str]) -> Vec<Role> {
    let model = names.iter().fold(builder, |builder, name| builder.parameter(free(*name))).build().unwrap();
    roles(&model)
}

fn noise(noise: impl Into<Noise>) -> ModelBuilder {
    crate::model::Model::builder("").time("t").state(constant("x")).measurement(measurement("y", "x", noise))
}

fn state(state: StateBuilder) -> ModelBuilder {
    noise(1.0).state(state)
}

fn n(text: &str) -> Formula {
    name(text)
}

#[test]
fn what_only_scales_noise_has_no_sign_of_its_own() {
    let first = || n("first").equals(1.0);
    for (formula, parameters) in [
        (n("s"), vec!["s"]),
        (when(first(), n("s"), 0.0), vec!["s"]),
        (when(first(), n("s") * n("column"), n("r") * n("s") / 2.0), vec!["s", "r"]),
        (n("s") * (1.0 + n("column") * 2.0) / n("r"), vec!["s", "r"]),
        ((n("s").power(2.0) + n("r").power(2.0) * n("column")).sqrt(), vec!["s", "r"]),
        (-(n("s") * n("s")) + n("column"), vec!["s"]),
        (n("s") * n("column") + n("s"), vec!["s"]),
    ] {
        let all = found(noise(formula.clone()), &parameters);
        assert!(all.iter().all(|role| *role == STANDARD_DEVIATION), "{formula:?}: {all:?}");
    }
    for (formula, parameters) in [
        (n("v"), vec!["v"]),
        (n("v") * n("w") / n("column"), vec!["v", "w"]),
        (when(first(), n("v"), n("w")), vec!["v", "w"]),
        (n("known") + n("v") + 2.0 * n("w"), vec!["v", "w"]),
        (n("v") - n("v") * n("column"), vec!["v"]),
    ] {
        let all = found(noise(variance(formula.clone())), &parameters);
        assert!(all.iter().all(|role| *role == VARIANCE), "{formula:?}: {all:?}");
        let root = found(noise(formula.clone().sqrt()), &parameters);
        assert!(root.iter().all(|role| *role == VARIANCE), "√ {formula:?}: {root:?}");
    }
    let both = n("known") + n("s").power(2.0) / n("column") + n("v");
    assert_eq!(found(noise(variance(both)), &["s", "v"]), [STANDARD_DEVIATION, VARIANCE]);
}

#[test]
fn what_may_take_either_sign_is_no_scale() {
    for (formula, parameter) in [
        (n("a") + 0.1 * n("column"), "a"),
        (0.1 + n("a") * n("column"), "a"),
        (n("a").exp(), "a"),
        (n("a").cos(), "a"),
        (when(n("a").equals(1.0), 1.0, 2.0), "a"),
        (2.0 * (1.0 + n("a")), "a"),
    ] {
        assert_eq!(found(noise(formula.clone()), &[parameter]), [Role::Other], "{formula:?}");
    }
    for formula in [n("a") * n("column") + 0.5, 1.0 - n("a"), -n("a"), n("a") * -2.0, n("a") + n("a") * n("a") + 1.0] {
        let role = found(noise(variance(formula.clone())), &["a"]);
        let natural = formula == n("a") + n("a") * n("a") + 1.0;
        assert_eq!(role, [if natural { VARIANCE } else { Role::Other }], "{formula:?}");
    }
    // a rising line may begin below zero
    assert_eq!(found(noise(variance(n("a") + n("b") * n("column"))), &["a", "b"]), [Role::Other; 2]);
}

#[test]
fn a_use_elsewhere_gives_a_sign_to_what_scales_noise() {
    let equation = |noise| {
        let level = crate::model::Model::builder("").state(constant("x"));
        level.measurement(measurement("y", n("x") * n("k"), noise))
    };
    assert_eq!(found(equation(n("k") * n("s")), &["k", "s"]), [Role::Other, STANDARD_DEVIATION]);
    let stationary = stepping("u", n("f") * n("u"), n("s") * (1.0 - n("f").power(2.0)).sqrt());
    assert_eq!(found(state(stationary), &["f", "s"]), [Role::Other, STANDARD_DEVIATION]);
    let known = state(moving("u", 0.0, 0.0).known("m", when(n("c").equals(1.0), n("s"), 0.0)));
    assert_eq!(found(known, &["m", "s"]), [Role::Other, STANDARD_DEVIATION]);
}

#[test]
fn standard_deviations_may_share_a_correlation_and_loadings_have_signs() {
    let first = || n("first").equals(1.0);
    let redrawn = |own: &str, s: &str| stepping(own, when(first(), 0.0, n(own)), when(first(), n(s), 0.0));
    let both = || state(redrawn("u", "s")).state(redrawn("w", "r"));
    let product = when(first(), n("rho") * n("s") * n("r"), 0.0);
    let roles = found(both().process_noise_covariance("u", "w", product), &["s", "r", "rho"]);
    assert_eq!(roles, [STANDARD_DEVIATION, STANDARD_DEVIATION, Role::Other]);
    let free = found(both().process_noise_covariance("u", "w", n("q")), &["s", "r", "q"]);
    assert_eq!(free, [STANDARD_DEVIATION, STANDARD_DEVIATION, Role::Other]);
    let loaded = |own: &str, l: &str| stepping(own, n(own), (n(l).power(2.0) + n("u2")).sqrt());
    let loadings = state(loaded("u", "l")).state(loaded("w", "m")).process_noise_covariance("u", "w", n("l") * n("m"));
    assert_eq!(found(loadings, &["l", "m", "u2"]), [Role::Other, Role::Other, VARIANCE]);
    // one shock moves both states: theta is a deviation of one, and the sign of the covariance
    let shocked = |size: Formula| state(stepping("u", n("u"), n("s"))).state(stepping("w", n("w"), size * n("s")));
    let moved = shocked(n("theta").abs()).process_noise_covariance("u", "w", n("theta") * n("s").power(2.0));
    assert_eq!(found(moved, &["theta", "s"]), [Role::Other, STANDARD_DEVIATION]);
    let even = shocked(n("theta")).process_noise_covariance("u", "w", n("theta").abs() * n("s").power(2.0));
    assert_eq!(found(even, &["theta", "s"]), [STANDARD_DEVIATION; 2]);
    let exchangeable = state(stepping("u", n("u"), n("v").sqrt())).state(stepping("w", n("w"), n("v").sqrt()));
    assert_eq!(found(exchangeable.process_noise_covariance("u", "w", 0.5 * n("v")), &["v"]), [VARIANCE]);
}

#[test]
fn time_constants_are_told_by_the_motion() {
    let lot = || n("lot").equals(1.0);
    let own = |rate: Formula| moving("u", rate * n("u"), n("s") * (2.0 / n("tau")).sqrt());
    let settles = || stepping("u", (-dt() / n("tau")).exp() * n("u"), n("s") * (1.0 - (-2.0 * dt() / n("tau")).exp()));
    for (state_of, what) in [
        (gauss_markov("u", "tau", "s"), "a process"),
        (gauss_markov("u", 2.0 * n("tau"), when(lot(), n("s"), 0.0)), "twice"),
        (gauss_markov_2("u", when(lot(), n("tau"), 3.0), "s"), "an alternative"),
        (own(-1.0 / n("tau")), "a derivative"),
        (moving("u", (n("input") - n("u")) / n("tau"), "s"), "a lag"),
        (settles(), "a step"),
    ] {
        assert_eq!(found(state(state_of), &["tau", "s"]), [Role::TimeConstant, STANDARD_DEVIATION], "{what}");
    }
    for (state_of, what) in [
        (moving("u", n("u") / n("tau"), "s"), "growth"),
        (moving("u", n("tau") * n("u"), "s"), "a rate"),
        (moving("u", n("x") / n("tau"), "s"), "a coupling"),
        (stepping("u", (dt() * n("tau")).exp() * n("u"), "s"), "a rate of steps"),
    ] {
        assert_eq!(found(state(state_of), &["tau", "s"]), [Role::Other, STANDARD_DEVIATION], "{what}");
    }
}

#[test]
fn a_parameter_may_stand_in_the_covariance_of_a_level_of_groups() {
    let mut model = noise(n("s")).parameter(free("s")).build().unwrap();
    let matrix = vec![vec![Expression::Parameter(0)]];
    let covariance = CovarianceStructure { kind: CovarianceKind::Fixed(matrix), ..CovarianceStructure::full() };
    model.levels.push(GroupLevel {
        name: "unit".to_owned(),
        column: 0,
        crossed: false,
        covariance,
        members: Vec::new(),
    });
    assert_eq!(roles(&model), [VARIANCE], "a standard deviation there, and a variance here");
}
