//! A likelihood-ratio test in words and tables.

use kalfit::record::{BootstrapRecord, FRecord, ParameterRecord, RatioRecord, SideRecord};

use crate::TextStyle;
use crate::number::{hundredths, p_value, plain, probability};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count, sentence};

/// Rows of the table of parameters.
const MOST_PARAMETERS: usize = 30;

/// The test in words and tables: what is tested, what was found, how far it can be trusted. Every line fits `style.width`.
pub fn ratio_summary(record: &RatioRecord, style: &TextStyle) -> String {
    let page = PageLayout::new(style);
    let mut sections = vec![headline(record, &page), fits(record, &page), laws(record, &page)];
    sections.push(parameters(record, &page));
    sections.push(parts(record, &page));
    let notes: Vec<String> = record.notes.iter().map(|note| sentence(&clean(note))).collect();
    sections.push(page.section("Notes", &page.items(&notes)));
    sections.retain(|s| !s.is_empty());
    sections.join("\n")
}

/// The same as parts of a larger page.
pub(crate) fn sections(record: &RatioRecord, page: &PageLayout<'_>) -> String {
    let notes: Vec<String> = record.notes.iter().map(|note| sentence(&clean(note))).collect();
    let verdict =
        page.paragraph(&format!("Hypothesis: {}", clean(&record.hypothesis))) + &page.paragraph(&verdict(record));
    let parts = [fits(record, page), laws(record, page), parameters(record, page), parts(record, page)];
    verdict + &parts.concat() + &page.section("Notes on the test", &page.items(&notes))
}

fn headline(record: &RatioRecord, page: &PageLayout<'_>) -> String {
    let title = if record.title.is_empty() { "Test of a hypothesis" } else { record.title.as_str() };
    let mut text = page.heading(&clean(title)) + "\n\n";
    text += &page.paragraph(&format!("Hypothesis: {}", clean(&record.hypothesis)));
    let verdict = page.paragraph(&verdict(record));
    match record.converged {
        true => text += &verdict,
        false => text.extend(verdict.lines().map(|line| page.style.bad(line) + "\n")),
    }
    text
}

/// What the test says, in one sentence.
fn verdict(record: &RatioRecord) -> String {
    if !record.converged {
        return "Not converged: one of the fits did not converge, so this test means little.".to_owned();
    }
    let (p, how) = match record.bootstrap.as_ref().and_then(|b| b.p_value) {
        Some(p) => (p, "by the bootstrap"),
        None => (record.p_value, "by the large-sample distribution"),
    };
    let verdict = match p {
        p if !p.is_finite() => "there is no p-value",
        p if p < 0.001 => "the data strongly contradict the hypothesis",
        p if p < 0.05 => "the data contradict the hypothesis",
        _ => "the data do not contradict the hypothesis",
    };
    format!("{}: {} {how}.", capital(verdict), p_value(p))
}

fn capital(text: &str) -> String {
    text[..1].to_uppercase() + &text[1..]
}

fn fits(record: &RatioRecord, page: &PageLayout<'_>) -> String {
    let sides: [(&str, &SideRecord); 2] = [("hypothesis", &record.null), ("model", &record.alternative)];
    let column = |of: &dyn Fn(&SideRecord) -> String| sides.iter().map(|(_, side)| of(side)).collect();
    let columns = [
        TextColumn::new("", ColumnSide::Left, sides.iter().map(|(name, _)| (*name).to_owned()).collect()),
        TextColumn::new("log-likelihood", ColumnSide::Right, column(&|s| plain(s.log_likelihood, 8))),
        TextColumn::new("free", ColumnSide::Right, column(&|s| s.free_parameters.to_string())),
        TextColumn::new(
            "AIC",
            ColumnSide::Right,
            column(&|s| hundredths(2.0 * s.free_parameters as f64 - 2.0 * s.log_likelihood)),
        ),
        TextColumn::new("converged", ColumnSide::Right, column(&|s| if s.converged { "yes" } else { "no" }.to_owned())),
    ];
    page.section(&format!("Fits to {}", count(record.data.tests, "test")), &page.table(&columns))
}

fn laws(record: &RatioRecord, page: &PageLayout<'_>) -> String {
    let mut rows: Vec<(String, f64)> = Vec::new();
    let law = record.law.iter().map(|c| match record.law.len() {
        1 => format!("χ²({})", c.df),
        _ => format!("{} χ²({})", plain(c.weight, 3), c.df),
    });
    let law = law.collect::<Vec<_>>().join(" + ");
    let bound = if record.law_is_bound { "upper bound: " } else { "" };
    rows.push((format!("{bound}{law}"), record.p_value));
    if record.law.len() > 1 {
        if let (Some(p), Some(mixture)) = (record.p_mixture, &record.mixture)
            && (p - record.p_value).abs() > 1e-3 * record.p_value
        {
            rows.push((format!("as if independent: {}", independent(mixture)), p));
        }
        rows.push((format!("χ²({}), which ignores the boundary", record.df), record.p_chi2_df));
    }
    if let Some(f) = &record.f {
        rows.push((of_means(f), f.p_value));
    }
    if let Some(bootstrap) = &record.bootstrap {
        rows.push((drawn(bootstrap), bootstrap.p_value.unwrap_or(f64::NAN)));
    }
    let columns = [
        TextColumn::new("reference distribution", ColumnSide::Left, rows.iter().map(|r| r.0.clone()).collect()),
        TextColumn::new("p-value", ColumnSide::Right, rows.iter().map(|r| probability(r.1)).collect()),
    ];
    let heading = format!("-2 log λ = {}", plain(record.lr, 6));
    let mut body = page.table(&columns);
    body += &page.items(&record.bootstrap.as_ref().map_or_else(Vec::new, remarks));
    page.section(&heading, &body)
}

/// The line of an F test: `F(2, 4.88) = 204.6 by Kenward and Roger, for few tests`.
fn of_means(f: &FRecord) -> String {
    let by = if f.method == "kenward-roger" { "Kenward and Roger" } else { "Satterthwaite" };
    let den = f.df_den.map_or_else(|| "∞".to_owned(), |df| plain(df, 3));
    format!("F({}, {den}) = {} by {by}, for few tests", f.df_num, plain(f.value, 4))
}

/// `0.5 chi2_0; 0.5 chi2_1` as other laws are written.
fn independent(mixture: &str) -> String {
    let component = |word: &str| word.split_once("chi2_").map(|(weight, df)| format!("{weight}χ²({df})"));
    mixture.split("; ").map(|word| component(word).unwrap_or_else(|| word.to_owned())).collect::<Vec<_>>().join(" + ")
}

/// What its p-value does not say.
fn remarks(bootstrap: &BootstrapRecord) -> Vec<String> {
    let mut remarks = Vec::new();
    if bootstrap.failed > 0 {
        remarks.push(match bootstrap.failed {
            1 => "1 draw was left out because its fit did not converge.".to_owned(),
            n => format!("{n} draws were left out because their fits did not converge."),
        });
    }
    let counted = bootstrap.replicates.saturating_sub(bootstrap.failed) as f64;
    if bootstrap.p_value.is_some_and(|p| p * (1.0 + counted) < 1.5) {
        remarks.push("No draw was as extreme as the data: with more draws the p-value may be smaller.".to_owned());
    }
    remarks
}

fn drawn(bootstrap: &BootstrapRecord) -> String {
    let how = format!("bootstrap of {}, seed {}", bootstrap.replicates, bootstrap.seed);
    bootstrap.std_error.map_or_else(|| how.clone(), |error| format!("{how} (± {})", plain(error, 2)))
}

fn name(p: &ParameterRecord) -> [Option<&str>; 3] {
    [Some(p.name.as_str()), p.per.as_deref(), p.level.as_deref()]
}

/// Dynamic parameters on both sides, where some are free.
fn parameters(record: &RatioRecord, page: &PageLayout<'_>) -> String {
    let rows = &record.alternative.parameters[..record.alternative.parameters.len().min(MOST_PARAMETERS)];
    let words = |p: &ParameterRecord| name(p).into_iter().flatten().collect::<Vec<_>>().join(" ");
    let value = |p: &ParameterRecord| {
        let fixed = if p.fixed { " fixed" } else { "" };
        format!("{}{fixed}", plain(p.estimate, 6))
    };
    let null = |p: &ParameterRecord| {
        let of = record.null.parameters.iter().filter(|other| other.name == p.name);
        let (own, common) =
            (of.clone().find(|other| name(other) == name(p)), of.clone().find(|other| other.per.is_none()));
        own.or(common).map_or("-".to_owned(), value)
    };
    if rows.is_empty() {
        return String::new();
    }
    let columns = [
        TextColumn::new("parameter", ColumnSide::Left, rows.iter().map(words).collect()),
        TextColumn::new("hypothesis", ColumnSide::Right, rows.iter().map(null).collect()),
        TextColumn::new("model", ColumnSide::Right, rows.iter().map(value).collect()),
    ];
    let more = record.alternative.parameters.len() - rows.len();
    let more = if more > 0 { vec![format!("… and {more} more.")] } else { Vec::new() };
    page.section("Dynamic parameters", &(page.table(&columns) + &page.items(&more)))
}

fn parts(record: &RatioRecord, page: &PageLayout<'_>) -> String {
    if record.parts.is_empty() {
        return String::new();
    }
    let mut rows: Vec<(String, f64, usize, f64)> = record
        .parts
        .iter()
        .map(|p| {
            (format!("{} alone{}", p.what, if p.converged { "" } else { " (not converged)" }), p.lr, p.df, p.p_value)
        })
        .collect();
    let dynamic = record.parts.iter().any(|p| p.what == "parameters");
    let (all, heading) = match (dynamic, rows.len()) {
        (false, _) => ("both", "Mean and covariance separately"),
        (true, 2) => ("both", "The two parts of the hypothesis separately"),
        (true, _) => ("all", "The parts of the hypothesis separately"),
    };
    rows.push((all.to_owned(), record.lr, record.df, record.p_value));
    let columns = [
        TextColumn::new("hypothesis on", ColumnSide::Left, rows.iter().map(|r| r.0.clone()).collect()),
        TextColumn::new("-2 log λ", ColumnSide::Right, rows.iter().map(|r| plain(r.1, 5)).collect()),
        TextColumn::new("df", ColumnSide::Right, rows.iter().map(|r| r.2.to_string()).collect()),
        TextColumn::new("p-value", ColumnSide::Right, rows.iter().map(|r| probability(r.3)).collect()),
    ];
    page.section(heading, &page.table(&columns))
}
