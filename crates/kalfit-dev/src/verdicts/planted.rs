//! Ensembles with one planted fault each: how many faults are found, and how many are named.

use kalfit::FitRecord;
use kalfit::model::Value;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::drawn::with_values;
use super::fault::{FAULTS, Fault, Planted};
use super::kind::GYROS;
use super::{VerdictOptions, findings, fitted, is_doubted};

/// Probability of the likelihood ratio below which a fault counts.
const CLEAR: f64 = 1e-6;
/// Most draws for one fault, as small ones do not count.
const DRAWS: u64 = 50;
/// Seeds between faults.
const SEEDS: u64 = 1 << 20;

/// A clear fault: whether the model is doubted, and whether the fault is named.
#[derive(Debug, Clone, Copy, Default)]
struct FaultCount {
    clear: usize,
    found: usize,
    named: usize,
}

/// Prints the table of faults.
pub(super) fn run(options: &VerdictOptions) -> Result<(), String> {
    let one = |k: usize| -> Result<(usize, FaultCount), String> {
        let of = k % FAULTS.len();
        if !FAULTS[of].name().contains(&options.only) {
            return Ok((of, FaultCount::default()));
        }
        for draw in 0..DRAWS {
            let seed = options.seed + (k as u64 + 1) * SEEDS + draw;
            if let Some((fault, record)) = clear(FAULTS[of], seed)? {
                let found = is_doubted(&record);
                let named = fault.is_named(&record);
                if options.list {
                    println!("{}, seed {seed}, named {named}: {}", FAULTS[of].name(), findings(&record));
                }
                return Ok((of, FaultCount { clear: 1, found: usize::from(found), named: usize::from(named) }));
            }
        }
        Ok((of, FaultCount::default()))
    };
    let all: Result<Vec<(usize, FaultCount)>, String> = (0..options.faults).into_par_iter().map(one).collect();
    let mut counts = [FaultCount::default(); FAULTS.len() + 1];
    for (of, count) in all? {
        for sum in [of, FAULTS.len()] {
            let before = counts[sum];
            counts[sum] = FaultCount {
                clear: before.clear + count.clear,
                found: before.found + count.found,
                named: before.named + count.named,
            };
        }
    }
    println!("\nFaults of which the likelihood ratio has p < 1e-6, in gyros on a rate table.\n");
    println!("| fault | clear | found | named |\n|---|--:|--:|--:|");
    let names = FAULTS.map(Fault::name).into_iter().chain(["all"]);
    for (name, count) in names.zip(counts) {
        println!("| {name} | {} | {} | {} |", count.clear, count.found, count.named);
    }
    Ok(())
}

/// The fit of an ensemble with a fault of random size; `None` where the fault is small, or a fit is not certified. A
/// fault that adds δ to the measurements has one parameter γ in y + γδ; at γ = 1 the likelihood of the data with the
/// fault is that of the data without it.
fn clear(fault: Fault, seed: u64) -> Result<Option<(Planted, FitRecord)>, String> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let drawn = GYROS.draw(&mut random)?;
    let mut changed = drawn.clone();
    let Some(planted) = fault.plant(&mut changed, &mut random) else { return Ok(None) };
    let model = match planted {
        Planted::Noise(ratio) => with_values(&drawn.known, &|value| match value {
            Value::Fixed(value) => Value::Fixed(ratio * value),
            free => free,
        }),
        _ => drawn.model.clone(),
    };
    let (Some(right), Some(wrong)) = (fitted(&drawn.model, &drawn)?, fitted(&model, &changed)?) else {
        return Ok(None);
    };
    let law = ChiSquared::new(1.0).map_err(|error| error.to_string())?;
    let is_clear = law.sf(2.0 * (right.log_likelihood - wrong.log_likelihood)) < CLEAR;
    Ok(is_clear.then_some((planted, wrong)))
}
