//! Work of the Newton solver, counted: passes over the reductions, for every kind of ensemble and every structure.

mod simulated;

use std::fmt::Write as _;

use kalfit::estimate::{Solver, Stop};
use simulated::structures::structures;
use simulated::{Assumed, Recipe, ensemble, fit};

const SEEDS: u64 = 4;

fn kinds(p: usize) -> Vec<(&'static str, Recipe)> {
    let tests = 20 * p;
    let base = Recipe { p, tests, rank: p, observed: p + 3, strength: 1.0, designs: tests, regressors: 1 };
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

/// The most passes of any seed, and what went wrong.
fn most(recipe: Recipe, assumed: &Assumed, failures: &mut Vec<String>, what: &str) -> usize {
    let count = |seed| {
        let found = fit(&ensemble(recipe, seed), assumed, Solver::Newton);
        if found.stop != Stop::Certified || found.passes > 15 {
            let trace: Vec<f64> = found.trace.iter().map(|x| x - found.log_likelihood).collect();
            failures.push(format!(
                "{what} seed {seed}: {} passes, {:?}, {:?}, ℓ less its end {trace:?}",
                found.passes, found.stop, found.certificate
            ));
        }
        found.passes
    };
    (0..SEEDS).map(count).max().expect("there are seeds")
}

fn table(p: usize) -> String {
    let kinds = kinds(p);
    let mut failures = Vec::new();
    let mut table = format!("{:18}", "");
    kinds.iter().for_each(|(name, _)| write!(table, "{name:>14}").expect("text"));
    for (structure, assumed) in structures(p) {
        write!(table, "\n{structure:18}").expect("text");
        for (kind, recipe) in &kinds {
            let passes = most(*recipe, &assumed, &mut failures, &format!("p = {p}, {kind}, {structure}"));
            write!(table, "{passes:14}").expect("text");
        }
    }
    assert!(failures.is_empty(), "{}\n{} failures\n{}", table, failures.len(), failures.join("\n"));
    table
}

#[test]
fn passes_for_three_states() {
    println!("{}", table(3));
}

#[test]
fn passes_for_six_states() {
    println!("{}", table(6));
}

#[test]
fn passes_for_ten_states() {
    println!("{}", table(10));
}
