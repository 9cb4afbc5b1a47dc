//! Slips that everybody makes once: each gets a hint that names it.

use crate::folder::{DATA, Folder, MODEL, shown};
use insta::assert_snapshot;

/// What a command that must be refused says; it writes nothing.
fn refused(args: &str, files: &[(&str, &str)]) -> String {
    let files: Vec<(&str, &[u8])> = files.iter().map(|(name, text)| (*name, text.as_bytes())).collect();
    let folder = Folder::new(&files);
    let before = folder.contents();
    let said = shown(&folder.run(args));
    assert_eq!(before, folder.contents(), "`kalfit {args}` left the folder as it was");
    said.strip_prefix("exit 2\n----- stdout\n----- stderr\n").unwrap_or_else(|| panic!("{said}")).to_owned()
}

fn data(from: &str, to: &str) -> String {
    assert!(DATA.contains(from), "`{from}` is in the data");
    DATA.replacen(from, to, 1)
}

fn model(from: &str, to: &str) -> String {
    assert!(MODEL.contains(from), "`{from}` is in the model");
    MODEL.replacen(from, to, 1)
}

#[test]
fn names_of_outputs_that_say_something_else() {
    assert_snapshot!(refused("fit m.toml d.csv --out fit.html", &[]), @"
    error: the output `fit.html` would hold JSON, which its ending does not say

    hint: name it `.json`; a page for a browser is written by `--report fit.html` and by `kalfit report`
    ");
    assert_snapshot!(refused("fit m.toml d.csv --report fit.JSON", &[]), @"
    error: the output `fit.JSON` would hold a page of HTML, which its ending does not say

    hint: name it `.html`, from which a browser prints a PDF: `--report` takes a file for the page, `--out` one for the results, as JSON
    ");
    assert_snapshot!(refused("fit m.toml d.csv --out fit.csv", &[]), @"
    error: the output `fit.csv` would hold JSON, which its ending does not say

    hint: name it `.json`; a page for a browser is written by `--report fit.html` and by `kalfit report`
    ");
    assert_snapshot!(refused("report fit.json --out page.json", &[("fit.json", "{}")]), @"
    error: the output `page.json` would hold a page of HTML, which its ending does not say

    hint: name it `.html`: it is a page for a browser
    ");
    let folder = Folder::new(&[]);
    let said = shown(&folder.run("fit m.toml d.csv --out fit.1 --report fit.HTM"));
    assert!(said.ends_with("Wrote fit.1\nWrote fit.HTM\n"), "{said}");
}

#[test]
fn arguments_in_the_wrong_order() {
    assert_snapshot!(refused("fit d.csv m.toml", &[]), @"
    error: not valid TOML: key with no value, expected `=`
      --> d.csv:1:3 | id,x,y
                    |   ^

    hint: the model comes first, then the data: `m.toml d.csv`
    ");
    assert_snapshot!(refused("check d.csv m.toml", &[]), @"
    error: not valid TOML: key with no value, expected `=`
      --> d.csv:1:3 | id,x,y
                    |   ^

    hint: the model comes first, then the data: `m.toml d.csv`
    ");
}

#[test]
fn a_row_of_units() {
    let units = data("id,x,y\n", "id,x,y\n,s,deg/h\n");
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", &units)]), @r#"
    error: d.csv, row 2: found `s` and no number in the first row after the header, expected numbers

    hint: row 2 looks like a row of units: remove it, and give units in the model file, as `unit = "deg/h"`
    "#);
    let named = data("id,x,y\n", "id,x,y\n\n[-],[s],[deg/h]\n");
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", &named)]), @r#"
    error: d.csv, row 3: found `[deg/h]` and no number in the first row after the header, expected numbers

    hint: row 3 looks like a row of units: remove it, and give units in the model file, as `unit = "deg/h"`
    "#);
    // a single cell that is no number is none
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", &data("a,0,1.1", "a,0,low"))]), @"
    error: d.csv, row 2, column `y`: found `low`, expected a number

    hint: leave a missing cell empty, or add its text to `missing` of `[data]`
    ");
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", &data("a,1,2.0", "a,s,low"))]), @"
    error: d.csv, row 3, column `y`: found `low`, expected a number

    hint: leave a missing cell empty, or add its text to `missing` of `[data]`
    ");
}

#[test]
fn dates_as_europe_writes_them() {
    let timed = model("test = \"id\"", "test = \"id\"\ntime = \"t\"\ntime_unit = \"h\"");
    let date = |text: &str| format!("id,t,x,y\na,{text},0,1.1\n");
    let files = |text: &str| refused("fit m.toml d.csv", &[("m.toml", &timed), ("d.csv", &date(text))]);
    assert_snapshot!(files("13.02.2026"), @"
    error: d.csv, row 2, column `t`: found `13.02.2026`, expected a number or a date-time

    hint: write date-times as in ISO 8601: `13.02.2026` is `2026-02-13`
    ");
    assert_snapshot!(files("3.2.2026 14:05"), @"
    error: d.csv, row 2, column `t`: found `3.2.2026 14:05`, expected a number or a date-time

    hint: write date-times as in ISO 8601: `3.2.2026 14:05` is `2026-02-03T14:05`
    ");
    assert_snapshot!(files("31.02.2026"), @"
    error: d.csv, row 2, column `t`: found `31.02.2026`, expected a number or a date-time

    hint: a cell holds a number and nothing else; units go into the model file
    ");
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", &data("a,0,1.1", "a,0,13.02.2026"))]), @"
    error: d.csv, row 2, column `y`: found `13.02.2026`, expected a number

    hint: date-times are read in the column that `time` of `[data]` names, and nowhere else
    ");
}

#[test]
fn comments_in_csv() {
    let above = format!("# drawn by hand, \"so\"\n{DATA}");
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", &above)]), @r##"
    error: d.csv has no column `id`, which is used in `test` of `[data]`
      --> m.toml:2:8 | test = "id"
                     |        ^^^^ this column is not in the data

    hint: if lines that begin with `#` are comments, set `comment = "#"` in `[data]`
    "##);
    let within = data("b,0,0.4", "# a pause\nb,0,0.4");
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", &within)]), @r##"
    error: d.csv, row 5: found 1 cells, expected 3 as in the header

    hint: if lines that begin with `#` are comments, set `comment = "#"` in `[data]`
    "##);
    assert_snapshot!(refused("fit m.toml d.csv", &[("m.toml", &model("test = \"id\"", "test = \"id\"\ncomment = \"\""))]), @r#"
    error: `comment` of `[data]` is ``, expected a mark that no row begins with, such as `#` or `//`
      --> m.toml:3:11 | comment = ""
                      |           ^^
    "#);
}

#[test]
fn lines_of_comments_are_skipped_and_lines_keep_their_numbers() {
    let told = model("test = \"id\"", "test = \"id\"\ncomment = \"#\"");
    let commented = format!("# drawn; by hand, \"so\"\n#\n{}# the end", data("b,0,0.4", "# a pause, \"\nb,0,0.4"));
    let folder = Folder::new(&[("told.toml", told.as_bytes()), ("c.csv", commented.as_bytes())]);
    let fit = |args: &str| {
        let said = shown(&folder.run(args));
        assert!(said.starts_with("exit 0"), "{said}");
        said.lines().find(|line| line.contains("log-likelihood")).map(str::to_owned)
    };
    assert_eq!(fit("fit told.toml c.csv"), fit("fit m.toml d.csv"));
    let wrong = commented.replace("b,1,0.9", "b,one,0.9");
    assert_snapshot!(refused("fit told.toml c.csv", &[("told.toml", &told), ("c.csv", &wrong)]), @"
    error: c.csv, row 9, column `x`: found `one`, expected a number

    hint: a text is compared, as in `if(x == 'one', 1, 0)`; leave a missing cell empty, or add its text to `missing` of `[data]`
    ");
}

#[test]
fn parts_per_million_without_their_factor() {
    let ppm = model("[states.slope]", "[states.slope]\nunit = \"ppm\"");
    let folder = Folder::new(&[("m.toml", ppm.as_bytes())]);
    let asked = "state `slope` is in ppm, but the equation of measurement `y` multiplies it by a column without the \
                 factor 1e-6: is `1e-6 * slope` meant?";
    let said = shown(&folder.run("check m.toml"));
    assert!(said.contains(&format!("warning: {asked}")), "{said}");
    let said = shown(&folder.run("fit m.toml d.csv")).replace("\n    ", " ");
    assert!(said.contains("State `slope` is in ppm"), "{said}");
    // the product of all numbers counts: parts of thousandths, as where a rate in deg/s makes a column in mdeg/s
    for scaled in [
        "1e-6 * slope * x",
        "1e-3 * slope * x",
        "slope * (x / 1000) * 1e-3",
        "slope / 1000 * x",
        "(x - 20) * slope / 1e6",
    ] {
        folder.write("m.toml", ppm.replace("slope * x", scaled).as_bytes());
        let said = shown(&folder.run("check m.toml"));
        assert!(!said.contains("warning"), "{scaled}: {said}");
    }
    for whole in ["1e-6 * slope * (1e6 * x)", "slope * (x - 1e-6)", "2 * slope * x"] {
        folder.write("m.toml", ppm.replace("slope * x", whole).as_bytes());
        let said = shown(&folder.run("check m.toml"));
        assert!(said.contains("warning: state `slope` is in ppm"), "{whole}: {said}");
    }
}

#[test]
fn a_page_has_the_ending_of_a_page() {
    assert_snapshot!(refused("fit m.toml d.csv --report fit.pdf", &[]), @"
    error: the output `fit.pdf` would hold a page of HTML, which its ending does not say

    hint: name it `.html`, from which a browser prints a PDF: `--report` takes a file for the page, `--out` one for the results, as JSON
    ");
    assert_snapshot!(refused("report fit.json --out page.docx", &[("fit.json", "{}")]), @"
    error: the output `page.docx` would hold a page of HTML, which its ending does not say

    hint: name it `.html`: it is a page for a browser
    ");
}

#[test]
fn a_state_that_is_misspelt() {
    let misspelt = model("level + slope * x", "levle + slope * x");
    assert_snapshot!(refused("fit m.toml d.csv", &[("m.toml", &misspelt)]), @r#"
    error: d.csv has no column `levle`, which is used in `equation` of measurement `y`
      --> m.toml:9:13 | equation = "levle + slope * x"
                      |             ^^^^^ this column is not in the data

    hint: what is no state or parameter is a column: is state `level` meant?
    "#);
    let parameter = model("noise = 0.1", "noise = \"sigam\"") + "[parameters]\nsigma = 0.1\n";
    let parameter = parameter.replace("noise = \"sigam\"", "noise = \"sigma + 0 * sigam\"");
    assert_snapshot!(refused("fit m.toml d.csv", &[("m.toml", &parameter)]), @r#"
    error: d.csv has no column `sigam`, which is used in `noise` of measurement `y`
      --> m.toml:10:22 | noise = "sigma + 0 * sigam"
                       |                      ^^^^^ this column is not in the data

    hint: what is no state or parameter is a column: is parameter `sigma` meant?
    "#);
}

#[test]
fn columns_with_blanks_between() {
    let blanks = DATA.replace(',', "  ");
    assert_snapshot!(refused("fit m.toml d.txt", &[("d.txt", &blanks)]), @r#"
    error: d.txt has no column `id`, which is used in `test` of `[data]`
      --> m.toml:2:8 | test = "id"
                     |        ^^^^ this column is not in the data

    hint: its header is one name of 3 words: if blanks stand between columns, write commas in their place, for instance by `sed -E 's/^ +//; s/ +/,/g' data.txt > data.csv`
    "#);
}

#[test]
fn a_text_where_a_number_belongs() {
    let text = DATA.replace(",0,", ",placebo,").replace(",1,", ",drug,");
    let regression = model("slope * x", "slope") + "[mean.regression]\nlevel = [\"x\"]\n";
    assert_snapshot!(refused("fit m.toml d.csv", &[("m.toml", &regression), ("d.csv", &text)]), @"
    error: d.csv, row 2, column `x`: found `placebo`, expected a number

    hint: a regression takes numbers: write a column of 0 and 1 for `placebo`, or give the equation a state with `random = false` times `if(x == 'placebo', 1, 0)` in place of the regression; only a text for missing cells goes into `missing` of `[data]`
    ");
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", &text)]), @"
    error: d.csv, row 2, column `x`: found `placebo`, expected a number

    hint: a text is compared, as in `if(x == 'placebo', 1, 0)`; leave a missing cell empty, or add its text to `missing` of `[data]`
    ");
    let total = DATA.to_owned() + "c,Total,9\n";
    assert_snapshot!(refused("fit m.toml d.csv", &[("d.csv", &total)]), @"
    error: d.csv, row 11, column `x`: found `Total`, expected a number

    hint: the row seems to sum up others: remove it
    ");
}
