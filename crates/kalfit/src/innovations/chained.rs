//! Innovations of tests in phases: one filter over all phases, from the factors of each (theory §7).
//!
//! The filter of a phase runs with σ = 0, as for its reduction, and leaves e, S and T of each measurement: given σ, its innovation
//! is e - Tσ, of variance S. σ itself is known in law from all that came before, in the phase and in earlier ones ([`Law`]), so
//! that the innovation of the test is e - Tσ̂, of variance S + T Var(σ) T'. After the last step the law of σ becomes that of the
//! next phase's, by the link between them. What Σ adds is carried in square roots: it may be singular, zero or huge.

use nalgebra::{DMatrix, DVector};

use crate::innovations::law::Law;
use crate::innovations::rows::{self, Figures};
use crate::innovations::series::Innovations;
use crate::linalg::symmetric;
use crate::model::{Alpha, Phase, PhasedModel, Population};
use crate::reduce::{
    ChainPhase, Evidence, Gains, Link, PhasedReducer, PhasedTest, PhasedWork, ReduceError, ReduceErrorKind, Workspace,
};

/// The filter of tests in phases at (α, μ, Σ).
#[derive(Debug)]
pub(crate) struct Chained {
    reducer: PhasedReducer,
    phases: Vec<Start>,
}

/// What a phase adds of its own.
#[derive(Debug)]
struct Start {
    mean: Vec<f64>,
    /// (element of μ, coefficient), in the order of the covariates.
    regressions: Vec<(usize, f64)>,
    /// L with LL' = Σ, p × p.
    root: DMatrix<f64>,
    time: Option<usize>,
    /// The phase has a filter of its own: its measurements are not evidence.
    filtered: bool,
}

impl Chained {
    /// `initial` is of the shape of the model.
    pub(crate) fn new(model: &PhasedModel, alpha: &Alpha, initial: &Population) -> Result<Chained, ReduceError> {
        let reducer = PhasedReducer::new(model, alpha)?;
        let start = |(phase, own): (&Phase, Population)| -> Result<Start, ReduceError> {
            if !symmetric::is_semidefinite(&own.covariance) {
                let (least, largest) = symmetric::scaled_range(&own.covariance);
                let kind = Box::new(ReduceErrorKind::NotSemidefinite { left: least, variance: largest });
                let what = format!("covariance of the initial state of phase `{}`", phase.name);
                return Err(ReduceError { test: None, row: None, what, kind });
            }
            Ok(Start {
                regressions: phase.model.mean.regression.iter().map(|r| r.element).zip(own.coefficients).collect(),
                root: symmetric::square_root(&own.covariance),
                time: phase.model.clock.time,
                filtered: phase.filter.is_some(),
                mean: own.mean,
            })
        };
        let phases = model.phases.iter().zip(initial.apart(model)).map(start).collect::<Result<_, _>>()?;
        Ok(Chained { reducer, phases })
    }

    pub(crate) fn workspace(&self) -> PhasedWork {
        self.reducer.workspace()
    }

    /// The innovations of a test; `None` where no phase is given by rows alone.
    pub(crate) fn innovations(
        &self,
        whole: &PhasedTest,
        work: &mut PhasedWork,
    ) -> Result<Option<Innovations>, ReduceError> {
        let (covariates, chain) = self.reducer.chain_of(whole, work)?;
        let (mut series, mut rest) = (Vec::new(), 0.0);
        let (mut covariates, mut before) = (&*covariates, None);
        let mut seen = false;
        for (at, (start, phase)) in self.phases.iter().zip(&chain.phases).enumerate() {
            let (own, others) = covariates.split_at(start.regressions.len());
            covariates = others;
            let mut law = start.law(own, phase, before.take());
            match &whole.phases[at] {
                Evidence::Rows(test) if !start.filtered => {
                    let reducer = &self.reducer.phases()[at].reducer;
                    let take = |e: f64, weight: f64, sensitivity: &[f64]| {
                        let (value, variance) = law.take(e, sensitivity, weight);
                        Figures { value, variance, standardised: value / variance.sqrt() }
                    };
                    let look =
                        |gains: &Gains, work: &mut Workspace| rows::series((at, test, start.time), gains, work, take);
                    let found = reducer.with_gains(test, &mut work.phases[at], look);
                    series.extend(found.map_err(|error| self.reducer.phases()[at].named(error))?);
                    seen = true;
                }
                _ => rest += absorb(phase, &mut law),
            }
            before = Some(law.posterior());
        }
        if !rows::are_finite(&series) {
            let kind = Box::new(ReduceErrorKind::NotFinite);
            return Err(ReduceError { test: Some(whole.id.clone()), row: None, what: "innovations".to_owned(), kind });
        }
        Ok(seen.then(|| Innovations::of_phases(whole.id.clone(), series, rest)))
    }
}

impl Start {
    /// The law of σ of a phase given all earlier ones; `before`: mean and root of σ of the phase before.
    fn law(&self, covariates: &[f64], phase: &ChainPhase, before: Option<(DVector<f64>, DMatrix<f64>)>) -> Law {
        let (p, q) = (self.mean.len(), phase.data.len());
        let mut mean = DVector::from_fn(q, |i, _| self.mean.get(i).copied().unwrap_or(0.0));
        for (&(element, coefficient), covariate) in self.regressions.iter().zip(covariates) {
            mean[element] += coefficient * covariate;
        }
        let own = self.root.clone().resize_vertically(q, 0.0);
        let Some(((m, f), Link { mean: g, sensitivity, root })) = before.zip(phase.link.as_ref()) else {
            return Law::new(mean, &own);
        };
        mean += g + sensitivity * m;
        let carried = sensitivity * f;
        let mut all = DMatrix::zeros(q, p + carried.ncols() + root.ncols());
        all.columns_mut(0, p).copy_from(&own);
        all.columns_mut(p, carried.ncols()).copy_from(&carried);
        all.columns_mut(p + carried.ncols(), root.ncols()).copy_from(root);
        Law::new(mean, &all)
    }
}

/// Takes in what is known of a phase otherwise than by rows; its log p given all earlier phases.
fn absorb(phase: &ChainPhase, law: &mut Law) -> f64 {
    let q = phase.data.len();
    let mut log_density = phase.constant;
    let mut line = vec![0.0; q];
    for i in 0..q {
        line.fill(0.0);
        (i..q).for_each(|k| line[k] = phase.factor[i + k * (k + 1) / 2]);
        let (value, variance) = law.take(phase.data[i], &line, 1.0);
        log_density -= 0.5 * (variance.ln() + value * value / variance);
    }
    log_density
}
