//! Parameters that only scale noise are positive without being told, wherever they stand.

use crate::folder::{Folder, shown};
use kalfit::FitRecord;

/// Two effects of sites within a test, drawn anew at the first row of each site.
const SITES: &str = r#"[data]
test = "id"
step_first = true
[states.level]
[states.u]
next = "if(first == 1, 0, u)"
step_noise = "if(first == 1, su, 0)"
initial = { mean = 0, sigma = 0 }
[states.w]
next = "if(first == 1, 0, w)"
step_noise = "if(first == 1, sw, 0)"
initial = { mean = 0, sigma = 0 }
[process_noise_covariance]
"u, w" = "if(first == 1, rho * su * sw, 0)"
[measurements.y]
column = "y"
equation = "level + u + w * x"
noise = "s * gain"
[parameters]
s = {}
su = {}
sw = {}
rho = { start = 0, lower = -1, upper = 1 }
"#;

/// Numbers that look random, between -1 and 1, of variance one third.
fn noise(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

fn data() -> String {
    let mut seed = 7;
    let mut text = "id,first,gain,x,y\n".to_owned();
    for test in 0..8 {
        let level = 3.0 * noise(&mut seed);
        for _ in 0..3 {
            let (u, w) = (0.9 * noise(&mut seed), 0.8 * noise(&mut seed));
            for row in 0..4 {
                let x = f64::from(row % 2);
                let y = level + u + w * x + noise(&mut seed);
                text += &format!("{test},{},1,{x},{y:.3}\n", u8::from(row == 0));
            }
        }
    }
    text
}

#[test]
fn standard_deviations_within_alternatives_and_products_are_positive() {
    let folder = Folder::new(&[("m.toml", SITES.as_bytes()), ("d.csv", data().as_bytes())]);
    let said = shown(&folder.run("check m.toml"));
    for (name, facts) in [
        ("s", "free, not negative"),
        ("su", "free, not negative"),
        ("sw", "free, not negative"),
        ("rho", "free, start 0, at least -1, at most 1"),
    ] {
        assert!(said.contains(&format!("  parameter `{name}`: {facts}\n")), "{name}: {said}");
    }
    let said = shown(&folder.run("fit m.toml d.csv --out fit.json --innovations off"));
    assert!(said.starts_with("exit 0\n"), "{said}");
    let text = std::fs::read_to_string(folder.path("fit.json")).expect("it was written");
    let record: FitRecord = serde_json::from_str(&text).expect("it is a record");
    for parameter in record.parameters.iter().filter(|parameter| parameter.name != "rho") {
        let [low, high] = parameter.interval95.unwrap_or([Some(0.0), Some(0.0)]);
        let (low, high) = (low.unwrap_or(0.0), high.unwrap_or(f64::INFINITY));
        let within = low >= 0.0 && parameter.estimate >= low && parameter.estimate <= high;
        assert!(within, "{}: {} in [{low}, {high}]", parameter.name, parameter.estimate);
        // in logarithms both ends are as far away
        if low > 0.0 {
            let (down, up) = (parameter.estimate / low, high / parameter.estimate);
            assert!((down / up - 1.0).abs() < 1e-6, "{}: {down} and {up}", parameter.name);
        }
    }
    assert!(record.parameters.iter().any(|p| p.interval95.is_some_and(|ends| ends[0].is_some_and(|low| low > 0.0))));
}

#[test]
fn what_is_told_of_a_positive_parameter_must_be_so() {
    for (told, message) in [
        ("su = { start = -1 }", "standard deviation `su` is -1, expected 0 or more"),
        ("su = { start = 0 }", "start of standard deviation `su` is 0, expected more than 0"),
        ("su = { lower = -1 }", "`lower` of standard deviation `su` is -1, expected 0 or more"),
        ("su = -0.5", "standard deviation `su` is -0.5, expected 0 or more"),
    ] {
        let folder = Folder::new(&[("m.toml", SITES.replace("su = {}", told).as_bytes())]);
        let said = shown(&folder.run("check m.toml"));
        assert!(said.starts_with("exit 2\n") && said.contains(message), "{told}: {said}");
    }
    let folder = Folder::new(&[("m.toml", SITES.replace("su = {}", "su = 0").as_bytes())]);
    assert!(shown(&folder.run("check m.toml")).starts_with("exit 0\n"), "zero is no noise");
}
