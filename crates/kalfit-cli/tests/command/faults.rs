//! Machines that fail: a process that is killed, disks that are full, limits on files, threads and memory. What stood in a file stays or
//! is replaced by the whole of the new, and nothing ends but with an exit status that the reference tells of.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::folder::{Folder, shown};
use kalfit::FitRecord;

const FIT: &str = "fit m.toml d.csv --out fit.json --report fit.html --tests tests.csv";
const WRITTEN: [&str; 3] = ["fit.json", "fit.html", "tests.csv"];

/// Runs a fit in a shell that was told something first.
fn after(folder: &Folder, told: &str) -> Output {
    let line = format!("{told}; exec '{}' {FIT}", env!("CARGO_BIN_EXE_kalfit"));
    Command::new("sh").args(["-c", &line]).current_dir(folder.path("")).stdin(Stdio::null()).output().unwrap()
}

/// Names of the files beside those that every folder has.
fn names(folder: &Folder) -> Vec<String> {
    let name = |(path, _): (String, Vec<u8>)| path.rsplit('/').next().unwrap_or_default().to_owned();
    folder.contents().into_iter().map(name).filter(|name| name != "m.toml" && name != "d.csv").collect()
}

/// Fails unless the run ended as the reference says, with files that are whole, and none after status 2.
fn is_sound(what: &str, folder: &Folder, output: &Output) {
    let seen = shown(output);
    let status = output.status.code();
    assert!(matches!(status, Some(0..=2)), "{what}: {:?}\n{seen}", output.status);
    let left = names(folder);
    assert!(left.iter().all(|name| WRITTEN.contains(&name.as_str())), "{what}: {left:?}\n{seen}");
    assert!(status != Some(2) || left.is_empty(), "{what}: {left:?} after status 2\n{seen}");
    assert!(status != Some(0) || left.len() == WRITTEN.len(), "{what}: only {left:?} after status 0\n{seen}");
    let is_told = seen.contains("error: ") || seen.contains("memory allocation of ");
    assert!(status == Some(0) || is_told, "{what}: no word of it\n{seen}");
    left.iter().for_each(|name| is_whole(what, folder, name));
}

/// A file that a fit writes, to its end.
fn is_whole(what: &str, folder: &Folder, name: &str) {
    let text = std::fs::read_to_string(folder.path(name)).unwrap();
    let whole = match name {
        "fit.json" => serde_json::from_str::<FitRecord>(&text).is_ok_and(|record| record.converged),
        "fit.html" => text.trim_end().ends_with("</html>"),
        _ => text.lines().count() == 4 && text.ends_with('\n'),
    };
    assert!(whole, "{what}: {name} is torn:\n{text}");
}

fn clear(folder: &Folder) {
    names(folder).iter().for_each(|name| std::fs::remove_file(folder.path(name)).unwrap());
}

/// What was in a file stays or is replaced; what the killed process was writing stays beside it under a name of its own.
#[test]
fn a_killed_fit_leaves_the_old_file_or_the_whole_new_one() {
    const TIMES: u32 = 24;
    let folder = Folder::new(&[]);
    let start =
        || folder.command(FIT).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let began = Instant::now();
    assert!(start().wait().unwrap().success());
    let whole = began.elapsed();
    let old: Vec<&[u8]> = vec![b"old results", b"an old page", b"an old table"];
    let (mut replaced, mut left) = (0, 0);
    for time in 0..TIMES {
        clear(&folder);
        WRITTEN.iter().zip(&old).for_each(|(name, text)| folder.write(name, text));
        let mut child = start();
        if time % 2 == 0 {
            std::thread::sleep(whole * time / TIMES);
        } else {
            // while it writes, which it does at the end
            let writes = |name: &String| name.starts_with(".kalfit-");
            while child.try_wait().unwrap().is_none() && !names(&folder).iter().any(writes) {}
            std::thread::sleep(Duration::from_micros(200) * time);
        }
        child.kill().unwrap();
        child.wait().unwrap();
        for (name, text) in WRITTEN.iter().zip(&old) {
            if std::fs::read(folder.path(name)).unwrap() != *text {
                is_whole(&format!("kill {time}"), &folder, name);
                replaced += 1;
            }
        }
        for name in names(&folder).iter().filter(|name| !WRITTEN.contains(&name.as_str())) {
            assert!(name.starts_with(".kalfit-") && name.ends_with(".tmp"), "{name}");
            left += 1;
        }
    }
    println!("of {TIMES} fits that were killed: {replaced} files replaced, {left} temporary ones left");
    // another one works beside what the killed ones left
    let output = folder.run(FIT);
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    WRITTEN.iter().for_each(|name| is_whole("the fit afterwards", &folder, name));
}

#[test]
fn files_beyond_the_limit_are_an_error_and_no_silent_end() {
    let folder = Folder::new(&[]);
    for blocks in [0, 1, 8, 16, 24, 40, 200] {
        let output = after(&folder, &format!("ulimit -f {blocks}"));
        is_sound(&format!("files of {blocks} blocks"), &folder, &output);
        clear(&folder);
    }
    let none = shown(&after(&folder, "ulimit -f 0"));
    assert!(none.starts_with("exit 2\n") && none.contains("File too large (os error 27)"), "{none}");
}

#[test]
fn few_open_files_are_enough_or_an_error() {
    let folder = Folder::new(&[]);
    for files in 4..16 {
        let output = after(&folder, &format!("ulimit -n {files}"));
        is_sound(&format!("{files} open files"), &folder, &output);
        clear(&folder);
    }
}

/// Megabytes that a command needs beyond those that the program takes to be loaded, to say that they are too few.
const LEAST: u64 = 64;

/// Below some limit the system itself cannot load the program; above it the program says that something is missing.
#[test]
fn little_address_space_is_enough_or_an_error() {
    let folder = Folder::new(&[]);
    let loads = |megabytes: u64| {
        let line = format!("ulimit -v {}; exec '{}' --version", megabytes << 10, env!("CARGO_BIN_EXE_kalfit"));
        let run = Command::new("sh").args(["-c", &line]).stderr(Stdio::null()).stdout(Stdio::null()).status();
        run.is_ok_and(|status| status.success())
    };
    let least = (8..400).step_by(4).find(|&megabytes| loads(megabytes)).expect("it loads within 400 MB");
    println!("the program is loaded from {least} MB on");
    let mut ended = Vec::new();
    for more in [0, 4, 8, 12, 16, 24, 32, 64, 96, 128, 256, 512, 1024, 4096] {
        let output = after(&folder, &format!("ulimit -v {}", (least + more) << 10));
        // a thread begins with a stack for its signals, without which the standard library ends the process
        let no_stack = String::from_utf8_lossy(&output.stderr).contains("alternative stack");
        if output.status.code().is_none() && (more < LEAST || no_stack) {
            // too little to say anything: the allocator itself gives up
            ended.push((least + more, None));
            clear(&folder);
            continue;
        }
        is_sound(&format!("{} MB", least + more), &folder, &output);
        ended.push((least + more, output.status.code()));
        clear(&folder);
    }
    println!("by megabytes: {ended:?}");
    // the allocator takes a gigabyte of address space in advance where it can
    assert_eq!(ended.last().map(|(_, status)| *status), Some(Some(0)), "four gigabytes are enough");
}

/// Memory that is refused in the middle of work ends a command by SIGABRT, which has an exit status like any other failure.
#[test]
fn an_abort_has_an_exit_status() {
    let folder = Folder::new(&[]);
    let quiet = || Stdio::null();
    let mut child =
        folder.command("check m.toml -").stdin(Stdio::piped()).stdout(quiet()).stderr(quiet()).spawn().unwrap();
    let caught = || {
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).map(str::trim).unwrap_or_default();
        u64::from_str_radix(mask, 16).is_ok_and(|mask| mask >> 5 & 1 == 1)
    };
    let begun = Instant::now();
    while !caught() && begun.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(Command::new("kill").args(["-ABRT", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(2));
}

/// A real disk, as large as the results but not the page: where whoever runs the tests may mount one.
#[test]
fn a_full_disk_keeps_what_there_is_room_for() {
    let folder = Folder::new(&[]);
    std::fs::create_dir(folder.path("disk")).unwrap();
    let fit = format!("'{}' fit ../m.toml ../d.csv --out fit.json --report fit.html", env!("CARGO_BIN_EXE_kalfit"));
    for kilobytes in [4, 32, 64] {
        let line =
            format!("mount -t tmpfs -o size={kilobytes}k none disk && cd disk && {{ {fit}; echo exit $?; ls -A; }}");
        let run = Command::new("unshare").args(["-Urm", "sh", "-c", &line]).current_dir(folder.path("")).output();
        let Ok(output) = run else { return println!("there is no `unshare`: nothing is tested") };
        let (said, wrong) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        let Some((_, ended)) = said.split_once("exit ") else {
            return println!("nothing can be mounted here: nothing is tested\n{wrong}");
        };
        let left: Vec<&str> = ended.lines().skip(1).collect();
        let sound = match ended.lines().next() {
            Some("2") => left.is_empty(),
            Some("1") => left == ["fit.json"],
            _ => false,
        };
        assert!(sound && wrong.contains("No space left on device"), "{kilobytes} kB: {said}\n{wrong}");
    }
}

/// Two signals at once and a reader that has gone: neither is a crash.
#[test]
fn a_reader_that_goes_and_signals_that_come_at_once_end_as_they_say() {
    let folder = Folder::new(&[]);
    for time in 0..8_u64 {
        let mut child = folder
            .command("fit m.toml d.csv --out fit.json")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        std::thread::sleep(Duration::from_millis(3 * time));
        for name in ["-TERM", "-HUP"] {
            let kill = Command::new("kill").args([name, &child.id().to_string()]).stderr(Stdio::null()).status();
            drop(kill); // it may have ended
        }
        let output = child.wait_with_output().unwrap();
        // before it listens, a signal does what it does to any program
        let early = matches!(output.status.signal(), Some(1 | 15));
        let code = output.status.code();
        assert!(early || matches!(code, Some(0..=2 | 130 | 141)), "{:?} {}", output.status, shown(&output));
        let left = names(&folder);
        assert!(left.iter().all(|name| name == "fit.json"), "{left:?}");
        if !left.is_empty() {
            serde_json::from_slice::<FitRecord>(&std::fs::read(folder.path("fit.json")).unwrap()).expect("it is whole");
        }
        clear(&folder);
    }
}
