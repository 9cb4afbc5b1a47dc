//! What classes say at a point, one after the other; those in phases, four of one shape at a time.

use crate::estimate::chained::{Chained, Detail};
use crate::estimate::classes::Class;
use crate::estimate::terms::{Point, Regressors, Terms};

/// Calls `of` with each class and what it says, in an order that depends on nothing but the classes.
pub(crate) fn each(
    classes: &[Class],
    regressors: &Regressors,
    point: &Point,
    detail: Detail,
    of: &mut dyn FnMut(usize, &Terms),
) {
    let mut terms = Terms::new(point.mean.len());
    let mut waiting: Vec<usize> = Vec::new();
    for (k, class) in classes.iter().enumerate() {
        if class.chain.is_some() {
            waiting.push(k);
        } else {
            terms.evaluate(class, regressors, point, detail);
            of(k, &terms);
        }
    }
    let chain = |k: usize| classes[k].chain.as_deref().expect("only such wait");
    while let Some(&first) = waiting.first() {
        let (alike, others): (Vec<usize>, Vec<usize>) =
            waiting.into_iter().partition(|&k| chain(k).is_alike(chain(first)));
        waiting = others;
        for group in alike.chunks(4) {
            four(classes, group, (regressors, point), detail, &mut terms, of);
        }
    }
}

/// Up to four classes of one shape.
fn four(
    classes: &[Class],
    group: &[usize],
    (regressors, point): (&Regressors, &Point),
    detail: Detail,
    terms: &mut Terms,
    of: &mut dyn FnMut(usize, &Terms),
) {
    let class = |lane: usize| &classes[group[lane.min(group.len() - 1)]];
    let lanes = [0, 1, 2, 3].map(class);
    let means = lanes.map(|class| point.mean_of(class, regressors));
    let chains = lanes.map(|class| class.chain.as_deref().expect("only such are given"));
    let together = match group.len() {
        1 => None,
        _ => Chained::at_four(chains, means.each_ref().map(Vec::as_slice), &point.root, detail),
    };
    for (lane, &k) in group.iter().enumerate() {
        match &together {
            Some(said) => terms.take(chains[lane], &classes[k], said, |four| four.0[lane]),
            None => terms.evaluate(&classes[k], regressors, point, detail),
        }
        of(k, terms);
    }
}
