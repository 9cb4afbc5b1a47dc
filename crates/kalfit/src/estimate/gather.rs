//! One class, from its tests.

use nalgebra::DMatrix;

use crate::estimate::chained::{ChainStore, ChainedClass};
use crate::estimate::class::Class;
use crate::estimate::frame::Frame;
use crate::linalg::elements::Elements;
use crate::linalg::symmetric::{self, pair};
use crate::reduce::{Chain, Path, Reductions};

/// Puts some tests with one R, by their numbers, into the place of a class.
pub(super) fn gather(reductions: &Reductions, tests: &[usize], frame: &Frame, class: &mut Class) {
    let p = frame.scale.len();
    let zeros = |numbers: &mut Vec<f64>, size: usize| {
        numbers.clear();
        numbers.resize(size, 0.0);
    };
    zeros(&mut class.factor, p * p);
    zeros(&mut class.mean, p); // R × the centre
    let factor = reductions.factor(tests[0]);
    for k in 0..p {
        for (i, &x) in factor[pair(k, 0)..][..=k].iter().enumerate() {
            class.factor[i * p + k] = x * frame.scale[k];
            class.mean[i] += x * frame.centre[k];
        }
    }
    class.scatter.clear();
    if let &[alone] = tests {
        class.mean.iter_mut().zip(reductions.data(alone)).for_each(|(mean, d)| *mean = d - *mean);
    } else {
        let offset = std::mem::replace(&mut class.mean, vec![0.0; p]);
        scatter(reductions, tests, &offset, class);
    }
    class.constant = tests.iter().map(|&j| reductions.constant(j)).sum();
    class.square_root = tests.iter().any(|&j| reductions.path(j) == Path::SquareRoot);
    class.chain = None;
    about(reductions, tests, frame, class);
}

/// The same of tests in phases; `place`: where their chain stands if it is made.
pub(super) fn gather_chains(
    (reductions, tests): (&Reductions, &[usize]),
    (frame, elements): (&Frame, &Elements),
    place: Option<ChainStore>,
    class: &mut Class,
) {
    let chains: Vec<&Chain> = tests.iter().filter_map(|&j| reductions.chain(j)).collect();
    let constant = |chain: &&Chain| chain.phases.iter().map(|phase| phase.constant).sum::<f64>();
    [&mut class.factor, &mut class.mean, &mut class.scatter].into_iter().for_each(Vec::clear);
    class.constant = chains.iter().map(constant).sum();
    class.square_root = false;
    let made = || ChainStore::Apart(ChainedClass::new(&chains, elements.blocks(), frame).into());
    class.chain = Some(place.unwrap_or_else(made));
    about(reductions, tests, frame, class);
}

/// How many they are, and their covariates in units of the frame.
fn about(reductions: &Reductions, tests: &[usize], frame: &Frame, class: &mut Class) {
    class.count = tests.len() as f64;
    class.covariates.clear();
    let covariates = reductions.covariates(tests[0]).iter().zip(&frame.covariate_scale);
    class.covariates.extend(covariates.map(|(x, s)| x / s));
}

/// The mean of d of several tests, and vectors whose outer products add up to their scatter about it.
fn scatter(reductions: &Reductions, tests: &[usize], offset: &[f64], class: &mut Class) {
    let (p, mean) = (offset.len(), &mut class.mean);
    for &j in tests {
        let data = reductions.data(j);
        (0..p).for_each(|i| mean[i] += data[i] - offset[i]);
    }
    mean.iter_mut().for_each(|m| *m /= tests.len() as f64);
    let away = |j: usize, i: usize| reductions.data(j)[i] - offset[i] - mean[i];
    if tests.len() <= p {
        class.scatter.extend(tests.iter().flat_map(|&j| (0..p).map(move |i| (j, i))).map(|(j, i)| away(j, i)));
        return;
    }
    let (mut sum, mut own) = (DMatrix::zeros(p, p), vec![0.0; p]);
    for &j in tests {
        own.iter_mut().enumerate().for_each(|(i, x)| *x = away(j, i));
        for (k, column) in sum.as_mut_slice().chunks_exact_mut(p.max(1)).enumerate() {
            column.iter_mut().zip(&own).for_each(|(s, a)| *s += a * own[k]);
        }
    }
    class.scatter.extend_from_slice(symmetric::square_root(&sum).as_slice());
}
