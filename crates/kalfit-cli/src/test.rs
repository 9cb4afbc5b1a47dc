//! `kalfit test`: a hypothesis within a model.

use std::path::Path;

use kalfit::estimate::{Estimate, Progress, Structure};
use kalfit::infer::{NotNested, at_least, bootstrap, fit_null, likelihood_ratio};
use kalfit::model::{Level, Parameter};
use kalfit::record::{PartRecord, RatioProvenance, RatioRecord};
use kalfit::{Alpha, PhasedModel, Reduction, estimate};
use kalfit_data::Input;
use kalfit_report::ratio_summary;
use kalfit_spec::{Hypothesis, HypothesisError, Spec};

use crate::evidence::Given;
use crate::failure::Failure;
use crate::job::{Outcome, TestJob};
use crate::output::Output;
use crate::progress::Line;
use crate::ratio::{self, with_covariance, with_mean};
use crate::{model, reductions, terminal};

pub(crate) fn run(job: &TestJob) -> Result<Outcome, Failure> {
    let mut spec = model::load(&job.model)?;
    let given = Given::open(&mut spec, &job.data)?;
    let hypothesis = hypothesis(&spec, job)?;
    let output = job.out.as_deref().map(|path| Output::prepare(path, &files(job, &given.inputs))).transpose()?;
    let record = read_and_test(job, &spec, &hypothesis, &given)?;
    if let Some(output) = &output {
        output.write(&record)?;
    }
    if !job.quiet {
        terminal::warn(&given.notes);
        terminal::print(&ratio_summary(&record, &terminal::style())).map_err(Failure::Stdout)?;
        if let Some(output) = &output {
            terminal::complain(&format!("Wrote {}\n", output.name()));
        }
    }
    Ok(if record.converged { Outcome::Done } else { Outcome::NotCertified })
}

fn hypothesis(spec: &Spec, job: &TestJob) -> Result<Hypothesis, Failure> {
    let text = Spec::read_text(&job.null).map_err(|error| Failure::model(error, &job.null, None))?;
    spec.under(&text).map_err(|error| match error {
        HypothesisError::Hypothesis(error) => Failure::model(error, &job.null, Some(text)),
        HypothesisError::Model(error) => Failure::model(error, &job.model.path, Some(spec.text.clone())),
    })
}

/// Which way it goes: with known parameters tests are forgotten once they are reduced.
fn read_and_test(job: &TestJob, spec: &Spec, hypothesis: &Hypothesis, given: &Given) -> Result<RatioRecord, Failure> {
    let provenance = RatioProvenance {
        title: spec.model.shared().title.clone(),
        hypothesis: hypothesis.title.clone().unwrap_or_else(|| job.null.display().to_string()),
        model_digest: Some(spec.digest.clone()),
        null_digest: Some(hypothesis.digest.clone()),
        files: given.names(),
    };
    if model::has_free(spec.model.shared()) {
        return ratio::test(job, spec, hypothesis, given, provenance);
    }
    let mut line = Line::new(job.quiet);
    let alpha = model::alpha(spec);
    same_parameters(hypothesis, &alpha)?;
    let reductions = reductions::reduce(spec, &alpha, given, &mut line, &mut |_| ())?;
    test(job, (spec, hypothesis), (&alpha, &reductions), provenance, &mut line)
}

/// The method in one place: fit both, compare.
pub(crate) fn test(
    job: &TestJob,
    (spec, hypothesis): (&Spec, &Hypothesis),
    (alpha, reductions): (&Alpha, &[Reduction]),
    provenance: RatioProvenance,
    line: &mut Line,
) -> Result<RatioRecord, Failure> {
    let bench = Bench { job, model: &spec.model, null: &hypothesis.model, alpha, reductions };
    let wide =
        estimate::fit(reductions, &Structure::of(&spec.model, alpha), &job.settings, line).map_err(Failure::Fit)?;
    let null = bench.fit(&hypothesis.model, line)?;
    let wide = at_least(wide, &null, reductions).map_err(Failure::Fit)?;
    let ratio = likelihood_ratio(&null, &wide).map_err(Failure::NotNested)?;
    let parts = bench.parts(&wide, line)?;
    line.say(|| "drawing ensembles from the hypothesis".to_owned());
    let drawn = job.bootstrap.map(|b| (b, bootstrap(&null, &wide, reductions, ratio.statistic, b)));
    let drawn = drawn.as_ref().map(|(b, found)| (*b, found));
    Ok(RatioRecord::new(&spec.model, reductions, (&null, &wide), &ratio, drawn, parts, provenance))
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

fn files<'a>(job: &'a TestJob, inputs: &'a [Input]) -> Vec<&'a Path> {
    let data = inputs.iter().filter_map(|input| match input {
        Input::Path(path) => Some(path.as_path()),
        Input::Stdin => None,
    });
    [job.model.path.as_path(), job.null.as_path()].into_iter().chain(data).collect()
}
