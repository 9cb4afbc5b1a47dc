//! What classes say at a point, one after the other; those in phases side by side.

#![expect(non_snake_case, reason = "W is the letter of the theory")]

use std::ops::Range;
use std::sync::Arc;

use kalfit_lanes::{Isa, Kernel, Lanes};
use nalgebra::{DMatrix, DMatrixView};
use rayon::prelude::*;

use crate::estimate::chained::{Detail, Kept, Packed, Root, Said, grouped};
use crate::estimate::classes::{Class, Classes};
use crate::estimate::terms::{Point, Regressors, Terms};
use crate::linalg::parts::{Columns, in_parts as in_columns};
use crate::linalg::rows::Rows;

/// Classes that one thread takes at a time.
const CHUNK: usize = 256;

/// Calls `of` with each class and what it says, in an order that depends on nothing but the classes.
pub(crate) fn each(
    classes: &[&Class],
    regressors: &Regressors,
    point: &Point,
    detail: Detail,
    of: &mut dyn FnMut(usize, &Terms),
) {
    let isa = Isa::best();
    let shapes = classes.iter().map(|class| class.chain.as_ref().and_then(Kept::shape));
    let groups = grouped(shapes.enumerate(), isa.lanes());
    let chained = |k: usize| classes[k].chain.as_ref().expect("it has a shape").chained();
    let pack = |(shape, numbers)| Arc::new(Packed::new(shape, numbers, isa.lanes(), chained));
    let packed: Vec<Arc<Packed>> = groups.into_iter().map(pack).collect();
    each_packed(classes, (isa, &packed), regressors, point, detail, of);
}

/// The same of classes those of which that can be are packed already.
pub(crate) fn each_packed(
    classes: &[&Class],
    (isa, packed): (Isa, &[Arc<Packed>]),
    regressors: &Regressors,
    point: &Point,
    detail: Detail,
    of: &mut dyn FnMut(usize, &Terms),
) {
    let mut terms = Terms::new(point.mean.len());
    for k in alone(classes) {
        terms.evaluate(classes[k], regressors, point, detail);
        of(k, &terms);
    }
    let root = &Root::of(&point.root);
    for packed in packed {
        isa.run(Tell { packed, classes, regressors, point, root, detail, terms: &mut terms, of });
    }
}

/// What `of` makes of each class and what it says, beginning with `start`: some classes by themselves, whatever thread they are on.
pub(crate) fn in_parts<T: Send>(
    classes: &Classes,
    regressors: &Regressors,
    point: &Point,
    detail: Detail,
    start: &(dyn Fn() -> T + Sync),
    of: &(dyn Fn(&mut T, usize, &Terms) + Sync),
) -> Vec<T> {
    let (isa, all) = (classes.blocks.isa(), classes.classes.iter().collect::<Vec<&Class>>());
    let alone: Vec<usize> = alone(&all).collect();
    let one_by_one = |numbers: &[usize]| {
        let (mut made, mut terms) = (start(), Terms::new(point.mean.len()));
        for &k in numbers {
            terms.evaluate(all[k], regressors, point, detail);
            of(&mut made, k, &terms);
        }
        made
    };
    let root = &Root::of(&point.root);
    let side_by_side = |blocks: &[Arc<Packed>]| {
        let (mut made, mut terms) = (start(), Terms::new(point.mean.len()));
        for packed in blocks {
            let of: &mut dyn FnMut(usize, &Terms) = &mut |k, terms| of(&mut made, k, terms);
            isa.run(Tell { packed, classes: &all, regressors, point, root, detail, terms: &mut terms, of });
        }
        made
    };
    let mut parts: Vec<T> = alone.par_chunks(CHUNK).map(one_by_one).collect();
    parts.par_extend(classes.chains.par_chunks(CHUNK / isa.lanes()).map(side_by_side));
    parts
}

/// What `of` makes of each class and of its W: u'Wu for every column u of `directions`. Some classes by themselves, as [`in_parts`].
pub(crate) fn forms_in_parts<T: Send>(
    classes: &Classes,
    (regressors, point): (&Regressors, &Point),
    directions: &DMatrix<f64>,
    start: &(dyn Fn() -> T + Sync),
    of: &(dyn Fn(&mut T, usize, &[f64]) + Sync),
) -> Vec<T> {
    let (isa, all) = (classes.blocks.isa(), classes.classes.iter().collect::<Vec<&Class>>());
    let (alone, p): (Vec<usize>, usize) = (alone(&all).collect(), point.mean.len());
    let one = |terms: &mut Terms, k: usize| {
        terms.evaluate(all[k], regressors, point, Detail::Between);
        let products = DMatrixView::from_slice(&terms.W, p, p) * directions; // W is symmetric
        directions.column_iter().zip(products.column_iter()).map(|(u, Wu)| u.dot(&Wu)).collect::<Vec<f64>>()
    };
    let one_by_one = |numbers: &[usize]| {
        let (mut made, mut terms) = (start(), Terms::new(p));
        numbers.iter().for_each(|&k| of(&mut made, k, &one(&mut terms, k)));
        made
    };
    let root = &Root::of(&point.root);
    let side_by_side = |blocks: &[Arc<Packed>]| {
        let (mut made, mut terms) = (start(), Terms::new(p));
        for packed in blocks {
            let found = isa.run(Forms { packed, classes: &all, regressors, point, root, directions });
            for (lane, &k) in packed.members().iter().enumerate() {
                match &found {
                    Some(found) => of(&mut made, k, &found[lane * directions.ncols()..][..directions.ncols()]),
                    None => of(&mut made, k, &one(&mut terms, k)),
                }
            }
        }
        made
    };
    let mut parts: Vec<T> = alone.par_chunks(CHUNK).map(one_by_one).collect();
    parts.par_extend(classes.chains.par_chunks(CHUNK / isa.lanes()).map(side_by_side));
    parts
}

/// Classes that are worked on one by one, by number.
fn alone<'a>(classes: &'a [&Class]) -> impl Iterator<Item = usize> + 'a {
    let is_alone = |class: &Class| class.chain.as_ref().is_none_or(Kept::is_careful);
    (0..classes.len()).filter(move |&k| is_alone(classes[k]))
}

struct Tell<'a, 'b> {
    packed: &'a Packed,
    classes: &'a [&'a Class],
    regressors: &'a Regressors,
    point: &'a Point,
    root: &'a Root<'a>,
    detail: Detail,
    terms: &'a mut Terms,
    of: &'b mut dyn FnMut(usize, &Terms),
}

impl Kernel for Tell<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let Tell { packed, classes, regressors, point, root, detail, terms, of } = self;
        let mean = packed.means::<T>(classes, point, regressors);
        let said = packed.said::<T>(&mean, root, detail);
        let ranges: Vec<Range<usize>> = packed.shape().ranges().cloned().collect();
        for (lane, &k) in packed.members().iter().enumerate() {
            let class = classes[k];
            match &said {
                Some(said) => terms.take((&ranges, class), said, detail, |x| x.lane(lane)),
                None => terms.evaluate(class, regressors, point, detail),
            }
            of(k, terms);
        }
    }
}

/// u'Wu of classes side by side, for every column u; one class after the other.
struct Forms<'a> {
    packed: &'a Packed,
    classes: &'a [&'a Class],
    regressors: &'a Regressors,
    point: &'a Point,
    root: &'a Root<'a>,
    directions: &'a DMatrix<f64>,
}

impl Kernel for Forms<'_> {
    type Output = Option<Vec<f64>>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Option<Vec<f64>> {
        let mean = self.packed.means::<T>(self.classes, self.point, self.regressors);
        let said = self.packed.said::<T>(&mean, self.root, Detail::Between)?;
        let columns = self.directions.ncols();
        let mut forms = vec![T::splat(0.0); columns];
        let ranges: Vec<&Range<usize>> = self.packed.shape().ranges().collect();
        in_columns(
            0,
            &mut OfDirections { said: &said, ranges: &ranges, directions: self.directions, forms: &mut forms },
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

/// A few directions at a time.
struct OfDirections<'a, T> {
    said: &'a Said<T>,
    ranges: &'a [&'a Range<usize>],
    directions: &'a DMatrix<f64>,
    forms: &'a mut [T],
}

impl<T: Lanes> Columns for OfDirections<'_, T> {
    #[inline(always)]
    fn count(&self) -> usize {
        self.forms.len()
    }

    #[inline(always)]
    fn part<const N: usize>(&mut self, from: usize) {
        let zero = T::splat(0.0);
        let mut sums = [zero; N];
        let mut blocks = self.said.W.iter();
        for (k, one) in self.ranges.iter().enumerate() {
            let (before, own) = blocks.as_slice().split_at(k);
            blocks.nth(k);
            for a in 0..one.len() {
                // W is symmetric: what lies between phases counts twice
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
    /// Adds row a of a block of W times what some directions have there.
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
