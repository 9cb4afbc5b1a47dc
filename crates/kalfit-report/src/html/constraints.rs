//! What the constraints of the model cost.

use kalfit::FitRecord;
use kalfit::record::ConstraintRecord;
use maud::{Markup, PreEscaped, html};
use serde_json::json;

use crate::html::chart::{PageChart, PageCharts, figures};
use crate::html::section::PageSection;
use crate::number::plain;
use crate::page::PageLayout;
use crate::summary::constraints;
use crate::words::{clean, count};

/// Constraints that are drawn, the most doubtful ones.
const MOST_BARS: usize = 60;
/// 95 % point of χ² with one degree of freedom.
const LIMIT: f64 = 3.841_458_820_694_124;

pub(super) fn section(record: &FitRecord, charts: &mut PageCharts) -> Option<PageSection> {
    let body = html! {
        (PreEscaped(constraints::section(record, &PageLayout::html())))
        (chart(record, charts).unwrap_or_default())
    };
    PageSection::new("constraints", "Constraints", body)
}

fn chart(record: &FitRecord, charts: &mut PageCharts) -> Option<Markup> {
    let mut tested: Vec<(&ConstraintRecord, f64)> =
        record.constraints.iter().filter_map(|c| Some((c, c.score_statistic.filter(|s| s.is_finite())?))).collect();
    tested.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.element.cmp(&b.0.element)));
    let (first, largest) = *tested.first()?;
    let all = tested.len();
    tested.truncate(MOST_BARS);
    let name = |c: &ConstraintRecord| clean(&constraints::name(record, c));
    let data = json!({
        "names": tested.iter().map(|(c, _)| name(c)).collect::<Vec<_>>(),
        "values": figures(tested.iter().map(|(_, s)| *s)),
        "axis": "constraint", "unit": "score statistic", "limit": LIMIT, "limitName": "5 % level of one",
    });
    let alternative = format!(
        "{}; the largest score statistic is {}, of {}.",
        count(all, "constraint"),
        plain(largest, 3),
        name(first)
    );
    let caption = "What each constraint costs: about twice the log-likelihood that freeing it alone would gain, by the slope at \
                   the constraint. Of twenty true constraints, one has a bar beyond the dashed line by chance.";
    Some(charts.figure(PageChart {
        kind: "bars",
        title: "Score tests of the constraints",
        caption,
        alternative: &alternative,
        data,
    }))
}
