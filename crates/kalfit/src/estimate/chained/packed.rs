//! Classes in phases of one shape, side by side.

use std::sync::Arc;

use kalfit_lanes::Lanes;

use crate::estimate::chained::{Chained, Link, Phase};
use crate::estimate::classes::Class;
use crate::estimate::terms::{Point, Regressors};
use crate::linalg::rows::Rows;

/// As many classes of one shape as there are lanes, or fewer: lanes that no class takes have a class without tests.
#[derive(Debug, Clone)]
pub(crate) struct Packed {
    members: Vec<usize>,
    /// One of them, for the shape.
    like: Arc<Chained>,
    lanes: usize,
    /// n of each, then all their numbers, entry by entry.
    numbers: Vec<f64>,
}

impl Packed {
    /// Of classes and their numbers, at least one and at most as many as there are lanes.
    pub(crate) fn new(members: &[(usize, &Arc<Chained>)], lanes: usize) -> Packed {
        let like = members[0].1;
        let size = 1 + like.matrices().map(|(matrix, _)| matrix.as_slice().len()).sum::<usize>();
        let mut numbers = vec![0.0; size * lanes];
        for lane in 0..lanes {
            let own = members.get(lane).map(|(_, chained)| *chained);
            let (first, mut rest) = numbers.split_at_mut(lanes);
            first[lane] = own.map_or(0.0, |chained| chained.count);
            for (matrix, design) in own.unwrap_or(like).matrices() {
                let (to, after) = rest.split_at_mut(matrix.as_slice().len() * lanes);
                if design || own.is_some() {
                    to.chunks_exact_mut(lanes).zip(matrix.as_slice()).for_each(|(to, x)| to[lane] = *x);
                }
                rest = after;
            }
        }
        Packed { members: members.iter().map(|(number, _)| *number).collect(), like: like.clone(), lanes, numbers }
    }

    /// Numbers of its classes.
    pub(crate) fn members(&self) -> &[usize] {
        &self.members
    }

    /// The classes in lanes.
    #[inline(always)]
    pub(crate) fn unpack<T: Lanes>(&self) -> Chained<T> {
        debug_assert_eq!(T::COUNT, self.lanes, "packed for others");
        let mut from = T::COUNT;
        let mut phases = Vec::with_capacity(self.like.phases.len());
        for phase in &self.like.phases {
            let factor = self.next(&phase.factor, &mut from);
            let data = self.next(&phase.data, &mut from);
            let mut link = None;
            if let Some(like) = &phase.link {
                let sensitivity = self.next(&like.sensitivity, &mut from);
                link = Some(Link { sensitivity, root: self.next(&like.root, &mut from) });
            }
            phases.push(Phase { own: phase.own.clone(), factor, data, link });
        }
        Chained { phases, columns: self.like.columns, count: T::load(&self.numbers), careful: false }
    }

    #[inline(always)]
    fn next<T: Lanes>(&self, like: &Rows, from: &mut usize) -> Rows<T> {
        let size = like.nrows() * like.ncols();
        let mut data = Vec::with_capacity(size);
        for x in self.numbers[*from..][..size * T::COUNT].chunks_exact(T::COUNT) {
            data.push(T::load(x));
        }
        *from += size * T::COUNT;
        Rows::from_vec(like.nrows(), like.ncols(), data)
    }

    /// μ of the tests of each class.
    #[inline(always)]
    pub(crate) fn means<T: Lanes>(
        &self,
        classes: &[impl std::borrow::Borrow<Class>],
        point: &Point,
        regressors: &Regressors,
    ) -> Vec<T> {
        let mut mean = Vec::with_capacity(point.mean.len());
        for x in &point.mean {
            mean.push(T::splat(*x));
        }
        for (c, &element) in regressors.iter().enumerate() {
            let mut moved = [0.0; kalfit_lanes::MOST];
            for (to, &member) in moved.iter_mut().zip(&self.members) {
                *to = classes[member].borrow().covariates[c] * point.coefficients[c];
            }
            mean[element] = mean[element] + T::load(&moved);
        }
        mean
    }
}
