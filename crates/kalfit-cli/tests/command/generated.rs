//! Completions and manual pages.

use std::process::Command;

use crate::folder::{Folder, shown};

const COMMANDS: [&str; 20] = [
    "init",
    "fit",
    "reduce",
    "estimates",
    "sums",
    "join",
    "test",
    "check",
    "simulate",
    "plan",
    "apply",
    "predict",
    "validate",
    "export",
    "datasheet",
    "compare",
    "report",
    "schema",
    "completions",
    "man",
];

#[test]
fn the_shell_takes_its_completions() {
    let folder = Folder::new(&[]);
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = folder.run(&format!("completions {shell}"));
        let script = shown(&output);
        assert!(output.status.success() && output.stderr.is_empty(), "{script}");
        for word in COMMANDS.iter().chain(&["max-iterations"]) {
            assert!(script.contains(word), "{shell} does not know `{word}`");
        }
    }
    let script = folder.run("completions bash").stdout;
    folder.write("kalfit.bash", &script);
    let check = "bash -n kalfit.bash && . ./kalfit.bash && COMP_WORDS=(kalfit init gy) COMP_CWORD=2 && \
        _kalfit kalfit gy init && echo ${COMPREPLY[@]}";
    let output =
        Command::new("bash").args(["-c", check]).current_dir(folder.path("")).output().expect("there is a bash");
    assert_eq!(String::from_utf8_lossy(&output.stdout), "gyro-bench\n", "{}", shown(&output));
}

#[test]
fn shells_that_are_not_known_are_refused_with_the_list() {
    let refused = shown(&Folder::new(&[]).run("completions bahs"));
    assert!(refused.starts_with("exit 2") && refused.contains("possible values: bash, elvish, fish"), "{refused}");
}

#[test]
fn the_page_of_the_program_has_all_commands() {
    let output = Folder::new(&[]).run("man");
    let page = shown(&output);
    assert!(output.status.success() && output.stderr.is_empty(), "{page}");
    assert!(page.contains(".TH kalfit 1"), "{page}");
    for command in COMMANDS {
        assert!(page.contains(&format!("kalfit\\-{command}(1)")), "no `{command}` in {page}");
    }
}

#[test]
fn every_command_has_a_page_with_its_options_and_examples() {
    let folder = Folder::new(&[]);
    let told = shown(&folder.run("man new/man1"));
    assert!(told.ends_with("Wrote 22 pages to new/man1\n"), "{told}");
    let page = |name: &str| {
        std::fs::read_to_string(folder.path(&format!("new/man1/{name}.1")))
            .unwrap_or_else(|error| panic!("{name}: {error}"))
    };
    assert!(page("kalfit").contains("Exit status"));
    for command in COMMANDS {
        assert!(page(&format!("kalfit-{command}")).contains("Examples"), "{command}");
    }
    assert!(page("kalfit-fit").contains("\\-\\-max\\-iterations"));
    assert_eq!(folder.path("new/man1").read_dir().expect("it is a folder").count(), 22);
    assert!(shown(&folder.run("man new/man1")).starts_with("exit 0"), "pages are replaced");
    assert!(shown(&folder.run("man d.csv")).starts_with("exit 2"), "a file is no folder");
}
