//! Models and tests of instruments, for tests of searches and intervals.

use kalfit_model::{Initial, Label, Labels, Motion, PhasedModel, PhasedTest, Source, Test, Value};

use crate::by_hand::{
    self, Lcg, alpha, column, gauss_markov, linear, meter, number, over, parameter, square, state, times,
};

/// The parameter that is the drift's time constant.
pub const TAU: usize = 0;
/// The parameter that is the drift's standard deviation.
pub const DRIFT: usize = 1;
/// The parameter that is the standard deviation of the noise.
pub const NOISE: usize = 2;
/// The parameter that multiplies u².
pub const SLOPE: usize = 3;

/// z = bias + scale u + drift + slope u² + noise, with one noise level per sensor, or per test if `per_test`. Columns:
/// t, z, u; text columns: sensor, test.
pub fn model(per_test: bool) -> PhasedModel {
    let terms = vec![(0, number(1.0)), (1, column(2)), (2, number(1.0))];
    let equation = linear(terms, times(alpha(SLOPE), square(column(2))));
    let parameters = vec![
        parameter("tau", Some(1.0), None, true),
        parameter("sigma_drift", Some(0.5), None, true),
        parameter("sigma", Some(0.4), Some(usize::from(per_test)), true),
        parameter("slope", Some(0.0), None, false),
    ];
    let states = vec![
        state("bias", Motion::Constant, Initial::Estimated),
        state("scale", Motion::Constant, Initial::Estimated),
        state("drift", gauss_markov(2, alpha(TAU), alpha(DRIFT)), Initial::Stationary),
    ];
    let names: [&[&str]; 3] = [&["t", "z", "u"], &["sensor", "test"], &["A", "B"]];
    by_hand::model(names, parameters, states, vec![meter("z", 1, equation, square(alpha(NOISE)))]).into()
}

/// Tests of [`model`], the same on every machine. Test j has `rows` + j mod 3 rows.
pub fn ensemble(model: &PhasedModel, tests: usize, rows: usize) -> (Labels, Vec<PhasedTest>) {
    let (mut random, mut labels) = (Lcg(5), Labels::new(&model.shared().literals));
    let mut drawn = Vec::new();
    for j in 0..tests {
        let id = format!("u{j:02}");
        let test_label = labels.intern(&id);
        let mut test = Test::new(&id, 3, 2);
        let (bias, scale) = (1.0 + random.normal(), -0.5 + 0.6 * random.normal());
        let (mut t, mut drift) = (0.0, 0.5 * random.normal());
        for k in 0..rows + j % 3 {
            let dt = if k == 0 { 0.0 } else { 0.3 + 0.4 * (random.next() + 0.5) };
            t += dt;
            let phi = f64::exp(-dt / 1.5);
            drift = phi * drift + 0.5 * (1.0 - phi * phi).sqrt() * random.normal();
            let (u, sensor) = (random.next() * 3.0, usize::from(random.next() > 0.0));
            let noise = if sensor == 0 { 0.3 } else { 0.6 };
            let z = bias + scale * u + drift + 0.2 * u * u + noise * random.normal();
            test.push(&[t, z, u], &[Label::literal(sensor), test_label], Source::default());
        }
        drawn.push(test.into());
    }
    (labels, drawn)
}

/// [`model`] with one free value σ: the measurement noise has the variance σ², the drift noise 3σ²/τ per unit of time.
pub fn scaled_model() -> PhasedModel {
    let mut model = model(false);
    let phase_model = &mut model.phases[0].model;
    for fixed in [TAU, DRIFT, SLOPE] {
        phase_model.parameters[fixed].value = Value::Fixed(if fixed == TAU { 1.5 } else { 0.2 });
    }
    phase_model.parameters[NOISE].per = None;
    let driving = over(times(number(3.0), square(alpha(NOISE))), alpha(TAU));
    if let Motion::Continuous { noise_variance, .. } = &mut phase_model.states[2].motion {
        *noise_variance = driving;
    }
    model
}

/// z = bias + one + two + noise, with two Gauss-Markov processes. Parameters: time constant `tau` and standard
/// deviation `sigma` of `one`, `rest` and `spread` of `two`, standard deviation `noise` of the noise.
pub fn twins() -> PhasedModel {
    let equation = linear(vec![(0, number(1.0)), (1, number(1.0)), (2, number(1.0))], number(0.0));
    let names = ["tau", "sigma", "rest", "spread", "noise"];
    let parameters = names.iter().map(|name| parameter(name, Some(1.0), None, true)).collect();
    let states = vec![
        state("bias", Motion::Constant, Initial::Estimated),
        state("one", gauss_markov(1, alpha(0), alpha(1)), Initial::Stationary),
        state("two", gauss_markov(2, alpha(2), alpha(3)), Initial::Stationary),
    ];
    by_hand::model(
        [&["t", "z", "u"], &["sensor", "test"], &["A", "B"]],
        parameters,
        states,
        vec![meter("z", 1, equation, square(alpha(4)))],
    )
    .into()
}

/// Tests of z = bias + processes + noise, with `rows` rows at unit steps: Gauss-Markov processes of the given (time
/// constant, standard deviation), and white noise of standard deviation `noise`.
pub fn with_processes(processes: &[(f64, f64)], noise: f64, (tests, rows): (usize, usize)) -> Vec<PhasedTest> {
    let mut random = Lcg(5);
    let mut one = |j: usize| {
        let mut test = Test::new(format!("u{j:02}"), 3, 2);
        let bias = random.normal();
        let mut drifts: Vec<f64> = processes.iter().map(|(_, sigma)| sigma * random.normal()).collect();
        for k in 0..rows {
            for (drift, (tau, sigma)) in drifts.iter_mut().zip(processes) {
                let phi = f64::exp(-1.0 / tau);
                *drift = phi * *drift + sigma * (1.0 - phi * phi).sqrt() * random.normal();
            }
            let z = bias + drifts.iter().sum::<f64>() + noise * random.normal();
            test.push(&[k as f64, z, 0.0], &[Label::literal(0), Label::literal(0)], Source::default());
        }
        test.into()
    };
    (0..tests).map(&mut one).collect()
}
