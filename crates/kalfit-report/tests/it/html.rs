//! The report page: what it holds, whoever wrote the names.

use kalfit::FitRecord;
use kalfit::record::*;
use kalfit_report::html;

use crate::common;

/// The page without its scripts and style: what a person reads, and the data of the charts.
fn body(page: &str) -> &str {
    let start = page.find("<body>").expect("there is a body");
    let end = page.find("<script>").expect("there is a script");
    &page[start..end]
}

/// What stands between the tags.
fn text(page: &str) -> String {
    let mut text = String::new();
    let mut inside = false;
    for letter in body(page).chars() {
        match letter {
            '<' => inside = true,
            '>' => {
                inside = false;
                text.push(' ');
            }
            _ if !inside => text.push(letter),
            _ => {}
        }
    }
    text
}

fn with_tests(n: usize) -> FitRecord {
    let mut record = common::sleepstudy();
    record.data.tests = n;
    record.tests = common::tests(&(0..n).map(|i| (i as f64 + 0.5) / n.max(1) as f64).collect::<Vec<_>>());
    common::change_tests(&mut record, |i, test| {
        test.id = format!("T{i}");
        let mean = vec![250.0 + i as f64, 10.0];
        let covariance = vec![vec![4.0, 0.0], vec![0.0, 1.0]].try_into().expect("it is square");
        test.phases = vec![PosteriorRow { name: "main".into(), mean, covariance, own: None }];
    });
    record
}

#[test]
fn every_figure_of_the_estimates_is_on_the_page() {
    let text = text(&html(&common::sleepstudy()));
    for figure in [
        "251.4",
        "± 6.6",
        "10.5",
        "± 1.5",
        "23.8",
        "± 5.1",
        "5.7",
        "± 1.1",
        "0.08 ± 0.33",
        "25.6",
        "22.8 to 28.7",
        "-875.97",
        "1763.94",
        "1783.10",
        "ms/day",
        "565.52",
        "32.682",
    ] {
        assert!(text.contains(figure), "{figure} is missing in {text}");
    }
}

#[test]
fn the_words_of_the_summary_are_those_of_the_page() {
    for record in [common::sleepstudy(), common::singular(), common::constrained()] {
        // what is code in the page stands between backticks in the text
        let page = text(&html(&record)).replace("&amp;", "&").replace('`', "");
        let page = page.split_whitespace().collect::<Vec<_>>().join(" ");
        let style = kalfit_report::TextStyle { width: 1000, color: false };
        for line in kalfit_report::summary(&record, &style).lines().filter(|line| line.trim().ends_with('.')) {
            let line = line.replace('`', "").split_whitespace().collect::<Vec<_>>().join(" ");
            if !line.starts_with("Log-likelihood ") {
                assert!(page.contains(&line), "{line} is missing in {page}");
            }
        }
        for figure in ["free parameters 6", "log-likelihood -875.97", "AIC 1763.94", "BIC 1783.10"] {
            assert!(page.contains(figure), "{figure} is not among the figures of {page}");
        }
    }
}

#[test]
fn names_that_are_markup_stay_text() {
    const NAMES: &[&str] = &[
        "<script>alert(1)</script>",
        "</script><script>alert(2)</script>",
        "\"><img src=x onerror=alert(3)>",
        "\" onmouseover=\"alert(4)",
        "<!--",
        "]]><svg/onload=alert(5)>",
        "\u{202e}μ̂ 測試 🚀",
    ];
    for name in NAMES {
        let mut record = common::constrained();
        let owned = || (*name).to_owned();
        record.title = owned();
        record.reason = owned();
        record.kalfit_version = owned();
        record.model_digest = Some(owned());
        record.model = vec![owned(), format!("state `{name}`: {name}")];
        record.notes = vec![owned()];
        record.data.files = vec![owned()];
        record.criterion = owned();
        for phase in &mut record.phases {
            phase.states.iter_mut().for_each(|state| *state = owned());
            phase.units = vec![Some(owned()); 3];
            phase.mean.regression[0].column = owned();
        }
        common::change_tests(&mut record, |_, test| test.id = owned());
        record.constraints.iter_mut().for_each(|constraint| constraint.element = owned());
        for parameter in &mut record.parameters {
            (parameter.name, parameter.level, parameter.unit) = (owned(), Some(owned()), Some(owned()));
        }
        let page = html(&record);
        let read = body(&page);
        assert_eq!(read.matches("<script").count(), 1, "{name}: only the data of the charts");
        assert_eq!(page.matches("</script>").count(), 3, "{name} ends a script");
        let markup = read.split("id=\"charts\">").next().unwrap();
        for bad in ["<img", "<svg", "<!--", "\" onmouseover=\"", "<script>alert"] {
            assert!(!markup.contains(bad), "{name} became {bad}");
        }
        let data = read.split("id=\"charts\">").nth(1).unwrap().split("</script>").next().unwrap();
        let charts: serde_json::Value = serde_json::from_str(data).expect("the data of the charts are JSON");
        assert!(charts.as_array().is_some_and(|all| !all.is_empty()));
    }
}

/// Data of the charts of this kind.
fn charts(page: &str, kind: &str) -> Vec<serde_json::Value> {
    let data = body(page).split("id=\"charts\">").nth(1).and_then(|data| data.split("</script>").next());
    let all: Vec<serde_json::Value> =
        serde_json::from_str(data.expect("there are charts")).expect("the data of the charts are JSON");
    all.into_iter().filter(|chart| chart["kind"] == kind).map(|chart| chart["data"].clone()).collect()
}

/// Twelve tests in groups that go round.
fn grouped(groups: &[&str]) -> FitRecord {
    let mut record = with_tests(12);
    record.group_column = Some("lot".to_owned());
    common::change_tests(&mut record, |i, test| test.group = Some(groups[i % groups.len()].to_owned()));
    record
}

#[test]
fn tests_have_the_colour_of_their_group_in_every_chart() {
    let page = html(&grouped(&["A", "B", "C"]));
    for (kind, list) in [("posteriors", "tests"), ("ellipses", "tests"), ("quantiles", "points")] {
        let found = charts(&page, kind);
        assert_eq!(found.len(), 1, "{kind}");
        assert_eq!(found[0]["groups"], serde_json::json!({ "column": "lot", "names": ["A", "B", "C"] }), "{kind}");
        for test in found[0][list].as_array().expect("tests") {
            let number: u64 = test["id"].as_str().unwrap()[1..].parse().unwrap();
            assert_eq!(test["group"], number % 3, "{kind}: {test}");
        }
    }
    assert!(text(&page).contains("Colours and shapes: tests by lot."));
}

#[test]
fn groups_beyond_the_colours_share_one_and_one_group_has_none() {
    let many = charts(&html(&grouped(&["A", "B", "C", "D", "E", "F", "G", "H"])), "posteriors").remove(0);
    // twelve tests: A to D have two, the others one
    assert_eq!(many["groups"]["names"], serde_json::json!(["A", "B", "C", "D", "E", "3 others"]));
    let places: Vec<u64> =
        many["tests"].as_array().unwrap().iter().map(|test| test["group"].as_u64().unwrap()).collect();
    assert_eq!(places.iter().filter(|place| **place == 5).count(), 3, "{places:?}");
    let one = html(&grouped(&["A"]));
    assert!(charts(&one, "posteriors")[0]["groups"].is_null() && !text(&one).contains("Colours and shapes"));
}

#[test]
fn nothing_is_loaded_and_only_the_two_scripts_may_run() {
    let page = html(&common::sleepstudy());
    let policy = page.split("Content-Security-Policy\" content=\"").nth(1).unwrap().split('"').next().unwrap();
    assert!(policy.starts_with("default-src 'none'; script-src 'sha256-"), "{policy}");
    assert!(!policy.contains("http") && !policy.contains('*') && !policy.contains("unsafe-eval"), "{policy}");
    assert_eq!(policy.matches("sha256-").count(), 2, "{policy}");
    let read = body(&page);
    for loads in ["src=", "http:", "https:", "url(", "@import", "<link", "<iframe"] {
        assert!(!read.contains(loads), "the page has {loads}");
    }
    assert!(page.len() < 1_500_000, "{} bytes", page.len());
}

#[test]
fn sections_have_anchors_and_headings_in_order() {
    let page = html(&with_tests(18));
    let read = body(&page);
    for id in
        ["overview", "model", "data", "estimates", "parameters", "identifiability", "tests", "solver", "provenance"]
    {
        assert!(read.contains(&format!("href=\"#{id}\"")), "no link to {id}");
        assert_eq!(read.matches(&format!("<section id=\"{id}\"")).count(), 1, "{id}");
    }
    assert_eq!(read.matches("<h1").count(), 1);
    let charts = read.matches("<figure").count();
    assert!(charts >= 5, "{charts} charts");
    assert_eq!(read.matches("role=\"img\" aria-label=\"").count(), charts, "each chart has a text alternative");
    assert_eq!(read.matches("<figcaption>").count(), charts);
}

#[test]
fn ensembles_of_any_size_give_a_page_of_bounded_size() {
    let sizes = [0, 1, 2, 200, 201, 10_000].map(|n| (n, html(&with_tests(n))));
    for (n, page) in &sizes {
        assert!(page.len() < 1_200_000, "{n} tests give {} bytes", page.len());
        assert!(!text(page).contains("NaN") && !text(page).contains("inf "), "{n} tests");
    }
    assert!(sizes[5].1.contains("The 200 most outlying of 10000 tests"), "what was left out is said");
    assert!(!sizes[3].1.contains("most outlying of"), "nothing was left out");
}

#[test]
fn records_whose_lists_do_not_match_give_a_page() {
    let mut record = common::sleepstudy();
    record.phases[0].mean.estimate.pop();
    record.phases[0].covariance.estimate[1].clear();
    record.phases[0].correlation.estimate.pop();
    record.phases[0].std_dev.estimate.clear();
    record.phases[0].units.clear();
    record.log_likelihood = f64::NAN;
    record.solver.trace = vec![f64::NAN, f64::INFINITY, 1.0];
    record.certificate.mean = f64::NAN;
    let series = SeriesRecord {
        measurements: vec![],
        at: vec![1.0, 2.0],
        measurement: vec![7],
        standardised: vec![f64::NAN],
        timed: true,
        time_unit: Some("s".into()),
        windows: vec![WindowRecord { from: f64::NAN, to: 1.0, count: 0, nis: f64::NAN }],
        autocorrelation: vec![],
    };
    let innovations = InnovationRecord {
        whitened_nis: None,
        count: 0,
        nis: Some(f64::NAN),
        nis_p_value: Some(f64::NAN),
        mean: None,
        whiteness: None,
        parts: vec![],
        series: Some(Box::new(series)),
    };
    let part = PosteriorRow { name: "main".into(), mean: vec![1.0], covariance: SquareRecord::default(), own: None };
    common::change_test(&mut record, 0, |test| {
        (test.phases, test.innovations) = (vec![part.clone()], Some(innovations.clone()));
    });
    let page = text(&html(&record));
    assert!(!page.contains("NaN"), "{page}");
    let empty = FitRecord { phases: vec![], tests: TestRecords::default(), ..record };
    assert!(html(&empty).contains("</html>"));
}

#[test]
fn the_page_of_a_record_is_that_of_its_json() {
    let record = with_tests(18);
    let back: FitRecord = serde_json::from_str(&serde_json::to_string(&record).unwrap()).unwrap();
    assert_eq!(html(&record), html(&back));
}
