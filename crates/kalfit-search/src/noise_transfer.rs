//! Transfer of variance between measurement noises with free covariances and a nearly white process.
//!
//! ```text
//! R + h h'σ²      covariance of measurements with noise covariance R and h times a white process of variance σ²
//! ```
//!
//! So noise may take over such a process, covariances included, or a process may take over noise up to the variance σ²
//! = 1/(h'R⁻¹h): ℓ is unchanged, and a search may lead on from the other explanation. If one variance alone replaced
//! another, ℓ would fall far, because measurements would be correlated differently.

use nalgebra::{DMatrix, DVector};

use crate::profile_likelihood::ProfileLikelihood;
use kalfit_model::{Expression, Model, Operator};

/// Part of the possible variance that a process does not take over: covariances are sought within the bounds that
/// variances set.
const UNTAKEN_PART: f64 = 1e-2;

/// Noises of measurements with free covariances, and the coefficients of one process in these measurements.
pub(super) struct NoiseTransfer<'b, 'a> {
    objective: &'b ProfileLikelihood<'a>,
    /// (Slot of the noise level, exponent k with variance = level^k) of each measurement.
    levels: Vec<(usize, f64)>,
    /// Free covariances of the noises of measurements i and j, as (i, j, slot).
    covariances: Vec<(usize, usize, usize)>,
    /// Coefficients h of the process in the measurements.
    loadings: DVector<f64>,
    /// (Slot of the level of the process, exponent k with variance = level^k).
    process: (usize, f64),
}

impl<'b, 'a> NoiseTransfer<'b, 'a> {
    /// The noises with free covariances, which must include the noise of level `s`, and the process of level `t`;
    /// `None` where there are no such noises, or where levels, covariances or coefficients are not simple enough for ℓ
    /// to stay unchanged.
    pub(super) fn of(objective: &'b ProfileLikelihood<'a>, s: usize, t: usize) -> Option<Self> {
        let [phase] = &objective.model.phases[..] else { return None };
        let model = &phase.model;
        let slot = |covariance: &Expression| match covariance {
            Expression::Parameter(p) => objective.slots.common(*p).filter(|&slot| objective.edges.has(slot)),
            _ => None,
        };
        let free = model.noise_covariance.iter().map(|(i, j, covariance)| Some((*i, *j, slot(covariance)?)));
        let free: Vec<(usize, usize, usize)> = free.collect::<Option<_>>()?;
        let mut measurements: Vec<usize> = free.iter().flat_map(|&(i, j, _)| [i, j]).collect();
        measurements.sort_unstable();
        measurements.dedup();
        let place = |m: usize| measurements.iter().position(|&other| other == m);
        let covariances = free.iter().filter_map(|&(i, j, slot)| Some((place(i)?, place(j)?, slot))).collect();
        let level = |&m: &usize| level_of(objective, &model.measurements[m].noise_variance);
        let levels: Vec<(usize, f64)> = measurements.iter().map(level).collect::<Option<_>>()?;
        let loadings = loadings(model, objective.slots.slots()[t].parameter, &measurements)?;
        let noises =
            NoiseTransfer { objective, levels, covariances, loadings, process: (t, objective.coordinates[t].level?) };
        (noises.levels.iter().any(|(level, _)| *level == s) && noises.is_complete()).then_some(noises)
    }

    /// Whether each level belongs to one measurement, and all measurements that contain the process have covariances
    /// with each other.
    fn is_complete(&self) -> bool {
        let count = self.levels.len();
        let seen = |i: usize| self.loadings[i] != 0.0;
        let has = |i: usize, j: usize| self.covariances.iter().any(|&(a, b, _)| (a, b) == (i, j) || (a, b) == (j, i));
        (0..count).any(seen)
            && (0..count)
                .all(|i| (0..i).all(|j| self.levels[i].0 != self.levels[j].0 && (!seen(i) || !seen(j) || has(i, j))))
    }

    /// Slot of the noise level of the first measurement.
    pub(super) fn first(&self) -> usize {
        self.levels[0].0
    }

    /// The sought values with the process given to the noises.
    pub(super) fn given(&self, sought: &[f64]) -> Vec<f64> {
        let mut values = self.objective.values(sought);
        let (t, exponent) = self.process;
        let variance = values[t].powf(exponent);
        let noises = self.covariance_of_noises(&values) + &self.loadings * self.loadings.transpose() * variance;
        values[t] = 0.0;
        self.values_with_noises(values, &noises)
    }

    /// The sought values with as much of the noises as possible given to the process; `None` where that is nothing.
    pub(super) fn taken(&self, sought: &[f64]) -> Option<Vec<f64>> {
        let mut values = self.objective.values(sought);
        let noises = self.covariance_of_noises(&values);
        let information = self.loadings.dot(&noises.clone().cholesky()?.solve(&self.loadings));
        let variance =
            Some((1.0 - UNTAKEN_PART) / information).filter(|variance| variance.is_finite() && *variance > 0.0)?;
        let (t, exponent) = self.process;
        let taker = self.objective.coordinates[t];
        values[t] = variance.powf(exponent.recip()).clamp(taker.lower, taker.upper);
        let remaining_noise = noises - &self.loadings * self.loadings.transpose() * values[t].powf(exponent);
        Some(self.values_with_noises(values, &remaining_noise))
    }

    /// The covariance R of the noises.
    fn covariance_of_noises(&self, values: &[f64]) -> DMatrix<f64> {
        let variances = self.levels.iter().map(|&(level, exponent)| values[level].powf(exponent));
        let mut covariance_of_noises = DMatrix::from_diagonal(&DVector::from_iterator(self.levels.len(), variances));
        for &(i, j, slot) in &self.covariances {
            (covariance_of_noises[(i, j)], covariance_of_noises[(j, i)]) = (values[slot], values[slot]);
        }
        covariance_of_noises
    }

    /// The sought values for a given covariance R of the noises.
    fn values_with_noises(&self, mut values: Vec<f64>, noises: &DMatrix<f64>) -> Vec<f64> {
        for (m, &(level, exponent)) in self.levels.iter().enumerate().filter(|(m, _)| self.loadings[*m] != 0.0) {
            let coordinate = self.objective.coordinates[level];
            values[level] = noises[(m, m)].max(0.0).powf(exponent.recip()).clamp(coordinate.lower, coordinate.upper);
        }
        self.covariances.iter().for_each(|&(i, j, slot)| values[slot] = noises[(i, j)]);
        self.objective.sought(&values)
    }
}

/// Slot of the level θ, common to all tests, and the exponent k, 1 or 2, of a variance θ^k; `None` for another
/// variance.
fn level_of(objective: &ProfileLikelihood<'_>, variance: &Expression) -> Option<(usize, f64)> {
    let (parameter, exponent) = match variance {
        Expression::Parameter(p) => (*p, 1.0),
        Expression::Binary(Operator::Multiply, a, b) if a == b => match &**a {
            Expression::Parameter(p) => (*p, 2.0),
            _ => return None,
        },
        _ => return None,
    };
    let slot = objective.slots.common(parameter)?;
    (objective.coordinates[slot].level == Some(exponent)).then_some((slot, exponent))
}

/// Coefficients, in these measurements, of the one state that a level drives; `None` unless they are numbers and no
/// other measurement contains that state.
fn loadings(model: &Model, driven: usize, measurements: &[usize]) -> Option<DVector<f64>> {
    let drives = |k: &usize| model.states[*k].motion.noise_variance().is_some_and(|variance| variance.mentions(driven));
    let mut states = (0..model.states.len()).filter(drives);
    let state = states.next().filter(|_| states.next().is_none())?;
    let all = (0..model.measurements.len()).map(|m| loading(model, m, state)).collect::<Option<Vec<f64>>>()?;
    let is_elsewhere = (0..all.len()).any(|m| all[m] != 0.0 && !measurements.contains(&m));
    (!is_elsewhere).then(|| DVector::from_iterator(measurements.len(), measurements.iter().map(|&m| all[m])))
}

/// Coefficient of a state in a measurement, where that is a number.
fn loading(model: &Model, measurement: usize, state: usize) -> Option<f64> {
    let terms = &model.measurements[measurement].equation.terms;
    let Some((_, coefficient)) = terms.iter().find(|(of, _)| *of == state) else { return Some(0.0) };
    match coefficient {
        Expression::Negate(a) => a.as_number().map(|x| -x),
        other => other.as_number(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use kalfit_fixtures::by_hand::Lcg;
    use kalfit_model::PhasedTest;
    use kalfit_model::build::{Formula, ModelBuilder, constant, free, gauss_markov, measurement, name};
    use kalfit_model::{Labels, Source, Test};
    use kalfit_model::{PhasedModel, Slots};

    /// y = a + p + noise and z = a - 0.3 p + noise with these noise levels; `more` extends the model, whose free values
    /// are `values`.
    fn instruments(
        levels: [Formula; 2],
        more: impl Fn(ModelBuilder) -> ModelBuilder,
        values: &[&'static str],
    ) -> PhasedModel {
        let [first, second] = levels;
        let model = kalfit_model::Model::builder("")
            .time("t")
            .state(constant("a"))
            .state(gauss_markov("p", "tau", "sigma"))
            .measurement(measurement("y", name("a") + name("p"), first))
            .measurement(measurement("z", name("a") - 0.3 * name("p"), second));
        values.iter().fold(more(model), |model, name| model.parameter(free(*name))).build().unwrap()
    }

    fn crossed(model: ModelBuilder) -> ModelBuilder {
        model.noise_covariance("y", "z", name("c"))
    }

    const VALUES: &[&str] = &["tau", "sigma", "s", "r", "c"];

    fn tests(model: &PhasedModel) -> Vec<PhasedTest> {
        let mut random = Lcg(3);
        let columns = &model.shared().columns;
        let one = |j: usize| {
            let mut test = Test::new(format!("u{j}"), columns.len(), 0);
            for k in 0..7 {
                let cell = |name: &str| if name == "t" { f64::from(k) } else { random.normal() };
                let cells: Vec<f64> = columns.iter().map(|column| column.name.as_str()).map(cell).collect();
                test.push(&cells, &[], Source::default());
            }
            test.into()
        };
        (0..6).map(one).collect()
    }

    #[test]
    fn a_white_process_and_noises_with_a_covariance_are_one_explanation() {
        let model = instruments([name("s"), name("r")], crossed, VALUES);
        let (tests, settings) = (tests(&model), Settings::default());
        let slots = Slots::in_phases(&model, &Labels::default(), &tests);
        let objective = ProfileLikelihood::new(&model, &tests, &slots, &settings);
        let white = objective.sought(&[0.02, 0.6, 0.5, 0.7, 0.1]);
        let noises = NoiseTransfer::of(&objective, 2, 1).expect("they have a covariance");
        let given = noises.given(&white);
        let found = objective.values(&given);
        for (found, expected) in
            found.iter().zip([0.02, 0.0, 0.61f64.sqrt(), (0.49f64 + 0.09 * 0.36).sqrt(), 0.1 - 0.3 * 0.36])
        {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        let taken = noises.taken(&given).expect("noise that a process may take over");
        assert!(taken[1] > 0.6 && taken[4].abs() <= 1.0, "more than before: {taken:?}");
        let [before, between, after] =
            [&white, &given, &taken].map(|place| objective.solve(place, None).expect("defined").value());
        assert!((between - before).abs() < 1e-8 && (after - before).abs() < 1e-8, "{before} {between} {after}");
        // the remaining noises have hardly any variance in the direction of the process
        let (remaining_noise, h) = (noises.covariance_of_noises(&objective.values(&taken)), &noises.loadings);
        let full = h.dot(&(noises.covariance_of_noises(&found).try_inverse().expect("regular") * h));
        assert!(
            (full * h.dot(&(remaining_noise.try_inverse().expect("regular") * h)).recip() - UNTAKEN_PART).abs() < 1e-6
        );
    }

    fn is_crossed(model: &PhasedModel) -> bool {
        let (slots, settings) = (Slots::new(model.shared(), &Labels::default(), &[]), Settings::default());
        NoiseTransfer::of(&ProfileLikelihood::new(model, &[], &slots, &settings), 2, 1).is_some()
    }

    #[test]
    fn noises_that_are_not_that_simple_are_not_crossed() {
        let both = || [name("s"), name("r")];
        assert!(is_crossed(&instruments(both(), crossed, VALUES)));
        assert!(!is_crossed(&instruments(both(), |model| model, &VALUES[..4])), "no covariance");
        let part = [name("s"), 2.0 * name("r")];
        assert!(!is_crossed(&instruments(part, crossed, VALUES)), "twice a level");
        let one = [name("s"), name("s")];
        assert!(!is_crossed(&instruments(one, crossed, &["tau", "sigma", "s", "c"])), "one level of both");
        let elsewhere = |model| crossed(model).measurement(measurement("w", name("p"), 0.5));
        assert!(!is_crossed(&instruments(both(), elsewhere, VALUES)), "the process is seen elsewhere");
        let beside = |model| crossed(model).state(gauss_markov("q", 3.0, "sigma"));
        assert!(!is_crossed(&instruments(both(), beside, VALUES)), "another process of that size");
    }
}
