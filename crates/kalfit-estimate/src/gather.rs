//! Gathers the tests of one class.

use nalgebra::DMatrix;

use crate::chained::{ChainStore, ChainedClass};
use crate::class::Class;
use crate::frame::Frame;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::fold::norm;
use kalfit_algebra::symmetric;
use kalfit_algebra::symmetric::pair;
use kalfit_filter::reduce::Reductions;
use kalfit_model::Chain;
use kalfit_model::ExactRows;
use kalfit_model::Path;

/// Writes the tests of these indices, which share one R, into the buffer of a class.
pub(super) fn gather(reductions: &Reductions, tests: &[usize], frame: &Frame, class: &mut Class) {
    let p = frame.scale.len();
    let zeros = |numbers: &mut Vec<f64>, size: usize| {
        numbers.clear();
        numbers.resize(size, 0.0);
    };
    let exact = reductions.exact(tests[0]);
    let rows = p + exact.map_or(0, |exact| exact.values.len());
    zeros(&mut class.factor, rows * p);
    zeros(&mut class.mean, rows); // R × centre, then C × centre
    let factor = reductions.factor(tests[0]);
    for k in 0..p {
        for (i, &x) in factor[pair(k, 0)..][..=k].iter().enumerate() {
            class.factor[i * p + k] = x * frame.scale[k];
            class.mean[i] += x * frame.centre[k];
        }
    }
    let units = exact.map_or_else(Vec::new, |exact| write_exact(exact, frame, class));
    class.scatter.clear();
    if let (&[single], None) = (tests, exact) {
        class.mean.iter_mut().zip(reductions.data(single)).for_each(|(mean, d)| *mean = d - *mean);
    } else {
        let offset = std::mem::replace(&mut class.mean, vec![0.0; rows]);
        scatter((reductions, tests), (&offset, &units), class);
    }
    class.constant = tests.iter().map(|&j| reductions.constant(j)).sum();
    // the density of the scaled rows, from that of g
    class.constant += tests.len() as f64 * units.iter().map(|unit| unit.ln()).sum::<f64>();
    class.square_root = exact.is_some() || tests.iter().any(|&j| reductions.path(j) == Path::SquareRoot);
    class.chain = None;
    set_count_and_covariates(reductions, tests, frame, class);
}

/// Writes C, with rows of length one, and C × centre into a class; returns the factors that scaled the rows.
fn write_exact(exact: &ExactRows, frame: &Frame, class: &mut Class) -> Vec<f64> {
    let p = frame.scale.len();
    let mut units = Vec::with_capacity(exact.values.len());
    for (at, (row, _)) in exact.rows(p).enumerate() {
        let scaled: Vec<f64> = row.iter().zip(&frame.scale).map(|(c, scale)| c * scale).collect();
        let unit = norm(&scaled).recip();
        let to = &mut class.factor[(p + at) * p..][..p];
        to.iter_mut().zip(&scaled).for_each(|(to, c)| *to = c * unit);
        class.mean[p + at] = unit * row.iter().zip(&frame.centre).map(|(c, centre)| c * centre).sum::<f64>();
        units.push(unit);
    }
    units
}

/// Writes tests in phases into the buffer of a class; `place`: the lane of the class, if packed.
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
    let made = || ChainStore::Single(ChainedClass::new(&chains, elements.blocks(), frame).into());
    class.chain = Some(place.unwrap_or_else(made));
    set_count_and_covariates(reductions, tests, frame, class);
}

/// Sets the number of tests and the covariates, in units of the frame.
fn set_count_and_covariates(reductions: &Reductions, tests: &[usize], frame: &Frame, class: &mut Class) {
    class.count = tests.len() as f64;
    class.covariates.clear();
    let units = frame.covariate_centre.iter().zip(&frame.covariate_scale);
    let covariates = reductions.covariates(tests[0]).iter().zip(units);
    class.covariates.extend(covariates.map(|(x, (centre, scale))| (x - centre) / scale));
}

/// Computes the mean of d and g of several tests, and vectors whose outer products add up to the scatter around that
/// mean; g is multiplied by `units`.
fn scatter((reductions, tests): (&Reductions, &[usize]), (offset, units): (&[f64], &[f64]), class: &mut Class) {
    let (rows, mean) = (offset.len(), &mut class.mean);
    let datum = |j: usize, i: usize| {
        let data = reductions.data(j);
        let exact = |at: usize| reductions.exact(j).map_or(0.0, |exact| exact.values[at] * units[at]);
        data.get(i).copied().unwrap_or_else(|| exact(i - data.len()))
    };
    for &j in tests {
        (0..rows).for_each(|i| mean[i] += datum(j, i) - offset[i]);
    }
    mean.iter_mut().for_each(|m| *m /= tests.len() as f64);
    let deviation = |j: usize, i: usize| datum(j, i) - offset[i] - mean[i];
    if tests.len() == 1 {
        return;
    }
    if tests.len() <= rows {
        class.scatter.extend(tests.iter().flat_map(|&j| (0..rows).map(move |i| (j, i))).map(|(j, i)| deviation(j, i)));
        return;
    }
    let (mut sum, mut one) = (DMatrix::zeros(rows, rows), vec![0.0; rows]);
    for &j in tests {
        one.iter_mut().enumerate().for_each(|(i, x)| *x = deviation(j, i));
        for (k, column) in sum.as_mut_slice().chunks_exact_mut(rows.max(1)).enumerate() {
            column.iter_mut().zip(&one).for_each(|(s, a)| *s += a * one[k]);
        }
    }
    class.scatter.extend_from_slice(symmetric::square_root(&sum).as_slice());
}
