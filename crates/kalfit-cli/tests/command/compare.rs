//! `kalfit compare` through the built command.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use insta::assert_snapshot;
use kalfit_fixtures::near;
use serde_json::Value;

use crate::folder::{Folder, shown};

/// Random coefficients; the same without correlation, and without spread of the slope.
fn fitted() -> Folder {
    let folder = Folder::new(&[]);
    for path in ["sleepstudy.toml", "sleepstudy.csv"] {
        folder.copy(&format!("../../examples/random-coefficients/{path}"));
    }
    let model = std::fs::read_to_string(folder.path("sleepstudy.toml")).unwrap();
    let variants = [
        ("full", ""),
        ("apart", "\n[covariance]\nstructure = \"diagonal\"\n"),
        ("parallel", "\n[covariance]\nfixed = { \"slope, slope\" = 0 }\n"),
    ];
    for (name, added) in variants {
        folder.write(&format!("{name}.toml"), format!("{model}{added}").as_bytes());
        let output = folder.run(&format!("fit {name}.toml sleepstudy.csv --out {name}.json --quiet"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    }
    folder
}

#[test]
fn fits_stand_side_by_side_with_tests_of_one_within_another() {
    let folder = fitted();
    assert_snapshot!(shown(&folder.run("compare full.json apart.json parallel.json --out c.json")), @"
    exit 0
    ----- stdout
    3 fits to 18 tests with 180 measured values. The smallest AIC is that of
    apart.json.

    Likelihoods
      fit            log-likelihood  free  converged
      full.json          -875.96967     6        yes
      apart.json         -876.00163     5        yes
      parallel.json      -897.03932     4        yes

      fit                AIC   ΔAIC  weight      BIC   ΔBIC
      full.json      1763.94   1.94   0.275  1783.10   5.13
      apart.json     1762.00   0.00   0.725  1777.97   0.00
      parallel.json  1802.08  40.08   0.000  1814.85  36.88

    Predictions of tests left out
      fit            log density  below the best  std. error
      full.json        -881.7424           1.475        0.49
      apart.json       -880.2671               0           0
      parallel.json    -903.7976           23.53          11

    Nested fits
      hypothesis     within      -2 log λ  df  p-value
      apart.json     full.json   0.063911   1     0.80
      parallel.json  full.json     42.139   2  ≤ 7e-10
      parallel.json  apart.json    42.075   1  < 1e-10
      parallel.json within full.json: At the end of its range: covariance[slope,
        slope]; the p-value is an upper bound.
      parallel.json within apart.json: At the end of its range: covariance[slope,
        slope]; the p-value is an upper bound.

    What differs
                                    full.json  apart.json  parallel.json
      covariance[intercept, slope]     11.055     0 fixed        0 fixed
      covariance[slope, slope]         32.682      33.633        0 fixed

    How to read this
      Results files do not contain the data. Whether the fits used the same data is
        judged from the names of the tests and the numbers of measured values.
      AIC and BIC weigh the log-likelihood against the number of free parameters;
        smaller is better. The weights are Akaike weights among these fits.
      Tests left out: the sum over all tests of the log density of each, given the
        mean and covariance of the fit to the others. Parameters have their values
        from all tests, the one left out included, which flatters every free
        parameter. Here all fits have the same free parameters.
      Nested fits are listed where the results files show that they are. `kalfit
        test` also handles boundaries, and has a bootstrap.
    ----- stderr
    Wrote c.json
    ");
    let record: Value = serde_json::from_slice(&std::fs::read(folder.path("c.json")).unwrap()).unwrap();
    assert_eq!(record["schema"], "kalfit-compare/1");
    // lme4 on the same data: -875.9697 with 6 free, -876.0016 with 5; anova gives χ² = 0.0639 with 1, p = 0.8004
    let test = record["nested"].as_array().unwrap().iter().find(|test| test["null"] == 1).unwrap();
    near::absolute("-2 log λ", test["lr"].as_f64().unwrap(), 0.0639, 1e-4);
    near::absolute("p", test["p_value"].as_f64().unwrap(), 0.8004, 1e-4);
    assert_eq!((test["df"].as_u64(), test["p_value_kind"].as_str()), (Some(1), Some("large-sample")));
    // and `kalfit test` on the same hypothesis
    folder.write("null.toml", b"[covariance]\nstructure = \"diagonal\"\n");
    let output = folder.run("test full.toml sleepstudy.csv --null null.toml --out t.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let own: Value = serde_json::from_slice(&std::fs::read(folder.path("t.json")).unwrap()).unwrap();
    let difference = own["lr"].as_f64().unwrap() - test["lr"].as_f64().unwrap();
    assert!(difference.abs() < 1e-6, "{} against {}", own["lr"], test["lr"]);
}

#[test]
fn validations_stand_beside_each_other() {
    let folder = fitted();
    for (name, seed) in [("full", 3), ("apart", 3), ("parallel", 4)] {
        let args = format!("validate {name}.toml sleepstudy.csv --folds 6 --seed {seed} --out {name}-v.json --quiet");
        let output = folder.run(&args);
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    }
    let output =
        folder.run("validate full.toml sleepstudy.csv --folds 6 --seed 3 --against apart.toml --out both.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let read = |name: &str| -> Value { serde_json::from_slice(&std::fs::read(folder.path(name)).unwrap()).unwrap() };
    let compared = folder.run("compare full.json apart.json full-v.json apart-v.json --out c.json --quiet");
    assert!(compared.status.success(), "{}", shown(&compared));
    let (record, both) = (read("c.json"), read("both.json"));
    assert_eq!(record["fits"].as_array().map(Vec::len), Some(2));
    let [full, apart] = [&record["validated"][0], &record["validated"][1]];
    assert_eq!((&full["log_density"], &full["std_error"]), (&both["log_density"], &both["std_error"]));
    assert_eq!(apart["log_density"], both["against"]["log_density"]);
    // the one that predicts better is zero below itself, the other as much as `--against` says
    let of = |own: &Value, what: &str| own["difference"][what].as_f64().unwrap();
    let against = |what: &str| both["against"][what].as_f64().unwrap();
    let (best, other) = if against("difference") > 0.0 { (full, apart) } else { (apart, full) };
    assert_eq!(of(best, "difference"), 0.0);
    for (what, expected) in [("difference", against("difference").abs()), ("std_error", against("std_error"))] {
        let found = of(other, what);
        assert!((found - expected).abs() < 1e-9 * (1.0 + expected), "{what}: {found} against {expected}");
    }
    assert_snapshot!(shown(&folder.run("compare full-v.json apart-v.json parallel-v.json")), @"
    exit 0
    ----- stdout
    3 validations on 18 tests with 180 measured values.

    Predictions of folds left out
      validation       folds  log density  std. error  below the best
      full-v.json          6      -889.05          29          0.5641
      apart-v.json         6    -888.4859          29               0
      parallel-v.json      6    -910.8013          22               -

      validation       std. error of that  converged
      full-v.json                    0.46        yes
      apart-v.json                      0        yes
      parallel-v.json                   -        yes

    Notes
      `parallel-v.json` and `apart-v.json` did not predict the same values in the
        same folds, so their difference is not given. Give `kalfit validate` the
        same data and the same `--folds`, `--seed` or `--by`.

    How to read this
      Folds left out: the sum over all folds of the log density of their tests,
        given the fit to the other folds. Larger is better. A difference of more
        than two standard errors is unlikely to be chance.
    ----- stderr
    ");
    assert_snapshot!(shown(&folder.run("compare full.json full-v.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: found 1 of the results of a fit, expected two or more

    hint: name two or more files that `kalfit fit --out` wrote, or two or more of `kalfit validate --out`
    ");
}

#[test]
fn fits_of_other_data_and_files_that_are_no_fits_are_refused() {
    let folder = fitted();
    let data = std::fs::read_to_string(folder.path("sleepstudy.csv")).unwrap();
    let short: Vec<&str> = data.lines().take(data.lines().count() - 1).collect();
    folder.write("short.csv", short.join("\n").as_bytes());
    let output = folder.run("fit full.toml short.csv --out short.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    assert_snapshot!(shown(&folder.run("compare full.json short.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `full.json` and `short.json` are not fits of the same data: test `372` has 10 measured values against 9

    hint: likelihoods can be compared only for the same measured values: fit all models to the same data
    ");
    assert_snapshot!(shown(&folder.run("compare full.json full.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `full.json` is given twice

    hint: name each file once
    ");
    assert_snapshot!(shown(&folder.run("compare full.json full.toml")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `full.toml` is not a result of `kalfit fit`: it is not JSON (expected value at line 1 column 1)

    hint: `kalfit compare` takes what `kalfit fit --out` writes
    ");
    assert_snapshot!(shown(&folder.run("compare full.json none.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot read `none.json`: No such file or directory (os error 2)
    ");
    assert_snapshot!(shown(&folder.run("compare full.json apart.json --out full.json")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the output `full.json` is one of the inputs

    hint: give the output a name of its own
    ");
    let output = folder.run("fit full.toml sleepstudy.csv --criterion reml --out reml.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    assert_snapshot!(shown(&folder.run("compare full.json reml.json")), @"
    exit 0
    ----- stdout
    2 fits to 18 tests with 180 measured values. Their log-likelihoods cannot be
    compared: see the notes.

    Likelihoods
      fit        log-likelihood  free  converged  criterion
      full.json      -875.96967     6        yes         ml
      reml.json      -871.81414     6        yes       reml

      fit            AIC      BIC
      full.json  1763.94  1783.10
      reml.json  1755.63  1774.79

    Predictions of tests left out
      fit        log density  below the best  std. error
      full.json    -881.7424          0.3162         0.3
      reml.json    -881.4262               0           0

    Notes
      Some fits maximise the likelihood, others the restricted likelihood (REML):
        the two cannot be compared.

    How to read this
      Results files do not contain the data. Whether the fits used the same data is
        judged from the names of the tests and the numbers of measured values.
      Tests left out: the sum over all tests of the log density of each, given the
        mean and covariance of the fit to the others. Parameters have their values
        from all tests, the one left out included, which flatters every free
        parameter. Here all fits have the same free parameters.
    ----- stderr
    ");
}
