//! One run of the program on a damaged file, in a folder of its own.

use std::fmt;
use std::fs::File;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use super::corpus::{FuzzCorpus, FuzzSubject};

/// No run may take longer by the clock, whatever else the machine does.
const LONGEST: Duration = Duration::from_secs(600);
/// Address space of a run, in kilobytes.
const MEMORY: u64 = 4_000_000;

/// Processor time and memory that a run may take, by the size of its input. Fits of 50 000 tests of one row (1.9 MB) with
/// all figures took 20 to 60 s in a released build, and a test with all figures some 1 100 bytes.
#[derive(Debug, Clone, Copy)]
struct RunBudget {
    /// Seconds of processor time.
    processor: u64,
    /// Memory that is in use at once, in bytes.
    memory: u64,
}

impl RunBudget {
    fn of(bytes: usize) -> RunBudget {
        // a build with the settings of tests is slow outside of its kernels
        let slow = if cfg!(debug_assertions) { 4 } else { 1 };
        RunBudget { processor: slow * (30 + bytes as u64 / 40_000), memory: (256 << 20) + 400 * bytes as u64 }
    }
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RunEnd {
    Status(i32),
    Signal,
    TooLate,
}

impl fmt::Display for RunEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RunEnd::Status(status) => write!(f, "exit {status}"),
            RunEnd::Signal => f.write_str("a signal"),
            RunEnd::TooLate => f.write_str("too late"),
        }
    }
}

/// What a run left.
pub(super) struct FinishedRun {
    pub(super) ended: RunEnd,
    pub(super) seconds: Duration,
    /// Memory that was in use at once, in bytes, where the system says so.
    pub(super) memory: u64,
    said: String,
    complained: String,
    /// Names of files that were not there before.
    files: Vec<String>,
    /// What a compiler says of an exported header, where there is one and it is not sound C.
    compiler: Option<String>,
}

impl FinishedRun {
    /// What is wrong with the run on these bytes.
    pub(super) fn wrong(&self, bytes: &[u8]) -> Option<String> {
        let last = || self.complained.chars().rev().take(600).collect::<Vec<_>>().into_iter().rev().collect::<String>();
        if !matches!(self.ended, RunEnd::Status(0..=2)) {
            return Some(format!("it ended with {}\n{}", self.ended, last()));
        }
        let budget = RunBudget::of(bytes.len());
        if self.memory > budget.memory {
            return Some(format!("it used {} MB of the {} MB that it may", self.memory >> 20, budget.memory >> 20));
        }
        if self.complained.contains("panicked at") {
            return Some(format!("it panicked\n{}", last()));
        }
        // names and titles are shown as they are
        let was_given = bytes.windows(3).any(|three| three == b"NaN");
        if !was_given && self.said.split(|c: char| !c.is_alphanumeric()).any(|word| word == "NaN") {
            return Some("it printed NaN".to_owned());
        }
        if self.ended == RunEnd::Status(2) && !self.files.is_empty() {
            return Some(format!("it ended with status 2 and left {}", self.files.join(", ")));
        }
        if let Some(complaint) = &self.compiler {
            return Some(format!("it exported what is no C\n{complaint}"));
        }
        let torn = self.files.iter().find(|name| name.contains("kalfit-"));
        torn.map(|name| format!("it left the temporary file {name}"))
    }
}

/// Runs a line of words in a folder, which is gone again after it.
pub(super) fn run(
    corpus: &FuzzCorpus,
    subject: &FuzzSubject,
    (line, bytes): (&[String], &[u8]),
    folder: &Path,
) -> Result<FinishedRun, String> {
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    std::fs::create_dir_all(folder).map_err(failed)?;
    std::fs::write(folder.join(subject.name), bytes).map_err(failed)?;
    let word = |word: &String| match word.as_str() {
        "@" => subject.name.to_owned(),
        word if subject.folder.join(word).is_file() => subject.folder.join(word).display().to_string(),
        word => word.to_owned(),
    };
    let words: Vec<String> = line.iter().map(word).collect();
    let [out, err] = ["stdout", "stderr"].map(|name| folder.with_extension(name));
    let begun = Instant::now();
    let mut command = limited(&corpus.kalfit, RunBudget::of(bytes.len()));
    command
        .args(&words)
        .current_dir(folder)
        .stdin(Stdio::null())
        .env("RUST_BACKTRACE", "0")
        .env("RAYON_NUM_THREADS", "2");
    command.stdout(File::create(&out).map_err(failed)?).stderr(File::create(&err).map_err(failed)?);
    let mut child = command.spawn().map_err(|error| format!("{}: {error}", corpus.kalfit.display()))?;
    let mut memory = 0;
    let ended = loop {
        memory = memory.max(in_use(child.id()));
        match child.try_wait().map_err(failed)? {
            Some(status) => break ended(status),
            None if begun.elapsed() > LONGEST => {
                child.kill().and_then(|()| child.wait()).map_err(failed)?;
                break RunEnd::TooLate;
            }
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    };
    let seconds = begun.elapsed();
    let read =
        |path: &Path| std::fs::read(path).map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).map_err(failed);
    let (said, complained) = (read(&out)?, read(&err)?);
    let names = std::fs::read_dir(folder).map_err(failed)?;
    let names = names.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()));
    let files: Vec<String> = names.collect::<std::io::Result<Vec<_>>>().map_err(failed)?;
    let files: Vec<String> = files.into_iter().filter(|name| name != subject.name).collect();
    let header = files.iter().find(|name| name.ends_with(".h"));
    let compiler = header.and_then(|name| refused_by_compiler(&folder.join(name)));
    std::fs::remove_dir_all(folder).map_err(failed)?;
    [out, err].iter().try_for_each(std::fs::remove_file).map_err(failed)?;
    Ok(FinishedRun { ended, seconds, memory, said, complained, files, compiler })
}

/// What gcc says of a header with all warnings as errors; `None` where it is content, or where there is no gcc.
fn refused_by_compiler(header: &Path) -> Option<String> {
    let arguments = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-unused-variable", "-fsyntax-only", "-x", "c"];
    let output = Command::new("gcc").args(arguments).arg(header).output().ok()?;
    (!output.status.success()).then(|| String::from_utf8_lossy(&output.stderr).chars().take(600).collect())
}

fn ended(status: ExitStatus) -> RunEnd {
    status.code().map_or(RunEnd::Signal, RunEnd::Status)
}

/// The most memory that a process had in use so far, in bytes; 0 where the system does not say.
fn in_use(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
    kilobytes.unwrap_or(0) << 10
}

/// The program with so much memory and processor time and no more, where a shell can say so.
fn limited(kalfit: &Path, budget: RunBudget) -> Command {
    if !cfg!(unix) {
        return Command::new(kalfit);
    }
    let mut command = Command::new("sh");
    let limits = format!("ulimit -v {MEMORY}; ulimit -t {}; exec \"$@\"", budget.processor);
    command.args(["-c", &limits, "sh"]).arg(kalfit);
    command
}
