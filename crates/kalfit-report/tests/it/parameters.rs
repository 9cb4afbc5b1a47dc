//! Dynamic parameters in the summary: where they lie, very many levels, several methods.

#[allow(dead_code, reason = "each test crate uses its own part of it")]
use crate::common;

use common::{phase, record};
use kalfit::FitRecord;
use kalfit::record::{MethodRecord, ParameterRecord};
use kalfit_report::{TextStyle, summary};

fn parameter(name: &str, estimate: f64, std_error: Option<f64>) -> ParameterRecord {
    ParameterRecord {
        name: name.into(),
        per: None,
        level: None,
        estimate,
        std_error,
        interval95: std_error.map(|e| [Some(estimate - 1.96 * e), Some(estimate + 1.96 * e)]),
        fixed: false,
        at_bound: false,
        unit: None,
        standing: Some("inside".into()),
        note: None,
    }
}

fn standing(name: &str, estimate: f64, standing: &str) -> ParameterRecord {
    ParameterRecord { standing: Some(standing.into()), ..parameter(name, estimate, None) }
}

fn with(parameters: Vec<ParameterRecord>) -> FitRecord {
    FitRecord { parameters, ..record("", vec![phase("main", &["bias"])]) }
}

/// The sections from a heading on, up to the constraints and the outlying tests.
fn shown(record: &FitRecord, heading: &str) -> String {
    let text = summary(record, &TextStyle::default());
    let start = text.find(heading).unwrap_or_else(|| panic!("no {heading} in\n{text}"));
    let rest = &text[start..];
    let end =
        ["\nConvergence", "\nOutlying", "\nNotes", "\nComputation"].iter().filter_map(|next| rest.find(next)).min();
    rest[..end.unwrap_or(rest.len())].to_owned()
}

#[test]
fn a_parameter_without_standard_error_says_where_it_lies() {
    let open = |low, high| ParameterRecord { interval95: Some([low, high]), ..parameter("f", 2.0, None) };
    let parameters = vec![
        parameter("tau", 120.4321, Some(3.21)),
        standing("walk", 0.0, "lower"),
        standing("low", 1.0, "lower"),
        standing("high", 9.0, "upper"),
        ParameterRecord { interval95: Some([Some(310.0), None]), ..standing("long", 1e9, "unbounded") },
        standing("idle", 20.0, "unidentified"),
        ParameterRecord { fixed: true, standing: None, ..parameter("known", 0.003, None) },
        ParameterRecord { standing: None, ..parameter("unsure", 4.0, None) },
        open(None, Some(3.25)),
        open(Some(1.5), Some(3.25)),
    ];
    insta::assert_snapshot!(shown(&with(parameters), "Dynamic parameters"), @"
    Dynamic parameters (± standard error)
      parameter  value                       95 % interval
      tau        120.4 ± 3.2                 114.1 to 126.7
      walk           0 at zero
      low            1 at its lower bound
      high           9 at its upper bound
      long         1e9 no upper limit found  from 310
      idle          20 not identified
      known      0.003 fixed
      unsure         4 ± unknown
      f              2 ± unknown             to 3.25
      f              2 ± unknown             1.5 to 3.25
    ");
}

#[test]
fn of_very_many_levels_the_first_and_the_extremes_are_shown() {
    let level = |i: usize| ParameterRecord {
        per: Some("unit".into()),
        level: Some(format!("u{i:04}")),
        fixed: i == 17,
        ..parameter("sigma_v", 1.0 + 0.001 * ((i * 7919) % 2000) as f64, Some(0.05))
    };
    let mut parameters: Vec<ParameterRecord> = (0..2000).map(level).collect();
    parameters.push(parameter("tau", 3.0, Some(0.1)));
    let text = shown(&with(parameters), "Dynamic parameters");
    insta::assert_snapshot!(text, @"
    Dynamic parameters (± standard error)
      parameter  for         value          95 % interval
      sigma_v    unit u0000  1.000 ± 0.050  0.902 to 1.098
      sigma_v    unit u0001  2.919 ± 0.050  2.821 to 3.017
      sigma_v    unit u0002  2.838 ± 0.050  2.740 to 2.936
      sigma_v    unit u0003  2.757 ± 0.050  2.659 to 2.855
      sigma_v    unit u0004  2.676 ± 0.050  2.578 to 2.774
      sigma_v    unit u0005  2.595 ± 0.050  2.497 to 2.693
      sigma_v    unit u0321  2.999 ± 0.050  2.901 to 3.097
      tau                     3.00 ± 0.10   2.80 to 3.20
      sigma_v has 2000 levels, 1 of them fixed. The table shows the first 6, the
        smallest and the largest; 1993 more are in the results file. The median of
        all is 2.
    ");
}

#[test]
fn so_many_parameters_do_not_fill_the_screen() {
    let parameters = (0..500).map(|i| parameter(&format!("p{i}"), 1.0, Some(0.1))).collect();
    let text = shown(&with(parameters), "Dynamic parameters");
    assert!(text.lines().count() < 50, "{} lines\n{text}", text.lines().count());
    assert!(text.contains("460 more"), "{text}");
}

#[test]
fn methods_stand_side_by_side() {
    let method = |method: &str, converged: bool, value: f64| MethodRecord {
        method: method.into(),
        log_likelihood: -637.602932 - if converged { 0.0 } else { 0.01 },
        converged,
        reason: "the search reached its limit of iterations".into(),
        values: vec![value, 123.61],
        iterations: 26,
        filter_passes: 20,
        score_passes: 19,
        seconds: 0.012,
    };
    let record = FitRecord {
        methods: vec![
            method("hybrid", true, 35.77194),
            method("innovations", true, 35.77194),
            method("em", false, 36.5),
        ],
        ..with(vec![
            parameter("walk", 35.77194, Some(16.0)),
            ParameterRecord { fixed: true, ..parameter("known", 1.0, None) },
            ParameterRecord {
                per: Some("lot".into()),
                level: Some("A".into()),
                ..parameter("sigma", 123.61, Some(13.0))
            },
        ])
    };
    insta::assert_snapshot!(shown(&record, "Methods side by side"), @"
    Methods side by side
      method          log-lik.  converged  iter.  filter runs  backward   time
      hybrid       -637.602932  yes           26           20        19  12 ms
      innovations  -637.602932  yes           26           20        19  12 ms
      em           -637.612932  no            26           20        19  12 ms

      parameter      hybrid  innovations      em
      walk         35.77194     35.77194    36.5
      sigma lot A    123.61       123.61  123.61
      em did not converge: the search reached its limit of iterations.
    ");
}
