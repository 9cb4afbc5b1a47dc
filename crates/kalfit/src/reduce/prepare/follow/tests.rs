//! Steps taken many at a time against the same steps one by one.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::build::{Formula, constant, measurement, moving, name, stepping, variance};
use crate::ensemble::{Source, Test};
use crate::model::{Alpha, Model};
use crate::reduce::prepare::{Preparer, Workspace};

/// When steps are, and which row their inputs stand in.
#[derive(Debug, Clone, Copy)]
enum Clock {
    Rows,
    Times,
    TimesBefore,
}

/// A random constant and a drift, seen by two measurements; `input` drives the drift.
fn model(clock: Clock, input: Formula) -> Model {
    let (drift, begun) = match clock {
        Clock::Rows => (stepping("drift", 0.7 * name("drift") + input, 0.4), Model::builder("")),
        Clock::Times => (moving("drift", input - 0.3 * name("drift"), 0.4), Model::builder("").time("t")),
        Clock::TimesBefore => {
            (moving("drift", input - 0.3 * name("drift"), 0.4), Model::builder("").time("t").previous_inputs())
        }
    };
    let model = begun
        .state(constant("constant"))
        .state(drift.known(0.1, 1.0))
        .measurement(measurement("z", name("u") * (name("constant") + 0.5) + name("drift"), variance(name("r"))))
        .measurement(measurement("w", 0.5 * name("constant") + name("v") * name("u") * name("drift"), 0.7));
    model.build().expect("a sound model").phases.remove(0).model
}

/// Rows that often repeat each other, some with measurements missing, some at the time of the one before; few have a cell that
/// cannot be.
fn test(model: &Model, rng: &mut ChaCha8Rng) -> Test {
    let mut test = Test::new("t1", model.columns.len(), 0);
    let (mut inputs, mut time) = ([1.0; 3], 0.0);
    for _ in 0..rng.random_range(1..40) {
        time += [0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0][rng.random_range(0..8)];
        for cell in &mut inputs {
            if rng.random_range(0..3) == 0 {
                *cell = [1.0, 2.0, 0.0, 0.25][rng.random_range(0..4)];
            }
        }
        let mut row: Vec<f64> = Vec::new();
        for column in &model.columns {
            row.push(match &*column.name {
                "t" => time,
                "u" => inputs[0],
                "v" => inputs[1],
                "r" => inputs[2],
                _ if rng.random_range(0..8) == 0 => f64::NAN,
                _ => rng.random_range(-1.0..1.0),
            });
        }
        if rng.random_range(0..200) == 0 {
            let at = rng.random_range(0..row.len());
            row[at] = [f64::NAN, f64::INFINITY, -1.0][rng.random_range(0..3)];
        }
        test.push(&row, &[], Source::default());
    }
    test
}

/// All that a preparation leaves, to the bit.
fn left(preparer: &Preparer, test: &Test, work: &mut Workspace) -> Result<String, String> {
    preparer.prepare(test, work).map_err(|fault| format!("{fault:?}"))?;
    let Workspace { design, data, instances, constants, .. } = &*work;
    let bits = |numbers: &[f64]| numbers.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
    let numbers = [&design.h, &design.noise, &data.values, &data.sizes, &data.inputs, constants].map(|all| bits(all));
    let moves: Vec<[Vec<u64>; 2]> = design.moves.iter().map(|own| [bits(&own.phi), bits(&own.q)]).collect();
    let all: Vec<_> = instances.iter().collect();
    let last = (instances.last_step(), instances.first_row());
    Ok(format!("{:?} {:?} {:?} {moves:?} {numbers:?} {all:?} {last:?}", design.runs, design.ends, design.states))
}

#[test]
fn steps_taken_together_are_those_taken_one_by_one() {
    let clocks = [Clock::Rows, Clock::Times, Clock::TimesBefore];
    let inputs = [Formula::from(0.3), 0.3 * name("v"), name("v") * name("u")];
    let mut rng = ChaCha8Rng::seed_from_u64(1980);
    let (mut sound, mut refused) = (0, 0);
    for (clock, input) in clocks.iter().flat_map(|clock| inputs.iter().map(move |input| (clock, input))) {
        let model = model(*clock, input.clone());
        let together = Preparer::new(&model, &Alpha::default()).expect("a sound model");
        let mut one_by_one = Preparer::new(&model, &Alpha::default()).expect("a sound model");
        assert!(std::mem::take(&mut one_by_one.follows), "rows of this model can follow each other");
        let (mut work, mut other_work) = (together.workspace(), one_by_one.workspace());
        for _ in 0..300 {
            let test = test(&model, &mut rng);
            let found = left(&together, &test, &mut work);
            assert_eq!(found, left(&one_by_one, &test, &mut other_work), "{clock:?}, {input:?}: {test:?}");
            *(if found.is_ok() { &mut sound } else { &mut refused }) += 1;
        }
    }
    println!("{sound} sound tests, {refused} refused ones");
    assert!(sound > 1500 && refused > 100, "{sound} sound tests, {refused} refused ones");
}
