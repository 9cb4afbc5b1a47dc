//! Where a phase of a test ends, for the phase after it.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};

use crate::reduce::class::Class;
use crate::reduce::terminal::Terminal;

/// x_K given σ.
#[derive(Debug, Clone)]
pub(crate) enum Ending<'a> {
    /// No phase follows.
    None,
    /// x̂_K, and the design class with the rest.
    Class(DVector<f64>, Class),
    /// As it was given.
    Known(Cow<'a, Terminal>),
}

impl Ending<'_> {
    /// x̂_K of a phase that another follows.
    pub(crate) fn mean(&self) -> &DVector<f64> {
        match self {
            Ending::None => unreachable!("a phase that another follows has an end"),
            Ending::Class(mean, _) => mean,
            Ending::Known(terminal) => &terminal.mean,
        }
    }

    /// Ψ_K and a root of P_K of a phase that another follows.
    pub(crate) fn design(&self) -> (&DMatrix<f64>, &DMatrix<f64>) {
        match self {
            Ending::None => unreachable!("a phase that another follows has an end"),
            Ending::Class(_, class) => {
                let end = class.end().expect("it was looked at");
                (&end.sensitivity, &end.root)
            }
            Ending::Known(terminal) => (&terminal.sensitivity, &terminal.root),
        }
    }
}
