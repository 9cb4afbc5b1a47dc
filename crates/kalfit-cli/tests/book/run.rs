//! Runs the commands of a page one after the other, in a folder that holds the examples and nothing else.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::compare::{LEFT_OUT, agree};
use crate::page::{Block, Page};
use crate::{root, writing};

/// A command of a page and what it is said to print.
struct Said {
    words: Vec<String>,
    /// Lines of the page with what it prints.
    from: usize,
    to: usize,
    status: i32,
}

/// What is wrong with a page, in words; when writing, the page is put right instead.
pub(crate) fn check(mut page: Page) -> Vec<String> {
    let blocks = page.blocks();
    let mut commands =
        blocks.iter().flat_map(|block| if block.is("console") { said(&page, block) } else { Vec::new() });
    if commands.next().is_none() {
        return Vec::new();
    }
    let folder = tempfile::tempdir().unwrap();
    copy(&root().join("examples"), &folder.path().join("examples"));
    let mut wrong = Vec::new();
    let mut written = Vec::new();
    for block in &blocks {
        if let Some(name) = block.value("file") {
            std::fs::write(folder.path().join(name), page.expanded(block)).unwrap();
        }
        for said in if block.is("console") { said(&page, block) } else { Vec::new() } {
            let shown = page.lines[said.from..said.to].to_vec();
            let (printed, status) = run(folder.path(), &said.words);
            let place = format!("{}, line {}: {}", page.path, said.from, said.words.join(" "));
            if status != said.status {
                wrong.push(format!("{place}\nends with status {status} and prints\n{}", printed.join("\n")));
            } else if !agree(&shown, &printed) {
                let differs = format!("{place}\nshows\n{}\nbut prints\n{}", shown.join("\n"), printed.join("\n"));
                let shorter = shorten(&shown, printed.clone());
                if writing() && agree(&shorter, &printed) {
                    written.push((said, shorter));
                } else {
                    wrong.push(differs);
                }
            }
        }
    }
    if !written.is_empty() {
        for (said, lines) in written.into_iter().rev() {
            page.lines.splice(said.from..said.to, lines);
        }
        std::fs::write(page.file(), page.lines.join("\n") + "\n").unwrap();
    }
    wrong
}

/// Besides kalfit these are run, by a shell: what takes data apart.
const TOOLS: [&str; 1] = ["awk"];

/// The commands of a block: lines `$ kalfit …`, and those of [`TOOLS`], continued behind `\`, each with the lines up to the next `$`.
fn said(page: &Page, block: &Block) -> Vec<Said> {
    let status = block.value("status").map_or(0, |status| status.parse().unwrap());
    let starts: Vec<usize> = (block.at..block.end).filter(|&at| page.lines[at].starts_with("$ ")).collect();
    let mut commands = Vec::new();
    for (k, &start) in starts.iter().enumerate() {
        let mut from = start + 1;
        let mut text = page.lines[start]["$ ".len()..].to_owned();
        while let Some(begun) = text.strip_suffix('\\') {
            text = format!("{begun} {}", page.lines[from].trim());
            from += 1;
        }
        let words = match text.split(' ').next() {
            Some(tool) if TOOLS.contains(&tool) => vec!["sh".to_owned(), "-c".to_owned(), text.clone()],
            _ => words(text.split(" # ").next().unwrap_or_default()),
        };
        if words.first().is_some_and(|word| word == "kalfit" || word == "sh") {
            commands.push(Said { words, from, to: starts.get(k + 1).copied().unwrap_or(block.end), status });
        }
    }
    commands
}

/// Words of a command line; quotes keep spaces.
fn words(text: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), String::new(), None);
    for letter in text.chars().chain([' ']) {
        match (letter, quote) {
            ('\'' | '"', None) => quote = Some(letter),
            (letter, Some(open)) if letter == open => quote = None,
            (' ', None) if word.is_empty() => {}
            (' ', None) => words.push(std::mem::take(&mut word)),
            (letter, _) => word.push(letter),
        }
    }
    words
}

fn run(folder: &Path, words: &[String]) -> (Vec<String>, i32) {
    let program = if words[0] == "kalfit" { env!("CARGO_BIN_EXE_kalfit") } else { words[0].as_str() };
    let mut command = Command::new(program);
    command.args(&words[1..]).current_dir(folder).stdin(Stdio::null()).env_remove("COLUMNS").env("NO_COLOR", "1");
    let output = command.output().unwrap();
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
    (text.lines().map(|line| line.trim_end().to_owned()).collect(), output.status.code().unwrap_or(-1))
}

/// What a page leaves out stays out: each stretch of it is sought by its first words, and takes as many lines as before. A
/// single line `words *` asks for the paragraph that begins with the words.
fn shorten(shown: &[String], printed: Vec<String>) -> Vec<String> {
    if !shown.iter().any(|line| line == LEFT_OUT) {
        return printed;
    }
    let beginning = |line: &str| line.split_whitespace().take(2).map(str::to_owned).collect::<Vec<_>>();
    let mut at = 0;
    let mut kept: Vec<String> = Vec::new();
    for (k, stretch) in shown.split(|line| line == LEFT_OUT).enumerate() {
        if k > 0 {
            kept.push(LEFT_OUT.to_owned());
        }
        let Some(first) = stretch.first() else { continue };
        let asked = first.strip_suffix(" *");
        let begins = |line: &String| asked.map_or(beginning(line) == beginning(first), |words| line.starts_with(words));
        let found = (at..printed.len()).find(|&line| begins(&printed[line])).unwrap_or(at);
        let paragraph = printed[found..].iter().take_while(|line| !line.is_empty()).count();
        at = (found + if asked.is_some() { paragraph } else { stretch.len() }).min(printed.len());
        kept.extend_from_slice(&printed[found.min(at)..at]);
    }
    kept
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in from.read_dir().unwrap().map(Result::unwrap) {
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() {
            copy(&path, &target);
        } else {
            std::fs::copy(&path, &target).unwrap();
        }
    }
}
