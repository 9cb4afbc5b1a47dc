//! Kinds of files, by name and by first bytes.

/// What a file is read as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FileKind {
    /// Text; with `tab` the delimiter is known.
    Csv { tab: bool },
    /// Parquet.
    Parquet,
    /// Arrow IPC, file format (Feather version 2).
    ArrowFile,
    /// Arrow IPC, stream format.
    ArrowStream,
}

/// Names of formats in messages.
pub(crate) const PARQUET: &str = "Parquet";
pub(crate) const ARROW_IPC: &str = "Arrow IPC";

/// Number of first bytes that tell kinds apart.
pub(crate) const HEAD: usize = 8;

const REFUSED: [(&[u8], &str); 7] = [
    (b"\x1f\x8b", "compressed with gzip"),
    (b"\x28\xb5\x2f\xfd", "compressed with zstd"),
    (b"\xfd7zXZ\0", "compressed with xz"),
    (b"BZh91AY", "compressed with bzip2"),
    (b"PK\x03\x04", "a zip archive or an Excel workbook"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook"),
    (b"FEA1", "a Feather file of version 1"),
];

/// The kind of a file, or what it is that is not read.
pub(crate) fn detect(extension: Option<&str>, head: &[u8]) -> Result<FileKind, &'static str> {
    if let Some((_, found)) = REFUSED.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Err(found);
    }
    let arrow = if head.starts_with(b"ARROW1") { FileKind::ArrowFile } else { FileKind::ArrowStream };
    Ok(match extension {
        Some("csv" | "txt") => FileKind::Csv { tab: false },
        Some("tsv") => FileKind::Csv { tab: true },
        Some("parquet" | "pq") => FileKind::Parquet,
        Some("arrow" | "ipc" | "feather" | "arrows") => arrow,
        _ if head.starts_with(b"PAR1") => FileKind::Parquet,
        _ if head.starts_with(b"ARROW1") || head.starts_with(&[0xff; 4]) => arrow,
        _ => FileKind::Csv { tab: false },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extensions_go_before_first_bytes() {
        assert_eq!(detect(Some("csv"), b"PAR1"), Ok(FileKind::Csv { tab: false }));
        assert_eq!(detect(Some("dat"), b"PAR1\x15"), Ok(FileKind::Parquet));
        assert_eq!(detect(None, b"ARROW1\0\0"), Ok(FileKind::ArrowFile));
        assert_eq!(detect(None, &[0xff, 0xff, 0xff, 0xff, 0x10, 0, 0, 0]), Ok(FileKind::ArrowStream));
        assert_eq!(detect(Some("feather"), b"\xff\xff\xff\xff"), Ok(FileKind::ArrowStream));
        assert_eq!(detect(None, b"a,b\n1,2"), Ok(FileKind::Csv { tab: false }));
        assert_eq!(detect(Some("csv"), b"\x1f\x8b\x08"), Err("compressed with gzip"));
    }
}
