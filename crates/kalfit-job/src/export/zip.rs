//! A zip archive of files that are not compressed. Format: APPNOTE.TXT of PKWARE, sections 4.3.7, 4.3.12 and 4.3.16.

/// Version of the format that is needed: 2.0.
const VERSION: u16 = 20;
/// 1 January 1980, the first day there is: a file says the same whenever it is made.
const DATE: u16 = 0x21;
/// Names are UTF-8.
const UTF8: u16 = 1 << 11;

/// An archive that is being made.
#[derive(Debug, Default)]
pub(super) struct ZipArchive {
    bytes: Vec<u8>,
    directory: Vec<u8>,
    files: u16,
}

impl ZipArchive {
    /// Adds a file.
    pub(super) fn add(&mut self, name: &str, contents: &[u8]) {
        let offset = self.bytes.len() as u32;
        let mut facts = Vec::new();
        short(&mut facts, &[VERSION, UTF8, 0, 0, DATE]);
        let size = contents.len() as u32;
        long(&mut facts, &[crc32(contents), size, size]);
        short(&mut facts, &[name.len() as u16, 0]);
        self.bytes.extend(b"PK\x03\x04");
        self.bytes.extend(&facts);
        self.bytes.extend(name.as_bytes());
        self.bytes.extend(contents);
        self.directory.extend(b"PK\x01\x02");
        short(&mut self.directory, &[VERSION]);
        self.directory.extend(&facts);
        short(&mut self.directory, &[0, 0, 0]); // comment, disk, attributes
        long(&mut self.directory, &[0, offset]);
        self.directory.extend(name.as_bytes());
        self.files += 1;
    }

    /// The archive.
    pub(super) fn finish(self) -> Vec<u8> {
        let ZipArchive { mut bytes, directory, files } = self;
        let offset = bytes.len() as u32;
        bytes.extend(&directory);
        bytes.extend(b"PK\x05\x06");
        short(&mut bytes, &[0, 0, files, files]);
        long(&mut bytes, &[directory.len() as u32, offset]);
        short(&mut bytes, &[0]);
        bytes
    }
}

fn short(bytes: &mut Vec<u8>, numbers: &[u16]) {
    numbers.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
}

fn long(bytes: &mut Vec<u8>, numbers: &[u32]) {
    numbers.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
}

/// The checksum of zip: polynomial 0xEDB88320, reflected.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        let bit = |crc: u32, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
        (0..8).fold(crc ^ u32::from(*byte), bit)
    };
    !bytes.iter().fold(!0, step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_the_standard() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
        assert_eq!(crc32(b""), 0);
    }
}
