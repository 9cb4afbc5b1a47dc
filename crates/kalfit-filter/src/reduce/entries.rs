//! Numbers as kernels read them: one for each lane, or the same for all.

use kalfit_lanes::{Lanes, Real};

/// A list of numbers.
pub(crate) trait Entries<R>: Copy {
    /// Number `k`.
    fn entry(self, k: usize) -> R;

    /// All but the first ones.
    fn skip(self, many: usize) -> Self;
}

/// Numbers of the kernel's own kind.
impl<R: Real> Entries<R> for &[R] {
    #[inline(always)]
    fn entry(self, k: usize) -> R {
        self[k]
    }

    #[inline(always)]
    fn skip(self, many: usize) -> Self {
        &self[many..]
    }
}

/// The same in every lane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Common<'a>(pub(crate) &'a [f64]);

impl<R: Real> Entries<R> for Common<'_> {
    #[inline(always)]
    fn entry(self, k: usize) -> R {
        R::splat(self.0[k])
    }

    #[inline(always)]
    fn skip(self, many: usize) -> Self {
        Common(&self.0[many..])
    }
}

/// Each lane's own: a number of one test beside the same of the others.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SideBySide<'a>(pub(crate) &'a [f64]);

impl<T: Lanes> Entries<T> for SideBySide<'_> {
    #[inline(always)]
    fn entry(self, k: usize) -> T {
        T::load(&self.0[k * T::COUNT..][..T::COUNT])
    }

    #[inline(always)]
    fn skip(self, many: usize) -> Self {
        SideBySide(&self.0[many * T::COUNT..])
    }
}
