//! Memory for the data of long records, which waits for the next test: fresh pages cost as much as filling them. (A fit of
//! six records of a million rows spent a tenth of its time in fresh pages.)

use std::sync::{Mutex, PoisonError};

use crate::reduce::data::Data;
use crate::reduce::known_steps::MIN_LONG_ROWS;

/// Memory that waits for tests; as much waits as was in use at one time.
#[derive(Debug, Default)]
pub(crate) struct DataMemory(Mutex<Vec<DataBuffers>>);

/// Memory for the data of a test, and of a block of tests in lanes; its numbers have no meaning.
#[derive(Debug, Default)]
pub(crate) struct DataBuffers {
    pub(crate) data: Data,
    pub(crate) block: Vec<f64>,
}

impl DataMemory {
    /// Memory that has waited, or none.
    pub(crate) fn take(&self) -> DataBuffers {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    /// Lets the memory of long records wait for further tests.
    pub(crate) fn give_back(&self, buffers: DataBuffers) {
        if buffers.data.values.capacity().max(buffers.block.capacity()) >= MIN_LONG_ROWS {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).push(buffers);
        }
    }
}
