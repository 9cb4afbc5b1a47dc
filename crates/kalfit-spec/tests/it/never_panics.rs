//! Whatever a model file holds, reading it ends with a model or with an error whose place is in the file.

use kalfit::model::{Filter, Initial};
use kalfit_spec::{ExpressionProblem, Spec, SpecError, SpecProblem};
use proptest::prelude::*;

fn read(text: &str) -> Result<Spec, SpecError> {
    let result = Spec::parse("model.toml", text);
    if let Err(error) = &result {
        assert!(!error.message.is_empty() && !error.message.ends_with('.'), "{error:?}");
        if let Some(span) = &error.span {
            assert!(text.get(span.clone()).is_some(), "{span:?} is no part of the text: {error}");
        }
    }
    if let Ok(spec) = &result {
        assert!(!spec.describe().is_empty() && spec.reduction_digest().len() == "sha256:".len() + 64);
        kept(spec);
    }
    result
}

/// What a model in phases promises whoever reads it.
fn kept(spec: &Spec) {
    let (shared, phases) = (spec.model.shared(), &spec.model.phases);
    let columns = spec.model.levels.iter().map(|level| shared.text_columns[level.column].name.as_str());
    assert!(columns.eq(spec.layout.levels.iter().map(String::as_str)));
    let alone = spec.model.levels.is_empty() || (phases.len() == 1 && phases[0].filter.is_none());
    assert!(alone && spec.model.levels.iter().all(|level| level.covariance.known.is_none()));
    assert!(phases[0].carry.is_empty() && (phases.len() == 1 || spec.model.column.is_some()));
    for (i, phase) in phases.iter().enumerate() {
        let model = &phase.model;
        assert_eq!((&model.columns, &model.text_columns), (&shared.columns, &shared.text_columns));
        assert_eq!((&model.literals, &model.parameters), (&shared.literals, &shared.parameters));
        assert_eq!(phase.label.map(|label| &model.literals[label]), spec.model.column.map(|_| &phase.name));
        assert!(phases[..i].iter().all(|before| before.name != phase.name));
        assert!(phase.carry.windows(2).all(|pair| pair[0].state < pair[1].state));
        for carry in &phase.carry {
            let before = &phases[i - 1].model.states;
            assert!(carry.state < model.states.len() && model.states[carry.state].initial != Initial::Stationary);
            assert!(carry.from.terms.iter().all(|(state, _)| *state < before.len()) && !carry.from.terms.is_empty());
        }
        let n = model.states.len();
        let whole = |filter: &Filter| {
            filter.mean.len() == n
                && filter.covariance.shape() == (n, n)
                && filter.consider.iter().all(|state| *state < n)
        };
        assert!(phase.filter.as_ref().is_none_or(whole));
        let _ = phase.entry_model();
    }
}

fn with_equation(quoted: &str) -> String {
    format!(
        "[states]\na = {{}}\nb = {{}}\n[measurements.y]\ncolumn = 'y'\nnoise = 1\nequation = {quoted}\n[data]\ntime = 't'\n"
    )
}

/// Pieces that expressions are made of, and some that they are not.
const PIECES: [&str; 34] = [
    "a", "b", "u", "1", "2.5", "1e-6", "dt", "pi", " ", "+", "-", "*", "/", "^", "(", ")", ",", "<", "==", "!=",
    "and ", "or ", "not ", "if(", "sqrt(", "max(", "`c d`", "''", "\"", "'A'", "`", "é", "=", "\\u0062",
];

/// Lines that model files are made of, some of them wrong.
const LINES: [&str; 69] = [
    "[data]",
    "time = 't'",
    "test = '@file'",
    "step_first = true",
    "initial_time = 0",
    "inputs = 'previous'",
    "[states]",
    "a = {}",
    "b = { random = false }",
    "[states.c]",
    "process = 'gauss-markov-2'",
    "time_constant = 'tau'",
    "sigma = 's'",
    "next = 'a + 0.5 * c'",
    "derivative = '-c / tau'",
    "noise_density = 's'",
    "step_noise = 0.1",
    "initial = { mean = 0, sigma = 1 }",
    "initial = 'stationary'",
    "[measurements.y]",
    "column = 'y'",
    "equation = 'a + b * u + c'",
    "noise = 's'",
    "variance = 2",
    "[measurements.z]",
    "[noise_covariance]",
    "'y, z' = 0.1",
    "[parameters]",
    "tau = { start = 3, lower = 1 }",
    "s = { per = 'lot', fixed = { A = 1 } }",
    "[mean]",
    "tied = { a = 'b + 1' }",
    "proportional_to = { a = 1 }",
    "[covariance]",
    "structure = 'blocks'",
    "blocks = [['a', 'b']]",
    "fixed = { 'a, a' = 0 }",
    "known = [[1, 0], [0, 1]]",
    "order = ['b', 'a']",
    "[process_noise_covariance]",
    "phase = 'leg'",
    "[phases.one]",
    "[phases.two.states]",
    "[phases.two]",
    "[phases.two.carry]",
    "a = 'a'",
    "c = '0.5 * c + b'",
    "b = { initial = { mean = 0, sigma = 0 } }",
    "[phases.two.measurements.y]",
    "[phases.two.covariance]",
    "[phases.one.mean]",
    "[phases.'three é']",
    "[filter]",
    "[phases.two.filter]",
    "kind = 'kalman-schmidt'",
    "consider = ['a']",
    "mean = { b = 1 }",
    "covariance = [[1, 0], [0, 2]]",
    "covariance = [[3]]",
    "parameters = { tau = 5 }",
    "matrix = [[1]]",
    "phases = { one = {}, two = {} }",
    "test = 'run'",
    "levels = ['lot', 'serial']",
    "levels = ['lot']",
    "states = ['a']",
    "states = []",
    "[levels.lot.covariance]",
    "[levels.serial.covariance]",
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, ..ProptestConfig::default() })]

    #[test]
    fn any_text_is_read_or_refused(text in any::<String>()) {
        let _ = read(&text);
    }

    #[test]
    fn any_expression_is_read_or_refused(pieces in prop::collection::vec(prop::sample::select(&PIECES[..]), 0..24)) {
        let expression: String = pieces.concat();
        let _ = read(&with_equation(&format!("\"\"\"{expression}\"\"\"")));
        let _ = read(&with_equation(&format!("'''{expression}'''")));
        let _ = read(&with_equation(&format!("\"{expression}\"")));
    }

    #[test]
    fn any_characters_in_an_expression_are_read_or_refused(expression in "[^'\\p{Cc}]{0,40}") {
        let _ = read(&with_equation(&format!("'{expression}'")));
    }

    #[test]
    fn any_lines_are_read_or_refused(lines in prop::collection::vec(prop::sample::select(&LINES[..]), 0..30)) {
        let _ = read(&lines.join("\n"));
    }

    #[test]
    fn any_assignment_is_done_or_refused(assignment in "(s|tau|x|é)?(\\[.{0,3}\\]?)?=?.{0,6}") {
        let mut spec = read(
            "[states]\na = {}\n[measurements.y]\ncolumn = 'y'\nequation = 'tau * a'\nnoise = 's'\n\
             [parameters]\ntau = {}\ns = { per = 'lot' }\n",
        )
        .expect("the model is whole");
        let _ = spec.set(&assignment);
        let _ = spec.describe();
    }
}

/// A model in phases with much that can go wrong.
const PHASES: &str = "[data]\ntime = 't'\nphase = 'leg'\n[states.a]\nprocess = 'gauss-markov-2'\ntime_constant = 'tau'\n\
    sigma = 1\n[states.b]\n[measurements.y]\ncolumn = 'y'\nequation = 'a + b'\nnoise = 1\n[filter]\n\
    kind = 'kalman-schmidt'\nconsider = ['a']\nmean = { b = 1 }\ncovariance = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n\
    parameters = { tau = 2 }\n[phases.one]\n[phases.'two é']\n[phases.'two é'.states]\na = { initial = 'estimated', \
    process = 'gauss-markov-2', time_constant = 'tau', sigma = 1 }\nb = { initial = { mean = 0, sigma = 0 } }\n\
    [phases.'two é'.carry]\na = '2 * a'\nb = 'b + tau'\n[phases.'two é'.covariance]\nstructure = 'fixed'\n\
    matrix = [[2]]\n[parameters]\ntau = 3\n";

/// The same with pieces cut out, from any place to any place.
#[test]
fn every_part_of_a_model_in_phases_may_be_missing() {
    let whole = read(PHASES).expect("the model is whole");
    assert_eq!(whole.model.phases.len(), 2);
    let lines: Vec<&str> = PHASES.lines().collect();
    for from in 0..lines.len() {
        for to in from + 1..=lines.len() {
            let _ = read(&[&lines[..from], &lines[to..]].concat().join("\n"));
        }
    }
    for end in (0..PHASES.len()).filter(|end| PHASES.is_char_boundary(*end)) {
        let _ = read(&PHASES[..end]);
    }
}

/// Phases that take much from the top level are refused before they take memory or time.
#[test]
fn many_phases_of_one_large_table_are_refused() {
    let many = |line: &dyn Fn(usize) -> String, n: usize| (0..n).map(line).collect::<String>();
    let start = "[data]\nphase = 'leg'\n[states]\na = {}\n";
    let measurement = |i: usize| format!("[measurements.m{i}]\ncolumn = 'y{i}'\nequation = 'a'\nnoise = 1\n");
    let phases = many(&|i| format!("[phases.p{i}]\n"), 100);
    let list = |i: usize| many(&|k| format!("'c{i}_{k}', "), 500);
    let regressions = many(&|i| format!("[phases.p{i}.mean.regression]\na = [{}]\n", list(i)), 100);
    for text in
        [format!("{start}{}{phases}", many(&measurement, 500)), format!("{start}{}{regressions}", measurement(0))]
    {
        let problem = *read(&text).unwrap_err().problem;
        assert!(matches!(problem, SpecProblem::Count { .. }), "{problem:?}");
    }
}

/// A model whose lines are shuffled by leaving some out is still read or refused.
#[test]
fn every_part_of_a_model_may_be_missing() {
    let whole = "[data]\ntime = 't'\n[states.a]\nprocess = 'gauss-markov'\ntime_constant = 'tau'\nsigma = 1\n[states.b]\n\
                 unit = 'm'\n[measurements.y]\ncolumn = 'y'\nequation = 'a + b'\nnoise = 1\n[parameters]\ntau = 3\n";
    assert!(read(whole).is_ok());
    let lines: Vec<&str> = whole.lines().collect();
    for without in 0..lines.len() {
        let rest: Vec<&str> = lines.iter().enumerate().filter(|(i, _)| *i != without).map(|(_, l)| *l).collect();
        let _ = read(&rest.join("\n"));
    }
    for end in (0..whole.len()).filter(|end| whole.is_char_boundary(*end)) {
        let _ = read(&whole[..end]);
    }
}

#[test]
fn deep_tables_and_arrays_are_refused() {
    for text in [
        format!("a = {}", "[".repeat(100_000)),
        format!("a = {}", "{a=".repeat(100_000)),
        format!("[{}a]", "a.".repeat(100_000)),
        format!("{}a = 1", "a.".repeat(100_000)),
    ] {
        assert!(matches!(*read(&text).unwrap_err().problem, SpecProblem::Toml { .. }));
    }
}

#[test]
fn equations_whose_expansion_explodes_are_refused() {
    // 250 states, each times the same sum of 240 columns, in equation after equation.
    let names: Vec<String> = (0..250).map(|i| format!("s{i}")).collect();
    let factor: Vec<String> = (0..240).map(|i| format!("u{i}")).collect();
    let mut text = "[states]\n".to_owned();
    for name in &names {
        text.push_str(&format!("{name} = {{}}\n"));
    }
    for i in 0..100 {
        let (sum, factor) = (names.join(" + "), factor.join(" + "));
        text.push_str(&format!("[measurements.m{i}]\ncolumn = 'y{i}'\nnoise = 1\nequation = '({factor}) * ({sum})'\n"));
    }
    let problem = *read(&text).unwrap_err().problem;
    assert!(matches!(problem, SpecProblem::Expression(ExpressionProblem::ModelTooLarge { .. })), "{problem:?}");
}

#[test]
fn lists_without_end_and_names_without_end_are_refused() {
    let states = "[states]\na = {}\n[measurements.y]\ncolumn = 'y'\nequation = 'a'\nnoise = 1\n";
    let many = |line: fn(usize) -> String| (0..2_000).map(line).collect::<String>();
    for text in [
        format!("[measurements]\n[states]\n{}", many(|i| format!("s{i} = {{}}\n"))),
        format!("[states]\na = {{}}\n[measurements]\n{}", many(|i| format!("m{i} = {{}}\n"))),
        format!("{states}[parameters]\n{}", many(|i| format!("p{i} = {{}}\n"))),
        format!("{states}[mean.regression]\na = [{}]\n", many(|i| format!("'c{i}', "))),
    ] {
        assert!(matches!(*read(&text).unwrap_err().problem, SpecProblem::Count { .. }));
    }
    let error = read(&format!("{} = 1", "k".repeat(1_000_000))).unwrap_err();
    assert!(error.message.len() < 2_000, "the message has {} bytes", error.message.len());
}

#[test]
fn files_that_are_too_large_or_no_text_are_refused() {
    let text = format!("# {}", "x".repeat(4 * 1024 * 1024));
    assert!(matches!(*read(&text).unwrap_err().problem, SpecProblem::TooLarge { .. }));
    let folder = std::env::temp_dir().join(format!("kalfit-spec-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("model.toml");
    std::fs::write(&path, [b'[', 0xff, b']']).unwrap();
    assert_eq!(*Spec::load(&path).unwrap_err().problem, SpecProblem::NotText { offset: 1 });
    std::fs::write(&path, &text).unwrap();
    assert!(matches!(*Spec::load(&path).unwrap_err().problem, SpecProblem::TooLarge { .. }));
    assert!(matches!(*Spec::load(&folder.join("none.toml")).unwrap_err().problem, SpecProblem::Unreadable { .. }));
    std::fs::write(&path, with_equation("'a + b'")).unwrap();
    assert_eq!(Spec::load(&path).unwrap().model.shared().estimated.len(), 2);
    std::fs::remove_dir_all(&folder).unwrap();
}
