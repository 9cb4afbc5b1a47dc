//! Groups of tests: which test is of which, and whether they differ.

use std::collections::BTreeMap;

use kalfit::estimate::{self, Combination, Criterion, Estimate, Stop, Structure};
use kalfit::record::{GroupTestRecord, TestGroups};
use kalfit::{Alpha, FitRecord, Labels, PhasedModel, PhasedTest, Reductions};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::FitJob;
use crate::work::JobWork;

/// A correlation matrix with a smaller eigenvalue is singular.
const SINGULAR: f64 = 1e-8;

/// Refuses a test of groups where there can be none.
pub(crate) fn refuse(job: &FitJob, model: &PhasedModel, given: &CommandInputs) -> Result<(), Failure> {
    if !job.group_test {
        return Ok(());
    }
    let refused = |problem, hint| Err(Failure::GroupTest { problem, hint });
    if model.shared().group.is_none() {
        return refused("the model names no column to group by", "add `group = \"COLUMN\"` to `[data]`");
    }
    if !model.levels.is_empty() {
        return refused(
            "the model has levels of groups, whose covariances say how much groups differ",
            "leave `--group-test` out, or leave `levels` out of `[data]`",
        );
    }
    if !given.is_rows() {
        return refused("reductions and estimates do not tell the groups of tests", "give the measurements");
    }
    if job.settings.criterion == Criterion::Reml {
        return refused("restricted likelihoods of different means cannot be compared", "leave `--criterion reml` out");
    }
    if job.settings.phases != Combination::Chain {
        return refused("`--phases marginal` and `stacked` have no likelihood to compare", "leave `--phases` out");
    }
    Ok(())
}

/// The groups of tests that are kept; `None` where the model names no column to group by.
pub(crate) fn of(model: &PhasedModel, tests: &[PhasedTest], labels: &Labels) -> Result<Option<TestGroups>, Failure> {
    let Some(mut groups) = TestGroups::new(model.shared()) else { return Ok(None) };
    groups.take(tests, labels).map_err(Failure::MixedGroup)?;
    Ok(Some(groups))
}

/// Tells the record the groups, and whether they differ where that was asked for.
pub(crate) fn add(
    job: &FitJob,
    record: &mut FitRecord,
    groups: &TestGroups,
    (model, alpha, estimate, reductions): (&PhasedModel, &Alpha, &Estimate, &Reductions),
    work: &mut JobWork<'_>,
) -> Result<(), Failure> {
    record.add_groups(groups);
    if !job.group_test || work.is_stopped() {
        return Ok(());
    }
    work.say(|| "fitting each group by itself".to_owned());
    let parts = parts(groups, reductions)?;
    let structure = Structure::of(model, alpha, None);
    let (mut log_likelihood, mut on_boundary) = (0.0, false);
    for (group, reductions) in &parts {
        let own = estimate::fit(reductions, &structure, &job.settings, work).map_err(Failure::Fit)?;
        if own.stop != Stop::Certified {
            record.notes.push(format!(
                "whether the groups differ is not known: the fit of group `{group}` by itself did not converge"
            ));
            return Ok(());
        }
        log_likelihood += own.log_likelihood;
        on_boundary |= is_singular(&own);
    }
    let free = estimate.declared_mean() + estimate.declared_covariance();
    let degrees_of_freedom = (parts.len() - 1) * free;
    let statistic = (2.0 * (log_likelihood - estimate.log_likelihood)).max(0.0);
    let law = ChiSquared::new(degrees_of_freedom as f64).ok().filter(|_| degrees_of_freedom > 0);
    let Some(chi) = law else { return Ok(()) };
    record.group_test = Some(GroupTestRecord {
        groups: parts.len(),
        log_likelihood,
        statistic,
        degrees_of_freedom,
        p_value: chi.sf(statistic),
        on_boundary,
    });
    let few = parts.iter().filter(|(_, reductions)| reductions.len() <= free).count();
    if few > 0 {
        record.notes.push(format!(
            "{few} of {} groups have no more tests than there are free quantities of the mean and covariance: the p-value for a \
             difference of groups is rough",
            parts.len()
        ));
    }
    Ok(())
}

/// The reductions of each group.
fn parts(groups: &TestGroups, reductions: &Reductions) -> Result<BTreeMap<String, Reductions>, Failure> {
    let of: BTreeMap<&str, Option<&str>> =
        groups.each().iter().map(|(id, group)| (id.as_str(), group.as_deref())).collect();
    let mut parts: BTreeMap<String, Reductions> = BTreeMap::new();
    for reduction in reductions {
        let Some(group) = of.get(reduction.test).copied().flatten() else {
            let problem = "some tests are of no group: their cells in the column of groups are empty";
            return Err(Failure::GroupTest { problem, hint: "fill the column in every test" });
        };
        parts.entry(group.to_owned()).or_default().push(reduction.into());
    }
    if parts.len() < 2 {
        let problem = "all tests are of one group";
        return Err(Failure::GroupTest { problem, hint: "leave `--group-test` out, or group by another column" });
    }
    Ok(parts)
}

/// Some combination of the states that vary does not vary in this fit.
fn is_singular(estimate: &Estimate) -> bool {
    let covariance = &estimate.covariance;
    let varying: Vec<usize> = (0..covariance.nrows()).filter(|&i| covariance[(i, i)] > 0.0).collect();
    let mut correlation = covariance.select_rows(&varying).select_columns(&varying);
    for (a, &i) in varying.iter().enumerate() {
        for (b, &k) in varying.iter().enumerate() {
            correlation[(a, b)] /= (covariance[(i, i)] * covariance[(k, k)]).sqrt();
        }
    }
    varying.is_empty() || correlation.symmetric_eigenvalues().min() < SINGULAR
}
