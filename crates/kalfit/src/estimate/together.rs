//! What classes say at a point, one after the other; those in phases side by side.

use kalfit_lanes::{Isa, Kernel, Lanes};

use crate::estimate::chained::{Chained, Detail, Packed};
use crate::estimate::classes::Class;
use crate::estimate::terms::{Point, Regressors, Terms};

/// Calls `of` with each class and what it says, in an order that depends on nothing but the classes.
pub(crate) fn each(
    classes: &[&Class],
    regressors: &Regressors,
    point: &Point,
    detail: Detail,
    of: &mut dyn FnMut(usize, &Terms),
) {
    let isa = Isa::best();
    let packed = packed(classes.iter().map(|class| class.chain.as_deref()).enumerate(), isa.lanes());
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
    for (k, class) in classes.iter().enumerate() {
        if class.chain.as_ref().is_none_or(|chain| chain.is_careful()) {
            terms.evaluate(class, regressors, point, detail);
            of(k, &terms);
        }
    }
    for packed in packed {
        isa.run(Tell { packed, classes, regressors, point, detail, terms: &mut terms, of });
    }
}

/// Packs what can be: classes in phases that need no special care, those of one shape together, in their order.
pub(crate) fn packed<'a>(chains: impl Iterator<Item = (usize, Option<&'a Chained>)>, lanes: usize) -> Vec<Packed> {
    let mut waiting: Vec<Vec<(usize, &Chained)>> = Vec::new();
    let mut packed = Vec::new();
    for (number, chain) in chains {
        let Some(chain) = chain.filter(|chain| !chain.is_careful()) else { continue };
        let place = waiting.iter().position(|alike| alike[0].1.is_alike(chain));
        let place = place.unwrap_or_else(|| {
            waiting.push(Vec::new());
            waiting.len() - 1
        });
        waiting[place].push((number, chain));
        if waiting[place].len() == lanes {
            packed.push(Packed::new(&waiting.swap_remove(place), lanes));
        }
    }
    packed.extend(waiting.iter().map(|alike| Packed::new(alike, lanes)));
    packed
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
