//! From ∂ℓ/∂(whitened measurement) back to ∂ℓ/∂(measurement before whitening).

use crate::reduce::instances::Instance;
use crate::reduce::observe::{Correlation, Meters, Whitening};
use crate::reduce::subject::{Coefficient, Fault, ModelAt};
use kalfit_model::Scope;
use kalfit_model::Test;

impl Meters {
    /// Noise, constant and terms (kernel state, h) of each measurement.
    pub(crate) fn parts(&self) -> impl Iterator<Item = (&Coefficient, &Coefficient, &[(u32, Coefficient)])> {
        self.meters.iter().map(|meter| (&meter.noise, &meter.constant, &*meter.terms))
    }

    /// Covariances of the noises of measurements.
    pub(crate) fn pairs(&self) -> impl Iterator<Item = &Coefficient> {
        self.pairs.iter().map(|(.., covariance)| covariance)
    }

    /// (measurement, filter) for each measurement that has a filter.
    pub(crate) fn filters(&self) -> impl Iterator<Item = (usize, &Coefficient)> {
        self.meters.iter().enumerate().filter_map(|(m, meter)| Some((m, meter.filter.as_ref()?)))
    }

    /// The noise variance of each instance, before whitening.
    pub(crate) fn noises(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        (instances, dt): (&[Instance], f64),
        out: &mut Vec<f64>,
    ) -> Result<(), Box<Fault>> {
        out.clear();
        for &Instance { meter, row } in instances {
            let scope = Scope { numbers: test.numbers(row), texts: test.texts(row), step: dt, alpha: at.alpha };
            out.push(at.variance_value(&self.meters[meter].noise, &scope).map_err(|fault| fault.on(row))?);
        }
        Ok(())
    }

    /// d of each measurement of the model; `None` where some d varies from row to row.
    pub(crate) fn known_constants(&self) -> Option<Vec<f64>> {
        self.meters.iter().map(|meter| meter.constant.constant()).collect()
    }

    /// Appends d of each instance.
    pub(crate) fn constants(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        (instances, dt): (&[Instance], f64),
        out: &mut Vec<f64>,
    ) -> Result<(), Box<Fault>> {
        for &Instance { meter, row } in instances {
            let scope = Scope { numbers: test.numbers(row), texts: test.texts(row), step: dt, alpha: at.alpha };
            out.push(at.value(&self.meters[meter].constant, &scope).map_err(|fault| fault.on(row))?);
        }
        Ok(())
    }
}

/// Adjoints of the m scalar measurements of a step: of R (the full matrix, m × m), of z - d, and of M (m × n, or empty
/// when not requested).
#[derive(Debug, Clone, Default)]
pub(crate) struct Unwhitened {
    pub(crate) noise: Vec<f64>,
    pub(crate) value: Vec<f64>,
    pub(crate) h: Vec<f64>,
}

impl Unwhitened {
    /// Goes back through z̃ = L⁻¹ζ, M̃ = L⁻¹M, R = LDL': ζ̄ = L'⁻¹z̄, M̄ = L'⁻¹H̄, R̄ = L'⁻¹(Φ + D̄)L⁻¹, symmetrised,
    /// with Φ the strictly lower part of -(z̄z̃' + H̄M̃')D⁻¹. `h`: M̃, m × n; `values`: z̃; `raw`: the noise variances
    /// before whitening; `noise_bar`: D̄; `value_bar`: z̄; `h_bar`: H̄, or empty when M̄ is not requested.
    pub(crate) fn set(
        &mut self,
        (h, values, n): (&[f64], &[f64], usize),
        (raw, correlations): (&[f64], &[Correlation]),
        (noise_bar, value_bar, h_bar): (&[f64], &[f64], &[f64]),
    ) {
        let m = raw.len();
        let whitening = Whitening::new(raw, correlations.iter().map(|c| (c.i, c.j, c.value)));
        let whitening = whitening.expect("it was positive semidefinite on the way forward");
        self.value.clear();
        self.value.extend_from_slice(value_bar);
        self.h.clear();
        self.h.extend_from_slice(h_bar);
        self.noise.clear();
        self.noise.resize(m * m, 0.0);
        for j in 0..m {
            self.noise[j * m + j] = noise_bar[j];
            let pivot = whitening.noise(j);
            if pivot == 0.0 {
                continue;
            }
            for i in j + 1..m {
                let mut sum = value_bar[i] * values[j];
                if !h_bar.is_empty() {
                    let (bars, own) = (&h_bar[i * n..][..n], &h[j * n..][..n]);
                    sum += bars.iter().zip(own).map(|(bar, h)| bar * h).sum::<f64>();
                }
                self.noise[i * m + j] = -sum / pivot;
            }
        }
        let columns = if self.h.is_empty() { 0 } else { n };
        whitening.back(&mut self.value, 1);
        whitening.back(&mut self.h, columns);
        whitening.back(&mut self.noise, m);
        whitening.back_right(&mut self.noise);
        for i in 0..m {
            for j in 0..i {
                let mean = 0.5 * (self.noise[i * m + j] + self.noise[j * m + i]);
                (self.noise[i * m + j], self.noise[j * m + i]) = (mean, mean);
            }
        }
    }
}
