//! The best plan among candidates as a record, part of plan.json.

use serde::{Deserialize, Serialize};

use kalfit_apply::plan::BestPlan;
use kalfit_apply::plan::optimal::{Kinds, MOST_TESTS};

/// The best plan among candidates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BestPlanRecord {
    /// What the plan makes best known: `D` for all free values together, `A` for the means over their standard deviations,
    /// or the figures.
    pub criterion: String,
    /// Largest cost of the plan.
    pub budget: f64,
    /// Cost of the plan.
    pub cost: f64,
    /// All candidates, in the order of their names.
    pub candidates: Vec<CandidateRecord>,
    /// log φ of the plan in whole numbers, in the user's units, by the logarithms of positive parameters; larger is better.
    pub log_phi: f64,
    /// log φ of the plan in any numbers.
    pub log_phi_relaxed: f64,
    /// φ of the plan is at least this share of that of any plan within the budget; of variances, not of standard errors.
    pub efficiency_bound: f64,
    /// U - 1 of the certificate at the plan in any numbers: zero at the best one.
    pub gap: f64,
    /// Whether branch and bound has proved that no plan in whole numbers is better.
    pub optimal_in_whole_numbers: bool,
    /// Number of branches that were looked at.
    pub nodes: usize,
    /// What tells what was known before, as named by the user; null where nothing was.
    pub information_so_far: Option<String>,
    /// Draws of the parameters that the plan is good for on average, those of the fit among them; null for one set.
    pub draws: Option<DrawsRecord>,
    /// The command that draws an ensemble of this plan; absent where it was not written to a file, and with levels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulate: Option<String>,
}

/// Draws of the parameters by the law of their estimates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DrawsRecord {
    /// Number of draws.
    pub count: usize,
    /// Seed of the draws.
    pub seed: u64,
}

/// One candidate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CandidateRecord {
    /// Name of the test, or of the unit of the outermost level.
    pub name: String,
    /// Cost of one.
    pub cost: f64,
    /// Largest number; null where there is none.
    pub most: Option<f64>,
    /// Number in the best plan in any numbers.
    pub relaxed: f64,
    /// Number in the best plan in whole numbers.
    pub tests: usize,
    /// ⟨G, F⟩ · budget / cost at the plan in any numbers: what a unit of cost for the candidate brings, times the budget. Where
    /// nothing was known before and no number is limited, at most 1, and 1 for every candidate of that plan (the
    /// equivalence theorem of Kiefer and Wolfowitz).
    pub sensitivity: f64,
}

impl BestPlanRecord {
    /// The record of a plan among candidates with these names. `scenarios`: number of sets of parameters.
    pub fn new(
        (best, criterion, scenarios): (&BestPlan, String, usize),
        (names, kinds): (&[String], &Kinds),
        (information_so_far, draws): (Option<String>, Option<DrawsRecord>),
    ) -> BestPlanRecord {
        let candidate = |(k, name): (usize, &String)| CandidateRecord {
            name: name.clone(),
            cost: kinds.costs[k],
            most: Some(kinds.most[k]).filter(|most| *most < MOST_TESTS),
            relaxed: best.relaxed.numbers[k],
            tests: best.whole.numbers[k].round() as usize,
            sensitivity: best.sensitivities[k],
        };
        BestPlanRecord {
            criterion,
            budget: kinds.budget,
            cost: best.whole.numbers.iter().zip(&kinds.costs).map(|(n, cost)| n * cost).sum(),
            candidates: names.iter().enumerate().map(candidate).collect(),
            log_phi: best.whole.log_phi + best.offset,
            log_phi_relaxed: best.relaxed.log_phi + best.offset,
            efficiency_bound: best.efficiency(scenarios),
            gap: best.relaxed.gap,
            optimal_in_whole_numbers: best.whole.is_optimal(),
            nodes: best.whole.nodes,
            information_so_far,
            draws,
            simulate: None,
        }
    }
}
