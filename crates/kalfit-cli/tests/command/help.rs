//! What the command says of itself.

use crate::folder::{Folder, shown};
use insta::assert_snapshot;

#[test]
fn version_and_help() {
    let folder = Folder::new(&[]);
    let version = shown(&folder.run("--version")).replace(env!("CARGO_PKG_VERSION"), "[version]");
    let known = version.lines().nth(2).unwrap_or_default();
    let commit = known.strip_prefix("kalfit [version] (commit ").and_then(|rest| rest.strip_suffix(")"));
    let is_commit = commit.is_some_and(|commit| commit.len() == 10 && commit.bytes().all(|b| b.is_ascii_hexdigit()));
    assert!(known == "kalfit [version]" || is_commit, "{version}");
    assert_snapshot!(shown(&folder.run("-V")).replace(env!("CARGO_PKG_VERSION"), "[version]"), @"
    exit 0
    ----- stdout
    kalfit [version]
    ----- stderr
    ");
    assert_snapshot!(shown(&folder.run("--help")), @"
    exit 0
    ----- stdout
    Error models from ensembles of non-identical tests, by maximum likelihood

    Usage: kalfit [OPTIONS] <COMMAND>

    Commands:
      init         Write a starter model with comments, and a small data set; both run as they are
      fit          Fit a model to data: print a summary, write all results to a file
      reduce       Run the filters once with known parameters and write the reduced data: all that a fit
                   needs
      estimates    Run the `[filter]` of each phase, optimal or not, and write its estimates with their
                   errors
      sums         Sum over the tests of one place, for a fit of tests in several places that exchange
                   nothing else
      join         Put the sums of all places together: write what each of them is asked next, or the
                   fit
      test         Test a hypothesis within a model by a likelihood-ratio test
      check        Describe a model in words, count the data, and say what they can identify; nothing is
                   fitted
      simulate     Draw an ensemble of tests from a fit, or from the values in a model
      plan         Expected standard errors for different numbers of tests, before any test is run
      apply        Apply a fitted model to old or new tests: whether they belong to the population, and
                   their states
      validate     Cross-validate: how well a model predicts tests that were left out, and whether
                   another does better
      predict      Predict a test that has not been made: means, spreads and limits of states and
                   outputs
      export       Write the filter of a fit for other programs: JSON, numpy, Matlab, C or Python
      datasheet    Datasheet numbers in their usual units: random walks, turn-on repeatability, Allan
                   deviations
      compare      Compare fits of the same data: likelihoods, AIC, BIC, likelihood-ratio tests of
                   nested fits
      report       Make the report of a fit, one HTML page, from its results
      plot         Draw a figure of a fit as SVG, PDF or PNG
      schema       Print the JSON Schema of model files, with which editors complete keys and find
                   mistakes
      completions  Print the script that completes commands and options in a shell
      man          Print the manual page, or write the pages of all commands to a folder
      help         Print this message or the help of the given subcommand(s)

    Options:
      -h, --help     Print help
      -V, --version  Print version

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
      kalfit init gyro-bench bench            a model to start from, and its data, in the folder `bench`
      kalfit fit bench/gyro-bench.toml bench/gyro-bench.csv --out fit.json --report fit.html
      kalfit check model.toml data.csv        before a fit: what the data can identify

    Exit status: 0 success; 1 a fit did not converge, or a file could not be written beside others; 2
    bad input, no file was written; 130 interrupted: a fit shows and writes the best so far, other
    commands write nothing.
    Colours: on terminals, unless NO_COLOR is set; CLICOLOR_FORCE=1 or `--color always` asks for them
    everywhere.
    ----- stderr
    ");
    assert_snapshot!(shown(&folder.run("fit --help")), @"
    exit 0
    ----- stdout
    Fit a model to data: print a summary, write all results to a file

    Usage: kalfit fit [OPTIONS] <MODEL> <DATA>...

    Arguments:
      <MODEL>
              Model file (TOML)

      <DATA>...
              Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input

    Options:
      -h, --help
              Print help (see a summary with '-h')

    Model:
          --set <NAME=VALUE>
              Fix a parameter: `tau=90`, or `sigma[A]=0.7` at one level; may be given many times

    Output:
      -o, --out <FILE>
              File for all results, as JSON; `-` writes them to standard output in place of the summary

          --report <FILE.html>
              File for a report: one self-contained HTML page; for data with times it also shows records

          --tests <FILE>
              File for a table of the tests: distance, likelihood, innovations, influence, posterior.
              `.parquet`, `.arrow`, `.csv` or `.tsv`

          --parameters <FILE>
              File for a table of all estimates: means, spreads, correlations and parameters, with
              standard errors and intervals

          --constraints <FILE>
              File for a table of the constraints, with a score test of each

          --rows <FILE>
              File for a table of the measurements that contradict the others of their test

          --no-tests
              Leave out all results of single tests (estimates, innovations, influence): for millions of
              tests, where they would take more time and memory than the fit

    Search:
          --method <METHOD>
              How free dynamic parameters are estimated

              Possible values:
              - hybrid:      A search over the parameters, with mean and covariance solved for at each
                step
              - innovations: A joint search over parameters, mean and covariance
              - em:          The EM algorithm: many more steps to the same optimum
              - all:         All three, for comparison; the results are those of `hybrid`
              
              [default: hybrid]

          --starts <N>
              Additional random starts of the search for dynamic parameters [default: 0]

          --seed <N>
              Seed of the random starts [default: 1]

          --solver <SOLVER>
              How the mean and the covariance are estimated

              Possible values:
              - newton: Newton's method with the exact Hessian, safeguarded by EM
              - em:     The EM algorithm: many more iterations to the same optimum
              
              [default: newton]

          --criterion <CRITERION>
              Likelihood that is maximised

              Possible values:
              - ml:   Maximum likelihood
              - reml: Restricted maximum likelihood: less biased covariances with few tests
              
              [default: ml]

          --phases <PHASES>
              How the phases of a test are combined

              Possible values:
              - chain:    Exactly, phase by phase; the cost is linear in the number of phases
              - marginal: Separately: the correlation between phases is ignored, which loses information
              - stacked:  Exactly, as one large test: slower, for comparison
              
              [default: chain]

          --tolerance <T>
              Stop within this many standard errors of the optimum [default: 1e-8]

          --max-iterations <N>
              Stop after this many iterations [default: 200 with newton, 20000 with em]

    Inference:
          --intervals <INTERVALS>
              How 95 % intervals are computed

              Possible values:
              - auto:      By profiles with `--criterion reml` and at most 50 tests or units, where that
                is quick; else from standard errors
              - wald:      From standard errors
              - profile:   From the profile likelihood: all values that a likelihood-ratio test at 5 %
                does not reject
              - bootstrap: From the profile likelihood, with the quantiles of its ratios in 199
                ensembles drawn from the fit in place of those of many tests; for known parameters
              
              [default: auto]

          --df <DF>
              How degrees of freedom of means are computed, with `--criterion reml` [default:
              kenward-roger]

              Possible values:
              - kenward-roger: Standard errors and degrees of freedom by Kenward and Roger
              - satterthwaite: Degrees of freedom by Satterthwaite
              - none:          None: intervals as for many tests

          --std-errors <STD_ERRORS>
              How standard errors are computed

              Possible values:
              - observed: From the curvature of the log-likelihood
              - expected: From the expected curvature
              - sandwich: From the curvature and the scatter of the tests' scores: valid for wrong
                models, given many tests
              
              [default: observed]

          --deletion <DELETION>
              Whether to repeat the fit without each test in turn, to find influential tests

              Possible values:
              - auto: If that takes about a second at most
              - all:  Always
              - none: Never
              
              [default: auto]

          --innovations <WHEN>
              Whether to compute the innovations of each test, to check the model

              Possible values:
              - on:  Compute them; large data are read twice
              - off: Leave them out, and read the data once
              
              [default: on]

          --group-test
              Also fit each group of `[data] group` separately, and test whether the groups differ

    Global options:
      -q, --quiet
              Print nothing but errors

      -j, --threads <N>
              Threads to use, at most four for each processor; the results do not depend on it [default:
              all processors]

          --color <WHEN>
              When to colour what is printed: `auto`, `always` or `never`
              
              [default: auto]

          --instructions <SET>
              Processor instructions to use: `portable`, `neon`, `avx2` or `avx512`; with the same
              choice, all machines give the same bits [default: the widest; or the variable
              KALFIT_INSTRUCTIONS]

    Examples:
      kalfit fit model.toml data.csv
      kalfit fit model.toml 'runs/*.csv' --out fit.json --report fit.html
      kalfit fit model.toml data.csv --tests tests.parquet --parameters parameters.csv
      kalfit fit model.toml data.parquet --set tau=90 --intervals profile --starts 5
      kalfit fit model.toml data.csv -o - | jq .log_likelihood

    Ctrl-C ends the search: the best so far is shown, and written to `--out` and `--report`, marked as
    not converged, with exit status 130. A second Ctrl-C ends at once, and writes nothing.
    ----- stderr
    ");
    assert_snapshot!(shown(&folder.run("check --help")), @"
    exit 0
    ----- stdout
    Describe a model in words, count the data, and say what they can identify; nothing is fitted

    Usage: kalfit check [OPTIONS] <MODEL> [DATA]...

    Arguments:
      <MODEL>    Model file (TOML)
      [DATA]...  Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard
                 input

    Options:
      -h, --help  Print help

    Model:
          --set <NAME=VALUE>  Fix a parameter: `tau=90`, or `sigma[A]=0.7` at one level; may be given
                              many times

    Output:
      -o, --out <FILE>  File for what was found, as JSON; `-` writes it to standard output in place of
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
      kalfit check model.toml                 is the model file valid, and how is it understood
      kalfit check model.toml data.csv        also what the data can identify
      kalfit check model.toml data.csv -o -   the same as JSON
    ----- stderr
    ");
}
