//! The law of Ljung and Box's statistic of independent normal numbers with known mean, by importance sampling: the table from which
//! kalfit takes its p-values (`crates/kalfit-filter/src/innovations/whiteness/table.rs`).
//!
//! ```text
//! P(Q > q) = E_g[w 1(Q > q)]        w = f/g
//! ```
//!
//! f is the law without correlation, g a mixture of it with laws of correlated series, so that a few million draws reach
//! probabilities of 1e-8. The statistic is free of scale, and so of short series only the direction counts, whose density under
//! N(0, C) is proportional to |C|^-1/2 (z'C⁻¹z)^-n/2 ([`short`]). Longer series take autoregressions with normal coefficients
//! ([`long`]).

mod long;
mod proposal;
mod short;

use std::fmt::Write as _;
use std::process::ExitCode;
use std::time::Instant;

use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use statrs::distribution::{ChiSquared, ContinuousCDF};

use self::proposal::{MOST_LAGS, PER_LAG, SeriesProposal, lags};
use crate::places;
use crate::seed::random_of_block;

const TABLE: &str = "crates/kalfit-filter/src/innovations/whiteness/table.rs";
/// From this length on all lags are taken.
const LONG: usize = MOST_LAGS * PER_LAG;
/// Lengths from there on; between them 1/n is interpolated, down to the χ² of n → ∞.
const LENGTHS: [usize; 15] = [50, 54, 60, 66, 75, 85, 100, 120, 150, 200, 300, 500, 1000, 3000, 10_000];
/// Tail probabilities.
const LEVELS: [f64; 21] = [
    0.9, 0.7, 0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7,
    1e-8,
];
/// Numbers drawn for each length, so many draws as that makes within these bounds.
const NUMBERS: usize = 200_000_000;
const DRAWS: (usize, usize) = (100_000, 1_000_000);
/// Draws of one stream of random numbers.
const BLOCK: usize = 10_000;

/// Writes the table.
pub(crate) fn run() -> ExitCode {
    let began = Instant::now();
    let mut rows = String::new();
    for n in (PER_LAG..LONG).chain(LENGTHS) {
        let quantiles = quantiles(n);
        writeln!(rows, "    {},", numbers(&quantiles)).expect("a string takes all");
        println!("{n} numbers, {} lags: {} ({:.0} s)", lags(n), numbers(&quantiles), began.elapsed().as_secs_f64());
    }
    let path = places::root().join(TABLE);
    match std::fs::write(&path, page(&rows)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{}: {error}", path.display());
            ExitCode::FAILURE
        }
    }
}

/// The table as a file of code.
fn page(rows: &str) -> String {
    let count = LEVELS.len();
    let levels: Vec<String> = LEVELS.iter().map(|p| format!("{p:e}")).collect();
    let lengths: Vec<String> = LENGTHS.iter().map(usize::to_string).collect();
    let chi = |lags: usize| -> String {
        let quantiles: Vec<f64> = LEVELS.iter().map(|&p| chi_squared(lags, p)).collect();
        format!("    {},\n", numbers(&quantiles))
    };
    let chi: String = (1..=MOST_LAGS).map(chi).collect();
    format!(
        "//! Written by `cargo dev whiteness`: the law of Ljung and Box's statistic by simulation.\n\n\
         /// Tail probabilities that the columns of the other tables are for.\n\
         #[cfg(test)]\n\
         #[rustfmt::skip]\n\
         pub(super) const LEVELS: [f64; {count}] = [{}];\n\n\
         /// Lengths of the rows of `QUANTILES` from the last short one on; the rows before are for {PER_LAG}, {}, … {}.\n\
         pub(super) const LENGTHS: [usize; {}] = [{}];\n\n\
         /// Quantiles of χ² with 1 to {MOST_LAGS} degrees of freedom.\n\
         #[rustfmt::skip]\n\
         pub(super) const CHI_SQUARED: [[f64; {count}]; {MOST_LAGS}] = [\n{chi}];\n\n\
         /// Quantiles of the statistic, one row for each length.\n\
         #[rustfmt::skip]\n\
         pub(super) const QUANTILES: [[f64; {count}]; {}] = [\n{rows}];\n",
        levels.join(", "),
        PER_LAG + 1,
        LONG - 1,
        LENGTHS.len(),
        lengths.join(", "),
        LONG - PER_LAG + LENGTHS.len(),
    )
}

fn numbers(row: &[f64]) -> String {
    // six digits: more than the simulation has, and enough for what is bounded close to the bound
    let digits = |x: &f64| format!("{x:.*}", (5 - x.log10().floor() as i32).clamp(1, 7) as usize);
    format!("[{}]", row.iter().map(digits).collect::<Vec<_>>().join(", "))
}

/// The value that a χ² exceeds with probability p, by bisection.
fn chi_squared(degrees_of_freedom: usize, p: f64) -> f64 {
    let chi = ChiSquared::new(degrees_of_freedom as f64).expect("positive");
    let (mut low, mut high) = (0.0, 1e3);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if chi.sf(middle) > p { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// The values that the statistic of n numbers exceeds with the probabilities of `LEVELS`.
fn quantiles(n: usize) -> Vec<f64> {
    let draws = (NUMBERS / n).clamp(DRAWS.0, DRAWS.1) / BLOCK * BLOCK;
    let drawn = if n <= LONG {
        drawn(n, draws, &short::ShortMixture::new(n))
    } else {
        drawn(n, draws, &long::LongMixture::new(n))
    };
    let mut quantiles = vec![f64::NAN; LEVELS.len()];
    let (mut sum, mut level) = (0.0, LEVELS.len());
    for (statistic, weight) in drawn {
        sum += weight;
        while level > 0 && sum >= LEVELS[level - 1] * draws as f64 {
            level -= 1;
            quantiles[level] = statistic;
        }
    }
    quantiles
}

/// Statistics with their weights, the largest first.
fn drawn(n: usize, draws: usize, proposal: &impl SeriesProposal) -> Vec<(f64, f64)> {
    let block = |block: usize| {
        let mut rng = random_of_block(n, block);
        let (mut z, mut products) = (vec![0.0; n], vec![0.0; lags(n) + 1]);
        let one = move |number: usize| {
            z.iter_mut().for_each(|x| *x = rng.sample(StandardNormal));
            proposal.draw(number, &mut rng, &mut z);
            for (k, product) in products.iter_mut().enumerate() {
                *product = z.iter().zip(&z[k..]).map(|(a, b)| a * b).sum();
            }
            (ljung_box(n, &products), proposal.weight(&z, &products))
        };
        (0..BLOCK).map(one).collect::<Vec<_>>()
    };
    let mut drawn: Vec<(f64, f64)> = (0..draws / BLOCK).into_par_iter().flat_map_iter(block).collect();
    drawn.par_sort_by(|a, b| b.0.total_cmp(&a.0));
    drawn
}

/// Q from the sums of products by lag.
fn ljung_box(n: usize, products: &[f64]) -> f64 {
    let each = |k: usize| (products[k] / products[0]).powi(2) / (n - k) as f64;
    (n * (n + 2)) as f64 * (1..products.len()).map(each).sum::<f64>()
}
