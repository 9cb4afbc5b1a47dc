//! Where what a class in phases says is kept.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use crate::chained::{ChainShape, ChainedClass, Packed};

/// A class in phases.
#[derive(Debug, Clone)]
pub enum ChainStore {
    /// By itself.
    Apart(Arc<ChainedClass>),
    /// In one lane of several.
    Lane(Arc<Packed>, usize),
}

impl ChainStore {
    /// The class.
    pub fn chained(&self) -> Cow<'_, ChainedClass> {
        match self {
            ChainStore::Apart(chained) => Cow::Borrowed(chained),
            ChainStore::Lane(packed, lane) => Cow::Owned(packed.chained(*lane)),
        }
    }

    /// The sizes of its matrices.
    fn sizes(&self) -> &ChainShape {
        match self {
            ChainStore::Apart(chained) => &chained.shape,
            ChainStore::Lane(packed, _) => packed.shape(),
        }
    }

    /// Its shape; `None` where it needs square-root arithmetic, and so to be worked on by itself.
    pub(crate) fn shape(&self) -> Option<Cow<'_, ChainShape>> {
        (!self.is_careful()).then(|| Cow::Borrowed(self.sizes()))
    }

    /// Needs square-root arithmetic.
    pub(crate) fn is_careful(&self) -> bool {
        matches!(self, ChainStore::Apart(chained) if chained.careful)
    }

    /// How many coordinates enter each phase that its tests have.
    pub fn entering(&self) -> Vec<usize> {
        self.sizes().phases.iter().map(|phase| phase.size).collect()
    }

    /// Where the states of its phases stand.
    pub(crate) fn ranges(&self) -> Vec<Range<usize>> {
        self.sizes().ranges().cloned().collect()
    }
}

/// Numbers of classes by shape, as many together as there are lanes, or fewer, in their order; those without a shape are left out.
pub(crate) fn grouped<'a>(
    shapes: impl Iterator<Item = (usize, Option<Cow<'a, ChainShape>>)>,
    lanes: usize,
) -> Vec<(Arc<ChainShape>, Vec<usize>)> {
    let mut waiting: Vec<(Arc<ChainShape>, Vec<usize>)> = Vec::new();
    let mut full = Vec::new();
    for (number, shape) in shapes {
        let Some(shape) = shape else { continue };
        let place = waiting.iter().position(|(alike, _)| **alike == *shape);
        let place = place.unwrap_or_else(|| {
            waiting.push((Arc::new(shape.into_owned()), Vec::new()));
            waiting.len() - 1
        });
        let (alike, numbers) = &mut waiting[place];
        numbers.push(number);
        if numbers.len() == lanes {
            full.push((alike.clone(), std::mem::take(numbers)));
        }
    }
    full.extend(waiting.into_iter().filter(|(_, numbers)| !numbers.is_empty()));
    full
}
