//! Where the time of a whole fit goes, what a second thread adds, and how long the command takes to start.

use std::hint::black_box;
use std::path::Path;

use super::clock;
use super::ensemble::PeerStudy;
use super::table::{figure, head, row, seconds};
use super::whole::{KalfitCommand, path};

/// Prints the tables.
pub(super) fn print(kalfit: &KalfitCommand) -> Result<(), String> {
    let start = kalfit.median(21, &["--version"])?;
    println!(
        "Start-up (`kalfit --version`): {} of a processor, {} elapsed.\n",
        seconds(start.processor),
        seconds(start.elapsed)
    );
    head(
        2,
        &[
            "tests",
            "from",
            "bytes alone",
            "reading (`check`)",
            "reduction and `.parquet`",
            "fit, noise known",
            "fit",
            "fit and fit.json",
        ],
    );
    let ensembles: Vec<_> = [10_000, 100_000]
        .into_iter()
        .map(|tests| Ok((tests, PeerStudy::Regression.draw(tests, kalfit)?)))
        .collect::<Result<_, String>>()?;
    for (tests, files) in &ensembles {
        for (from, file) in ["CSV", "Parquet"].iter().zip(files) {
            row(&[vec![tests.to_string(), (*from).to_owned()], stages(kalfit, file)?].concat());
        }
    }
    println!();
    head(1, &["tests", "one thread, elapsed", "two threads, elapsed", "ratio"]);
    for (tests, [csv, _]) in &ensembles {
        let [one, two] = threads(kalfit, csv)?;
        row(&[tests.to_string(), seconds(one), seconds(two), figure(one / two)]);
    }
    println!();
    Ok(())
}

/// Processor times, each that of a whole process that does more than the one before.
fn stages(kalfit: &KalfitCommand, file: &Path) -> Result<Vec<String>, String> {
    let model = PeerStudy::Regression.model();
    let (model, data) = (path(&model)?, path(file)?);
    let bytes = clock::repeated(|| {
        let bytes = std::fs::read(file).unwrap_or_default();
        black_box(bytes.iter().filter(|&&byte| byte == b'\n').count());
    })?;
    let known = ["--set", "sigma=0.5"];
    let runs: [Vec<&str>; 5] = [
        vec!["check", model, data],
        [&["reduce", model, data, "--threads", "1", "--out", "reductions.parquet"], &known[..]].concat(),
        [&["fit", model, data, "--threads", "1"], &known[..]].concat(),
        vec!["fit", model, data, "--threads", "1"],
        vec!["fit", model, data, "--threads", "1", "--out", "fit.json"],
    ];
    let mut cells = vec![seconds(bytes.processor)];
    for arguments in runs {
        cells.push(seconds(kalfit.median(5, &arguments)?.processor));
    }
    Ok(cells)
}

/// Least elapsed times of whole fits by one and by two threads, in turn: other work on the machine only ever adds.
fn threads(kalfit: &KalfitCommand, file: &Path) -> Result<[f64; 2], String> {
    let model = PeerStudy::Regression.model();
    let (model, data) = (path(&model)?, path(file)?);
    let mut least = [f64::INFINITY; 2];
    for _ in 0..7 {
        for (threads, least) in ["1", "2"].iter().zip(&mut least) {
            let taken = kalfit.run(&["fit", model, data, "--threads", threads, "--out", "fit.json"])?;
            *least = least.min(taken.elapsed);
        }
    }
    Ok(least)
}
