//! Expected information of (α, μ, Σ) together (theory §13): of a test, Σ_k ½ tr(S⁻¹S_aS⁻¹S_b) + E[e_a'S⁻¹e_b] over its innovations e,
//! with their tangents along each coordinate. One filter carries P, the predicted state x̂ and the tangents of both; what of x̂ and of
//! its tangents is random comes from the innovations before, which are white.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::dynamic::bench::Bench;
use crate::dynamic::covariances::Covariances;
use crate::dynamic::{Coordinate, DynamicError, DynamicFit};
use crate::ensemble::Test;
use crate::estimate::InitialLaw;
use crate::model::{Alpha, Model};
use crate::reduce::{Data, Design, Evidence, PhasedTest, Reducer, Transition};

/// Step of a coordinate of α, and of the tangent basis in standard errors, for differences of coefficients.
const STEP: f64 = 1e-4;
/// A value that is not positive moves by this part of one at least.
const LEAST: f64 = 1e-2;

/// Covariances from the expected information; `None` where values of single tests are free, and where some side is not defined.
pub(super) fn expected(bench: &Bench<'_>, fit: &DynamicFit) -> Result<Option<Covariances>, DynamicError> {
    let shared = fit.joint.shared();
    let model = &bench.model.phases[0].model;
    let Some(directions) = Directions::of(bench, fit, shared)? else { return Ok(None) };
    let one = |&j: &usize| -> Result<DMatrix<f64>, DynamicError> {
        directions.information(model, rows(&bench.tests[j])).map_err(|error| DynamicError::Reduce(Box::new(error)))
    };
    let all: Vec<Result<DMatrix<f64>, DynamicError>> = bench.order().par_iter().map(one).collect();
    let n = directions.all.len();
    let sum = all.into_iter().try_fold(DMatrix::zeros(n, n), |sum, one| one.map(|one| sum + one))?;
    Ok(fit.joint.covariances_of(&sum))
}

/// A model whose tests are rows of one phase and in no groups, its noises known up to their variances: that of which it is worked out.
pub(super) fn is_possible(bench: &Bench<'_>) -> bool {
    let all_rows = bench.tests.iter().all(|test| matches!(test.phases[..], [Evidence::Rows(_)]));
    let [phase] = &bench.model.phases[..] else { return false };
    bench.model.levels.is_empty() && all_rows && phase.filter.is_none() && phase.model.noise_covariance.is_empty()
}

fn rows(test: &PhasedTest) -> &Test {
    match &test.phases[0] {
        Evidence::Rows(rows) => rows,
        _ => unreachable!("tests that are no rows were refused"),
    }
}

/// A place in all coordinates.
struct Place {
    reducer: Reducer,
    law: InitialLaw,
}

/// The place of a fit, and places to both sides of it along each coordinate, with the distance between them.
struct Directions {
    home: Place,
    all: Vec<([Place; 2], f64)>,
}

impl Directions {
    /// `None` where (μ, Σ) have no law to some side.
    fn of(bench: &Bench<'_>, fit: &DynamicFit, shared: &[usize]) -> Result<Option<Directions>, DynamicError> {
        let model = &bench.model.phases[0].model;
        let state = &fit.estimate.state;
        let place = |alpha: &Alpha, law: InitialLaw| -> Result<Place, DynamicError> {
            Ok(Place { reducer: Reducer::new(model, alpha).map_err(Box::new)?, law })
        };
        let mut all = Vec::new();
        for &s in shared {
            let coordinate = &bench.coordinates[s];
            let values = [1.0, -1.0].map(|sign| moved(coordinate, fit.sought[s], sign));
            let at = |value: f64| -> Result<Option<Place>, DynamicError> {
                let mut sought = fit.sought.clone();
                sought[s] = value;
                let alpha = bench.alpha(&sought);
                let there = state.elsewhere(&fit.reductions, &alpha).ok().flatten();
                there.map(|there| place(&alpha, there.law())).transpose()
            };
            let width = coordinate.of_value(values[0]) - coordinate.of_value(values[1]);
            let (Some(up), Some(down)) = (at(values[0])?, at(values[1])?) else { return Ok(None) };
            all.push(([up, down], width));
        }
        let tangent = &state.place.tangent;
        for i in 0..tangent.gradient.len() {
            let information = tangent.information[(i, i)];
            let step = STEP * if information > 0.0 { information.sqrt().recip() } else { tangent.sizes[i] };
            let at = |sign: f64| -> Result<Option<Place>, DynamicError> {
                let mut along = DVector::zeros(tangent.gradient.len());
                along[i] = sign * step;
                let there = state.moved(&fit.reductions, &fit.alpha, &along);
                there.map(|there| place(&fit.alpha, there.law())).transpose()
            };
            let (Some(up), Some(down)) = (at(1.0)?, at(-1.0)?) else { return Ok(None) };
            all.push(([up, down], 2.0 * step));
        }
        Ok(Some(Directions { home: place(&fit.alpha, state.law())?, all }))
    }

    /// What a test is expected to say.
    fn information(&self, model: &Model, test: &Test) -> Result<DMatrix<f64>, crate::reduce::ReduceError> {
        let home = Side::of(&self.home, test)?;
        let sides = |([up, down], width): &([Place; 2], f64)| -> Result<Pair, crate::reduce::ReduceError> {
            Ok(Pair { up: Side::of(up, test)?, down: Side::of(down, test)?, width: *width })
        };
        let pairs: Vec<Pair> = self.all.iter().map(sides).collect::<Result<_, _>>()?;
        debug_assert_eq!(home.design.frame.n, model.states.len(), "every state is in the filter");
        Ok(Carried::new(&home, &pairs).over(&home, &pairs))
    }
}

fn moved(coordinate: &Coordinate, value: f64, sign: f64) -> f64 {
    let step = if coordinate.log { STEP } else { STEP * value.abs().max(LEAST) };
    coordinate.moved(value, sign * step)
}

/// A test at a place: its design and data, and the law of the state before the first step.
struct Side {
    design: Design,
    data: Data,
    mean: DVector<f64>,
    variance: DMatrix<f64>,
}

impl Side {
    fn of(place: &Place, test: &Test) -> Result<Side, crate::reduce::ReduceError> {
        let mut work = place.reducer.workspace();
        let (design, data, covariates) = place.reducer.evaluated(test, &mut work)?;
        let (n, p, r) = (design.frame.n, design.frame.p, design.frame.r);
        let sensitivity = DMatrix::from_row_slice(n, p, &design.frame.sensitivity);
        let mean = &sensitivity * place.law.mean_of(&covariates) + DVector::from_column_slice(&data.start);
        let root = &sensitivity * &place.law.root;
        let mut variance = &root * root.transpose();
        for i in 0..r {
            for j in 0..r {
                variance[(i, j)] += design.variance[i.max(j) * r + i.min(j)];
            }
        }
        Ok(Side { design, data, mean, variance })
    }
}

/// Places to both sides, and the distance between them.
struct Pair {
    up: Side,
    down: Side,
    width: f64,
}

impl Pair {
    fn slope<T>(&self, up: T, down: T) -> T
    where
        T: std::ops::Sub<Output = T> + std::ops::Mul<f64, Output = T>,
    {
        // a value between two bounds that meet has no sides
        if self.width == 0.0 { (up - down) * 0.0 } else { (up - down) * self.width.recip() }
    }
}

/// What the filter carries: P and its tangents; mean and covariance of u = (x̂, tangents of x̂), one after the other.
struct Carried {
    n: usize,
    variance: DMatrix<f64>,
    slopes: Vec<DMatrix<f64>>,
    mean: DVector<f64>,
    spread: DMatrix<f64>,
    information: DMatrix<f64>,
}

impl Carried {
    fn new(home: &Side, pairs: &[Pair]) -> Carried {
        let n = home.mean.len();
        let mut mean = DVector::zeros(n * (pairs.len() + 1));
        mean.rows_mut(0, n).copy_from(&home.mean);
        for (a, pair) in pairs.iter().enumerate() {
            mean.rows_mut(n * (a + 1), n).copy_from(&pair.slope(pair.up.mean.clone(), pair.down.mean.clone()));
        }
        let slope = |pair: &Pair| pair.slope(pair.up.variance.clone(), pair.down.variance.clone());
        Carried {
            n,
            variance: home.variance.clone(),
            slopes: pairs.iter().map(slope).collect(),
            spread: DMatrix::zeros(mean.len(), mean.len()),
            mean,
            information: DMatrix::zeros(pairs.len(), pairs.len()),
        }
    }

    /// All steps of the test.
    fn over(mut self, home: &Side, pairs: &[Pair]) -> DMatrix<f64> {
        let mut at = Cursor::new(home);
        let mut beside: Vec<[Cursor<'_>; 2]> =
            pairs.iter().map(|pair| [Cursor::new(&pair.up), Cursor::new(&pair.down)]).collect();
        for step in home.design.each_step() {
            let own = at.motion(step.transition.map(|transition| &**transition));
            let sides: Vec<[Option<Motion>; 2]> = beside
                .iter_mut()
                .map(|both| {
                    both.each_mut().map(|side| {
                        let transition = side.next_transition();
                        side.motion(transition)
                    })
                })
                .collect();
            if let Some(own) = own {
                let slope = |(pair, [up, down]): (&Pair, [Option<Motion>; 2])| match (up, down) {
                    (Some(up), Some(down)) => up.minus(&down, pair),
                    _ => Motion::still(self.n),
                };
                let slopes: Vec<Motion> = pairs.iter().zip(sides).map(slope).collect();
                self.advance(&own, &slopes);
            }
            for (line, row) in step.lines.zip(step.rows) {
                let own = Line::of(home, line, row, self.n);
                let slopes: Vec<Line> = pairs
                    .iter()
                    .zip(&mut beside)
                    .map(|(pair, [up, down])| {
                        let [up, down] = [up.line(self.n), down.line(self.n)];
                        Line {
                            h: pair.slope(up.h, down.h),
                            noise: pair.slope(up.noise, down.noise),
                            value: pair.slope(up.value, down.value),
                        }
                    })
                    .collect();
                self.measure(&own, &slopes);
            }
        }
        self.information
    }

    /// Over a step: x̂ → φx̂ + b, P → φPφ' + Q.
    fn advance(&mut self, own: &Motion, slopes: &[Motion]) {
        let n = self.n;
        let mut map = DMatrix::zeros(self.mean.len(), self.mean.len());
        map.view_mut((0, 0), (n, n)).copy_from(&own.phi);
        let mut input = DVector::zeros(self.mean.len());
        input.rows_mut(0, n).copy_from(&own.input);
        let before = self.variance.clone();
        for (a, slope) in slopes.iter().enumerate() {
            let place = n * (a + 1);
            map.view_mut((place, place), (n, n)).copy_from(&own.phi);
            map.view_mut((place, 0), (n, n)).copy_from(&slope.phi);
            input.rows_mut(place, n).copy_from(&slope.input);
            let turned = &slope.phi * &before * own.phi.transpose();
            self.slopes[a] =
                &own.phi * &self.slopes[a] * own.phi.transpose() + &turned + turned.transpose() + &slope.noise;
        }
        self.variance = &own.phi * before * own.phi.transpose() + &own.noise;
        self.mean = &map * &self.mean + input;
        self.spread = &map * &self.spread * map.transpose();
    }

    /// A measurement z = h'x + d + v: its innovation is informative through its variance and its mean, and updates what is carried.
    fn measure(&mut self, own: &Line, slopes: &[Line]) {
        let n = self.n;
        let carried = &self.variance * &own.h;
        let variance = own.h.dot(&carried) + own.noise;
        if variance <= 0.0 {
            return; // it can only be one value, and says nothing
        }
        let gain = &carried / variance;
        let k = slopes.len();
        // e_a = value_a - h_a'x̂ - h'x̂_a = value_a - (column a of `seen`)'u
        let mut seen = DMatrix::zeros(self.mean.len(), k);
        let mut turned = DVector::zeros(k); // S_a
        let mut gains = DMatrix::zeros(n, k); // K_a
        for (a, slope) in slopes.iter().enumerate() {
            seen.view_mut((0, a), (n, 1)).copy_from(&slope.h);
            seen.view_mut((n * (a + 1), a), (n, 1)).copy_from(&own.h);
            let from = &self.slopes[a] * &own.h + &self.variance * &slope.h;
            turned[a] = own.h.dot(&(&self.slopes[a] * &own.h)) + 2.0 * slope.h.dot(&carried) + slope.noise;
            gains.set_column(a, &((from - &gain * turned[a]) / variance));
        }
        let expected = DVector::from_fn(k, |a, _| slopes[a].value) - seen.tr_mul(&self.mean);
        let with = &self.spread * &seen;
        let among = seen.tr_mul(&with);
        self.information += (&turned * turned.transpose()) * (0.5 / (variance * variance))
            + (&expected * expected.transpose() + &among) / variance;
        // x̂_a → x̂_a + K_a e + K e_a, x̂ → x̂ + K e
        let mut through = DMatrix::zeros(self.mean.len(), k);
        let mut white = DVector::zeros(self.mean.len());
        white.rows_mut(0, n).copy_from(&gain);
        for a in 0..k {
            through.view_mut((n * (a + 1), a), (n, 1)).copy_from(&gain);
            white.rows_mut(n * (a + 1), n).copy_from(&gains.column(a));
        }
        self.mean += &through * &expected;
        let crossed = &with * through.transpose();
        self.spread += &through * among * through.transpose() - &crossed - crossed.transpose();
        self.spread.ger(variance, &white, &white, 1.0);
        for (a, slope) in self.slopes.iter_mut().enumerate() {
            let crossed = gains.column(a) * gain.transpose() * variance;
            *slope -= &crossed + crossed.transpose() + &gain * gain.transpose() * turned[a];
        }
        self.variance -= &gain * gain.transpose() * variance;
    }
}

/// φ, Q and b of a step, or their slopes.
struct Motion {
    phi: DMatrix<f64>,
    noise: DMatrix<f64>,
    input: DVector<f64>,
}

impl Motion {
    /// Slopes of what does not change.
    fn still(n: usize) -> Motion {
        Motion { phi: DMatrix::zeros(n, n), noise: DMatrix::zeros(n, n), input: DVector::zeros(n) }
    }

    fn minus(self, other: &Motion, pair: &Pair) -> Motion {
        Motion {
            phi: pair.slope(self.phi, other.phi.clone()),
            noise: pair.slope(self.noise, other.noise.clone()),
            input: pair.slope(self.input, other.input.clone()),
        }
    }
}

/// h, R and z - d of a scalar measurement, or their slopes.
struct Line {
    h: DVector<f64>,
    noise: f64,
    value: f64,
}

impl Line {
    fn of(side: &Side, line: usize, row: usize, n: usize) -> Line {
        let (states, terms) = side.design.terms(line);
        let mut h = DVector::zeros(n);
        states.iter().zip(terms).for_each(|(&state, &term)| h[state as usize] = term);
        Line { h, noise: side.design.noise[line], value: side.data.values[row] }
    }
}

/// A test on its way through its steps.
struct Cursor<'a> {
    side: &'a Side,
    /// Number of the next step, and the next (line, row) of the present one.
    step: usize,
    next: (usize, usize),
    /// Inputs that were taken.
    inputs: usize,
}

impl<'a> Cursor<'a> {
    fn new(side: &'a Side) -> Cursor<'a> {
        Cursor { side, step: 0, next: (0, 0), inputs: 0 }
    }

    /// Goes on to the next step.
    fn next_transition(&mut self) -> Option<&'a Transition> {
        let step = self.side.design.step(self.step);
        self.step += 1;
        self.next = (step.lines.start, step.rows.start);
        step.transition.map(|transition| &**transition)
    }

    /// The next measurement of the step.
    fn line(&mut self, n: usize) -> Line {
        let (line, row) = self.next;
        self.next = (line + 1, row + 1);
        Line::of(self.side, line, row, n)
    }

    /// φ, Q and b of a transition, which takes its inputs.
    fn motion(&mut self, transition: Option<&Transition>) -> Option<Motion> {
        let (transition, design) = (transition?, &self.side.design);
        let n = design.frame.n;
        let mut input = DVector::zeros(n);
        for &state in &design.frame.driven {
            input[state as usize] = self.side.data.inputs[self.inputs];
            self.inputs += 1;
        }
        Some(Motion { phi: transition.phi_of(n, |i| i), noise: transition.noise_of(n, |i| i), input })
    }
}
