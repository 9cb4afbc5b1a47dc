//! What the number of tests means for intervals of means, in words.

use kalfit::FitRecord;
use kalfit::infer::FEW_UNITS;
use kalfit::record::{LevelRecord, PhaseRecord};

use super::levels;

/// How often 95 % intervals of means by maximum likelihood hold, in percent, by number of tests: simulated ensembles of
/// one to four states.
const COVERAGE: [(f64, f64); 6] = [(5.0, 85.0), (8.0, 88.0), (12.0, 91.0), (20.0, 93.0), (40.0, 94.0), (50.0, 94.0)];

/// Degrees of freedom in a table: `17.0`; nothing where there are none.
pub(crate) fn freedom(df: Option<f64>) -> String {
    df.map_or_else(String::new, |df| if df < 1e4 { format!("{df:.1}") } else { "> 10000".to_owned() })
}

/// Degrees of freedom as they stand beside a standard error: ` (df 17.0)`.
pub(crate) fn beside(df: Option<f64>) -> String {
    df.map_or_else(String::new, |df| format!(" (df {})", freedom(Some(df))))
}

/// What is said below the table of means.
pub(crate) fn items(record: &FitRecord, phase: &PhaseRecord) -> Vec<String> {
    if record.phases.first().is_some_and(|first| first.name != phase.name) {
        return Vec::new(); // it was said of the first phase
    }
    let method = match record.df_method.as_deref() {
        Some("kenward-roger") => "standard errors and degrees of freedom by Kenward and Roger.",
        Some("satterthwaite") => "degrees of freedom by Satterthwaite.",
        _ => return unrestricted(record, phase).into_iter().collect(),
    };
    let mut items = vec![format!("Intervals of means: Student's t, {method}")];
    let levels = record.all_levels().map(|level| &level.boundary);
    let singular = levels.chain([&phase.boundary]).flatten().find(|own| own.rank < own.of);
    items.extend(singular.map(|own| {
        let (rank, of) = (own.rank, own.of);
        format!(
            "The covariance has rank {rank} of {of}: degrees of freedom allow for the part that is estimated as zero."
        )
    }));
    items
}

/// How often intervals of means hold with few tests under maximum likelihood.
fn unrestricted(record: &FitRecord, phase: &PhaseRecord) -> Option<String> {
    let is_free = |(error, fixed): (&Option<f64>, &bool)| error.is_some() && !fixed;
    let free = phase.mean.std_error.iter().zip(&phase.mean.fixed).any(is_free);
    let varies = |level: &&LevelRecord| (0..level.states.len()).any(|i| !levels::is_held_at_zero(level, i));
    let fewest = record.crossed.iter().map(|factor| &factor.level).filter(varies).min_by_key(|factor| factor.groups);
    let (count, what) = match record.levels.first().filter(|_| record.levels.len() > 1) {
        _ if let Some(factor) = fewest => (factor.groups, format!("levels of {}", factor.name)),
        Some(outermost) => (outermost.groups, format!("groups of {}", outermost.name)),
        None => (record.data.tests, "tests".to_owned()),
    };
    if record.criterion != "ml" || !free || !(2..FEW_UNITS).contains(&count) {
        return None;
    }
    let often = match coverage(count as f64) {
        Some(percent) => format!("about {percent:.0} %"),
        None => "less than 85 %".to_owned(),
    };
    Some(format!(
        "With {count} {what}, ± 1.96 standard errors hold the mean {often} of the time; --criterion reml allows for that."
    ))
}

/// Percent of the time, between the figures that were simulated; `None` below them.
fn coverage(count: f64) -> Option<f64> {
    let pair = COVERAGE.windows(2).find(|pair| (pair[0].0..=pair[1].0).contains(&count))?;
    let part = (count - pair[0].0) / (pair[1].0 - pair[0].0);
    Some(pair[0].1 + part * (pair[1].1 - pair[0].1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_between_those_simulated_are_interpolated() {
        let of = |count: f64| coverage(count).map(f64::round);
        assert_eq!([5.0, 8.0, 10.0, 12.0, 49.0].map(of), [85.0, 88.0, 90.0, 91.0, 94.0].map(Some));
        assert_eq!(of(4.0), None);
        assert_eq!(beside(Some(17.04)), " (df 17.0)");
    }
}
