//! What the first row of a test must hold.

use crate::folder::{Folder, shown};

#[test]
fn a_stationary_start_needs_no_cells_of_other_states() {
    let model = r#"
[data]
test = "id"
time = "t"
[states]
a = { derivative = "u" }
b = { next = "b + u / dt" }
d = { process = "gauss-markov", time_constant = "2", sigma = "s" }
[measurements.y]
column = "y"
equation = "a + b * t + d"
noise = 0.1
[parameters]
s = { value = 1, per = "k", fixed = { A = 0.5 } }
"#;
    // no step leads to the first rows: there is no u, and dt is zero
    let data = "id,t,k,u,y\n1,0,A,,1\n1,1,A,2,3\n2,0,B,,0\n2,1,B,1,1.5\n3,0,B,,1\n3,1,B,1,-1\n";
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
    let output = folder.run("fit m.toml d.csv");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    // but its own are needed
    let folder =
        Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.replace("1,0,A,,1", "1,0,,,1").as_bytes())]);
    let output = folder.run("fit m.toml d.csv");
    assert_eq!(output.status.code(), Some(2), "{}", shown(&output));
    assert!(shown(&output).contains("`k`"), "{}", shown(&output));
}
