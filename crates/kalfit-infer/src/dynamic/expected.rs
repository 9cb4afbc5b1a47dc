//! Expected information of (α, μ, Σ) together (theory §13): for a test, Σ_k ½ tr(S⁻¹S_aS⁻¹S_b) + E[e_a'S⁻¹e_b] over the
//! innovations e of the test, with the tangents S_a, e_a along each coordinate. One filter carries P, the predicted
//! state x̂ and the tangents of P and x̂; x̂ and the tangents of x̂ are random through the earlier innovations, which
//! are white.

use std::collections::BTreeMap;
use std::ops::AddAssign;

use nalgebra::{DMatrix, DVector};

use crate::SharedProgress;
use crate::dynamic::stepwise::{
    EvaluationPoint, GroupedTest, LineValues, MotionValues, RecordMoments, TimeStep, TimeSteps,
};
use kalfit_filter::reduce::ReduceError;
use kalfit_filter::score::InitialLaw;
use kalfit_model::Alpha;
use kalfit_model::{Evidence, Grouping};
use kalfit_search::ProfileLikelihood;
use kalfit_search::ValueCovariances;
use kalfit_search::{DynamicError, DynamicFit};

/// Step, for differences of coefficients, of a coordinate of α, and, in standard errors, of a coordinate along the
/// tangent basis.
const STEP: f64 = 1e-4;
/// Number of time steps of a record between two checks for a stop.
const STEPS_PER_CHECK: usize = 4096;

/// Covariances from the expected information; `None` where values of single tests are free, where some difference is
/// not defined, and once `progress` stops.
pub(super) fn expected(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    progress: &SharedProgress<'_>,
) -> Result<Option<ValueCovariances>, DynamicError> {
    let shared = fit.joint.shared();
    let Some(directions) = Directions::of(objective, fit, shared)? else { return Ok(None) };
    let units = units(objective);
    let one = |k: usize| -> Result<DMatrix<f64>, DynamicError> {
        directions.information(&units[k], progress).map_err(|error| DynamicError::Reduce(Box::new(error)))
    };
    let Some(all) = progress.each(units.len(), one) else { return Ok(None) };
    let n = directions.all.len();
    let sum = all.into_iter().try_fold(DMatrix::zeros(n, n), |sum, one| one.map(|one| sum + one))?;
    Ok(if progress.stops() { None } else { fit.joint.covariances_of(&sum) })
}

/// Whether the expected information is available: all tests are given by rows, all phases have the optimal filter, and
/// tests are independent but for nested groups, which one filter can carry.
pub(super) fn is_possible(objective: &ProfileLikelihood<'_>) -> bool {
    let is_rows = |evidence: &Evidence| matches!(evidence, Evidence::Rows(_));
    let all_rows = objective.tests.iter().all(|test| test.phases.iter().all(is_rows));
    let crossed = objective.grouping().is_some_and(Grouping::is_crossed);
    all_rows && !crossed && objective.model.phases.iter().all(|phase| phase.filter.is_none())
}

/// The points after a step up and down of one coordinate, with the distance between the two.
pub(super) type EvaluationPair = ([EvaluationPoint; 2], f64);

/// The points after a step up and down of one value of α, with the distance between the two; `None` where ℓ is not
/// defined there.
pub(super) fn along_value(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    s: usize,
) -> Result<Option<EvaluationPair>, DynamicError> {
    let (sides, width) = sides(objective, &fit.sought, s);
    let at = |sought: &[f64]| -> Result<Option<EvaluationPoint>, DynamicError> {
        let alpha = objective.alpha(sought);
        let there = fit.estimate.state.at_other_alpha(&fit.reductions, &alpha).ok().flatten();
        there.map(|there| EvaluationPoint::new(objective, &alpha, there.law())).transpose()
    };
    let (Some(up), Some(down)) = (at(&sides[0])?, at(&sides[1])?) else { return Ok(None) };
    Ok(Some(([up, down], width)))
}

/// Sought values after a step up and down of value `s`, with the distance between the two in its coordinate.
pub(super) fn sides(objective: &ProfileLikelihood<'_>, sought: &[f64], s: usize) -> ([Vec<f64>; 2], f64) {
    let coordinate = &objective.coordinates[s];
    let step = coordinate.step(sought[s], STEP);
    let values = [1.0, -1.0].map(|sign| coordinate.moved(sought[s], sign * step));
    let moved = values.map(|value| {
        let mut moved = sought.to_vec();
        moved[s] = value;
        moved
    });
    (moved, coordinate.of_value(values[0]) - coordinate.of_value(values[1]))
}

/// Units of correlated tests: the tests of one group of the outermost level, or, without groups, a single test. The
/// order does not depend on the order of the tests in the ensemble.
pub(super) fn units<'a>(objective: &ProfileLikelihood<'a>) -> Vec<Vec<GroupedTest<'a>>> {
    let Some(grouping) = objective.grouping() else {
        return objective
            .order()
            .iter()
            .map(|&j| vec![GroupedTest { test: &objective.tests[j], groups: Vec::new() }])
            .collect();
    };
    let mut units: BTreeMap<usize, Vec<GroupedTest<'a>>> = BTreeMap::new();
    for &j in objective.order() {
        let groups: Vec<usize> = (0..grouping.depth()).map(|level| grouping.group_of(j, level)).collect();
        let unit = units.entry(groups.last().copied().unwrap_or(j)).or_default();
        unit.push(GroupedTest { test: &objective.tests[j], groups });
    }
    let mut units: Vec<Vec<GroupedTest<'a>>> = units.into_values().collect();
    // tests of a nested group follow each other
    units
        .iter_mut()
        .for_each(|unit| unit.sort_by_key(|member| member.groups.iter().rev().copied().collect::<Vec<_>>()));
    units
}

/// The point of a fit, and, for each coordinate, the points after a step up and down, with the distance between the
/// two.
pub(super) struct Directions {
    pub(super) centre: EvaluationPoint,
    pub(super) all: Vec<EvaluationPair>,
}

impl Directions {
    /// The points about a fit; `None` where (μ, Σ) after some step is not defined.
    fn of(
        objective: &ProfileLikelihood<'_>,
        fit: &DynamicFit,
        shared: &[usize],
    ) -> Result<Option<Directions>, DynamicError> {
        let state = &fit.estimate.state;
        let place = |alpha: &Alpha, law: InitialLaw| EvaluationPoint::new(objective, alpha, law);
        let mut all = Vec::new();
        for &s in shared {
            let Some(own) = along_value(objective, fit, s)? else { return Ok(None) };
            all.push(own);
        }
        let tangent = &state.newton_iterate.tangent;
        for i in 0..tangent.gradient.len() {
            let information = tangent.information[(i, i)];
            let step = STEP * if information > 0.0 { information.sqrt().recip() } else { tangent.sizes[i] };
            let at = |sign: f64| -> Result<Option<EvaluationPoint>, DynamicError> {
                let mut along = DVector::zeros(tangent.gradient.len());
                along[i] = sign * step;
                let there = state.moved(&fit.reductions, &fit.alpha, &along);
                there.map(|there| place(&fit.alpha, there.law())).transpose()
            };
            let (Some(up), Some(down)) = (at(1.0)?, at(-1.0)?) else { return Ok(None) };
            all.push(([up, down], 2.0 * step));
        }
        Ok(Some(Directions { centre: place(&fit.alpha, state.law())?, all }))
    }

    /// Expected information of a unit of tests; incomplete once `progress` stops.
    pub(super) fn information(
        &self,
        unit: &[GroupedTest<'_>],
        progress: &SharedProgress<'_>,
    ) -> Result<DMatrix<f64>, ReduceError> {
        let centre = self.centre.record(unit)?;
        let sides = |([up, down], width): &([EvaluationPoint; 2], f64)| -> Result<RecordPair, ReduceError> {
            Ok(RecordPair { up: up.record(unit)?, down: down.record(unit)?, width: *width })
        };
        let pairs: Vec<RecordPair> = self.all.iter().map(sides).collect::<Result<_, _>>()?;
        Ok(TangentFilter::new(pairs.len()).over(&centre, &pairs, progress))
    }
}

/// A record after a step up and after a step down along a coordinate, and the distance between the two points.
struct RecordPair {
    up: RecordMoments,
    down: RecordMoments,
    width: f64,
}

impl RecordPair {
    fn slope<T>(&self, up: T, down: T) -> T
    where
        T: std::ops::Sub<Output = T> + std::ops::Mul<f64, Output = T>,
    {
        // a value between two equal bounds cannot move
        if self.width == 0.0 { (up - down) * 0.0 } else { (up - down) * self.width.recip() }
    }

    /// Slopes of a time step between `up` and `down`; `own` is the time step at the fit.
    fn moment(&self, own: &TimeStep, up: TimeStep, down: TimeStep) -> TimeStep {
        let motion = own.motion.as_ref().map(|own| match (up.motion, down.motion) {
            (Some(up), Some(down)) => MotionValues {
                phi: self.slope(up.phi, down.phi),
                noise: self.slope(up.noise, down.noise),
                input: self.slope(up.input, down.input),
            },
            _ => MotionValues::zero_motion(own.phi.shape()),
        });
        let line = |(up, down): (LineValues, LineValues)| LineValues {
            h: self.slope(up.h, down.h),
            noise: self.slope(up.noise, down.noise),
            value: self.slope(up.value, down.value),
        };
        TimeStep { motion, lines: up.lines.into_iter().zip(down.lines).map(line).collect() }
    }
}

/// State of the filter: P, the tangents of P, and mean and covariance of the stacked vector u = (x̂, tangents of x̂).
struct TangentFilter {
    n: usize,
    variance: DMatrix<f64>,
    slopes: Vec<DMatrix<f64>>,
    mean: DVector<f64>,
    spread: DMatrix<f64>,
    information: DMatrix<f64>,
}

impl TangentFilter {
    /// The filter before the first entry, with `k` coordinates.
    fn new(k: usize) -> TangentFilter {
        TangentFilter {
            n: 0,
            variance: DMatrix::zeros(0, 0),
            slopes: vec![DMatrix::zeros(0, 0); k],
            mean: DVector::zeros(0),
            spread: DMatrix::zeros(0, 0),
            information: DMatrix::zeros(k, k),
        }
    }

    /// The information from all time steps of a record; incomplete once `progress` stops.
    fn over(mut self, centre: &RecordMoments, pairs: &[RecordPair], progress: &SharedProgress<'_>) -> DMatrix<f64> {
        let mut side_steps: Vec<[TimeSteps<'_>; 2]> =
            pairs.iter().map(|pair| [pair.up.moments(), pair.down.moments()]).collect();
        for (number, own) in centre.moments().enumerate() {
            if number % STEPS_PER_CHECK == STEPS_PER_CHECK - 1 && progress.stops() {
                break;
            }
            let sides = pairs.iter().zip(&mut side_steps);
            let slopes: Option<Vec<TimeStep>> =
                sides.map(|(pair, [up, down])| Some(pair.moment(&own, up.next()?, down.next()?))).collect();
            let Some(slopes) = slopes else { break };
            if let Some(motion) = &own.motion {
                let slopes: Vec<&MotionValues> = slopes.iter().filter_map(|slope| slope.motion.as_ref()).collect();
                self.advance(motion, &slopes);
            }
            for (k, line) in own.lines.iter().enumerate() {
                let slopes: Vec<&LineValues> = slopes.iter().map(|slope| &slope.lines[k]).collect();
                self.measure(line, &slopes);
            }
        }
        self.information
    }

    /// Predicts over a motion: x̂ → φx̂ + b, P → φPφ' + Q.
    fn advance(&mut self, own: &MotionValues, slopes: &[&MotionValues]) {
        let to = own.phi.nrows();
        let stays = own.phi.is_square() && own.phi.is_identity(0.0);
        let moves = !stays || slopes.iter().any(|slope| slope.phi.iter().any(|x| *x != 0.0));
        let before = std::mem::replace(&mut self.variance, DMatrix::zeros(0, 0));
        if moves {
            for (a, slope) in slopes.iter().enumerate() {
                let turned = &slope.phi * &before * own.phi.transpose();
                self.slopes[a] = &own.phi * &self.slopes[a] * own.phi.transpose() + &turned + turned.transpose();
            }
            self.variance = &own.phi * before * own.phi.transpose();
            let mean = DMatrix::from_column_slice(self.mean.len(), 1, self.mean.as_slice());
            self.mean = stacked(own, slopes, &mean).column(0).clone_owned();
            let half = stacked(own, slopes, &self.spread);
            self.spread = stacked(own, slopes, &half.transpose());
        } else {
            self.variance = before;
        }
        self.n = to;
        self.variance += &own.noise;
        let inputs = std::iter::once(&own.input).chain(slopes.iter().map(|slope| &slope.input));
        inputs.enumerate().for_each(|(a, input)| self.mean.rows_mut(to * a, to).add_assign(input));
        self.slopes.iter_mut().zip(slopes).for_each(|(own, slope)| own.add_assign(&slope.noise));
    }

    /// Updates by a measurement z = h'x + d + v, whose innovation is informative through its variance and its mean.
    fn measure(&mut self, own: &LineValues, slopes: &[&LineValues]) {
        let n = self.n;
        let carried = &self.variance * &own.h;
        let variance = own.h.dot(&carried) + own.noise;
        if variance <= 0.0 {
            return; // the prediction is exact, so the measurement has no information
        }
        let gain = &carried / variance;
        let k = slopes.len();
        // e_a = value_a - h_a'x̂ - h'x̂_a = value_a - (column a of `observation_map`)'u
        let mut observation_map = DMatrix::zeros(self.mean.len(), k);
        let mut turned = DVector::zeros(k); // S_a
        let mut gains = DMatrix::zeros(n, k); // K_a
        for (a, slope) in slopes.iter().enumerate() {
            observation_map.view_mut((0, a), (n, 1)).copy_from(&slope.h);
            observation_map.view_mut((n * (a + 1), a), (n, 1)).copy_from(&own.h);
            let carried_slope = &self.slopes[a] * &own.h + &self.variance * &slope.h;
            turned[a] = own.h.dot(&(&self.slopes[a] * &own.h)) + 2.0 * slope.h.dot(&carried) + slope.noise;
            gains.set_column(a, &((carried_slope - &gain * turned[a]) / variance));
        }
        let expected = DVector::from_fn(k, |a, _| slopes[a].value) - observation_map.tr_mul(&self.mean);
        let with = &self.spread * &observation_map;
        let residual_covariance = observation_map.tr_mul(&with);
        self.information += (&turned * turned.transpose()) * (0.5 / (variance * variance))
            + (&expected * expected.transpose() + &residual_covariance) / variance;
        // x̂_a → x̂_a + K_a e + K e_a, x̂ → x̂ + K e
        let mut gain_map = DMatrix::zeros(self.mean.len(), k);
        let mut white = DVector::zeros(self.mean.len());
        white.rows_mut(0, n).copy_from(&gain);
        for a in 0..k {
            gain_map.view_mut((n * (a + 1), a), (n, 1)).copy_from(&gain);
            white.rows_mut(n * (a + 1), n).copy_from(&gains.column(a));
        }
        self.mean += &gain_map * &expected;
        let crossed = &with * gain_map.transpose();
        self.spread += &gain_map * residual_covariance * gain_map.transpose() - &crossed - crossed.transpose();
        self.spread.ger(variance, &white, &white, 1.0);
        for (a, slope) in self.slopes.iter_mut().enumerate() {
            let crossed = gains.column(a) * gain.transpose() * variance;
            *slope -= &crossed + crossed.transpose() + &gain * gain.transpose() * turned[a];
        }
        self.variance -= &gain * gain.transpose() * variance;
    }
}

/// The rows of u = (x̂, tangents of x̂) after a motion: φx̂, and φx̂_a + φ_a x̂ for each tangent.
fn stacked(own: &MotionValues, slopes: &[&MotionValues], before: &DMatrix<f64>) -> DMatrix<f64> {
    let ((to, from), columns) = (own.phi.shape(), before.ncols());
    let mut after = DMatrix::zeros(to * (slopes.len() + 1), columns);
    for a in 0..=slopes.len() {
        after.rows_mut(to * a, to).gemm(1.0, &own.phi, &before.rows(from * a, from), 0.0);
        if let Some(slope) = a.checked_sub(1).map(|a| slopes[a]).filter(|slope| slope.phi.iter().any(|x| *x != 0.0)) {
            after.rows_mut(to * a, to).gemm(1.0, &slope.phi, &before.rows(0, from), 1.0);
        }
    }
    after
}
