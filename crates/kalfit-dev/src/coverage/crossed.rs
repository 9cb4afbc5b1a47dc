//! Coverage of intervals where units meet stations: of the mean, of the spread of stations and of units.

use kalfit::estimate::{self, Criterion};
use kalfit::infer::{Choices, DeletionChoice, IntervalKind, TestsChoice};
use kalfit::record::{FitRecord, Interval};
use kalfit::{Alpha, Ensemble, Labels, Options, PhasedModel};
use kalfit_spec::Spec;
use rayon::prelude::*;

use super::drawn::rows;
use super::tally::IntervalTally;
use crate::seed::SEED;
use crate::setup;

/// Numbers of stations.
const STATIONS: [usize; 2] = [6, 12];
/// Units, and tests of each; the tests of a unit are on different stations.
const UNITS: (usize, usize) = (24, 4);
/// Mean, then the standard deviations of tests, units, stations, and of the noise of a test's rows.
const TRUTH: [f64; 5] = [250.0, 6.0, 12.0, 12.0, 10.0];
/// Rows of a test.
const ROWS: [f64; 4] = [0.0, 1.0, 2.0, 3.0];
/// Fits of each ensemble: name, criterion and kind of intervals.
const FITS: [(&str, Criterion, IntervalKind); 4] = [
    ("ML, Wald", Criterion::Ml, IntervalKind::Wald),
    ("ML, profile", Criterion::Ml, IntervalKind::Profile),
    ("REML, Wald", Criterion::Reml, IntervalKind::Wald),
    ("REML, profile", Criterion::Reml, IntervalKind::Profile),
];
/// The quantities with their true values.
const QUANTITIES: [(&str, f64); 4] = [
    ("mean", TRUTH[0]),
    ("std dev of tests", TRUTH[1]),
    ("std dev of units", TRUTH[2]),
    ("std dev of stations", TRUTH[3]),
];
const MODEL: &str = r#"
[data]
test = "test"
levels = ["unit"]
crossed = ["station"]
[states]
level = {}
[measurements.y]
column = "y"
equation = "level"
noise = 10
"#;

/// Prints the table of each number of stations, if the title holds `only`.
pub(super) fn run(ensembles: u64, only: &str) {
    let model = Spec::parse("set-up", MODEL).expect("a set-up is sound").model;
    for stations in STATIONS {
        let title = format!("Crossed: {} units of {} tests on {stations} stations", UNITS.0, UNITS.1);
        if !title.contains(only) {
            continue;
        }
        println!("{title}; {ensembles} ensembles\n");
        println!("| quantity | truth | {} |", FITS.map(|(name, ..)| name).join(" | "));
        println!("|---|---|---|---|---|---|");
        for ((name, truth), tallies) in QUANTITIES.into_iter().zip(tally(&model, stations, ensembles)) {
            println!("| {name} | {truth} | {} |", tallies.map(|tally| tally.shown(ensembles)).join(" | "));
        }
        println!();
    }
}

/// By quantity, of each of [`FITS`].
fn tally(model: &PhasedModel, stations: usize, ensembles: u64) -> [[IntervalTally; FITS.len()]; QUANTITIES.len()] {
    let design = design(model, stations);
    let alpha = Alpha::fixed(&model.shared().parameters).expect("the noise is known");
    let population = || setup::independent(&TRUTH[..1], &[], &[&TRUTH[1..2], &TRUTH[2..3], &TRUTH[3..4]]);
    let of_ensemble = |k: u64| {
        let drawn =
            design.draw(&alpha, population(), design.tests().len() as u64, SEED + k).expect("a set-up is sound");
        FITS.map(|(_, criterion, intervals)| intervals_of(&fit(&drawn, criterion, intervals)))
    };
    let each: Vec<[[Interval; QUANTITIES.len()]; FITS.len()]> =
        (0..ensembles).into_par_iter().map(of_ensemble).collect();
    let mut tallies = [[IntervalTally::default(); FITS.len()]; QUANTITIES.len()];
    for fits in &each {
        for (f, intervals) in fits.iter().enumerate() {
            for (q, interval) in intervals.iter().enumerate() {
                tallies[q][f].add(*interval, QUANTITIES[q].1);
            }
        }
    }
    tallies
}

/// The tests of the units on their stations, with a zero for every value that is drawn.
fn design(model: &PhasedModel, stations: usize) -> Ensemble {
    let shared = model.shared();
    let mut labels = Labels::new(&shared.literals);
    let mut all = Vec::new();
    for unit in 0..UNITS.0 {
        for test in 0..UNITS.1 {
            let station = (unit + test * (1 + unit / stations)) % stations;
            let names = [("unit", format!("u{unit}")), ("station", format!("s{station}"))];
            let text = |column: &kalfit::model::Column| {
                let (_, name) = names.iter().find(|(of, _)| *of == column.name).expect("it is one of the two");
                labels.intern(name)
            };
            let texts: Vec<kalfit::Label> = shared.text_columns.iter().map(text).collect();
            all.push(rows(model, &format!("u{unit}/{test}"), &ROWS, &texts));
        }
    }
    Ensemble::of_tests(model, labels, all)
}

fn fit(drawn: &Ensemble, criterion: Criterion, intervals: IntervalKind) -> FitRecord {
    let choices = Choices { intervals, deletion: DeletionChoice::None, tests: TestsChoice::None, ..Choices::default() };
    let mut options = Options { choices, innovations: false, ..Options::default() };
    options.settings.criterion = criterion;
    drawn.fit_with(&options, &mut estimate::Silent).expect("a legal problem").record
}

/// The intervals of the quantities; `None` where the fit has none, or is not certified.
fn intervals_of(record: &FitRecord) -> [Interval; QUANTITIES.len()] {
    if !record.converged {
        return [None; QUANTITIES.len()];
    }
    let of_level = |level: &kalfit::record::LevelRecord| level.std_dev.interval95[0];
    [
        record.phases[0].mean.interval95[0],
        of_level(&record.levels[1]),
        of_level(&record.levels[0]),
        of_level(&record.crossed[0].level),
    ]
}
