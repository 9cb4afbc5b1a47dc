//! What the command says of itself.

use crate::folder::{Folder, shown};
use insta::assert_snapshot;

#[test]
fn version_and_help() {
    let folder = Folder::new(&[]);
    assert_snapshot!(shown(&folder.run("--version")).replace(env!("CARGO_PKG_VERSION"), "[version]"), @"
    exit 0
    ----- stdout
    kalfit [version]
    ----- stderr
    ");
    assert_snapshot!(shown(&folder.run("--help")), @"
    exit 0
    ----- stdout
    Error models from ensembles of non-identical tests, by maximum likelihood

    Usage: kalfit <COMMAND>

    Commands:
      init         Write a starter model, with comments, and a small data set: both run as they are
      fit          Fit a model to data: a summary to standard output, all results to a file
      reduce       Run the filters once, at known parameters, and write what they make of the data: all
                   that a fit needs
      estimates    Run the `[filter]` of each phase, optimal or not, and write its estimates with the
                   errors they make
      sums         Sums over the tests of one place, for a fit of tests in several places that exchange
                   nothing else
      join         Put the sums of all places together: what is asked next of each of them, or the fit
      test         Test a hypothesis within a model by the ratio of the likelihoods
      check        Read a model, and data if given, and fit nothing: the model in words, counts, what
                   the data identify
      simulate     Draw an ensemble of tests from a fit, or from the values of a model
      plan         Expected standard errors against the number of tests, before any is run
      apply        Apply a fitted model to tests, old or new: are they of the population, and what were
                   their states
      validate     How well a model predicts tests that it was not fitted to, and whether another one
                   does so better
      predict      What a test that nobody has made will give: means, spread and limits of states and
                   outputs
      export       The filter that follows from a fit, for programs that are not kalfit: JSON, numpy,
                   Matlab, C or Python
      datasheet    The numbers of a datasheet, in its units: random walks, Gauss-Markov pairs, turn-on
                   repeatability, Allan deviations
      compare      Fits of the same data side by side: likelihoods, AIC and BIC, tests of one within
                   another
      report       The report of a fit, one HTML page, from its results alone
      completions  The script that completes commands and options in a shell, to standard output
      man          The manual page, to standard output, or the pages of all commands, to a folder
      help         Print this message or the help of the given subcommand(s)

    Options:
      -h, --help     Print help
      -V, --version  Print version

    Examples:
      kalfit init gyro-bench bench            a model to start from, and its data, in the folder `bench`
      kalfit fit bench/gyro-bench.toml bench/gyro-bench.csv --out fit.json --report fit.html
      kalfit check model.toml data.csv        before a fit: is all understood as it was meant

    Exit status: 0 done and certified; 1 finished without a certified optimum; 2 bad input, nothing is
    written; 130 interrupted: a fit shows and writes the best so far, other commands write nothing.
    Colours: on terminals, unless NO_COLOR is set; CLICOLOR_FORCE=1 asks for them everywhere.
    ----- stderr
    ");
    assert_snapshot!(shown(&folder.run("fit --help")), @"
    exit 0
    ----- stdout
    Fit a model to data: a summary to standard output, all results to a file

    Usage: kalfit fit [OPTIONS] <MODEL> <DATA>...

    Arguments:
      <MODEL>
              Model file (TOML)

      <DATA>...
              Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input

    Options:
          --set <NAME=VALUE>
              Fix a parameter: `tau=90`, or `sigma[A]=0.7` at one level; may be given many times

          --threads <N>
              Threads to use; the results do not depend on it [default: all processors]

          --instructions <SET>
              Instructions to use: `portable`, `avx2` or `avx512`, for the same bits on every machine
              that has them [default: the widest; or the variable KALFIT_INSTRUCTIONS]

          --out <FILE>
              File for all results, as JSON

          --report <FILE.html>
              File for a report, one HTML page that needs nothing else; of records with times it shows
              them, too

          --tests <FILE>
              File for a table of the tests: distance, likelihood, innovations, influence, posterior.
              `.parquet`, `.arrow`, `.csv` or `.tsv`

          --parameters <FILE>
              File for a table of all estimates: means, spreads, correlations and parameters, with
              standard errors and intervals

          --constraints <FILE>
              File for a table of the constraints, and what each costs

          --method <METHOD>
              How free dynamic parameters are sought

              Possible values:
              - hybrid:      Mean and covariance are solved for each value of the parameters, which an
                outer search moves
              - innovations: Maximum likelihood of the innovations, jointly in all that is free
              - em:          EM on the states and noises: many more steps, to the same point
              - all:         All three, side by side; the results are those of `hybrid`
              
              [default: hybrid]

          --starts <N>
              Random starts of the search for dynamic parameters, besides the one worked out from the
              data [default: 0]

          --seed <N>
              Seed of the random starts [default: 1]

          --solver <SOLVER>
              How the mean and the covariance are sought

              Possible values:
              - newton: Newton's method with the exact Hessian, safeguarded by EM
              - em:     The EM algorithm: many more passes, to the same point
              
              [default: newton]

          --criterion <CRITERION>
              What is maximised

              Possible values:
              - ml:   The likelihood of the mean and the covariance
              - reml: The restricted likelihood of the covariance, whose estimate does not shrink when
                tests are few
              
              [default: ml]

          --phases <PHASES>
              How tests in several phases are put together

              Possible values:
              - chain:    Phase by phase: exact, at a cost that is linear in the number of phases
              - marginal: Each phase by itself: the correlation between phases is ignored, and
                information with it
              - stacked:  As one large test: exact, the reference
              
              [default: chain]

          --tolerance <T>
              Stop within this many standard errors of the optimum [default: 1e-8]

          --max-iterations <N>
              Stop after this many passes over the reduced data [default: 200 with newton, 20000 with
              em]

          --intervals <INTERVALS>
              What 95 % intervals are made of

              Possible values:
              - wald:    Standard errors
              - profile: Profile likelihood: what a likelihood-ratio test at 5 % does not reject
              
              [default: wald]

          --std-errors <STD_ERRORS>
              What standard errors are made of

              Possible values:
              - observed: The curvature of the log-likelihood
              - expected: Its expectation
              - sandwich: Both, and the spread of the tests' scores: right also for a wrong model, given
                many tests
              
              [default: observed]

          --deletion <DELETION>
              Whether to fit again without each test in turn

              Possible values:
              - auto: When it takes about a second at most
              - all:  Whatever it takes
              - none: Never
              
              [default: auto]

          --innovations <WHEN>
              Look at each test's innovations after the fit: is the model right for it

              Possible values:
              - on:  Look at them; large data are read a second time
              - off: Leave them out, and read the data once
              
              [default: on]

          --group-test
              Fit each group of `[data] group` by itself too, and say whether the groups differ

          --no-tests
              Leave out what each test says, its innovations and the fits without it: `tests` of the
              results is empty. For millions of tests, of which that would take more time, memory and
              disk than the fit

          --quiet
              Print nothing but errors

      -h, --help
              Print help (see a summary with '-h')

    Examples:
      kalfit fit model.toml data.csv
      kalfit fit model.toml 'runs/*.csv' --out fit.json --report fit.html
      kalfit fit model.toml data.csv --tests tests.parquet --parameters parameters.csv
      kalfit fit model.toml data.parquet --set tau=90 --intervals profile --starts 5

    Ctrl-C ends the search: the best so far is shown, and written to `--out` and `--report`, marked as
    not converged, with exit status 130. A second Ctrl-C ends at once, and writes nothing.
    ----- stderr
    ");
    assert_snapshot!(shown(&folder.run("check --help")), @"
    exit 0
    ----- stdout
    Read a model, and data if given, and fit nothing: the model in words, counts, what the data identify

    Usage: kalfit check [OPTIONS] <MODEL> [DATA]...

    Arguments:
      <MODEL>    Model file (TOML)
      [DATA]...  Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard
                 input

    Options:
          --set <NAME=VALUE>    Fix a parameter: `tau=90`, or `sigma[A]=0.7` at one level; may be given
                                many times
          --threads <N>         Threads to use; the results do not depend on it [default: all
                                processors]
          --instructions <SET>  Instructions to use: `portable`, `avx2` or `avx512`, for the same bits
                                on every machine that has them [default: the widest; or the variable
                                KALFIT_INSTRUCTIONS]
      -h, --help                Print help

    Examples:
      kalfit check model.toml                 is the model file sound, and how is it understood
      kalfit check model.toml data.csv        what the data identify, too
    ----- stderr
    ");
}
