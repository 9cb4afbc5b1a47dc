//! `kalfit test` where dynamic parameters are free: both sides are fitted with α, to tests that are kept.

use std::sync::Arc;

use kalfit::dynamic::{
    self, DynamicFit, DynamicRatioError, Method, ParameterInference, Settings, dynamic_bootstrap_while, dynamic_ratio,
    started,
};
use kalfit::estimate::{self, Criterion};
use kalfit::infer::{
    Choices, DeletionChoice, Inference, JointTest, LikelihoodRatio, NoJointTest, NotNested, restricted,
};
use kalfit::model::Slots;
use kalfit::record::{DynamicParts, DynamicSides, PartRecord, RatioProvenance, RatioRecord};
use kalfit::reduce::grouping;
use kalfit::{Labels, Model, PhasedModel, PhasedTest};
use kalfit_data::DataReading;
use kalfit_spec::{Hypothesis, Spec};

use crate::dynamic::{SearchData, failure};
use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::hypothesis::{each, is_of_mean, with_covariance, with_mean, with_parameters};
use crate::job::TestJob;
use crate::work::JobWork;
use crate::{known, reductions, tests};

/// A search that ended below the hypothesis is made again with so many random starts.
const STARTS: usize = 8;

/// The method in one place: read, fit both, compare.
pub(crate) fn test(
    job: &TestJob,
    (spec, hypothesis): (&Spec, &Hypothesis),
    given: &CommandInputs,
    provenance: RatioProvenance,
    work: &mut JobWork<'_>,
) -> Result<RatioRecord, Failure> {
    let null = &hypothesis.model;
    // labels are numbered by the texts that both name
    let (literals, text_columns) = (&null.shared().literals, &null.shared().text_columns);
    let wide = each(&spec.model, &|_, model| {
        let (literals, text_columns) = (literals.clone(), text_columns.clone());
        Model { literals, text_columns, ..model }
    });
    let (tests, reading) = tests::read_for(spec, null, given, work)?;
    let slots = [Slots::in_phases(null, &reading.labels, &tests), Slots::in_phases(&wide, &reading.labels, &tests)];
    restricted((null, &slots[0]), (&wide, &slots[1]), &tests)
        .map_err(|error| Failure::DynamicRatio(DynamicRatioError::Parameter(error)))?;
    if slots[1].is_empty() {
        // every level of the data has a value after all
        let alpha = slots[1].alpha(wide.shared(), &[]);
        let reductions = reductions::of_all(&wide, &alpha, (&tests, &reading), work)?;
        let grouping = grouping(&wide, &tests).map_err(|error| failure(error.into(), &reading))?.map(Arc::new);
        return known::test(job, (spec, hypothesis), (&alpha, &reductions, grouping.as_ref()), provenance, work);
    }
    let settings = Settings { method: Method::Hybrid, inner: job.settings.clone(), starts: 0, seed: 1 };
    let bench = FreeParameterTest { wide: &wide, null, tests: &tests, reading: &reading, settings };
    let narrow = bench.fit(null, work)?;
    let full = bench.at_least(bench.fit(&wide, work)?, &narrow, work)?;
    let ratio = bench.ratio((null, &narrow), &full)?;
    let parts = bench.parts(&full, work)?;
    work.go_on()?;
    let drawn = match job.bootstrap.resolved(false) {
        None => None,
        Some(asked) => {
            let data = (&reading.labels, &tests[..]);
            let asked_of = (ratio.statistic, asked);
            let mut goes_on = |done| known::drawing(work, done, asked);
            let found = dynamic_bootstrap_while((null, &narrow), &wide, data, &bench.settings, asked_of, &mut goes_on);
            let found = found.map_err(|error| Failure::Simulate {
                error: Box::new(error),
                reading: Some(Box::new(reading.clone())),
            })?;
            Some((asked, found.ok_or(Failure::Interrupted)?))
        }
    };
    let inferred = [bench.infer(null, &narrow, work)?, bench.infer(&wide, &full, work)?];
    let sides = DynamicSides {
        null: parts_of(null, &reading.labels, &narrow, &inferred[0]),
        alternative: parts_of(&wide, &reading.labels, &full, &inferred[1]),
    };
    let drawn = drawn.as_ref().map(|(asked, found)| (*asked, found));
    let mut record = RatioRecord::dynamic(&sides, &ratio, drawn, parts, provenance);
    if is_of_mean(&wide, null)
        && let Some(found) = bench.f_test(&narrow, work)
    {
        record.add_f(found);
    }
    Ok(record)
}

fn parts_of<'a>(
    model: &'a PhasedModel,
    labels: &'a Labels,
    fit: &'a DynamicFit,
    (inference, parameters): &'a (Inference, Vec<ParameterInference>),
) -> DynamicParts<'a> {
    DynamicParts { model, labels, fit, inference, parameters }
}

/// What all fits of a test share.
struct FreeParameterTest<'a> {
    wide: &'a PhasedModel,
    null: &'a PhasedModel,
    tests: &'a [PhasedTest],
    reading: &'a DataReading,
    settings: Settings,
}

impl FreeParameterTest<'_> {
    fn fit_with(
        &self,
        model: &PhasedModel,
        settings: &Settings,
        work: &mut JobWork<'_>,
    ) -> Result<DynamicFit, Failure> {
        work.go_on()?;
        SearchData { model, tests: self.tests, reading: self.reading }.fit(settings, work)
    }

    fn fit(&self, model: &PhasedModel, work: &mut JobWork<'_>) -> Result<DynamicFit, Failure> {
        self.fit_with(model, &self.settings, work)
    }

    fn infer(
        &self,
        model: &PhasedModel,
        fit: &DynamicFit,
        work: &mut JobWork<'_>,
    ) -> Result<(Inference, Vec<ParameterInference>), Failure> {
        let choices = Choices { deletion: DeletionChoice::None, ..Choices::default() };
        let data = (&self.reading.labels, self.tests);
        dynamic::infer(model, data, fit, choices, work).map_err(|error| failure(error, self.reading))
    }

    /// The F test of a hypothesis on means, by the restricted likelihood of the model; `None` without its maximum.
    fn f_test(&self, null: &DynamicFit, work: &mut JobWork<'_>) -> Option<Result<JointTest, NoJointTest>> {
        let inner = estimate::Settings { criterion: Criterion::Reml, ..self.settings.inner.clone() };
        let wide = self.fit_with(self.wide, &Settings { inner, ..self.settings.clone() }, work).ok()?;
        let (inference, _) = self.infer(self.wide, &wide, work).ok()?;
        Some(inference.few_tests?.ok()?.law.f_test(&wide.estimate, &null.estimate))
    }

    /// The model fitted again, from the hypothesis and from elsewhere, when the hypothesis has the higher likelihood.
    fn at_least(&self, full: DynamicFit, narrow: &DynamicFit, work: &mut JobWork<'_>) -> Result<DynamicFit, Failure> {
        let (found, least) = (full.estimate.log_likelihood, narrow.estimate.log_likelihood);
        if found >= least - 1e-9 * least.abs().max(1.0) {
            return Ok(full);
        }
        let settings = Settings { starts: STARTS, ..self.settings.clone() };
        let again = self.fit_with(&started(self.wide, (self.null, narrow)), &settings, work)?;
        Ok(if again.estimate.log_likelihood > found { again } else { full })
    }

    fn ratio(&self, null: (&PhasedModel, &DynamicFit), full: &DynamicFit) -> Result<LikelihoodRatio, Failure> {
        dynamic_ratio(null, (self.wide, full), self.tests).map_err(Failure::DynamicRatio)
    }

    /// A hypothesis on more than one of μ, Σ and α, each by itself.
    fn parts(&self, full: &DynamicFit, work: &mut JobWork<'_>) -> Result<Vec<PartRecord>, Failure> {
        let (wide, null) = (self.wide, self.null);
        let parts = [
            ("mean", with_mean(wide, null)),
            ("covariance", with_covariance(wide, null)),
            ("parameters", with_parameters(wide, null)),
        ];
        let alone: Vec<(&str, PhasedModel)> =
            parts.into_iter().filter_map(|(what, model)| Some((what, model?))).collect();
        if alone.len() < 2 {
            return Ok(Vec::new());
        }
        let mut parts = Vec::new();
        for (what, model) in alone {
            let fit = self.fit(&model, work)?;
            match self.ratio((&model, &fit), full) {
                Ok(ratio) => parts.push(PartRecord::dynamic(what, &fit, &ratio)),
                Err(Failure::DynamicRatio(DynamicRatioError::Structure(NotNested::Same))) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(parts)
    }
}
