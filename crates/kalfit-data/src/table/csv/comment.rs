//! Lines of comments, taken out of the bytes of a CSV file before anything else looks at them.
//!
//! Each leaves a line of one form feed, so that lines keep their numbers: a row is none, and a blank line, which may be a missing
//! cell in a file of one column, is none either.

use std::io::{self, Read};

/// What stands in the place of a comment.
pub(super) const MARK: &[u8] = b"\x0c";

/// Bytes without the lines that begin with `comment`, which is not empty. In a quoted cell no line is a comment.
pub(super) struct UncommentedBytes<R> {
    bytes: R,
    comment: Vec<u8>,
    state: CommentState,
    /// Read, and not handed out.
    ready: Vec<u8>,
    given: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CommentState {
    /// At the start of a row; so many bytes of the comment's text were seen.
    Start(usize),
    /// In a comment.
    Comment,
    /// In a row. `opens`: a quote here opens a cell, or goes on with one that it seemed to close.
    Row { quoted: bool, opens: bool },
}

impl<R: Read> UncommentedBytes<R> {
    pub(super) fn new(bytes: R, comment: &str) -> UncommentedBytes<R> {
        let comment = comment.as_bytes().to_vec();
        UncommentedBytes { bytes, comment, state: CommentState::Start(0), ready: Vec::new(), given: 0 }
    }

    fn take(&mut self, byte: u8) {
        match self.state {
            CommentState::Start(seen) if byte == self.comment[seen] => {
                self.state = CommentState::Start(seen + 1);
                if seen + 1 == self.comment.len() {
                    self.ready.extend_from_slice(MARK);
                    self.state = CommentState::Comment;
                }
            }
            CommentState::Start(seen) => {
                self.state = CommentState::Row { quoted: false, opens: true };
                let begun = self.comment[..seen].to_vec();
                begun.into_iter().chain([byte]).for_each(|byte| self.of_row(byte));
            }
            CommentState::Comment if byte == b'\n' => {
                self.ready.push(byte);
                self.state = CommentState::Start(0);
            }
            CommentState::Comment => {}
            CommentState::Row { .. } => self.of_row(byte),
        }
    }

    fn of_row(&mut self, byte: u8) {
        let CommentState::Row { quoted, opens } = self.state else { return };
        self.ready.push(byte);
        self.state = match byte {
            b'"' if quoted => CommentState::Row { quoted: false, opens: true },
            b'"' if opens => CommentState::Row { quoted: true, opens: false },
            b'\n' if !quoted => CommentState::Start(0),
            b',' | b';' | b'\t' => CommentState::Row { quoted, opens: !quoted },
            _ => CommentState::Row { quoted, opens: false },
        };
    }

    /// The file has ended.
    fn end(&mut self) {
        if let CommentState::Start(seen) = self.state {
            self.ready.extend_from_slice(&self.comment[..seen]);
            self.state = CommentState::Comment;
        }
    }
}

impl<R: Read> Read for UncommentedBytes<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let mut bytes = [0; 1 << 13];
        while self.given == self.ready.len() && !out.is_empty() {
            self.ready.clear();
            self.given = 0;
            let found = self.bytes.read(&mut bytes)?;
            bytes[..found].iter().for_each(|&byte| self.take(byte));
            if found == 0 {
                self.end();
                break;
            }
        }
        let count = out.len().min(self.ready.len() - self.given);
        out[..count].copy_from_slice(&self.ready[self.given..][..count]);
        self.given += count;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn left(text: &str, comment: &str) -> String {
        let mut left = String::new();
        UncommentedBytes::new(text.as_bytes(), comment).read_to_string(&mut left).unwrap();
        left
    }

    #[test]
    fn lines_of_comments_leave_a_mark_and_nothing_else_changes() {
        assert_eq!(left("# by hand, \"open\na,b\n#\r\n1,2\n#last", "#"), "\x0c\na,b\n\x0c\n1,2\n\x0c");
        assert_eq!(left("a # b\n/ c\n// d\n/", "//"), "a # b\n/ c\n\x0c\n/");
        assert_eq!(left("a,\"\n# not \"\"one\"\n#\n", "#"), "a,\"\n# not \"\"one\"\n\x0c\n");
        assert_eq!(left("a\"b\n# one\n", "#"), "a\"b\n\x0c\n");
    }
}
