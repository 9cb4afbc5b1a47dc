//! What is made of a seed, and what reads it.

use std::path::{Path, PathBuf};

use kalfit::{Labels, Test};
use kalfit_data::{Datum, Input, TestSink};
use kalfit_job::{CheckJob, CompareJob, Document, ReportJob, Unwatched};
use kalfit_spec::Spec;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::corpus::{FuzzCorpus, FuzzSubject};
use super::damage;
use super::fits::{self, model};

/// Pieces of expressions, of which random ones are put together.
const PIECES: [&str; 40] = [
    "level", "slope", "x", "y", "t", "dt", "sigma", "tau", "lot", "nothing", "(", ")", "+", "-", "*", "/", "^", "**",
    " ", ",", "exp(", "sqrt(", "log(", "abs(", "sin(", "if(", "d(", "1", "0", "2.5", "1e300", "1e-320", "9e999", ".5",
    "-1", "==", "<", "\"A\"", "µ", "'",
];

/// Bytes of an input, at most.
const LARGEST: usize = 1 << 20;

/// What a seed makes.
#[derive(Debug)]
pub(super) struct FuzzInput {
    /// Models, expressions, CSV, Parquet, Arrow, exchange, results or fits.
    pub(super) kind: &'static str,
    /// The name of its file.
    pub(super) name: String,
    pub(super) bytes: Vec<u8>,
    /// The model that reads it, as a text, where it is not one.
    model: String,
    /// The sound results beside it.
    beside: PathBuf,
}

pub(super) struct FuzzTargets {
    subjects: Vec<(SoundFile, String)>,
}

/// A sound file.
struct SoundFile {
    kind: &'static str,
    damage: damage::DamageKind,
    name: &'static str,
    bytes: Vec<u8>,
    folder: PathBuf,
}

impl FuzzTargets {
    pub(super) fn new(corpus: &FuzzCorpus) -> Result<FuzzTargets, String> {
        let of = |subject: &FuzzSubject| {
            let template = subject.folder.file_name().map(|name| name.to_string_lossy().into_owned());
            let model = subject.folder.join(format!("{}.toml", template.unwrap_or_default()));
            let text = std::fs::read_to_string(&model).map_err(|error| format!("{}: {error}", model.display()))?;
            let FuzzSubject { kind, damage, name, bytes, folder, .. } = subject;
            Ok((SoundFile { kind, damage: *damage, name, bytes: bytes.clone(), folder: folder.clone() }, text))
        };
        Ok(FuzzTargets { subjects: corpus.subjects.iter().map(of).collect::<Result<_, String>>()? })
    }

    /// The input of a seed.
    pub(super) fn input(&self, seed: u64) -> FuzzInput {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (sound, model) = &self.subjects[random.random_range(0..self.subjects.len())];
        let (model, beside) = (model.clone(), sound.folder.join("fit.json"));
        match random.random_range(0..16_u32) {
            0 => {
                let (model, rows) = fits::drawn(&mut random);
                FuzzInput { kind: "fits", name: "f.csv".to_owned(), bytes: rows.into_bytes(), model, beside }
            }
            1..=3 => {
                let text = expressions(&mut random);
                FuzzInput { kind: "expressions", name: "e.toml".to_owned(), bytes: text.into_bytes(), model, beside }
            }
            _ => {
                let mut bytes = damage::damaged(&mut random, &sound.bytes, sound.damage);
                bytes.truncate(LARGEST); // a text that is repeated again and again has hundreds of megabytes
                FuzzInput { kind: sound.kind, name: sound.name.to_owned(), bytes, model, beside }
            }
        }
    }

    /// Whether an input was read, or the words for what was wrong with it. It may write into a folder.
    pub(super) fn run(&self, input: &FuzzInput, folder: &Path) -> Result<bool, String> {
        match input.kind {
            "model" | "expressions" => {
                let Ok(text) = std::str::from_utf8(&input.bytes) else { return Ok(false) };
                Ok(Spec::parse(&input.name, text).map(|spec| spec.describe()).is_ok())
            }
            "results" => report(input),
            "fits" => fits::compared(&input.model, &in_file(input, folder)?),
            "exchange" => checked(&input.model, &in_file(input, folder)?),
            _ => read(&input.model, &in_file(input, folder)?),
        }
    }
}

/// The input as a file.
fn in_file(input: &FuzzInput, folder: &Path) -> Result<PathBuf, String> {
    let place = folder.join(&input.name);
    std::fs::write(&place, &input.bytes).map_err(|error| format!("{}: {error}", place.display()))?;
    Ok(place)
}

/// Takes tests and forgets them.
struct ForgetfulSink;

impl TestSink for ForgetfulSink {
    type Error = std::convert::Infallible;

    fn tests(&mut self, _: Vec<Test>, _: &Labels) -> Result<(), Self::Error> {
        Ok(())
    }

    fn restart(&mut self) {}
}

/// Tables by what reads them.
fn read(text: &str, data: &Path) -> Result<bool, String> {
    let spec = Spec::parse("m.toml", text).map_err(|error| error.to_string())?;
    let inputs = Input::expand(&[data.display().to_string()]).map_err(|error| error.to_string())?;
    match kalfit_data::read(&spec.model, &spec.layout, &inputs, &mut ForgetfulSink) {
        Ok(_) => Ok(true),
        Err(error) if error.to_string().is_empty() => Err("it was refused without a word".to_owned()),
        Err(_) => Ok(false),
    }
}

/// Exchange files by all that a command does before it fits.
fn checked(text: &str, data: &Path) -> Result<bool, String> {
    let job = CheckJob { model: model(text), data: vec![Datum::Named(data.display().to_string())], out: None };
    match kalfit_job::check(&job, &mut Unwatched) {
        Ok(_) => Ok(true),
        Err(failure) if failure.to_string().is_empty() => Err("it was refused without a word".to_owned()),
        Err(_) => Ok(false),
    }
}

/// Results by what shows them.
fn report(input: &FuzzInput) -> Result<bool, String> {
    let Ok(text) = std::str::from_utf8(&input.bytes) else { return Ok(false) };
    let fit = Document::Text { name: input.name.clone(), text: text.to_owned(), file: None };
    let read = kalfit_job::report(&ReportJob { fit: fit.clone(), test: None, out: None }).is_ok();
    let fits = vec![fit, Document::File(input.beside.clone())];
    let _ = kalfit_job::compare(&CompareJob { fits, out: None });
    Ok(read)
}

/// A model one of whose expressions is put together at random, within a sound one or by itself.
fn expressions(random: &mut ChaCha8Rng) -> String {
    let most = [4, 12, 60][random.random_range(0..3_usize)];
    let count = random.random_range(1..most);
    let pieces: String = (0..count).map(|_| PIECES[random.random_range(0..PIECES.len())]).collect();
    let [equation, noise] = match random.random_range(0..4_u32) {
        0 => [pieces, "sigma".to_owned()],
        1 => [format!("level + slope * ({pieces})"), "sigma".to_owned()],
        2 => ["level + slope * x".to_owned(), pieces],
        _ => ["level + slope * x".to_owned(), format!("sigma * ({pieces})")],
    };
    let quoted = |text: &str| serde_json::to_string(text).unwrap_or_default();
    format!(
        "[data]\ntest = \"id\"\n[states.level]\n[states.slope]\n[measurements.y]\ncolumn = \"y\"\nequation = {}\nnoise = {}\n\
         [parameters]\nsigma = 1\ntau = 2\n",
        quoted(&equation),
        quoted(&noise)
    )
}
