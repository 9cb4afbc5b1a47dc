use super::*;
use crate::ensemble::Labels;
use crate::model::{CovarianceKind, Expression, Initial, Model, Motion, PhasedModel};

fn level() -> ModelBuilder {
    Model::builder("levels").state(constant("level"))
}

fn refused(builder: &ModelBuilder) -> String {
    builder.build().expect_err("it makes no model").to_string()
}

#[test]
fn an_equation_is_taken_apart_into_coefficients_and_a_constant() {
    let equation = 2.0 * (name("a") - name("b") / name("u")) + when(text_is("s", "A"), name("a"), 3.0) - name("c0");
    let model = Model::builder("")
        .state(constant("a"))
        .state(constant("b"))
        .measurement(measurement("y", equation, 1.0))
        .parameter(fixed("c0", 7.0))
        .build()
        .unwrap();
    let mut labels = Labels::new(&model.shared().literals);
    let columns = Columns::new("t").numbers("y", [0.0]).numbers("u", [4.0]).texts("s", ["A"]);
    let test = columns.test(&model, &mut labels).unwrap().joined();
    let alpha = crate::model::Alpha::common([7.0]);
    let value = |e: &Expression, text: &str| {
        let texts = [labels.clone().intern(text)];
        e.evaluate(&crate::model::Scope { numbers: test.numbers(0), texts: &texts, step: 0.0, alpha: &alpha }).unwrap()
    };
    let equation = &model.shared().measurements[0].equation;
    let of = |text: &str| -> Vec<f64> {
        let terms = equation.terms.iter().map(|(_, coefficient)| coefficient);
        terms.chain([&equation.constant]).map(|e| value(e, text)).collect()
    };
    assert_eq!(of("A"), [3.0, -0.5, -7.0]);
    assert_eq!(of("B"), [2.0, -0.5, -4.0]);
}

#[test]
fn what_is_not_linear_in_the_states_is_refused() {
    for equation in
        [name("level") * name("level"), 1.0 / name("level"), name("level").exp(), name("level").less_than(1.0) + 1.0]
    {
        let said = refused(&level().measurement(measurement("y", equation, 1.0)));
        assert_eq!(said, "equation of measurement `y` is not linear in the states");
    }
    let said = refused(&level().measurement(measurement("y", "level", "level")));
    assert_eq!(said, "noise of measurement `y` depends on state `level`, expected columns and parameters only");
}

#[test]
fn names_that_make_no_model_are_refused() {
    let cases = [
        (Model::builder(""), "the model has no states"),
        (level().state(constant("level")), "two states have the name `level`"),
        (level().parameter(free("level")), "a state and a parameter have the name `level`"),
        (level().parameter(free("tau")), "nothing depends on parameter `tau`"),
        (
            level().fix_mean("slope", 0.0),
            "there is no estimated state `slope`, which a constraint on a mean names; there is `level`",
        ),
        (
            level().noise_covariance("y", "z", 0.1),
            "there is no measurement `y`, which noise covariance of `y` and `z` names; there is none",
        ),
        (
            level().state(gauss_markov("drift", 1.0, 1.0)),
            "state `drift` needs times, and the model names no column of times",
        ),
        (
            level().measurement(measurement("y", dt() * name("level"), 1.0)),
            "equation of measurement `y` needs times, and the model names no column of times",
        ),
        (
            level().state(constant("c").stationary()),
            "the motion of state `c`, which never settles, does not go with a stationary start",
        ),
        (
            level().state(constant("c").known(0.0, 1.0).common()),
            "one value common to all tests does not go with the start of state `c`, which is not estimated",
        ),
    ];
    for (builder, expected) in cases {
        assert_eq!(refused(&builder), expected);
    }
}

#[test]
fn numbers_that_cannot_be_are_refused() {
    let noisy = |parameter| level().measurement(measurement("y", "level", "s")).parameter(parameter);
    let cases = [
        (level().measurement(measurement("y", "level", -1.0)), "noise of measurement `y` is -1, expected 0 or more"),
        (
            level().measurement(measurement("y", f64::NAN * name("level"), 1.0)),
            "a number in equation of measurement `y` is NaN, expected a finite number",
        ),
        (level().time("t").state(gauss_markov("d", 0.0, 1.0)), "time constant of state `d` is 0, expected more than 0"),
        (noisy(fixed("s", -2.0)), "parameter `s` is -2, expected 0 or more"),
        (noisy(free("s").start(0.0)), "the start of parameter `s` is 0, expected more than 0"),
        (noisy(free("s").start(3.0).upper(2.0)), "parameter `s` is 3, expected at most 2, its upper bound"),
        (
            noisy(free("s").lower(3.0).upper(2.0)),
            "the upper bound of parameter `s` is 2, expected more than the lower one, 3",
        ),
        (
            level().fix_covariance("level", "level", -1.0),
            "the covariance of `level` and `level` is -1, expected 0 or more",
        ),
        (level().known_covariance(nalgebra::DMatrix::zeros(2, 2)), "the known covariance is 2 × 2, expected 1 × 1"),
    ];
    for (builder, expected) in cases {
        assert_eq!(refused(&builder), expected);
    }
}

#[test]
fn a_second_order_process_brings_a_hidden_rate_that_is_not_estimated() {
    let model = level().time("t").state(gauss_markov_2("drift", 2.0, 3.0)).build().unwrap();
    let shared = model.shared();
    assert_eq!(shared.states.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["level", "drift", "drift (rate)"]);
    assert_eq!((model.estimated_names(), &shared.states[2].initial), (vec!["level".to_owned()], &Initial::Stationary));
    let Motion::Continuous { derivative, noise_variance } = &shared.states[2].motion else { panic!("it moves") };
    // β = 1/2: -β² on the state, -2β on its rate, noise of 4β³σ²
    assert_eq!(derivative.terms, [(1, Expression::Number(-0.25)), (2, Expression::Number(-1.0))]);
    assert_eq!(*noise_variance, Expression::Number(4.5));
}

#[test]
fn constraints_are_by_name() {
    let model = level()
        .state(constant("a"))
        .state(constant("b").common())
        .fix_mean("a", 0.5)
        .tie_mean("level", 1.0, [("b", 2.0)])
        .regress_mean("b", "temperature")
        .blocks(&[&["level", "b"]])
        .build()
        .unwrap();
    let shared = model.shared();
    assert_eq!(shared.covariance.kind, CovarianceKind::Blocks(vec![vec![0, 2], vec![1]]));
    assert_eq!(shared.covariance.fixed.len(), 1, "a common state has no variance");
    assert_eq!(shared.mean.basis().0, [1.0, 0.5, 0.0]);
    assert_eq!(shared.columns[shared.mean.regression[0].column].name, "temperature");
    let tied = level().state(constant("a")).tie_mean("a", 0.0, [("level", 1.0)]).tie_mean("level", 0.0, [("a", 1.0)]);
    assert_eq!(refused(&tied), "a tie of the mean of `level` does not go with one of `a`, which is tied itself");
}

#[test]
fn phases_share_columns_and_parameters() {
    let shared = level().parameter(free("s"));
    let model = PhasedModel::builder("when")
        .phase(phase("a", &shared.clone().measurement(measurement("y", "level", "s"))))
        .phase(
            phase("b", &shared.clone().measurement(measurement("z", "level", "s"))).carry("level", 2.0 * name("level")),
        )
        .build()
        .unwrap();
    let of = |i: usize| -> Vec<&str> { model.phases[i].model.columns.iter().map(|c| c.name.as_str()).collect() };
    assert_eq!((of(0), of(1)), (vec!["y", "z"], vec!["y", "z"]));
    assert_eq!(model.phases[1].carry[0].from.terms, [(0, Expression::Number(2.0))]);
    let wrong = |second: PhaseBuilder| {
        let first = phase("a", &shared.clone().measurement(measurement("y", "level", "s")));
        PhasedModel::builder("when").phase(first).phase(second).build().unwrap_err().to_string()
    };
    assert_eq!(wrong(phase("a", &level())), "two phases have the name `a`");
    let other = level().parameter(free("s").start(2.0)).measurement(measurement("y", "level", "s"));
    assert_eq!(wrong(phase("b", &other)), "phase `b` has another parameter `s` than the phases before it");
    let strange = phase("b", &level()).carry("level", name("slope") * name("slope"));
    assert_eq!(
        wrong(strange.carry("nothing", 0.0)),
        "there is no state `nothing`, which what state `nothing` of phase `b` inherits names; there is `level`"
    );
    let first = PhasedModel::builder("when").phase(phase("a", &level()).carry("level", "level"));
    assert_eq!(
        first.build().unwrap_err().to_string(),
        "phase `a` is the first one, and carries over what was before it"
    );
}

#[test]
fn columns_that_are_not_those_of_the_model_are_refused() {
    let model = level().measurement(measurement("y", "level", "s")).build().unwrap();
    let refused = |columns: Columns| columns.test(&model, &mut Labels::default()).unwrap_err().to_string();
    let good = || Columns::new("t").numbers("y", [1.0, 2.0]);
    assert_eq!(refused(good()), "test `t` has no column `s`, which noise of measurement `y` reads; it has y");
    assert_eq!(
        refused(good().numbers("s", [1.0])),
        "column `s` of test `t` has 1 rows, expected 2 as in the columns before it"
    );
    assert_eq!(refused(good().every_number("y", 1.0)), "test `t` has two columns `y`");
    assert_eq!(
        refused(good().numbers("s", [1.0, f64::INFINITY])),
        "column `s` of test `t` is inf at row 2, expected a finite number, or NaN for a missing one"
    );
}
