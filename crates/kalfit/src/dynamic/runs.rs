//! Filters and scores at any α, with any law of the initial states.

use std::sync::OnceLock;

use crate::dynamic::bench::Bench;
use crate::dynamic::indirect::Indirect;
use crate::estimate::InitialLaw;
use crate::reduce::{PhasedReducer, ReduceError, Reduction};
use crate::score::{Companies, Gradient, PhasedScorer};

/// What runs the filters of a bench.
#[derive(Debug)]
pub(crate) struct Runs<'b, 'a> {
    bench: &'b Bench<'a>,
    indirect: Indirect,
    companies: OnceLock<Companies>,
}

/// The ensemble at an α.
pub(crate) struct Run {
    reducer: PhasedReducer,
    pub(crate) reductions: Vec<Reduction>,
}

impl<'b, 'a> Runs<'b, 'a> {
    pub(crate) fn new(bench: &'b Bench<'a>) -> Runs<'b, 'a> {
        let indirect = Indirect::of(bench.model, bench.tests, bench.slots);
        Runs { bench, indirect, companies: OnceLock::new() }
    }

    /// Runs the filters.
    pub(crate) fn at(&self, values: &[f64]) -> Result<Run, ReduceError> {
        let mut reducer = PhasedReducer::scoring(self.bench.model, &self.bench.alpha(values), self.bench.slots)?;
        let reductions = reducer.reduce(self.bench.tests)?;
        Ok(Run { reducer, reductions })
    }

    /// dℓ_j/dvalue of each test, matrices of the covariance structure apart.
    pub(crate) fn scores(&self, run: &Run, values: &[f64], law: &InitialLaw) -> Result<Vec<Gradient>, ReduceError> {
        let Run { reducer, reductions } = run;
        let scorer = PhasedScorer::new(self.bench.model, reducer, self.bench.slots)?;
        if self.companies.get().is_none() {
            // not within the lock: threads that find them may take up other work meanwhile
            let _ = self.companies.set(scorer.companies(self.bench.tests));
        }
        let companies = self.companies.get().expect("they were set");
        let mut scores = scorer.scores(self.bench.tests, reductions, law, companies)?;
        self.bench.edges.pull(values, &self.bench.alpha(values), self.bench.slots, &mut scores);
        self.indirect.add(self.bench, (reducer, values), (reductions, law), &mut scores)?;
        Ok(scores)
    }
}
