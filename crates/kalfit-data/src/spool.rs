//! Standard input, which comes only once, for a reader that may have to start again.

use std::io::{self, Read};

use crate::room::{bytes_in_words, memory_left};

/// Standard input with a memory: what was read can be read again from the start.
pub(crate) struct StdinSpool<'a> {
    source: &'a mut dyn Read,
    kept: Vec<u8>,
    keeps: bool,
}

impl<'a> StdinSpool<'a> {
    /// Remembers what passes only when `keeps` says that it may be needed again.
    pub(crate) fn new(source: &'a mut dyn Read, keeps: bool) -> StdinSpool<'a> {
        StdinSpool { source, kept: Vec::new(), keeps }
    }

    /// What comes from now on need not be remembered.
    pub(crate) fn last_time(&mut self) {
        self.keeps = false;
    }

    /// Makes room for further bytes, of which there must be some: room that grows does so by as much as it is.
    fn grow(&mut self, further: usize) -> io::Result<()> {
        const LARGE: usize = 1 << 24;
        let kept = self.kept.len();
        if kept < LARGE || kept + further <= self.kept.capacity() {
            return Ok(());
        }
        let Some(left) = memory_left().filter(|left| *left < 2 * kept as u64) else { return Ok(()) };
        let (kept, left) = (bytes_in_words(kept as u64), bytes_in_words(left));
        let reason = format!("{kept} of it are kept, as a test may come back, and {left} of memory are left");
        Err(io::Error::new(io::ErrorKind::OutOfMemory, reason))
    }

    /// All of it, from the start.
    pub(crate) fn rewound(&mut self) -> RewoundStdin<'_, 'a> {
        RewoundStdin { spool: self, position: 0 }
    }
}

/// One reading of a [`StdinSpool`].
pub(crate) struct RewoundStdin<'s, 'a> {
    spool: &'s mut StdinSpool<'a>,
    position: usize,
}

impl Read for RewoundStdin<'_, '_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let spool = &mut *self.spool;
        if self.position < spool.kept.len() {
            let again = (&spool.kept[self.position..]).read(buffer)?;
            self.position += again;
            return Ok(again);
        }
        let fresh = spool.source.read(buffer)?;
        if spool.keeps {
            spool.grow(fresh)?;
            spool.kept.extend_from_slice(&buffer[..fresh]);
            self.position += fresh;
        }
        Ok(fresh)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_read_comes_again_and_the_rest_follows() {
        let mut source: &[u8] = b"abcdefgh";
        let mut spool = StdinSpool::new(&mut source, true);
        let mut start = [0; 3];
        spool.rewound().read_exact(&mut start).unwrap();
        assert_eq!(&start, b"abc");
        spool.last_time();
        let mut all = String::new();
        spool.rewound().read_to_string(&mut all).unwrap();
        assert_eq!(all, "abcdefgh");
        assert_eq!(spool.kept, b"abc", "the second reading is not kept");
    }
}
