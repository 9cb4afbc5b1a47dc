//! The tests of model files, one program.

mod accepts;
mod digest;
mod give;
mod hypothesis;
mod hypothesis_phases;
mod in_code;
mod levels;
mod linear;
mod never_panics;
mod phases;
mod refuses;
mod set;

use kalfit::Model;
use kalfit_spec::{Hypothesis, Spec};

/// The model of a file without phases.
pub(crate) trait Only {
    fn only(&self) -> Model;
}

impl Only for Spec {
    fn only(&self) -> Model {
        self.model.shared().clone()
    }
}

impl Only for Hypothesis {
    fn only(&self) -> Model {
        self.model.shared().clone()
    }
}
