//! A job runs on a thread of its own, without Python's lock; the thread that asked for it listens, and sees to Ctrl-C.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use kalfit_job::{Failure, JobWatch, ProgressShare, used_threads};
use pyo3::exceptions::{PyKeyboardInterrupt, PyRuntimeError};
use pyo3::prelude::*;

use crate::errors::exception;

/// How often Python is asked whether a signal has come.
const LISTEN: Duration = Duration::from_millis(50);
/// How long an interrupted job may take to end with what it has.
const PATIENCE: Duration = Duration::from_secs(5);
/// No more often than this is anybody told how it goes.
const TELL: Duration = Duration::from_millis(100);

/// On how many threads, all when none; and who is told how it goes.
#[derive(FromPyObject)]
pub(crate) struct RunOptions<'py>(Option<usize>, Option<Bound<'py, PyAny>>);

/// How a job ended.
pub(crate) struct JobEnd<R> {
    pub(crate) result: R,
    /// It was interrupted, and ended with what it had.
    pub(crate) interrupted: bool,
}

enum JobMessage<R> {
    /// How it goes; and how much of how much is done, where the end is known.
    Words(String, Option<(u64, u64)>),
    Done(Box<Result<R, Failure>>),
}

/// The job's side.
struct MessageSender<R> {
    sender: Sender<JobMessage<R>>,
    stop: Arc<AtomicBool>,
    /// Somebody wants to hear how it goes.
    wanted: bool,
    last: Option<Instant>,
}

impl<R> MessageSender<R> {
    fn tell(&mut self, what: &dyn Fn() -> String, share: Option<(u64, u64)>) {
        if self.wanted && self.last.is_none_or(|last| last.elapsed() >= TELL) {
            self.last = Some(Instant::now());
            let _ = self.sender.send(JobMessage::Words(what(), share)); // nobody listens any longer when it fails
        }
    }
}

impl<R: Send> JobWatch for MessageSender<R> {
    fn say(&mut self, what: &dyn Fn() -> String) {
        self.tell(what, None);
    }

    fn share(&mut self, ProgressShare { what, done, of }: ProgressShare) {
        self.tell(&|| what.to_owned(), Some((done, of)).filter(|_| of > 0));
    }

    fn stops(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Runs a job. After Ctrl-C it is asked to stop: one that ends soon with a result gives that, any other is left to wind down by
/// itself, which writes nothing, and the exception of the signal is raised.
pub(crate) fn run<R: Send + 'static>(
    py: Python<'_>,
    RunOptions(threads, progress): RunOptions<'_>,
    job: impl FnOnce(&mut dyn JobWatch) -> Result<R, Failure> + Send + 'static,
) -> PyResult<JobEnd<R>> {
    let pool = if threads.is_some() { Arc::new(pool(threads)?) } else { shared_pool()? };
    let (sender, receiver) = channel();
    let stop = Arc::new(AtomicBool::new(false));
    let mut teller = MessageSender { sender, stop: stop.clone(), wanted: progress.is_some(), last: None };
    let work = move || {
        let result = pool.install(|| job(&mut teller));
        let _ = teller.sender.send(JobMessage::Done(Box::new(result)));
    };
    let thread = std::thread::Builder::new().name("kalfit".to_owned()).spawn(work);
    thread.map_err(|error| exception(&Failure::Threads { threads: 1, reason: error.to_string() }))?;
    let listener = MessageListener { receiver: Mutex::new(receiver), stop, progress };
    listener.wait(py)
}

/// The threads of this process, with its id: a forked child has none of those of its parent.
static SHARED: Mutex<Option<(u32, Arc<rayon::ThreadPool>)>> = Mutex::new(None);

/// The threads that jobs share which ask for no number of their own; one for each processor.
fn shared_pool() -> PyResult<Arc<rayon::ThreadPool>> {
    let own = std::process::id();
    // a child that was forked while its parent held the lock never gets it
    let Ok(mut shared) = SHARED.try_lock() else { return pool(None).map(Arc::new) };
    if let Some((id, pool)) = &*shared
        && *id == own
    {
        return Ok(pool.clone());
    }
    let made = Arc::new(pool(None)?);
    if let Some(of_parent) = shared.replace((own, made.clone())) {
        std::mem::forget(of_parent); // its threads are not here, and nobody may wait for them
    }
    Ok(made)
}

/// A pool of `asked` threads, one for each processor without, and at most a few for each.
pub(crate) fn pool(asked: Option<usize>) -> PyResult<rayon::ThreadPool> {
    let threads = used_threads(asked);
    let built = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    built.map_err(|error| exception(&Failure::Threads { threads, reason: error.to_string() }))
}

/// Python's side.
struct MessageListener<'py, R> {
    receiver: Mutex<Receiver<JobMessage<R>>>,
    stop: Arc<AtomicBool>,
    progress: Option<Bound<'py, PyAny>>,
}

/// What a while of listening brought.
enum ListenResult<R> {
    Heard(JobMessage<R>),
    Nothing,
    /// The job is gone without a word.
    Gone,
}

impl<R: Send> MessageListener<'_, R> {
    fn wait(self, py: Python<'_>) -> PyResult<JobEnd<R>> {
        let mut raised: Option<(PyErr, Instant)> = None;
        loop {
            match self.listen(py) {
                ListenResult::Heard(JobMessage::Words(words, share)) => {
                    let (done, of) = share.unzip();
                    let tell = |progress: &Bound<'_, PyAny>| progress.call1((words, done, of)).map(|_| ());
                    let told = self.progress.as_ref().map_or(Ok(()), tell);
                    self.note(&mut raised, told);
                }
                ListenResult::Heard(JobMessage::Done(result)) => {
                    return ended(py, *result, raised.map(|(error, _)| error));
                }
                ListenResult::Gone => {
                    let words =
                        "kalfit came to a halt by a fault of its own: please report it with the model and the data";
                    return Err(raised.map_or_else(|| PyRuntimeError::new_err(words), |(error, _)| error));
                }
                ListenResult::Nothing => {}
            }
            self.note(&mut raised, py.check_signals());
            if raised.as_ref().is_some_and(|(_, since)| since.elapsed() > PATIENCE) {
                break;
            }
        }
        Err(raised.expect("the loop ends only after an exception").0)
    }

    fn listen(&self, py: Python<'_>) -> ListenResult<R> {
        let receiver = &self.receiver;
        let heard = py.detach(|| receiver.lock().expect("there is one listener").recv_timeout(LISTEN));
        match heard {
            Ok(heard) => ListenResult::Heard(heard),
            Err(RecvTimeoutError::Timeout) => ListenResult::Nothing,
            Err(RecvTimeoutError::Disconnected) => ListenResult::Gone,
        }
    }

    /// After the first exception the job is asked to stop.
    fn note(&self, raised: &mut Option<(PyErr, Instant)>, outcome: PyResult<()>) {
        if let (Err(error), None) = (outcome, &raised) {
            self.stop.store(true, Ordering::Relaxed);
            *raised = Some((error, Instant::now()));
        }
    }
}

/// What comes of a job that ended: an exception of Python's own goes before the job's, and Ctrl-C leaves a result that there is.
fn ended<R>(py: Python<'_>, result: Result<R, Failure>, raised: Option<PyErr>) -> PyResult<JobEnd<R>> {
    match (result, raised) {
        (Ok(result), None) => Ok(JobEnd { result, interrupted: false }),
        (Ok(result), Some(error)) if error.is_instance_of::<PyKeyboardInterrupt>(py) => {
            Ok(JobEnd { result, interrupted: true })
        }
        (_, Some(error)) => Err(error),
        (Err(failure), None) => Err(exception(&failure)),
    }
}
