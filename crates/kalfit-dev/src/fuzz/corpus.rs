//! Sound files of every kind that kalfit reads, made by kalfit from its starter models, and the commands that read them.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::damage::DamageKind;

/// Starter models.
const TEMPLATES: [&str; 5] = ["random-coefficients", "meta-analysis", "gyro-bench", "static-imu", "two-phase"];

/// What is damaged, and the commands that read it.
pub(super) struct FuzzSubject {
    /// Its name in the tally of runs: model, CSV, rows, Parquet, Arrow, exchange, results.
    pub(super) kind: &'static str,
    pub(super) damage: DamageKind,
    /// Its name in the folder of a run.
    pub(super) name: &'static str,
    pub(super) bytes: Vec<u8>,
    /// Words of the command line; `@` is what is damaged, and other files are in the folder of the corpus.
    pub(super) lines: Vec<Vec<String>>,
    /// The folder of the corpus with the sound files beside it.
    pub(super) folder: PathBuf,
}

pub(super) struct FuzzCorpus {
    pub(super) kalfit: PathBuf,
    pub(super) subjects: Vec<FuzzSubject>,
}

impl FuzzCorpus {
    /// Makes the sound files in a folder, anew.
    pub(super) fn new(kalfit: &Path, folder: &Path) -> Result<FuzzCorpus, String> {
        let _ = std::fs::remove_dir_all(folder); // of an earlier campaign, if any
        let mut corpus = FuzzCorpus { kalfit: kalfit.to_owned(), subjects: Vec::new() };
        for template in TEMPLATES {
            corpus.add(template, folder.join(template))?;
        }
        Ok(corpus)
    }

    fn add(&mut self, template: &str, folder: PathBuf) -> Result<(), String> {
        std::fs::create_dir_all(&folder).map_err(|error| error.to_string())?;
        let (model, data) = (format!("{template}.toml"), format!("{template}.csv"));
        for line in [
            format!("init {template} ."),
            format!("fit {model} {data} --out fit.json"),
            format!("simulate {model} --from fit.json --design {data} --seed 1 --out drawn.parquet"),
            format!("simulate {model} --from fit.json --design {data} --seed 2 --out drawn.arrow"),
        ] {
            self.make(&folder, &line)?;
        }
        let mut subjects = vec![
            (
                "model",
                DamageKind::Text,
                "m.toml",
                model.clone(),
                vec![
                    "check @".to_owned(),
                    format!("check @ {data}"),
                    format!("fit @ {data} --max-iterations 30 --out out.json --report out.html"),
                    format!("simulate @ --from fit.json --design {data} --seed 1 --out out.csv"),
                    "export @ --from fit.json --as c --out out.h".to_owned(),
                ],
            ),
            (
                "CSV",
                DamageKind::Text,
                "d.csv",
                data.clone(),
                vec![
                    format!("check {model} @"),
                    format!("fit {model} @ --max-iterations 30 --out out.json --tests out.parquet"),
                    format!("apply {model} @ --from fit.json --out out.csv"),
                    format!("plan {model} --from fit.json --candidates @ --budget 3 --out out.json"),
                ],
            ),
            (
                "rows",
                DamageKind::Rows,
                "d.csv",
                data.clone(),
                vec![
                    format!("check {model} @"),
                    format!("fit {model} @ --no-tests --max-iterations 30 --out out.json"),
                    format!("fit {model} @ --max-iterations 30 --out out.json --tests out.parquet"),
                    format!("apply {model} @ --from fit.json --out out.csv"),
                    format!("predict {model} --from fit.json --design @ --out out.parquet"),
                    format!("simulate {model} --from fit.json --design @ --seed 1 --out out.parquet"),
                ],
            ),
            ("Parquet", DamageKind::Bytes, "d.parquet", "drawn.parquet".to_owned(), vec![format!("check {model} @")]),
            ("Arrow", DamageKind::Bytes, "d.arrow", "drawn.arrow".to_owned(), vec![format!("check {model} @")]),
            (
                "results",
                DamageKind::Json,
                "fit.json",
                "fit.json".to_owned(),
                vec![
                    "report @ --out out.html".to_owned(),
                    "compare @ fit.json --out out.json".to_owned(),
                    format!("apply {model} {data} --from @ --out out.csv"),
                    format!("predict {model} --from @ --design {data} --out out.parquet"),
                    format!("simulate {model} --from @ --design {data} --seed 1 --out out.csv"),
                    format!("plan {model} --from @ --design {data} --tests 5,10 --out out.json"),
                    format!("plan {model} --from @ --candidates {data} --budget 3 --with @ --out out.json"),
                    format!("export {model} --from @ --as c --out out.h"),
                    format!("export {model} --from @ --as json --out out.json"),
                ],
            ),
        ];
        // models with free dynamic parameters have none
        if self.make(&folder, &format!("reduce {model} {data} --out r.parquet")).is_ok() {
            let line = format!("fit {model} @ --max-iterations 30 --out out.json");
            subjects.push(("exchange", DamageKind::Bytes, "r.parquet", "r.parquet".to_owned(), vec![line]));
        }
        // not of models in phases
        if self.make(&folder, &format!("sums {model} {data} --out site.sums")).is_ok() {
            let lines =
                vec![format!("join {model} @ --out out.json"), format!("join {model} @ site.sums --out out.json")];
            subjects.push(("sums", DamageKind::Json, "s.sums", "site.sums".to_owned(), lines));
        }
        if self
            .make(&folder, &format!("plan {model} --from fit.json --candidates {data} --budget 3 --out plan.json"))
            .is_ok()
        {
            let lines = vec![
                format!("simulate {model} --from fit.json --design {data} --plan @ --seed 1 --out out.csv"),
                "plot @ --what sensitivities --out out.svg".to_owned(),
            ];
            subjects.push(("plan", DamageKind::Json, "plan.json", "plan.json".to_owned(), lines));
        }
        for (kind, damage, name, file, lines) in subjects {
            let place = folder.join(&file);
            let bytes = std::fs::read(&place).map_err(|error| format!("{}: {error}", place.display()))?;
            let lines = lines.iter().map(|line| line.split(' ').map(str::to_owned).collect()).collect();
            self.subjects.push(FuzzSubject { kind, damage, name, bytes, lines, folder: folder.clone() });
        }
        Ok(())
    }

    /// Runs a command that must succeed, or end without a certificate.
    fn make(&self, folder: &Path, line: &str) -> Result<(), String> {
        let mut command = Command::new(&self.kalfit);
        let output = command.args(line.split(' ')).current_dir(folder).output().map_err(|error| error.to_string())?;
        match output.status.code() {
            Some(0 | 1) => Ok(()),
            _ => Err(format!("kalfit {line}: {}", String::from_utf8_lossy(&output.stderr))),
        }
    }
}
