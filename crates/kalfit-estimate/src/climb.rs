//! Newton's method from a given iterate, for an objective with a maximum near that iterate: few steps are needed.

use crate::certificate::{Escape, certificate};
use crate::covariance::CovarianceMap;
use crate::local::Objective;
use crate::newton::{Attempt, Damping, NewtonIterate, moved};
use crate::point::Point;
use crate::settings::Stop;

/// A step along flat directions is accepted if ℓ gains at least this fraction of what the slopes promise.
const MIN_FLAT_GAIN_RATIO: f64 = 0.05;

/// The limits of a climb.
#[derive(Debug, Clone, Copy)]
pub struct ClimbLimits {
    /// Newton decrement that counts as the optimum.
    pub tolerance: f64,
    /// Maximum number of accepted steps.
    pub steps: usize,
}

/// Takes Newton steps until the certificate holds, with steps off the boundary where the certificate fails on the null
/// space of Σ.
pub fn climb(
    objective: &dyn Objective,
    map: &CovarianceMap,
    tests: f64,
    start: NewtonIterate,
    limits: ClimbLimits,
) -> (NewtonIterate, Stop) {
    let mut iterate = start;
    let mut damping = Damping::default();
    for _ in 0..limits.steps {
        if iterate.decrement() <= limits.tolerance {
            match step_off_boundary(objective, map, tests, &mut iterate)
                .or_else(|| step_along_flat(objective, map, &mut iterate))
            {
                Some(better) => iterate = better,
                None => return (iterate, Stop::Certified),
            }
        }
        match damping.attempt(objective, map, &mut iterate) {
            Attempt::Better(next) => iterate = *next,
            Attempt::Failed | Attempt::BelowRounding => return (iterate, Stop::Stalled),
        }
    }
    let certified = iterate.decrement() <= limits.tolerance && certificate(map, &iterate, tests).1.is_none();
    (iterate, if certified { Stop::Certified } else { Stop::PassLimit })
}

/// A better iterate off the boundary, where the certificate fails on the null space of Σ.
pub(crate) fn step_off_boundary(
    objective: &dyn Objective,
    map: &CovarianceMap,
    tests: f64,
    iterate: &mut NewtonIterate,
) -> Option<NewtonIterate> {
    let (_, escape) = certificate(map, iterate, tests);
    let escape = escape?;
    let mut length = escape.length;
    for _ in 0..8 {
        if let Some(next) =
            iterate.try_successor(objective, |iterate| after_escape(objective, map, iterate, &escape, length))
        {
            return Some(next);
        }
        length *= 0.25;
    }
    None
}

/// A better iterate along flat directions, which ordinary steps leave out; `None` where ℓ gains too little of what the
/// slopes promise.
pub(crate) fn step_along_flat(
    objective: &dyn Objective,
    map: &CovarianceMap,
    iterate: &mut NewtonIterate,
) -> Option<NewtonIterate> {
    let (step, promised) = iterate.curvature.along_flat()?;
    iterate.try_successor(objective, |iterate| {
        let point = moved(objective, map, iterate, &step)?;
        let next = NewtonIterate::new(objective, map, point, iterate.near())?;
        (next.local.value > iterate.local.value + MIN_FLAT_GAIN_RATIO * promised).then_some(next)
    })
}

fn after_escape(
    objective: &dyn Objective,
    map: &CovarianceMap,
    iterate: &NewtonIterate,
    escape: &Escape,
    length: f64,
) -> Option<NewtonIterate> {
    let sigma = iterate.point.covariance() + &escape.direction * length;
    let root = map.on_constraints(&map.root_of(&sigma))?;
    let next = NewtonIterate::new(objective, map, Point { root, ..iterate.point.clone() }, iterate.near())?;
    (next.local.value > iterate.local.value).then_some(next)
}
