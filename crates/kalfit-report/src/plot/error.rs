//! Why there is no figure.

/// Why there is no figure.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// The results lack what it would show.
    #[error("the results have nothing for this figure: {0}")]
    Nothing(String),
    /// No such test.
    #[error("test `{test}` is not among those that can be drawn: {known}")]
    NoTest {
        /// What was asked for.
        test: String,
        /// Tests that can be drawn.
        known: String,
    },
    /// It could not be drawn or encoded.
    #[error("cannot draw the figure: {0}")]
    Draw(String),
}
