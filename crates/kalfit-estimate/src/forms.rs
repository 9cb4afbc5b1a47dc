//! Quadratic forms u'Wu of the classes; in lanes, W itself is never assembled.
#![expect(non_snake_case, reason = "W is the letter of the theory")]

use std::ops::Range;

use kalfit_lanes::{Kernel, Lanes};
use nalgebra::DMatrix;

use crate::chained::{ChainDetail, ChainTerms, Packed, Root};
use crate::class::ClassRef;
use crate::classes::Classes;
use crate::each_class::map_classes_and_packed;
use crate::listed::Listed;
use crate::point::{Point, Regressors};
use crate::terms::ClassTerms;
use kalfit_algebra::parts::{ColumnWork, by_column_blocks};
use kalfit_algebra::rows::Rows;

/// Folds u'Wu of each class, for every column u of `directions`, by `of` into parts that begin as `start()`, like
/// `map_classes`.
pub fn map_forms<T: Send>(
    classes: &Classes,
    (regressors, point): (&Regressors, &Point),
    directions: &DMatrix<f64>,
    start: &(dyn Fn() -> T + Sync),
    of: &(dyn Fn(&mut T, usize, &[f64]) + Sync),
) -> Vec<T> {
    let isa = classes.blocks.isa();
    let p = point.mean.len();
    let one = |(terms, forms): (&mut ClassTerms<'_>, &mut Vec<f64>), class: ClassRef<'_>| {
        terms.evaluate(class, ChainDetail::Between);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let form = |u: &[f64]| terms.W.chunks_exact(p).zip(u).map(|(row, own)| own * dot(row, u)).sum::<f64>();
        forms.clear();
        forms.extend(directions.as_slice().chunks_exact(p.max(1)).map(form));
    };
    let root = &Root::of(&point.root);
    let parts = map_classes_and_packed(
        classes,
        &|| (start(), ClassTerms::new(point, regressors), Vec::new()),
        &|(folded, terms, forms), k, class| {
            one((terms, forms), class);
            of(folded, k, forms);
        },
        &|(folded, terms, forms), packed| {
            let found = isa.run(Forms { packed, classes: &classes.listed, regressors, point, root, directions });
            for (lane, &k) in packed.members().iter().enumerate() {
                match &found {
                    Some(found) => of(folded, k, &found[lane * directions.ncols()..][..directions.ncols()]),
                    None => {
                        one((terms, forms), classes.listed.get(k));
                        of(folded, k, forms);
                    }
                }
            }
        },
    );
    parts.into_iter().map(|(folded, ..)| folded).collect()
}

/// u'Wu of packed classes for every column u, class after class.
struct Forms<'a> {
    packed: &'a Packed,
    classes: &'a Listed,
    regressors: &'a Regressors,
    point: &'a Point,
    root: &'a Root<'a>,
    directions: &'a DMatrix<f64>,
}

impl Kernel for Forms<'_> {
    type Output = Option<Vec<f64>>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Option<Vec<f64>> {
        let covariates = self.packed.covariates::<T>(|k| self.classes.get(k), self.regressors.len());
        let mean = self.packed.means(&covariates, self.point, self.regressors);
        let evaluated = self.packed.evaluated::<T>(&mean, self.root, ChainDetail::Between)?;
        let columns = self.directions.ncols();
        let mut forms = vec![T::splat(0.0); columns];
        let ranges: Vec<&Range<usize>> = self.packed.shape().ranges().collect();
        by_column_blocks(
            0,
            &mut OfDirections {
                evaluated: &evaluated,
                ranges: &ranges,
                directions: self.directions,
                forms: &mut forms,
            },
        );
        let mut found = vec![0.0; columns * T::COUNT];
        for (c, form) in forms.iter().enumerate() {
            for lane in 0..T::COUNT {
                found[lane * columns + c] = form.lane(lane);
            }
        }
        Some(found)
    }
}

/// The part of the kernel `Forms` that evaluates N directions at a time.
struct OfDirections<'a, T> {
    evaluated: &'a ChainTerms<T>,
    ranges: &'a [&'a Range<usize>],
    directions: &'a DMatrix<f64>,
    forms: &'a mut [T],
}

impl<T: Lanes> ColumnWork for OfDirections<'_, T> {
    #[inline(always)]
    fn count(&self) -> usize {
        self.forms.len()
    }

    #[inline(always)]
    fn part<const N: usize>(&mut self, from: usize) {
        let zero = T::splat(0.0);
        let mut sums = [zero; N];
        let mut blocks = self.evaluated.W.iter();
        for (k, one) in self.ranges.iter().enumerate() {
            let (before, own) = blocks.as_slice().split_at(k);
            blocks.nth(k);
            for a in 0..one.len() {
                // W is symmetric: blocks between phases count twice
                let (mut twice, mut once) = ([zero; N], [zero; N]);
                for (W, other) in before.iter().zip(self.ranges) {
                    self.row::<N>(W.as_ref(), (a, other.start), from, &mut twice);
                }
                self.row::<N>(own[0].as_ref(), (a, one.start), from, &mut once);
                for c in 0..N {
                    let own = T::splat(self.directions[(one.start + a, from + c)]);
                    sums[c] = own.fma(twice[c] + twice[c] + once[c], sums[c]);
                }
            }
        }
        self.forms[from..from + N].copy_from_slice(&sums);
    }
}

impl<T: Lanes> OfDirections<'_, T> {
    /// Adds row a of a block of W times the entries of N directions at the block's columns, which begin at `start`.
    #[inline(always)]
    fn row<const N: usize>(&self, W: Option<&Rows<T>>, (a, start): (usize, usize), from: usize, sums: &mut [T; N]) {
        let Some(W) = W else { return };
        for (b, &w) in W.row(a).iter().enumerate() {
            for c in 0..N {
                sums[c] = w.fma(T::splat(self.directions[(start + b, from + c)]), sums[c]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map_classes;
    use kalfit_filter::reduce::Reductions;
    use kalfit_model::Path;
    use kalfit_model::Reduction;
    use kalfit_model::{Chain, ChainPhase, Link};
    use nalgebra::DVector;

    fn wave(seed: usize, at: usize) -> f64 {
        ((7 * seed + 3 * at) as f64).sin()
    }

    fn packed(size: usize, seed: usize) -> Vec<f64> {
        let entry = |i: usize, k: usize| if i == k { 1.5 + wave(seed, 9 * k) } else { wave(seed, 9 * k + i) };
        (0..size).flat_map(|k| (0..=k).map(move |i| entry(i, k))).collect()
    }

    /// A test with phases of two states each; every second test lacks the last phase, and one needs square-root
    /// arithmetic.
    fn test(number: usize) -> Reduction {
        let phase = |at: usize| {
            let seed = 10 * number + at;
            let link = Link {
                mean: DVector::from_fn(2, |i, _| wave(seed, i)),
                sensitivity: DMatrix::from_fn(2, 2, |i, k| wave(seed, 20 + 2 * i + k)),
                root: DMatrix::from_fn(2, 1, |i, _| 0.3 * wave(seed, 30 + i)),
            };
            ChainPhase {
                own: 2,
                constant: 0.0,
                data: vec![wave(seed, 40), wave(seed, 41)],
                factor: packed(2, seed),
                path: if number == 5 { Path::SquareRoot } else { Path::Information },
                link: (at > 0).then_some(link),
            }
        };
        let chain = Chain { phases: (0..3 - number % 2).map(phase).collect() };
        Reduction {
            test: format!("t{number}"),
            constant: 0.0,
            residual: None,
            data: (0..6).map(|i| wave(number, i)).collect(),
            factor: packed(6, 100 + number),
            covariates: vec![],
            steps: 1,
            observations: 1,
            path: Path::Information,
            design: number as u128,
            chain: Some(Box::new(chain)),
            exact: None,
        }
    }

    #[test]
    fn forms_are_those_of_the_matrices() {
        let reductions: Reductions = (0..23).map(test).collect();
        let classes = Classes::new(&reductions, vec![0..2, 2..4, 4..6], &[], true);
        assert!(!classes.chains.is_empty(), "some stand side by side");
        let point = Point {
            mean: (0..6).map(|i| 0.1 * i as f64).collect(),
            coefficients: vec![],
            root: DMatrix::from_fn(6, 6, |i, k| if i >= k { wave(3, 6 * i + k) } else { 0.0 }),
        };
        let regressors: &Regressors = &[];
        let directions = DMatrix::from_fn(6, 5, |i, k| wave(8, 5 * i + k));
        let none = || Vec::new();
        let found = map_forms(&classes, (regressors, &point), &directions, &none, &|all, k, forms| {
            all.push((k, forms.to_vec()));
        });
        let expected = map_classes(&classes, regressors, &point, ChainDetail::Between, &none, &|all, k, _, terms| {
            let W = DMatrix::from_column_slice(6, 6, &terms.W);
            let form = |u: nalgebra::DVectorView<'_, f64>| (u.transpose() * &W * u)[0];
            all.push((k, directions.column_iter().map(form).collect::<Vec<f64>>()));
        });
        let (found, expected) = (found.concat(), expected.concat());
        assert_eq!(found.len(), classes.len());
        for ((k, found), (other, expected)) in found.iter().zip(&expected) {
            assert_eq!(k, other);
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-12 * (1.0 + expected.abs()), "class {k}: {found} {expected}");
            }
        }
    }
}
