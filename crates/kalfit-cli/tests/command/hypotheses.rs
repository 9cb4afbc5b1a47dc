//! `kalfit test`: hypotheses within a model.

use crate::folder::{Folder, shown};
use insta::assert_snapshot;
use kalfit::record::RatioRecord;
use serde_json::Value;

const MEAN: &str = "title = \"no effect at the equator\"\n[mean]\nfixed = { effect = 0 }\n";
const VARIANCE: &str = "[covariance]\nfixed = { \"effect, effect\" = 0 }\n";
const BOTH: &str = "[mean]\nfixed = { effect = 0 }\n[covariance]\nfixed = { \"effect, effect\" = 0 }\n";

/// The vaccine trials, with a hypothesis `h.toml`.
fn trials(hypothesis: &str) -> Folder {
    let folder = Folder::new(&[("h.toml", hypothesis.as_bytes())]);
    folder.copy("tests/data/vaccine.toml");
    folder.copy("tests/data/vaccine.csv");
    folder
}

fn test(hypothesis: &str, options: &str) -> String {
    shown(&trials(hypothesis).run(&format!("test vaccine.toml vaccine.csv --null h.toml {options}")))
}

fn json(hypothesis: &str, options: &str) -> (String, Value) {
    let folder = trials(hypothesis);
    let text = shown(&folder.run(&format!("test vaccine.toml vaccine.csv --null h.toml --out t.json {options}")));
    let json = std::fs::read_to_string(folder.path("t.json")).unwrap_or_else(|error| panic!("{error}\n{text}"));
    (text, serde_json::from_str(&json).expect("test.json is JSON"))
}

/// A command that must be refused, with nothing written.
fn refused(args: &str, files: &[(&str, &str)]) -> String {
    let folder = trials(MEAN);
    files.iter().for_each(|(name, text)| folder.write(name, text.as_bytes()));
    let before = folder.contents();
    let output = folder.run(args);
    assert_eq!(output.status.code(), Some(2), "{}", shown(&output));
    assert_eq!(before, folder.contents(), "`kalfit {args}` left the folder as it was");
    shown(&output)
}

fn refused_hypothesis(hypothesis: &str) -> String {
    refused("test vaccine.toml vaccine.csv --null h.toml --out t.json", &[("h.toml", hypothesis)])
}

#[test]
fn a_mean_is_tested_against_chi_squared() {
    assert_snapshot!(test(MEAN, ""), @"
    exit 0
    ----- stdout
    BCG vaccine against tuberculosis, log risk ratios

    Hypothesis: no effect at the equator
    The data do not contradict the hypothesis: p = 0.35 by the bootstrap.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis       -8.450369     2  20.90        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 1.52941
      reference distribution                p-value
      χ²(1)                                    0.22
      F(1, 5.89) = 0.9642 by Kenward and       0.36
      Roger, for few tests
      bootstrap of 999, seed 1 (± 0.015)       0.35
    ----- stderr
    ");
}

#[test]
fn a_variance_of_zero_is_tested_against_a_mixture() {
    assert_snapshot!(test(VARIANCE, "--out t.json"), @"
    exit 0
    ----- stdout
    BCG vaccine against tuberculosis, log risk ratios

    Hypothesis: h.toml
    The data contradict the hypothesis: p = 0.003 by the bootstrap.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis      -9.4736109     2  22.95        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 3.57589
      reference distribution               p-value
      0.5 χ²(0) + 0.5 χ²(1)                   0.03
      χ²(1), which ignores the boundary       0.06
      bootstrap of 999, seed 1 (± 0.0017)    0.003
    ----- stderr
    Wrote t.json
    ");
}

#[test]
fn mean_and_covariance_are_also_tested_apart() {
    assert_snapshot!(test(BOTH, ""), @"
    exit 0
    ----- stdout
    BCG vaccine against tuberculosis, log risk ratios

    Hypothesis: h.toml
    The data contradict the hypothesis: p = 0.001 by the bootstrap.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis      -18.458109     1  38.92        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 21.5449
      reference distribution              p-value
      0.5 χ²(1) + 0.5 χ²(2)                  1e-5
      χ²(2), which ignores the boundary      2e-5
      bootstrap of 999, seed 1 (± 0.001)    0.001
      No draw was as extreme as the data: with more draws the p-value may be
        smaller.

    Mean and covariance separately
      hypothesis on     -2 log λ  df  p-value
      mean alone          1.5294   1     0.22
      covariance alone    3.5759   1     0.03
      both                21.545   2     1e-5
    ----- stderr
    ");
}

#[test]
fn a_hypothesis_without_a_regression_is_within_the_model() {
    assert_snapshot!(test("[mean]\nregression = {}\n", ""), @"
    exit 0
    ----- stdout
    BCG vaccine against tuberculosis, log risk ratios

    Hypothesis: h.toml
    The data contradict the hypothesis: p = 0.008 by the bootstrap.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis      -12.665076     2  29.33        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 9.95882
      reference distribution                p-value
      χ²(1)                                   0.002
      F(1, 6.5) = 15.34 by Kenward and        0.007
      Roger, for few tests
      bootstrap of 999, seed 1 (± 0.0028)     0.008
    ----- stderr
    ");
}

#[test]
fn few_tests_draw_ensembles_without_being_asked() {
    let (_, found) = json(BOTH, "");
    assert_eq!((&found["bootstrap"]["replicates"], &found["bootstrap"]["seed"]), (&999.into(), &1.into()));
    let (_, none) = json(BOTH, "--bootstrap 0");
    assert!(none["bootstrap"].is_null());
}

#[test]
fn the_bootstrap_draws_the_same_on_any_number_of_threads() {
    let (text, one) = json(BOTH, "--bootstrap 60 --seed 7 --threads 1");
    assert_snapshot!(text, @"
    exit 0
    ----- stdout
    BCG vaccine against tuberculosis, log risk ratios

    Hypothesis: h.toml
    The data contradict the hypothesis: p = 0.02 by the bootstrap.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis      -18.458109     1  38.92        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 21.5449
      reference distribution             p-value
      0.5 χ²(1) + 0.5 χ²(2)                 1e-5
      χ²(2), which ignores the boundary     2e-5
      bootstrap of 60, seed 7 (± 0.016)     0.02
      No draw was as extreme as the data: with more draws the p-value may be
        smaller.

    Mean and covariance separately
      hypothesis on     -2 log λ  df  p-value
      mean alone          1.5294   1     0.22
      covariance alone    3.5759   1     0.03
      both                21.545   2     1e-5
    ----- stderr
    Wrote t.json
    ");
    for threads in [2, 3] {
        let (_, more) = json(BOTH, &format!("--bootstrap 60 --seed 7 --threads {threads}"));
        assert_eq!(one.to_string(), more.to_string(), "{threads} threads");
    }
    let (_, other) = json(BOTH, "--bootstrap 60 --seed 8");
    assert_ne!(one["bootstrap"], other["bootstrap"], "another seed draws others");
    let (_, unsaid) = json(BOTH, "--bootstrap 60");
    assert_eq!(unsaid["bootstrap"]["seed"], 1, "the default seed");
}

#[test]
fn results_are_written_with_the_keys_of_the_schema() {
    let (_, found) = json(VARIANCE, "--bootstrap 20 --quiet");
    let keys: Vec<&str> = found.as_object().expect("an object").keys().map(String::as_str).collect();
    assert_snapshot!(keys.join(" "), @"alternative bootstrap converged data df hypothesis kalfit_version law law_is_bound lr mixture model_digest notes null null_digest p_chi2_df p_mixture p_value parts schema title");
    assert_eq!(found["schema"], "kalfit-test/1");
    assert_eq!(found["hypothesis"], "h.toml", "a hypothesis without a title has the name of its file");
    assert_eq!(found["mixture"], "0.5 chi2_0; 0.5 chi2_1");
    assert_eq!(found["law"], serde_json::json!([{"df": 0, "weight": 0.5}, {"df": 1, "weight": 0.5}]));
    let keys = |of: &Value| of.as_object().expect("an object").keys().cloned().collect::<Vec<_>>().join(" ");
    assert_snapshot!(keys(&found["bootstrap"]), @"failed p_value quantile95 replicates seed std_error");
    assert_snapshot!(keys(&found["null"]), @"converged covariance free_parameters log_likelihood mean parameters states");
    assert_eq!(found["null"]["covariance"], serde_json::json!([[0.0]]));
    let record: RatioRecord = serde_json::from_value(found.clone()).expect("it is a record: no number in it is null");
    let by_hand = 2.0 * (record.alternative.log_likelihood - record.null.log_likelihood);
    assert!((record.lr - by_hand).abs() < 1e-12, "lr {} beside {by_hand}", record.lr);
    assert_eq!(record.p_mixture, Some(record.p_value));
    assert!((record.p_value - 0.5 * record.p_chi2_df).abs() < 1e-15, "half of χ²(1): {record:?}");
    let (_, titled) = json(MEAN, "");
    assert_eq!(titled["hypothesis"], "no effect at the equator");
    assert_eq!(titled["mixture"], Value::Null);
}

/// What a test says of the model is what a fit of it says, and -2 log λ is the difference of two fits.
#[test]
fn both_sides_are_those_of_two_fits() {
    let folder = trials(BOTH);
    let restricted = std::fs::read_to_string(folder.path("vaccine.toml")).expect("the model is there");
    let restricted = restricted.replace("[mean.regression]", "[mean.fixed]\neffect = 0\n[mean.regression]");
    folder.write("null.toml", (restricted + "[covariance]\nfixed = { \"effect, effect\" = 0 }\n").as_bytes());
    let log_likelihood = |model: &str| {
        let output = folder.run(&format!("fit {model} vaccine.csv --out fit.json --quiet"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        let text = std::fs::read_to_string(folder.path("fit.json")).expect("fit.json is written");
        serde_json::from_str::<Value>(&text).expect("fit.json is JSON")["log_likelihood"].as_f64().expect("a number")
    };
    let expected = 2.0 * (log_likelihood("vaccine.toml") - log_likelihood("null.toml"));
    let found = json(BOTH, "").1["lr"].as_f64().expect("a number");
    assert!((found - expected).abs() < 1e-8, "found {found}, expected {expected}");
}

#[test]
fn a_set_parameter_is_set_on_both_sides() {
    let folder = Folder::new(&[("h.toml", b"[mean]\nfixed = { bias = 0.5 }\n")]);
    folder.copy("tests/data/gyro.toml");
    folder.copy("tests/data/gyro.csv");
    let test = |options: &str| shown(&folder.run(&format!("test gyro.toml gyro.csv --null h.toml {options}")));
    // the keys of the hypothesis replace those of the model, which fixes the mean of scale
    assert_snapshot!(test("--set tau=200"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot test this hypothesis: the hypothesis allows means that the model does not

    hint: keys of the hypothesis replace the model's whole, so repeat in them the constraints that the model has
    ");
    folder.write("h.toml", b"[mean]\nfixed = { bias = 0.5, scale = 300 }\n");
    assert_snapshot!(test("--set tau=200"), @"
    exit 0
    ----- stdout
    Gyros on a turntable

    Hypothesis: h.toml
    The data do not contradict the hypothesis: p = 0.06 by the bootstrap.

    Fits to 6 tests
                  log-likelihood  free      AIC  converged
      hypothesis       81.799801     3  -157.60        yes
      model            84.307711     4  -160.62        yes

    -2 log λ = 5.01582
      reference distribution                p-value
      χ²(1)                                    0.03
      F(1, 5.12) = 6.522 by Kenward and        0.05
      Roger, for few tests
      bootstrap of 999, seed 1 (± 0.0075)      0.06
    ----- stderr
    ");
    folder.write("h.toml", b"[mean]\nfixed = { bias = 0.5, scale = 300 }\n[parameters]\ntau = 100\n");
    assert_snapshot!(test("--set tau=200"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot test this hypothesis: the model fixes parameter `tau` at 200, and the hypothesis has it at 100

    hint: a hypothesis restricts what the model leaves free
    ");
    folder.write("h.toml", b"[mean]\nfixed = { bias = 0.5, scale = 300 }\n[parameters]\ntau = {}\n");
    assert_snapshot!(test("--set tau=200"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot test this hypothesis: the model fixes parameter `tau` at 200, and the hypothesis leaves it free

    hint: a hypothesis restricts what the model leaves free
    ");
    folder.write(
        "h.toml",
        b"[mean]\nfixed = { bias = 0.5, scale = 300 }\n[parameters]\nsigma_v = { per = 'lot', fixed = { B = 0.02, A = 0.04 } }\n",
    );
    assert_snapshot!(test("--set tau=200"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot test this hypothesis: the model fixes parameter `sigma_v` at 0.02, and the hypothesis has it at 0.04

    hint: a hypothesis restricts what the model leaves free
    ");
    folder.write(
        "h.toml",
        b"[mean]\nfixed = { bias = 0.5, scale = 300 }\n[parameters]\nsigma_v = { per = 'lot', fixed = { B = 0.04, A = 0.02 } }\n",
    );
    let text = test("--set tau=200");
    assert!(text.starts_with("exit 0"), "the levels of the model in another order\n{text}");
}

#[test]
fn hypotheses_outside_the_model_are_refused() {
    let narrow = |model: &str, hypothesis: &str| {
        let model = format!("{}{model}", crate::folder::MODEL);
        refused("test m.toml d.csv --null h.toml --out t.json", &[("m.toml", &model), ("h.toml", hypothesis)])
    };
    assert_snapshot!(narrow("[covariance]\nstructure = \"diagonal\"\n", "[covariance]\nstructure = 'full'\n"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot test this hypothesis: the hypothesis allows covariances that the model does not

    hint: keys of the hypothesis replace the model's whole, so repeat in them the constraints that the model has
    ");
    assert_snapshot!(narrow("[mean]\nfixed = { slope = 0 }\n", "[mean]\nfixed = { level = 0 }\n"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot test this hypothesis: the hypothesis allows means that the model does not

    hint: keys of the hypothesis replace the model's whole, so repeat in them the constraints that the model has
    ");
    assert_snapshot!(narrow("", "[covariance]\nstructure = 'full'\n"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot test this hypothesis: the hypothesis restricts nothing that the model leaves free

    hint: a hypothesis adds constraints to the model's
    ");
    assert_snapshot!(narrow("", "[mean]\nfixed = {}\n"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot test this hypothesis: the hypothesis restricts nothing that the model leaves free

    hint: a hypothesis adds constraints to the model's
    ");
}

#[test]
fn files_that_are_no_hypotheses_are_refused() {
    assert_snapshot!(refused("test vaccine.toml vaccine.csv --null no.toml", &[]), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot read `no.toml`: No such file or directory (os error 2)
    ");
    assert_snapshot!(refused("test no.toml vaccine.csv --null h.toml", &[]), @"
    exit 2
    ----- stdout
    ----- stderr
    error: cannot read `no.toml`: No such file or directory (os error 2)
    ");
    assert_snapshot!(refused("test vaccine.toml vaccine.csv --null vaccine.toml", &[]), @"
    exit 2
    ----- stdout
    ----- stderr
    error: unknown key `data` in the hypothesis
      --> vaccine.toml:3:2 | [data]
                           |  ^^^^

    hint: its keys are `title`, `mean`, `covariance`, `levels`, `crossed`, `parameters` or `phases`
    ");
    assert_snapshot!(refused_hypothesis(""), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the hypothesis has no `mean`
      --> h.toml:1:1 | 
                     | ^

    hint: say what to test, in `[mean]` or `[covariance]`
    ");
    assert_snapshot!(refused_hypothesis("[mean]\nfixed = { efect = 0 }\n"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: unknown state `efect` in `fixed` of `[mean]`
      --> h.toml:2:11 | fixed = { efect = 0 }
                      |           ^^^^^

    hint: did you mean `effect`?
    ");
    assert_snapshot!(refused_hypothesis("[mean\nfixed = { effect = 0 }\n"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: not valid TOML: unclosed table, expected `]`
      --> h.toml:1:6 | [mean
                     |      ^
    ");
    assert_snapshot!(refused_hypothesis("[mean]\nregression = { effect = ['lattitude'] }\n"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: unknown regression column `lattitude` in the hypothesis: the model has no regression on it
      --> h.toml:2:26 | regression = { effect = ['lattitude'] }
                      |                          ^^^^^^^^^^^
    ");
    assert_snapshot!(refused_hypothesis("[mean]\nfixed = { effect = nan }\n"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `effect` of `fixed` of `[mean]` is nan, expected a finite number
      --> h.toml:2:20 | fixed = { effect = nan }
                      |                    ^^^
    ");
    assert_snapshot!(refused_hypothesis("mean = 0\n"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `mean` of the hypothesis is a number, expected a table
      --> h.toml:1:8 | mean = 0
                     |        ^ expected a table
    ");
}

#[test]
fn wrong_options_are_refused() {
    let test = |options: &str| refused(&format!("test vaccine.toml vaccine.csv {options}"), &[]);
    assert_snapshot!(test(""), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the following required arguments were not provided:
      --null <NULL>

    Usage: kalfit test --null <NULL> <MODEL> <DATA>...

    For more information, try '--help'.
    ");
    assert_snapshot!(test("--null h.toml --bootstrap 1000001"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: invalid value '1000001' for '--bootstrap <N>': 1000001 is not in 0..=1000000

    For more information, try '--help'.
    ");
    assert_snapshot!(test("--null h.toml --out h.toml"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the output `h.toml` is one of the inputs

    hint: give the output a name of its own
    ");
    assert_snapshot!(test("--null h.toml --out ./vaccine.csv"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the output `./vaccine.csv` is one of the inputs

    hint: give the output a name of its own
    ");
    assert_snapshot!(test("--null h.toml --out vaccine.toml"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: the output `vaccine.toml` is one of the inputs

    hint: give the output a name of its own
    ");
}

#[test]
fn fits_that_are_not_certified_are_said_to_be_so() {
    let (text, found) = json(MEAN, "--max-iterations 1");
    assert_snapshot!(text, @"
    exit 1
    ----- stdout
    BCG vaccine against tuberculosis, log risk ratios

    Hypothesis: no effect at the equator
    Not converged: one of the fits did not converge, so this test means little.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis      -8.7423203     2  21.48         no
      model             -7.82064     3  21.64         no

    -2 log λ = 1.84336
      reference distribution  p-value
      χ²(1)                      0.17

    Notes
      With 13 tests the large-sample distribution is a rough guide, and its p-values
        tend to be too small; `--bootstrap 1000` does not use it.
    ----- stderr
    Wrote t.json
    ");
    assert_eq!(found["converged"], false);
}

#[test]
fn quiet_tests_print_nothing() {
    assert_eq!(test(MEAN, "--quiet"), "exit 0\n----- stdout\n----- stderr\n");
}

#[test]
fn help_shows_an_example() {
    assert_snapshot!(shown(&Folder::new(&[]).run("test --help")), @r#"
    exit 0
    ----- stdout
    Test a hypothesis within a model by a likelihood-ratio test

    Usage: kalfit test [OPTIONS] --null <NULL> <MODEL> <DATA>...

    Arguments:
      <MODEL>    Model file (TOML)
      <DATA>...  Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard
                 input

    Options:
          --null <NULL>         File of the hypothesis (TOML)
          --bootstrap <N>       Draw this many ensembles from the hypothesis and repeat the test in
                                each: a p-value without large-sample theory; 0 for none [default: 999
                                with at most 50 tests or units and known parameters]
          --seed <S>            Seed of the bootstrap [default: 1]
          --tolerance <T>       Stop within this many standard errors of the optimum [default: 1e-8]
          --max-iterations <N>  Stop a fit after this many iterations [default: 200]
      -h, --help                Print help

    Model:
          --set <NAME=VALUE>  Fix a parameter: `tau=90`, or `sigma[A]=0.7` at one level; may be given
                              many times

    Output:
      -o, --out <FILE>  File for the results, as JSON; `-` writes them to standard output in place of
                        the summary

    Global options:
      -q, --quiet               Print nothing but errors
      -j, --threads <N>         Threads to use, at most four for each processor; the results do not
                                depend on it [default: all processors]
          --color <WHEN>        When to colour what is printed: `auto`, `always` or `never` [default:
                                auto]
          --instructions <SET>  Processor instructions to use: `portable`, `neon`, `avx2` or `avx512`;
                                with the same choice, all machines give the same bits [default: the
                                widest; or the variable KALFIT_INSTRUCTIONS]

    Examples:
      kalfit test model.toml data.csv --null null.toml
      kalfit test model.toml data.csv --null null.toml --bootstrap 1000 --out test.json

    The hypothesis is a TOML file with `[mean]`, `[covariance]` or `[parameters]`. Its keys replace the
    model's; `structure` drops the model's other keys of `[covariance]`. For example, no spread of the
    slope, whose mean is 10:

      [mean]
      fixed = { slope = 10 }
      [covariance]
      fixed = { "slope, slope" = 0 }
    ----- stderr
    "#);
}

/// One test of each unit: what differs between tests is not told from what differs between units, but it is no more than the sum.
#[test]
fn a_variance_that_only_limits_a_sum_is_tested_by_a_bound() {
    let model = "[data]\ntest = \"test\"\nlevels = [\"unit\"]\n[states.a]\n[measurements.y]\ncolumn = \"y\"\nequation = \"a\"\n\
                 noise = 0.3\n";
    let free = model.replace("0.3", "\"s\"") + "[parameters]\ns = {}\n";
    let levels = [1.5, 2.7, 2.8, 2.1, 1.3, 2.4, 1.1, 2.9, 2.2, 1.8, 2.6, 1.6];
    let row = |k: usize| format!("u{},t,{}\n", k / 3, levels[k / 3] + 0.2 * ((k % 3) as f64 - 1.0));
    let data = "unit,test,y\n".to_owned() + &(0..36).map(row).collect::<String>();
    let folder = Folder::new(&[
        ("m.toml", model.as_bytes()),
        ("free.toml", free.as_bytes()),
        ("d.csv", data.as_bytes()),
        ("one.toml", b"[covariance]\nfixed = { \"a, a\" = 1 }\n"),
        ("small.toml", b"[covariance]\nfixed = { \"a, a\" = 0.1 }\n"),
    ]);
    let of = |model: &str, null: &str| -> RatioRecord {
        let output = folder.run(&format!("test {model} d.csv --null {null} --out t.json"));
        assert!(folder.path("t.json").exists(), "{}", shown(&output));
        serde_json::from_str(&std::fs::read_to_string(folder.path("t.json")).unwrap()).unwrap()
    };
    let small = of("m.toml", "small.toml");
    for one in ["m.toml", "free.toml"].map(|model| of(model, "one.toml")) {
        assert!(one.lr > 1.0 && one.df == 1 && one.law_is_bound, "{one:?}");
        assert!(one.p_value > 1e-4 && one.p_value == one.p_chi2_df, "{one:?}");
    }
    assert!(small.lr < 1e-6 && small.p_value == 1.0, "{small:?}");
}
