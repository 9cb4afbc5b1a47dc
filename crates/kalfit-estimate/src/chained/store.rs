//! Storage of a class in phases: by itself, or in one lane of several.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use crate::chained::{ChainShape, ChainedClass, Packed};

/// A class in phases.
#[derive(Debug, Clone)]
pub enum ChainStore {
    /// The class is stored by itself.
    Single(Arc<ChainedClass>),
    /// The class is in this lane of a pack.
    Lane(Arc<Packed>, usize),
}

impl ChainStore {
    /// The class, unpacked if it is in a lane.
    pub fn chained(&self) -> Cow<'_, ChainedClass> {
        match self {
            ChainStore::Single(chained) => Cow::Borrowed(chained),
            ChainStore::Lane(packed, lane) => Cow::Owned(packed.chained(*lane)),
        }
    }

    /// The sizes of the class's matrices.
    fn sizes(&self) -> &ChainShape {
        match self {
            ChainStore::Single(chained) => &chained.shape,
            ChainStore::Lane(packed, _) => packed.shape(),
        }
    }

    /// Shape of the class; `None` where the class needs square-root arithmetic, and so cannot be packed.
    pub(crate) fn shape(&self) -> Option<Cow<'_, ChainShape>> {
        (!self.is_by_rotations()).then(|| Cow::Borrowed(self.sizes()))
    }

    /// Whether the class needs square-root arithmetic.
    pub(crate) fn is_by_rotations(&self) -> bool {
        matches!(self, ChainStore::Single(chained) if chained.needs_rotations)
    }

    /// Number of coordinates that enter each phase of the class's tests.
    pub fn entering(&self) -> Vec<usize> {
        self.sizes().phases.iter().map(|phase| phase.size).collect()
    }

    /// For each phase the range of the new states, as indices into the states of all phases.
    pub(crate) fn ranges(&self) -> Vec<Range<usize>> {
        self.sizes().ranges().cloned().collect()
    }
}

/// Groups the indices of classes by shape, in the order of `shapes`, at most `lanes` indices in a group; classes
/// without a shape are omitted.
pub(crate) fn grouped<'a>(
    shapes: impl Iterator<Item = (usize, Option<Cow<'a, ChainShape>>)>,
    lanes: usize,
) -> Vec<(Arc<ChainShape>, Vec<usize>)> {
    let mut open_groups: Vec<(Arc<ChainShape>, Vec<usize>)> = Vec::new();
    let mut full = Vec::new();
    for (number, shape) in shapes {
        let Some(shape) = shape else { continue };
        let place = open_groups.iter().position(|(shared_shape, _)| **shared_shape == *shape);
        let place = place.unwrap_or_else(|| {
            open_groups.push((Arc::new(shape.into_owned()), Vec::new()));
            open_groups.len() - 1
        });
        let (shared_shape, numbers) = &mut open_groups[place];
        numbers.push(number);
        if numbers.len() == lanes {
            full.push((shared_shape.clone(), std::mem::take(numbers)));
        }
    }
    full.extend(open_groups.into_iter().filter(|(_, numbers)| !numbers.is_empty()));
    full
}
