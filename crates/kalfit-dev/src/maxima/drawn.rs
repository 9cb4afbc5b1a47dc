//! Random models with the values and the data that they are drawn with.

use std::fmt::Write as _;

use kalfit::dynamic::{self, DynamicFit};
use kalfit::estimate::Silent;
use kalfit::model::{Level, Value};
use kalfit::reduce::Evidence;
use kalfit::simulate::{Designs, Simulator};
use kalfit::{Alpha, Labels, PhasedModel, PhasedTest, Population, Source, Test};
use kalfit_spec::Spec;
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Spread of random starts: standard deviation of a logarithm.
const SPREAD: f64 = 1.5;

/// A model with the values it is drawn with.
pub(super) struct DrawnModel {
    pub(super) kind: String,
    pub(super) text: String,
    pub(super) model: PhasedModel,
    pub(super) truth: Vec<f64>,
    /// Whether each parameter is known to fits, at the truth.
    pub(super) known: Vec<bool>,
    pub(super) tests: Vec<PhasedTest>,
}

impl DrawnModel {
    /// Draws a model, its values, a design and the data.
    pub(super) fn new(random: &mut ChaCha8Rng, seed: u64) -> DrawnModel {
        loop {
            let (kind, text, truth) = model(random);
            let spec = Spec::parse("model", &text).unwrap_or_else(|error| panic!("{}\n{text}", error.message));
            let model = spec.model;
            if let Some(tests) = data(&model, &truth, random, seed) {
                let known = vec![false; truth.len()];
                return DrawnModel { kind, text, model, truth, known, tests };
            }
        }
    }

    /// The model with every other parameter known on average, but not all, drawn from another stream of the seed.
    pub(super) fn with_known(mut self, seed: u64) -> DrawnModel {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(1);
        self.known.iter_mut().for_each(|known| *known = random.random_bool(0.5));
        let one = random.random_range(0..self.known.len());
        self.known[one] = false;
        self
    }

    /// The truth with the values of a fit in the places of the parameters that are free.
    pub(super) fn with_free(&self, free: &[f64]) -> Vec<f64> {
        let mut free = free.iter();
        let value = |(truth, known): (&f64, &bool)| if *known { *truth } else { *free.next().unwrap_or(truth) };
        self.truth.iter().zip(&self.known).map(value).collect()
    }

    /// The data as a table.
    pub(super) fn table(&self) -> String {
        let names: Vec<&str> = self.model.shared().columns.iter().map(|column| column.name.as_str()).collect();
        let mut table = format!("test,{}\n", names.join(","));
        for test in &self.tests {
            for rows in
                test.phases.iter().filter_map(|phase| if let Evidence::Rows(rows) = phase { Some(rows) } else { None })
            {
                for row in 0..rows.rows() {
                    let cells: Vec<String> = rows.numbers(row).iter().map(f64::to_string).collect();
                    let _ = writeln!(table, "{},{}", test.id, cells.join(","));
                }
            }
        }
        table
    }

    /// The model with the parameters free that are not known.
    pub(super) fn free(&self, starts: Option<&[f64]>) -> PhasedModel {
        let mut model = self.model.clone();
        for phase in model.models_mut() {
            for (at, parameter) in phase.parameters.iter_mut().enumerate() {
                parameter.value = match self.known[at] {
                    true => Value::Fixed(self.truth[at]),
                    false => Value::Free { start: starts.map(|starts| starts[at]) },
                };
            }
        }
        model
    }

    /// The fit of the model in one of its forms.
    pub(super) fn fit(&self, model: &PhasedModel) -> Option<DynamicFit> {
        dynamic::fit(model, &Labels::default(), &self.tests, &dynamic::Settings::default(), &mut Silent).ok()
    }

    /// Random starts.
    pub(super) fn scattered(&self, random: &mut ChaCha8Rng) -> Vec<f64> {
        let parameters = &self.model.shared().parameters;
        let one = |(value, parameter): (&f64, &kalfit::model::Parameter)| {
            let draw: f64 = StandardNormal.sample(random);
            if parameter.positive { value.max(0.05) * (SPREAD * draw).exp() } else { 0.0 }
        };
        self.truth.iter().zip(parameters).map(one).collect()
    }
}

fn data(model: &PhasedModel, truth: &[f64], random: &mut ChaCha8Rng, seed: u64) -> Option<Vec<PhasedTest>> {
    let columns = &model.shared().columns;
    let (count, rows) = (random.random_range(8..=20), random.random_range(6..=24));
    let test = |k: usize| {
        let mut test = Test::new(format!("t{k:02}"), columns.len(), 0);
        let mut time = 0.0;
        for _ in 0..rows {
            let cells: Vec<f64> = columns.iter().map(|column| if column.name == "t" { time } else { 0.0 }).collect();
            test.push(&cells, &[], Source::default());
            time += random.random_range(0.2..1.5);
        }
        PhasedTest::from(test)
    };
    let designs = Designs::new((0..count).map(test).collect()).ok()?;
    let p = model.shared().dimension();
    let alpha = Alpha { values: truth.iter().map(|value| Level::Common(*value)).collect() };
    let population = Population {
        mean: vec![1.0; p],
        coefficients: vec![],
        covariance: DMatrix::from_fn(p, p, |i, k| if i == k { 1.0 } else { 0.3 }),
    };
    let simulator = Simulator::new(model, &alpha, population, seed).ok()?;
    let drawn = simulator.draw(&designs, 0..count as u64).ok()?;
    Some(drawn.into_iter().map(|drawn| drawn.test).collect())
}

/// A model file without start values and the values of its parameters, in their order.
fn model(random: &mut ChaCha8Rng) -> (String, String, Vec<f64>) {
    let mut states = String::from("[states.a]\n");
    let (mut equation, mut parameters, mut truth) = (String::from("a"), String::new(), Vec::new());
    let mut add = |parameters: &mut String, name: &str, value: f64| {
        let _ = writeln!(parameters, "{name} = {{}}");
        truth.push(value);
    };
    let processes = random.random_range(1..=3);
    let mut kinds: Vec<&str> = Vec::new();
    let mut shared_time = None;
    for k in 0..processes {
        let zero = random.random_bool(0.2);
        let level = if zero { 0.0 } else { random.random_range(0.2..1.0) };
        let _ = write!(equation, " + p{k}");
        match random.random_range(0..4) {
            0 => {
                kinds.push("walk");
                let _ = writeln!(
                    states,
                    "[states.p{k}]\nprocess = \"random-walk\"\nnoise_density = \"s{k}\"\ninitial = {{ mean = 0, sigma = 0 }}"
                );
            }
            _ => {
                kinds.push("gauss-markov");
                // now and then as long as another's: one of the two is redundant
                let time = shared_time.filter(|_| random.random_bool(0.3));
                let time = time.unwrap_or_else(|| random.random_range(-1.0_f64..3.0).exp());
                shared_time = Some(time);
                let _ = writeln!(
                    states,
                    "[states.p{k}]\nprocess = \"gauss-markov\"\ntime_constant = \"tau{k}\"\nsigma = \"s{k}\""
                );
                add(&mut parameters, &format!("tau{k}"), time);
            }
        }
        add(&mut parameters, &format!("s{k}"), level);
    }
    kinds.sort_unstable();
    let white = if random.random_bool(0.2) { 0.0 } else { random.random_range(0.1..0.6) };
    let mut measurements = format!("[measurements.y]\ncolumn = \"y\"\nequation = \"{equation}\"\nnoise = \"s\"\n");
    add(&mut parameters, "s", white);
    match random.random_range(0..4) {
        0 => {
            kinds.push("two instruments");
            measurements += "[measurements.z]\ncolumn = \"z\"\nequation = \"a - 0.3 * p0\"\nnoise = \"r\"\n";
            add(&mut parameters, "r", if random.random_bool(0.2) { 0.05 } else { 0.3 });
        }
        1 => {
            kinds.push("noise covariance");
            measurements += "[measurements.z]\ncolumn = \"z\"\nequation = \"a - 0.3 * p0\"\nnoise = \"r\"\n";
            measurements += "[noise_covariance]\n\"y, z\" = \"c\"\n";
            let r = random.random_range(0.1..0.5);
            add(&mut parameters, "r", r);
            let part = if random.random_bool(0.3) { 1.0 } else { random.random_range(-0.9..0.9) };
            add(&mut parameters, "c", part * r * white);
        }
        _ => {}
    }
    let text = format!("[data]\ntest = \"test\"\ntime = \"t\"\n{states}{measurements}[parameters]\n{parameters}");
    (kinds.join(", "), text, truth)
}
