//! One test in matrices: φ, b, Q, M, d, R, z.

use nalgebra::{DMatrix, DVector};

/// One step: x_k = φ x_{k-1} + b + w, w ~ N(0, Q), then z = M x_k + d + v, v ~ N(0, R).
#[derive(Debug, Clone, PartialEq)]
pub struct StepMatrices {
    /// φ, n × n; `None` is the identity.
    pub transition: Option<DMatrix<f64>>,
    /// b, n numbers; `None` is zero.
    pub input: Option<DVector<f64>>,
    /// Q, n × n, positive semidefinite; `None` is zero.
    pub process_noise: Option<DMatrix<f64>>,
    /// M, m × n; m may be zero.
    pub measurement: DMatrix<f64>,
    /// d, m numbers.
    pub constant: DVector<f64>,
    /// R, m × m, positive semidefinite. An infinite variance means not measured.
    pub noise: DMatrix<f64>,
    /// z, m numbers; NaN is missing.
    pub values: DVector<f64>,
}

/// One test in matrices, with x_0 = a + A ξ + ζ, ζ ~ N(0, P0).
#[derive(Debug, Clone, PartialEq)]
pub struct Plain {
    /// Id of the test.
    pub id: String,
    /// a, n numbers.
    pub offset: DVector<f64>,
    /// A, n × p.
    pub sensitivity: DMatrix<f64>,
    /// P0, n × n, positive semidefinite.
    pub covariance: DMatrix<f64>,
    /// The steps, in order.
    pub steps: Vec<StepMatrices>,
}

impl StepMatrices {
    /// A step without motion, input or constant: z = M x + v.
    pub fn new(measurement: DMatrix<f64>, noise: DMatrix<f64>, values: DVector<f64>) -> StepMatrices {
        let constant = DVector::zeros(values.len());
        StepMatrices { transition: None, input: None, process_noise: None, measurement, constant, noise, values }
    }

    /// A step that measures nothing, of n states.
    pub fn silent(n: usize) -> StepMatrices {
        StepMatrices::new(DMatrix::zeros(0, n), DMatrix::zeros(0, 0), DVector::zeros(0))
    }

    /// The step with the given φ and Q.
    #[must_use]
    pub fn moving(mut self, transition: DMatrix<f64>, process_noise: DMatrix<f64>) -> StepMatrices {
        (self.transition, self.process_noise) = (Some(transition), Some(process_noise));
        self
    }

    /// The step with the given b.
    #[must_use]
    pub fn with_input(mut self, input: DVector<f64>) -> StepMatrices {
        self.input = Some(input);
        self
    }

    /// The step with the given d.
    #[must_use]
    pub fn with_constant(mut self, constant: DVector<f64>) -> StepMatrices {
        self.constant = constant;
        self
    }
}

impl Plain {
    /// A test without steps.
    pub fn new(
        id: impl Into<String>,
        offset: DVector<f64>,
        sensitivity: DMatrix<f64>,
        covariance: DMatrix<f64>,
    ) -> Plain {
        Plain { id: id.into(), offset, sensitivity, covariance, steps: Vec::new() }
    }

    /// A test whose initial states are the unknowns themselves: x_0 = ξ. With steps that do not move, the states are
    /// random constants.
    pub fn constants(id: impl Into<String>, steps: impl IntoIterator<Item = StepMatrices>) -> Plain {
        let steps: Vec<StepMatrices> = steps.into_iter().collect();
        let n = steps.first().map_or(0, |step| step.measurement.ncols());
        let (zero, identity) = (DMatrix::zeros(n, n), DMatrix::identity(n, n));
        Plain { id: id.into(), offset: DVector::zeros(n), sensitivity: identity, covariance: zero, steps }
    }
}
