//! What a phase inherits.

use crate::ensemble::Test;
use crate::model::{Alpha, PhasedModel};
use crate::reduce::ReduceError;

#[derive(Debug)]
pub(crate) struct Carrier;

impl Carrier {
    pub(crate) fn of(_model: &PhasedModel, _at: usize, _alpha: &Alpha) -> Result<Option<Carrier>, ReduceError> {
        Ok(None)
    }

    pub(crate) fn inherit(&self, _rows: &Test, _before: &[f64], _entering: &mut [f64]) -> Result<(), ReduceError> {
        Ok(())
    }
}
