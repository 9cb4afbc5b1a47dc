//! The measurements that a step has: values, equations and noise, whitened.

mod backward;
mod whiten;

use crate::reduce::chunk_size::CACHED_ROWS;
use crate::reduce::data::Data;
use crate::reduce::design::Design;
use crate::reduce::error::ReduceErrorKind;
use crate::reduce::instances::{Instance, Instances};
use crate::reduce::subject::{Coefficient, Fault, ModelAt, Subject, Uses};
use kalfit_model::Test;
use kalfit_model::{Alpha, Scope};

pub(crate) use backward::Unwhitened;
pub(crate) use whiten::{Whitening, whiten};

/// A measurement of the model at α.
#[derive(Debug, Clone)]
struct Meter {
    column: usize,
    filter: Option<Coefficient>,
    /// Terms (kernel state, h) of the equation, by ascending state, without terms known to be zero.
    terms: Vec<(u32, Coefficient)>,
    constant: Coefficient,
    noise: Coefficient,
}

/// All measurements of a model at α.
#[derive(Debug, Clone)]
pub(crate) struct Meters {
    meters: Vec<Meter>,
    /// Covariances (i, j, covariance) of the noises of measurements i and j.
    pairs: Vec<(usize, usize, Coefficient)>,
}

/// Noise covariance of measurements i and j of a step, counted from the first measurement of the step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Correlation {
    pub(crate) i: usize,
    pub(crate) j: usize,
    pub(crate) value: f64,
    /// Index of the covariance among the noise covariances of the model.
    pub(crate) pair: usize,
    /// Row of the test on which the covariance was evaluated.
    pub(crate) row: usize,
}

impl Meters {
    /// The measurements of a model at α. `place`: kernel index of each state.
    pub(crate) fn new(at: &ModelAt<'_>, place: &[usize]) -> Result<Meters, Box<Fault>> {
        let mut meters = Vec::with_capacity(at.model.measurements.len());
        for (m, measurement) in at.model.measurements.iter().enumerate() {
            let mut terms = Vec::new();
            for (state, h) in &measurement.equation.terms {
                let h = at.coefficient(h, Subject::Equation(m))?;
                if !h.is_zero() {
                    terms.push((place[*state] as u32, h));
                }
            }
            terms.sort_by_key(|term| term.0);
            let filter = measurement.filter.as_ref().map(|filter| at.coefficient(filter, Subject::Filter(m)));
            meters.push(Meter {
                column: measurement.column,
                filter: filter.transpose()?,
                terms,
                constant: at.coefficient(&measurement.equation.constant, Subject::Equation(m))?,
                noise: at.variance(&measurement.noise_variance, Subject::Noise(m))?,
            });
        }
        let mut pairs = Vec::new();
        for (i, j, covariance) in &at.model.noise_covariance {
            let subject = Subject::NoiseCovariance(*i, *j);
            if i == j {
                let name = at.model.measurements[*i].name.clone();
                return Err(Fault::new(subject, ReduceErrorKind::SelfCovariance { name }));
            }
            let covariance = at.coefficient(covariance, subject)?;
            if !covariance.is_zero() {
                pairs.push((*i, *j, covariance));
            }
        }
        Ok(Meters { meters, pairs })
    }

    /// Appends the scalar measurements of one step, rows `rows` of a test, to design and data.
    pub(crate) fn observe(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        (rows, dt): (std::ops::Range<usize>, f64),
        out: &mut Observed<'_>,
    ) -> Result<(), Box<Fault>> {
        let (first, line) = (out.instances.len(), out.design.ends.len());
        out.instances.begin(rows.start);
        out.constants.clear();
        for row in rows {
            let scope = Scope { numbers: test.numbers(row), texts: test.texts(row), step: dt, alpha: at.alpha };
            for (m, meter) in self.meters.iter().enumerate() {
                let z = scope.numbers[meter.column];
                if !z.is_nan() && meter.take(at, m, z, &scope, out).map_err(|fault| fault.on(row))? {
                    out.instances.push(Instance { meter: m, row });
                }
            }
        }
        let own = out.instances.last_step();
        if self.pairs.is_empty() || own.len() < 2 {
            return Ok(());
        }
        let row = own[0].row;
        let found = self.covariances(at, test, dt, own)?;
        if found.is_empty() {
            return Ok(());
        }
        if let Some(covariances) = &mut out.covariances {
            covariances.extend(found.iter().map(|c| (first + c.i, first + c.j, c.value)));
            return Ok(());
        }
        let entries: Vec<(usize, usize, f64)> = found.iter().map(|c| (c.i, c.j, c.value)).collect();
        whiten(out.design, out.data, line, &entries).map_err(|bad| Fault::new(Subject::StepNoise, bad).on(row))
    }

    /// Appends the measurements that a row has; false where a measurement is in error.
    #[inline]
    pub(crate) fn measured(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        (row, dt): (usize, f64),
        out: &mut Vec<Instance>,
    ) -> bool {
        let numbers = test.numbers(row);
        self.meters.iter().enumerate().all(|(meter, own)| {
            let z = numbers[own.column];
            if z.is_nan() {
                return true;
            }
            if let Some(filter) = &own.filter {
                match at.value(filter, &Scope { numbers, texts: test.texts(row), step: dt, alpha: at.alpha }) {
                    Ok(0.0) => return true,
                    Ok(_) => {}
                    Err(_) => return false,
                }
            }
            out.push(Instance { meter, row });
            z.is_finite()
        })
    }

    /// (columns on which h, noises and filters of measurements depend, columns on which constants d depend).
    pub(crate) fn uses(&self, alpha: &Alpha) -> (Uses, Uses) {
        let (mut lines, mut constants) = (Uses::default(), Uses::default());
        for meter in &self.meters {
            let terms = meter.terms.iter().map(|(_, h)| h);
            terms.chain(&meter.filter).chain([&meter.noise]).for_each(|c| lines.add(c, alpha));
            constants.add(&meter.constant, alpha);
        }
        (lines, constants)
    }

    /// For each measurement, the kernel states of the line, ascending, and the index of each term of the measurement
    /// among these states. A whitened line may have the terms of all measurements.
    pub(crate) fn shapes(&self) -> Vec<(Vec<u32>, Vec<usize>)> {
        let own = |meter: &Meter| meter.terms.iter().map(|(state, _)| *state).collect::<Vec<u32>>();
        let mut all: Vec<u32> = self.meters.iter().flat_map(own).collect();
        all.sort_unstable();
        all.dedup();
        let shape = |meter: &Meter| {
            let (own, all) = (own(meter), &all);
            let line = if self.pairs.is_empty() { own.clone() } else { all.clone() };
            let place = |state: &u32| line.binary_search(state).expect("its own states are among them");
            let places = own.iter().map(place).collect();
            (line, places)
        };
        self.meters.iter().map(shape).collect()
    }

    /// Number of measurements of the model.
    pub(crate) fn count(&self) -> usize {
        self.meters.len()
    }

    /// The column of a measurement.
    pub(crate) fn column(&self, meter: usize) -> usize {
        self.meters[meter].column
    }

    /// The columns of all measurements.
    pub(crate) fn columns(&self) -> impl Iterator<Item = usize> {
        self.meters.iter().map(|meter| meter.column)
    }

    /// True when a step whose cells repeat has the measurements of the step before, except for measured values.
    pub(crate) fn can_repeat(&self) -> bool {
        self.pairs.is_empty() // whitening mixes the values of a step
    }

    /// Appends the measured values of a step whose lines are those of the step before, `height` rows earlier. Returns
    /// false and appends nothing where other measurements were made or a value is infinite. `fresh`: constants d may
    /// differ from constants of the step before.
    #[inline]
    pub(crate) fn repeat(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        ((first, height), dt): ((usize, usize), f64),
        fresh: bool,
        out: &mut Observed<'_>,
    ) -> Result<bool, Box<Fault>> {
        let measured = |row: usize, meter: &Meter| {
            let (z, before) = (test.numbers(row)[meter.column], test.numbers(row - height)[meter.column]);
            z.is_nan() == before.is_nan() && !z.is_infinite()
        };
        if !(first..first + height).all(|row| self.meters.iter().all(|meter| measured(row, meter))) {
            return Ok(false);
        }
        let entries = out.instances.last_step();
        for (entry, constant) in entries.iter().zip(out.constants.iter_mut()) {
            let (meter, row) = (&self.meters[entry.meter], first + (entry.row - out.instances.first_row()));
            let numbers = test.numbers(row);
            if fresh {
                let scope = Scope { numbers, texts: test.texts(row), step: dt, alpha: at.alpha };
                *constant = at.value(&meter.constant, &scope).map_err(|fault| fault.on(row))?;
            }
            let z = numbers[meter.column];
            out.data.take(z, *constant);
        }
        out.instances.repeat(1, height);
        Ok(true)
    }

    /// Appends the values of at most `most` one-row steps from row `first` on, where only values are read from the
    /// test. Stops before a row with other measurements than the last step. Returns the number of steps appended.
    pub(crate) fn repeat_values(&self, test: &Test, first: usize, most: usize, out: &mut Observed<'_>) -> usize {
        let entries = out.instances.last_step();
        let mut is_taken = vec![false; self.meters.len()];
        entries.iter().for_each(|entry| is_taken[entry.meter] = true);
        let columns: Vec<(usize, bool)> =
            self.meters.iter().zip(&is_taken).map(|(meter, &taken)| (meter.column, taken)).collect();
        let taken: Vec<(usize, f64)> =
            entries.iter().zip(&*out.constants).map(|(e, &d)| (self.meters[e.meter].column, d)).collect();
        let width = test.widths().0;
        let rows = test.all_numbers()[first * width..].chunks_exact(width).take(most);
        let continues = |numbers: &[f64]| {
            let as_before = |&(column, taken): &(usize, bool)| match numbers[column] {
                z if taken => z.is_finite(),
                z => z.is_nan(),
            };
            columns.iter().all(as_before)
        };
        let mut appended = 0;
        while appended < most {
            let some = rows.clone().skip(appended).take(CACHED_ROWS);
            let (given, taken_rows) = (some.len(), some.clone().take_while(|numbers| continues(numbers)).count());
            out.data.take_rows(some.take(taken_rows), &taken);
            appended += taken_rows;
            if taken_rows < given || given == 0 {
                break;
            }
        }
        out.instances.repeat(appended, 1);
        appended
    }

    /// Noise covariances among the instances of a step.
    pub(crate) fn covariances(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        dt: f64,
        instances: &[Instance],
    ) -> Result<Vec<Correlation>, Box<Fault>> {
        let mut found = Vec::new();
        for (pair, (i, j, covariance)) in self.pairs.iter().enumerate() {
            let of = |meter: usize| {
                instances.iter().enumerate().filter(move |(_, instance)| instance.meter == meter).map(|(k, _)| k)
            };
            let (firsts, seconds): (Vec<usize>, Vec<usize>) = (of(*i).collect(), of(*j).collect());
            let partner = |a: usize| seconds.iter().copied().find(|&b| instances[b].row == instances[a].row);
            let mut matched: Vec<(usize, usize)> = firsts.iter().filter_map(|&a| Some((a, partner(a)?))).collect();
            if matched.len() < firsts.len() && matched.len() < seconds.len() {
                if firsts.len() > 1 || seconds.len() > 1 {
                    let name = |m: usize| at.model.measurements[m].name.clone();
                    let kind = ReduceErrorKind::AmbiguousCovariance { first: name(*i), second: name(*j) };
                    return Err(Fault::new(Subject::NoiseCovariance(*i, *j), kind).on(instances[firsts[0]].row));
                }
                matched.push((firsts[0], seconds[0]));
            }
            for (a, b) in matched {
                let value = |k: usize| {
                    let row = instances[k].row;
                    let scope = Scope { numbers: test.numbers(row), texts: test.texts(row), step: dt, alpha: at.alpha };
                    at.value(covariance, &scope).map_err(|fault| fault.on(row))
                };
                let (value, row) = match value(a) {
                    Err(fault) if matches!(fault.kind, ReduceErrorKind::MissingCell { .. }) => {
                        value(b).map(|value| (value, instances[b].row)).map_err(|_| fault)
                    }
                    other => other.map(|value| (value, instances[a].row)),
                }?;
                found.push(Correlation { i: a, j: b, value, pair, row });
            }
        }
        Ok(found)
    }
}

/// Design, data and lists to which scalar measurements are appended.
#[derive(Debug)]
pub(crate) struct Observed<'a> {
    pub(crate) design: &'a mut Design,
    pub(crate) data: &'a mut Data,
    pub(crate) instances: &'a mut Instances,
    /// d of each scalar measurement of the last step.
    pub(crate) constants: &'a mut Vec<f64>,
    /// Noise covariances (i, j, value), collected where measurements are not whitened; else `None`.
    pub(crate) covariances: Option<&'a mut Vec<(usize, usize, f64)>>,
}

impl Meter {
    /// Appends measurement `m` with value `z`, unless the filter excludes the measurement. Returns whether the
    /// measurement was appended.
    fn take(
        &self,
        at: &ModelAt<'_>,
        m: usize,
        z: f64,
        scope: &Scope<'_>,
        out: &mut Observed<'_>,
    ) -> Result<bool, Box<Fault>> {
        if let Some(filter) = &self.filter
            && at.value(filter, scope)? == 0.0
        {
            return Ok(false);
        }
        if z.is_infinite() {
            let column = at.model.columns[self.column].name.clone();
            return Err(Fault::new(Subject::Value(m), ReduceErrorKind::InfiniteCell { column, value: z }));
        }
        let (noise, constant) = self.line(at, scope, &mut out.design.h)?;
        out.design.states.extend(self.terms.iter().map(|(state, _)| *state));
        out.design.ends.push(out.design.states.len());
        out.design.noise.push(noise);
        out.constants.push(constant);
        out.data.take(z, constant);
        Ok(true)
    }

    /// Returns noise variance and constant, and appends the coefficients of the terms to `h`.
    #[inline(always)]
    fn line(&self, at: &ModelAt<'_>, scope: &Scope<'_>, h: &mut Vec<f64>) -> Result<(f64, f64), Box<Fault>> {
        let noise = at.variance_value(&self.noise, scope)?;
        let constant = at.value(&self.constant, scope)?;
        for (_, coefficient) in &self.terms {
            h.push(at.value(coefficient, scope)?);
        }
        Ok((noise, constant))
    }
}
