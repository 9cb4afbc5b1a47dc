//! The best plan among candidates, in words and tables.

use kalfit::infer::student_quantile;
use kalfit::record::{BestPlanRecord, CandidateRecord, PlanRecord, PlannedRecord};

use crate::number::{FigurePrecision, plain};
use crate::page::PageLayout;
use crate::plan::two_digits;
use crate::summary::headline;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count, list};

/// No more names than this in a sentence.
const MOST_NAMES: usize = 6;
/// Candidates that are not in the plan, of which so many are shown.
const MOST_LEFT_OUT: usize = 12;
/// Gap of the certificate at which a plan is as good as the best.
const CERTIFIED: f64 = 1e-5;
/// Correlations and covariances with a standard error of at least this share of their range are worth a word.
const BADLY_KNOWN: f64 = 0.5;

pub(crate) fn summary(record: &PlanRecord, best: &BestPlanRecord, page: &PageLayout<'_>) -> String {
    let mut sections = Vec::new();
    if !record.title.trim().is_empty() {
        sections.push(page.heading(&clean(&record.title)) + "\n");
    }
    let facts = headline::data(&record.design);
    let about = format!("Candidates: {}", facts.trim_start_matches("Data: "));
    let so_far = best.information_so_far.as_deref();
    let known = so_far.map_or_else(String::new, |name| page.paragraph(&format!("Known already: {}.", clean(name))));
    let from = page.paragraph(&format!("Population: {}.", clean(&record.from)));
    sections.push(page.paragraph(&about) + &from + &known);
    sections
        .push(page.section("The best plan", &(candidates(record, best, page) + &page.items(&verdict(record, best)))));
    let figures: Vec<&PlannedRecord> = record.quantities.iter().filter(|one| one.quantity != "covariance").collect();
    sections.push(page.section("Expected standard errors", &table(record, &figures, page)));
    sections.push(page.section("How to read this", &page.items(&notes(record, best))));
    sections.push(
        best.simulate.as_deref().map_or_else(String::new, |command| page.section("To simulate it", &lines(command))),
    );
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

/// A command with an option on each line, as a shell takes it.
fn lines(command: &str) -> String {
    clean(command).split(" --").enumerate().fold(String::new(), |text, (k, part)| match k {
        0 => format!("  {part}"),
        _ => format!("{text} \\\n    --{part}"),
    }) + "\n"
}

/// A row for each candidate of the plan, then the best of those left out.
fn candidates(record: &PlanRecord, best: &BestPlanRecord, page: &PageLayout<'_>) -> String {
    let made = if has_levels(record) { "units" } else { "tests" };
    let is_chosen = |one: &&CandidateRecord| one.tests > 0 || one.relaxed > 0.005;
    let mut left_out: Vec<&CandidateRecord> = best.candidates.iter().filter(|one| !is_chosen(one)).collect();
    left_out.sort_by(|a, b| b.sensitivity.total_cmp(&a.sensitivity));
    left_out.truncate(page.rows(MOST_LEFT_OUT));
    let is_shown = |one: &&CandidateRecord| is_chosen(one) || left_out.contains(one);
    let rows: Vec<&CandidateRecord> = best.candidates.iter().filter(is_shown).collect();
    let column = |name: &str, side, of: &dyn Fn(&CandidateRecord) -> String| {
        TextColumn::new(name, side, rows.iter().map(|one| of(one)).collect())
    };
    let mut columns = vec![
        column("candidate", ColumnSide::Left, &|one| one.name.clone()),
        column("cost", ColumnSide::Right, &|one| plain(one.cost, 4)),
    ];
    if rows.iter().any(|one| one.most.is_some()) {
        columns.push(column("at most", ColumnSide::Right, &|one| one.most.map_or("-".to_owned(), |n| plain(n, 6))));
    }
    columns.push(column("relaxed", ColumnSide::Right, &|one| format!("{:.2}", one.relaxed)));
    columns.push(column(made, ColumnSide::Right, &|one| one.tests.to_string()));
    columns.push(column("sensitivity", ColumnSide::Right, &|one| format!("{:.3}", one.sensitivity)));
    page.table(&columns)
}

/// What the plan costs, what it makes known, and how good it is.
fn verdict(record: &PlanRecord, best: &BestPlanRecord) -> Vec<String> {
    let tests: usize = best.candidates.iter().map(|one| one.tests).sum();
    let hidden = best.candidates.iter().filter(|one| one.tests == 0 && one.relaxed <= 0.005).count();
    let mut said = vec![format!(
        "The plan has {} and costs {} of {}.",
        count(tests, if has_levels(record) { "unit" } else { "test" }),
        plain(best.cost, 6),
        plain(best.budget, 6)
    )];
    if let Some(one) = single(record, best) {
        let now = one.std_error_before.map_or("not known now".to_owned(), |error| format!("now {}", plain(error, 3)));
        let after = one.std_error[0].map_or("not known".to_owned(), |error| plain(error * few_tests(one), 3));
        let least = match one.std_error[0].filter(|_| best.draws.is_none()) {
            Some(error) => {
                format!(
                    " No plan within the budget has less than {}.",
                    plain(error * few_tests(one) * best.efficiency_bound.sqrt(), 3)
                )
            }
            None => String::new(),
        };
        said.push(format!("Standard error of {}: {after} ({now}).{least}", clean(best.criterion.trim())));
    }
    let efficiency = (best.efficiency_bound * 1e4).floor() / 100.0;
    let proof = match best.optimal_in_whole_numbers {
        true => format!(
            "no plan in whole numbers within the budget is better (branch and bound, {})",
            count_branches(best.nodes)
        ),
        false => format!("branch and bound was stopped after {}", count_branches(best.nodes)),
    };
    let against = if best.draws.is_some() { ", on average over the draws" } else { "" };
    said.push(format!(
        "Even with divided tests, no plan within the budget could have less than {} % of its variances{against}; {proof}. Certificate: gap \
         {}.",
        plain(efficiency, 4),
        plain(best.gap.max(0.0), 1)
    ));
    if best.gap > CERTIFIED {
        said.push("The certificate does not hold: the plan may be far from the best.".to_owned());
    }
    if hidden > MOST_LEFT_OUT {
        said.push(format!(
            "{} are left out; those with the largest sensitivities are shown.",
            count(hidden, "candidate")
        ));
    }
    said
}

fn has_levels(record: &PlanRecord) -> bool {
    record.quantities.iter().any(|one| one.level.is_some())
}

fn count_branches(nodes: usize) -> String {
    if nodes == 1 { "1 branch".to_owned() } else { format!("{nodes} branches") }
}

/// The one figure that was asked for.
fn single<'a>(record: &'a PlanRecord, best: &BestPlanRecord) -> Option<&'a PlannedRecord> {
    let plain = |text: &str| text.split_whitespace().collect::<String>();
    let several = several_phases(record);
    record.quantities.iter().find(|one| plain(&one.name(several)) == plain(&best.criterion))
}

fn several_phases(record: &PlanRecord) -> bool {
    record.quantities.iter().any(|one| one.phase != record.quantities[0].phase)
}

fn table(record: &PlanRecord, rows: &[&PlannedRecord], page: &PageLayout<'_>) -> String {
    let several = several_phases(record);
    let error = |error: Option<f64>| error.map_or("-".to_owned(), two_digits);
    let value = |one: &PlannedRecord| {
        let shown = |value: f64| match one.std_error[0] {
            Some(error) => FigurePrecision::of(value, Some(error)).show(value),
            None => plain(value, 3),
        };
        one.value.map_or("-".to_owned(), shown)
    };
    let after = |one: &PlannedRecord| one.std_error[0].map(|error| error * few_tests(one));
    let column = |name: &str, side, of: &dyn Fn(&PlannedRecord) -> String| {
        TextColumn::new(name, side, rows.iter().map(|one| of(one)).collect())
    };
    let mut columns = vec![column("figure", ColumnSide::Left, &|one| one.name(several))];
    if rows.iter().any(|one| one.unit.is_some()) {
        columns.push(column("unit", ColumnSide::Left, &|one| one.unit.clone().unwrap_or_default()));
    }
    columns.push(column("value", ColumnSide::Right, &value));
    if rows.iter().any(|one| one.std_error_before.is_some()) {
        columns.push(column("now", ColumnSide::Right, &|one| error(one.std_error_before)));
    }
    columns.push(column("planned", ColumnSide::Right, &|one| error(after(one))));
    if rows.iter().any(|one| one.df.is_some()) {
        columns.push(column("df", ColumnSide::Right, &|one| match one.df {
            Some(df) if df < 1.0 => "< 1".to_owned(),
            df => df.map_or(String::new(), |df| plain(df, 3)),
        }));
    }
    page.table(&columns)
}

/// How much wider the interval of a mean is by Student's t than by the normal law.
fn few_tests(one: &PlannedRecord) -> f64 {
    let quantile = |df: f64| student_quantile(df, 0.975);
    let ratio = |df: f64| Some(quantile(df)? / quantile(f64::INFINITY)?);
    one.df.filter(|df| *df >= 1.0).and_then(ratio).unwrap_or(1.0)
}

fn notes(record: &PlanRecord, best: &BestPlanRecord) -> Vec<String> {
    let mut notes = vec![
        "Relaxed: the best plan if tests could be divided. Sensitivity: what the next unit of cost brings if it goes to a \
         candidate, times the budget; of candidates whose number is not limited, those of the relaxed plan have the largest."
            .to_owned(),
        "Standard errors come from the expected information at the values given.".to_owned(),
    ];
    if record.quantities.iter().any(|one| one.df.is_some()) {
        notes.push(
            "Those of means are multiplied by t/1.96, with the quantile of Student's t for the degrees of freedom (df), as \
             intervals with few tests will be."
                .to_owned(),
        );
    }
    let several = several_phases(record);
    let names = |which: &dyn Fn(&&PlannedRecord) -> bool| -> Vec<String> {
        let all = record.quantities.iter().filter(|one| one.quantity != "covariance").filter(which);
        let by =
            |one: &PlannedRecord| one.informed_by.as_deref().map_or(String::new(), |own| format!(" ({})", clean(own)));
        all.map(|one| clean(&one.name(several)) + &by(one)).collect()
    };
    let open = names(&|one| one.std_error[0].is_none());
    if !open.is_empty() {
        notes.push(format!("The plan does not determine {}.", list(&open, MOST_NAMES)));
    }
    let badly = names(&|one| one.quantity == "correlation" && one.std_error[0].is_some_and(|e| e > BADLY_KNOWN));
    if !badly.is_empty() {
        notes.push(format!("Badly known after the plan: {}.", list(&badly, MOST_NAMES)));
    }
    if !(open.is_empty() && badly.is_empty()) {
        notes.push("In brackets: the candidate that informs it most for its cost.".to_owned());
    }
    if !record.parameters_taken_as_known.is_empty() {
        let known: Vec<String> = record.parameters_taken_as_known.iter().map(|name| clean(name)).collect();
        notes.push(format!("Taken as known at the values given: {}.", list(&known, MOST_NAMES)));
    }
    if let Some(draws) = best.draws {
        notes.push(format!(
            "The plan is the best on average over the given values and {} draws of them by the errors of the fit (seed {}); \
             standard errors are those at the given values.",
            draws.count, draws.seed
        ));
    }
    notes
        .push("With few tests, estimates scatter more than this: simulate the plan and fit what was drawn.".to_owned());
    notes
}
