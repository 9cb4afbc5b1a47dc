//! Phases and what they inherit.

use super::refusal as complete;

/// The message about a model of two phases: `one` and `two` are added to the tables of each, `[data]` has time and phase.
fn refusal(one: &str, two: &str) -> String {
    let phase = |name: &str, rest: &str| {
        let mut text = String::new();
        for (table, given) in
            [("states", "a = {}\nb = {}\n"), ("measurements.y", "column = 'y'\nequation = 'a'\nnoise = 1\n")]
        {
            let header = format!("[phases.{name}.{table}]\n");
            if !rest.contains(header.trim_end().trim_end_matches(".y]")) {
                text += &(header + given);
            }
        }
        text + rest
    };
    complete(&format!("[data]\ntime = 't'\nphase = 'leg'\n{}{}", phase("one", one), phase("two", two)))
}

const PHASE: &str = "states.a = {}\nmeasurements.y = { column = 'y', equation = 'a', noise = 1 }\n";

#[test]
fn whole_phases_are_accepted() {
    insta::assert_snapshot!(refusal("", "[phases.two.carry]\na = 'a'\n"), @"accepted");
}

#[test]
fn phases_without_any() {
    insta::assert_snapshot!(complete("[phases]\n"), @r#"
    the model has 0 phases, expected 1 to 100
    at   "phases"
    hint a phase has tables, as in `[phases.coast.states]`
    "#);
}

#[test]
fn phases_without_end() {
    let many: String = (0..101).map(|i| format!("[phases.p{i}]\n")).collect();
    insta::assert_snapshot!(complete(&many), @r#"
    the model has 101 phases, expected 1 to 100
    at   "phases"
    hint a phase has tables, as in `[phases.coast.states]`
    "#);
}

#[test]
fn phases_that_are_no_table() {
    insta::assert_snapshot!(complete("phases = 3\n"), @r#"
    `phases` of the model file is a number, expected a table
    at   "3"
    "#);
    insta::assert_snapshot!(complete("phases.one = 3\n"), @r#"
    `one` of `[phases]` is a number, expected a table
    at   "3"
    "#);
}

#[test]
fn an_unknown_table_of_a_phase() {
    insta::assert_snapshot!(refusal("", "[phases.two.measurement.y]\n"), @r#"
    unknown key `measurement` in `[phases.two]`
    at   "measurement"
    hint did you mean `measurements`?
    "#);
}

#[test]
fn parameters_of_a_phase() {
    insta::assert_snapshot!(refusal("", "[phases.two.parameters]\nk = 1\n"), @r#"
    unknown key `parameters` in `[phases.two]`
    at   "parameters"
    hint phases share parameters by name: they stand in `[parameters]`
    "#);
}

#[test]
fn a_name_that_no_cell_can_be_told_by() {
    insta::assert_snapshot!(complete(&format!("[phases.' one']\n{PHASE}")), @r#"
    ` one` cannot be the name of a phase: it is empty or has spaces around it
    at   "' one'"
    "#);
}

#[test]
fn several_phases_without_a_column() {
    insta::assert_snapshot!(complete(&format!("[phases.one]\n{PHASE}[phases.two]\n{PHASE}")), @r#"
    `[data]` has no `phase`
    at   "two"
    hint with several phases, `phase` names the column that holds the phase of each row
    "#);
    insta::assert_snapshot!(complete(&format!("[data]\ntest = 'id'\n[phases.one]\n{PHASE}[phases.two]\n{PHASE}")), @r#"
    `[data]` has no `phase`
    at   "[data]"
    hint with several phases, `phase` names the column that holds the phase of each row
    "#);
}

#[test]
fn a_column_of_phases_that_is_no_column() {
    insta::assert_snapshot!(complete("[data]\nphase = 3\n"), @r#"
    `phase` of `[data]` is a number, expected a string
    at   "3"
    "#);
}

#[test]
fn a_first_step_of_no_phase() {
    let text = format!("[data]\ntime = 't'\ninitial_time = 0\n[phases.one]\n{PHASE}");
    insta::assert_snapshot!(complete(&text), @r#"
    `initial_time` has no effect beside `[phases]`
    at   "initial_time"
    hint write `initial_time` in `[phases.NAME]`: each phase has its own x_0
    "#);
    insta::assert_snapshot!(complete(&text.replace("initial_time = 0", "step_first = false")), @r#"
    `step_first` has no effect beside `[phases]`
    at   "step_first"
    hint write `step_first` in `[phases.NAME]`: each phase has its own x_0
    "#);
}

#[test]
fn a_first_step_that_nothing_takes() {
    insta::assert_snapshot!(refusal("", "[phases.two]\ninitial_time = 0\n"), @r#"
    `initial_time` has no effect when no state moves
    at   "initial_time"
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two]\nstep_first = true\n"), @r#"
    `step_first` has no effect when no state moves
    at   "step_first"
    "#);
}

#[test]
fn a_first_step_of_a_phase_without_time() {
    insta::assert_snapshot!(complete(&format!("[phases.one]\ninitial_time = 0\n{PHASE}")), @r#"
    `initial_time` has no effect without `time`
    at   "initial_time"
    hint `time` names the column with the time of each row
    "#);
}

#[test]
fn a_first_step_of_a_phase_in_continuous_time() {
    let states = "[phases.two]\nstep_first = true\n[phases.two.states]\na = { derivative = '-a' }\n";
    insta::assert_snapshot!(refusal("", states), @r#"
    `step_first` gives the first step no length, which the motion of state `a` needs
    at   "step_first"
    hint `initial_time` says when the first step begins
    "#);
    let both = states.replace("step_first = true", "step_first = true\ninitial_time = 't0'");
    insta::assert_snapshot!(refusal("", &both), @r#"
    `step_first` has no effect beside `initial_time`
    at   "step_first"
    hint with `initial_time` a step from x_0 precedes the first row anyway
    "#);
}

#[test]
fn inputs_that_no_phase_uses() {
    let text =
        format!("[data]\ntime = 't'\nphase = 'leg'\ninputs = 'previous'\n[phases.one]\n{PHASE}[phases.two]\n{PHASE}");
    insta::assert_snapshot!(complete(&text), @r#"
    `inputs` has no effect when no motion uses a column
    at   "inputs"
    "#);
}

#[test]
fn a_table_that_no_phase_takes() {
    insta::assert_snapshot!(refusal("[phases.one.mean]\n", "[phases.two.mean]\n[mean]\nfixed = { a = 0 }\n"), @r#"
    `mean` has no effect when every phase has its own
    at   "mean"
    "#);
}

#[test]
fn a_table_of_the_top_level_that_one_phase_cannot_take() {
    insta::assert_snapshot!(refusal("", "[phases.two.states]\na = {}\n[mean]\nfixed = { b = 0 }\n"), @r#"
    unknown state `b` in `fixed` of `[mean]`
    at   "b"
    "#);
}

#[test]
fn a_phase_without_states_anywhere() {
    insta::assert_snapshot!(complete(&format!("[data]\nphase = 'leg'\n[phases.one]\n{PHASE}[phases.two]\n")), @r#"
    the model has 0 states, expected 1 to 500
    at   "two"
    hint a state is a table in `[states]`, as in `intercept = {}`
    "#);
}

#[test]
fn errors_in_tables_of_a_phase_name_the_phase() {
    insta::assert_snapshot!(refusal("", "[phases.two.states]\na = { unt = 'm' }\n"), @r#"
    unknown key `unt` in state `a` of phase `two`
    at   "unt"
    hint did you mean `unit`?
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.measurements.y]\ncolumn = 'y'\nequation = 'a'\n"), @r#"
    measurement `y` of phase `two` has neither `noise` nor `variance`, expected one of them
    at   "[phases.two.measurements.y]"
    hint `noise` is a standard deviation, `variance` its square; 0 is legal
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.mean]\nfixed = { c = 0 }\n"), @r#"
    unknown state `c` in `fixed` of `[phases.two.mean]`
    at   "c"
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.covariance]\nfixed = { 'a, c' = 0 }\n"), @r#"
    unknown state `c` in `fixed` of `[phases.two.covariance]`
    at   "'a, c'"
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.covariance]\nequal = [['a, a', 'a, a']]\n"), @r#"
    `a, a` stands twice in `equal` of `[phases.two.covariance]`
    at   "'a, a'"
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.covariance]\nstructure = 'fixed'\n"), @r#"
    `[phases.two.covariance]` has no `matrix`
    at   "[phases.two.covariance]"
    hint structure `fixed` needs `matrix`, with a row for every estimated state
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.noise_covariance]\n'y, x' = 1\n"), @r#"
    unknown measurement `x` in `[phases.two.noise_covariance]`
    at   "'y, x'"
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.process_noise_covariance]\n'a, x' = 1\n"), @r#"
    unknown state `x` in `[phases.two.process_noise_covariance]`
    at   "'a, x'"
    "#);
}

#[test]
fn carry_in_the_first_phase() {
    insta::assert_snapshot!(refusal("[phases.one.carry]\na = 'a'\n", ""), @r#"
    `carry` has no effect in the first phase, which inherits nothing
    at   "carry"
    hint phases happen in the order in which the file names them first
    "#);
    insta::assert_snapshot!(complete("[carry]\na = 'a'\n"), @r#"
    unknown key `carry` in the model file
    at   "carry"
    hint its keys are `title`, `data`, `states`, `process_noise_covariance`, `measurements`, `noise_covariance`, `parameters`, `mean`, `covariance`, `levels`, `crossed`, `phases` or `filter`
    "#);
}

#[test]
fn carry_of_a_state_that_is_not_there() {
    insta::assert_snapshot!(refusal("", "[phases.two.carry]\nbais = 'a'\n[phases.two.states]\nbias = {}\na = {}\n"), @r#"
    unknown state `bais` in `[phases.two.carry]`
    at   "bais"
    hint did you mean `bias`?
    "#);
}

#[test]
fn carry_of_a_hidden_state() {
    let states = "[phases.two.states]\na = { process = 'gauss-markov-2', time_constant = 1, sigma = 1 }\n";
    insta::assert_snapshot!(refusal("", &format!("{states}[phases.two.carry]\n'a (rate)' = 'a'\n")), @r#"
    unknown state `a (rate)` in `[phases.two.carry]`
    at   "'a (rate)'"
    hint a hidden rate goes where its owner goes
    "#);
}

#[test]
fn carry_that_is_not_linear() {
    insta::assert_snapshot!(refusal("", "[phases.two.carry]\na = 'a * b'\n"), @r#"
    state `a` times state `b` is not linear in the states
    at   "a * b"
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.carry]\na = 'a * dt'\n"), @r#"
    `dt` cannot stand in `a` of `[phases.two.carry]`
    at   "dt"
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.carry]\na = true\n"), @r#"
    `a` of `[phases.two.carry]` is a truth value, expected a number or an expression
    at   "true"
    "#);
}

#[test]
fn carry_of_nothing() {
    insta::assert_snapshot!(refusal("", "[phases.two.carry]\na = 0\n"), @r#"
    `carry` of state `a` names no state of phase `one`
    at   "0"
    hint without `carry` a state starts afresh; `offset` adds a known amount to an estimated start
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.carry]\na = '2 * u'\n"), @r#"
    `carry` of state `a` names no state of phase `one`
    at   "'2 * u'"
    hint without `carry` a state starts afresh; `offset` adds a known amount to an estimated start
    "#);
    let states = "[phases.one.states]\nbias = {}\na = {}\n";
    insta::assert_snapshot!(refusal(states, "[phases.two.carry]\na = 'baias'\n"), @r#"
    `carry` of state `a` names no state of phase `one`
    at   "'baias'"
    hint did you mean `bias`?
    "#);
}

#[test]
fn carry_from_a_state_of_the_same_phase() {
    let states = "[phases.two.states]\na = {}\nslope = {}\n[phases.two.carry]\n";
    insta::assert_snapshot!(refusal("", &format!("{states}a = 'a + 2 * slope'\n")), @r#"
    `slope` is no state of phase `one`, from which `carry` inherits, but of the phase that inherits
    at   "'a + 2 * slope'"
    hint a column of this name is written `` `slope` ``
    "#);
    insta::assert_snapshot!(refusal("", &format!("{states}a = 'a + 2 * `slope`'\n")), @"accepted");
}

#[test]
fn carry_into_a_stationary_state() {
    let states = |initial: &str| {
        format!(
            "[phases.two.states]\na = {{ process = 'gauss-markov', time_constant = 3, sigma = 1{initial} }}\n\
             [phases.two.carry]\na = 'a'\n"
        )
    };
    insta::assert_snapshot!(refusal("", &states("")), @r#"
    state `a` inherits by `carry`, so it cannot start in its stationary distribution
    at   "a"
    hint say what phase `two` adds: `initial = "estimated"`, or `initial = { mean = 0, sigma = 0 }` for nothing
    "#);
    insta::assert_snapshot!(refusal("", &states(", initial = 'stationary'")), @r#"
    state `a` inherits by `carry`, so it cannot start in its stationary distribution
    at   "a"
    hint say what phase `two` adds: `initial = "estimated"`, or `initial = { mean = 0, sigma = 0 }` for nothing
    "#);
    insta::assert_snapshot!(refusal("", &states(", initial = 'estimated'")), @"accepted");
    insta::assert_snapshot!(refusal("", &states(", initial = { mean = 0, sigma = 0 }")), @"accepted");
}

#[test]
fn carry_into_a_hidden_rate_from_a_state_without_one() {
    let states = "[phases.two.states]\na = { process = 'gauss-markov-2', time_constant = 3, sigma = 1, initial = 'estimated' }\n";
    insta::assert_snapshot!(refusal("", &format!("{states}[phases.two.carry]\na = 'a'\n")), @r#"
    state `a` has a hidden rate, which cannot inherit from state `a`: it has none
    at   "'a'"
    hint write the process as two states, with `derivative`, to say what its rate inherits
    "#);
}

#[test]
fn a_parameter_that_no_phase_uses() {
    insta::assert_snapshot!(refusal("", "[parameters]\nk = 3\n"), @r#"
    parameter `k` is not used
    at   "k"
    "#);
    insta::assert_snapshot!(refusal("", "[phases.two.carry]\na = 'k * a'\n[parameters]\nk = 3\n"), @"accepted");
}

#[test]
fn phases_that_together_are_too_large() {
    let states: String = (0..400).map(|i| format!("s{i} = {{}}\n")).collect();
    let phases: String = (0..6).map(|i| format!("[phases.p{i}]\n")).collect();
    let text = format!(
        "[data]\nphase = 'leg'\n[states]\n{states}[measurements.y]\ncolumn = 'y'\nequation = 's1'\nnoise = 1\n{phases}"
    );
    insta::assert_snapshot!(complete(&text), @r#"
    the model has 2400 states of all phases together, expected at most 2000
    at   "p5"
    "#);
}
