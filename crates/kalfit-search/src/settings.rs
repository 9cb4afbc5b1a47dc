//! Settings of a search for α.

use kalfit_estimate as estimate;

/// Method of estimating α; all methods end at the same maximum.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// The paper's Figure 1: μ and Σ are solved on the reductions for each α, an outer step moves α.
    #[default]
    Hybrid,
    /// Maximum likelihood of the innovations, jointly in α, μ and Σ.
    Innovations,
    /// EM on states and noises (Sun's, extended to repeated tests).
    Em,
}

/// Settings of a search for α.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    /// Method of estimating α.
    pub method: Method,
    /// Settings of the search for μ and Σ; its `tolerance` holds for α too.
    pub inner: estimate::Settings,
    /// Number of random starts, in addition to the start computed from the data.
    pub starts: usize,
    /// Seed of the random starts.
    pub seed: u64,
}
