//! A model built in code is the model that its file describes: both give one fit of the same tests.

use kalfit::build::{
    Columns, ModelBuilder, constant, dt, fixed, free, gauss_markov, gauss_markov_2, integral, measurement, moving,
    name, phase, random_walk, stepping, text_is, variance, when,
};
use kalfit::{Ensemble, Model, PhasedModel};
use kalfit_spec::Spec;

/// Tests with all columns that the models here read; irregular times, some cells missing.
fn tests() -> Vec<Columns> {
    let one = |j: usize| {
        let steps = 7 + j % 4;
        let at = |f: &dyn Fn(f64) -> f64| (0..steps).map(|k| f(k as f64)).collect::<Vec<f64>>();
        let phase = |k: usize| if k < 4 { "a" } else { "b" };
        Columns::new(format!("t{j}"))
            .numbers("t", at(&|k| 0.5 * k + 0.1 * (k * 1.7).sin()))
            .numbers("u", at(&|k| (0.9 * k + j as f64).cos()))
            .numbers("y", at(&|k| if k == 3.0 { f64::NAN } else { (1.3 * k + j as f64 * 0.7).sin() + 0.2 * j as f64 }))
            .numbers("z", at(&|k| (0.4 * k - j as f64).cos()))
            .every_number("temperature", 20.0 + j as f64)
            .every_text("lot", if j.is_multiple_of(3) { "A" } else { "B" })
            .texts("phase", (0..steps).map(phase))
    };
    (0..9).map(one).collect()
}

fn compare(file: &str, built: &PhasedModel) {
    let spec = Spec::parse("m.toml", file).expect("a sound file");
    let [from_file, in_code] =
        [&spec.model, built].map(|model| Ensemble::new(model, &tests()).expect("sound tests").fit().expect("a fit"));
    assert_eq!(spec.model.estimated_names(), built.estimated_names());
    let (expected, found) = (from_file.log_likelihood(), in_code.log_likelihood());
    assert!((expected - found).abs() < 1e-8 * expected.abs(), "{expected} from the file, {found} in code");
    assert_eq!(from_file.record.free_parameters, in_code.record.free_parameters);
    for (a, b) in from_file.estimate.mean.iter().zip(&in_code.estimate.mean) {
        assert!((a - b).abs() < 1e-6 * (1.0 + a.abs()), "{a} from the file, {b} in code");
    }
    let parameters = from_file.record.parameters.iter().zip(&in_code.record.parameters);
    for (a, b) in parameters {
        assert_eq!((&a.name, &a.level, a.fixed), (&b.name, &b.level, b.fixed));
        assert!((a.estimate - b.estimate).abs() < 1e-4 * a.estimate.abs(), "{a:?} from the file, {b:?} in code");
    }
}

fn bias() -> ModelBuilder {
    Model::builder("").state(constant("bias"))
}

#[test]
fn processes_in_continuous_time() {
    let file = r#"
        [data]
        test = "id"
        time = "t"
        initial_time = -1.0
        [states.bias]
        [states.slow]
        process = "gauss-markov"
        time_constant = "tau"
        sigma = 0.4
        [states.smooth]
        process = "gauss-markov-2"
        time_constant = 2
        sigma = "0.3 * s"
        [states.walk]
        process = "random-walk"
        noise_density = 0.1
        initial = { mean = 0, sigma = 0.5 }
        [states.angle]
        process = "integral"
        of = "bias + u * slow"
        initial = { mean = 0.1, sigma = 0 }
        [states.own]
        derivative = "-0.5 * own + walk - 0.1 * u"
        noise_density = 0.2
        offset = "0.01 * temperature"
        [process_noise_covariance]
        "own, walk" = 0.01
        [measurements.y]
        column = "y"
        equation = "bias + slow + if(lot == 'A', 1, 2) * smooth - (angle - own) / 4 + 0.1"
        noise = "if(u > 0 and lot == 'B', 0.2, 0.3)"
        [measurements.z]
        column = "z"
        equation = "walk + dt * bias"
        variance = "0.04 + u ^ 2"
        [noise_covariance]
        "y, z" = 0.01
        [parameters]
        tau = 1.5
        s = 1
        [mean]
        fixed = { own = 0.3 }
        [mean.regression]
        bias = ["temperature"]
        [covariance]
        structure = "diagonal"
    "#;
    let noise = when(name("u").more_than(0.0).and(text_is("lot", "B")), 0.2, 0.3);
    let built = bias()
        .time("t")
        .initial_time(-1.0)
        .state(gauss_markov("slow", "tau", 0.4))
        .state(gauss_markov_2("smooth", 2.0, 0.3 * name("s")))
        .state(random_walk("walk", 0.1).known(0.0, 0.5))
        .state(integral("angle", name("bias") + name("u") * name("slow")).known(0.1, 0.0))
        .state(
            moving("own", -0.5 * name("own") + name("walk") - 0.1 * name("u"), 0.2).offset(0.01 * name("temperature")),
        )
        .process_noise_covariance("own", "walk", 0.01)
        .measurement(measurement(
            "y",
            name("bias") + "slow" + when(text_is("lot", "A"), 1.0, 2.0) * "smooth" - (name("angle") - "own") / 4.0
                + 0.1,
            noise,
        ))
        .measurement(measurement("z", name("walk") + dt() * "bias", variance(0.04 + name("u").power(2.0))))
        .noise_covariance("y", "z", 0.01)
        .parameter(fixed("tau", 1.5))
        .parameter(fixed("s", 1.0))
        .fix_mean("own", 0.3)
        .regress_mean("bias", "temperature")
        .diagonal();
    compare(file, &built.build().unwrap());
}

#[test]
fn processes_from_step_to_step_with_levels_to_be_found() {
    let file = r#"
        [data]
        test = "id"
        step_first = true
        inputs = "previous"
        [states.bias]
        [states.common]
        random = false
        [states.x]
        next = "0.8 * x"
        step_noise = 0.2
        initial = "stationary"
        [states.walk]
        next = "walk + 0.1 * u"
        step_noise = 0.05
        [measurements.y]
        column = "y"
        equation = "bias + x"
        noise = "sigma"
        [measurements.z]
        column = "z"
        where = "u < 0.5"
        equation = "walk + common * u"
        noise = 0.3
        [parameters]
        sigma = { start = 0.5, per = "lot", fixed = { B = 0.6 } }
        [covariance]
        structure = "blocks"
        blocks = [["bias", "walk"]]
    "#;
    let built = bias()
        .step_first()
        .previous_inputs()
        .state(constant("common").common())
        .state(stepping("x", 0.8 * name("x"), 0.2).stationary())
        .state(stepping("walk", name("walk") + 0.1 * name("u"), 0.05))
        .measurement(measurement("y", name("bias") + "x", "sigma"))
        .measurement(measurement("z", name("walk") + name("common") * "u", 0.3).only_where(name("u").less_than(0.5)))
        .parameter(free("sigma").start(0.5).per("lot").fixed_at("B", 0.6))
        .blocks(&[&["bias", "walk"]]);
    compare(file, &built.build().unwrap());
}

#[test]
fn phases_that_carry() {
    let file = r#"
        [data]
        test = "id"
        time = "t"
        phase = "phase"
        [states.bias]
        [states.x]
        derivative = "bias - 0.2 * x"
        noise_density = 0.3
        [phases.a.measurements.y]
        column = "y"
        equation = "x"
        noise = 0.2
        [phases.b.carry]
        bias = "bias"
        x = "0.5 * x + bias * gain"
        [phases.b.measurements.z]
        column = "z"
        equation = "x + bias"
        noise = 0.2
        [parameters]
        gain = 0.7
    "#;
    let shared = bias().time("t").state(moving("x", name("bias") - 0.2 * name("x"), 0.3)).parameter(fixed("gain", 0.7));
    let first = shared.clone().measurement(measurement("y", "x", 0.2));
    let second = shared.measurement(measurement("z", name("x") + "bias", 0.2));
    let second = phase("b", &second).carry("bias", "bias").carry("x", 0.5 * name("x") + name("bias") * "gain");
    compare(file, &PhasedModel::builder("phase").phase(phase("a", &first)).phase(second).build().unwrap());
}
