//! `kalfit test`: a hypothesis within a model.

use kalfit::estimate::{Estimate, Progress, Structure};
use kalfit::infer::{Bootstrap, NotNested, at_least, bootstrap_while, fit_null, likelihood_ratio};
use kalfit::model::{Level, Parameter};
use kalfit::record::{PartRecord, RatioProvenance, RatioRecord};
use kalfit::{Alpha, PhasedModel, Reduction, estimate};
use kalfit_spec::{Hypothesis, HypothesisError, Spec};

use crate::evidence::Given;
use crate::failure::Failure;
use crate::job::{Done, TestJob, files};
use crate::output::{Contents, Output};
use crate::ratio::{self, with_covariance, with_mean};
use crate::work::{Watch, Work};
use crate::{model, reductions};

/// Tests a hypothesis within a model.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn test(job: &TestJob, watch: &mut dyn Watch) -> Result<Done<RatioRecord>, Failure> {
    let mut work = Work::new(watch);
    let mut spec = model::load(&job.model, &job.data)?;
    let given = Given::open(&mut spec, &job.data)?;
    let hypothesis = hypothesis(&spec, job)?;
    let read = files(&[&job.model.document, &job.null], &given.inputs);
    let output = Output::prepare_for(("--out", Contents::Json), job.out.as_deref(), &read)?;
    let record = read_and_test(job, &spec, &hypothesis, &given, &mut work)?;
    work.go_on()?;
    if let Some(output) = &output {
        output.write(&record)?;
    }
    Ok(Done { record, notes: given.notes, written: output.iter().map(Output::name).collect() })
}

fn hypothesis(spec: &Spec, job: &TestJob) -> Result<Hypothesis, Failure> {
    let text = model::text(&job.null)?;
    spec.under(&text).map_err(|error| match error {
        HypothesisError::Hypothesis(error) => Failure::model(error, &job.null.name(), Some(text)),
        HypothesisError::Model(error) => Failure::model(error, &spec.name, Some(spec.text.clone())),
    })
}

/// Which way it goes: with known parameters tests are forgotten once they are reduced.
fn read_and_test(
    job: &TestJob,
    spec: &Spec,
    hypothesis: &Hypothesis,
    given: &Given,
    work: &mut Work<'_>,
) -> Result<RatioRecord, Failure> {
    let provenance = RatioProvenance {
        title: spec.model.shared().title.clone(),
        hypothesis: hypothesis.title.clone().unwrap_or_else(|| job.null.name()),
        model_digest: Some(spec.digest.clone()),
        null_digest: Some(hypothesis.digest.clone()),
        files: given.names(),
    };
    if model::has_free(spec.model.shared()) {
        return ratio::test(job, (spec, hypothesis), given, provenance, work);
    }
    let alpha = model::alpha(spec);
    same_parameters(hypothesis, &alpha)?;
    let reductions = reductions::reduce(spec, &alpha, given, work, &mut |_| ())?;
    known(job, (spec, hypothesis), (&alpha, &reductions), provenance, work)
}

/// The method in one place: fit both, compare.
pub(crate) fn known(
    job: &TestJob,
    (spec, hypothesis): (&Spec, &Hypothesis),
    (alpha, reductions): (&Alpha, &[Reduction]),
    provenance: RatioProvenance,
    work: &mut Work<'_>,
) -> Result<RatioRecord, Failure> {
    let bench = Bench { job, model: &spec.model, null: &hypothesis.model, alpha, reductions };
    let wide =
        estimate::fit(reductions, &Structure::of(&spec.model, alpha), &job.settings, work).map_err(Failure::Fit)?;
    let null = bench.fit(&hypothesis.model, work)?;
    let wide = at_least(wide, &null, reductions).map_err(Failure::Fit)?;
    let ratio = likelihood_ratio(&null, &wide).map_err(Failure::NotNested)?;
    work.go_on()?;
    let parts = bench.parts(&wide, work)?;
    work.go_on()?;
    let drawn = match job.bootstrap {
        None => None,
        Some(asked) => {
            let mut goes_on = |done| drawing(work, done, asked);
            let found = bootstrap_while(&null, &wide, reductions, (ratio.statistic, asked), &mut goes_on);
            Some((asked, found.ok_or(Failure::Interrupted)?))
        }
    };
    let drawn = drawn.as_ref().map(|(asked, found)| (*asked, found));
    Ok(RatioRecord::new(&spec.model, reductions, (&null, &wide), &ratio, drawn, parts, provenance))
}

/// Says how many ensembles are done; true if somebody waits for more.
pub(crate) fn drawing(work: &mut Work<'_>, done: usize, asked: Bootstrap) -> bool {
    let all = asked.replicates;
    work.share("drawing ensembles", done as u64, all as u64);
    work.say(|| format!("drawing ensembles from the hypothesis: {done} of {all}"));
    !work.is_stopped()
}

/// What all fits of a test share.
struct Bench<'a> {
    job: &'a TestJob,
    model: &'a PhasedModel,
    null: &'a PhasedModel,
    alpha: &'a Alpha,
    reductions: &'a [Reduction],
}

impl Bench<'_> {
    fn fit(&self, model: &PhasedModel, progress: &mut dyn Progress) -> Result<Estimate, Failure> {
        let (within, structure) = (Structure::of(self.model, self.alpha), Structure::of(model, self.alpha));
        fit_null(self.reductions, &within, &structure, &self.job.settings, progress)
            .ok_or(Failure::NotNested(NotNested::Mean))?
            .map_err(Failure::Fit)
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

/// Parameters of a model without free ones must be the same on both sides.
fn same_parameters(hypothesis: &Hypothesis, alpha: &Alpha) -> Result<(), Failure> {
    let alone = |parameter: &Parameter| Alpha::fixed(std::slice::from_ref(parameter)).ok();
    let same = |parameter: &Parameter, known: &Level| alone(parameter).is_some_and(|null| null.values[0] == *known);
    match hypothesis
        .model
        .shared()
        .parameters
        .iter()
        .zip(&alpha.values)
        .find(|(parameter, known)| !same(parameter, known))
    {
        None => Ok(()),
        Some((parameter, _)) => Err(Failure::HypothesisParameter { name: parameter.name.clone() }),
    }
}
