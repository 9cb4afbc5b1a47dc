//! Innovations after the fit. They need the data once more: small data are kept while they are read, larger ones are read a
//! second time, standard input from a copy in memory or, when large, in a temporary file.

use std::collections::HashMap;
use std::io::{Read, Seek, SeekFrom, Write};

use kalfit::infer::misfit::{FittedEnsemble, misfit};
use kalfit::innovations::{InnovationFilter, Innovations};
use kalfit::model::Population;
use kalfit::record::{InnovationRecord, InnovationRecords, SeriesKeeper, TestGroups, TestRecords};
use kalfit::reduce::{Evidence, ReduceError, SplitError};
use kalfit::{Alpha, FitRecord, Labels, PhasedModel, PhasedTest, Test};
use kalfit_data::{DataError, Input, ReadError, TestSink};
use kalfit_spec::Spec;
use rayon::prelude::*;
use tempfile::SpooledTempFile;

use crate::tests::batch;
use crate::work::JobWork;

/// Bytes of tests that are kept, and of standard input that is kept in memory.
const MOST_BYTES: usize = 64 << 20;
/// The log-likelihood of a test by its innovations and by the fit may differ by this part of itself.
const AGREEMENT: f64 = 1e-6;

/// Why there are no innovations, or not of all tests. The fit itself does not depend on them.
#[derive(Debug, thiserror::Error)]
enum InnovationsUnavailable {
    #[error("the data are too large to be kept, and `{name}` cannot be read a second time")]
    OnlyOnce { name: String },
    #[error("standard input is too large to be kept, and no temporary file could be written")]
    NoCopy,
    #[error("the data could not be read a second time: {0}")]
    Unreadable(DataError),
    #[error("the data changed while they were read: {0}")]
    Split(SplitError),
    #[error("{0}")]
    Filter(ReduceError),
    #[error("the fit was interrupted")]
    Interrupted,
}

/// What a reading leaves for a second look at the data.
pub(crate) struct KeptData {
    pub(crate) tests: KeptTests,
    pub(crate) copy: StdinCopy,
    /// Of which group each test is, where the model has groups.
    pub(crate) groups: Option<TestGroups>,
}

/// Tests, as long as they are not too many.
#[derive(Default)]
pub(crate) struct KeptTests {
    wanted: bool,
    tests: Vec<PhasedTest>,
    bytes: usize,
    /// `tests` are not all.
    overflowed: bool,
}

/// A copy of standard input.
pub(crate) enum StdinCopy {
    None,
    Whole(Box<SpooledTempFile>),
    Failed,
}

impl KeptData {
    /// Keeps what a second look at these inputs takes.
    pub(crate) fn of(inputs: &[Input]) -> KeptData {
        let copy = if inputs.contains(&Input::Stdin) {
            StdinCopy::Whole(Box::new(SpooledTempFile::new(MOST_BYTES)))
        } else {
            StdinCopy::None
        };
        KeptData { copy, tests: KeptTests { wanted: true, ..KeptTests::default() }, groups: None }
    }

    /// Keeps nothing.
    pub(crate) fn nothing() -> KeptData {
        KeptData { copy: StdinCopy::None, tests: KeptTests::default(), groups: None }
    }
}

impl KeptTests {
    /// Takes complete tests.
    pub(crate) fn take(&mut self, tests: Vec<PhasedTest>) {
        if !self.wanted || self.overflowed {
            return;
        }
        self.bytes += tests.iter().map(bytes).sum::<usize>();
        self.tests.extend(tests);
        if self.bytes > MOST_BYTES {
            (self.tests, self.overflowed) = (Vec::new(), true);
        }
    }

    /// All tests; `None` where some were not kept.
    pub(crate) fn known(&self) -> Option<&[PhasedTest]> {
        (self.wanted && !self.overflowed).then_some(&self.tests)
    }

    /// All of them; `None` where they are not all there.
    pub(crate) fn all(self) -> Option<Vec<PhasedTest>> {
        (self.wanted && !self.overflowed).then_some(self.tests)
    }

    /// Forgets them.
    pub(crate) fn restart(&mut self) {
        *self = KeptTests { wanted: self.wanted, ..KeptTests::default() };
    }
}

impl StdinCopy {
    /// `source`, with a copy of what passes where one is needed.
    pub(crate) fn copying<'a>(&'a mut self, source: &'a mut dyn Read) -> impl Read + use<'a> {
        CopyingReader { source, copy: self }
    }
}

fn bytes(test: &PhasedTest) -> usize {
    let of = |evidence: &Evidence| match evidence {
        Evidence::Rows(rows) if rows.rows() > 0 => {
            rows.rows() * (16 + 8 * rows.numbers(0).len() + 4 * rows.texts(0).len())
        }
        // nobody looks at these again, but they are kept with the others
        Evidence::Rows(_) => 0,
        Evidence::Estimates(found) => 8 * (found.sensitivities.len() + found.transition.len() + found.root.len()),
        Evidence::Reduced(found) => 8 * (found.reduction.factor.len() + 3 * found.reduction.data.len()),
    };
    test.phases.iter().map(|evidence| 128 + test.id.len() + of(evidence)).sum()
}

struct CopyingReader<'a> {
    source: &'a mut dyn Read,
    copy: &'a mut StdinCopy,
}

impl Read for CopyingReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let fresh = self.source.read(buffer)?;
        if let StdinCopy::Whole(file) = self.copy
            && file.write_all(&buffer[..fresh]).is_err()
        {
            *self.copy = StdinCopy::Failed;
        }
        Ok(fresh)
    }
}

/// Adds innovations to the record, or a note that says why there are none.
pub(crate) fn add(
    record: &mut FitRecord,
    kept: &mut KeptData,
    (spec, alpha, inputs): (&Spec, &Alpha, &[Input]),
    initial: &Population,
    work: &mut JobWork<'_>,
) {
    let found = InnovationSink::new((&spec.model, alpha, initial), &record.tests, work)
        .map_err(InnovationsUnavailable::Filter)
        .and_then(|looking| all(looking, kept, spec, inputs));
    finish(record, found);
}

/// Adds the misfit that tests have in common to the record, or a note that says why it was not looked for.
pub(crate) fn add_misfit(record: &mut FitRecord, of: &FittedEnsemble<'_>, work: &mut JobWork<'_>) {
    let found = misfit(of, &mut |share| {
        work.share("misfit in common", (1e3 * share) as u64, 1000);
        !work.is_stopped()
    });
    record.set_misfit(found, of.model);
}

/// As [`add`], of tests that were all kept.
pub(crate) fn add_of(
    record: &mut FitRecord,
    at: (&PhasedModel, &Alpha, &Population),
    tests: &[PhasedTest],
    work: &mut JobWork<'_>,
) {
    let found =
        InnovationSink::new(at, &record.tests, work).map_err(InnovationsUnavailable::Filter).and_then(|mut looking| {
            looking.look_at(tests)?;
            Ok(looking.seen)
        });
    finish(record, found);
}

/// As [`add_of`], of so many tests of which only reductions are given.
pub(crate) fn add_none(
    record: &mut FitRecord,
    at: (&PhasedModel, &Alpha, &Population),
    tests: usize,
    work: &mut JobWork<'_>,
) {
    let found = match InnovationSink::new(at, &record.tests, work) {
        Ok(looking) if looking.work.is_stopped() => Err(InnovationsUnavailable::Interrupted),
        Ok(looking) => Ok(InnovationSummary { silent: tests, ..looking.seen }),
        Err(error) => Err(InnovationsUnavailable::Filter(error)),
    };
    finish(record, found);
}

fn finish(record: &mut FitRecord, found: Result<InnovationSummary, InnovationsUnavailable>) {
    let seen = match found {
        Ok(seen) => seen,
        Err(why) => return record.notes.push(format!("innovations were not computed: {why}")),
    };
    if let Some(error) = seen.failed {
        record.notes.push(format!("the innovations of some tests could not be computed: {error}"));
    }
    if seen.silent > 0 {
        let tests = if seen.silent == 1 { "1 test has".to_owned() } else { format!("{} tests have", seen.silent) };
        record.notes.push(format!(
            "{tests} no innovations: they are given by estimates or reductions, which no longer tell what was measured when"
        ));
    }
    if seen.strange > 0 {
        record.notes.push(format!(
            "the innovations of {} of {} tests are left out: they do not give the likelihood of the fit, because the data changed while they were read, or because the test is too ill-conditioned",
            seen.strange, seen.seen
        ));
    }
    record.set_innovations(seen.found);
    record.add_series(seen.series);
}

/// What the filter saw of all tests.
#[derive(Default)]
struct InnovationSummary {
    found: InnovationRecords,
    /// For charts.
    series: SeriesKeeper,
    /// Tests that have innovations.
    seen: usize,
    /// Those of them whose innovations do not give the likelihood of the fit.
    strange: usize,
    /// Tests that cannot have any.
    silent: usize,
    failed: Option<ReduceError>,
}

impl InnovationSummary {
    /// Of none of these tests yet.
    fn of(fitted: &TestRecords) -> InnovationSummary {
        InnovationSummary { found: InnovationRecords::with_room(fitted.len()), ..InnovationSummary::default() }
    }
}

/// The tests of the fit.
struct FittedTests<'a> {
    tests: &'a TestRecords,
    /// Their numbers, by their ids.
    numbers: HashMap<&'a str, usize>,
}

impl FittedTests<'_> {
    /// The number of the test, where it is one of the fit. Two ways to one likelihood must agree; where they do not, the data changed between
    /// two readings, or digits were lost.
    fn number(&self, one: &Innovations) -> Option<usize> {
        let number = *self.numbers.get(one.test.as_str())?;
        let fitted = self.tests.get(number).log_likelihood;
        ((fitted - one.log_likelihood).abs() <= AGREEMENT * (1.0 + fitted.abs())).then_some(number)
    }
}

/// Takes tests in and keeps figures only.
struct InnovationSink<'a, 'w> {
    filter: InnovationFilter,
    model: &'a PhasedModel,
    fitted: FittedTests<'a>,
    seen: InnovationSummary,
    work: &'a mut JobWork<'w>,
}

impl<'a, 'w> InnovationSink<'a, 'w> {
    fn new(
        (model, alpha, initial): (&'a PhasedModel, &Alpha, &Population),
        fitted: &'a TestRecords,
        work: &'a mut JobWork<'w>,
    ) -> Result<InnovationSink<'a, 'w>, ReduceError> {
        Ok(InnovationSink {
            filter: InnovationFilter::new(model, alpha, initial)?,
            model,
            fitted: FittedTests { tests: fitted, numbers: fitted.by_id() },
            seen: InnovationSummary::of(fitted),
            work,
        })
    }

    /// At all of them, as long as somebody waits.
    fn look_at(&mut self, tests: &[PhasedTest]) -> Result<(), InnovationsUnavailable> {
        let most_rows = ROWS_OF_A_THREAD * rayon::current_num_threads();
        let mut from = 0;
        while from < tests.len() {
            if self.work.is_stopped() {
                return Err(InnovationsUnavailable::Interrupted);
            }
            self.work.share("innovations", from as u64, tests.len() as u64);
            let end = batch(tests, from, most_rows).min(from + BATCH);
            self.look(&tests[from..end]);
            from = end;
        }
        Ok(())
    }

    fn look(&mut self, tests: &[PhasedTest]) {
        let (seen, model, fitted) = (&mut self.seen, self.model, &self.fitted);
        let of = |result: Result<Option<Innovations>, ReduceError>| {
            let Some(one) = result? else { return Ok(None) };
            Ok(Some((fitted.number(&one), InnovationRecord::new(&one, model), one)))
        };
        let found: Vec<Result<Option<_>, ReduceError>> = self.filter.run(tests).into_par_iter().map(of).collect();
        for result in found {
            match result {
                Ok(Some((number, record, one))) => {
                    seen.seen += 1;
                    let Some(number) = number else {
                        seen.strange += 1;
                        continue;
                    };
                    seen.series.offer(&one, &record, model);
                    seen.found.put(number, record);
                }
                Ok(None) => seen.silent += 1,
                Err(error) => seen.failed = seen.failed.take().or(Some(error)),
            }
        }
        let done = seen.seen + seen.silent;
        self.work.say(|| format!("innovations: {done} tests"));
    }
}

impl TestSink for InnovationSink<'_, '_> {
    type Error = InnovationsUnavailable;

    fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), InnovationsUnavailable> {
        if self.work.is_stopped() {
            return Err(InnovationsUnavailable::Interrupted);
        }
        let split = tests.into_iter().map(|test| self.model.split(test, labels));
        let tests: Vec<PhasedTest> = split.collect::<Result<_, _>>().map_err(InnovationsUnavailable::Split)?;
        self.look(&tests);
        Ok(())
    }

    fn bytes(&mut self, done: u64, of: Option<u64>) -> Result<(), InnovationsUnavailable> {
        of.into_iter().for_each(|of| self.work.share("innovations", done, of));
        if self.work.is_stopped() { Err(InnovationsUnavailable::Interrupted) } else { Ok(()) }
    }

    fn restart(&mut self) {
        self.seen = InnovationSummary::of(self.fitted.tests);
    }
}

/// Most tests that are looked at together, and rows of them for each thread: their series of innovations are in memory at
/// the same time.
const BATCH: usize = 1024;
const ROWS_OF_A_THREAD: usize = 1 << 20;

fn all(
    mut looking: InnovationSink<'_, '_>,
    kept: &mut KeptData,
    spec: &Spec,
    inputs: &[Input],
) -> Result<InnovationSummary, InnovationsUnavailable> {
    if kept.tests.overflowed {
        again(&mut looking, kept, spec, inputs)?;
    } else {
        looking.look_at(&kept.tests.tests)?;
    }
    Ok(looking.seen)
}

/// Reads the data a second time.
fn again(
    looking: &mut InnovationSink<'_, '_>,
    kept: &mut KeptData,
    spec: &Spec,
    inputs: &[Input],
) -> Result<(), InnovationsUnavailable> {
    let once = inputs.iter().find(|input| match input {
        Input::Path(path) => !std::fs::metadata(path).is_ok_and(|found| found.is_file()),
        Input::Stdin | Input::Table(_) => false,
    });
    if let Some(input) = once {
        return Err(InnovationsUnavailable::OnlyOnce { name: input.name() });
    }
    let mut copy: Box<dyn Read> = match std::mem::replace(&mut kept.copy, StdinCopy::None) {
        StdinCopy::None => Box::new(std::io::empty()),
        StdinCopy::Whole(mut file) => {
            file.seek(SeekFrom::Start(0)).map_err(|_| InnovationsUnavailable::NoCopy)?;
            Box::new(std::io::BufReader::new(file))
        }
        StdinCopy::Failed => return Err(InnovationsUnavailable::NoCopy),
    };
    match kalfit_data::read_from(&spec.model, &spec.layout, inputs, looking, &mut copy) {
        Ok(_) => Ok(()),
        Err(ReadError::Data(error)) => Err(InnovationsUnavailable::Unreadable(error)),
        Err(ReadError::Sink { error, .. }) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use kalfit::Source;
    use kalfit::record::TestRow;

    use super::*;
    use crate::work::Unwatched;

    fn test(rows: usize) -> PhasedTest {
        let mut test = Test::new("a", 2, 0);
        (0..rows).for_each(|_| test.push(&[1.0, 2.0], &[], Source::default()));
        test.into()
    }

    #[test]
    fn tests_are_kept_up_to_a_limit_and_from_a_restart_on() {
        let mut kept = KeptData::of(&[]).tests;
        kept.take(vec![test(10), test(20)]);
        assert_eq!((kept.tests.len(), kept.overflowed), (2, false));
        let large = 1 + MOST_BYTES / (8 * 32);
        (0..8).for_each(|_| kept.take(vec![test(large)]));
        assert_eq!((kept.tests.len(), kept.overflowed), (0, true), "{} bytes", kept.bytes);
        kept.restart();
        kept.take(vec![test(10)]);
        assert_eq!((kept.tests.len(), kept.overflowed), (1, false));
        let mut nothing = KeptData::nothing().tests;
        nothing.take(vec![test(10)]);
        assert_eq!(nothing.tests.len(), 0);
    }

    #[test]
    fn standard_input_can_be_read_again_from_its_copy() {
        let mut kept = KeptData::of(&[Input::Stdin]);
        let mut source: &[u8] = b"some text";
        let mut first = String::new();
        kept.copy.copying(&mut source).read_to_string(&mut first).unwrap();
        let StdinCopy::Whole(mut file) = kept.copy else { panic!("there is no copy") };
        let mut second = String::new();
        file.seek(SeekFrom::Start(0)).unwrap();
        file.read_to_string(&mut second).unwrap();
        assert_eq!((first.as_str(), second.as_str()), ("some text", "some text"));
    }

    const MODEL: &str = r#"
[data]
test = "id"
[states.level]
[measurements.y]
column = "y"
equation = "level"
noise = 1
"#;
    /// `b` comes back after `a`, so that the second reading starts again too.
    const DATA: &str = "id,y\nb,1\na,2\na,3\nb,-1\nb,4\n";

    /// By hand: y is N(1, I + 11') of n, with inverse I - 11'/(n + 1) and determinant n + 1: (z'S⁻¹z, log p).
    fn by_hand(z: &[f64]) -> (f64, f64) {
        let (n, tau) = (z.len() as f64, std::f64::consts::TAU);
        let square: f64 = z.iter().map(|z| z * z).sum::<f64>() - z.iter().sum::<f64>().powi(2) / (n + 1.0);
        (square, -0.5 * (n * tau.ln() + (n + 1.0).ln() + square))
    }

    /// Tests `a` and `b` of the data with these likelihoods.
    fn fitted(log_likelihoods: [f64; 2]) -> TestRecords {
        let test = |(id, log_likelihood): (&str, f64)| TestRow {
            id: id.to_owned(),
            group: None,
            groups: Vec::new(),
            log_likelihood,
            observations: 0,
            steps: None,
            design_class: None,
            phases: Vec::new(),
            distance: None,
            degrees_of_freedom: 0,
            p_value: None,
            deletion: None,
            innovations: None,
        };
        ["a", "b"].into_iter().zip(log_likelihoods).map(test).collect()
    }

    /// Innovations of `a` and `b`, and how many are left out.
    fn figures(
        mut kept: KeptData,
        inputs: &[Input],
        log_likelihoods: [f64; 2],
    ) -> Result<([Option<InnovationRecord>; 2], usize), InnovationsUnavailable> {
        let spec = Spec::parse("m.toml", MODEL).unwrap();
        let mut initial = Population { mean: vec![1.0], coefficients: vec![], covariance: Default::default() };
        initial.covariance.resize_mut(1, 1, 1.0);
        let mut watch = Unwatched;
        let mut work = JobWork::new(&mut watch);
        let fitted = fitted(log_likelihoods);
        let looking = InnovationSink::new((&spec.model, &Alpha::default(), &initial), &fitted, &mut work).unwrap();
        let seen = all(looking, &mut kept, &spec, inputs)?;
        assert_eq!((seen.failed, seen.silent, seen.seen), (None, 0, 2));
        Ok(([0, 1].map(|number| seen.found.get(number).cloned()), seen.strange))
    }

    fn overflowed(copy: StdinCopy) -> KeptData {
        KeptData { tests: KeptTests { wanted: true, overflowed: true, ..KeptTests::default() }, copy, groups: None }
    }

    #[test]
    fn data_too_large_to_keep_are_read_a_second_time_to_the_same_figures() {
        let mut file = tempfile::Builder::new().suffix(".csv").tempfile().unwrap();
        file.write_all(DATA.as_bytes()).unwrap();
        let inputs = [Input::Path(file.path().to_owned())];
        let expected = [by_hand(&[1.0, 2.0]), by_hand(&[0.0, -2.0, 3.0])];
        let likelihoods = expected.map(|(_, log_likelihood)| log_likelihood);
        let (from_file, strange) = figures(overflowed(StdinCopy::None), &inputs, likelihoods).unwrap();
        assert_eq!(strange, 0);
        for (found, (square, _)) in from_file.iter().zip(expected) {
            let nis = found.as_ref().unwrap().nis.unwrap();
            assert!((nis - square).abs() < 1e-12, "{nis} {square}");
        }
        // of other likelihoods they are left out
        let off = [likelihoods[0], likelihoods[1] + 1e-4];
        let (some, strange) = figures(overflowed(StdinCopy::None), &inputs, off).unwrap();
        assert_eq!((some, strange), ([from_file[0].clone(), None], 1));
        let mut copy = Box::new(SpooledTempFile::new(8)); // rolls over to a file
        copy.write_all(DATA.as_bytes()).unwrap();
        let again = figures(overflowed(StdinCopy::Whole(copy)), &[Input::Stdin], likelihoods).unwrap();
        assert_eq!(again, (from_file, 0));
        let none = figures(overflowed(StdinCopy::Failed), &[Input::Stdin], likelihoods);
        assert!(matches!(none, Err(InnovationsUnavailable::NoCopy)));
        let gone = [Input::Path("no/such/pipe".into())];
        let once = figures(overflowed(StdinCopy::None), &gone, likelihoods);
        assert!(matches!(once, Err(InnovationsUnavailable::OnlyOnce { .. })));
    }
}
