//! Texts in the place of files, and tables that are handed back.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use std::io::{Read, Seek, SeekFrom};

use kalfit_job::{Document, ExchangeJob, FitJob, ModelJob, SimulateJob, Unwatched, fit_record};

const MODEL: &str =
    "[data]\ntest = \"id\"\n[states.level]\n[measurements.y]\ncolumn = \"y\"\nequation = \"level\"\nnoise = 0.1\n";
const DATA: &str = "id,y\na,1.1\na,0.9\nb,2.1\nb,2.0\nc,-0.4\nc,-0.5\n";

fn model(text: &str) -> ModelJob {
    let document = Document::Text { name: "the model".to_owned(), text: text.to_owned(), file: None };
    ModelJob { document, set: Vec::new() }
}

fn data(folder: &tempfile::TempDir) -> Vec<kalfit_data::Datum> {
    let path = folder.path().join("d.csv");
    std::fs::write(&path, DATA).unwrap();
    vec![path.display().to_string().into()]
}

#[test]
fn a_model_in_memory_is_as_good_as_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let given = data(&folder);
    let path = folder.path().join("m.toml");
    std::fs::write(&path, MODEL).unwrap();
    let of = |model: ModelJob| kalfit_job::fit(&FitJob::new(model, given.clone()), &mut Unwatched).unwrap().record;
    let (one, other) = (of(model(MODEL)), of(ModelJob { document: path.into(), set: Vec::new() }));
    assert_eq!(one.log_likelihood.to_bits(), other.log_likelihood.to_bits());
    assert_eq!(one.model_digest, other.model_digest);
    let wrong = kalfit_job::fit(&FitJob::new(model("[states]\n"), given), &mut Unwatched).unwrap_err();
    assert!(kalfit_job::render(&wrong, false).contains("the model"), "{wrong}");
}

#[test]
fn a_text_that_was_read_from_a_file_protects_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.toml");
    std::fs::write(&path, MODEL).unwrap();
    let document = Document::Text { name: "m".to_owned(), text: MODEL.to_owned(), file: Some(path.clone()) };
    let mut job = FitJob::new(ModelJob { document, set: Vec::new() }, data(&folder));
    job.out = Some(path.clone());
    let refused = kalfit_job::fit(&job, &mut Unwatched).unwrap_err().to_string();
    assert!(refused.contains("is one of the inputs"), "{refused}");
    assert_eq!(std::fs::read_to_string(path).unwrap(), MODEL);
}

#[test]
fn tables_without_a_name_are_handed_back_with_the_bytes_of_those_with_one() {
    let folder = tempfile::tempdir().unwrap();
    let (given, out) = (data(&folder), folder.path().join("r.parquet"));
    let of = |out| {
        let job = ExchangeJob { model: model(MODEL), data: given.clone(), at: None, out };
        kalfit_job::reduce(&job, &mut Unwatched).unwrap()
    };
    let (named, nameless) = (of(Some(out.clone())), of(None));
    assert!(named.record.table.is_none() && nameless.written.is_empty());
    assert_eq!(bytes(nameless.record.table), std::fs::read(out).unwrap());
    assert_eq!((nameless.record.rows, nameless.record.tests), (3, 3));
}

#[test]
fn an_ensemble_is_drawn_from_a_fit_in_memory() {
    let folder = tempfile::tempdir().unwrap();
    let given = data(&folder);
    let fit = kalfit_job::fit(&FitJob::new(model(MODEL), given.clone()), &mut Unwatched).unwrap().record;
    let json = serde_json::to_string(&fit).unwrap();
    assert_eq!(fit_record("the fit", &json).unwrap(), fit);
    let from = Document::Text { name: "the fit".to_owned(), text: json, file: None };
    let of = |out, states| {
        let (model, from, design) = (model(MODEL), from.clone(), given.clone());
        let job = SimulateJob { model, from, design, tests: Some(5), plan: None, seed: 3, out, states };
        kalfit_job::simulate(&job, &mut Unwatched).unwrap().record
    };
    let drawn = of(None, None);
    assert_eq!((drawn.tests, drawn.rows, drawn.state_names), (5, 10, vec!["level".to_owned()]));
    let (data, states) = (folder.path().join("s.arrow"), folder.path().join("s.csv"));
    of(Some(data.clone()), Some(states.clone()));
    assert_eq!(bytes(drawn.table), std::fs::read(data).unwrap());
    let rows: String = drawn.initial.iter().map(|(test, x)| format!("{test},{}\n", x[0])).collect();
    assert_eq!(std::fs::read_to_string(states).unwrap(), format!("test,level\n{rows}"));
}

fn bytes(file: Option<std::fs::File>) -> Vec<u8> {
    let (mut file, mut bytes) = (file.expect("no file was named"), Vec::new());
    file.seek(SeekFrom::Start(0)).unwrap();
    file.read_to_end(&mut bytes).unwrap();
    bytes
}
