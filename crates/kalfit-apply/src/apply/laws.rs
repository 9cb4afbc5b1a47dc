//! Laws of distances and residuals of tests that are compared with estimated parameters.

use std::borrow::Cow;

use rayon::prelude::*;

use crate::apply::doubt::{EstimateErrors, ParameterEffect, Trust};
use crate::apply::law::{DistanceSum, Law};
use crate::apply::tree::{TestTree, Weights};
use crate::apply::{Applied, ApplyError, Said};
use kalfit_filter::reduce::{PhasedReducer, Reductions};
use kalfit_infer::{Distance, Estimand, Knowledge};
use kalfit_model::Evidence;
use kalfit_model::{Alpha, Slots};

/// Laws of the results of tests, in the order of the results. A law is `None` without degrees of freedom, where the
/// result depends on a quantity that the data of the fit do not determine, and where the fit has too few tests.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Laws {
    /// Law of the sum of the distances of all tests, or of all groups of the outermost level, from the population.
    pub distance: Option<Law>,
    /// Law of the sum of distances within groups, where tests are in groups.
    pub within: Option<Law>,
    /// Law of the sum of all residuals.
    pub residual: Option<Law>,
    /// Law of the distance of each test.
    pub tests: Vec<Option<Law>>,
    /// Law of the distance of each group, the innermost level first.
    pub groups: Vec<Vec<Option<Law>>>,
    /// Law of each test's residual.
    pub residuals: Vec<Option<Law>>,
}

impl Laws {
    /// χ² for every result: for known parameters, and for tests that the parameters were estimated from.
    pub fn known(said: &Said) -> Laws {
        let of = |degrees: usize| (degrees > 0).then(|| Law::chi_squared(degrees as f64));
        let of_distance = |distance: &Distance| of(distance.degrees_of_freedom);
        let [distance, within, residual] = said.degrees();
        Laws {
            distance: of(distance.1),
            within: of(within.1),
            residual: of(residual.1),
            tests: said.posteriors.iter().map(|test| of_distance(&test.distance)).collect(),
            groups: said
                .groups
                .iter()
                .map(|level| level.iter().map(|group| of_distance(&group.distance)).collect())
                .collect(),
            residuals: said.residuals.iter().map(|own| own.and_then(|(_, degrees)| of(degrees))).collect(),
        }
    }
}

/// Number of tests in one parallel task.
const CHUNK: usize = 256;

impl Applied<'_> {
    /// Laws of the results of tests that the parameters were not estimated from.
    ///
    /// # Errors
    /// The errors of [`Applied::new`]: the tests are reduced again for derivatives.
    pub fn laws(&self, said: &Said, trust: &Trust<'_>) -> Result<Laws, ApplyError> {
        let knowledge = match trust {
            Trust::Estimates(knowledge) => knowledge.of_few_tests(),
            Trust::Tests(_) => Cow::Owned(Knowledge::exact()),
        };
        let doubt = EstimateErrors::new(self.model, &knowledge, &|state| self.varies(state));
        let tree = self.tree(&self.reductions, &doubt);
        let moved = self.moved(&tree, &doubt)?;
        let builder = LawBuilder { said, trust, doubt, tree, moved };
        Ok(builder.laws())
    }

    /// Whether a state differs from test to test.
    fn varies(&self, state: usize) -> bool {
        let (p, sigma) = (self.model.dimension(), &self.population.covariance);
        (state..sigma.nrows()).step_by(p).any(|i| sigma[(i, i)] > 0.0)
    }

    fn tree(&self, reductions: &Reductions, doubt: &EstimateErrors<'_>) -> TestTree {
        let own = (reductions, self.model.dimension());
        TestTree::new(own, self.population, self.grouping.as_deref(), &|reduction| doubt.effect(reduction))
    }

    /// Derivatives of the expectations with respect to each estimated parameter, by differences between a higher and a
    /// lower value of the parameter. Empty where a phase of a test is not given by rows.
    fn moved(&self, tree: &TestTree, doubt: &EstimateErrors<'_>) -> Result<Vec<ParameterEffect>, ApplyError> {
        let is_reduced = self.tests.iter().any(|test| test.phases.iter().any(|own| !matches!(own, Evidence::Rows(_))));
        if is_reduced {
            return Ok(Vec::new());
        }
        let of = |(index, known, error): (Option<usize>, &Estimand, Option<f64>)| {
            let Some((sides, width)) = known.sides(self.model, self.alpha, error) else { return Ok(None) };
            let sides = sides.map(|alpha| self.reductions_at(&alpha));
            let [low, high] = sides;
            let (low, high) = (low?, high?);
            let trees = [&low, &high].map(|own| self.tree(own, doubt));
            let trees = [&trees[0], &trees[1]];
            let per_width = |x: f64| if (x / width).is_finite() { x / width } else { 0.0 };
            let level =
                |level: usize| tree.log_det_differences(level, trees).into_iter().map(per_width).collect::<Vec<f64>>();
            let residual = |at: usize| {
                let log_det = |own: &Reductions| -2.0 * own.get(at).constant - own.get(at).residual.unwrap_or(f64::NAN);
                let [j, k] = trees.map(|tree| &tree.nodes[0][at].information);
                per_width(log_det(&high) - log_det(&low) + tree.log_det_information_change(0, at, j, k))
            };
            let (residuals, groups) = ((0..self.tests.len()).map(residual).collect(), 1..=tree.depth());
            let (tests, groups) = (level(0), groups.map(level).collect());
            Ok(Some(ParameterEffect {
                index,
                all: per_width(tree.joint_log_det_difference(trees)),
                tests,
                groups,
                residuals,
            }))
        };
        let all: Result<Vec<Option<ParameterEffect>>, ApplyError> = doubt.parameters().map(of).collect();
        Ok(all?.into_iter().flatten().collect())
    }

    fn reductions_at(&self, alpha: &Alpha) -> Result<Reductions, ApplyError> {
        let slots = Slots::none(self.model.shared());
        Ok(PhasedReducer::scoring(self.model, alpha, &slots)?.reduce(self.tests)?)
    }
}

/// Inputs of the laws: results of the tests, errors of the estimates, and weights of Σ, means and parameters.
struct LawBuilder<'a> {
    said: &'a Said,
    trust: &'a Trust<'a>,
    doubt: EstimateErrors<'a>,
    tree: TestTree,
    moved: Vec<ParameterEffect>,
}

impl LawBuilder<'_> {
    fn laws(&self) -> Laws {
        let (tests, of_tests) = self.tests();
        let of_groups: Vec<Vec<Weights>> = (1..=self.tree.depth()).map(|level| self.tree.groups(level)).collect();
        let groups: Vec<Vec<Option<Law>>> =
            of_groups.iter().enumerate().map(|(level, all)| self.groups(level, all)).collect();
        let [distance, within, residual] = self.said.degrees();
        let outermost = of_groups.last().map(|all| Weights::sum(all.iter()));
        let outer_slope = |moved: &ParameterEffect| -> f64 {
            moved.groups.last().map_or_else(|| moved.tests.iter().sum(), |groups| groups.iter().sum())
        };
        let distance_weights = outermost.as_ref().unwrap_or(&of_tests);
        let within = outermost.as_ref().and_then(|groups| {
            let posteriors: Vec<Vec<_>> =
                self.said.groups.iter().map(|level| level.iter().map(|group| &group.covariance).collect()).collect();
            let mut all = self.tree.all(&posteriors);
            all.of_means.clone_from(&groups.of_means);
            all.add(groups, -1.0);
            self.law(&all, within, 0, &|moved| moved.all - outer_slope(moved))
        });
        Laws {
            distance: self.law(distance_weights, distance, self.tree.depth(), &outer_slope),
            within,
            residual: self.residual(residual.1, &|moved| moved.residuals.iter().sum()),
            tests,
            groups,
            residuals: (0..self.said.residuals.len())
                .map(|test| {
                    self.said.residuals[test].and_then(|own| self.residual(own.1, &|moved| moved.residuals[test]))
                })
                .collect(),
        }
    }

    /// Laws of the distances of tests, and the weights in the sum of the distances.
    fn tests(&self) -> (Vec<Option<Law>>, Weights) {
        let outer_sigma = self.tree.outer_sigma(0);
        let indices: Vec<usize> = (0..self.said.posteriors.len()).collect();
        let chunk = |indices: &[usize]| {
            let all: Vec<Weights> = indices.iter().map(|&test| self.tree.test(test, &outer_sigma)).collect();
            let law = |(&test, weights): (&usize, &Weights)| {
                let degrees = self.said.posteriors.get(test).distance.degrees_of_freedom;
                self.law(weights, (1, degrees), self.tree.depth(), &|moved| moved.tests[test])
            };
            let laws: Vec<Option<Law>> = indices.iter().zip(&all).map(law).collect();
            (laws, Weights::sum(all.iter()))
        };
        let parts: Vec<(Vec<Option<Law>>, Weights)> = indices.par_chunks(CHUNK).map(chunk).collect();
        let sum = Weights::sum(parts.iter().map(|(_, sum)| sum));
        (parts.into_iter().flat_map(|(laws, _)| laws).collect(), sum)
    }

    fn groups(&self, level: usize, all: &[Weights]) -> Vec<Option<Law>> {
        let law = |(group, weights): (usize, &Weights)| {
            let degrees = self.said.groups[level][group].distance.degrees_of_freedom;
            self.law(weights, (1, degrees), self.tree.depth(), &|moved| moved.groups[level][group])
        };
        all.iter().enumerate().map(law).collect()
    }

    /// Law of a sum over `count` tests or groups, with `degrees` degrees of freedom. `level`: level whose Σ contributes
    /// most to the differences between the tests or groups; `moved`: derivative of the expected sum with respect to a
    /// parameter.
    fn law(
        &self,
        weights: &Weights,
        (count, degrees): (usize, usize),
        level: usize,
        moved: &dyn Fn(&ParameterEffect) -> f64,
    ) -> Option<Law> {
        if count == 0 || degrees == 0 {
            return None;
        }
        let (count, degrees) = (count as f64, degrees as f64);
        if let Trust::Tests(tests) = *self.trust {
            let is_within = level < self.tree.depth();
            return if is_within {
                Some(Law::chi_squared(degrees))
            } else {
                DistanceSum::of_tests(count, degrees, tests as f64).law()
            };
        }
        let own: Vec<(&ParameterEffect, f64)> = self.moved.iter().map(|one| (one, moved(one))).collect();
        if self.doubt.depends_on_open(weights, &own, degrees) {
            return None;
        }
        let variance = self.doubt.variance(weights, &own) / (degrees * degrees);
        let degrees_each = (degrees / count).max(1.0);
        let (dimension, sharing_variance) = self.doubt.dimension(&weights.of_level[level], level);
        let (dimension, sharing_variance) = (dimension.min(degrees_each), sharing_variance.min(degrees_each));
        let of_mean = self.doubt.of_means(&weights.of_means);
        let is_of_means = of_mean > 0.0;
        let means = if is_of_means { self.doubt.means(&weights.of_means, of_mean) as f64 } else { 0.0 };
        let knowledge = self.doubt.knowledge;
        let (is_biased, tests) = (!knowledge.is_restricted && is_of_means, knowledge.tests);
        DistanceSum { count, degrees, dimension, sharing_variance, variance, of_mean, means, is_biased, tests }.law()
    }

    /// Law of a residual or of a sum of residuals, on which only errors of the dynamic parameters have an effect.
    fn residual(&self, degrees: usize, moved: &dyn Fn(&ParameterEffect) -> f64) -> Option<Law> {
        let degrees = degrees as f64;
        if degrees == 0.0 {
            return None;
        }
        let own: Vec<(&ParameterEffect, f64)> = self.moved.iter().map(|one| (one, moved(one))).collect();
        if self.doubt.depends_on_open_parameter(&own, degrees) {
            return None;
        }
        let variance = self.doubt.variance_by_parameters(&own) / (degrees * degrees);
        Some(match variance > f64::EPSILON {
            true => Law { denominator: 2.0 / variance, ..Law::chi_squared(degrees) },
            false => Law::chi_squared(degrees),
        })
    }
}
