//! A job that somebody stops.

use std::path::PathBuf;

use kalfit::dynamic::Method;
use kalfit::estimate::Solver;
use kalfit::infer::IntervalKind;
use kalfit_job::{Document, ExchangeJob, Failure, FitJob, JobWatch, ModelJob};

/// Stops a job once it has heard these words so many times.
struct Impatient {
    words: &'static str,
    times: usize,
}

impl JobWatch for Impatient {
    fn say(&mut self, what: &dyn Fn() -> String) {
        if what().contains(self.words) {
            self.times = self.times.saturating_sub(1);
        }
    }

    fn stops(&self) -> bool {
        self.times == 0
    }
}

fn example(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(name)
}

fn job(model: &str, data: &str) -> FitJob {
    let document = Document::File(example(model));
    FitJob::new(ModelJob { document, set: Vec::new() }, vec![example(data).display().to_string().into()])
}

fn bench() -> FitJob {
    job("gyro-bench/bench.toml", "gyro-bench/bench.csv")
}

fn sleep() -> FitJob {
    job("random-coefficients/sleepstudy.toml", "random-coefficients/sleepstudy.csv")
}

fn ovary() -> FitJob {
    job("gauss-markov/ovary.toml", "gauss-markov/ovary.csv")
}

#[test]
fn a_search_that_is_stopped_ends_with_its_best_so_far_and_says_so() {
    let whole = kalfit_job::fit(&bench(), &mut Impatient { words: "nothing says this", times: 1 }).unwrap().record;
    assert!(whole.converged);
    for solver in [Solver::Newton, Solver::Em] {
        let folder = tempfile::tempdir().unwrap();
        let mut job = bench();
        job.settings = kalfit::estimate::Settings::of(solver);
        job.out = Some(folder.path().join("fit.json"));
        let done = kalfit_job::fit(&job, &mut Impatient { words: ": log-likelihood", times: 2 }).unwrap();
        assert!(!done.record.converged, "{}", done.record.reason);
        assert!(done.record.reason.contains("interrupted"), "{}", done.record.reason);
        assert!(done.record.log_likelihood < whole.log_likelihood);
        assert!(done.written.is_empty(), "{:?}", done.written);
        assert!(!folder.path().join("fit.json").exists(), "nobody waits for the file");
    }
}

#[test]
fn a_search_for_parameters_stops_by_every_method() {
    for method in [Method::Hybrid, Method::Innovations, Method::Em] {
        let mut job = sleep();
        job.method = kalfit_job::MethodChoice::By(method);
        job.search.starts = 3;
        let record = kalfit_job::fit(&job, &mut Impatient { words: ": log-likelihood", times: 1 }).unwrap().record;
        assert!(!record.converged, "{method:?}: {}", record.reason);
        assert!(record.reason.contains("interrupted"), "{method:?}: {}", record.reason);
        assert!(record.starts.is_empty(), "{method:?}: no other start was tried");
    }
}

#[test]
fn intervals_that_are_stopped_are_those_from_standard_errors_and_it_says_so() {
    for (words, runs) in [("interval of `", "filter run"), ("interval of the", "")] {
        let folder = tempfile::tempdir().unwrap();
        let mut job = ovary();
        let wald = kalfit_job::fit(&job, &mut Impatient { words: "nothing says this", times: 1 }).unwrap().record;
        job.choices.intervals = IntervalKind::Profile;
        job.out = Some(folder.path().join("fit.json"));
        let mut heard = Listener::default();
        let whole = kalfit_job::fit(&job, &mut heard).unwrap();
        assert!(heard.0.iter().any(|said| said.contains(words) && said.contains(runs)), "{:?}", heard.0);
        assert_eq!((whole.record.intervals.as_str(), whole.written.len()), ("profile", 1));
        std::fs::remove_file(folder.path().join("fit.json")).unwrap();
        let done = kalfit_job::fit(&job, &mut Impatient { words, times: 2 }).unwrap();
        assert!(done.record.converged, "{}", done.record.reason);
        assert_eq!((&done.record.parameters, &done.record.intervals), (&wald.parameters, &wald.intervals));
        assert!(done.record.notes.iter().any(|note| note.contains("interrupted")), "{:?}", done.record.notes);
        assert!(!folder.path().join("fit.json").exists(), "nobody waits for the file");
    }
}

/// Stops at once when it has heard these words, and counts how often they are said after that.
struct Deaf(&'static str, Option<usize>);

impl JobWatch for Deaf {
    fn say(&mut self, what: &dyn Fn() -> String) {
        if what().contains(self.0) {
            self.1 = Some(self.1.map_or(0, |later| later + 1));
        }
    }

    fn stops(&self) -> bool {
        self.1.is_some()
    }
}

#[test]
fn no_filter_runs_for_intervals_once_nobody_waits() {
    let mut job = ovary();
    job.choices.intervals = IntervalKind::Profile;
    let mut deaf = Deaf("end: filter run ", None);
    let record = kalfit_job::fit(&job, &mut deaf).unwrap().record;
    assert_eq!(record.intervals, "wald");
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    assert!(deaf.1.is_some_and(|later| later <= threads), "{:?}", deaf.1);
}

#[test]
fn whatever_is_no_search_ends_without_a_result() {
    let interrupted = |result: Result<(), Failure>| assert!(matches!(result, Err(Failure::Interrupted)), "{result:?}");
    interrupted(kalfit_job::fit(&bench(), &mut Impatient { words: "", times: 0 }).map(|_| ()));
    let FitJob { model, data, .. } = bench();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("reductions.parquet");
    let job = ExchangeJob { model, data, at: None, out: Some(out.clone()) };
    interrupted(kalfit_job::reduce(&job, &mut Impatient { words: "", times: 0 }).map(|_| ()));
    assert!(!out.exists());
    assert_eq!(folder.path().read_dir().unwrap().count(), 0, "no temporary file stays behind");
}

/// Remembers what was said.
#[derive(Default)]
struct Listener(Vec<String>);

impl JobWatch for Listener {
    fn say(&mut self, what: &dyn Fn() -> String) {
        self.0.push(what());
    }
}

#[test]
fn a_fit_tells_what_it_is_at_before_the_first_step() {
    let mut heard = Listener::default();
    let folder = tempfile::tempdir().unwrap();
    let model = std::fs::read_to_string(example("random-coefficients/sleepstudy.toml")).unwrap();
    let path = folder.path().join("m.toml");
    std::fs::write(&path, model.replace("{ start = 20,", "{")).unwrap();
    let mut job = sleep();
    job.model.document = Document::File(path);
    kalfit_job::fit(&job, &mut heard).unwrap();
    let first = |what: &str| {
        heard.0.iter().position(|said| said.starts_with(what)).unwrap_or_else(|| panic!("{what}: {:?}", heard.0))
    };
    let (starts, search, step) = (first("start values: filter run 1"), first("search: filter run "), first("pass "));
    assert!(starts < search && search < step, "{:?}", heard.0);
    assert!(heard.0[step].contains(": log-likelihood -"), "{}", heard.0[step]);
    assert!(heard.0.iter().any(|said| said.ends_with(" standard errors from the optimum")), "{:?}", heard.0);
}
