//! Headers of Parquet pages, in the compact protocol of Thrift: as much of them as tells what a page unpacks to.

use std::io::{self, Read};

use parquet::basic::Encoding;

/// Structures within structures that a header may have.
const DEPTH: usize = 16;

/// What a header says of its page.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PageHeader {
    pub(super) is_dictionary: bool,
    /// Values, of which some may be null.
    pub(super) values: u64,
    /// How they are written; `None` for codes that are not known.
    pub(super) encoding: Option<Encoding>,
    /// Bytes of the page when unpacked, and in the file.
    pub(super) unpacked: u64,
    pub(super) packed: u64,
    /// Bytes of the header itself.
    pub(super) length: u64,
}

/// Numbers of the fields of a header, by the format's definition.
mod field {
    pub(super) const UNPACKED: i16 = 2;
    pub(super) const PACKED: i16 = 3;
    pub(super) const DATA: i16 = 5;
    pub(super) const DICTIONARY: i16 = 7;
    pub(super) const DATA_V2: i16 = 8;
    /// Of the structures in these: the number of values, and their encoding.
    pub(super) const VALUES: i16 = 1;
    pub(super) const ENCODING: i16 = 2;
    pub(super) const ENCODING_V2: i16 = 4;
    /// Algorithm of encryption, in the description of a file.
    pub(super) const ENCRYPTION: i16 = 8;
}

/// Codes of types.
mod code {
    pub(super) const TRUE: u8 = 1;
    pub(super) const FALSE: u8 = 2;
    pub(super) const BYTE: u8 = 3;
    pub(super) const I16: u8 = 4;
    pub(super) const I32: u8 = 5;
    pub(super) const I64: u8 = 6;
    pub(super) const DOUBLE: u8 = 7;
    pub(super) const BINARY: u8 = 8;
    pub(super) const LIST: u8 = 9;
    pub(super) const SET: u8 = 10;
    pub(super) const MAP: u8 = 11;
    pub(super) const STRUCT: u8 = 12;
}

/// Whether the description of a file names an algorithm of encryption: some columns are then encrypted.
///
/// # Errors
/// Bytes that are no such description.
pub(super) fn has_encryption(bytes: impl Read) -> io::Result<bool> {
    let mut found = false;
    CompactReader { bytes, read: 0 }.fields(|_, field, code| {
        found |= (field, code) == (field::ENCRYPTION, code::STRUCT);
        Ok(false)
    })?;
    Ok(found)
}

impl PageHeader {
    /// Reads the header that begins here.
    ///
    /// # Errors
    /// The end of the file, or bytes that are no header.
    pub(super) fn read(bytes: impl Read) -> io::Result<PageHeader> {
        let mut compact = CompactReader { bytes, read: 0 };
        let mut header = PageHeader::default();
        compact.fields(|compact, field, code| {
            match (field, code) {
                (field::UNPACKED, code::I32) => header.unpacked = compact.count()?,
                (field::PACKED, code::I32) => header.packed = compact.count()?,
                (field::DATA | field::DICTIONARY | field::DATA_V2, code::STRUCT) => {
                    header.is_dictionary = field == field::DICTIONARY;
                    let encoding = if field == field::DATA_V2 { field::ENCODING_V2 } else { field::ENCODING };
                    compact.fields(|compact, field, code| {
                        match (field, code) {
                            (field::VALUES, code::I32) => header.values = compact.count()?,
                            (field, code::I32) if field == encoding => header.encoding = known(compact.count()?),
                            _ => return Ok(false),
                        }
                        Ok(true)
                    })?;
                }
                _ => return Ok(false),
            }
            Ok(true)
        })?;
        Ok(PageHeader { length: compact.read, ..header })
    }
}

fn known(code: u64) -> Option<Encoding> {
    Some(match code {
        0 => Encoding::PLAIN,
        2 => Encoding::PLAIN_DICTIONARY,
        3 => Encoding::RLE,
        5 => Encoding::DELTA_BINARY_PACKED,
        6 => Encoding::DELTA_LENGTH_BYTE_ARRAY,
        7 => Encoding::DELTA_BYTE_ARRAY,
        8 => Encoding::RLE_DICTIONARY,
        9 => Encoding::BYTE_STREAM_SPLIT,
        _ => return None,
    })
}

/// Bytes in the compact protocol.
struct CompactReader<R> {
    bytes: R,
    read: u64,
}

fn broken(what: &'static str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

impl<R: Read> CompactReader<R> {
    /// Goes through the fields of a structure: `take` reads the value of a field, of which it is told number and type, or says that it
    /// did not.
    fn fields(&mut self, mut take: impl FnMut(&mut Self, i16, u8) -> io::Result<bool>) -> io::Result<()> {
        let mut field = 0_i16;
        loop {
            let byte = self.byte()?;
            let (step, code) = (i16::from(byte >> 4), byte & 0x0f);
            if byte == 0 {
                return Ok(());
            }
            field = match step {
                0 => i16::try_from(self.integer()?).map_err(|_| broken("the number of a field"))?,
                step => field.checked_add(step).ok_or_else(|| broken("the number of a field"))?,
            };
            if !take(self, field, code)? {
                self.skip(code, DEPTH)?;
            }
        }
    }

    fn skip(&mut self, code: u8, depth: usize) -> io::Result<()> {
        let depth = depth.checked_sub(1).ok_or_else(|| broken("structures within structures"))?;
        match code {
            code::TRUE | code::FALSE => Ok(()),
            code::BYTE => self.byte().map(drop),
            code::I16 | code::I32 | code::I64 => self.varint().map(drop),
            code::DOUBLE => self.pass(8),
            code::BINARY => {
                let length = self.varint()?;
                self.pass(length)
            }
            code::LIST | code::SET => {
                let byte = self.byte()?;
                let count = if byte >> 4 == 15 { self.varint()? } else { u64::from(byte >> 4) };
                (0..count).try_for_each(|_| self.skip_element(byte & 0x0f, depth))
            }
            code::MAP => {
                let count = self.varint()?;
                let codes = if count == 0 { 0 } else { self.byte()? };
                (0..count).try_for_each(|_| {
                    self.skip_element(codes >> 4, depth)?;
                    self.skip_element(codes & 0x0f, depth)
                })
            }
            code::STRUCT => self.fields(|compact, _, code| compact.skip(code, depth).map(|()| true)),
            _ => Err(broken("the type of a field")),
        }
    }

    /// Truths are a byte each where they are elements.
    fn skip_element(&mut self, code: u8, depth: usize) -> io::Result<()> {
        if matches!(code, code::TRUE | code::FALSE) { self.byte().map(drop) } else { self.skip(code, depth) }
    }

    fn byte(&mut self) -> io::Result<u8> {
        let mut byte = [0];
        self.bytes.read_exact(&mut byte)?;
        self.read += 1;
        Ok(byte[0])
    }

    fn pass(&mut self, length: u64) -> io::Result<()> {
        let passed = io::copy(&mut self.bytes.by_ref().take(length), &mut io::sink())?;
        self.read += passed;
        if passed == length { Ok(()) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
    }

    fn varint(&mut self) -> io::Result<u64> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(broken("a number of more than 64 bits"))
    }

    fn integer(&mut self) -> io::Result<i64> {
        let value = self.varint()?;
        Ok((value >> 1) as i64 ^ -((value & 1) as i64))
    }

    fn count(&mut self) -> io::Result<u64> {
        u64::try_from(self.integer()?).map_err(|_| broken("a negative count"))
    }
}
