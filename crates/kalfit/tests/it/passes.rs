//! Work of the Newton solver, counted: passes over the reductions, for every kind of ensemble and every structure.

use crate::simulated;

use std::fmt::Write as _;

use kalfit::estimate::{Solver, Stop};
use simulated::structures::structures;
use simulated::{Assumed, Recipe, ensemble, fit};

const SEEDS: u64 = 4;

fn kinds(p: usize) -> Vec<(&'static str, Recipe)> {
    let tests = 20 * p;
    let base = Recipe { p, tests, rank: p, observed: p + 3, strength: 1.0, designs: tests, regressors: 1, mild: true };
    let singular = match p {
        3 => 1,
        6 => 3,
        _ => 7,
    };
    vec![
        ("plain", base),
        ("weak", Recipe { strength: 0.2, ..base }),
        ("strong", Recipe { strength: 1e3, ..base }),
        ("near-singular", Recipe { tests: 2 * p + 2, designs: 2 * p + 2, strength: 0.7, ..base }),
        ("singular", Recipe { rank: singular, ..base }),
        ("few designs", Recipe { designs: 4, rank: singular, ..base }),
        ("partial", Recipe { observed: 2, ..base }),
        ("one design", Recipe { designs: 1, rank: singular, ..base }),
    ]
}

/// Passes that the worst seed may take. With hardly more tests than states, few designs, or tests that see two states at most,
/// the likelihood has flat directions, and the way to the top is longer.
fn most_passes(kind: &str) -> usize {
    match kind {
        "plain" | "weak" | "strong" | "singular" => 15,
        _ => 20,
    }
}

/// The most passes of any seed, and what went wrong.
fn most(
    (p, kind, recipe): (usize, &str, Recipe),
    (name, assumed): (&str, &Assumed),
    failures: &mut Vec<String>,
) -> usize {
    let count = |seed| {
        let found = fit(&ensemble(recipe, seed), assumed, Solver::Newton);
        assert!(found.certificate.decrement.is_finite(), "{:?}", found.certificate);
        if found.stop != Stop::Certified || found.passes > most_passes(kind) {
            let (passes, stop, certificate) = (found.passes, found.stop, found.certificate);
            failures.push(format!("p = {p}, {kind}, {name} seed {seed}: {passes} passes, {stop:?}, {certificate:?}"));
        }
        found.passes
    };
    (0..if p > 6 { 2 } else { SEEDS }).map(count).max().expect("there are seeds")
}

fn table(p: usize) {
    let kinds = kinds(p);
    let mut failures = Vec::new();
    let mut table = format!("{:18}", "");
    kinds.iter().for_each(|(name, _)| write!(table, "{name:>14}").expect("text"));
    for (structure, assumed) in structures(p) {
        write!(table, "\n{structure:18}").expect("text");
        for (kind, recipe) in &kinds {
            let passes = most((p, kind, *recipe), (structure, &assumed), &mut failures);
            write!(table, "{passes:14}").expect("text");
        }
    }
    assert!(failures.is_empty(), "{table}\n{} failures\n{}", failures.len(), failures.join("\n"));
}

#[test]
fn passes_for_three_states_are_few() {
    table(3);
}

#[test]
fn passes_for_six_states_are_few() {
    table(6);
}

#[test]
fn passes_for_ten_states_are_few() {
    table(10);
}
