//! The peers: their scripts, run as child processes where they are installed.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::answer::PeerAnswer;
use super::clock;
use super::whole::path;

/// Where the models and the peers' scripts are.
pub(super) fn scripts() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("peers")
}

/// The language of a script.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ScriptLanguage {
    R,
    Python,
}

/// A script that fits with a peer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Peer {
    /// Its package.
    pub(crate) name: &'static str,
    /// What of it is run.
    pub(crate) what: &'static str,
    pub(crate) language: ScriptLanguage,
    /// The script and what follows the data file.
    pub(crate) script: &'static str,
    pub(crate) arguments: &'static [&'static str],
    /// What installs it.
    pub(crate) install: &'static str,
}

const fn r(name: &'static str, what: &'static str, script: &'static str, install: &'static str) -> Peer {
    Peer { name, what, language: ScriptLanguage::R, script, arguments: &[], install }
}

const fn python(name: &'static str, what: &'static str, script: &'static str, install: &'static str) -> Peer {
    Peer { name, what, language: ScriptLanguage::Python, script, arguments: &[], install }
}

const METAFOR: Peer = r("metafor", "`rma.mv`", "metafor.R", "apt install r-cran-metafor");

pub(super) const LME4: Peer = r("lme4", "`lmer`", "lme4.R", "apt install r-cran-lme4");
pub(super) const LME4_CROSSED: Peer = Peer { script: "lme4_crossed.R", ..LME4 };
pub(super) const NLME: Peer = r("nlme", "`lme`", "nlme.R", "apt install r-cran-nlme");
pub(super) const OPENMX: Peer = r("OpenMx", "RAM", "openmx.R", "apt install r-cran-openmx");
pub(super) const METAFOR_DENSE: Peer = Peer { arguments: &["dense"], ..METAFOR };
pub(super) const METAFOR_SPARSE: Peer = Peer { what: "`rma.mv`, sparse", arguments: &["sparse"], ..METAFOR };
pub(super) const STATSMODELS: Peer =
    Peer { arguments: &["statsmodels"], ..python("statsmodels", "`MixedLM`", "mixedlm.py", "pip install statsmodels") };
pub(super) const MIXEDLM_RS: Peer =
    Peer { arguments: &["mixedlm-rs"], ..python("mixedlm-rs", "`MixedLM`", "mixedlm.py", "pip install mixedlm-rs") };
pub(super) const CELERITE: Peer = python("celerite2", "`log_likelihood`", "celerite.py", "pip install celerite2");
pub(super) const POLARS: Peer = python("polars", "`read_parquet`, `group_by`", "polars_sums.py", "pip install polars");
pub(super) const DYNAMAX: Peer =
    python("dynamax", "jit and vmap", "dynamax_filter.py", "pip install dynamax 'jax[cpu]'");
pub(super) const PYKALMAN: Peer = python("pykalman", "`loglikelihood`", "pykalman_filter.py", "pip install pykalman");

/// What came of a peer.
#[derive(Debug)]
pub(crate) enum PeerOutcome {
    Answered(PeerAnswer),
    Missing,
}

/// Which programs to run.
#[derive(Debug)]
pub(crate) struct Interpreters {
    pub(crate) rscript: String,
    pub(crate) python: String,
}

/// The status by which a script says that a package is missing.
const MISSING: i32 = 77;

impl Peer {
    /// The answer with the median time of up to three runs.
    pub(super) fn answer(&self, interpreters: &Interpreters, data: &Path) -> Result<PeerOutcome, String> {
        let PeerOutcome::Answered(first) = self.run(interpreters, data)? else { return Ok(PeerOutcome::Missing) };
        let mut first = Some(first);
        let answer = clock::median(
            3,
            |answer: &PeerAnswer| answer.taken,
            || match first.take() {
                Some(answer) => Ok(answer),
                None => match self.run(interpreters, data)? {
                    PeerOutcome::Answered(answer) => Ok(answer),
                    PeerOutcome::Missing => Err(format!("{}: it was there and is no more", self.name)),
                },
            },
        )?;
        Ok(PeerOutcome::Answered(answer))
    }

    fn run(&self, interpreters: &Interpreters, data: &Path) -> Result<PeerOutcome, String> {
        let program = match self.language {
            ScriptLanguage::R => &interpreters.rscript,
            ScriptLanguage::Python => &interpreters.python,
        };
        let mut command = Command::new(program);
        command.arg(self.script).arg(path(data)?).args(self.arguments).current_dir(scripts());
        // one core against one core
        for name in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"] {
            command.env(name, "1");
        }
        command.env("PYTHONDONTWRITEBYTECODE", "1");
        let output = match command.output() {
            Ok(output) => output,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(PeerOutcome::Missing),
            Err(error) => return Err(format!("{program}: {error}")),
        };
        match output.status.code() {
            Some(0) => {}
            Some(MISSING) => return Ok(PeerOutcome::Missing),
            _ => return Err(format!("{}: {}\n{}", self.name, output.status, last_lines(&output.stderr))),
        }
        let answer = PeerAnswer::parse(&String::from_utf8_lossy(&output.stdout));
        answer.map(PeerOutcome::Answered).map_err(|why| format!("{}: {why}", self.name))
    }
}

fn last_lines(text: &[u8]) -> String {
    let text = String::from_utf8_lossy(text);
    let lines: Vec<&str> = text.lines().collect();
    lines[lines.len().saturating_sub(5)..].join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Peer; 12] = [
        LME4,
        LME4_CROSSED,
        NLME,
        OPENMX,
        METAFOR_DENSE,
        METAFOR_SPARSE,
        STATSMODELS,
        MIXEDLM_RS,
        DYNAMAX,
        PYKALMAN,
        CELERITE,
        POLARS,
    ];

    #[test]
    fn every_peer_has_its_script_and_the_script_says_what_is_missing() {
        for peer in ALL {
            let text = std::fs::read_to_string(scripts().join(peer.script)).unwrap();
            let says = match peer.language {
                ScriptLanguage::R => "needs(",
                ScriptLanguage::Python => "common.missing()",
            };
            assert!(text.contains(says), "{}", peer.script);
        }
    }

    #[test]
    fn a_peer_whose_interpreter_is_not_there_is_missing() {
        let none = "no-such-interpreter".to_owned();
        let interpreters = Interpreters { rscript: none.clone(), python: none };
        for peer in ALL {
            let outcome = peer.run(&interpreters, Path::new("data.csv")).unwrap();
            assert!(matches!(outcome, PeerOutcome::Missing), "{}: {outcome:?}", peer.name);
        }
    }
}
