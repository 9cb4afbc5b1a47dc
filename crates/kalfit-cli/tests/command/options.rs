//! Options that every command has, short options, results on standard output.

use crate::folder::{Folder, shown};

#[test]
fn options_of_all_commands_stand_anywhere() {
    let folder = Folder::new(&[]);
    for line in ["-q -j 1 fit m.toml d.csv -o fit.json", "fit -j1 m.toml d.csv --quiet --out fit.json"] {
        assert_eq!(shown(&folder.run(line)), "exit 0\n----- stdout\n----- stderr\n", "{line}");
        assert!(folder.path("fit.json").exists());
        std::fs::remove_file(folder.path("fit.json")).expect("it was written");
    }
    assert_eq!(shown(&folder.run("check m.toml d.csv --quiet")), "exit 0\n----- stdout\n----- stderr\n");
}

#[test]
fn colour_is_by_the_option_whatever_the_terminal_and_the_variables_say() {
    let folder = Folder::new(&[]);
    let colored = |line: &str, force: bool| {
        let mut command = folder.command(line);
        if force {
            command.env("CLICOLOR_FORCE", "1");
        }
        let output = command.output().expect("the command runs");
        [output.stdout, output.stderr].map(|bytes| bytes.contains(&b'\x1b'))
    };
    assert_eq!(colored("fit m.toml d.csv", false), [false, false]);
    assert_eq!(colored("fit m.toml d.csv --color always", false), [true, false]);
    assert_eq!(colored("fit m.toml d.csv --color auto", true), [true, false]);
    assert_eq!(colored("fit m.toml d.csv --color never", true), [false, false]);
    assert_eq!(colored("--color always fit none.toml d.csv", false), [false, true]);
    assert_eq!(colored("fit none.toml d.csv --color never", true), [false, false]);
}

/// Without the time it took.
fn steady(text: &str) -> String {
    text.lines().filter(|line| !line.contains("\"seconds\"")).map(|line| format!("{line}\n")).collect()
}

#[test]
fn results_on_standard_output_are_those_of_the_file() {
    let null = "[mean]\nfixed = { level = 1, slope = 0.5 }\n";
    let timed = crate::folder::MODEL.replace("test = \"id\"", "test = \"id\"\ntime = \"x\"");
    let folder = Folder::new(&[("null.toml", null.as_bytes()), ("timed.toml", timed.as_bytes())]);
    assert_eq!(folder.run("fit timed.toml d.csv -q -o timed.json").status.code(), Some(0));
    assert_eq!(folder.run("fit m.toml d.csv -q -o base.json").status.code(), Some(0));
    std::fs::copy(folder.path("base.json"), folder.path("same.json")).expect("it was written");
    let lines = [
        "fit m.toml d.csv",
        "check m.toml d.csv",
        "test m.toml d.csv --null null.toml",
        "plan m.toml --from base.json --design d.csv --tests 5",
        "validate m.toml d.csv --folds 3",
        "compare base.json same.json",
        "datasheet timed.toml --from timed.json d.csv",
    ];
    for line in lines {
        assert!(folder.run(&format!("{line} -q -o out.json")).status.code() < Some(2), "{line}");
        let file = std::fs::read_to_string(folder.path("out.json")).expect("the file is there");
        let printed = folder.run(&format!("{line} -o -"));
        let text = String::from_utf8(printed.stdout).expect("JSON is text");
        assert_eq!(steady(&text), steady(&file), "{line}");
        let schema = format!("\"schema\": \"kalfit-{}/1\"", line.split(' ').next().unwrap_or_default());
        assert!(text.contains(&schema), "{line} lacks {schema}");
        assert!(!String::from_utf8_lossy(&printed.stderr).contains("Wrote"), "{line}");
        std::fs::remove_file(folder.path("out.json")).expect("it was written");
    }
    let quiet = folder.run("fit m.toml d.csv -q -o -");
    assert!(quiet.stdout.starts_with(b"{") && quiet.stderr.is_empty(), "results are no message");
}

#[test]
fn values_of_a_fit_come_from_it_under_both_names() {
    let free = "\n[parameters]\nsigma = {}\n";
    let model = crate::folder::MODEL.replace("noise = 0.1", "noise = \"sigma\"") + free;
    let folder = Folder::new(&[("free.toml", model.as_bytes())]);
    assert!(folder.run("fit free.toml d.csv -q -o fit.json").status.code() < Some(2));
    for (option, name) in [("--from", "a.parquet"), ("--at", "b.parquet")] {
        let done = folder.run(&format!("reduce free.toml d.csv {option} fit.json -q -o {name}"));
        assert_eq!(shown(&done), "exit 0\n----- stdout\n----- stderr\n");
    }
    let read = |name: &str| std::fs::read(folder.path(name)).expect("it was written");
    assert!(read("a.parquet") == read("b.parquet"), "the tables differ");
}
