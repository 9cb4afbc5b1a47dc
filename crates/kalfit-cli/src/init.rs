//! `kalfit init`: a starter model and its data in a folder, both or none, and nothing that stood there is touched.

use std::io::Write;
use std::path::{Path, PathBuf};

use crate::templates::Template;

/// File of the schema of models, beside the model.
const SCHEMA_FILE: &str = "kalfit-model.schema.json";

/// What was asked for.
#[derive(Debug)]
pub(crate) struct InitJob {
    pub(crate) template: Template,
    pub(crate) folder: PathBuf,
}

/// Why nothing was written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum InitError {
    #[error("`{}` exists, and would be replaced", path.display())]
    Exists { path: PathBuf },
    #[error("`{}` is not a folder", path.display())]
    NotAFolder { path: PathBuf },
    #[error("cannot make the folder `{}`: {source}", path.display())]
    NoFolder { path: PathBuf, source: std::io::Error },
    #[error("cannot write `{}`: {source}", path.display())]
    Unwritable { path: PathBuf, source: std::io::Error },
}

impl InitError {
    pub(crate) fn hint(&self) -> Option<&'static str> {
        match self {
            InitError::Exists { .. } => Some("name another folder, `kalfit init TEMPLATE DIR`, or move the file away"),
            InitError::NotAFolder { .. } => Some("name a folder, which is made if need be"),
            InitError::NoFolder { .. } | InitError::Unwritable { .. } => None,
        }
    }
}

/// Writes the files; what to tell the user.
pub(crate) fn init(job: &InitJob) -> Result<String, InitError> {
    let InitJob { template, folder } = job;
    let [model, data] = template.files();
    let model_text = format!("#:schema {SCHEMA_FILE}\n{}", model.1);
    let files = [(folder.join(model.0), model_text.as_str()), (folder.join(data.0), data.1)];
    if let Some((path, _)) = files.iter().find(|(path, _)| path.symlink_metadata().is_ok()) {
        return Err(InitError::Exists { path: path.clone() });
    }
    if folder.exists() && !folder.is_dir() {
        return Err(InitError::NotAFolder { path: folder.clone() });
    }
    let made = first_missing(folder);
    std::fs::create_dir_all(folder).map_err(|source| InitError::NoFolder { path: folder.clone(), source })?;
    let schema = (folder.join(SCHEMA_FILE), kalfit_job::model_schema());
    let is_new = schema.0.symlink_metadata().is_err();
    let all: Vec<(PathBuf, &str)> =
        files.iter().cloned().chain(is_new.then(|| (schema.0.clone(), schema.1.as_str()))).collect();
    let written = write_all(folder, &all);
    if let (Err(_), Some(made)) = (&written, made) {
        let _ = remove_empty(folder, &made); // as it was found; what went wrong before is what the user must hear
    }
    written?;
    let [model, data] = files.map(|(path, _)| path);
    Ok(told((&model, &data), template.data_in_words(), is_new.then_some(&schema.0)))
}

/// The outermost folder that is to be made, if any.
fn first_missing(folder: &Path) -> Option<PathBuf> {
    let missing = |folder: &&Path| !folder.as_os_str().is_empty() && !folder.exists();
    folder.ancestors().take_while(missing).last().map(Path::to_owned)
}

/// Removes folders that were made, from the inner to the outer one, as long as they are empty.
fn remove_empty(inner: &Path, outer: &Path) -> std::io::Result<()> {
    inner.ancestors().take_while(|folder| folder.starts_with(outer)).try_for_each(std::fs::remove_dir)
}

/// Fills temporary files first, and moves them into place when all are whole.
fn write_all(folder: &Path, files: &[(PathBuf, &str)]) -> Result<(), InitError> {
    let unwritable = |path: &Path, source| InitError::Unwritable { path: path.to_owned(), source };
    let fill = |(path, text): &(PathBuf, &str)| {
        let mut builder = tempfile::Builder::new();
        builder.prefix(".kalfit-").suffix(".tmp");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o666)); // less the umask, as for any new file
        }
        let here = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        let mut file = builder.tempfile_in(here)?;
        file.write_all(text.as_bytes())?;
        Ok((file, path.clone()))
    };
    let mut full = Vec::new();
    for file in files {
        full.push(fill(file).map_err(|source| unwritable(&file.0, source))?);
    }
    let mut placed: Vec<PathBuf> = Vec::new();
    for (file, path) in full {
        if let Err(error) = file.persist_noclobber(&path) {
            placed.iter().for_each(|path| drop(std::fs::remove_file(path)));
            return Err(match error.error.kind() {
                std::io::ErrorKind::AlreadyExists => InitError::Exists { path },
                _ => unwritable(&path, error.error),
            });
        }
        placed.push(path);
    }
    Ok(())
}

fn told((model, data): (&Path, &Path), words: &str, schema: Option<&PathBuf>) -> String {
    let (shown_model, shown_data) = (model.display(), data.display());
    let (typed_model, typed_data) = (typed(model), typed(data));
    let schema = schema
        .map_or_else(String::new, |path| format!("Wrote {}: the keys of model files, for editors\n", path.display()));
    format!(
        "Wrote {shown_model}: the model, with comments\nWrote {shown_data}: {words}\n{schema}\nNext:\n  kalfit fit {typed_model} {typed_data}\n"
    )
}

/// A path as it is to be typed in a shell.
fn typed(path: &Path) -> String {
    let text = path.display().to_string();
    let text = if text.starts_with('-') { format!("./{text}") } else { text };
    let plain = |c: char| c.is_alphanumeric() || "/._-+,@%:=".contains(c) || (cfg!(windows) && c == '\\');
    if text.chars().all(plain) {
        text
    } else if cfg!(windows) {
        format!("\"{text}\"")
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(unix)]
    fn names_are_typed_so_that_a_shell_takes_them_as_they_are() {
        for (name, expected) in [
            ("bench.toml", "bench.toml"),
            ("my tests/a.toml", "'my tests/a.toml'"),
            ("it's/a.toml", r"'it'\''s/a.toml'"),
            ("-x/a.toml", "./-x/a.toml"),
            ("$HOME/a.toml", "'$HOME/a.toml'"),
        ] {
            assert_eq!(typed(Path::new(name)), expected);
        }
    }
}
