//! Steps taken many at a time against the same steps one by one.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::ensemble::{Source, Test};
use crate::model::{
    Alpha, Clock, Column, CovarianceStructure, Expression, Initial, Linear, MeanStructure, Measurement, Model, Motion,
    Operator, State,
};
use crate::reduce::prepare::{Preparer, Workspace};

/// Time, z, w, an input of z, an input of the drift, the variance of z.
const COLUMNS: usize = 6;

/// A random constant and a drift, seen by two measurements; `input` drives the drift.
fn model(clock: Clock, input: Expression) -> Model {
    let (number, column) = (Expression::Number, Expression::Column);
    let linear = |terms: Vec<(usize, Expression)>, constant| Linear { terms, constant };
    let times = |a, b| Expression::Binary(Operator::Multiply, Box::new(a), Box::new(b));
    let state = |name: &str, motion: Motion, initial: Initial| State {
        name: name.to_owned(),
        unit: None,
        motion,
        initial,
        offset: None,
        random: true,
    };
    let drift = Motion::Continuous { derivative: linear(vec![(1, number(-0.3))], input), noise_variance: number(0.2) };
    let meter = |name: &str, column: usize, equation: Linear, noise_variance| Measurement {
        name: name.to_owned(),
        column,
        filter: None,
        equation,
        noise_variance,
    };
    let z = linear(vec![(0, column(3)), (1, number(1.0))], times(column(3), number(0.5)));
    let w = linear(vec![(0, number(0.5)), (1, times(column(4), column(3)))], number(0.0));
    Model {
        title: String::new(),
        columns: (0..COLUMNS).map(|k| Column { name: format!("c{k}"), used_in: "the tests".to_owned() }).collect(),
        text_columns: Vec::new(),
        literals: Vec::new(),
        parameters: Vec::new(),
        states: vec![
            state("constant", Motion::Constant, Initial::Estimated),
            state("drift", drift, Initial::Known { mean: number(0.1), variance: number(1.0) }),
        ],
        process_noise_covariance: Vec::new(),
        measurements: vec![meter("z", 1, z, column(5)), meter("w", 2, w, number(0.5))],
        noise_covariance: Vec::new(),
        clock,
        group: None,
        estimated: vec![0],
        mean: MeanStructure::free(1),
        covariance: CovarianceStructure::full(),
    }
}

/// Rows that often repeat each other, some with measurements missing, some at the time of the one before; few have a cell that
/// cannot be.
fn test(rng: &mut ChaCha8Rng) -> Test {
    let mut test = Test::new("t1", COLUMNS, 0);
    let (mut cells, mut time) = ([1.0; COLUMNS], 0.0);
    for _ in 0..rng.random_range(1..40) {
        time += [0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0][rng.random_range(0..8)];
        for cell in &mut cells[3..] {
            if rng.random_range(0..3) == 0 {
                *cell = [1.0, 2.0, 0.0, 0.25][rng.random_range(0..4)];
            }
        }
        let mut row = cells;
        row[0] = time;
        for measured in &mut row[1..3] {
            *measured = if rng.random_range(0..8) == 0 { f64::NAN } else { rng.random_range(-1.0..1.0) };
        }
        if rng.random_range(0..200) == 0 {
            row[rng.random_range(1..COLUMNS)] = [f64::NAN, f64::INFINITY, -1.0][rng.random_range(0..3)];
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
    let timed = Clock { time: Some(0), ..Clock::default() };
    let clocks = [Clock::default(), timed.clone(), Clock { previous_inputs: true, ..timed }];
    let inputs = [Expression::Number(0.0), Expression::Number(0.3), Expression::Column(4)];
    let mut rng = ChaCha8Rng::seed_from_u64(1980);
    let (mut sound, mut refused) = (0, 0);
    for (clock, input) in clocks.iter().flat_map(|clock| inputs.iter().map(move |input| (clock, input))) {
        let together = Preparer::new(&model(clock.clone(), input.clone()), &Alpha::default()).expect("a sound model");
        let mut one_by_one = Preparer::new(&together.model, &Alpha::default()).expect("a sound model");
        assert!(std::mem::take(&mut one_by_one.follows), "rows of this model can follow each other");
        let (mut work, mut other_work) = (together.workspace(), one_by_one.workspace());
        for _ in 0..300 {
            let test = test(&mut rng);
            let found = left(&together, &test, &mut work);
            assert_eq!(found, left(&one_by_one, &test, &mut other_work), "{clock:?}, {input:?}: {test:?}");
            *(if found.is_ok() { &mut sound } else { &mut refused }) += 1;
        }
    }
    println!("{sound} sound tests, {refused} refused ones");
    assert!(sound > 1500 && refused > 100, "{sound} sound tests, {refused} refused ones");
}
