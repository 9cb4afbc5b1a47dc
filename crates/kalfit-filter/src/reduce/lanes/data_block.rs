//! The data of tests in lanes, one test per lane.

use kalfit_lanes::Width;

use crate::reduce::data::Outcome;
use crate::reduce::design::Design;
use crate::reduce::gains::Gains;
use crate::reduce::lanes::numbers::DataView;
use crate::reduce::lanes::pass::DataPass;
use crate::reduce::lanes::workspace::DataWorkspace;
use crate::reduce::measured_cells::MeasuredCells;

/// a, b and z - d of as many tests as lanes: number k of the test in a lane is at k × lanes + lane. Empty lanes hold
/// zeros.
#[derive(Debug, Clone)]
pub(crate) struct DataBlock {
    width: Width,
    numbers: Vec<f64>,
    /// Index of the first input and of the first value, counted in numbers per test.
    inputs: usize,
    values: usize,
}

impl DataBlock {
    /// An empty block.
    pub(crate) fn new(width: Width) -> DataBlock {
        DataBlock { width, numbers: Vec::new(), inputs: 0, values: 0 }
    }

    /// An empty block in the memory of a list.
    pub(crate) fn with_memory(width: Width, numbers: Vec<f64>) -> DataBlock {
        DataBlock { width, numbers, inputs: 0, values: 0 }
    }

    /// The memory of the block, which is then empty.
    pub(crate) fn take_memory(&mut self) -> Vec<f64> {
        std::mem::take(&mut self.numbers)
    }

    /// Width of the lanes.
    pub(crate) fn width(&self) -> Width {
        self.width
    }

    /// Changes the width of the lanes; the block must be cleared before it is used again.
    pub(crate) fn set_width(&mut self, width: Width) {
        self.width = width;
    }

    /// Number of lanes, which is the number of tests that the block can hold.
    pub(crate) fn lanes(&self) -> usize {
        self.width.lanes()
    }

    /// Sets the block to zeros, for tests with `start` numbers of a, `inputs` of b and `values` of z - d.
    pub(crate) fn clear(&mut self, start: usize, inputs: usize, values: usize) {
        (self.inputs, self.values) = (start, start + inputs);
        self.numbers.clear();
        self.numbers.resize((start + inputs + values) * self.width.lanes(), 0.0);
    }

    /// As [`DataBlock::clear`], except that any numbers may stand in the block until they are put there.
    pub(crate) fn reshape(&mut self, start: usize, inputs: usize, values: usize) {
        (self.inputs, self.values) = (start, start + inputs);
        self.numbers.resize((start + inputs + values) * self.width.lanes(), 0.0);
    }

    /// Puts the start and the inputs of a test into a lane.
    pub(crate) fn begin(&mut self, lane: usize, start: &[f64], inputs: &[f64]) {
        let lanes = self.width.lanes();
        self.numbers.chunks_exact_mut(lanes).zip(start).for_each(|(lane_values, x)| lane_values[lane] = *x);
        self.numbers[self.inputs * lanes..]
            .chunks_exact_mut(lanes)
            .zip(inputs)
            .for_each(|(lane_values, x)| lane_values[lane] = *x);
    }

    /// Puts the values z - d of several tests, with these numbers, into the first lanes.
    pub(crate) fn put_values(&mut self, numbers: &[&[f64]], cells: &MeasuredCells) {
        let lanes = self.width.lanes();
        cells.write(numbers, lanes, &mut self.numbers[self.values * lanes..]);
    }

    /// Runs the data pass of all lanes under the gains of one design.
    pub(crate) fn run(&self, design: &Design, gains: &Gains, scratch: &mut DataWorkspace) {
        self.width.run(DataPass { design, gains, data: self.view(), scratch });
    }

    /// Start, inputs and values, mutable.
    pub(super) fn numbers_mut(&mut self) -> [&mut [f64]; 3] {
        let lanes = self.width.lanes();
        let (start, rest) = self.numbers.split_at_mut(self.inputs * lanes);
        let (inputs, values) = rest.split_at_mut((self.values - self.inputs) * lanes);
        [start, inputs, values]
    }

    /// z - d of all tests, in lanes.
    pub(crate) fn measured(&self) -> &[f64] {
        self.view().values
    }

    /// Start, inputs and values, in lanes.
    pub(crate) fn view(&self) -> DataView<'_> {
        let (start, rest) = self.numbers.split_at(self.inputs * self.width.lanes());
        let (inputs, values) = rest.split_at((self.values - self.inputs) * self.width.lanes());
        DataView { start, inputs, values }
    }

    /// The outcome of the pass of the test in a lane. `log_determinant`: Σ log S over `active` measurements.
    pub(crate) fn outcome(
        &self,
        lane: usize,
        (active, log_determinant): (usize, f64),
        scratch: &DataWorkspace,
    ) -> Outcome {
        scratch.outcome((lane, self.width.lanes()), active, log_determinant)
    }

    /// The innovations e of the test in a lane, one for each value of the block.
    pub(crate) fn innovations<'a>(
        &self,
        lane: usize,
        scratch: &'a DataWorkspace,
    ) -> impl Iterator<Item = f64> + use<'a> {
        scratch.e.iter().skip(lane).step_by(self.width.lanes()).copied()
    }

    /// x̂ of the last step of the test in a lane.
    pub(crate) fn last<'a>(&self, lane: usize, scratch: &'a DataWorkspace) -> impl Iterator<Item = f64> + use<'a> {
        scratch.x.iter().skip(lane).step_by(self.width.lanes()).copied()
    }
}
