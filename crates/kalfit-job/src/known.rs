//! `kalfit test` where all parameters are known: both sides are fitted to the same reductions.

use std::sync::Arc;

use kalfit::estimate::{Criterion, Estimate, Progress, Settings, Stop, Structure};
use kalfit::infer::{
    Bootstrap, DfChoice, JointTest, NoJointTest, NotNested, SmallSample, at_least, bootstrap_while, fit_null,
    has_few_units, likelihood_ratio,
};
use kalfit::record::{PartRecord, RatioProvenance, RatioRecord};
use kalfit::{Alpha, Grouping, PhasedModel, Reductions, estimate};
use kalfit_spec::{Hypothesis, Spec};

use crate::failure::Failure;
use crate::hypothesis::{is_of_mean, with_covariance, with_mean};
use crate::job::TestJob;
use crate::work::JobWork;

/// The method in one place: fit both, compare.
pub(crate) fn test(
    job: &TestJob,
    (spec, hypothesis): (&Spec, &Hypothesis),
    (alpha, reductions, grouping): (&Alpha, &Reductions, Option<&Arc<Grouping>>),
    provenance: RatioProvenance,
    work: &mut JobWork<'_>,
) -> Result<RatioRecord, Failure> {
    let bench = KnownParameterTest { job, model: &spec.model, null: &hypothesis.model, alpha, reductions, grouping };
    let wide = estimate::fit(reductions, &Structure::of(&spec.model, alpha, grouping), &job.settings, work)
        .map_err(Failure::Fit)?;
    let null = bench.fit(&hypothesis.model, work)?;
    let wide = at_least(wide, &null, reductions).map_err(Failure::Fit)?;
    let ratio = likelihood_ratio(&null, &wide).map_err(Failure::NotNested)?;
    work.go_on()?;
    let parts = bench.parts(&wide, work)?;
    work.go_on()?;
    let are_certified = [&null, &wide].iter().all(|estimate| estimate.stop == Stop::Certified);
    let drawn = match job.bootstrap.resolved(are_certified && has_few_units(&wide, reductions.len())) {
        None => None,
        Some(asked) => {
            let mut goes_on = |done| drawing(work, done, asked);
            let found = bootstrap_while(&null, &wide, reductions, (ratio.statistic, asked), &mut goes_on);
            Some((asked, found.ok_or(Failure::Interrupted)?))
        }
    };
    let drawn = drawn.as_ref().map(|(asked, found)| (*asked, found));
    let mut record = RatioRecord::new(&spec.model, reductions, (&null, &wide), &ratio, drawn, parts, provenance);
    if is_of_mean(&spec.model, &hypothesis.model)
        && let Some(found) = bench.f_test(&null, work)
    {
        record.add_f(found);
    }
    Ok(record)
}

/// Says how many ensembles are done; true if somebody waits for more.
pub(crate) fn drawing(work: &mut JobWork<'_>, done: usize, asked: Bootstrap) -> bool {
    let all = asked.replicates;
    work.share("drawing ensembles", done as u64, all as u64);
    work.say(|| format!("drawing ensembles from the hypothesis: {done} of {all}"));
    !work.is_stopped()
}

/// What all fits of a test share.
struct KnownParameterTest<'a> {
    job: &'a TestJob,
    model: &'a PhasedModel,
    null: &'a PhasedModel,
    alpha: &'a Alpha,
    reductions: &'a Reductions,
    grouping: Option<&'a Arc<Grouping>>,
}

impl KnownParameterTest<'_> {
    fn fit(&self, model: &PhasedModel, progress: &mut dyn Progress) -> Result<Estimate, Failure> {
        let of = |model| Structure::of(model, self.alpha, self.grouping);
        let (within, structure) = (of(self.model), of(model));
        fit_null(self.reductions, &within, &structure, &self.job.settings, progress)
            .ok_or(Failure::NotNested(NotNested::Mean))?
            .map_err(Failure::Fit)
    }

    /// The F test of a hypothesis on means, by the restricted likelihood of the model; `None` without its maximum.
    fn f_test(&self, null: &Estimate, progress: &mut dyn Progress) -> Option<Result<JointTest, NoJointTest>> {
        let settings = Settings { criterion: Criterion::Reml, ..self.job.settings.clone() };
        let structure = Structure::of(self.model, self.alpha, self.grouping);
        let wide = estimate::fit(self.reductions, &structure, &settings, progress).ok()?;
        let small = SmallSample::of(&wide, self.reductions, DfChoice::Auto)?.ok()?;
        Some(small.f_test(&wide, null))
    }

    /// A hypothesis on both μ and Σ, each by itself (Shumway, Olsen and Levy).
    fn parts(&self, wide: &Estimate, progress: &mut dyn Progress) -> Result<Vec<PartRecord>, Failure> {
        let (Some(mean), Some(covariance)) = (with_mean(self.model, self.null), with_covariance(self.model, self.null))
        else {
            return Ok(Vec::new());
        };
        let mut parts = Vec::new();
        for (what, model) in [("mean", mean), ("covariance", covariance)] {
            let estimate = self.fit(&model, progress)?;
            let ratio = likelihood_ratio(&estimate, wide).map_err(Failure::NotNested)?;
            parts.push(PartRecord::new(what, &estimate, &ratio));
        }
        Ok(parts)
    }
}
