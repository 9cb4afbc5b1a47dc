//! Entries compared with numbers computed by hand.

use nalgebra::DMatrix;

use crate::datasheet::{Source, datasheet};
use kalfit_apply::export::ExportError;
use kalfit_model::build::{constant, fixed, gauss_markov, gauss_markov_2, measurement, name, random_walk, stepping};
use kalfit_model::{Alpha, Model, PhasedModel, Population};
use kalfit_record::{DatasheetRecord, EntryRecord};

fn model() -> PhasedModel {
    let sum = name("bias") + name("walk") + name("drift") + name("slow") + name("jumps");
    Model::builder("gyro")
        .time("t")
        .time_unit("s")
        .state(constant("bias").unit("deg/s"))
        .state(constant("scale").unit("ppm"))
        .state(random_walk("walk", 0.002).unit("deg/s").known(0.0, 0.0))
        .state(gauss_markov("drift", name("tau"), name("sigma")).unit("deg/s"))
        .state(gauss_markov_2("slow", 50.0, 0.25).unit("deg/s"))
        .state(stepping("jumps", 0.5 * name("jumps"), 0.3).unit("deg/s").known(0.0, 0.0))
        .measurement(measurement("y", sum + 1e-6 * name("rate") * name("scale"), 0.01))
        .measurement(measurement("z", name("bias"), name("noise") * name("warmth")))
        .parameter(fixed("tau", 20.0))
        .parameter(fixed("sigma", 0.4))
        .parameter(fixed("noise", 0.1))
        .build()
        .expect("it is sound")
}

fn made(step: Option<f64>, at: &[(&str, &str)]) -> Result<DatasheetRecord, ExportError> {
    let model = model();
    let alpha = Alpha::fixed(&model.shared().parameters).expect("all are known");
    let covariance = DMatrix::from_diagonal(&nalgebra::DVector::from_vec(vec![0.04, 2500.0]));
    let population = Population { mean: vec![0.5, 100.0], coefficients: vec![], covariance };
    let at: Vec<(String, String)> = at.iter().map(|(c, v)| ((*c).to_owned(), (*v).to_owned())).collect();
    datasheet(&model, &alpha, &population, &Source { name: "m".to_owned(), record: None, step, at: &at, tests: None })
}

fn entry<'a>(sheet: &'a DatasheetRecord, name: &str, of: &str) -> &'a EntryRecord {
    let found = sheet.entries.iter().find(|entry| entry.name == name && entry.of == of);
    found.unwrap_or_else(|| panic!("no {name} of {of} in {:#?}", sheet.entries))
}

#[test]
fn numbers_are_those_of_the_model_in_units_of_datasheets() {
    let sheet = made(Some(0.25), &[("warmth", "2")]).expect("it has numbers");
    let cases = [
        ("angle random walk", "y", 0.01 * 0.5 * 60.0, "deg/sqrt(h)"),
        ("angle random walk", "z", 0.2 * 0.5 * 60.0, "deg/sqrt(h)"),
        ("rate random walk", "walk", 0.002 * 3600.0 * 60.0, "deg/h/sqrt(h)"),
        ("Gauss-Markov sigma", "drift", 0.4 * 3600.0, "deg/h"),
        ("Gauss-Markov time constant", "drift", 20.0, "s"),
        ("Gauss-Markov sigma", "slow", 0.25 * 3600.0, "deg/h"),
        ("Gauss-Markov time constant", "slow", 50.0, "s"),
        ("Gauss-Markov sigma", "jumps", 0.3 / 0.75_f64.sqrt() * 3600.0, "deg/h"),
        ("Gauss-Markov time constant", "jumps", 0.25 / 2.0_f64.ln(), "s"),
        ("turn-on mean", "bias", 1800.0, "deg/h"),
        ("turn-on repeatability", "bias", 720.0, "deg/h"),
        ("scale factor mean", "scale", 100.0, "ppm"),
        ("scale factor repeatability", "scale", 50.0, "ppm"),
    ];
    for (name, of, expected, unit) in cases {
        let found = entry(&sheet, name, of);
        let value = found.value.unwrap_or(f64::NAN);
        println!("{name} of {of}: {value} against {expected}");
        assert!((value - expected).abs() < 1e-9 * expected, "{name} of {of}: {value} against {expected}");
        assert_eq!(found.unit.as_deref(), Some(unit), "{name} of {of}");
    }
    assert_eq!(sheet.entries.len(), cases.len(), "{:#?}", sheet.entries);
    assert_eq!(entry(&sheet, "Gauss-Markov sigma", "drift").from, ["sigma"]);
    assert_eq!(entry(&sheet, "Gauss-Markov time constant", "drift").from, ["tau"]);
    let curve = &sheet.allan[0];
    assert_eq!((curve.zero.as_slice(), curve.points.len()), (&["rate".to_owned()][..], 16));
    assert!(curve.points.iter().all(|point| point.model.is_some_and(|x| x > 0.0)));
}

#[test]
fn what_differs_from_row_to_row_is_said() {
    let sheet = made(Some(0.25), &[]).expect("it has numbers");
    let noise = entry(&sheet, "angle random walk", "z");
    assert_eq!((noise.value, noise.varies_with.as_slice()), (None, &["warmth".to_owned()][..]));
    assert!(sheet.allan[0].notes[0].contains("column `warmth`"), "{:?}", sheet.allan[0].notes);
    let sheet = made(None, &[("warmth", "2")]).expect("it has numbers");
    assert_eq!(entry(&sheet, "angle random walk", "y").varies_with, ["step"]);
    assert_eq!(sheet.allan[0].notes, ["there is no curve without a step: give data or `--step`"]);
}

#[test]
fn bad_wishes_are_refused() {
    assert!(matches!(made(Some(-1.0), &[]), Err(ExportError::BadStep { .. })));
    assert!(matches!(made(Some(1.0), &[("nothing", "1")]), Err(ExportError::NoEffect { .. })));
    assert!(matches!(made(Some(1.0), &[("warmth", "hot")]), Err(ExportError::NotANumber { .. })));
}
