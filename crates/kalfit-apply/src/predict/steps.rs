//! The delta method: variances of predicted values by errors of the estimates, from predictions at α with each free
//! value moved down and up.

use std::ops::Range;

use nalgebra::DVector;

use crate::predict::degrees::LostDegrees;
use crate::predict::few_tests::FewTestsInput;
use crate::predict::value::PredictedValue;
use crate::predict::{Estimation, Initial};
use kalfit_infer::{Estimand, Estimated, Knowledge, MOST_OF_A_VALUE, MeanAndVarianceLaw};
use kalfit_model::{Alpha, Phase, PhasedModel};

/// Fraction of the scale of a derivative below which the derivative counts as zero.
const NEGLIGIBLE_SLOPE: f64 = 1e-9;

/// α with each free value moved down and up, for derivatives by differences.
#[derive(Debug)]
pub(super) struct ValueSteps {
    /// For each estimated quantity, then for each quantity that the data do not determine: (index in `moved` of α with
    /// the lower value, followed by α with the higher value; difference of the two values). `None` without such a pair.
    side_indices: Vec<Option<(usize, f64)>>,
    /// Indices in `moved` of each α in which a noise level that was estimated as zero is set to one.
    probes: Vec<usize>,
    /// (Element of μ, column of the data) of each regression coefficient.
    regressions: Vec<(usize, usize)>,
    moved: Vec<Alpha>,
}

impl ValueSteps {
    pub(super) fn new(model: &PhasedModel, alpha: &Alpha, knowledge: Option<&Knowledge>) -> ValueSteps {
        let of_phase = |(phase, range): (&Phase, Range<usize>)| {
            let own = phase.model.mean.regression.iter();
            own.map(move |regression| (range.start + regression.element, regression.column)).collect::<Vec<_>>()
        };
        let regressions = model.phases.iter().zip(model.ranges()).flat_map(of_phase).collect();
        let mut steps = ValueSteps { side_indices: Vec::new(), probes: Vec::new(), regressions, moved: Vec::new() };
        let Some(knowledge) = knowledge else { return steps };
        let errors = (0..knowledge.quantities.len()).map(|i| Some(knowledge.covariance[(i, i)].max(0.0).sqrt()));
        let all = knowledge.quantities.iter().zip(errors).chain(knowledge.open.iter().map(|open| (open, None)));
        for (known, error) in all {
            let place = known.sides(model, alpha, error).map(|(sides, width)| {
                steps.moved.extend(sides);
                (steps.moved.len() - 2, width)
            });
            steps.side_indices.push(place);
        }
        for known in &knowledge.at_zero {
            let mut alpha = alpha.clone();
            if let Some(own) = known.value(model, &mut alpha) {
                *own = 1.0;
                steps.probes.push(steps.moved.len());
                steps.moved.push(alpha);
            }
        }
        steps
    }

    /// Whether a free variance or noise level that was estimated as zero would affect a value.
    pub(super) fn hangs_on_zero(
        &self,
        knowledge: &Knowledge,
        initial: &Initial,
        value: &PredictedValue,
        sides: &[&PredictedValue],
    ) -> bool {
        let p = initial.mean.len();
        let own = value.sensitivity.rows(0, p);
        let largest = own.amax();
        let is_seen = |known: &Estimand| match *known {
            Estimand::Population(Estimated::Covariance(i, _)) => {
                let is_counted = knowledge.few_tests.as_ref().is_some_and(|law| law.quantities.contains(known));
                let level = i / p;
                let of_effects = initial.slots.of_effects(level, own.as_slice());
                let is_felt = of_effects.iter().any(|own| own[i % p].abs() > NEGLIGIBLE_SLOPE * largest);
                !is_counted && initial.levels.contains(&level) && is_felt
            }
            _ => false,
        };
        let variance = |side: &PredictedValue| side.population(&initial.covariance) + side.process;
        let moves = |&place: &usize| variance(sides[place]) > variance(value) * (1.0 + NEGLIGIBLE_SLOPE);
        knowledge.at_zero.iter().any(is_seen) || self.probes.iter().any(moves)
    }

    /// Whether a variance between groups that affects a value of a known group was estimated as zero.
    pub(super) fn is_drawn_to_zero(knowledge: &Knowledge, initial: &Initial, value: &PredictedValue) -> bool {
        let p = initial.mean.len();
        let own = value.sensitivity.rows(0, p);
        let is_seen = |known: &Estimand| match *known {
            Estimand::Population(Estimated::Covariance(i, _)) if i >= p => {
                let of_effects = initial.all_slots.of_effects(i / p, own.as_slice());
                of_effects.iter().any(|of_slot| of_slot[i % p].abs() > NEGLIGIBLE_SLOPE * own.amax())
            }
            _ => false,
        };
        initial.left.is_some() && knowledge.at_zero.iter().any(is_seen)
    }

    pub(super) fn moved(&self) -> impl Iterator<Item = &Alpha> {
        self.moved.iter()
    }

    fn lost(&self, knowledge: &Knowledge, initial: &Initial, of: &Slopes<'_>, all: &[[f64; 3]]) -> usize {
        let slopes = |part: usize| DVector::from_iterator(all.len(), all.iter().map(|slopes| slopes[part]));
        let degrees = LostDegrees {
            knowledge,
            covariance: &initial.covariance,
            regressions: &self.regressions,
            by_mean: slopes(0),
            by_variance: slopes(1),
            affects: &|element| of.own[element].abs() > NEGLIGIBLE_SLOPE * of.own.amax(),
        };
        degrees.lost()
    }

    /// Variances of the estimates of a value's mean and of the value's variance over tests; `sides`: the value at each
    /// α of `moved`. `None` where the value depends on a quantity that the data do not determine.
    pub(super) fn estimation(
        &self,
        knowledge: &Knowledge,
        initial: &Initial,
        value: &PredictedValue,
        sides: &[&PredictedValue],
    ) -> Option<Estimation> {
        let of = Slopes::new(self, initial, value, sides);
        let count = knowledge.quantities.len();
        if knowledge.open.iter().enumerate().any(|(k, open)| of.depends_on(count + k, open)) {
            return None;
        }
        let all: Vec<[f64; 3]> = knowledge.quantities.iter().enumerate().map(|(at, one)| of.by(at, one)).collect();
        let variance = |of: &dyn Fn(&[f64; 3]) -> f64| {
            let gradient = DVector::from_iterator(count, all.iter().map(of));
            gradient.dot(&(&knowledge.covariance * &gradient))
        };
        let found =
            [variance(&|slopes| slopes[0]), variance(&|slopes| slopes[1] + slopes[2]), variance(&|slopes| slopes[1])];
        let [mean, variance, population] = found.map(|x| if x < 0.0 { 0.0 } else { x });
        let left = initial.left.as_ref().map_or(0.0, |left| value.population(left));
        let is_known = mean.is_finite() && variance.is_finite() && population.is_finite();
        let few_tests =
            knowledge.few_tests.as_ref().and_then(|law| of.few_tests(law, (knowledge, &all), left)?.errors());
        let (mean, variance, population) = match &few_tests {
            Some(few) => (few.mean.unwrap_or(mean) + left, few.variance, few.population),
            None => (mean + left, variance, population),
        };
        is_known.then_some(Estimation {
            mean,
            variance,
            population,
            lost: self.lost(knowledge, initial, &of, &all),
            is_restricted: knowledge.is_restricted,
            tests: knowledge.tests,
            few_tests: few_tests.map(|few| few.degrees),
        })
    }
}

/// Derivatives of one value with respect to the estimates.
struct Slopes<'a> {
    steps: &'a ValueSteps,
    initial: &'a Initial,
    value: &'a PredictedValue,
    sides: &'a [&'a PredictedValue],
    /// Derivatives of the mean with respect to ξ (`own`) and to μ (`by_mean`).
    own: DVector<f64>,
    by_mean: DVector<f64>,
}

impl<'a> Slopes<'a> {
    fn new(
        steps: &'a ValueSteps,
        initial: &'a Initial,
        value: &'a PredictedValue,
        sides: &'a [&'a PredictedValue],
    ) -> Slopes<'a> {
        let own = value.sensitivity.rows(0, initial.mean.len()).into_owned();
        let by_mean = initial.shrinkage.as_ref().map_or(own.clone(), |shrinkage| shrinkage.transpose() * &own);
        Slopes { steps, initial, value, sides, own, by_mean }
    }

    /// Derivatives of (mean, variance by the initial state, variance by process noise) with respect to the estimand
    /// with index `at`.
    fn by(&self, at: usize, estimand: &Estimand) -> [f64; 3] {
        if let Estimand::Population(own) = *estimand {
            return self.by_population(own);
        }
        let along_group = self.along_group(estimand);
        let Some((place, width)) = self.steps.side_indices[at] else { return [along_group, 0.0, 0.0] };
        let [below, above] = [self.sides[place], self.sides[place + 1]];
        let slope = |of: &dyn Fn(&PredictedValue) -> f64| (of(above) - of(below)) / width;
        let population = |side: &PredictedValue| side.population(&self.initial.covariance);
        [along_group + slope(&|side| side.mean), slope(&population), slope(&|side| side.process)]
    }

    /// The same with respect to a mean, a coefficient or an element of Σ.
    fn by_population(&self, estimated: Estimated) -> [f64; 3] {
        let p = self.own.len();
        match estimated {
            Estimated::Mean(i) => [self.by_mean.get(i).copied().unwrap_or(0.0), 0.0, 0.0],
            Estimated::Coefficient(c) => {
                let known = self.initial.by_coefficients.as_ref().map_or(0.0, |by| by.column(c).dot(&self.own));
                [self.value.sensitivity[p + c] + known, 0.0, 0.0]
            }
            Estimated::Covariance(i, j) => {
                let (level, both) = (i / p, if i == j { 1.0 } else { 2.0 });
                let of_effects = self.initial.slots.of_effects(level, self.own.as_slice());
                let product = || of_effects.iter().map(|own| own[i % p] * own[j % p]).sum::<f64>();
                let by_variance = if self.initial.levels.contains(&level) { both * product() } else { 0.0 };
                [self.along_group(&Estimand::Population(estimated)), by_variance, 0.0]
            }
            Estimated::Value(_) => [0.0; 3],
        }
    }

    /// Derivative of the mean of a known group.
    fn along_group(&self, estimand: &Estimand) -> f64 {
        let known = self.initial.by_estimates.as_ref().and_then(|by| by.get(estimand));
        known.map_or(0.0, |by| by.dot(&self.own))
    }

    /// The derivatives by (μ, γ) and by θ of `law`; `all`: those by the quantities of `knowledge`. `None` where a
    /// parameter of θ is not among them.
    fn few_tests<'b>(
        &'b self,
        law: &'b MeanAndVarianceLaw<Estimand>,
        (knowledge, all): (&Knowledge, &[[f64; 3]]),
        left: f64,
    ) -> Option<FewTestsInput<'b>> {
        let p = self.own.len();
        let by_mean = DVector::from_fn(law.mean_covariance.nrows(), |i, _| {
            let quantity = if i < p { Estimated::Mean(i) } else { Estimated::Coefficient(i - p) };
            self.by_population(quantity)[0]
        });
        let by_theta = law.quantities.iter().map(|quantity| match quantity {
            Estimand::Population(own) => Some(self.by_population(*own)),
            Estimand::Parameter { .. } => Some(all[knowledge.quantities.iter().position(|own| own == quantity)?]),
        });
        Some(FewTestsInput {
            law,
            initial: self.initial,
            own: &self.own,
            by_mean,
            by_theta: by_theta.collect::<Option<_>>()?,
            variance: self.value.population(&self.initial.covariance) + self.value.process,
            left,
        })
    }

    /// Whether the value depends on the estimand with index `at`.
    fn depends_on(&self, at: usize, estimand: &Estimand) -> bool {
        let size = self.own.amax();
        if let Estimand::Population(_) = estimand {
            let found = self.by(at, estimand);
            return found[0].abs() > NEGLIGIBLE_SLOPE * size || found[1].abs() > NEGLIGIBLE_SLOPE * size.powi(2);
        }
        let Some((place, _)) = self.steps.side_indices[at] else { return false };
        let [below, above] = [self.sides[place], self.sides[place + 1]];
        let variance = |side: &PredictedValue| side.population(&self.initial.covariance) + side.process;
        let moves = |of: &dyn Fn(&PredictedValue) -> f64, size: f64| {
            (of(above) - of(below)).abs() > NEGLIGIBLE_SLOPE * MOST_OF_A_VALUE * size
        };
        moves(&|side| side.mean, self.value.mean.abs() + size) || moves(&variance, variance(self.value))
    }
}
