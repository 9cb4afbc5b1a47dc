//! The data of a test, and what they say under a design.

/// e'S⁻¹e beyond which c + ½d'd would lose digits, so that the innovations are taken again from the best ξ.
pub(crate) const REFINE: f64 = 1e3;
/// So many equal steps are not worth a scan.
pub(crate) const FEW: usize = 64;

/// The data of a test, in kernel order and whitened.
#[derive(Debug, Clone, Default)]
pub(crate) struct Data<R = f64> {
    /// a, n numbers.
    pub(crate) start: Vec<R>,
    /// b of the driven states, for each transition.
    pub(crate) inputs: Vec<R>,
    /// z - d.
    pub(crate) values: Vec<R>,
    /// |z| + |d|.
    pub(crate) sizes: Vec<R>,
}

impl Data {
    /// Appends a measured value z, of which d is known.
    #[inline(always)]
    pub(crate) fn take(&mut self, z: f64, constant: f64) {
        self.values.push(z - constant);
        self.sizes.push(z.abs() + constant.abs());
    }
}

impl<R> Data<R> {
    pub(crate) fn clear(&mut self) {
        self.start.clear();
        self.inputs.clear();
        self.values.clear();
        self.sizes.clear();
    }
}

/// Work space of the data pass; afterwards x̂ of the last step.
#[derive(Debug, Clone, Default)]
pub(crate) struct DataWork<R = f64> {
    pub(crate) x: Vec<R>,
    pub(super) moved: Vec<R>,
    /// The innovations, in order.
    pub(crate) e: Vec<R>,
    pub(crate) y: Vec<R>,
}

/// What the data say under a design.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Outcome {
    pub(crate) constant: f64,
    /// The sum of squares that is left.
    pub(crate) residual: f64,
    /// d, p numbers.
    pub(crate) data: Vec<f64>,
}

impl Outcome {
    pub(crate) fn is_finite(&self) -> bool {
        self.constant.is_finite() && self.data.iter().all(|d| d.is_finite())
    }
}

/// Measurement `row` missed its only possible value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Miss {
    pub(crate) row: usize,
    pub(crate) residual: f64,
}
