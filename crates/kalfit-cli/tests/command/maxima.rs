//! Ensembles whose likelihood has several maxima, saddles or edges in the dynamic parameters: where a search ended once, and where
//! the maximum is.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit::FitRecord;
use kalfit::record::ParameterRecord;

use crate::folder::{Folder, shown};

/// The fit of one of the models in `data/maxima` to its data; `changed`: parts of the model file in other words.
fn fitted(model: &str, data: &str, changed: &[(&str, &str)]) -> FitRecord {
    let folder = Folder::new(&[]);
    folder.copy(&format!("tests/data/maxima/{model}.toml"));
    folder.copy(&format!("tests/data/maxima/{data}.csv"));
    let mut text = std::fs::read_to_string(folder.path(&format!("{model}.toml"))).unwrap();
    for (from, to) in changed {
        assert!(text.contains(from), "{model}: `{from}`");
        text = text.replace(from, to);
    }
    folder.write("model.toml", text.as_bytes());
    let output = folder.run(&format!("fit model.toml {data}.csv --no-tests --out fit.json"));
    assert_eq!(output.status.code(), Some(0), "{model}: {}", shown(&output));
    serde_json::from_slice(&std::fs::read(folder.path("fit.json")).unwrap()).unwrap()
}

fn parameter<'a>(record: &'a FitRecord, name: &str, level: Option<&str>) -> &'a ParameterRecord {
    let named = |p: &&ParameterRecord| p.name == name && p.level.as_deref() == level;
    record.parameters.iter().find(named).unwrap()
}

fn reaches(record: &FitRecord, what: &str, highest: f64) {
    let found = record.log_likelihood;
    assert!(record.converged, "{what}: {}", record.reason);
    assert!((found - highest).abs() < 2e-6, "{what}: found {found:.6}, the maximum is {highest:.6}");
}

#[test]
fn a_noise_level_is_not_lost_to_zero() {
    // other starts of the same program, and of others, end here
    let known = [
        ("two-noises-2", -62.918080),
        ("integral-10", -61.439531),
        ("discrete2-0", -75.939069),
        ("discrete2-4", -40.742504),
    ];
    for (name, highest) in known {
        reaches(&fitted(name, name, &[]), name, highest);
        reaches(&fitted(&format!("{name}-given"), name, &[]), &format!("{name} from given starts"), highest);
    }
}

#[test]
fn an_end_on_its_way_along_a_ridge_is_taken_up_again() {
    // two starts climb on while the third process becomes slower and larger, and end without a certificate above the one that has it
    reaches(&fitted("three-processes", "three-processes", &[]), "three processes", -142.321258);
}

#[test]
fn two_processes_explain_what_the_other_one_did() {
    // of two instruments one reads only the first process; where the search ends without start values, the slow one is the first
    reaches(&fitted("processes-exchanged", "processes-exchanged", &[]), "no starts", -171.319242);
    let exchanged = [("tau0 = {}", "tau0 = { start = 10.9 }"), ("tau1 = {}", "tau1 = { start = 0.37 }")];
    reaches(&fitted("processes-exchanged", "processes-exchanged", &exchanged), "the other way round", -171.319242);
}

#[test]
fn both_time_constants_of_two_processes_are_longer() {
    let lower = [
        ("tau0 = {}", "tau0 = { start = 16.5 }"),
        ("s0 = {}", "s0 = { start = 0.86 }"),
        ("tau1 = {}", "tau1 = { start = 0.94 }"),
        ("s1 = {}", "s1 = { start = 0.103 }"),
        ("\ns = {}", "\ns = { start = 0.22 }"),
    ];
    reaches(&fitted("processes-longer", "processes-longer", &[]), "no starts", -145.366035);
    reaches(&fitted("processes-longer", "processes-longer", &lower), "at another maximum", -145.366035);
}

#[test]
fn a_process_that_has_become_white_is_given_to_the_noise() {
    // two instruments read the first process, which stood for the noise of one of them while the second one explained all else
    let truth = [
        ("tau0 = {}", "tau0 = { start = 16.79 }"),
        ("tau1 = {}", "tau1 = { start = 1.136 }"),
        ("s1 = {}", "s1 = { start = 0.2546 }"),
        ("\ns = {}", "\ns = { start = 0.3519 }"),
        ("r = {}", "r = { start = 0.3 }"),
    ];
    let found = fitted("processes-white", "processes-white", &[]);
    reaches(&found, "no starts", -174.243078);
    assert!(found.notes.iter().any(|note| note.contains("several processes are free")), "{:?}", found.notes);
    reaches(&fitted("processes-white", "processes-white", &truth), "the values it was drawn with", -174.243078);
}

#[test]
fn a_level_that_cannot_be_zero_comes_as_near_to_it_as_counts() {
    let starts =
        [("s0 = {}", "s0 = { start = 0.3 }"), ("\ns = {}", "\ns = { start = 0.5 }"), ("r = {}", "r = { start = 0.3 }")];
    let found = fitted("level-nearer-zero", "level-nearer-zero", &starts);
    reaches(&found, "from far above zero", 29.440699);
    assert_eq!(parameter(&found, "s", None).standing.as_deref(), Some("lower"));
}

#[test]
fn a_noise_returns_together_with_its_covariance() {
    // with s at zero c has no effect, and ℓ has a slope in s only beside the c that belongs to it
    let highest = fitted("noises-crossed", "noises-crossed", &[]).log_likelihood;
    let given = [
        ("tau0 = {}", "tau0 = { start = 0.48 }"),
        ("s0 = {}", "s0 = { start = 0.6 }"),
        ("c = {}", "c = { start = 0 }"),
    ];
    for level in ["0.05", "0.00001"] {
        let start = format!("s = {{ start = {level} }}");
        let found = fitted(
            "noises-crossed",
            "noises-crossed",
            &[&given[..], &[("\ns = {}", &format!("\n{start}")), ("r = {}", "r = { start = 0.05 }")]].concat(),
        );
        reaches(&found, &start, highest);
        assert!(parameter(&found, "s", None).estimate > 0.01, "{:?}", parameter(&found, "s", None));
    }
}

#[test]
fn every_start_ends_at_the_same_maximum_of_a_coupled_stationary_process() {
    let own = fitted("stationary-coupled", "stationary-coupled", &[]);
    let given = fitted("stationary-coupled", "stationary-coupled", &[("s = {}", "s = { start = 0.3 }")]);
    reaches(&own, "own start", given.log_likelihood);
    assert!(parameter(&own, "s", None).estimate > 0.01, "{:?}", parameter(&own, "s", None));
}

#[test]
fn a_standard_deviation_of_zero_is_left_where_its_correlation_lets_the_likelihood_rise() {
    // lme4 (optimiser tightened) gives 132.103721 for sites within wafers
    let found = fitted("wafer", "wafer", &[]);
    reaches(&found, "wafers", 132.103721);
    for name in ["sd0", "sd1"] {
        assert!(parameter(&found, name, None).estimate > 0.0, "{:?}", parameter(&found, name, None));
    }
    assert_eq!(parameter(&found, "rho", None).standing.as_deref(), Some("upper"));
}

#[test]
fn the_edge_of_what_a_noise_covariance_may_be_is_named() {
    let found = fitted("covariance-boundary", "covariance-boundary", &[]);
    assert!(found.converged, "{}", found.reason);
    let edge = parameter(&found, "s", Some("B"));
    assert_eq!((edge.standing.as_deref(), edge.at_bound, edge.std_error), (Some("edge"), true, None));
    assert!(found.notes.iter().any(|note| note.contains("at the largest possible covariance")), "{:?}", found.notes);
}

#[test]
fn a_covariance_of_motion_is_sought_within_its_cone() {
    let found = fitted("matrices-process", "matrices-process", &[]);
    assert!(found.converged, "{}", found.reason);
    let vanishing = parameter(&found, "s2", None);
    assert_eq!((vanishing.standing.as_deref(), vanishing.at_bound), (Some("lower"), true));
    let (qa, qab) = (parameter(&found, "qa", None).estimate, parameter(&found, "qab", None));
    assert!(qab.estimate.abs() < 0.6 * qa && qab.std_error.is_some(), "{qab:?} beside {qa}");
    // starts that would not be positive semidefinite are brought inside
    let far = fitted("matrices-process", "matrices-process", &[("qab = { start = 0 }", "qab = { start = 5 }")]);
    reaches(&far, "a start outside the cone", found.log_likelihood);
}

/// What a held mean costs is asked of the values of α that move: here none does.
#[test]
fn a_held_mean_stands_beside_a_parameter_at_its_bound() {
    let model = "[data]\ntest = \"test\"\n[states.a]\n[measurements.y]\ncolumn = \"y\"\nequation = \"a + g\"\nnoise = 1\n\
                 [parameters]\ng = { lower = 5, upper = 9 }\n[mean]\nfixed = { a = 0 }\n";
    let mut data = "test,y\n".to_owned();
    for j in 0..8 {
        (0..4).for_each(|k| data.push_str(&format!("x{j},{}\n", 3.0 + f64::from((j * 5 + k * 3) % 7 - 3) / 3.0)));
    }
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
    let output = folder.run("fit m.toml d.csv --out fit.json");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let record: FitRecord = serde_json::from_slice(&std::fs::read(folder.path("fit.json")).unwrap()).unwrap();
    assert_eq!(parameter(&record, "g", None).estimate, 5.0);
    assert!(record.constraints[0].sensitivity.unwrap() < 0.0, "{:?}", record.constraints[0]);
}

#[test]
fn a_process_of_known_size_finds_its_time_constant() {
    // a slow process and more noise, or a white one and none, are lower maxima
    reaches(&fitted("known-size", "known-size", &[]), "300 rows", -394.331562);
    reaches(&fitted("known-size", "known-size-short", &[]), "48 rows", -61.065308);
}

#[test]
fn a_factor_of_a_deviation_and_of_a_covariance_has_a_sign() {
    let record = fitted("one-shock", "one-shock", &[]);
    reaches(&record, "one shock", -317.769093);
    assert!((parameter(&record, "theta", None).estimate + 0.247_970_8).abs() < 1e-4);
    reaches(
        &fitted("one-shock", "one-shock", &[("theta = {}", "theta = { start = -0.2, lower = -5 }")]),
        "given",
        -317.769093,
    );
}
