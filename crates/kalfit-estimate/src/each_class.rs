//! Evaluation of all classes at a point, one by one or, for packed classes in phases, in lanes.

use std::ops::Range;
use std::sync::Arc;

use kalfit_lanes::{Kernel, Lanes};
use rayon::prelude::*;

use crate::chained::{ChainDetail, Packed, Root};
use crate::class::{Class, ClassRef};
use crate::classes::Classes;
use crate::point::{Point, Regressors};
use crate::terms::ClassTerms;

/// Number of classes that one thread evaluates at a time.
const CLASSES_PER_TASK: usize = 256;

/// Function from the index of a class to the class.
type Numbered<'a, 'c> = &'a (dyn Fn(usize) -> ClassRef<'c> + Sync);

/// Evaluates every class at a point and folds the terms of each class, by `of`, into parts that begin as `start()`. The
/// division into parts does not depend on the number of threads.
pub fn map_classes<T: Send>(
    classes: &Classes,
    regressors: &Regressors,
    point: &Point,
    detail: ChainDetail,
    start: &(dyn Fn() -> T + Sync),
    of: &(dyn Fn(&mut T, usize, ClassRef<'_>, &ClassTerms<'_>) + Sync),
) -> Vec<T> {
    let (isa, class) = (classes.blocks.isa(), &|k: usize| classes.listed.get(k));
    let root = &Root::of(&point.root);
    let parts = map_classes_and_packed(
        classes,
        &|| (start(), ClassTerms::new(point, regressors)),
        &|(folded, terms), k, class| {
            terms.evaluate(class, detail);
            of(folded, k, class, terms);
        },
        &|(folded, terms), packed| {
            let of: &mut dyn FnMut(usize, &ClassTerms<'_>) = &mut |k, terms| of(folded, k, class(k), terms);
            isa.run(PackedTerms { packed, class, regressors, point, root, detail, terms, of });
        },
    );
    parts.into_iter().map(|(folded, _)| folded).collect()
}

/// Folds each unpacked class, with the index of the class, and each pack of classes into parts that begin as `start()`.
/// The division into parts does not depend on the number of threads.
pub(super) fn map_classes_and_packed<T: Send>(
    classes: &Classes,
    start: &(dyn Fn() -> T + Sync),
    fold_class: &(dyn Fn(&mut T, usize, ClassRef<'_>) + Sync),
    fold_pack: &(dyn Fn(&mut T, &Packed) + Sync),
) -> Vec<T> {
    // where some classes are packed, `listed` holds all classes in order
    let packed = !classes.chains.is_empty();
    let alone = if packed { classes.unbatched.clone() } else { (0..classes.len()).collect() };
    let one_by_one = |numbers: &[usize]| {
        let (mut folded, mut buffer) = (start(), Class::default());
        numbers.iter().for_each(|&k| fold_class(&mut folded, k, classes.get(k, &mut buffer)));
        folded
    };
    let packed_blocks = |blocks: &[Arc<Packed>]| {
        let mut folded = start();
        blocks.iter().for_each(|packed| fold_pack(&mut folded, packed));
        folded
    };
    let mut parts: Vec<T> = alone.par_chunks(CLASSES_PER_TASK).map(one_by_one).collect();
    parts.par_extend(classes.chains.par_chunks(CLASSES_PER_TASK / classes.blocks.isa().lanes()).map(packed_blocks));
    parts
}

struct PackedTerms<'a, 'b, 'c> {
    packed: &'b Packed,
    class: Numbered<'b, 'c>,
    regressors: &'a Regressors,
    point: &'a Point,
    root: &'a Root<'a>,
    detail: ChainDetail,
    terms: &'b mut ClassTerms<'a>,
    of: &'b mut dyn FnMut(usize, &ClassTerms<'_>),
}

impl Kernel for PackedTerms<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let PackedTerms { packed, class, regressors, point, root, detail, terms, of } = self;
        let covariates = packed.covariates::<T>(class, regressors.len());
        let mean = packed.means(&covariates, point, regressors);
        let evaluated = packed.evaluated::<T>(&mean, root, detail);
        let ranges: Vec<Range<usize>> = packed.shape().ranges().cloned().collect();
        for (lane, &k) in packed.members().iter().enumerate() {
            match &evaluated {
                Some(evaluated) => terms.take((&ranges, class(k)), evaluated, detail, |x| x.lane(lane)),
                None => terms.evaluate(class(k), detail),
            }
            of(k, terms);
        }
    }
}
