//! Pages of the book and the blocks of code in them.

use std::path::PathBuf;

use crate::root;

/// A page as it is in its file: what it includes is not in it.
pub(crate) struct Page {
    /// From `book/src`.
    pub(crate) path: String,
    pub(crate) lines: Vec<String>,
}

/// A fenced block.
pub(crate) struct Block {
    /// What stands behind the fence: `toml,file=m.toml`.
    pub(crate) info: String,
    /// Index of its first line.
    pub(crate) at: usize,
    /// Index of the fence that closes it.
    pub(crate) end: usize,
}

impl Block {
    pub(crate) fn is(&self, language: &str) -> bool {
        self.info.split(',').next() == Some(language)
    }

    pub(crate) fn says(&self, word: &str) -> bool {
        self.info.split(',').any(|part| part == word)
    }

    /// The value of `key=value`.
    pub(crate) fn value(&self, key: &str) -> Option<&str> {
        self.info.split(',').find_map(|part| part.strip_prefix(key)?.strip_prefix('='))
    }

    pub(crate) fn is_model(&self) -> bool {
        self.is("toml") && !self.says("fragment") && !self.says("hypothesis")
    }
}

impl Page {
    /// The pages of the table of contents, in its order.
    pub(crate) fn all() -> Vec<Page> {
        let summary = std::fs::read_to_string(root().join("book/src/SUMMARY.md")).unwrap();
        let target = |line: &str| Some(line.split_once("](")?.1.split_once(')')?.0.to_owned());
        summary.lines().filter_map(target).map(|path| Page::read(&path)).collect()
    }

    fn read(path: &str) -> Page {
        let text = std::fs::read_to_string(root().join("book/src").join(path));
        let text = text.unwrap_or_else(|error| panic!("SUMMARY.md names {path}: {error}"));
        Page { path: path.to_owned(), lines: text.lines().map(str::to_owned).collect() }
    }

    pub(crate) fn file(&self) -> PathBuf {
        root().join("book/src").join(&self.path)
    }

    pub(crate) fn blocks(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let mut open: Option<(String, usize)> = None;
        for (at, line) in self.lines.iter().enumerate() {
            open = match (line.strip_prefix("```"), open) {
                (Some(_), Some((info, first))) => {
                    blocks.push(Block { info, at: first, end: at });
                    None
                }
                (Some(info), None) => Some((info.to_owned(), at + 1)),
                (None, open) => open,
            };
        }
        assert!(open.is_none(), "{}: a block is not closed", self.path);
        blocks
    }

    /// The text of a block with what it includes.
    pub(crate) fn expanded(&self, block: &Block) -> String {
        self.lines[block.at..block.end].iter().map(|line| self.include(line)).collect()
    }

    /// The page with what it includes.
    pub(crate) fn whole(&self) -> String {
        self.lines.iter().map(|line| self.include(line)).collect()
    }

    fn include(&self, line: &str) -> String {
        let Some(path) = line.trim().strip_prefix("{{#include ").and_then(|rest| rest.strip_suffix("}}")) else {
            return format!("{line}\n");
        };
        let file = self.file().parent().unwrap().join(path.trim());
        std::fs::read_to_string(&file).unwrap_or_else(|error| panic!("{} includes {path}: {error}", self.path))
    }
}
