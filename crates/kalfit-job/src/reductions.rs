//! Data → reductions: tests are reduced as they are read, and forgotten.

use kalfit::record::TestGroups;
use kalfit::reduce::PhasedReducer;
use kalfit::{Alpha, Labels, PhasedModel, PhasedTest, Reductions, Test};
use kalfit_data::{DataReading, TestSink};
use kalfit_spec::Spec;

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::innovations::{KeptData, KeptTests};
use crate::refused::{self, SinkRefusal};
use crate::work::JobWork;

/// Sees every test, and nothing when all are to be forgotten.
type TestObserver<'a> = &'a mut dyn FnMut(Option<&PhasedTest>);

struct ReducingSink<'a, 'w> {
    model: &'a PhasedModel,
    reducer: PhasedReducer,
    reductions: Reductions,
    kept: &'a mut KeptTests,
    groups: Option<&'a mut TestGroups>,
    counted: TestObserver<'a>,
    work: &'a mut JobWork<'w>,
}

impl TestSink for ReducingSink<'_, '_> {
    type Error = SinkRefusal;

    fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), SinkRefusal> {
        SinkRefusal::unless_stopped(self.work)?;
        let tests: Vec<PhasedTest> = tests
            .into_iter()
            .map(|test| self.model.split(test, labels))
            .collect::<Result<_, _>>()
            .map_err(SinkRefusal::Split)?;
        self.reductions.append(self.reducer.reduce(&tests).map_err(SinkRefusal::Reduce)?);
        tests.iter().for_each(|test| (self.counted)(Some(test)));
        if let Some(groups) = &mut self.groups {
            groups.take(&tests, labels).map_err(SinkRefusal::Group)?;
        }
        self.kept.take(tests);
        let done = self.reductions.len();
        self.work.say(|| format!("reading: {done} tests"));
        Ok(())
    }

    fn bytes(&mut self, done: u64, of: Option<u64>) -> Result<(), SinkRefusal> {
        SinkRefusal::unless_stopped_at(self.work, done, of)
    }

    fn restart(&mut self) {
        self.reductions = Reductions::new();
        (self.counted)(None);
        if let Some(groups) = &mut self.groups {
            groups.clear();
        }
        self.kept.restart();
    }
}

/// Reads the data and runs the filters over them at α. `counted` sees every test, and nothing when all are to be forgotten and
/// read again.
pub(crate) fn reduce(
    spec: &Spec,
    alpha: &Alpha,
    given: &CommandInputs,
    work: &mut JobWork<'_>,
    counted: TestObserver<'_>,
) -> Result<Reductions, Failure> {
    read(spec, alpha, given, (work, counted), &mut KeptData::nothing())
}

/// [`reduce`], keeping what a second look at the data takes.
pub(crate) fn reduce_keeping(
    spec: &Spec,
    alpha: &Alpha,
    given: &CommandInputs,
    watched: (&mut JobWork<'_>, TestObserver<'_>),
    kept: &mut KeptData,
) -> Result<Reductions, Failure> {
    read(spec, alpha, given, watched, kept)
}

fn read(
    spec: &Spec,
    alpha: &Alpha,
    given: &CommandInputs,
    (work, counted): (&mut JobWork<'_>, TestObserver<'_>),
    kept: &mut KeptData,
) -> Result<Reductions, Failure> {
    let model = &spec.model;
    if !given.is_rows() {
        let (tests, reading) = given.tests(spec, model, work)?;
        tests.iter().for_each(|test| counted(Some(test)));
        return of_all(model, alpha, (&tests, &reading), work);
    }
    let reducer = PhasedReducer::new(model, alpha).map_err(|error| Failure::Reduce { error, reading: None })?;
    let mut stdin = given.stdin();
    let KeptData { tests, copy, groups } = kept;
    let mut sink = ReducingSink {
        model,
        reducer,
        reductions: Reductions::new(),
        kept: tests,
        groups: groups.as_mut(),
        counted,
        work,
    };
    let mut stdin = copy.copying(&mut stdin);
    kalfit_data::read_from(model, &spec.layout, &given.inputs, &mut sink, &mut stdin)
        .map_err(|error| refused::failure(error, spec))?;
    Ok(sink.reductions)
}

/// Kept tests are reduced so many at a time, so that somebody may hear of it.
const BATCH: usize = 1024;

/// [`of`], as long as somebody waits.
pub(crate) fn of_all(
    model: &PhasedModel,
    alpha: &Alpha,
    (tests, reading): (&[PhasedTest], &DataReading),
    work: &mut JobWork<'_>,
) -> Result<Reductions, Failure> {
    let failed = |error| Failure::Reduce { error, reading: Some(Box::new(reading.clone())) };
    let reducer = PhasedReducer::new(model, alpha).map_err(failed)?;
    let mut reductions = Reductions::new();
    for batch in tests.chunks(BATCH) {
        work.go_on()?;
        work.share("reducing", reductions.len() as u64, tests.len() as u64);
        work.say(|| format!("reducing: {} tests", tests.len()));
        reductions.append(reducer.reduce(batch).map_err(failed)?);
    }
    Ok(reductions)
}

/// Runs the filters over tests that were kept.
pub(crate) fn of(
    model: &PhasedModel,
    alpha: &Alpha,
    tests: &[PhasedTest],
    reading: &DataReading,
) -> Result<Reductions, Failure> {
    PhasedReducer::new(model, alpha)
        .and_then(|reducer| reducer.reduce(tests))
        .map_err(|error| Failure::Reduce { error, reading: Some(Box::new(reading.clone())) })
}
