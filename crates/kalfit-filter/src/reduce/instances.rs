//! The measurement of the model and the row of each scalar measurement of a test.

/// One scalar measurement of a test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Instance {
    pub meter: usize,
    /// Row of the test in which it was measured.
    pub row: usize,
}

/// All scalar measurements of a test, in the order of the design. Measurements of repeated steps are stored once.
#[derive(Debug, Clone, Default)]
pub struct Instances {
    blocks: Vec<RepeatedEntries>,
    entries: Vec<Instance>,
    /// Start of the last step in `entries`.
    step: usize,
    /// First row of the last step, in its first occurrence.
    row: usize,
    len: usize,
}

/// Entries that occur `count` times, `height` rows later each time.
#[derive(Debug, Clone, Copy)]
struct RepeatedEntries {
    first: usize,
    /// Index of the first entry of the block, which ends at the first entry of the next block.
    entry: usize,
    count: usize,
    height: usize,
}

impl Instances {
    pub(crate) fn clear(&mut self) {
        self.blocks.clear();
        self.entries.clear();
        (self.step, self.row, self.len) = (0, 0, 0);
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Begins a step whose first row is `row`.
    pub(crate) fn begin(&mut self, row: usize) {
        (self.step, self.row) = (self.entries.len(), row);
        if self.blocks.last().is_none_or(|block| block.count > 1) {
            self.blocks.push(RepeatedEntries { first: self.len, entry: self.step, count: 1, height: 0 });
        }
    }

    /// Appends a scalar measurement to the last step, which is not repeated yet.
    pub(crate) fn push(&mut self, instance: Instance) {
        self.entries.push(instance);
        self.len += 1;
    }

    /// The entries of the last step, in its first occurrence.
    pub(crate) fn last_step(&self) -> &[Instance] {
        &self.entries[self.step..]
    }

    /// First row of the last step, in its first occurrence.
    pub(crate) fn first_row(&self) -> usize {
        self.row
    }

    /// Appends the last step `many` more times, each `height` rows later.
    pub(crate) fn repeat(&mut self, many: usize, height: usize) {
        let (width, last) = (self.entries.len() - self.step, self.blocks.len() - 1);
        if width == 0 || many == 0 {
            return;
        }
        let block = &mut self.blocks[last];
        if block.entry == self.step {
            (block.count, block.height) = (block.count + many, height);
        } else {
            self.blocks.push(RepeatedEntries { first: self.len - width, entry: self.step, count: 1 + many, height });
        }
        self.len += many * width;
    }

    /// Scalar measurement `row`, in the order of the design.
    pub fn get(&self, row: usize) -> Instance {
        let at = self.blocks.partition_point(|block| block.first <= row) - 1;
        let block = self.blocks[at];
        let end = self.blocks.get(at + 1).map_or(self.entries.len(), |next| next.entry);
        let (width, number) = (end - block.entry, row - block.first);
        let Instance { meter, row } = self.entries[block.entry + number % width];
        Instance { meter, row: row + number / width * block.height }
    }

    /// True if the scalar measurements `rows`, at least one, are all of one measurement of the model.
    pub(crate) fn uniform(&self, rows: std::ops::Range<usize>) -> bool {
        let meter = self.get(rows.start).meter;
        let first = self.blocks.partition_point(|block| block.first <= rows.start) - 1;
        let blocks = self.blocks[first..].iter().take_while(|block| block.first < rows.end);
        blocks.enumerate().all(|(k, block)| {
            let end = self.blocks.get(first + k + 1).map_or(self.entries.len(), |next| next.entry);
            // a block that does not repeat has one entry per scalar measurement, and perhaps entries outside the range
            let (first_entry, end_entry) = if block.count > 1 {
                (block.entry, end)
            } else {
                let at = |row: usize| block.entry + row.saturating_sub(block.first);
                (at(rows.start), at(rows.end).min(end))
            };
            self.entries[first_entry..end_entry].iter().all(|entry| entry.meter == meter)
        })
    }

    /// The scalar measurements in a range, as a list.
    pub(crate) fn of(&self, rows: std::ops::Range<usize>) -> Vec<Instance> {
        rows.map(|row| self.get(row)).collect()
    }

    /// (scalar measurements, number of occurrences, number of rows from one occurrence to the next), in order.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = (&[Instance], usize, usize)> {
        self.blocks.iter().enumerate().map(|(at, block)| {
            let end = self.blocks.get(at + 1).map_or(self.entries.len(), |next| next.entry);
            (&self.entries[block.entry..end], block.count, block.height)
        })
    }

    /// All scalar measurements, in order.
    pub(crate) fn iter(&self) -> impl Iterator<Item = Instance> {
        self.blocks().flat_map(|(entries, count, height)| {
            (0..count).flat_map(move |k| {
                entries.iter().map(move |&Instance { meter, row }| Instance { meter, row: row + k * height })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_steps_are_as_if_written_out() {
        let (mut short, mut long) = (Instances::default(), Vec::new());
        let mut row = 0;
        for (meters, repeats) in [(2, 0), (1, 0), (3, 4), (0, 2), (1, 1), (1, 0), (2, 3), (2, 1)] {
            short.begin(row);
            for meter in 0..meters {
                short.push(Instance { meter, row: row + meter });
            }
            for _ in 0..=repeats {
                long.extend((0..meters).map(|meter| Instance { meter, row: row + meter }));
                row += 5;
            }
            for _ in 0..repeats {
                short.repeat(1, 5);
            }
        }
        assert_eq!(short.iter().collect::<Vec<_>>(), long);
        assert_eq!((0..short.len()).map(|k| short.get(k)).collect::<Vec<_>>(), long);
    }
}
