//! Correct models of every kind: the share that is doubted, by each finding, and the tails of p-values.

use kalfit::FitRecord;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::kind::{KINDS, Kind};
use super::{VerdictOptions, findings, fitted, is_doubted};
use crate::p_values::{PValueCount, head};

/// Kinds of findings.
const FINDINGS: [&str; 7] = ["mean_square", "innovations", "distance", "unlike", "row", "misfit", "normality"];
/// Terms of misfit, then other p-values.
const FIGURES: [&str; 9] =
    ["levels", "square", "change", "record", "steps", "shared", "normality", "unlike", "constraints"];
/// Constraints are contradicted when the p-value of one of them is below this over their number, as the summary says.
const CONTRADICTED: f64 = 0.05;
/// Largest share of correct models that may be doubted: 5 % and a fifth of it.
const MOST: f64 = 0.06;

/// Counts over ensembles.
#[derive(Debug, Clone, Copy, Default)]
struct VerdictCount {
    drawn: usize,
    certified: usize,
    doubted: usize,
    contradicted: usize,
    findings: [usize; FINDINGS.len()],
    /// p-values of each figure.
    p_values: [PValueCount; FIGURES.len()],
}

impl VerdictCount {
    fn of(record: Option<&FitRecord>) -> VerdictCount {
        let Some(record) = record else { return VerdictCount { drawn: 1, ..VerdictCount::default() } };
        let findings = record.model_check.as_ref().map_or(&[][..], |check| &check.findings);
        let constraints: Vec<f64> = record.constraints.iter().filter_map(|own| own.p_value).collect();
        let limit = CONTRADICTED / constraints.len().max(1) as f64;
        let is_contradicted = |p: Option<f64>| p.is_some_and(|p| p < limit);
        let contradicted = record.constraints.iter().any(|own| is_contradicted(own.likelihood_ratio_p_value));
        VerdictCount {
            drawn: 1,
            certified: 1,
            doubted: usize::from(!findings.is_empty()),
            contradicted: usize::from(contradicted),
            findings: FINDINGS.map(|kind| usize::from(findings.iter().any(|finding| finding.kind == kind))),
            p_values: FIGURES.map(|figure| {
                let mut count = PValueCount::default();
                p_values(record, figure).into_iter().for_each(|p| count.take(Some(p)));
                count
            }),
        }
    }

    fn with(self, other: VerdictCount) -> VerdictCount {
        VerdictCount {
            drawn: self.drawn + other.drawn,
            certified: self.certified + other.certified,
            doubted: self.doubted + other.doubted,
            contradicted: self.contradicted + other.contradicted,
            findings: std::array::from_fn(|k| self.findings[k] + other.findings[k]),
            p_values: std::array::from_fn(|k| self.p_values[k].with(other.p_values[k])),
        }
    }

    fn row(&self, name: &str) {
        let findings: Vec<String> = self.findings.iter().map(usize::to_string).collect();
        let share = 100.0 * self.doubted as f64 / self.certified.max(1) as f64;
        println!(
            "| {name} | {} | {} | {share:.1} % | {} | {} |",
            self.drawn,
            self.certified,
            findings.join(" | "),
            self.contradicted
        );
    }
}

/// All p-values of a figure in a fit.
fn p_values(record: &FitRecord, figure: &str) -> Vec<f64> {
    let misfit = || record.misfit.iter();
    match figure {
        "constraints" => record.constraints.iter().filter_map(|own| own.p_value).collect(),
        "normality" => misfit().filter_map(|misfit| Some(misfit.normality.as_ref()?.p_value)).collect(),
        // the least probable test of each fit, as the list of a record is cut off
        "unlike" => misfit().filter_map(|misfit| Some(misfit.unlike.first()?.adjusted_p_value)).collect(),
        term => {
            misfit().flat_map(|misfit| &misfit.terms).filter(|one| one.term == term).map(|one| one.p_value).collect()
        }
    }
}

/// Prints the tables; whether no more correct models are doubted than should be.
pub(super) fn run(options: &VerdictOptions) -> Result<bool, String> {
    let kinds: Vec<&Kind> = KINDS.iter().filter(|kind| kind.name.contains(&options.only)).collect();
    if kinds.is_empty() {
        return Ok(true);
    }
    let one = |k: usize| -> Result<(usize, VerdictCount), String> {
        let mut random = ChaCha8Rng::seed_from_u64(options.seed + k as u64);
        let of = k % kinds.len();
        let drawn = kinds[of].draw(&mut random)?;
        let record = fitted(&drawn.model, &drawn)?;
        if let Some(record) = record.as_ref().filter(|record| options.list && is_doubted(record)) {
            println!("{}, seed {}: {}", kinds[of].name, options.seed + k as u64, findings(record));
        }
        Ok((of, VerdictCount::of(record.as_ref())))
    };
    let all: Result<Vec<(usize, VerdictCount)>, String> = (0..options.correct).into_par_iter().map(one).collect();
    let mut counts = vec![VerdictCount::default(); kinds.len()];
    all?.into_iter().for_each(|(of, count)| counts[of] = counts[of].with(count));
    let sum = counts.iter().copied().fold(VerdictCount::default(), VerdictCount::with);
    println!(
        "\n{} ensembles of correct models, seeds from {}: how many are doubted, by what.\n",
        sum.drawn, options.seed
    );
    println!("| kind | drawn | certified | doubtful | {} | contradicted |", FINDINGS.join(" | "));
    println!("|---|--:|--:|--:|{}--:|", "--:|".repeat(FINDINGS.len()));
    kinds.iter().zip(&counts).for_each(|(kind, count)| count.row(kind.name));
    sum.row("all");
    println!("\nShare of p-values below the nominal one, as a multiple of it.\n");
    head("p-values of");
    FIGURES.iter().zip(sum.p_values).for_each(|(name, count)| count.row(name));
    // three sampling errors
    let certified = sum.certified as f64;
    Ok(sum.doubted as f64 <= MOST * certified + 3.0 * (MOST * certified).sqrt())
}
