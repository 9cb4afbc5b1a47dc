//! `--method em` on real files ends where the default method ends.

use crate::folder::{Folder, shown};
use kalfit::FitRecord;

/// Bench gyros: a Gauss-Markov drift whose time constant and level are unknown, noise levels of two stations.
const GYRO: &[u8] = include_bytes!("../reference/inertial-gyro/full.toml");
const ROWS: &[u8] = include_bytes!("../reference/inertial-gyro/data.csv");

/// Two Gauss-Markov states; the noise variances are sums, whose search begins at zero.
const SUMS: &[u8] = include_bytes!("../reference/ssm-continuous3/stationary.toml");
const SUMS_ROWS: &[u8] = include_bytes!("../reference/ssm-continuous3/data.csv");

fn fit((model, rows): (&[u8], &[u8]), options: &str) -> FitRecord {
    let folder = Folder::new(&[("m.toml", model), ("d.csv", rows)]);
    let output = folder.run(&format!("fit m.toml d.csv --out fit.json {options}"));
    let text = std::fs::read_to_string(folder.path("fit.json")).unwrap_or_else(|_| panic!("{}", shown(&output)));
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    serde_json::from_str(&text).expect("fit.json is a record")
}

#[test]
fn em_and_the_default_method_end_at_the_same_point() {
    for files in [(GYRO, ROWS), (SUMS, SUMS_ROWS)] {
        let (em, hybrid) = (fit(files, "--method em"), fit(files, ""));
        assert!(em.converged, "certificate {:?}", em.certificate);
        let (own, other) = (em.log_likelihood, hybrid.log_likelihood);
        assert!((own - other).abs() < 1e-8, "ℓ {own} by EM, {other} by the default method");
        let falls = em.solver.trace.windows(2).filter(|pair| pair[1] < pair[0] - 1e-9).count();
        assert_eq!(falls, 0, "ℓ falls {falls} times: {:?}", em.solver.trace);
    }
}
