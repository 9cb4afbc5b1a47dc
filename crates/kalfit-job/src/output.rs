//! A result file: whole or not at all. What stood there before survives every failure.

use std::collections::BTreeSet;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// Why a result file cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// There is no such folder.
    #[error("the folder `{}` for the output {found}", folder.display())]
    NoFolder {
        /// The folder.
        folder: PathBuf,
        /// What it is.
        found: &'static str,
    },
    /// It cannot be a file.
    #[error("the output `{}` is {found}, expected the name of a file", path.display())]
    NotAFile {
        /// The file.
        path: PathBuf,
        /// What it is.
        found: &'static str,
    },
    /// Its ending says that something else is in it.
    #[error("the output `{}` would hold {contents}, which its ending does not say", path.display())]
    Ending {
        /// The file.
        path: PathBuf,
        /// What would be written.
        contents: FileContents,
        /// The option that names it.
        option: &'static str,
    },
    /// It is there, and can be neither replaced nor written to.
    #[error("the output `{}` is {found}, expected a file that can be replaced", path.display())]
    Fixed {
        /// The file.
        path: PathBuf,
        /// What it is.
        found: &'static str,
    },
    /// It is read, too.
    #[error("the output `{}` is one of the inputs", path.display())]
    IsInput {
        /// The file.
        path: PathBuf,
    },
    /// Two outputs would be one file.
    #[error("both outputs are `{}`, expected two files", path.display())]
    Twice {
        /// The file.
        path: PathBuf,
    },
    /// The system could not write.
    #[error("cannot write `{}`: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The system could not write a file without a name.
    #[error("cannot write a temporary file: {source}")]
    Temporary {
        /// What the system said.
        source: std::io::Error,
    },
}

impl OutputError {
    pub(crate) fn hint(&self) -> Option<&'static str> {
        match self {
            OutputError::NoFolder { .. } => Some("name a folder that exists"),
            OutputError::NotAFile { .. } => Some("`--out` takes a file such as `fit.json`"),
            OutputError::Ending { option: "--report", .. } => Some(
                "name it `.html`, from which a browser prints a PDF: `--report` takes a file for the page, `--out` one for the results, as JSON",
            ),
            OutputError::Ending { contents: FileContents::Figure, .. } => Some("name it `.svg`, `.pdf` or `.png`"),
            OutputError::Ending { contents: FileContents::Page, .. } => {
                Some("name it `.html`: it is a page for a browser")
            }
            OutputError::Ending { option: "--as", .. } => Some(
                "the endings are `.json`, `.npz`, `.mat`, `.h` and `.py`: give the file that of its format, or leave `--as` out",
            ),
            OutputError::Ending { .. } => {
                Some("name it `.json`; a page for a browser is written by `--report fit.html` and by `kalfit report`")
            }
            OutputError::Fixed { .. } => Some(
                "name another file, or take away what protects this one; a folder may be mounted in place of a file",
            ),
            OutputError::IsInput { .. } | OutputError::Twice { .. } => Some("give the output a name of its own"),
            OutputError::Io { .. } => None,
            OutputError::Temporary { .. } => Some("name a file for the table"),
        }
    }
}

/// What a file will hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileContents {
    /// Results.
    Json,
    /// A report.
    Page,
    /// Arrays of numpy.
    Npz,
    /// Variables of Matlab.
    Mat,
    /// A header for C and C++.
    Header,
    /// A module of Python.
    Module,
    /// A picture.
    Figure,
}

impl std::fmt::Display for FileContents {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            FileContents::Json => "JSON",
            FileContents::Page => "a page of HTML",
            FileContents::Npz => "arrays of numpy",
            FileContents::Mat => "variables of Matlab",
            FileContents::Header => "a header for C",
            FileContents::Module => "a module of Python",
            FileContents::Figure => "a figure",
        })
    }
}

impl FileContents {
    /// A name may have any ending but that of another kind of file which the program reads or writes; what stands behind a
    /// page is opened by its ending, so a page has its own or none.
    fn suits(self, path: &Path) -> bool {
        const KINDS: [&str; 17] = [
            "json", "html", "htm", "csv", "tsv", "parquet", "arrow", "toml", "md", "npz", "mat", "h", "hh", "hpp",
            "py", "svg", "png",
        ];
        let own: &[&str] = match self {
            FileContents::Json => &["json"],
            FileContents::Page => &["html", "htm"],
            FileContents::Npz => &["npz"],
            FileContents::Mat => &["mat"],
            FileContents::Header => &["h", "hh", "hpp"],
            FileContents::Module => &["py"],
            FileContents::Figure => &["svg", "png"],
        };
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        let is_open = |ending: &str| self != FileContents::Page && !KINDS.contains(&ending);
        ending.is_none_or(|ending| own.contains(&ending.as_str()) || is_open(&ending))
    }
}

/// A place to write to that was found sound before the work began.
#[derive(Debug)]
pub(crate) struct OutputFile {
    /// As the user named it.
    named: PathBuf,
    /// With links followed, so that a link stays a link.
    target: PathBuf,
    folder: PathBuf,
}

impl OutputFile {
    /// Checks that a file of this name can be written and is not among the inputs.
    pub(crate) fn prepare(path: &Path, inputs: &[&Path]) -> Result<OutputFile, OutputError> {
        let not_a_file = |found| OutputError::NotAFile { path: path.to_owned(), found };
        if path.as_os_str().is_empty() || path == Path::new("-") || path.file_name().is_none() {
            return Err(not_a_file("not a file name"));
        }
        let fixed = |found| OutputError::Fixed { path: path.to_owned(), found };
        let target = followed(path).map_err(|source| OutputError::Io { path: path.to_owned(), source })?;
        match std::fs::metadata(&target) {
            Ok(found) if found.is_dir() => return Err(not_a_file("a folder")),
            Ok(found) if !found.is_file() => return Err(not_a_file("a device or a pipe")),
            Ok(found) if found.permissions().readonly() => return Err(fixed("read-only")),
            Ok(_) if is_mounted(&target) => return Err(fixed("mounted by itself")),
            _ => {}
        }
        if inputs.iter().any(|input| input.canonicalize().is_ok_and(|input| input == target)) {
            return Err(OutputError::IsInput { path: path.to_owned() });
        }
        let folder = match target.parent() {
            Some(parent) if parent != Path::new("") => parent.to_owned(),
            _ => PathBuf::from("."),
        };
        if !folder.is_dir() {
            let found = if folder.exists() { "is not a folder" } else { "does not exist" };
            return Err(OutputError::NoFolder { folder, found });
        }
        let output = OutputFile { named: path.to_owned(), target, folder };
        output.temporary()?; // gone again at once: better to fail before hours of work than after
        Ok(output)
    }

    /// A file for results, where one is named.
    pub(crate) fn results(path: Option<&Path>, inputs: &[&Path]) -> Result<Option<OutputFile>, OutputError> {
        OutputFile::prepare_for(("--out", FileContents::Json), path, inputs)
    }

    /// As [`OutputFile::prepare`], for these contents under this option: a name that says otherwise is refused.
    pub(crate) fn prepare_for(
        (option, contents): (&'static str, FileContents),
        path: Option<&Path>,
        inputs: &[&Path],
    ) -> Result<Option<OutputFile>, OutputError> {
        let Some(path) = path else { return Ok(None) };
        let output = OutputFile::prepare(path, inputs)?;
        if contents.suits(path) {
            Ok(Some(output))
        } else {
            Err(OutputError::Ending { path: path.to_owned(), contents, option })
        }
    }

    /// Refuses two outputs in one place.
    pub(crate) fn refuse_same(&self, other: Option<&OutputFile>) -> Result<(), OutputError> {
        match other {
            Some(other) if self.is_same(other) => Err(OutputError::Twice { path: other.named.clone() }),
            _ => Ok(()),
        }
    }

    /// Its name as the user gave it.
    pub(crate) fn name(&self) -> String {
        self.named.display().to_string()
    }

    /// Its name without folder and ending.
    pub(crate) fn stem(&self) -> String {
        self.named.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// Writes the record beside the target and moves it into place.
    pub(crate) fn write(&self, record: &impl serde::Serialize) -> Result<(), OutputError> {
        self.write_by(|file| {
            let mut writer = std::io::BufWriter::new(file);
            crate::json::to_writer(&mut writer, record)?;
            writer.write_all(b"\n")?;
            writer.flush()
        })
    }

    /// Writes beside the target and moves what was written into place.
    pub(crate) fn write_by(
        &self,
        write: impl FnOnce(&std::fs::File) -> std::io::Result<()>,
    ) -> Result<(), OutputError> {
        let pending = self.begin()?;
        write(pending.file()).map_err(|source| self.io(source))?;
        pending.finish().map(|_| ())
    }

    /// Writes bytes beside the target and moves them into place.
    pub(crate) fn write_bytes(&self, bytes: &[u8]) -> Result<(), OutputError> {
        let pending = self.begin()?;
        pending.file().write_all(bytes).map_err(|source| self.io(source))?;
        pending.finish().map(|_| ())
    }

    /// A file beside the target, to be moved into place when it is whole.
    pub(crate) fn begin(&self) -> Result<PendingFile<'_>, OutputError> {
        Ok(PendingFile(PendingPlace::Beside(self, self.temporary()?)))
    }

    /// True when both would be one file.
    fn is_same(&self, other: &OutputFile) -> bool {
        let place =
            |output: &OutputFile| Some((output.folder.canonicalize().ok()?, output.target.file_name()?.to_owned()));
        place(self) == place(other)
    }

    fn temporary(&self) -> Result<TemporaryFile, OutputError> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(".kalfit-").suffix(".tmp");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // What any new file gets, less the umask; by default only the owner could read it.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let mut known = TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner); // before there is a file
        let file = builder.tempfile_in(&self.folder).map_err(|source| self.io(source))?;
        known.insert(file.path().to_owned());
        Ok(TemporaryFile { path: file.path().to_owned(), file: Some(file) })
    }

    fn io(&self, source: std::io::Error) -> OutputError {
        OutputError::Io { path: self.named.clone(), source }
    }
}

/// Links that are followed one after the other.
const LINKS: usize = 40;

/// Where a file is, or would be, with links followed, also those to what is not there yet.
///
/// # Errors
/// A name that no file can have, links that go round.
fn followed(path: &Path) -> std::io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..LINKS {
        match path.canonicalize() {
            // of folders something better is said elsewhere
            Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {}
            found => return found,
        }
        let Ok(link) = std::fs::read_link(&path) else { return Ok(path) };
        path = path.parent().unwrap_or(Path::new("")).join(link);
    }
    path.canonicalize()
}

/// True for a file that is mounted by itself, as containers do: nothing can take its place.
fn is_mounted(target: &Path) -> bool {
    let Ok(mounts) = std::fs::read_to_string("/proc/self/mountinfo") else { return false };
    // the fifth word of a line; spaces and the like are written in octal digits
    let escaped =
        |place: &str| place.replace("\\040", " ").replace("\\011", "\t").replace("\\012", "\n").replace("\\134", "\\");
    mounts.lines().filter_map(|line| line.split(' ').nth(4)).any(|place| Path::new(&escaped(place)) == target)
}

/// The temporary files that there are.
static TEMPORARY: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Whether all files of a command are in place.
static IN_PLACE: AtomicBool = AtomicBool::new(false);

/// Removes the temporary files of all jobs, and keeps jobs from making any more: for a process that ends at once, while jobs
/// run. False, and nothing is removed, where all files of the command are in place already: it is then done but for its last
/// words. Files that are whole stay.
pub fn abandon() -> bool {
    let known = TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner);
    if IN_PLACE.load(Ordering::SeqCst) {
        return false;
    }
    known.iter().for_each(|path| drop(std::fs::remove_file(path)));
    std::mem::forget(known); // whoever wants another one waits for the end
    true
}

/// Moves all files of a command into place, all or none as far as the system lets: what can fail or take long is done before
/// the first is moved, and no signal ends the process between two of them. The files themselves where they have no name.
pub(crate) fn finish_together<const N: usize>(
    mut files: [Option<PendingFile<'_>>; N],
) -> Result<[Option<std::fs::File>; N], OutputError> {
    for file in files.iter().flatten() {
        file.prepare()?;
    }
    let mut found = [const { None }; N];
    // held until all are moved; `files` outlive it, as each takes it when it goes
    let _known = TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner);
    for (place, file) in found.iter_mut().zip(&mut files) {
        if let Some(PendingFile(PendingPlace::Beside(output, temporary))) = file {
            let own = temporary.file.take().expect("it is not in its place yet");
            own.persist(&output.target).map_err(|error| output.io(error.error))?;
        } else if let Some(PendingFile(PendingPlace::Nameless(own))) = file.take() {
            *place = Some(own);
        }
    }
    IN_PLACE.store(true, Ordering::SeqCst);
    Ok(found)
}

/// A temporary file that is known until it is gone or in its place.
#[derive(Debug)]
struct TemporaryFile {
    path: PathBuf,
    /// None once it is in its place.
    file: Option<tempfile::NamedTempFile>,
}

impl TemporaryFile {
    fn file(&self) -> &std::fs::File {
        self.file.as_ref().expect("it is not in its place yet").as_file()
    }

    fn persist(mut self, target: &Path) -> std::io::Result<()> {
        let file = self.file.take().expect("it is not in its place yet");
        file.persist(target).map(drop).map_err(|error| error.error)
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        self.file = None;
        TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.path);
    }
}

/// Where a table goes.
#[derive(Debug)]
pub(crate) enum OutputTarget {
    /// Into a file with a name.
    Named(OutputFile),
    /// Into a file without one, to be handed back.
    Nameless,
}

impl OutputTarget {
    /// As [`OutputFile::prepare`], where there is a name.
    pub(crate) fn prepare(path: Option<&Path>, inputs: &[&Path]) -> Result<OutputTarget, OutputError> {
        path.map_or(Ok(OutputTarget::Nameless), |path| Ok(OutputTarget::Named(OutputFile::prepare(path, inputs)?)))
    }

    /// Refuses two outputs in one place.
    pub(crate) fn refuse_same(&self, other: Option<&OutputFile>) -> Result<(), OutputError> {
        match self {
            OutputTarget::Named(output) => output.refuse_same(other),
            OutputTarget::Nameless => Ok(()),
        }
    }

    /// Its name as the user gave it.
    pub(crate) fn name(&self) -> Option<String> {
        match self {
            OutputTarget::Named(output) => Some(output.name()),
            OutputTarget::Nameless => None,
        }
    }

    /// A file to write to.
    pub(crate) fn begin(&self) -> Result<PendingFile<'_>, OutputError> {
        match self {
            OutputTarget::Named(output) => output.begin(),
            OutputTarget::Nameless => {
                let file = tempfile::tempfile().map_err(|source| OutputError::Temporary { source })?;
                Ok(PendingFile(PendingPlace::Nameless(file)))
            }
        }
    }
}

/// A file that is being written; it is gone again unless it is finished.
#[derive(Debug)]
pub(crate) struct PendingFile<'a>(PendingPlace<'a>);

#[derive(Debug)]
enum PendingPlace<'a> {
    Beside(&'a OutputFile, TemporaryFile),
    Nameless(std::fs::File),
}

impl PendingFile<'_> {
    /// What the user named.
    pub(crate) fn name(&self) -> String {
        match &self.0 {
            PendingPlace::Beside(output, _) => output.name(),
            PendingPlace::Nameless(_) => "a temporary file".to_owned(),
        }
    }

    /// Where to write.
    pub(crate) fn file(&self) -> &std::fs::File {
        match &self.0 {
            PendingPlace::Beside(_, temporary) => temporary.file(),
            PendingPlace::Nameless(file) => file,
        }
    }

    /// Does what can take long or fail before a file is moved.
    fn prepare(&self) -> Result<(), OutputError> {
        let PendingPlace::Beside(output, file) = &self.0 else { return Ok(()) };
        file.file().sync_all().map_err(|source| output.io(source))?;
        if let Ok(old) = std::fs::metadata(&output.target) {
            std::fs::set_permissions(&file.path, old.permissions()).map_err(|source| output.io(source))?;
        }
        Ok(())
    }

    /// Moves it into place; the file itself when it has none.
    pub(crate) fn finish(self) -> Result<Option<std::fs::File>, OutputError> {
        self.prepare()?;
        let (output, file) = match self.0 {
            PendingPlace::Beside(output, file) => (output, file),
            PendingPlace::Nameless(file) => return Ok(Some(file)),
        };
        file.persist(&output.target).map_err(|source| output.io(source))?;
        Ok(None)
    }
}
