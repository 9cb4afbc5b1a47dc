//! Tests of the copy: which of them meet which mutant, and whether one of these fails while it is on.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::scratch::{ScratchCopy, TestProgram};

/// Address space of a run, in kilobytes.
const MEMORY: u64 = 8_000_000;
/// A run may take so many times as long as without a mutant, and this much more.
const SLOWER: u32 = 5;
const AND: Duration = Duration::from_secs(10);
/// Tests go in batches, the quickest first, each as long as this at most (seconds) and then as the rest.
const BATCHES: [f64; 4] = [1.0, 10.0, 40.0, f64::INFINITY];

/// A test, how long it takes and which mutants it meets.
#[derive(Debug, Clone)]
pub(super) struct MutantTrial {
    /// Place of its program in the list.
    program: usize,
    name: String,
    seconds: f64,
    met: Vec<usize>,
}

/// How a mutant ended.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum MutantFate {
    /// By this test, or by how its run ended.
    Killed(String),
    /// Though so many tests run through it, of this many that could.
    Survived(usize, usize),
}

/// How a run of some tests ended.
enum TrialEnd {
    Passed,
    Failed(String),
}

/// A run of tests with a mutant, or with none.
struct TrialRun<'a> {
    tests: &'a TestProgram,
    names: Vec<&'a str>,
    limit: Duration,
}

impl TrialRun<'_> {
    fn command(&self) -> Command {
        let mut command = limited(&self.tests.program);
        command.args(["--exact", "--test-threads", "1"]).args(&self.names);
        command
            .current_dir(&self.tests.folder)
            .env("CARGO_MANIFEST_DIR", &self.tests.folder)
            .env("INSTA_WORKSPACE_ROOT", &self.tests.folder)
            .env("INSTA_UPDATE", "no")
            .env("PROPTEST_RNG_SEED", "1980")
            .env("PROPTEST_MAX_SHRINK_ITERS", "0")
            .env("PROPTEST_FAILURE_PERSISTENCE", "off")
            .env("RAYON_NUM_THREADS", "1")
            .env("RUST_BACKTRACE", "0");
        command
    }

    /// Until the first test fails.
    fn run(&self, environment: (&str, &str)) -> Result<TrialEnd, String> {
        let failed = |error: std::io::Error| format!("{}: {error}", self.tests.program.display());
        let mut command = self.command();
        command.env(environment.0, environment.1).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().map_err(failed)?;
        let out = child.stdout.take().ok_or("no output")?;
        let (sender, lines) = mpsc::channel();
        let reader = std::thread::spawn(move || {
            BufReader::new(out).lines().map_while(Result::ok).try_for_each(|line| sender.send(line))
        });
        let end = Instant::now() + self.limit;
        let ended = loop {
            match lines.recv_timeout(end.saturating_duration_since(Instant::now())) {
                Ok(line) => {
                    if let Some(name) = line.strip_prefix("test ").and_then(|rest| rest.strip_suffix(" ... FAILED")) {
                        break Some(name.trim_end_matches(" - should panic").to_owned());
                    }
                }
                Err(RecvTimeoutError::Timeout) => break Some("no end".to_owned()),
                Err(RecvTimeoutError::Disconnected) => break None,
            }
        };
        if let Some(by) = ended {
            child.kill().and_then(|()| child.wait()).map_err(failed)?;
            drop(lines);
            let _ = reader.join();
            return Ok(TrialEnd::Failed(by));
        }
        let status = child.wait().map_err(failed)?;
        Ok(if status.success() { TrialEnd::Passed } else { TrialEnd::Failed(format!("{status}")) })
    }
}

/// A program with so much memory and no more, where a shell can say so.
fn limited(program: &Path) -> Command {
    if !cfg!(unix) {
        return Command::new(program);
    }
    let mut command = Command::new("sh");
    command.args(["-c", &format!("ulimit -v {MEMORY}; ulimit -c 0; exec \"$@\""), "sh"]).arg(program);
    command
}

/// Every test by itself with no mutant on: all must pass.
pub(super) fn trials(scratch: &ScratchCopy, programs: &[TestProgram]) -> Result<Vec<MutantTrial>, String> {
    let (kept, head) = (scratch.file("trials"), head(programs)?);
    if let Some(trials) = std::fs::read_to_string(&kept).ok().and_then(|text| read(&text, &head)) {
        return Ok(trials);
    }
    let (mut trials, mut failed) = (Vec::new(), Vec::new());
    let met = scratch.file("met");
    for (program, tests) in programs.iter().enumerate() {
        let names = listed(tests)?;
        println!("   {}: {} tests, each by itself with no mutant on", tests.name, names.len());
        for name in names {
            let _ = std::fs::remove_file(&met);
            let begun = Instant::now();
            let run = TrialRun { tests, names: vec![&name], limit: Duration::from_secs(600) };
            if let TrialEnd::Failed(by) = run.run(("KALFIT_MUTANTS_MET", &met.display().to_string()))? {
                failed.push(format!("{} {name}: {by}", tests.name));
            }
            let seconds = begun.elapsed().as_secs_f64();
            let text = std::fs::read_to_string(&met).unwrap_or_default();
            let met = text.lines().filter_map(|line| line.parse().ok()).collect();
            trials.push(MutantTrial { program, name, seconds, met });
        }
    }
    if !failed.is_empty() {
        return Err(format!("these tests fail with no mutant on:\n  {}", failed.join("\n  ")));
    }
    std::fs::write(&kept, written(&trials, &head)).map_err(|error| format!("{}: {error}", kept.display()))?;
    Ok(trials)
}

/// What the kept trials are of.
fn head(programs: &[TestProgram]) -> Result<String, String> {
    let mut head = String::new();
    for tests in programs {
        let failed = |error: std::io::Error| format!("{}: {error}", tests.program.display());
        let built = std::fs::metadata(&tests.program).and_then(|data| data.modified()).map_err(failed)?;
        let since = built.duration_since(std::time::UNIX_EPOCH).unwrap_or_default().as_nanos();
        head.push_str(&format!("{} {since} ", tests.program.display()));
    }
    Ok(head)
}

fn written(trials: &[MutantTrial], head: &str) -> String {
    let mut text = format!("{head}\n");
    for trial in trials {
        let met: Vec<String> = trial.met.iter().map(usize::to_string).collect();
        text.push_str(&format!("{}\t{}\t{}\t{}\n", trial.program, trial.name, trial.seconds, met.join(" ")));
    }
    text
}

fn read(text: &str, head: &str) -> Option<Vec<MutantTrial>> {
    let (first, rest) = text.split_once('\n')?;
    let of = |line: &str| {
        let mut words = line.split('\t');
        let program = words.next()?.parse().ok()?;
        let (name, seconds) = (words.next()?.to_owned(), words.next()?.parse().ok()?);
        let met = words.next()?.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        Some(MutantTrial { program, name, seconds, met })
    };
    (first == head).then(|| rest.lines().map(of).collect())?
}

fn listed(tests: &TestProgram) -> Result<Vec<String>, String> {
    let done = Command::new(&tests.program).args(["--list", "--format", "terse"]).output();
    let done = done.map_err(|error| format!("{}: {error}", tests.program.display()))?;
    let text = String::from_utf8_lossy(&done.stdout);
    Ok(text.lines().filter_map(|line| line.strip_suffix(": test")).map(str::to_owned).collect())
}

/// Runs the tests that meet a mutant, the quickest first, until one fails or they have taken so many seconds.
pub(super) fn fate(
    programs: &[TestProgram],
    trials: &[MutantTrial],
    mutant: usize,
    seconds: f64,
) -> Result<MutantFate, String> {
    let mut meeting: Vec<&MutantTrial> = trials.iter().filter(|trial| trial.met.contains(&mutant)).collect();
    meeting.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    let asked = within(&meeting, seconds);
    let mut rest = asked;
    for most in BATCHES {
        let batch = within(rest, most);
        rest = &rest[batch.len()..];
        let mut by_program: BTreeMap<usize, Vec<&MutantTrial>> = BTreeMap::new();
        batch.iter().for_each(|&trial| by_program.entry(trial.program).or_default().push(trial));
        for (program, batch) in by_program {
            let seconds: f64 = batch.iter().map(|trial| trial.seconds).sum();
            let names = batch.iter().map(|trial| trial.name.as_str()).collect();
            let limit = Duration::from_secs_f64(seconds) * SLOWER + AND;
            let run = TrialRun { tests: &programs[program], names, limit };
            if let TrialEnd::Failed(by) = run.run(("KALFIT_MUTANT", &mutant.to_string()))? {
                return Ok(MutantFate::Killed(by));
            }
        }
    }
    Ok(MutantFate::Survived(asked.len(), meeting.len()))
}

/// The first of some tests, as many as there is time for.
fn within<'a, 't>(trials: &'a [&'t MutantTrial], seconds: f64) -> &'a [&'t MutantTrial] {
    let mut sum = 0.0;
    let in_time = |trial: &&&MutantTrial| {
        sum += trial.seconds;
        sum <= seconds
    };
    &trials[..trials.iter().take_while(in_time).count()]
}
