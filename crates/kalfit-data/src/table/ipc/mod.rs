//! Arrow IPC, stream and file format.
//!
//! Messages are taken from the bytes here and decoded by the library, so that what they declare can be checked first.

mod file;
mod message;
mod stream;

pub(super) use file::open as open_file;
pub(super) use stream::open as open_stream;
