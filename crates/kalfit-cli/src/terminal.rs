//! What the terminal can do.

use std::io::{IsTerminal, Write};

use anstream::stream::RawStream;
use anstream::{AutoStream, ColorChoice};
use kalfit_report::TextStyle;

/// Wider lines are hard to read.
const WIDEST: usize = 120;

/// How to lay out what goes to standard output.
pub(crate) fn style() -> TextStyle {
    let mut style = TextStyle::default();
    if std::io::stdout().is_terminal()
        && let Some((terminal_size::Width(width), _)) = terminal_size::terminal_size()
    {
        style.width = usize::from(width).min(WIDEST);
    }
    style.color = wants_color(&std::io::stdout());
    style
}

/// Whether messages to standard error may be coloured.
pub(crate) fn color_on_stderr() -> bool {
    wants_color(&std::io::stderr())
}

/// Fixes whether there are colours, where an option does.
pub(crate) fn choose_color(choice: clap::ColorChoice) {
    match choice {
        clap::ColorChoice::Auto => {}
        clap::ColorChoice::Always => ColorChoice::Always.write_global(),
        clap::ColorChoice::Never => ColorChoice::Never.write_global(),
    }
}

/// As `--color` says. Without it as the help goes by, too: on terminals that know colours, unless `NO_COLOR` is set or `CLICOLOR`
/// is 0; with `CLICOLOR_FORCE` everywhere.
fn wants_color(stream: &impl RawStream) -> bool {
    AutoStream::choice(stream) != ColorChoice::Never
}

/// Writes to standard output. A reader that has gone away (`kalfit fit … | head`) is no error.
pub(crate) fn print(text: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// Writes to standard error, where nothing can be done about a failure.
pub(crate) fn complain(text: &str) {
    let _ = std::io::stderr().lock().write_all(text.as_bytes());
}

/// Writes warnings to standard error, each on a line of its own; of very many the first.
pub(crate) fn warn(warnings: &[String]) {
    const MOST: usize = 20;
    for warning in warnings.iter().take(MOST) {
        complain(&format!("warning: {}\n", kalfit::record::plain_text(warning)));
    }
    if warnings.len() > MOST {
        complain(&format!("warning: and {} more of this kind\n", warnings.len() - MOST));
    }
}
