//! The page itself: head, navigation, styles and scripts, all inline, and a policy that lets nothing else in.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use kalfit::FitRecord;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use sha2::{Digest, Sha256};

use crate::html::chart::{PageCharts, cut};
use crate::html::section::PageSection;
use crate::words::clean;

/// Apache ECharts, the parts that are used; see assets/README.md.
const LIBRARY: &str = include_str!("../../assets/echarts.min.js");
const STYLE: &str = include_str!("page/report.css");
/// Our own script, in parts; they share one scope.
const SCRIPTS: &[&str] = &[
    include_str!("page/base.js"),
    include_str!("page/groups.js"),
    include_str!("page/forest.js"),
    include_str!("page/matrix.js"),
    include_str!("page/ellipses.js"),
    include_str!("page/tests.js"),
    include_str!("page/innovations.js"),
    include_str!("page/allan.js"),
    include_str!("page/records.js"),
    include_str!("page/solver.js"),
    include_str!("page/table.js"),
    include_str!("page/start.js"),
];

pub(super) fn document(record: &FitRecord, sections: &[PageSection], charts: &PageCharts) -> String {
    let title = title(record);
    let own = format!("\"use strict\";(() => {{\n{}}})();", SCRIPTS.concat());
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(policy(&own));
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="generator" content=(format!("kalfit {}", clean(&record.kalfit_version)));
                meta name="color-scheme" content="light dark";
                title { (cut(&title, 120)) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                a.skip href="#main" { "Skip to the report" }
                header { div.wide {
                    div { p.kind { "Fit report" } h1 { (title) } }
                    div.tools {
                        button type="button" id="theme" hidden { "Dark" }
                        button type="button" id="print" hidden { "Print" }
                    }
                } }
                div.wide.columns {
                    nav aria-label="Contents" { (contents(sections)) }
                    main id="main" tabindex="-1" {
                        noscript { p.verdict { "Charts and sorting need JavaScript; all text and tables work without it." } }
                        @for section in sections {
                            section id=(section.id) aria-labelledby=(format!("{}-title", section.id)) {
                                h2 id=(format!("{}-title", section.id)) { (section.title) }
                                (section.body)
                            }
                        }
                    }
                }
                script type="application/json" id="charts" { (PreEscaped(charts.json())) }
                script { (PreEscaped(LIBRARY)) }
                script { (PreEscaped(&own)) }
            }
        }
    }
    .into_string()
}

fn title(record: &FitRecord) -> String {
    let title = clean(&record.title);
    if title.trim().is_empty() { "Untitled model".to_owned() } else { title }
}

fn contents(sections: &[PageSection]) -> Markup {
    html! { ol { @for section in sections { li { a href=(format!("#{}", section.id)) { (section.title) } } } } }
}

/// Nothing is loaded, nothing is sent, no script runs but these two.
fn policy(own: &str) -> String {
    let hash = |script: &str| format!("'sha256-{}'", STANDARD.encode(Sha256::digest(script.as_bytes())));
    format!(
        "default-src 'none'; script-src {} {}; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'",
        hash(LIBRARY),
        hash(own)
    )
}
