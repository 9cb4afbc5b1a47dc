//! Is the model right for each test, as the filter sees it: size and whiteness over all tests, and one test in detail.

use kalfit::FitRecord;
use kalfit::record::{
    AutocorrelationRecord, InnovationRecord, SeriesRecord, TestRecord, WhitenessRecord, WindowRecord,
};
use maud::{Markup, PreEscaped, html};
use serde_json::{Value, json};
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

use crate::html::chart::{PageChart, PageCharts, figure, figures};
use crate::html::grouping::{ColoredGroups, place};
use crate::html::outlying::MOST_TESTS;
use crate::html::section::PageSection;
use crate::number::{plain, probability};
use crate::page::PageLayout;
use crate::summary::innovations;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count};

/// Both tails together.
const LEVEL: f64 = 0.05;
/// 1.96: the normal law's.
const NORMAL: f64 = 1.959_963_984_540_054;

type TestInnovations<'a> = (TestRecord<'a>, &'a InnovationRecord);

pub(super) fn section(record: &FitRecord, charts: &mut PageCharts) -> Option<PageSection> {
    if record.tests.is_empty() {
        return None;
    }
    let page = PageLayout::html();
    let mut found: Vec<(f64, &str, usize)> = (record.tests.iter().enumerate())
        .filter_map(|(number, test)| Some((least(test.innovations?), test.id, number)))
        .collect();
    let all = found.len();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(b.1)));
    found.truncate(MOST_TESTS);
    found.sort_by_key(|(_, id, _)| *id);
    let tests = found.into_iter().map(|(_, _, number)| record.tests.get(number));
    let found: Vec<TestInnovations<'_>> = tests.filter_map(|test| Some((test, test.innovations?))).collect();
    let said =
        if all > found.len() { format!(" The {} least probable of {all} tests.", found.len()) } else { String::new() };
    let body = if found.is_empty() {
        html! { p { "These results contain no innovations. They were not asked for, or the tests came as reductions or estimates, which do \
        not contain the single measurements." } }
    } else {
        html! {
            (PreEscaped(innovations::section(record, &page)))
            (sizes((record, &found), &said, charts).unwrap_or_default())
            (one_test(record, &found, charts).unwrap_or_default())
            (table(&found, &said, &page))
        }
    };
    PageSection::new("innovations", "Innovations", body)
}

/// The smaller of the p-values of a test.
fn least(found: &InnovationRecord) -> f64 {
    let white = found.whiteness.as_ref().map(|w| w.p_value);
    [found.nis_p_value, white].into_iter().flatten().filter(|p| p.is_finite()).fold(2.0, f64::min)
}

/// χ² bounds of a mean square of n, which is normal to six digits where n has seven; none for n = 0.
fn bounds(n: usize) -> Option<[f64; 2]> {
    const NORMAL_FROM: usize = 10_000_000;
    let chi = ChiSquared::new(n as f64).ok().filter(|_| n > 0)?;
    let bounds = [0.5 * LEVEL, 1.0 - 0.5 * LEVEL].map(|p| match n {
        NORMAL_FROM.. => 1.0 + (2.0 / n as f64).sqrt() * Normal::standard().inverse_cdf(p),
        _ => chi.inverse_cdf(p) / n as f64,
    });
    bounds.iter().all(|x| x.is_finite()).then_some(bounds)
}

/// The mean square of n with its bounds.
fn ratio(nis: f64, n: usize) -> Value {
    let bounds = bounds(n).unwrap_or([f64::NAN; 2]);
    json!({ "n": n, "ratio": figure(nis / n.max(1) as f64), "low": figure(bounds[0]), "high": figure(bounds[1]) })
}

fn sizes((record, found): (&FitRecord, &[TestInnovations<'_>]), said: &str, charts: &mut PageCharts) -> Option<Markup> {
    let groups = ColoredGroups::of(record);
    let sized: Vec<(&TestInnovations<'_>, f64)> =
        found.iter().filter_map(|f| Some((f, f.1.nis.filter(|x| x.is_finite())?))).collect();
    if sized.len() < 2 {
        return None;
    }
    let test = |((test, innovations), nis): &(&TestInnovations<'_>, f64)| {
        let mut value = ratio(*nis, innovations.count);
        value["id"] = json!(clean(test.id));
        value["group"] = place(groups.as_ref(), *test);
        value["p"] = json!(innovations.nis_p_value.map_or_else(|| "-".to_owned(), probability));
        value
    };
    let tests: Vec<Value> = sized.iter().map(test).collect();
    let outside = |((_, i), nis): &&(&TestInnovations<'_>, f64)| {
        bounds(i.count).is_some_and(|[low, high]| !(low..=high).contains(&(nis / i.count as f64)))
    };
    let alternative =
        format!("{} of {} outside their bounds.", sized.iter().filter(outside).count(), count(tests.len(), "test"));
    let caption = format!(
        "The mean square of each test's standardised innovations (NIS over its degrees of freedom), which should be 1; the bars are \
         95 % bounds of χ². If all points are above, the model has too little noise or lacks a process. If all are below, it has too \
         much noise. If one point is outside, look at that test.{said}{}",
        ColoredGroups::caption(groups.as_ref())
    );
    let mut data = json!({ "tests": tests });
    ColoredGroups::tell(groups.as_ref(), &mut data);
    let title = "Size of the innovations, test by test";
    Some(charts.figure(PageChart { kind: "sizes", title, caption: &caption, alternative: &alternative, data }))
}

fn one_test(record: &FitRecord, found: &[TestInnovations<'_>], charts: &mut PageCharts) -> Option<Markup> {
    let mut kept: Vec<(&TestInnovations<'_>, &SeriesRecord)> =
        found.iter().filter_map(|f| Some((f, f.1.series.as_deref()?))).filter(|(_, series)| sound(series)).collect();
    kept.sort_by(|a, b| least(a.0.1).total_cmp(&least(b.0.1)).then_with(|| a.0.0.id.cmp(b.0.0.id)));
    let first = kept.first()?.0.0.id;
    let tests: Vec<Value> = kept.iter().map(|((test, figures), series)| series_data(*test, figures, series)).collect();
    let left = record.tests.len() - tests.len();
    let among =
        if left > 0 { format!(" {} less striking cannot be chosen.", count(left, "test")) } else { String::new() };
    let caption = format!(
        "Choose a test; the least probable comes first. Top: each innovation divided by its standard deviation; 95 % should lie within \
         the dashed lines, without a pattern. Middle: their mean square in windows, with 95 % bounds of χ². Bottom: \
         autocorrelation, which should stay within the dashed lines; a slow decay from lag 1 suggests a missing drift.{among}"
    );
    let alternative = format!("For {}; test {} is shown first.", count(tests.len(), "test"), clean(first));
    let data = json!({ "tests": tests });
    let title = "Innovations of one test";
    Some(charts.figure(PageChart { kind: "innovations", title, caption: &caption, alternative: &alternative, data }))
}

/// Lists that go together do.
fn sound(series: &SeriesRecord) -> bool {
    let n = series.at.len();
    !series.windows.is_empty()
        && n == series.measurement.len()
        && n == series.standardised.len()
        && series.measurement.iter().all(|&m| m < series.measurements.len())
}

fn series_data(test: TestRecord<'_>, figures_: &InnovationRecord, series: &SeriesRecord) -> Value {
    let window = |w: &WindowRecord| {
        let mut value = ratio(w.nis, w.count);
        (value["from"], value["to"]) = (figure(w.from), figure(w.to));
        value
    };
    let autocorrelation = |a: &AutocorrelationRecord| {
        json!({
            "name": a.measurement.as_ref().map_or_else(|| "all measurements".to_owned(), |m| clean(m)),
            "bound": figure(NORMAL / (a.count.max(1) as f64).sqrt()), "lags": figures(a.lags.iter().copied()),
        })
    };
    let p = |p: Option<f64>| p.map_or_else(|| "-".to_owned(), probability);
    let said = format!(
        "{}; mean square {}, p-value {}; whiteness p-value {}.",
        count(figures_.count, "innovation"),
        figures_.nis.map_or_else(|| "-".to_owned(), |nis| plain(nis / figures_.count.max(1) as f64, 3)),
        p(figures_.nis_p_value),
        p(figures_.whiteness.as_ref().map(|w| w.p_value))
    );
    json!({
        "id": clean(test.id), "said": said, "timed": series.timed,
        "timeUnit": series.time_unit.as_deref().map_or_else(String::new, clean),
        "measurements": series.measurements.iter().map(|m| clean(m)).collect::<Vec<_>>(),
        "at": figures(series.at.iter().copied()), "measurement": series.measurement,
        "z": figures(series.standardised.iter().copied()),
        "windows": series.windows.iter().map(window).collect::<Vec<Value>>(),
        "autocorrelation": series.autocorrelation.iter().map(autocorrelation).collect::<Vec<Value>>(),
    })
}

fn table(found: &[TestInnovations<'_>], said: &str, page: &PageLayout<'_>) -> Markup {
    let column = |of: &dyn Fn(&InnovationRecord) -> Option<String>| -> Vec<String> {
        found.iter().map(|(_, innovations)| of(innovations).unwrap_or_else(|| "-".to_owned())).collect()
    };
    let per = |i: &InnovationRecord| i.nis.map(|nis| plain(nis / i.count.max(1) as f64, 3));
    let within =
        |i: &InnovationRecord| bounds(i.count).map(|[low, high]| format!("{} to {}", plain(low, 3), plain(high, 3)));
    let size = [
        TextColumn::new("mean square", ColumnSide::Right, column(&per)),
        TextColumn::new("95 % bounds", ColumnSide::Left, column(&within)),
    ];
    let mut columns =
        vec![TextColumn::new("test", ColumnSide::Left, found.iter().map(|(test, _)| test.id.to_owned()).collect())];
    columns.extend(crate::figures::columns(&InnovationRecord::FIGURES, found.iter().map(|&(_, own)| own)));
    columns.splice(2..2, size); // beside the number of innovations
    let whiteness = found.iter().map(|(_, own)| own.whiteness.as_ref());
    columns.extend(crate::figures::columns(&WhitenessRecord::FIGURES, whiteness));
    let sentences =
        [crate::figures::sentences(&InnovationRecord::FIGURES), crate::figures::sentences(&WhitenessRecord::FIGURES)];
    let hint = sentences.join(" ") + said;
    html! { h3 { "Innovations test by test" } (PreEscaped(page.table(&columns))) p.hint { (hint) } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_those_of_chi_squared() {
        // R: qchisq(c(0.025, 0.975), 10) / 10
        let [low, high] = bounds(10).unwrap();
        assert!((low - 0.3246973).abs() < 1e-6 && (high - 2.0483177).abs() < 1e-6, "{low} {high}");
        assert_eq!(bounds(0), None);
        let [low, high] = bounds(1_000_000).unwrap();
        assert!(low > 0.99 && high < 1.01, "{low} {high}");
        let [below, above] = [9_999_999, 10_000_000].map(|n| bounds(n).unwrap()[1]);
        assert!((below - above).abs() < 1e-6, "{below} {above}");
        assert!(bounds(usize::MAX).is_some());
    }
}
