//! What classes say at a point, one after the other; those in phases side by side.

use std::sync::Arc;

use kalfit_lanes::{Isa, Kernel, Lanes};
use rayon::prelude::*;

use crate::estimate::chained::{Chained, Detail, Packed};
use crate::estimate::classes::{Class, Classes};
use crate::estimate::terms::{Point, Regressors, Terms};

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
    let packed = packed(classes.iter().map(|class| class.chain.as_ref()).enumerate(), isa.lanes());
    each_packed(classes, (isa, &packed), regressors, point, detail, of);
}

/// The same of classes those of which that can be are packed already.
pub(crate) fn each_packed(
    classes: &[&Class],
    (isa, packed): (Isa, &[Packed]),
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
    for packed in packed {
        isa.run(Tell { packed, classes, regressors, point, detail, terms: &mut terms, of });
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
    let side_by_side = |blocks: &[Packed]| {
        let (mut made, mut terms) = (start(), Terms::new(point.mean.len()));
        for packed in blocks {
            let of: &mut dyn FnMut(usize, &Terms) = &mut |k, terms| of(&mut made, k, terms);
            isa.run(Tell { packed, classes: &all, regressors, point, detail, terms: &mut terms, of });
        }
        made
    };
    let mut parts: Vec<T> = alone.par_chunks(CHUNK).map(one_by_one).collect();
    parts.par_extend(classes.chains.par_chunks(CHUNK / isa.lanes()).map(side_by_side));
    parts
}

/// Classes that are worked on one by one, by number.
fn alone<'a>(classes: &'a [&Class]) -> impl Iterator<Item = usize> + 'a {
    let is_alone = |class: &Class| class.chain.as_ref().is_none_or(|chain| chain.is_careful());
    (0..classes.len()).filter(move |&k| is_alone(classes[k]))
}

/// Packs what can be: classes in phases that need no special care, those of one shape together, in their order.
pub(crate) fn packed<'a>(chains: impl Iterator<Item = (usize, Option<&'a Arc<Chained>>)>, lanes: usize) -> Vec<Packed> {
    let mut waiting: Vec<Vec<(usize, &Arc<Chained>)>> = Vec::new();
    let mut full = Vec::new();
    for (number, chain) in chains {
        let Some(chain) = chain.filter(|chain| !chain.is_careful()) else { continue };
        let place = waiting.iter().position(|alike| alike[0].1.is_alike(chain));
        let place = place.unwrap_or_else(|| {
            waiting.push(Vec::new());
            waiting.len() - 1
        });
        waiting[place].push((number, chain));
        if waiting[place].len() == lanes {
            full.push(waiting.swap_remove(place));
        }
    }
    full.append(&mut waiting);
    full.par_iter().map(|alike| Packed::new(alike, lanes)).collect()
}

struct Tell<'a, 'b> {
    packed: &'a Packed,
    classes: &'a [&'a Class],
    regressors: &'a Regressors,
    point: &'a Point,
    detail: Detail,
    terms: &'a mut Terms,
    of: &'b mut dyn FnMut(usize, &Terms),
}

impl Kernel for Tell<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let Tell { packed, classes, regressors, point, detail, terms, of } = self;
        let mean = packed.means::<T>(classes, point, regressors);
        let said = packed.unpack::<T>().side_by_side(&mean, &point.root, detail);
        for (lane, &k) in packed.members().iter().enumerate() {
            let class = classes[k];
            match (&said, &class.chain) {
                (Some(said), Some(chain)) => terms.take(chain, class, said, |x| x.lane(lane)),
                _ => terms.evaluate(class, regressors, point, detail),
            }
            of(k, terms);
        }
    }
}
