//! Positions of expressions in a model, and the list of all expressions.

use crate::model::{CovarianceKind, Expression, Initial, Linear, Model};

/// Position of an expression in a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Site {
    /// The coefficient of one state in the derivative, or the next value, of a state.
    Rate {
        /// Index of the state that moves.
        state: usize,
        /// Index of the state that the coefficient multiplies.
        from: usize,
    },
    /// The constant term of the derivative, or the next value, of a state.
    Input(usize),
    /// The variance of the process noise of a state.
    ProcessNoise(usize),
    /// The known mean of a state at the start.
    InitialMean(usize),
    /// The known variance of a state at the start.
    InitialVariance(usize),
    /// The offset of a state at the start.
    Offset(usize),
    /// The coefficient of a state in a measurement.
    Coefficient {
        /// Index of the measurement.
        measurement: usize,
        /// Index of the state.
        state: usize,
    },
    /// The constant term of a measurement.
    Constant(usize),
    /// The variance of the noise of a measurement.
    Noise(usize),
    /// The condition `where` of a measurement.
    Filter(usize),
    /// A covariance of two process noises.
    ProcessCovariance,
    /// A covariance of the noises of two measurements.
    NoiseCovariance,
    /// The time of x_0.
    InitialTime,
    /// An element of the known covariance that is added to Σ.
    KnownCovariance {
        /// Whether the element is a variance.
        diagonal: bool,
    },
    /// An element of the matrix in the structure of Σ: of a fixed Σ, of Σ* in Σ = β Σ*, or of R in Σ = D R D.
    Structure {
        /// Whether the element is on the diagonal.
        diagonal: bool,
    },
}

impl Site {
    /// Whether the site is part of the filter: of the motion of states, of a measurement, or of process or measurement
    /// noise.
    pub fn is_of_filter(self) -> bool {
        self.is_of_motion()
            || matches!(
                self,
                Site::Coefficient { .. } | Site::Constant(_) | Site::Noise(_) | Site::Filter(_) | Site::NoiseCovariance
            )
    }

    /// Whether the site is part of the motion of states or of process noise.
    pub fn is_of_motion(self) -> bool {
        matches!(self, Site::Rate { .. } | Site::Input(_) | Site::ProcessNoise(_) | Site::ProcessCovariance)
    }

    /// The state to whose motion or start the site belongs.
    pub fn of_state(self) -> Option<usize> {
        match self {
            Site::Rate { state, .. }
            | Site::Input(state)
            | Site::ProcessNoise(state)
            | Site::InitialMean(state)
            | Site::InitialVariance(state)
            | Site::Offset(state) => Some(state),
            _ => None,
        }
    }

    /// Whether the site is a variance or covariance of noise, or of a known start.
    pub fn is_variance(self) -> bool {
        matches!(
            self,
            Site::ProcessNoise(_)
                | Site::InitialVariance(_)
                | Site::Noise(_)
                | Site::ProcessCovariance
                | Site::NoiseCovariance
                | Site::KnownCovariance { .. }
        )
    }
}

impl Model {
    /// (position, expression) of every expression in the model: of the states, then of measurements, of noise
    /// covariances, of the time of x_0, and of the known covariance and the structure of Σ.
    pub fn expressions(&self) -> Vec<(Site, &Expression)> {
        let mut all = Vec::new();
        self.push_state_expressions(&mut all);
        for (measurement, meter) in self.measurements.iter().enumerate() {
            push_linear(
                &meter.equation,
                |state| Site::Coefficient { measurement, state },
                Site::Constant(measurement),
                &mut all,
            );
            all.extend(meter.filter.iter().map(|filter| (Site::Filter(measurement), filter)));
            all.push((Site::Noise(measurement), &meter.noise_variance));
        }
        all.extend(self.process_noise_covariance.iter().map(|(.., covariance)| (Site::ProcessCovariance, covariance)));
        all.extend(self.noise_covariance.iter().map(|(.., covariance)| (Site::NoiseCovariance, covariance)));
        all.extend(self.clock.initial_time.iter().map(|time| (Site::InitialTime, time)));
        if let Some(known) = &self.covariance.known {
            push_matrix(known, |diagonal| Site::KnownCovariance { diagonal }, &mut all);
        }
        all.extend(self.covariance.kind.expressions());
        all
    }

    fn push_state_expressions<'m>(&'m self, all: &mut Vec<(Site, &'m Expression)>) {
        for (i, state) in self.states.iter().enumerate() {
            if let Some((form, noise_variance)) = state.motion.parts() {
                push_linear(form, |from| Site::Rate { state: i, from }, Site::Input(i), all);
                all.push((Site::ProcessNoise(i), noise_variance));
            }
            if let Initial::Known { mean, variance } = &state.initial {
                all.extend([(Site::InitialMean(i), mean), (Site::InitialVariance(i), variance)]);
            }
            all.extend(state.offset.iter().map(|offset| (Site::Offset(i), offset)));
        }
    }
}

impl CovarianceKind {
    /// (position, element) of every element of the matrix in the structure; empty for structures without a matrix.
    pub fn expressions(&self) -> Vec<(Site, &Expression)> {
        let mut all = Vec::new();
        if let CovarianceKind::Proportional(entries)
        | CovarianceKind::Correlation(entries)
        | CovarianceKind::Fixed(entries) = self
        {
            push_matrix(entries, |diagonal| Site::Structure { diagonal }, &mut all);
        }
        all
    }
}

fn push_linear<'m>(
    form: &'m Linear,
    site_of: impl Fn(usize) -> Site,
    constant: Site,
    all: &mut Vec<(Site, &'m Expression)>,
) {
    all.extend(form.terms.iter().map(|(state, coefficient)| (site_of(*state), coefficient)));
    all.push((constant, &form.constant));
}

fn push_matrix<'m>(rows: &'m [Vec<Expression>], site_of: impl Fn(bool) -> Site, all: &mut Vec<(Site, &'m Expression)>) {
    for (i, row) in rows.iter().enumerate() {
        all.extend(row.iter().enumerate().map(|(j, entry)| (site_of(i == j), entry)));
    }
}
