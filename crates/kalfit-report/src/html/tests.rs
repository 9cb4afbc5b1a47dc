//! The tests one by one: posteriors, distances, and a table of them all or of the most outlying.

use kalfit::FitRecord;
use kalfit::record::TestRecord;
use maud::{Markup, PreEscaped, html};
use serde_json::{Value, json};

use crate::figures;
use crate::html::chart::{PageChart, PageCharts, figure};
use crate::html::grouping::{ColoredGroups, place};
use crate::html::outlying::{LEVEL, MOST_TESTS, outlying, stands_out};
use crate::html::posteriors;
use crate::html::section::PageSection;
use crate::number::{FigurePrecision, probability};
use crate::page::PageLayout;
use crate::summary::{outliers, places};
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count};

/// States whose posteriors are in the table.
const MOST_STATES: usize = 8;
/// Points of the chart of p-values.
const MOST_POINTS: usize = 600;

pub(super) fn section(record: &FitRecord, charts: &mut PageCharts) -> Option<PageSection> {
    if record.tests.is_empty() {
        return None;
    }
    let page = PageLayout::html();
    let several = record.phases.len() > 1;
    let mut drawn: Vec<Markup> = Vec::new();
    for phase in &record.phases {
        let name = if several { format!("Phase {}: ", clean(&phase.name)) } else { String::new() };
        drawn.extend(posteriors::posteriors(record, phase, &name, charts));
    }
    let body = html! {
        @for one in &drawn { (one) }
        (PreEscaped(outliers::section(record, &page)))
        (p_values(record, charts).unwrap_or_default())
        (table(record, &page))
    };
    PageSection::new("tests", "Tests", body)
}

/// p-values against what they should be: evenly spread.
fn p_values(record: &FitRecord, charts: &mut PageCharts) -> Option<Markup> {
    let p_value = |number: usize| record.tests.get(number).p_value.filter(|p| p.is_finite());
    let tested: Vec<(usize, f64)> =
        outlying(record).into_iter().filter_map(|number| Some((number, p_value(number)?))).collect();
    let (n, groups) = (tested.len(), ColoredGroups::of(record));
    if n < 3 {
        return None;
    }
    let thin = n.saturating_sub(MOST_TESTS).div_ceil(MOST_POINTS - MOST_TESTS).max(1);
    let points = tested.iter().enumerate().filter(|(i, _)| *i < MOST_TESTS || (i - MOST_TESTS).is_multiple_of(thin));
    let points: Vec<Value> = points
        .map(|(i, &(number, p))| {
            let test = record.tests.get(number);
            let expected = -((i as f64 + 0.5) / n as f64).log10();
            json!({ "id": clean(test.id), "x": figure(expected), "y": figure(-p.max(1e-300).log10()), "p": probability(p),
                    "out": stands_out(test, n), "group": place(groups.as_ref(), test) })
        })
        .collect();
    let mut data = json!({ "points": points, "limit": figure(-(LEVEL / n as f64).log10()) });
    ColoredGroups::tell(groups.as_ref(), &mut data);
    let out = tested.iter().filter(|(number, _)| stands_out(record.tests.get(*number), n)).count();
    let alternative =
        format!("{} above the line, of {n}; the smallest p-value is {}.", count(out, "test"), probability(tested[0].1));
    let together = places::innermost(record)
        .map_or_else(String::new, |unit| format!(" Tests of one {unit} are near to or far from it together."));
    let caption = format!(
        "How far each test is from the population, as minus the logarithm of its p-value, against the value expected by chance. Points \
         near the diagonal: the population describes the tests. Points above the dashed line are outliers at the 5 % level, after \
         Bonferroni correction.{together}{}",
        ColoredGroups::caption(groups.as_ref())
    );
    Some(charts.figure(PageChart {
        kind: "quantiles",
        title: "Distances from the population",
        caption: &caption,
        alternative: &alternative,
        data,
    }))
}

fn table(record: &FitRecord, page: &PageLayout<'_>) -> Markup {
    let all = record.tests.len();
    let mut tests: Vec<TestRecord<'_>> =
        outlying(record).into_iter().take(MOST_TESTS).map(|number| record.tests.get(number)).collect();
    if all <= MOST_TESTS {
        tests.sort_by_key(|test| test.id);
    }
    let mut of_test = TestRecord::FIGURES;
    of_test.sort_by_key(|figure| figure.name != "observations"); // what there is of a test comes first
    let outlier = |test: &TestRecord<'_>| if stands_out(*test, all) { "outlier" } else { "" }.to_owned();
    let mut columns = vec![TextColumn::new("test", ColumnSide::Left, tests.iter().map(|t| t.id.to_owned()).collect())];
    columns.extend(figures::columns(&of_test, &tests));
    columns.push(TextColumn::new("", ColumnSide::Left, tests.iter().map(outlier).collect()));
    columns.extend(states(record, &tests));
    let rows = page.table(&columns);
    let said = if all > tests.len() {
        format!("The {} most outlying of {all} tests; all are in fit.json.", tests.len())
    } else {
        format!("{}. States: estimate given the population ± standard deviation.", count(all, "test"))
    };
    html! { h3 { "Test by test" } (PreEscaped(rows)) p.hint { (said) } }
}

/// What each test says of each state, given the population.
fn states(record: &FitRecord, tests: &[TestRecord<'_>]) -> Vec<TextColumn> {
    let several = record.phases.len() > 1;
    let places = record.phases.iter().flat_map(|phase| (0..phase.states.len()).map(move |i| (phase, i)));
    let column = |(phase, i): (&kalfit::record::PhaseRecord, usize)| {
        let cell = |test: &TestRecord<'_>| {
            let part = test.phases.iter().find(|part| part.name == phase.name)?;
            let (mean, variance) = (*part.mean.get(i)?, *part.covariance.rows().nth(i)?.get(i)?);
            let sd = Some(variance.max(0.0).sqrt()).filter(|s| *s > 0.0 && s.is_finite());
            let precision = FigurePrecision::of(mean, sd);
            let sd = sd.map_or_else(String::new, |sd| format!(" ± {}", precision.show_error(sd)));
            Some(format!("{}{sd}", precision.show(mean)))
        };
        let name = if several { format!("{}: {}", phase.name, phase.states[i]) } else { phase.states[i].clone() };
        TextColumn::new(&name, ColumnSide::Right, tests.iter().map(|test| cell(test).unwrap_or_default()).collect())
    };
    places.take(MOST_STATES).map(column).collect()
}
