//! Where the measured values of a test stand among its numbers.

/// The cell and the constant d of each scalar measurement of a test: the value in the filter is the number in the cell
/// minus d. Cells of repeated steps are stored once.
#[derive(Debug, Clone, Default)]
pub(crate) struct MeasuredCells {
    blocks: Vec<RepeatedCells>,
    /// (cell, d) of the first occurrence of each block.
    entries: Vec<(usize, f64)>,
    len: usize,
}

/// Entries that occur `count` times, `stride` cells later each time.
#[derive(Debug, Clone, Copy)]
struct RepeatedCells {
    /// End of the entries of the block, which begin where those of the previous block end.
    end: usize,
    count: usize,
    stride: usize,
}

impl MeasuredCells {
    /// Appends cells that occur `count` times, `stride` cells later each time.
    pub(crate) fn push(&mut self, cells: impl Iterator<Item = (usize, f64)>, count: usize, stride: usize) {
        let first = self.entries.len();
        self.entries.extend(cells);
        self.len += count * (self.entries.len() - first);
        self.blocks.push(RepeatedCells { end: self.entries.len(), count, stride });
    }

    /// Number of scalar measurements.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Cell and d of each scalar measurement, in order.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, f64)> {
        let starts = std::iter::once(0).chain(self.blocks.iter().map(|block| block.end));
        starts.zip(&self.blocks).flat_map(|(first, &RepeatedCells { end, count, stride })| {
            let entries = &self.entries[first..end];
            (0..count).flat_map(move |k| entries.iter().map(move |&(cell, d)| (cell + k * stride, d)))
        })
    }

    /// Writes the values of tests to `out`, that of measurement k of test t to k × `lanes` + t. `numbers`: all numbers
    /// of each test.
    pub(crate) fn write(&self, numbers: &[&[f64]], lanes: usize, out: &mut [f64]) {
        let (mut first, mut out) = (0, out);
        for &RepeatedCells { end, count, stride } in &self.blocks {
            let entries = &self.entries[first..end];
            let (own, rest) = std::mem::take(&mut out).split_at_mut(count * entries.len() * lanes);
            match (numbers, entries) {
                // one test and one measurement a step: values are a column of the test
                (&[numbers], &[(cell, d)]) if lanes == 1 && stride > 0 => {
                    let column = numbers[cell..].iter().step_by(stride);
                    own.iter_mut().zip(column).for_each(|(value, z)| *value = z - d);
                }
                _ => {
                    let mut rows = own.chunks_exact_mut(lanes);
                    for shift in (0..count).map(|k| k * stride) {
                        for (&(cell, d), values) in entries.iter().zip(&mut rows) {
                            values.iter_mut().zip(numbers).for_each(|(z, numbers)| *z = numbers[cell + shift] - d);
                        }
                    }
                }
            }
            (first, out) = (end, rest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_cells_are_read_as_if_listed() {
        let mut cells = MeasuredCells::default();
        cells.push([(1, 0.5)].into_iter(), 3, 2);
        cells.push([(6, 0.0), (7, 1.0)].into_iter(), 2, 3);
        cells.push([].into_iter(), 4, 1);
        cells.push([(0, -1.0)].into_iter(), 1, 0);
        let numbers: [Vec<f64>; 2] = [(0..12).map(f64::from).collect(), (20..32).map(f64::from).collect()];
        let expected = [0.5, 2.5, 4.5, 6.0, 6.0, 9.0, 9.0, 1.0];
        assert_eq!(cells.len(), expected.len());
        assert!(cells.iter().zip(expected).all(|((cell, d), value)| numbers[0][cell] - d == value));
        assert_eq!(cells.iter().count(), expected.len());
        for lanes in [1, 2, 4] {
            let tests: Vec<&[f64]> = numbers.iter().take(lanes).map(|numbers| &**numbers).collect();
            let mut out = vec![0.0; lanes * expected.len()];
            cells.write(&tests, lanes, &mut out);
            for (k, expected) in expected.iter().enumerate() {
                for test in 0..tests.len() {
                    assert_eq!(out[k * lanes + test], expected + 20.0 * test as f64, "{lanes}, {k}, {test}");
                }
            }
        }
    }
}
