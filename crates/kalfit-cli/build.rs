//! Tells the program which commit it was built from, for `kalfit --version`; nothing where that is not known.

use std::path::Path;
use std::process::Command;

/// Letters of a commit that are shown.
const SHOWN: usize = 10;

fn main() {
    let commit = packaged().or_else(checked_out).unwrap_or_default();
    let shown: String = commit.chars().take(SHOWN).collect();
    println!("cargo::rustc-env=KALFIT_COMMIT={shown}");
    println!("cargo::rerun-if-changed=build.rs");
}

/// The commit that cargo wrote into a package.
fn packaged() -> Option<String> {
    let text = std::fs::read_to_string(".cargo_vcs_info.json").ok()?;
    let after = text.split("\"sha1\"").nth(1)?;
    let commit = after.split('"').nth(1)?;
    commit.bytes().all(|b| b.is_ascii_hexdigit()).then(|| commit.to_owned())
}

/// The commit of a checkout of this project: not of another that this source may be a part of.
fn checked_out() -> Option<String> {
    let root = Path::new("../..");
    if !root.join("crates/kalfit-cli/build.rs").exists() || !root.join(".git").exists() {
        return None;
    }
    for file in ["HEAD", "logs/HEAD"] {
        let path = root.join(".git").join(file);
        if path.exists() {
            println!("cargo::rerun-if-changed={}", path.display());
        }
    }
    let output = Command::new("git").args(["rev-parse", "HEAD"]).current_dir(root).output().ok()?;
    let commit = String::from_utf8(output.stdout).ok()?.trim().to_owned();
    (output.status.success() && commit.bytes().all(|b| b.is_ascii_hexdigit())).then_some(commit)
}
