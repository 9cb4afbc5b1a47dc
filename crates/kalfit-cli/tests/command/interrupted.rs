//! Ctrl-C, by a signal to the process.
#![cfg(target_os = "linux")]

use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::folder::{Folder, shown};
use kalfit::FitRecord;

/// A search that goes on for hours if it is let: EM towards a tolerance that it does not reach.
const ENDLESS: &str = "fit m.toml d.csv --solver em --tolerance 1e-300 --max-iterations 4000000000 --threads 1";

/// Starts the command with signals as they are by default: whoever runs the tests may ignore them.
fn start(folder: &Folder, args: &str) -> Child {
    let mut command = Command::new("env");
    command.args(["--default-signal=INT,TERM,HUP", env!("CARGO_BIN_EXE_kalfit")]).args(args.split_whitespace());
    command.current_dir(folder.path("")).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().expect("`env` is there")
}

fn interrupt(child: &Child) {
    signal(child, "-INT");
}

fn signal(child: &Child, name: &str) {
    let status = Command::new("kill").args([name, &child.id().to_string()]).status();
    assert!(status.expect("`kill` is there").success(), "the process has ended by itself");
}

/// Ticks of processor time that the process has used, all its threads.
fn ticks(child: &Child) -> u64 {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    [11, 12].iter().filter_map(|&i| fields.get(i)?.parse::<u64>().ok()).sum()
}

/// Waits until it has worked for half a second of processor time: a few rows are read and the search begun long before.
fn until_it_searches(child: &Child) {
    let began = Instant::now();
    while ticks(child) < 50 {
        assert!(began.elapsed() < Duration::from_secs(120), "it does not work");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn end(child: Child) -> Output {
    child.wait_with_output().expect("it ends")
}

#[test]
fn a_fit_ends_with_the_best_so_far_and_writes_it_as_not_converged() {
    for name in ["-INT", "-TERM", "-HUP"] {
        ends_with_the_best_so_far(name);
    }
}

/// By one signal.
fn ends_with_the_best_so_far(name: &str) {
    let folder = Folder::new(&[]);
    let child = start(&folder, &format!("{ENDLESS} --out fit.json --report fit.html"));
    until_it_searches(&child);
    signal(&child, name);
    let output = end(child);
    let seen = shown(&output);
    assert!(seen.starts_with("exit 130\n"), "{seen}");
    assert!(seen.contains("Not converged") && seen.contains("interrupted"), "{seen}");
    assert!(seen.ends_with("Wrote fit.json\nWrote fit.html\n"), "{seen}");
    let text = std::fs::read_to_string(folder.path("fit.json")).expect("it was written");
    let record: FitRecord = serde_json::from_str(&text).expect("fit.json is a record");
    assert!(!record.converged && record.reason.contains("interrupted"), "{}", record.reason);
    let page = std::fs::read_to_string(folder.path("fit.html")).expect("it was written");
    assert!(page.contains("interrupted"), "the page says so");
    assert_eq!(folder.contents().len(), 4, "no temporary file stays behind");
}

#[test]
fn a_second_signal_ends_a_fit_at_once() {
    let folder = Folder::new(&[]);
    let before = folder.contents();
    // the second one may come after the end that the first one led to: then there are results
    for _ in 0..20 {
        let child = start(&folder, ENDLESS);
        until_it_searches(&child);
        interrupt(&child);
        let _ = Command::new("kill").args(["-INT", &child.id().to_string()]).stderr(Stdio::null()).status();
        let output = end(child);
        assert_eq!(output.status.code(), Some(130), "{}", shown(&output));
        assert_eq!(folder.contents(), before);
        if output.stdout.is_empty() {
            return;
        }
    }
}

/// Under `nohup`, say: the one signal goes by, the other is heard.
#[test]
fn a_signal_that_was_ignored_at_the_start_stays_ignored() {
    let folder = Folder::new(&[]);
    let mut command = Command::new("env");
    command.args(["--ignore-signal=HUP", "--default-signal=INT,TERM", env!("CARGO_BIN_EXE_kalfit")]);
    command.args(format!("{ENDLESS} --out fit.json").split_whitespace()).current_dir(folder.path(""));
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    until_it_searches(&child);
    signal(&child, "-HUP");
    let (before, began) = (ticks(&child), Instant::now());
    while ticks(&child) < before + 20 {
        assert!(began.elapsed() < Duration::from_secs(120), "it works on");
        std::thread::sleep(Duration::from_millis(20));
    }
    signal(&child, "-TERM");
    let seen = shown(&end(child));
    assert!(seen.starts_with("exit 130\n") && seen.ends_with("Wrote fit.json\n"), "{seen}");
}

#[test]
fn other_commands_end_at_once_and_leave_nothing_behind() {
    let folder = Folder::new(&[]);
    let start_values = "[mean]\nstart = { level = 1, slope = 0 }\n[covariance]\nstart = [[1, 0], [0, 1]]\n";
    folder.write("m.toml", (crate::folder::MODEL.to_owned() + start_values).as_bytes());
    let before = folder.contents();
    let child =
        start(&folder, "simulate m.toml --from m.toml --design d.csv --seed 1 --tests 1000000000 --out drawn.csv");
    until_it_searches(&child);
    assert!(folder.contents().len() > before.len(), "it writes to a temporary file");
    interrupt(&child);
    let output = end(child);
    assert_eq!(output.status.code(), Some(130), "{}", shown(&output));
    assert_eq!(folder.contents(), before);
}
