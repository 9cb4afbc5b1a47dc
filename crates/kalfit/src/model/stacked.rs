//! Populations of tests in several phases: ξ = (ξ_1, …, ξ_I), independent from phase to phase (theory §7).

use std::ops::Range;

use nalgebra::DMatrix;

use crate::model::{Alpha, PhasedModel, Population, PopulationError};

impl Population {
    /// The population that a model file describes, all phases together: what it fixes, else what it gives as start value.
    ///
    /// # Errors
    /// As [`Population::of_model`], the first phase's; what has no value is said with its phase.
    pub fn of_phases(model: &PhasedModel, alpha: &Alpha) -> Result<Population, PopulationError> {
        let mut missing = Vec::new();
        let mut all = Vec::new();
        for phase in &model.phases {
            match Population::of_model(&phase.model, alpha) {
                Ok(own) => all.push(own),
                Err(PopulationError::NoValue { elements }) if model.is_single() => missing.extend(elements),
                Err(PopulationError::NoValue { elements }) => {
                    missing.extend(elements.iter().map(|element| format!("{element} of phase `{}`", phase.name)));
                }
                Err(error) => return Err(error),
            }
        }
        if missing.is_empty() { Ok(Population::stack(&all)) } else { Err(PopulationError::NoValue { elements: missing }) }
    }

    /// Populations of the phases, in their order, as one: Σ is block-diagonal.
    pub fn stack(phases: &[Population]) -> Population {
        let p = phases.iter().map(|phase| phase.mean.len()).sum();
        let mut covariance = DMatrix::zeros(p, p);
        let mut first = 0;
        for phase in phases {
            let own = &phase.covariance;
            covariance.view_mut((first, first), own.shape()).copy_from(own);
            first += own.nrows();
        }
        let all = |of: fn(&Population) -> &[f64]| phases.iter().flat_map(of).copied().collect();
        Population { mean: all(|phase| &phase.mean), coefficients: all(|phase| &phase.coefficients), covariance }
    }

    /// The population of each phase. `self` passed [`Population::check_phases`].
    pub(crate) fn apart(&self, model: &PhasedModel) -> Vec<Population> {
        let mut coefficients = self.coefficients.as_slice();
        let of = |(phase, range): (&crate::model::Phase, Range<usize>)| {
            let (own, rest) = coefficients.split_at(phase.model.mean.regression.len());
            coefficients = rest;
            let covariance = self.covariance.view((range.start, range.start), (range.len(), range.len())).into_owned();
            Population { mean: self.mean[range].to_vec(), coefficients: own.to_vec(), covariance }
        };
        model.phases.iter().zip(model.ranges()).map(of).collect()
    }

    /// Whether it has the dimensions of the phases together, finite values, and a covariance that is symmetric, positive
    /// semidefinite, and zero between states of different phases.
    ///
    /// # Errors
    /// The first of these that it has not.
    pub fn check_phases(&self, model: &PhasedModel) -> Result<(), PopulationError> {
        let names = model.estimated_names();
        let regressions = model.phases.iter().map(|phase| phase.model.mean.regression.len()).sum();
        self.check_named(names.len(), regressions, &|i| names[i].clone())?;
        for range in model.ranges() {
            for (j, i) in range.clone().flat_map(|j| (range.end..names.len()).map(move |i| (j, i))) {
                let found = self.covariance[(i, j)];
                if found != 0.0 {
                    let (first, second) = (names[j].clone(), names[i].clone());
                    return Err(PopulationError::AcrossPhases { first, second, found });
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{CovarianceStructure, MeanStructure, Model, Phase, Regression};

    /// Phases of 2 and 1 estimated states, the second with a regression.
    fn model() -> PhasedModel {
        let state = |name: &str| crate::model::State {
            name: name.to_owned(),
            unit: None,
            motion: crate::model::Motion::Constant,
            initial: crate::model::Initial::Estimated,
            offset: None,
            random: true,
        };
        let of = |names: &[&str], regression: Vec<Regression>| Model {
            title: String::new(),
            columns: vec![crate::model::Column { name: "u".into(), used_in: String::new() }],
            text_columns: Vec::new(),
            literals: Vec::new(),
            parameters: Vec::new(),
            states: names.iter().map(|name| state(name)).collect(),
            process_noise_covariance: Vec::new(),
            measurements: Vec::new(),
            noise_covariance: Vec::new(),
            clock: Default::default(),
            group: None,
            estimated: (0..names.len()).collect(),
            mean: MeanStructure { regression, ..MeanStructure::free(names.len()) },
            covariance: CovarianceStructure::full(),
        };
        let phase = |name: &str, model| Phase { name: name.into(), label: None, model, carry: vec![], filter: None };
        let second = of(&["c"], vec![Regression { element: 0, column: 0 }]);
        PhasedModel { phases: vec![phase("one", of(&["a", "b"], Vec::new())), phase("two", second)], column: None }
    }

    fn population() -> Population {
        let covariance = DMatrix::from_row_slice(3, 3, &[4.0, 1.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 9.0]);
        Population { mean: vec![1.0, 2.0, 3.0], coefficients: vec![0.5], covariance }
    }

    #[test]
    fn phases_stack_and_come_apart() {
        let (model, whole) = (model(), population());
        whole.check_phases(&model).expect("sound");
        let apart = whole.apart(&model);
        assert_eq!((apart[0].mean.as_slice(), apart[0].coefficients.as_slice()), (&[1.0, 2.0][..], &[][..]));
        assert_eq!((apart[1].covariance[(0, 0)], apart[1].coefficients.as_slice()), (9.0, &[0.5][..]));
        assert_eq!(Population::stack(&apart), whole);
    }

    #[test]
    fn states_of_different_phases_are_not_correlated() {
        let mut whole = population();
        (whole.covariance[(2, 0)], whole.covariance[(0, 2)]) = (0.1, 0.1);
        let error = whole.check_phases(&model()).expect_err("phases are independent");
        assert_eq!(error.to_string(), "the covariance of `one.a` and `two.c` is 0.1, expected 0 between phases");
    }

    #[test]
    fn what_has_no_value_is_named_with_its_phase() {
        let error = Population::of_phases(&model(), &Alpha::default()).expect_err("nothing has a value");
        let PopulationError::NoValue { elements } = error else { panic!("{error}") };
        assert_eq!(elements[0], "mean[a] of phase `one`");
        assert!(elements.contains(&"covariance[c, c] of phase `two`".to_owned()), "{elements:?}");
    }
}
