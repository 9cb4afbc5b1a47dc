//! The reduction of a test in phases: one factor for each phase, and the links between phases (theory §7).

use nalgebra::{DMatrix, DVector};

use crate::evidence::path::Path;

/// The likelihood of a test in several phases, phase by phase. σ_i are the q_i entering coordinates of phase i
/// ([`Phase::entering`](crate::model::Phase::entering)), the first p_i of which are the ξ_i of the phase:
///
/// ```text
/// σ_1 = [ξ_1; 0]        σ_{i+1} = [ξ_{i+1}; 0] + g_i + G_i σ_i + w_i,  w_i ~ N(0, C_iC_i')
/// log p(z_i | σ_i, z of earlier phases) = constant_i - ½ ‖d_i - R_i σ_i‖²
/// ```
///
/// Phases that the test lacks are left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    /// The phases that the test has, in order.
    pub phases: Vec<ChainPhase>,
}

impl Chain {
    /// Sets everything that depends on data to zero; factors, sensitivities and roots do not change.
    pub fn blank(&mut self) {
        for phase in &mut self.phases {
            phase.constant = 0.0;
            phase.data.fill(0.0);
            if let Some(link) = &mut phase.link {
                link.mean.fill(0.0);
            }
        }
    }
}

/// One phase of a [`Chain`].
#[derive(Debug, Clone, PartialEq)]
pub struct ChainPhase {
    /// p_i: the number of entering coordinates that are ξ_i.
    pub own: usize,
    /// constant_i: the part of the log-likelihood that does not depend on σ_i.
    pub constant: f64,
    /// d_i, q_i numbers.
    pub data: Vec<f64>,
    /// R_i, q_i × q_i, upper triangular, packed in the order of
    /// [`Reduction::factor`](crate::evidence::reduction::Reduction).
    pub factor: Vec<f64>,
    /// The arithmetic that made the factor.
    pub path: Path,
    /// Link from the phase before; `None` for the first phase.
    pub link: Option<Link>,
}

/// σ_{i+1} = [ξ_{i+1}; 0] + mean + sensitivity σ_i + root × white noise.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// g, q_{i+1} numbers.
    pub mean: DVector<f64>,
    /// G, q_{i+1} × q_i.
    pub sensitivity: DMatrix<f64>,
    /// C, q_{i+1} × any number of columns.
    pub root: DMatrix<f64>,
}
