//! What is made from the definition of the commands: shell completions and manual pages.

use std::path::{Path, PathBuf};

use clap::{Command, CommandFactory};
use clap_complete::Shell;

use crate::args::Args;

/// Why pages were not written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write manual pages to `{}`: {source}", folder.display())]
pub(crate) struct ManError {
    folder: PathBuf,
    source: std::io::Error,
}

/// The commands, as they are to be documented.
fn commands() -> Command {
    Args::command()
}

/// The script that completes what is typed in a shell.
pub(crate) fn completions(shell: Shell) -> String {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut commands(), "kalfit", &mut script);
    String::from_utf8(script).expect("completions are made of UTF-8")
}

/// The page of the program by itself.
pub(crate) fn man() -> std::io::Result<String> {
    let mut page = Vec::new();
    clap_mangen::Man::new(commands()).render(&mut page)?;
    Ok(String::from_utf8(page).expect("the page is made of UTF-8"))
}

/// Writes the pages of the program and of every command; how many there are. None is in place before all are whole.
pub(crate) fn man_pages(folder: &Path) -> Result<usize, ManError> {
    let failed = |source| ManError { folder: folder.to_owned(), source };
    let made = !folder.exists();
    let place = || -> std::io::Result<()> {
        std::fs::create_dir_all(folder)?;
        let beside = tempfile::Builder::new().prefix(".kalfit-").tempdir_in(folder)?;
        clap_mangen::generate_to(commands(), beside.path())?;
        for page in std::fs::read_dir(beside.path())? {
            let page = page?;
            std::fs::rename(page.path(), folder.join(page.file_name()))?;
        }
        Ok(())
    };
    place().map_err(|source| {
        if made {
            let _ = std::fs::remove_dir(folder); // as it was found; what went wrong is what the user must hear
        }
        failed(source)
    })?;
    Ok(1 + commands().get_subcommands().count())
}
