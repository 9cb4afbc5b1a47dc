//! The result of a likelihood-ratio test as a record: test.json.

use serde::{Deserialize, Serialize};

use crate::few_tests;
use crate::square::rows;
use crate::{DataRecord, ParameterRecord};
use kalfit_estimate::{Estimate, Stop};
use kalfit_filter::reduce::Reductions;
use kalfit_infer::{Bootstrap, BootstrapResult, Component, JointTest, LikelihoodRatio, NoJointTest};
use kalfit_model::PhasedModel;

/// All results of the test of a hypothesis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RatioRecord {
    /// Always `kalfit-test/1`.
    pub schema: String,
    /// Version that made it.
    pub kalfit_version: String,
    /// Title of the model.
    pub title: String,
    /// Name of the hypothesis.
    pub hypothesis: String,
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// SHA-256 of the file of the hypothesis.
    pub null_digest: Option<String>,
    /// Counts.
    pub data: DataRecord,
    /// The fit under the hypothesis.
    pub null: SideRecord,
    /// The fit of the model.
    pub alternative: SideRecord,
    /// Both fits are certified.
    pub converged: bool,
    /// -2 log λ = 2 (ℓ of the model - ℓ of the hypothesis).
    pub lr: f64,
    /// The F test by the restricted likelihood, of a hypothesis on means alone; absent where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f: Option<FRecord>,
    /// Identified free quantities that the hypothesis takes away.
    pub df: usize,
    /// Tail probability of `lr` under `law`.
    pub p_value: f64,
    /// Tail probability under χ² with `df` degrees of freedom: too large where the hypothesis lies on a boundary.
    pub p_chi2_df: f64,
    /// Tail probability under the mixture whose weights textbooks give, those of independent estimates; null for a
    /// plain χ².
    pub p_mixture: Option<f64>,
    /// The mixture of `p_mixture` in words: `0.5 chi2_0; 0.5 chi2_1`.
    pub mixture: Option<String>,
    /// The large-sample law: χ² distributions with their weights.
    pub law: Vec<ComponentRecord>,
    /// Whether `law` is only an upper bound: `p_value` may then be too large, never too small.
    pub law_is_bound: bool,
    /// The parametric bootstrap.
    pub bootstrap: Option<BootstrapRecord>,
    /// The parts of a hypothesis on more than one of μ, Σ and α, each by itself (Shumway, Olsen and Levy).
    pub parts: Vec<PartRecord>,
    /// Findings in plain words, most important first.
    pub notes: Vec<String>,
}

/// An F test of means, for few tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FRecord {
    /// F, with the scale.
    pub value: f64,
    /// Number of combinations of means that the hypothesis fixes.
    pub df_num: usize,
    /// Degrees of freedom of the denominator; null where no covariance is estimated.
    pub df_den: Option<f64>,
    /// Scale by Kenward and Roger, which F contains.
    pub scale: f64,
    /// Tail probability of `value`.
    pub p_value: f64,
    /// `kenward-roger` or `satterthwaite`.
    pub method: String,
}

/// One of the two fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SideRecord {
    /// log p of all measurements.
    pub log_likelihood: f64,
    /// Declared free quantities.
    pub free_parameters: usize,
    /// The optimality certificate holds.
    pub converged: bool,
    /// The estimated states, in the order of μ and Σ; `phase.state` where there are several phases.
    #[serde(default)]
    pub states: Vec<String>,
    /// μ of all phases in a row.
    pub mean: Vec<f64>,
    /// Σ of all phases, zero between them.
    pub covariance: Vec<Vec<f64>>,
    /// Dynamic parameters, where some are free.
    #[serde(default)]
    pub parameters: Vec<ParameterRecord>,
}

/// A χ² distribution with its weight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ComponentRecord {
    /// Degrees of freedom.
    pub df: usize,
    /// Weight.
    pub weight: f64,
}

/// Results of the parametric bootstrap.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BootstrapRecord {
    /// Number of ensembles drawn.
    pub replicates: usize,
    /// Number of ensembles whose fits were not certified; these do not count.
    pub failed: usize,
    /// Seed.
    pub seed: u64,
    /// (1 + replicates at or above `lr`) / (1 + replicates); null when none counts.
    pub p_value: Option<f64>,
    /// Standard error of the p-value.
    pub std_error: Option<f64>,
    /// 95 % point of the statistic.
    pub quantile95: Option<f64>,
}

/// One part of a hypothesis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PartRecord {
    /// `mean`, `covariance` or `parameters`.
    pub what: String,
    /// -2 log λ of this part alone, with the others as in the model.
    pub lr: f64,
    /// Degrees of freedom.
    pub df: usize,
    /// Tail probability.
    pub p_value: f64,
    /// log p of all measurements under this part.
    pub log_likelihood: f64,
    /// Its fit is certified.
    pub converged: bool,
}

/// Facts about a test that the core does not know.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RatioProvenance {
    /// Title of the model.
    pub title: String,
    /// Name of the hypothesis.
    pub hypothesis: String,
    /// SHA-256 of the model file.
    pub model_digest: Option<String>,
    /// SHA-256 of the hypothesis.
    pub null_digest: Option<String>,
    /// Data files, as named by the user.
    pub files: Vec<String>,
}

impl RatioRecord {
    /// The record of a test of `null` within `alternative`, fits of a hypothesis and of the model that contains it.
    /// Both have the model's states.
    pub fn new(
        model: &PhasedModel,
        reductions: &Reductions,
        (null, alternative): (&Estimate, &Estimate),
        ratio: &LikelihoodRatio,
        bootstrap: Option<(Bootstrap, &BootstrapResult)>,
        parts: Vec<PartRecord>,
        provenance: RatioProvenance,
    ) -> RatioRecord {
        let sides = (side(model, null), side(model, alternative));
        let (mut notes, independent) =
            (Vec::new(), bootstrap.is_none().then(|| independent(model, alternative, reductions)));
        add_doubts(&mut notes, ratio, (&sides.0, &sides.1), "variances with free covariances", independent);
        RatioRecord::at(reductions, sides, ratio, bootstrap, (parts, notes), provenance)
    }

    /// The record with the given sides and notes.
    pub(super) fn at(
        reductions: &Reductions,
        (null, alternative): (SideRecord, SideRecord),
        ratio: &LikelihoodRatio,
        bootstrap: Option<(Bootstrap, &BootstrapResult)>,
        (parts, notes): (Vec<PartRecord>, Vec<String>),
        provenance: RatioProvenance,
    ) -> RatioRecord {
        let law = &ratio.law;
        let mixed = !law.is_chi_squared() && !law.is_bound;
        RatioRecord {
            schema: "kalfit-test/1".to_owned(),
            kalfit_version: env!("CARGO_PKG_VERSION").to_owned(),
            title: provenance.title,
            hypothesis: provenance.hypothesis,
            model_digest: provenance.model_digest,
            null_digest: provenance.null_digest,
            data: DataRecord::of(reductions, provenance.files),
            converged: null.converged && alternative.converged,
            lr: ratio.statistic,
            f: None,
            df: ratio.degrees_of_freedom,
            p_value: ratio.p_value(),
            p_chi2_df: ratio.chi_squared_p_value(),
            p_mixture: mixed.then(|| law.tail_if_independent(ratio.statistic)),
            mixture: mixed.then(|| words(&law.independent)),
            law: law.components.iter().map(component).collect(),
            law_is_bound: law.is_bound,
            notes,
            bootstrap: bootstrap.map(|(request, found)| BootstrapRecord::of(request, found)),
            parts,
            null,
            alternative,
        }
    }
}

impl RatioRecord {
    /// Adds the F test of means, or why there is none.
    pub fn add_f(&mut self, found: Result<JointTest, NoJointTest>) {
        match found {
            Ok(JointTest { value, df_num, df_den, scale, p_value, method }) => {
                let method = few_tests::name(method).to_owned();
                self.f = Some(FRecord { value, df_num, df_den, scale, p_value, method });
            }
            Err(NoJointTest::TooFew) => {
                self.notes.push("there is no F test: too few tests for a joint test".to_owned())
            }
            Err(NoJointTest::Unidentified | NoJointTest::Dependent) => {
                self.notes
                    .push("there is no F test: the tests do not determine the variance of these means".to_owned());
            }
        }
    }
}

impl BootstrapRecord {
    fn of(request: Bootstrap, found: &BootstrapResult) -> BootstrapRecord {
        let counts = !found.statistics.is_empty();
        let mut sorted = found.statistics.clone();
        sorted.sort_by(f64::total_cmp);
        let at = (0.95 * (sorted.len() as f64 + 1.0)).ceil() as usize;
        BootstrapRecord {
            replicates: request.replicates,
            failed: found.failed,
            seed: request.seed,
            p_value: counts.then_some(found.p_value),
            std_error: counts.then_some(found.std_error),
            quantile95: sorted.get(at.wrapping_sub(1)).copied(),
        }
    }
}

impl PartRecord {
    /// The record of one part that was tested alone.
    pub fn new(what: &str, null: &Estimate, ratio: &LikelihoodRatio) -> PartRecord {
        PartRecord {
            what: what.to_owned(),
            lr: ratio.statistic,
            df: ratio.degrees_of_freedom,
            p_value: ratio.p_value(),
            log_likelihood: null.log_likelihood,
            converged: null.stop == Stop::Certified,
        }
    }
}

pub(super) fn side(model: &PhasedModel, estimate: &Estimate) -> SideRecord {
    SideRecord {
        states: model.element_names(),
        log_likelihood: estimate.log_likelihood,
        free_parameters: estimate.declared_mean() + estimate.declared_covariance(),
        converged: estimate.stop == Stop::Certified,
        mean: estimate.mean.clone(),
        covariance: rows(&estimate.covariance),
        parameters: Vec::new(),
    }
}

fn component(component: &Component) -> ComponentRecord {
    ComponentRecord { df: component.degrees_of_freedom, weight: component.weight }
}

/// The mixture in words: `0.5 chi2_0; 0.5 chi2_1`.
fn words(components: &[Component]) -> String {
    let word = |c: &Component| format!("{} chi2_{}", c.weight, c.degrees_of_freedom);
    components.iter().map(word).collect::<Vec<_>>().join("; ")
}

/// Number of tests below which large-sample laws are only a rough guide.
const FEW_TESTS: usize = 50;

/// (Number of tests, or of groups of the outermost level; the noun for the number, such as `tests`).
pub(super) fn independent(model: &PhasedModel, estimate: &Estimate, reductions: &Reductions) -> (usize, String) {
    let plural = |count: usize| if count == 1 { "" } else { "s" };
    match (estimate.grouping(), model.levels.first()) {
        (Some(grouping), Some(_)) if grouping.is_crossed() => {
            let depth = grouping.depth();
            let fewest = (0..depth).min_by_key(|&level| grouping.groups(level).len()).unwrap_or(0);
            let count = grouping.groups(fewest).len();
            let (what, name) = match &model.levels[depth - 1 - fewest] {
                factor if factor.crossed => ("level", format!("of factor `{}`", factor.name)),
                level => ("group", format!("of level `{}`", level.name)),
            };
            (count, format!("{what}{} {name}", plural(count)))
        }
        (Some(grouping), Some(outermost)) if grouping.depth() > 0 => {
            let count = grouping.groups(grouping.depth() - 1).len();
            (count, format!("group{} of level `{}`", plural(count), outermost.name))
        }
        _ => (reductions.len(), format!("test{}", plural(reductions.len()))),
    }
}

/// Adds notes on how far the large-sample law can be trusted, and on what the hypothesis removes. `several`: noun for
/// the quantities that the hypothesis puts on a boundary; `independent`: number and noun of the tests or groups, where
/// the accuracy of the law depends on the number.
pub(super) fn add_doubts(
    notes: &mut Vec<String>,
    ratio: &LikelihoodRatio,
    (null, alternative): (&SideRecord, &SideRecord),
    several: &str,
    independent: Option<(usize, String)>,
) {
    if ratio.law.is_bound {
        notes.push(format!(
            "the hypothesis puts several {several} on their boundary. The distribution used is an upper bound, so the p-value may be too large but not too small; `--bootstrap` avoids this"
        ));
    }
    if ratio.null_on_boundary {
        notes.push(
            "under the hypothesis the estimated covariance is singular, and the large-sample distribution does not hold exactly; `--bootstrap` does not use it"
                .to_owned(),
        );
    }
    if let Some((count, name)) = independent.filter(|(count, _)| *count < FEW_TESTS && notes.is_empty()) {
        notes.push(format!(
            "with {count} {name} the large-sample distribution is a rough guide, and its p-values tend to be too small; `--bootstrap 1000` does not use it"
        ));
    }
    let declared = alternative.free_parameters.saturating_sub(null.free_parameters);
    if declared != ratio.degrees_of_freedom {
        notes.push(format!(
            "the hypothesis removes {declared} free {}; the data identify {} of them",
            if declared == 1 { "quantity" } else { "quantities" },
            ratio.degrees_of_freedom
        ));
    }
}
