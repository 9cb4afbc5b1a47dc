//! `kalfit plot`.

use crate::folder::{Folder, shown};
use insta::assert_snapshot;

/// Forty rows of each of eight units, half a second apart.
const TIMED: &str = r#"
title = "Records"
[data]
test = "unit"
time = "t"
time_unit = "s"
[states.bias]
unit = "deg/h"
[states.scale]
[states.walk]
process = "random-walk"
noise_density = 0.3
initial = { mean = 0, sigma = 0 }
[measurements.rate]
column = "rate"
equation = "bias + scale * u + walk"
noise = 0.5
"#;

fn timed() -> Folder {
    let mut data = "unit,t,u,rate\n".to_owned();
    for unit in 0..8 {
        for k in 0..40 {
            let (t, u) = (0.5 * f64::from(k), f64::from(k % 5) - 2.0);
            let wobble = f64::from((unit * 17 + k * 29) % 23) / 23.0 - 0.5;
            let rate = f64::from(unit) - 3.0 + u * (1.0 + 0.2 * f64::from((unit * 5) % 7)) + wobble;
            data += &format!("u<{unit}>,{t},{u},{rate}\n");
        }
    }
    let folder = Folder::new(&[("timed.toml", TIMED.as_bytes()), ("timed.csv", data.as_bytes())]);
    let fitted = folder.run("fit timed.toml timed.csv -q -o fit.json --deletion all");
    assert_eq!(shown(&fitted), "exit 0\n----- stdout\n----- stderr\n");
    folder
}

fn drawn(folder: &Folder, options: &str, name: &str) -> String {
    let done = folder.run(&format!("plot fit.json {options} --out {name}"));
    assert_eq!(shown(&done), format!("exit 0\n----- stdout\n----- stderr\nWrote {name}\n"));
    String::from_utf8_lossy(&std::fs::read(folder.path(name)).unwrap_or_default()).into_owned()
}

#[test]
fn every_figure_has_what_it_is_about() {
    let folder = timed();
    let records = "timed.csv --what records --model timed.toml --test u<3>";
    let cases = [
        ("--what forest", &["Records", "95 % intervals", "mean [deg/h]", "standard deviation", "bias", "scale"][..], 4),
        ("--what ellipses", &["Population (50 % and 95 %)", "bias [deg/h]", "scale"], 8),
        ("--what influence", &["Cook's displacement", "u&lt;7&gt;", "50 % confidence region"], 0),
        (records, &["Test u&lt;3&gt; of 8", "rate", "innovations / standard deviation", "time [s]"], 80),
    ];
    let of_data = |what: &str| format!("timed.csv --what {what} --model timed.toml");
    let [residuals, quantiles, allan] = ["residuals", "quantiles", "allan"].map(of_data);
    let more = [
        (residuals.as_str(), &["Test u&lt;", "over their standard deviations", "rate", "time [s]"][..], 40),
        (&quantiles, &["innovations against the quantiles", "quantile of the normal law"], 40),
        (&allan, &["Allan deviation", "averaging time [s]", "rate"], 5),
    ];
    for (options, words, dots) in cases.into_iter().chain(more) {
        let figure = drawn(&folder, options, "f.svg");
        assert!(figure.starts_with("<svg ") && figure.ends_with("</svg>\n"), "{options} is not whole");
        for word in words {
            assert!(figure.contains(word), "{options} lacks {word}");
        }
        assert_eq!(figure.matches("<circle").count(), dots, "dots of {options}");
        assert!(!figure.contains("u<"), "names of {options} are text");
        assert!(!figure.contains("NaN") && !figure.contains("inf"), "{options} has places that are no numbers");
    }
}

#[test]
fn candidates_of_a_plan_are_drawn_by_their_sensitivities() {
    let folder = timed();
    let planned = folder.run("plan timed.toml --from fit.json --candidates timed.csv --budget 5 --out plan.json -q");
    assert_eq!(planned.status.code(), Some(0), "{}", shown(&planned));
    let done = folder.run("plot plan.json --what sensitivities --out s.svg");
    assert_eq!(done.status.code(), Some(0), "{}", shown(&done));
    let figure = std::fs::read_to_string(folder.path("s.svg")).unwrap_or_default();
    for word in ["candidates", "5 × u&lt;", "Orange:", "room for more"] {
        assert!(figure.contains(word), "it lacks {word}");
    }
    let refused = shown(&folder.run("plot fit.json --what sensitivities --out s.svg"));
    assert!(refused.contains("the schema is `kalfit-fit/1`"), "{refused}");
}

#[test]
fn a_png_has_two_pixels_in_a_point() {
    let folder = timed();
    drawn(&folder, "--width 500", "f.png");
    let bytes = std::fs::read(folder.path("f.png")).unwrap_or_default();
    assert!(bytes.starts_with(b"\x89PNG\r\n\x1a\n") && bytes.len() > 5000, "{} bytes", bytes.len());
    let width = u32::from_be_bytes(bytes[16..20].try_into().expect("four bytes"));
    assert_eq!(width, 1000);
}

#[test]
fn what_cannot_be_drawn_is_refused() {
    let folder = timed();
    assert_eq!(folder.run("fit timed.toml timed.csv -q -o few.json --deletion none").status.code(), Some(0));
    let all: Vec<String> = [
        "plot fit.json --out forest.gif",
        "plot fit.json --what records --out f.svg",
        "plot fit.json timed.csv --out f.svg",
        "plot few.json --what influence --out f.svg",
        "plot fit.json timed.csv --what records --model timed.toml --test nobody --out f.svg",
        "plot fit.json timed.csv --what records --model timed.toml --out timed.csv.svg --width 10",
        "plot timed.toml --out f.svg",
    ]
    .iter()
    .map(|line| format!("$ kalfit {line}\n{}", shown(&folder.run(line))))
    .collect();
    assert_snapshot!(all.join("\n"), @"
    $ kalfit plot fit.json --out forest.gif
    exit 2
    ----- stdout
    ----- stderr
    error: the output `forest.gif` would hold a figure, which its ending does not say

    hint: name it `.svg`, `.pdf` or `.png`

    $ kalfit plot fit.json --what records --out f.svg
    exit 2
    ----- stdout
    ----- stderr
    error: this figure needs the model and the data, which the results do not contain

    hint: write `kalfit plot fit.json data.csv --what records --model model.toml --out records.svg`

    $ kalfit plot fit.json timed.csv --out f.svg
    exit 2
    ----- stdout
    ----- stderr
    error: `--model`, `--test` and data go with `--what records`, `residuals`, `quantiles` and `allan` only

    hint: leave them out: other figures are drawn from the results alone

    $ kalfit plot few.json --what influence --out f.svg
    exit 2
    ----- stdout
    ----- stderr
    error: the results have nothing for this figure: the fit was not repeated without each test; `kalfit fit --deletion all` does that

    $ kalfit plot fit.json timed.csv --what records --model timed.toml --test nobody --out f.svg
    exit 2
    ----- stdout
    ----- stderr
    error: test `nobody` is not among those that can be drawn: u<3>, u<2>, u<6>, u<5>, u<1>, u<0>, u<4> and u<7>

    $ kalfit plot fit.json timed.csv --what records --model timed.toml --out timed.csv.svg --width 10
    exit 2
    ----- stdout
    ----- stderr
    error: invalid value '10' for '--width <POINTS>': 10 is not in 300..=3000

    For more information, try '--help'.

    $ kalfit plot timed.toml --out f.svg
    exit 2
    ----- stdout
    ----- stderr
    error: `timed.toml` is not a result of `kalfit fit`: it is not JSON (expected ident at line 2 column 2)

    hint: give a file that `kalfit fit --out` wrote
    ");
    assert!(!folder.path("f.svg").exists());
}
