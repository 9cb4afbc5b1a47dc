//! The reference pages, made from the code: help of the commands, keys of the model file, fields of fit.json.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::process::Command;

use kalfit::record::{
    ConstraintRecord, DeletionRecord, Figure, InnovationRecord, QuantityRecord, TestRecord, WhitenessRecord,
    WrongRowRecord,
};

use crate::source::{Structure, files, structures};
use crate::{fresh, root};

const MADE: &str = "<!-- Made from the code by `cargo dev book`. -->\n\n";

fn help(words: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_kalfit"));
    let output = command.args(words).arg("--help").env_remove("COLUMNS").env("NO_COLOR", "1").output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| format!("{}\n", line.trim_end())).collect()
}

/// Names of the commands, as the help lists them.
fn commands(help: &str) -> Vec<String> {
    let list = help.split("Commands:\n").nth(1).unwrap().split("\n\n").next().unwrap();
    let name = |line: &str| {
        line.strip_prefix("  ")?.split_whitespace().next().filter(|_| !line.starts_with("   ")).map(str::to_owned)
    };
    list.lines().filter_map(name).filter(|name| name != "help").collect()
}

#[test]
fn the_reference_of_commands_is_their_help() {
    let all = help(&[]);
    let mut page = format!("{MADE}# Commands\n\n```text\n{}```\n", all);
    for name in commands(&all) {
        write!(page, "\n## kalfit {name}\n\n```text\n{}```\n", help(&[&name])).unwrap();
    }
    fresh("reference/commands.md", &page);
}

/// The keys that a file of kalfit-spec knows, by the name of the list.
fn keys(file: &str, list: &str) -> Vec<String> {
    let text = std::fs::read_to_string(root().join("crates/kalfit-spec/src").join(file)).unwrap();
    let after = |start: &str| text.split(start).nth(1);
    if let Some(body) = after(&format!("const {list}: [&str; ")) {
        let body = body.split("];").next().unwrap().split('=').nth(1).unwrap();
        return body.split('"').skip(1).step_by(2).map(str::to_owned).collect();
    }
    let body = after(&format!("const {list}: &[Key] =")).unwrap_or_else(|| panic!("{file} has no {list}"));
    let body = body.split("];").next().unwrap();
    let named = |body: &str| -> Vec<String> {
        body.split("key(").skip(1).filter_map(|entry| Some(entry.split('"').nth(1)?.to_owned())).collect()
    };
    let shared = body.split(['[', ',', '\n', ' ']).filter(|word| !word.is_empty());
    let shared = shared.filter_map(|word| after(&format!("const {word}: Key =")));
    named(body).into_iter().chain(shared.flat_map(|entry| named(entry.split(';').next().unwrap()))).collect()
}

/// The names of processes that kalfit-spec knows.
fn processes() -> Vec<String> {
    let text = std::fs::read_to_string(root().join("crates/kalfit-spec/src/motion.rs")).unwrap();
    let list = text.split("const PROCESSES: ").nth(1).unwrap().split("];").next().unwrap();
    list.split('"').skip(1).step_by(2).map(str::to_owned).collect()
}

/// What `keys.txt` says of each key, table by table; every key of the code is in it, and no other.
#[test]
fn the_reference_of_the_model_file_has_every_key_of_the_code() {
    let words = std::fs::read_to_string(root().join("crates/kalfit-cli/tests/book/keys.txt")).unwrap();
    let mut page = format!("{MADE}# Model file\n");
    for section in words.split("\n== ").skip(1) {
        let (title, rest) = section.split_once('\n').unwrap();
        let (source, rest) = rest.split_once('\n').unwrap();
        let (intro, table) = rest.split_once("\n\n").unwrap();
        let said: Vec<(&str, &str)> = table.lines().filter_map(|line| line.split_once(": ")).collect();
        let known = match source.split_once(' ').unwrap() {
            ("processes", _) => processes(),
            (file, lists) => lists.split(' ').flat_map(|list| keys(file, list)).collect(),
        };
        let names: Vec<&str> = said.iter().map(|(name, _)| *name).collect();
        let sorted = |mut names: Vec<String>| {
            names.sort();
            names
        };
        let described = sorted(names.iter().map(|name| (*name).to_owned()).collect());
        assert_eq!(described, sorted(known), "keys.txt, {title}: left, what it describes; right, what the code knows");
        write!(page, "\n## {title}\n\n{}\n| key | meaning |\n|---|---|\n", wrapped(intro)).unwrap();
        for (name, meaning) in said {
            writeln!(page, "| `{name}` | {} |", meaning.replace('|', "\\|")).unwrap();
        }
    }
    page.push_str("\n## Expressions\n\n");
    page.push_str(&wrapped(&expressions()));
    fresh("reference/model-file.md", &page);
}

/// What the documentation of kalfit-spec says of the expression language.
fn expressions() -> String {
    let text = std::fs::read_to_string(root().join("crates/kalfit-spec/src/lib.rs")).unwrap();
    let part = text.split("//! # The expression language\n").nth(1).unwrap();
    let lines = part.lines().skip(1).take_while(|line| line.starts_with("//!"));
    lines.map(|line| format!("{}\n", line.trim_start_matches("//!").strip_prefix(' ').unwrap_or_default())).collect()
}

/// Rust's types in the words of JSON.
fn kind(rust: &str) -> String {
    let rust = owned(rust);
    let inside = |prefix: &str| rust.strip_prefix(prefix).and_then(|rest| rest.strip_suffix('>'));
    if let Some(inner) = inside("Option<") {
        return format!("{} or null", kind(inner));
    }
    if let Some(inner) = inside("Vec<") {
        return format!("list of {}", kind(inner));
    }
    if let Some(inner) = inside("Box<") {
        return kind(inner);
    }
    match rust.as_str() {
        "String" | "Label" | "PValueKind" => "text".to_owned(),
        "f64" => "number".to_owned(),
        "usize" | "u64" | "u32" => "count".to_owned(),
        "bool" => "true or false".to_owned(),
        "SquareRecord" => "list of list of number".to_owned(),
        "Interval" => "two ends, each a number or null".to_owned(),
        "[usize; 2]" => "pair of counts".to_owned(),
        "[f64; 2]" => "pair of numbers".to_owned(),
        "(String, usize)" => "pair of text and count".to_owned(),
        other => format!("[{other}](#{})", other.to_lowercase()),
    }
}

/// A type as if it had memory of its own.
fn owned(rust: &str) -> String {
    let views = [
        ("&'a String", "String"),
        ("&'a str", "String"),
        ("&'a [String]", "Vec<String>"),
        ("SquareRecord<&'a [f64]>", "SquareRecord"),
        ("&'a [f64]", "Vec<f64>"),
        ("PosteriorRecords<'a>", "Vec<PosteriorRecord>"),
        ("TestRecords", "Vec<TestRecord>"),
        ("&'a ", ""),
    ];
    views.iter().fold(rust.to_owned(), |rust, (view, own)| rust.replace(view, own))
}

/// Paragraphs of lines of at most a hundred characters; blocks stay as they are.
fn wrapped(text: &str) -> String {
    const WIDTH: usize = 100;
    let mut page = String::new();
    let (mut at, mut inside) = (0, false);
    for line in text.lines() {
        let fence = line.starts_with("```");
        if inside || fence || line.is_empty() {
            page.push_str(if at > 0 { "\n" } else { "" });
            page.push_str(line);
            page.push('\n');
            (at, inside) = (0, inside != fence);
            continue;
        }
        for word in line.split(' ') {
            let size = word.chars().count();
            let follows = at > 0 && at + 1 + size <= WIDTH;
            page.push_str(if follows {
                " "
            } else if at > 0 {
                "\n"
            } else {
                ""
            });
            page.push_str(word);
            at = if follows { at + 1 + size } else { size };
        }
    }
    page.push_str(if at > 0 { "\n" } else { "" });
    page
}

/// Words of the documentation without its links to code.
fn plain(words: &str) -> String {
    words.replace("[`", "`").replace("`]", "`").replace('|', "\\|")
}

/// The records that are reached from this one, in the order of their fields.
fn reached<'a>(name: &str, all: &'a BTreeMap<String, Structure>, found: &mut Vec<&'a Structure>) {
    let Some(structure) = all.get(name) else { return };
    if found.iter().any(|other| other.item.name == name) {
        return;
    }
    found.push(structure);
    for field in &structure.fields {
        let inner = owned(&field.kind);
        let inner = inner.rsplit('<').next().unwrap().trim_end_matches('>');
        reached(inner, all, found);
    }
}

fn records(title: &str, intro: &str, top: &str) -> String {
    let folders =
        ["crates/kalfit/src", "crates/kalfit-model/src", "crates/kalfit-infer/src", "crates/kalfit-record/src"];
    let found = folders.into_iter().flat_map(files).flat_map(|file| structures(&file));
    let all: BTreeMap<String, Structure> =
        found.filter(|s| s.item.attributes.contains("Serialize")).map(|s| (s.item.name.clone(), s)).collect();
    let mut order = Vec::new();
    reached(top, &all, &mut order);
    assert!(order.len() > 1, "{top} leads nowhere");
    let mut page = format!("{MADE}# {title}\n\n{}", wrapped(intro));
    for structure in order {
        write!(
            page,
            "\n## {}\n\n{}\n| field | type | meaning |\n|---|---|---|\n",
            structure.item.name,
            wrapped(&structure.item.words)
        )
        .unwrap();
        for field in &structure.fields {
            let name = if field.attributes.contains("flatten") {
                "(its fields)".to_owned()
            } else {
                format!("`{}`", field.name)
            };
            writeln!(page, "| {name} | {} | {} |", kind(&field.kind), plain(&field.words)).unwrap();
        }
    }
    page
}

#[test]
fn the_reference_of_results_has_every_field_of_the_code() {
    let fit = "`kalfit fit --out fit.json` writes a `FitRecord`. Unknown numbers are null. Later versions may add fields, but do not rename them.";
    fresh("reference/fit-json.md", &records("fit.json", fit, "FitRecord"));
    let test = "`kalfit test --out test.json` writes a `RatioRecord`.";
    fresh("reference/test-json.md", &records("test.json", test, "RatioRecord"));
    let plan = "`kalfit plan --out plan.json` writes a `PlanRecord`.";
    fresh("reference/plan-json.md", &records("plan.json", plan, "PlanRecord"));
    let validated = "`kalfit validate --out validated.json` writes a `ValidatedRecord`.";
    fresh("reference/validated-json.md", &records("validated.json", validated, "ValidatedRecord"));
    let compared = "`kalfit compare --out compared.json` writes a `ComparedRecord`.";
    fresh("reference/compared-json.md", &records("compared.json", compared, "ComparedRecord"));
    let sheet = "`kalfit datasheet --out datasheet.json` writes a `DatasheetRecord`.";
    fresh("reference/datasheet-json.md", &records("datasheet.json", sheet, "DatasheetRecord"));
}

#[test]
fn the_reference_names_fields_that_a_fit_writes() {
    let folder = tempfile::tempdir().unwrap();
    let examples = root().join("examples/random-coefficients");
    let mut command = Command::new(env!("CARGO_BIN_EXE_kalfit"));
    command.arg("fit").args(["sleepstudy.toml", "sleepstudy.csv"].map(|name| examples.join(name)));
    let output = command.arg("--out").arg(folder.path().join("fit.json")).output().unwrap();
    assert!(output.status.success());
    let text = std::fs::read_to_string(folder.path().join("fit.json")).unwrap();
    let fit: serde_json::Value = serde_json::from_str(&text).unwrap();
    let page = records("fit.json", "", "FitRecord");
    for (key, value) in fit.as_object().unwrap() {
        assert!(page.contains(&format!("| `{key}` |")), "{key} is not in the reference");
        for inner in value.as_array().and_then(|list| list.first()).unwrap_or(value).as_object().into_iter().flatten() {
            assert!(page.contains(&format!("| `{}` |", inner.0)), "{key}.{} is not in the reference", inner.0);
        }
    }
}

/// Words of a figure in the reference and columns of the guide's row for a table are those of the figures' entries.
#[test]
fn the_book_has_every_figure_of_the_code() {
    let fit = records("fit.json", "", "FitRecord");
    let guide = std::fs::read_to_string(root().join("book/src/guide/command-line.md")).unwrap();
    let row = |table: &str| guide.lines().find(|line| line.starts_with(&format!("| `{table}` |"))).unwrap().to_owned();
    let check = |table: &str, figures: &[(&str, &str, Option<&str>)], in_reference: bool| {
        for (name, words, column) in figures {
            let meaning = format!("| {} |", plain(words));
            assert!(!in_reference || fit.contains(&meaning), "{name} is not in the reference as {meaning}");
            let listed = column.is_none_or(|column| row(table).contains(&format!("`{column}`")));
            assert!(listed, "{column:?} is not in the guide's row for {table}");
        }
    };
    check("--tests", &entries(&TestRecord::FIGURES), true);
    check("--tests", &entries(&InnovationRecord::FIGURES), true);
    check("--tests", &entries(&WhitenessRecord::FIGURES), true);
    check("--tests", &entries(&DeletionRecord::FIGURES), true);
    check("--constraints", &entries(&ConstraintRecord::FIGURES), true);
    check("--rows", &entries(&WrongRowRecord::FIGURES), true);
    check("--parameters", &entries(&QuantityRecord::FIGURES), false); // fit.json has no list of them
}

/// (Name, words, column) of figures.
fn entries<R>(figures: &[Figure<R>]) -> Vec<(&'static str, &'static str, Option<&'static str>)> {
    figures.iter().map(|figure| (figure.name, figure.doc, figure.column)).collect()
}
