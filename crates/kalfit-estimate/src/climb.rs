//! Newton's method from a given iterate, for objectives near one that is solved already: no start is needed, and few
//! steps are.

use crate::certificate::{Escape, certificate};
use crate::covariance::CovarianceMap;
use crate::local::Objective;
use crate::newton::{Attempt, Damping, NewtonIterate, moved};
use crate::point::Point;
use crate::settings::Stop;

/// Smallest fraction of the gain promised by the slopes along flat directions at which a step along them is accepted.
const RISES: f64 = 0.05;

/// The limits of a climb.
#[derive(Debug, Clone, Copy)]
pub struct ClimbLimits {
    /// Newton decrement that counts as the optimum.
    pub tolerance: f64,
    /// Maximum number of accepted steps.
    pub steps: usize,
}

/// Takes Newton steps until the certificate holds, leaving the boundary where it must.
pub fn climb(
    objective: &dyn Objective,
    map: &CovarianceMap,
    tests: f64,
    start: NewtonIterate,
    limits: ClimbLimits,
) -> (NewtonIterate, Stop) {
    let mut place = start;
    let mut damping = Damping::default();
    for _ in 0..limits.steps {
        if place.decrement() <= limits.tolerance {
            match escaped(objective, map, tests, &mut place).or_else(|| slid(objective, map, &mut place)) {
                Some(better) => place = better,
                None => return (place, Stop::Certified),
            }
        }
        match damping.attempt(objective, map, &mut place) {
            Attempt::Better(next) => place = *next,
            Attempt::Failed | Attempt::Blind => return (place, Stop::Stalled),
        }
    }
    let certified = place.decrement() <= limits.tolerance && certificate(map, &place, tests).1.is_none();
    (place, if certified { Stop::Certified } else { Stop::PassLimit })
}

/// A better iterate off the boundary, where the certificate fails on the null space of Σ.
pub(crate) fn escaped(
    objective: &dyn Objective,
    map: &CovarianceMap,
    tests: f64,
    place: &mut NewtonIterate,
) -> Option<NewtonIterate> {
    let (_, escape) = certificate(map, place, tests);
    let escape = escape?;
    let mut length = escape.length;
    for _ in 0..8 {
        if let Some(next) = place.surpassed(objective, |place| grown(objective, map, place, &escape, length)) {
            return Some(next);
        }
        length *= 0.25;
    }
    None
}

/// A better iterate along the flat directions that ordinary steps leave out, where ℓ rises as their slopes promise.
pub(crate) fn slid(objective: &dyn Objective, map: &CovarianceMap, place: &mut NewtonIterate) -> Option<NewtonIterate> {
    let (step, promised) = place.curvature.along_flat()?;
    place.surpassed(objective, |place| {
        let point = moved(objective, map, place, &step)?;
        let next = NewtonIterate::new(objective, map, point, place.near())?;
        (next.local.value > place.local.value + RISES * promised).then_some(next)
    })
}

fn grown(
    objective: &dyn Objective,
    map: &CovarianceMap,
    place: &NewtonIterate,
    escape: &Escape,
    length: f64,
) -> Option<NewtonIterate> {
    let sigma = place.point.covariance() + &escape.direction * length;
    let root = map.onto(&map.root_of(&sigma))?;
    let next = NewtonIterate::new(objective, map, Point { root, ..place.point.clone() }, place.near())?;
    (next.local.value > place.local.value).then_some(next)
}
