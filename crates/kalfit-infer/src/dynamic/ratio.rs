//! Likelihood-ratio tests where α is estimated too.
//!
//! The restriction of (μ, Σ) by the hypothesis is judged at the model's α. The law of the whole statistic, with nothing
//! on a boundary, is χ² with all r degrees of freedom. One quantity on its boundary, a variance or a value of α, makes
//! the tangent cone a half space: ½χ²_{r-1} + ½χ²_r, for any other estimated quantities. With several quantities on a
//! boundary, the cone is part of a half space, and the projection onto a part is no longer than the projection onto the
//! whole, so this mixture bounds the law from above.

use crate::{Bootstrap, BootstrapResult, Component, LikelihoodRatio, NotNested, ReferenceLaw};
use crate::{GoesOn, NotNestedParameter, Restricted, fit_null, likelihood_ratio, replicates, restricted};
use kalfit_estimate::{FitError, Silent, Stop, Structure, fit_from};
use kalfit_filter::simulate::{Designs, SimulateError, Simulator};
use kalfit_model::Labels;
use kalfit_model::PhasedTest;
use kalfit_model::{PhasedModel, Population, Value};
use kalfit_search::fit;
use kalfit_search::{DynamicFit, Settings};

/// Why a hypothesis cannot be tested.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DynamicRatioError {
    /// The hypothesis allows μ or Σ that the model does not, or restricts nothing.
    #[error(transparent)]
    Structure(#[from] NotNested),
    /// The hypothesis allows α that the model does not.
    #[error(transparent)]
    Parameter(#[from] NotNestedParameter),
    /// μ and Σ of the hypothesis cannot be estimated at the model's α.
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// Tests a hypothesis within a model, both fitted to the same tests.
///
/// # Errors
/// Fails for a hypothesis that is not within the model, or that restricts nothing.
pub fn dynamic_ratio(
    null: (&PhasedModel, &DynamicFit),
    wide: (&PhasedModel, &DynamicFit),
    tests: &[PhasedTest],
) -> Result<LikelihoodRatio, DynamicRatioError> {
    let removed = restricted((null.0, &null.1.slots), (wide.0, &wide.1.slots), tests)?;
    let population_part = population(null.0, wide)?;
    if population_part.is_none() && removed.count == 0 {
        return Err(NotNested::Same.into());
    }
    let gap = wide.1.estimate.log_likelihood - null.1.estimate.log_likelihood;
    let degrees_of_freedom = removed.count + population_part.as_ref().map_or(0, |r| r.degrees_of_freedom);
    Ok(LikelihoodRatio {
        statistic: if degrees_of_freedom == 0 { 0.0 } else { (2.0 * gap).max(0.0) },
        degrees_of_freedom,
        law: law(population_part.as_ref().map(|r| &r.law), removed, degrees_of_freedom),
        null_on_boundary: population_part.is_some_and(|r| r.null_on_boundary),
    })
}

/// Likelihood ratio of the hypothesis about μ and Σ, at the model's α; `None` when the hypothesis restricts neither μ
/// nor Σ at this α.
fn population(
    null: &PhasedModel,
    wide: (&PhasedModel, &DynamicFit),
) -> Result<Option<LikelihoodRatio>, DynamicRatioError> {
    let (model, fit) = wide;
    let of = |model| Structure::of(model, &fit.alpha, fit.estimate.grouping());
    let (structure, within) = (of(null), of(model));
    let settings = &fit.estimate.state.settings;
    let narrow = fit_null(&fit.reductions, &within, &structure, settings, &mut Silent).ok_or(NotNested::Mean)??;
    let found = match likelihood_ratio(&narrow, &fit.estimate) {
        // the search ended in coordinates of another α
        Err(NotNested::Different) => {
            let start = Population::from(&fit.estimate);
            likelihood_ratio(&narrow, &fit_from(&fit.reductions, &within, &start, settings, &mut Silent)?)
        }
        found => found,
    };
    match found {
        Ok(ratio) => Ok(Some(ratio)),
        Err(NotNested::Same) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

fn law(population_part: Option<&ReferenceLaw>, removed: Restricted, r: usize) -> ReferenceLaw {
    // quantities of μ and Σ on the boundary: none, one, or more
    let boundary_count = match population_part {
        None => 0,
        Some(law) if law.is_chi_squared() => 0,
        Some(law) if is_half_space(law) => 1,
        Some(_) => 2,
    };
    match boundary_count + removed.at_bound {
        0 => ReferenceLaw { is_bound: population_part.is_some_and(|law| law.is_bound), ..ReferenceLaw::chi_squared(r) },
        boundary_count => {
            let half = |degrees_of_freedom| Component { degrees_of_freedom, weight: 0.5 };
            let components = vec![half(r.saturating_sub(1)), half(r)];
            ReferenceLaw { independent: components.clone(), components, is_bound: boundary_count > 1 }
        }
    }
}

fn is_half_space(law: &ReferenceLaw) -> bool {
    let even = |c: &Component| (c.weight - 0.5).abs() < 1e-9;
    matches!(&law.components[..], [a, b] if even(a) && even(b) && a.degrees_of_freedom + 1 == b.degrees_of_freedom)
        && !law.is_bound
}

/// Draws ensembles with new data from the hypothesis, and fits α, μ and Σ of hypothesis and model to each ensemble.
/// Replicate b is the b-th round of the tests that [`Simulator`] draws with the seed.
///
/// # Errors
/// Data cannot be drawn for these tests.
pub fn dynamic_bootstrap(
    null: (&PhasedModel, &DynamicFit),
    wide: &PhasedModel,
    data: (&Labels, &[PhasedTest]),
    settings: &Settings,
    asked_of: (f64, Bootstrap),
) -> Result<BootstrapResult, SimulateError> {
    let found = dynamic_bootstrap_while(null, wide, data, settings, asked_of, &mut |_| true)?;
    Ok(found.expect("nobody stops it"))
}

/// Result of the bootstrap as from [`dynamic_bootstrap`]; `None` once `goes_on` returns false.
///
/// # Errors
/// As [`dynamic_bootstrap`].
pub fn dynamic_bootstrap_while(
    null: (&PhasedModel, &DynamicFit),
    wide: &PhasedModel,
    (labels, tests): (&Labels, &[PhasedTest]),
    settings: &Settings,
    (statistic, asked): (f64, Bootstrap),
    goes_on: GoesOn<'_>,
) -> Result<Option<BootstrapResult>, SimulateError> {
    let (model, fit) = null;
    let simulator = Simulator::new(model, &fit.alpha, Population::from(&fit.estimate), asked.seed)?;
    let designs = Designs::of(model, tests.to_vec())?;
    let starts = [started(model, null), started(wide, null)];
    let n = tests.len() as u64;
    let one = |b: usize| -> Result<Option<f64>, SimulateError> {
        let drawn = simulator.draw(&designs, b as u64 * n..(b as u64 + 1) * n)?;
        let drawn: Vec<PhasedTest> = drawn.into_iter().map(|one| one.test).collect();
        let [narrow, full] = [(&starts[0], model), (&starts[1], wide)].map(|(near, plain)| {
            [near, plain].into_iter().find_map(|model| certified(model, labels, &drawn, settings))
        });
        let gap = narrow.zip(full).map(|(narrow, full)| 2.0 * (full - narrow));
        Ok(gap.filter(|gap| *gap >= -1e-6).map(|gap| gap.max(0.0)))
    };
    let Some(found) = replicates(asked.replicates, one, goes_on) else { return Ok(None) };
    let found: Vec<Option<f64>> = found.into_iter().collect::<Result<_, _>>()?;
    Ok(Some(BootstrapResult::of(&found, statistic)))
}

/// ℓ at a certified maximum.
fn certified(model: &PhasedModel, labels: &Labels, tests: &[PhasedTest], settings: &Settings) -> Option<f64> {
    let fit = fit(model, labels, tests, settings, &mut Silent).ok()?;
    (fit.stop == Stop::Certified && fit.estimate.stop == Stop::Certified).then_some(fit.estimate.log_likelihood)
}

/// The model with each free parameter starting at the estimate of a fit: the mean over the levels of the parameter.
pub fn started(model: &PhasedModel, (of, fit): (&PhasedModel, &DynamicFit)) -> PhasedModel {
    let mut parameters = model.shared().parameters.clone();
    for (index, parameter) in parameters.iter_mut().enumerate() {
        let Value::Free { start } = &mut parameter.value else { continue };
        let own = fit.slots.slots().iter().zip(&fit.values).filter(|(slot, _)| slot.parameter == index);
        let mut values: Vec<f64> = own.map(|(_, value)| *value).collect();
        if let (true, Value::Fixed(value)) = (values.is_empty(), of.shared().parameters[index].value) {
            values.push(value);
        }
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        // a positive parameter cannot start at zero
        if !values.is_empty() && mean.is_finite() && (mean > 0.0 || !parameter.positive) {
            *start = Some(mean);
        }
    }
    let mut model = model.clone();
    model.phases.iter_mut().for_each(|phase| phase.model.parameters.clone_from(&parameters));
    model
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mixture(weights: &[(usize, f64)], is_bound: bool) -> ReferenceLaw {
        let components: Vec<Component> =
            weights.iter().map(|&(degrees_of_freedom, weight)| Component { degrees_of_freedom, weight }).collect();
        ReferenceLaw { independent: components.clone(), components, is_bound }
    }

    fn half_space(r: usize) -> ReferenceLaw {
        mixture(&[(r - 1, 0.5), (r, 0.5)], false)
    }

    #[test]
    fn one_quantity_on_its_boundary_makes_a_half_space_whatever_else_falls_away() {
        let free = Restricted { count: 3, at_bound: 0 };
        let edge = Restricted { count: 3, at_bound: 1 };
        let plain = ReferenceLaw::chi_squared(2);
        assert_eq!(law(None, free, 3), ReferenceLaw::chi_squared(3));
        assert_eq!(law(None, edge, 3), half_space(3));
        assert_eq!(law(Some(&plain), free, 5), ReferenceLaw::chi_squared(5));
        assert_eq!(law(Some(&plain), edge, 5), half_space(5));
        assert_eq!(law(Some(&half_space(2)), free, 5), half_space(5));
    }

    #[test]
    fn several_quantities_on_their_boundaries_have_a_bound() {
        let bound = ReferenceLaw { is_bound: true, ..half_space(4) };
        assert_eq!(law(None, Restricted { count: 4, at_bound: 2 }, 4), bound);
        assert_eq!(law(Some(&half_space(2)), Restricted { count: 2, at_bound: 1 }, 4), bound);
        let three = mixture(&[(0, 0.3), (1, 0.5), (2, 0.2)], false);
        assert_eq!(law(Some(&three), Restricted { count: 2, at_bound: 0 }, 4), bound);
        // two independent ones: the bound is no smaller anywhere
        let two = mixture(&[(0, 0.25), (1, 0.5), (2, 0.25)], false);
        let bound = law(None, Restricted { count: 2, at_bound: 2 }, 2);
        for x in [0.1, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0] {
            let (above, below) = (bound.tail(x), two.tail(x));
            assert!(above >= below, "at {x}: {above} is below {below}");
        }
    }
}
