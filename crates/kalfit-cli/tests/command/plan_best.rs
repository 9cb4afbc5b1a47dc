//! `kalfit plan --candidates`: the best plan, against dense formulas and the cases of theory §15.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit::record::{PlanRecord, PlannedRecord};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};

use crate::folder::{Folder, shown};

/// Three states of an instrument, known by the values of a truth file.
const INSTRUMENT: &str = "[data]\ntest = \"test\"\n[states]\nbias = {}\nscale = {}\ng = {}\n[measurements.y]\ncolumn = \"y\"\n\
                          equation = \"a * bias + b * scale + c * g\"\nnoise = 0.5\n";
const TRUTH: &str = "[mean]\nstart = { bias = 1, scale = 1, g = 1 }\n[covariance]\n\
                     start = [[0.6, 0.3, -0.05], [0.3, 1.0, -0.2], [-0.05, -0.2, 0.1]]\n";

/// Name, cost, largest number and rows of each kind of test.
const KINDS: [(&str, u32, u32, &[[f64; 3]]); 4] = [
    ("static", 1, 12, &[[1.0, 0.0, 1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    ("rate", 2, 8, &[[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]),
    ("tumble", 3, 5, &[[1.0, 0.5, 1.0], [1.0, -0.5, -1.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.5]]),
    ("centrifuge", 5, 3, &[[1.0, 0.0, 5.0], [1.0, 0.2, 10.0], [1.0, 0.0, 0.0]]),
];

fn rows(test: &str, rows: &[[f64; 3]], last: &str) -> String {
    rows.iter().map(|[a, b, c]| format!("{test},{a},{b},{c},0{last}\n")).collect()
}

fn instruments() -> Folder {
    let kinds: String =
        KINDS.iter().map(|(name, cost, most, own)| rows(name, own, &format!(",{cost},{most}"))).collect();
    let bare: String = KINDS.iter().map(|(name, _, _, own)| rows(name, own, "")).collect();
    let made: String =
        (0..3).flat_map(|k| KINDS[..2].iter().map(move |own| rows(&format!("{}{k}", own.0), own.3, ""))).collect();
    let files = [
        ("i.toml", INSTRUMENT.to_owned()),
        ("truth.toml", format!("{INSTRUMENT}{TRUTH}")),
        ("kinds.csv", format!("test,a,b,c,y,cost,most\n{kinds}")),
        ("bare.csv", format!("test,a,b,c,y\n{bare}")),
        ("made.csv", format!("test,a,b,c,y\n{made}")),
    ];
    Folder::new(&files.each_ref().map(|(name, text)| (*name, text.as_bytes())))
}

fn planned(folder: &Folder, args: &str) -> PlanRecord {
    let mut command = folder.command("plan");
    // figures have spaces in them
    let args: Vec<&str> = args.split(' ').map(|word| word.trim_matches('\'')).collect();
    let output =
        command.args(args.iter().map(|word| word.replace('~', " "))).args(["--out", "plan.json"]).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{args:?}: {}", shown(&output));
    serde_json::from_str(&std::fs::read_to_string(folder.path("plan.json")).unwrap()).unwrap()
}

/// (Relaxed number, whole number) of each candidate, by its name.
fn numbers(plan: &PlanRecord) -> Vec<(String, f64, usize)> {
    let best = plan.best.as_ref().unwrap();
    best.candidates.iter().map(|one| (one.name.clone(), one.relaxed, one.tests)).collect()
}

fn quantity<'a>(plan: &'a PlanRecord, name: &str) -> &'a PlannedRecord {
    plan.quantities.iter().find(|one| one.name(false) == name).unwrap_or_else(|| panic!("no {name}"))
}

/// Theory §15, case 1: three of each of the first two kinds are there; a budget of 20.
#[test]
fn plans_of_instruments_are_those_of_the_theory() {
    let folder = instruments();
    let base = "i.toml --from truth.toml --candidates kinds.csv --budget 20 --with made.csv --for";
    // candidates are in the order of their names: centrifuge, rate, static, tumble
    for (goal, relaxed, whole, log_phi) in [
        ("D", [0.0, 0.0, 7.5985, 4.1338], [0, 0, 8, 4], 3.229_460_251_723),
        ("sd(scale)", [0.0, 8.0, 0.0, 1.3333], [0, 8, 1, 1], 2.936_254_979_958),
        ("corr(scale,bias)", [0.0, 8.0, 0.0, 1.3333], [0, 8, 1, 1], 2.469_754_821_347),
        ("A", [0.0, 2.2507, 11.1598, 1.4463], [0, 3, 11, 1], 1.054_659_416_705),
    ] {
        let plan = planned(&folder, &format!("{base} {goal}"));
        let best = plan.best.as_ref().unwrap();
        near::absolute(goal, best.log_phi, log_phi, 1e-8);
        for ((name, found, tests), (relaxed, whole)) in numbers(&plan).into_iter().zip(relaxed.into_iter().zip(whole)) {
            near::absolute(&name, found, relaxed, 1e-3);
            assert_eq!(tests, whole, "{goal}: {name}");
        }
        assert!(best.optimal_in_whole_numbers && best.gap < 1e-8 && best.cost <= 20.0, "{best:?}");
        let bound = (best.log_phi - best.log_phi_relaxed).exp();
        near::relative("efficiency", best.efficiency_bound, bound, 1e-8);
    }
    let plan = planned(&folder, &format!("{base} sd(scale)"));
    let scale = quantity(&plan, "sd(scale)");
    near::relative("now", scale.std_error_before.unwrap(), 0.457_80, 1e-5);
    near::relative("planned", scale.std_error[0].unwrap(), 0.230_356_426_3, 1e-8);
    assert_eq!(quantity(&plan, "corr(scale, g)").informed_by.as_deref(), Some("tumble"));
}

/// The value of an output at a row of a mission, and the limit that 95 % of tests stay below, by the formulas of a Gaussian
/// vector.
#[test]
fn values_of_a_mission_are_figures() {
    let folder = instruments();
    folder.write("mission.csv", b"test,a,b,c\nflight,1,0,0\nflight,1,2,0.5\n");
    folder.write("out.toml", b"[outputs.angle]\nequation = \"a * bias + b * scale + c * g\"\n");
    let base = "i.toml --from truth.toml --candidates kinds.csv --budget 20 --with made.csv --mission mission.csv --outputs out.toml";
    let plan = planned(&folder, &format!("{base} --for limit(angle,2)"));
    let sigma = DMatrix::from_row_slice(3, 3, &[0.6, 0.3, -0.05, 0.3, 1.0, -0.2, -0.05, -0.2, 0.1]);
    let pairs: Vec<(usize, usize)> = (0..3).flat_map(|a| (a..3).map(move |b| (a, b))).collect();
    let element = |&(a, b): &(usize, usize)| {
        let mut s = DMatrix::zeros(3, 3);
        (s[(a, b)], s[(b, a)]) = (1.0, 1.0);
        s
    };
    let (mut of_means, mut of_sigma) = (DMatrix::zeros(3, 3), DMatrix::zeros(6, 6));
    let made = [("static", 3), ("rate", 3)];
    let chosen = numbers(&plan).into_iter().map(|(name, _, n)| (name, n));
    for (name, n) in chosen.chain(made.map(|(name, n)| (name.to_owned(), n))) {
        let rows = KINDS.iter().find(|kind| kind.0 == name).unwrap().3;
        let j = rows.iter().fold(DMatrix::zeros(3, 3), |sum, row| {
            let h = DVector::from_row_slice(row);
            sum + &h * h.transpose() / 0.25
        });
        let w = (DMatrix::identity(3, 3) + &j * &sigma).try_inverse().unwrap() * j;
        let of = |k: usize, l: usize| 0.5 * (&w * element(&pairs[k]) * &w * element(&pairs[l])).trace();
        of_means += &w * n as f64;
        of_sigma += DMatrix::from_fn(6, 6, of) * n as f64;
    }
    let x = DVector::from_vec(vec![1.0, 2.0, 0.5]);
    let std_dev = x.dot(&(&sigma * &x)).sqrt();
    let by_sigma = DVector::from_iterator(6, pairs.iter().map(|pair| x.dot(&(element(pair) * &x)) / (2.0 * std_dev)));
    let of_mean = x.dot(&(of_means.try_inverse().unwrap() * &x));
    let of_spread = by_sigma.dot(&(of_sigma.try_inverse().unwrap() * &by_sigma));
    let quantile = 1.644_853_626_951_472_7;
    for (name, value, error) in [
        ("output(angle, 2)", 3.5, of_mean.sqrt()),
        ("limit(angle, 2)", 3.5 + quantile * std_dev, (of_mean + quantile * quantile * of_spread).sqrt()),
    ] {
        let found = quantity(&plan, name);
        near::relative(name, found.value.unwrap(), value, 1e-9);
        near::relative(name, found.std_error[0].unwrap(), error, 1e-7);
    }
    near::relative(
        "a state",
        quantity(&plan, "output(bias, 1)").std_error[0].unwrap(),
        quantity(&plan, "mean(bias)").std_error[0].unwrap(),
        1e-9,
    );
    folder.write("mission.csv", b"test,a,b,c\nx,1,0,0\ny,1,2,0.5\n");
    let output = folder.run(&format!("plan {base}"));
    assert!(shown(&output).contains("the mission has 2 tests, expected one"), "{}", shown(&output));
}

/// Units at cost 5 with m tests at cost 1, spread 1 of units and 2 of tests: theory §15, case 2.
#[test]
fn units_have_as_many_tests_as_their_costs_ask_for() {
    let model = "[data]\ntest = \"run\"\nlevels = [\"unit\"]\n[states]\nlevel = {}\n[measurements.y]\ncolumn = \"y\"\n\
                 equation = \"level\"\nnoise = 0.1\n";
    let truth = format!(
        "{model}[mean]\nstart = {{ level = 1 }}\n[covariance]\nstart = [[4]]\n[levels.unit.covariance]\nstart = [[1]]\n"
    );
    let rows = (1..=14).flat_map(|m| (0..m).map(move |k| format!("m{m:02},m{m:02}r{k},0,{}\n", 5 + m)));
    let table = "unit,run,y,cost\n".to_owned() + &rows.collect::<String>();
    let files = [("l.toml", model), ("truth.toml", &truth), ("units.csv", &table)];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    let base = "l.toml --from truth.toml --candidates units.csv --budget 200 --for";
    for (goal, chosen, log_phi) in [
        ("mean(level)", vec![("m05", 20)], 2.406_835_114_458),
        ("sd(unit.level)", vec![("m09", 10), ("m10", 4)], 2.602_580_515_198),
        ("D", vec![("m09", 10), ("m10", 4)], 1.596_570_116_695),
    ] {
        let plan = planned(&folder, &format!("{base} {goal}"));
        let found: Vec<(String, usize)> =
            numbers(&plan).into_iter().filter(|one| one.2 > 0).map(|one| (one.0, one.2)).collect();
        assert_eq!(found, chosen.iter().map(|(name, n)| ((*name).to_owned(), *n)).collect::<Vec<_>>(), "{goal}");
        let best = plan.best.as_ref().unwrap();
        assert!(best.optimal_in_whole_numbers, "{best:?}");
        near::absolute(goal, best.log_phi, log_phi, 1e-8);
    }
}

/// y_k = bias + f^k decay + e_k: all information by the formulas of a Gaussian vector (15.1), with f and the noise free.
#[test]
fn free_parameters_are_planned_for_as_the_joint_gaussian_says() {
    let model = "[data]\ntest = \"test\"\n[states]\nbias = {}\ndecay = { next = \"f * decay\" }\n[measurements.y]\ncolumn = \"y\"\n\
                 equation = \"bias + decay\"\nnoise = \"s\"\n[parameters]\nf = { start = 0.8 }\ns = { start = 0.3 }\n";
    let truth =
        format!("{model}[mean]\nstart = {{ bias = 1, decay = 2 }}\n[covariance]\nstart = [[0.5, 0.1], [0.1, 0.8]]\n");
    let table = |test: &str, n: usize| format!("{test},0\n").repeat(n);
    let data = format!("test,y\n{}{}", table("long", 9), table("short", 4));
    let files = [("f.toml", model), ("truth.toml", &truth), ("d.csv", &data)];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    let plan = planned(&folder, "f.toml --from truth.toml --candidates d.csv --budget 60");
    let (f, s) = (0.8f64, 0.3f64);
    let mu = DVector::from_vec(vec![1.0, 2.0]);
    let sigma = DMatrix::from_row_slice(2, 2, &[0.5, 0.1, 0.1, 0.8]);
    let of = |n: usize| {
        let h = DMatrix::from_fn(n, 2, |k, c| if c == 0 { 1.0 } else { f.powi(k as i32) });
        let h_f = DMatrix::from_fn(n, 2, |k, c| if c == 0 || k == 0 { 0.0 } else { k as f64 * f.powi(k as i32 - 1) });
        let inverse = (&h * &sigma * h.transpose() + DMatrix::identity(n, n) * s * s).try_inverse().unwrap();
        let one = |i: usize, j: usize| {
            let mut element = DMatrix::zeros(2, 2);
            (element[(i, j)], element[(j, i)]) = (1.0, 1.0);
            &h * element * h.transpose()
        };
        let by_f = &h_f * &sigma * h.transpose();
        let none = || (DVector::zeros(n), DMatrix::zeros(n, n));
        // derivatives of mean and covariance by bias, decay, Σ, f and s
        let by = [
            (h.column(0).into_owned(), none().1),
            (h.column(1).into_owned(), none().1),
            (none().0, one(0, 0)),
            (none().0, one(0, 1)),
            (none().0, one(1, 1)),
            (&h_f * &mu, &by_f + by_f.transpose()),
            (none().0, DMatrix::identity(n, n) * 2.0 * s),
        ];
        DMatrix::from_fn(7, 7, |a, b| {
            let turned = |v: &DMatrix<f64>| &inverse * v;
            by[a].0.dot(&(&inverse * &by[b].0)) + 0.5 * (turned(&by[a].1) * turned(&by[b].1)).trace()
        })
    };
    let counts: Vec<f64> = numbers(&plan).iter().map(|one| one.2 as f64).collect();
    let covariance = (of(9) * counts[0] + of(4) * counts[1]).try_inverse().unwrap();
    let error = |k: usize| covariance[(k, k)].sqrt();
    for (name, expected) in [
        ("mean(bias)", error(0)),
        ("mean(decay)", error(1)),
        ("cov(bias, bias)", error(2)),
        ("cov(decay, decay)", error(4)),
        ("sd(decay)", error(4) / 2.0 / 0.8f64.sqrt()),
        ("f", error(5)),
        ("s", error(6)),
    ] {
        near::relative(name, quantity(&plan, name).std_error[0].unwrap(), expected, 1e-6);
    }
    // no plan is better: the certificate by these matrices
    let best = plan.best.as_ref().unwrap();
    let relaxed: Vec<f64> = best.candidates.iter().map(|one| one.relaxed).collect();
    let inverse = (of(9) * relaxed[0] + of(4) * relaxed[1]).try_inverse().unwrap();
    let gain = [of(9), of(4)].map(|unit| (&inverse * unit).trace() * 60.0 / 7.0);
    near::absolute("certificate", gain[0].max(gain[1]), 1.0, 1e-6);
    near::absolute("sensitivity", best.candidates[1].sensitivity, gain[1], 1e-6);
}

/// What a fit knows is what its tests tell.
#[test]
fn a_fit_stands_for_its_tests() {
    let folder = Folder::new(&[]);
    folder.copy("../../examples/gyro-bench/bench.toml");
    folder.copy("../../examples/gyro-bench/bench.csv");
    let output = folder.run("fit bench.toml bench.csv --std-errors expected --out fit.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let base = "bench.toml --from fit.json --candidates bench.csv --budget 9 --for sd(bias)";
    let [fit, data] = ["fit.json", "bench.csv"].map(|with| planned(&folder, &format!("{base} --with {with}")));
    assert_eq!(
        numbers(&fit).iter().map(|one| one.2).collect::<Vec<_>>(),
        numbers(&data).iter().map(|one| one.2).collect::<Vec<_>>()
    );
    for (one, other) in fit.quantities.iter().zip(&data.quantities) {
        let name = one.name(false);
        near::relative(&name, one.std_error_before.unwrap(), other.std_error_before.unwrap(), 1e-5);
        near::relative(&name, one.std_error[0].unwrap(), other.std_error[0].unwrap(), 1e-5);
    }
    let drawn = planned(&folder, &format!("{base} --draws 10 --seed 3"));
    let again = planned(&folder, &format!("{base} --draws 10 --seed 3"));
    assert_eq!(drawn, again);
    assert_eq!(drawn.best.as_ref().unwrap().draws.unwrap().count, 10);
    assert!(drawn.best.unwrap().gap < 1e-8);
    let command = again.best.unwrap().simulate.unwrap();
    let expected =
        "kalfit simulate bench.toml --from fit.json --design bench.csv --plan plan.json --seed 1 --out drawn.csv";
    assert_eq!(command, expected);
    let output =
        folder.run("simulate bench.toml --from fit.json --design bench.csv --plan plan.json --seed 1 --out drawn.csv");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let ids: std::collections::BTreeSet<String> =
        folder.table("drawn.csv").iter().map(|row| row["unit"].clone()).collect();
    assert_eq!(ids.len(), 9, "{ids:?}");
}

/// The order of rows changes nothing; a table without costs has tests of cost 1.
#[test]
fn the_order_of_candidates_changes_nothing() {
    let folder = instruments();
    let base = "i.toml --from truth.toml --budget 12 --with made.csv --candidates";
    let plain = planned(&folder, &format!("{base} bare.csv"));
    let text = std::fs::read_to_string(folder.path("bare.csv")).unwrap();
    let (head, body) = text.split_once('\n').unwrap();
    let mut lines: Vec<&str> = body.lines().collect();
    lines.rotate_left(5);
    folder.write("bare.csv", format!("{head}\n{}\n", lines.join("\n")).as_bytes());
    let turned = planned(&folder, &format!("{base} bare.csv"));
    assert_eq!(plain.best, turned.best);
    assert_eq!(plain.quantities, turned.quantities);
    assert!(plain.best.unwrap().candidates.iter().all(|one| one.cost == 1.0 && one.most.is_none()));
}

#[test]
fn what_is_not_possible_is_said() {
    let folder = instruments();
    folder.write("cost.csv", b"test,a,b,c,y,cost\nx,1,0,0,0,free\nx,1,0,1,0,free\n");
    folder.write("two.csv", b"test,a,b,c,y,cost\nx,1,0,0,0,1\nx,1,0,1,0,2\n");
    folder.write("bias.csv", b"test,a,b,c,y\nx,1,0,0,0\nx,1,0,0,0\n");
    let fixed = format!("{INSTRUMENT}[mean]\nfixed = {{ bias = 1 }}\n");
    folder.write("fixed.toml", fixed.as_bytes());
    let none = format!("{INSTRUMENT}[mean]\nfixed = {{ bias = 1, scale = 1, g = 1 }}\n");
    folder.write("none.toml", none.as_bytes());
    // Σ as of the truth, but for the covariance that is fixed
    let zero = format!("{INSTRUMENT}[covariance]\nfixed = {{ \"bias, g\" = -0.05 }}\n");
    folder.write("zero.toml", zero.as_bytes());
    for (args, message) in [
        ("i.toml --candidates kinds.csv --budget 0.5", "the budget is 0.5, and the cheapest candidate costs 1"),
        (
            "i.toml --candidates cost.csv --budget 9",
            "candidate `x` has `free` in column `cost`, expected a number above zero",
        ),
        ("i.toml --candidates two.csv --budget 9", "candidate `x` has `1` and `2` in column `cost`"),
        ("i.toml --candidates bias.csv --budget 9", "no candidate informs mean(scale), mean(g), sd(scale)"),
        (
            "i.toml --candidates bias.csv --budget 9 --for sd(scale)",
            "no candidate informs sd(scale), and nothing is known of it yet",
        ),
        ("i.toml --candidates kinds.csv --budget 9 --for sd(skale)", "did you mean `sd(scale)`?"),
        (
            "i.toml --candidates kinds.csv --budget 9 --most how_many",
            "kinds.csv has no column `how_many`, which is used in `--most`",
        ),
        ("i.toml --candidates kinds.csv --budget 9 --draws 5", "`--draws` draws parameters by the errors of a fit"),
        ("i.toml --candidates kinds.csv --budget 1", "no plan in whole numbers within the budget of 1 determines all"),
        ("fixed.toml --candidates kinds.csv --budget 9 --for mean(bias)", "the model fixes mean(bias)"),
        ("i.toml --budget 9", "--candidates"),
        ("i.toml --candidates kinds.csv", "--budget"),
        ("i.toml --candidates kinds.csv --budget 9 --tests 5", "cannot be used with"),
    ] {
        let output = folder.run(&format!("plan {args} --from truth.toml"));
        let text = shown(&output);
        assert!(matches!(output.status.code(), Some(1 | 2)), "{args}: {text}");
        assert!(text.split_whitespace().collect::<Vec<_>>().join(" ").contains(message), "{args}: {text}");
    }
}
