//! One place of tests, and the answers of the place to questions about these tests.

use std::sync::{Arc, Mutex, PoisonError};

use crate::dynamic;
use crate::shards::error::ShardError;
use crate::shards::search::refuse_model;
use kalfit_estimate::{Silent, Structure, Summed};
use kalfit_filter::reduce::{FilteredPhases, PhasedReducer, ReduceError, Reductions, grouping};
use kalfit_filter::score::{Batching, Gradient, PhasedScorer};
use kalfit_infer::observability_counts;
use kalfit_model::remote::{Answer, Asked, Law, Question};
use kalfit_model::{Evidence, PhasedTest};
use kalfit_model::{Grouping, Labels};
use kalfit_model::{PhasedModel, Slots};
use kalfit_search::{Around, Scale, Settings, add_exact};

/// The tests of one place; tests of one group of the outermost level must all be in the same place. An answer depends
/// on the tests and the question only; cached results only save work.
#[derive(Debug)]
pub struct Shard {
    model: PhasedModel,
    /// Tests, sorted by id.
    tests: Vec<PhasedTest>,
    /// Groups of the tests, where the model has levels.
    grouping: Option<Arc<Grouping>>,
    /// Sorted names of the groups of the outermost level.
    groups: Vec<String>,
    slots: Slots,
    settings: Settings,
    batching: Batching,
    /// `Some` if the only free value scales all noise, so that the filters need to run at few values of α only.
    scale: Option<Scale>,
    /// Cached results for the tests at the α requested last.
    cached: Mutex<Option<ShardAtAlpha>>,
}

/// Reductions and filtered batches of the tests at one α.
#[derive(Debug)]
struct ShardAtAlpha {
    values: Vec<f64>,
    summed: Summed,
    /// Batches of tests after their filters, where scores need them.
    filtered: Option<FilteredPhases>,
}

impl Shard {
    /// The shard of these tests of a model; `settings`: settings of the search for start values.
    ///
    /// # Errors
    /// A model that cannot be fitted by sums; tests that are not given by rows although parameters are free; tests that
    /// cannot be grouped.
    pub fn new(
        model: PhasedModel,
        labels: &Labels,
        mut tests: Vec<PhasedTest>,
        settings: Settings,
    ) -> Result<Shard, ShardError> {
        refuse_model(&model, &settings.inner)?;
        let slots = Slots::in_phases(&model, labels, &tests);
        let is_rows = |test: &PhasedTest| test.phases.iter().all(|evidence| matches!(evidence, Evidence::Rows(_)));
        if let (Some(slot), Some(test)) = (slots.slots().first(), tests.iter().find(|test| !is_rows(test))) {
            let parameter = model.shared().parameters[slot.parameter].name.clone();
            return Err(ShardError::NotRows { test: test.id.to_string(), parameter });
        }
        tests.sort_by(|a, b| a.id.cmp(&b.id));
        let grouping = grouping(&model, &tests)?.map(Arc::new);
        let mut groups = grouping.as_deref().map_or(Vec::new(), |grouping| apart(&model, labels, grouping));
        groups.sort();
        let scale = Scale::of(&model, &tests, &slots);
        let (batching, cached) = (Batching::default(), Mutex::new(None));
        Ok(Shard { model, tests, grouping, groups, slots, settings, batching, scale, cached })
    }

    /// Number of tests.
    pub fn tests(&self) -> usize {
        self.tests.len()
    }

    /// Sorted names of the groups of the outermost level and of the levels of crossed factors; all tests of a group must be
    /// in one place.
    pub fn groups(&self) -> &[String] {
        &self.groups
    }

    /// The answer to a question; `None` where the answer is not defined at the free values of the question.
    ///
    /// # Errors
    /// A question about another model; a test that has no reduction, where no parameter is free.
    pub fn answer(&self, asked: &Asked) -> Result<Answer, ShardError> {
        if asked.values.len() != self.slots.len() {
            return Err(ShardError::Question { what: "the number of free values" });
        }
        if asked.question == Question::Opening {
            let context = (&self.slots, &self.settings);
            return Ok(Some(dynamic::opening(&self.model, &self.tests, context, &mut Silent)));
        }
        let mut cached = self.cached.lock().unwrap_or_else(PoisonError::into_inner);
        if cached.as_ref().is_none_or(|cached| cached.values != asked.values) {
            *cached = None;
            match self.reduce(&asked.values) {
                Ok(made) => *cached = Some(made),
                Err(error) if self.slots.is_empty() => return Err(error),
                Err(_) => return Ok(None),
            }
        }
        let ShardAtAlpha { summed, filtered, .. } = cached.as_mut().expect("it was set");
        match &asked.question {
            Question::Score { law } => self.score(&asked.values, (summed, filtered.as_ref()), law),
            Question::Observability { frame } => match observability_counts(summed, frame) {
                Some(counts) => Ok(Some(counts)),
                None => Err(ShardError::Question { what: "the number of states" }),
            },
            question => summed.answer(question).ok_or(ShardError::Question { what: "the number of states" }),
        }
    }

    fn reduce(&self, values: &[f64]) -> Result<ShardAtAlpha, ShardError> {
        let alpha = self.slots.alpha(self.model.shared(), values);
        let filter = |value: f64| Ok(self.reduce_only(&[value])?);
        let scaled = match &self.scale {
            Some(scale) => scale.reductions_from(origin(values[0]), values[0], &filter).map_err(Box::new)?,
            None => None,
        };
        let (reductions, filtered) = scaled.map_or_else(|| self.filter(values), |reductions| Ok((reductions, None)))?;
        let summed = Summed::new(reductions, &Structure::of(&self.model, &alpha, self.grouping.as_ref()));
        Ok(ShardAtAlpha { values: values.to_vec(), summed, filtered })
    }

    /// Runs the filters, and stores the batches that scores need, unless no value is free or `scale` gives the scores.
    fn filter(&self, values: &[f64]) -> Result<(Reductions, Option<FilteredPhases>), Box<ReduceError>> {
        if self.slots.is_empty() || self.scale.is_some() {
            return Ok((self.reduce_only(values)?, None));
        }
        let alpha = self.slots.alpha(self.model.shared(), values);
        let mut reducer = PhasedReducer::scoring(&self.model, &alpha, &self.slots)?;
        Ok(self.batching.reduce((&self.model, &self.slots), &mut reducer, &self.tests)?)
    }

    /// Runs the filters for the reductions only.
    fn reduce_only(&self, values: &[f64]) -> Result<Reductions, Box<ReduceError>> {
        let alpha = self.slots.alpha(self.model.shared(), values);
        PhasedReducer::passing(&self.model, &alpha, &self.slots)?.reduce(&self.tests).map_err(Box::new)
    }

    /// The sum Σ dℓ_j/dα over the tests.
    fn score(
        &self,
        values: &[f64],
        (summed, filtered): (&mut Summed, Option<&FilteredPhases>),
        law: &Law,
    ) -> Result<Answer, ShardError> {
        let law = summed.law(law).ok_or(ShardError::Question { what: "the number of states" })?;
        if let Some(scores) = self.scale.as_ref().and_then(|scale| scale.scores(values[0], &summed.reductions, &law)) {
            return Ok(finite_sum(&scores, values.len()));
        }
        let alpha = self.slots.alpha(self.model.shared(), values);
        let found = || {
            let reducer = PhasedReducer::scoring(&self.model, &alpha, &self.slots)?;
            let scorer = PhasedScorer::new(&self.model, &reducer, &self.slots)?;
            let known = (self.batching.classes(&reducer, &self.tests), filtered);
            let mut scores = scorer.scores(&self.tests, &summed.reductions, &law, known)?;
            let alpha = |values: &[f64]| self.slots.alpha(self.model.shared(), values);
            let around = Around { model: &self.model, tests: &self.tests, slots: &self.slots, alpha: &alpha };
            add_exact(&around, values, (&summed.reductions, &law), &mut scores)?;
            Ok::<_, ReduceError>(scores)
        };
        let Ok(scores) = found() else { return Ok(None) };
        Ok(finite_sum(&scores, values.len()))
    }
}

/// The sum of the scores over tests (`values` numbers); `None` where a component is not finite.
fn finite_sum(scores: &[Gradient], values: usize) -> Answer {
    let mut sum = vec![0.0; values];
    scores.iter().flatten().for_each(|&(slot, bar)| sum[slot] += bar);
    sum.iter().all(|x| x.is_finite()).then_some(sum)
}

/// The value from which `value` is scaled: the nearest power of four, which depends on `value` alone.
fn origin(value: f64) -> f64 {
    if value > 0.0 && value.is_finite() { 2f64.powi(2 * (0.5 * value.log2()).round() as i32) } else { value }
}

/// Names of the groups whose tests must be in one place: those of the outermost level and, with the name of the factor
/// before that of the level, those of crossed factors.
fn apart(model: &PhasedModel, labels: &Labels, grouping: &Grouping) -> Vec<String> {
    let of = |level: usize| {
        let factor = &model.levels[grouping.depth() - 1 - level];
        let name = move |group: &kalfit_model::Group| match factor.crossed {
            true => format!("{}: {}", factor.name, labels.text(group.path[0])),
            false => labels.text(group.path[0]).to_owned(),
        };
        grouping.groups(level).iter().map(name)
    };
    (grouping.nested().saturating_sub(1)..grouping.depth()).flat_map(of).collect()
}
