//! Random designs, and ensembles drawn from the model of a kind.

use kalfit::model::{Column, Value};
use kalfit::simulate::{Designs, Simulator};
use kalfit::{Alpha, Evidence, Labels, PhasedModel, PhasedTest, Source, Test};
use kalfit_spec::Spec;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::kind::Kind;
use crate::setup;

/// Share of measured values that are missing where a kind has gaps: enough for gaps in most tests.
const GAPS: f64 = 0.15;
/// Units of one site, as the kind with sites says.
const UNITS_OF_A_SITE: usize = 4;

/// A test as cells.
#[derive(Debug, Clone)]
pub(super) struct DrawnTest {
    pub(super) id: String,
    /// Rows of each phase.
    pub(super) phases: Vec<Vec<Vec<f64>>>,
    texts: Vec<kalfit::Label>,
}

/// An ensemble that was drawn from its model.
#[derive(Debug, Clone)]
pub(super) struct DrawnEnsemble {
    /// The model with its parameters at the truth.
    pub(super) known: PhasedModel,
    /// The model with its parameters free.
    pub(super) model: PhasedModel,
    pub(super) labels: Labels,
    pub(super) tests: Vec<DrawnTest>,
}

impl Kind {
    /// Draws a design and an ensemble.
    pub(super) fn draw(&self, random: &mut ChaCha8Rng) -> Result<DrawnEnsemble, String> {
        let known = self.known()?;
        let mut labels = Labels::new(&known.shared().literals);
        let mut tests = self.design(&known, &mut labels, random);
        let alpha = Alpha::fixed(&known.shared().parameters).map_err(|error| error.to_string())?;
        let population = setup::independent(self.mean, self.coefficients, self.std_dev);
        let designs: Vec<PhasedTest> = tests.iter().map(DrawnTest::rows).collect();
        let designs = Designs::of(&known, designs).map_err(|error| error.to_string())?;
        let simulator = Simulator::new(&known, &alpha, population, random.random::<u64>() >> 1);
        let simulator = simulator.map_err(|error| error.to_string())?;
        let drawn = simulator.draw(&designs, 0..tests.len() as u64).map_err(|error| error.to_string())?;
        for (test, drawn) in tests.iter_mut().zip(drawn) {
            for (cells, evidence) in test.phases.iter_mut().zip(&drawn.test.phases) {
                let Evidence::Rows(rows) = evidence else { continue };
                *cells = (0..rows.rows()).map(|row| rows.numbers(row).to_vec()).collect();
            }
        }
        let model = with_values(&known, &|_| Value::Free { start: None });
        Ok(DrawnEnsemble { known, model, labels, tests })
    }

    /// The model with its parameters at the truth.
    fn known(&self) -> Result<PhasedModel, String> {
        Ok(Spec::parse(self.name, self.text).map_err(|error| format!("{}: {}", self.name, error.message))?.model)
    }

    fn design(&self, model: &PhasedModel, labels: &mut Labels, random: &mut ChaCha8Rng) -> Vec<DrawnTest> {
        let [least, most] = self.rows;
        let mut within = |[least, most]: [usize; 2]| random.random_range(least..=most);
        let tests_of_unit: Vec<usize> = (0..within(self.units)).map(|_| within(self.tests)).collect();
        let ends = tests_of_unit.iter().enumerate().flat_map(|(unit, tests)| (0..*tests).map(move |test| (unit, test)));
        let mut all = Vec::new();
        for (unit, test) in ends {
            let text = |column: &Column| match column.name.as_str() {
                "site" => format!("s{}", unit / UNITS_OF_A_SITE),
                _ => format!("u{unit}"),
            };
            let texts = model.shared().text_columns.iter().map(|name| labels.intern(&text(name))).collect();
            let phase = |_| {
                let rows = random.random_range(least..=most);
                self.cells(model, rows, random)
            };
            let phases = (0..model.phases.len()).map(phase).collect();
            all.push(DrawnTest { id: format!("u{unit:02}-{test:02}"), phases, texts });
        }
        all
    }

    fn cells(&self, model: &PhasedModel, rows: usize, random: &mut ChaCha8Rng) -> Vec<Vec<f64>> {
        let age: f64 = StandardNormal.sample(random);
        let mut time = 0.0;
        let mut row = |k: usize| {
            time += if self.shared_times { 0.25 } else { random.random_range(0.2..1.5) };
            let mut cell = |name: &str| match name {
                "t" => time,
                "x" => random.random_range(-1.0..1.0),
                "ramp" => 2.0 * (k as f64 + 0.5) / rows as f64 - 1.0,
                "se" => random.random_range(0.2..1.0),
                "age" => age,
                _ if self.gaps && random.random_bool(GAPS) => f64::NAN,
                _ => 0.0,
            };
            model.shared().columns.iter().map(|column| cell(&column.name)).collect()
        };
        (0..rows).map(&mut row).collect()
    }
}

impl DrawnTest {
    fn rows(&self) -> PhasedTest {
        let phase = |cells: &Vec<Vec<f64>>| {
            let width = cells.first().map_or(0, Vec::len);
            let mut rows = Test::new(self.id.as_str(), width, self.texts.len());
            cells.iter().for_each(|row| rows.push(row, &self.texts, Source::default()));
            Evidence::Rows(rows)
        };
        PhasedTest { id: self.id.as_str().into(), phases: self.phases.iter().map(phase).collect() }
    }
}

impl DrawnEnsemble {
    /// The tests as they are read.
    pub(super) fn tests(&self) -> Vec<PhasedTest> {
        self.tests.iter().map(DrawnTest::rows).collect()
    }

    /// Standard deviation of the noise, the first parameter.
    pub(super) fn noise(&self) -> Option<f64> {
        match self.known.shared().parameters.first()?.value {
            Value::Fixed(value) => Some(value),
            Value::Free { .. } => None,
        }
    }

    /// Index of a column.
    pub(super) fn column(&self, name: &str) -> Option<usize> {
        self.model.shared().columns.iter().position(|column| column.name == name)
    }
}

/// The model with other values of its parameters.
pub(super) fn with_values(model: &PhasedModel, value: &dyn Fn(Value) -> Value) -> PhasedModel {
    let mut model = model.clone();
    for phase in model.models_mut() {
        phase.parameters.iter_mut().for_each(|parameter| parameter.value = value(parameter.value));
    }
    model
}
