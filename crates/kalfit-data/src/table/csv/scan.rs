//! Where cells and rows of bytes without quotes begin and end.

/// Cells, one after the other, and the rows that they make.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct CsvCuts {
    /// Where each cell begins, and at last where another would: one byte lies between a cell's end and the next one.
    pub(super) starts: Vec<u32>,
    /// Number of cells up to the end of each row.
    pub(super) rows: Vec<u32>,
}

/// Bytes that are looked at together.
const BLOCK: usize = u64::BITS as usize;

/// Every `delimiter` ends a cell, every line feed a cell and a row; the last row may go without. At most 2^32 bytes.
pub(super) fn cuts(bytes: &[u8], delimiter: u8) -> CsvCuts {
    let mut cuts = CsvCuts { starts: Vec::with_capacity(bytes.len() / 8 + 2), rows: Vec::new() };
    cuts.starts.push(0);
    let (blocks, rest) = bytes.as_chunks::<BLOCK>();
    for (number, block) in blocks.iter().enumerate() {
        cuts.take((number * BLOCK) as u32, ones(block, delimiter), ones(block, b'\n'));
    }
    let (mut last, sound) = ([0; BLOCK], (1 << rest.len()) - 1);
    last[..rest.len()].copy_from_slice(rest);
    cuts.take((bytes.len() - rest.len()) as u32, ones(&last, delimiter) & sound, ones(&last, b'\n') & sound);
    if bytes.last().is_some_and(|last| *last != b'\n') {
        cuts.starts.push(bytes.len() as u32 + 1);
        cuts.rows.push(cuts.cells());
    }
    cuts
}

/// The places of a byte in a block, as the bits of a number.
fn ones(block: &[u8; BLOCK], byte: u8) -> u64 {
    // the product has the lowest bits of eight bytes side by side in its highest byte
    const GATHER: u64 = 0x0102_0408_1020_4080;
    let equal = block.map(|other| u8::from(other == byte));
    let eights = equal.as_chunks::<8>().0.iter().rev();
    eights.fold(0, |ones, eight| ones << 8 | u64::from_le_bytes(*eight).wrapping_mul(GATHER) >> 56)
}

impl CsvCuts {
    fn cells(&self) -> u32 {
        self.starts.len() as u32 - 1
    }

    /// Takes in a block that begins at `from`, by the places of its delimiters and line feeds.
    fn take(&mut self, from: u32, delimiters: u64, mut feeds: u64) {
        let (before, mut ends) = (self.cells(), delimiters | feeds);
        while feeds != 0 {
            let up_to = feeds ^ (feeds - 1);
            self.rows.push(before + (ends & up_to).count_ones());
            feeds &= feeds - 1;
        }
        while ends != 0 {
            self.starts.push(from + ends.trailing_zeros() + 1);
            ends &= ends - 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;

    /// The same, byte by byte.
    fn slowly(bytes: &[u8], delimiter: u8) -> CsvCuts {
        let mut cuts = CsvCuts { starts: vec![0], rows: Vec::new() };
        let unended = bytes.last().is_some_and(|last| *last != b'\n').then_some(&b'\n');
        for (at, &byte) in bytes.iter().chain(unended).enumerate() {
            if byte == delimiter || byte == b'\n' {
                cuts.starts.push(at as u32 + 1);
            }
            if byte == b'\n' {
                cuts.rows.push(cuts.cells());
            }
        }
        cuts
    }

    proptest! {
        #[test]
        fn cuts_are_where_a_look_at_every_byte_finds_them(
            text in "[0-9,;\n\r]{0,300}", dense in "[,\n]{0,200}", any in vec(any::<u8>(), 0..300), delimiter in "[,;\t]"
        ) {
            for bytes in [text.as_bytes(), dense.as_bytes(), &any] {
                prop_assert_eq!(cuts(bytes, delimiter.as_bytes()[0]), slowly(bytes, delimiter.as_bytes()[0]));
            }
        }
    }

    #[test]
    fn a_byte_is_found_at_each_place_of_a_block_and_no_other_byte_is() {
        for place in 0..BLOCK {
            for byte in 0..=u8::MAX {
                let mut block = [byte ^ 1; BLOCK];
                block[place] = byte;
                assert_eq!(ones(&block, byte), 1 << place, "byte {byte} at {place}");
                assert_eq!(ones(&block, byte ^ 0x80), 0, "byte {byte} at {place}");
            }
        }
    }
}
