//! Which registers a kernel is run with.
//!
//! # Why the `unsafe` here is sound
//!
//! A function compiled for instructions that the machine lacks must not be called. An [`Isa`] for such instructions can be had only
//! from [`Isa::all`], which asks the machine first, and an [`Alone`] with fused products only from such an [`Isa`], so each call
//! below is of instructions that are there.
//!
//! # Why there are three types
//!
//! A kernel is compiled for each kind of number that it may be run with. Most are run with registers only, or with one number at a
//! time only, and are compiled for no more than that.
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "calls of functions for instructions found at run time")
)]

use std::sync::OnceLock;

use crate::{Four, Lanes};

/// Work that is written once for all kinds of numbers. `run` must be `#[inline(always)]`.
pub trait Kernel {
    /// What it gives.
    type Output;

    /// Does the work with this kind of numbers.
    fn run<T: Lanes>(self) -> Self::Output;
}

/// What is fixed for this process.
static FIXED: OnceLock<Isa> = OnceLock::new();

/// A set of instructions that this machine has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Isa(IsaKind);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum IsaKind {
    Portable,
    #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
    Neon,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Isa {
    /// Four at a time by plain arrays, which a compiler may or may not put into registers.
    pub const PORTABLE: Isa = Isa(IsaKind::Portable);

    /// The best one, or the one that is fixed.
    pub fn best() -> Isa {
        FIXED.get().or(Isa::all().last()).copied().unwrap_or(Isa::PORTABLE)
    }

    /// Makes this the one that [`Isa::best`] gives from now on, so that machines with other instructions give the same bits.
    ///
    /// # Errors
    /// The one that is fixed already, when it is another.
    pub fn fix(self) -> Result<(), Isa> {
        let fixed = *FIXED.get_or_init(|| self);
        if fixed == self { Ok(()) } else { Err(fixed) }
    }

    /// The words for all sets, also those that this machine lacks.
    pub const WORDS: [&'static str; 4] = ["portable", "neon", "avx2", "avx512"];

    /// The one of a word; `None` when this machine does not have it.
    pub fn named(word: &str) -> Option<Isa> {
        Isa::all().iter().copied().find(|isa| isa.word() == word)
    }

    /// One number at a time: to the bit what each lane of this one holds, but for reciprocals that are a rounding or two off.
    pub fn alone(self) -> Alone {
        Alone { fused: self != Isa::PORTABLE }
    }

    /// Its word.
    pub fn word(self) -> &'static str {
        match self.0 {
            IsaKind::Portable => "portable",
            #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
            IsaKind::Neon => "neon",
            #[cfg(target_arch = "x86_64")]
            IsaKind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            IsaKind::Avx512 => "avx512",
        }
    }

    /// All that this machine has, the best one last.
    pub fn all() -> &'static [Isa] {
        static ALL: OnceLock<Vec<Isa>> = OnceLock::new();
        ALL.get_or_init(found)
    }

    /// How many numbers it works on at once.
    pub fn lanes(self) -> usize {
        match self.0 {
            IsaKind::Portable => 4,
            #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
            IsaKind::Neon => 4,
            #[cfg(target_arch = "x86_64")]
            IsaKind::Avx2 => 4,
            #[cfg(target_arch = "x86_64")]
            IsaKind::Avx512 => 8,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self.0 {
            IsaKind::Portable => "four numbers at a time",
            #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
            IsaKind::Neon => "NEON, four numbers at a time",
            #[cfg(target_arch = "x86_64")]
            IsaKind::Avx2 => "AVX2 and FMA, four numbers at a time",
            #[cfg(target_arch = "x86_64")]
            IsaKind::Avx512 => "AVX-512, eight numbers at a time",
        }
    }

    /// Runs a kernel on several numbers side by side.
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            IsaKind::Portable => kernel.run::<Four>(),
            #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
            IsaKind::Neon => kernel.run::<crate::neon::Neon>(),
            // SAFETY: `found` made this value, so the machine has AVX2 and FMA.
            #[cfg(target_arch = "x86_64")]
            IsaKind::Avx2 => unsafe { in_avx2::<K, crate::avx2::Avx2>(kernel) },
            // SAFETY: `found` made this value, so the machine has AVX-512F, AVX2 and FMA.
            #[cfg(target_arch = "x86_64")]
            IsaKind::Avx512 => unsafe { in_avx512(kernel) },
        }
    }
}

/// One number at a time, with fused products or without.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Alone {
    fused: bool,
}

impl Alone {
    /// Runs a kernel on one number at a time.
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.fused {
            #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
            true => kernel.run::<crate::fused::Fused>(),
            // SAFETY: `Isa::alone` made this value of an `Isa` that `found` made, and each but the portable one has AVX2 and FMA.
            #[cfg(target_arch = "x86_64")]
            true => unsafe { in_avx2::<K, crate::fused::Fused>(kernel) },
            _ => kernel.run::<f64>(),
        }
    }
}

/// Several numbers side by side or one at a time, where only the work at hand tells which.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// As many as registers hold.
    Lanes(Isa),
    /// One.
    One(Alone),
}

impl Width {
    /// How many numbers are worked on at once.
    pub fn lanes(self) -> usize {
        match self {
            Width::Lanes(isa) => isa.lanes(),
            Width::One(_) => 1,
        }
    }

    /// Runs a kernel.
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self {
            Width::Lanes(isa) => isa.run(kernel),
            Width::One(alone) => alone.run(kernel),
        }
    }
}

impl From<Isa> for Width {
    fn from(isa: Isa) -> Width {
        Width::Lanes(isa)
    }
}

impl From<Alone> for Width {
    fn from(alone: Alone) -> Width {
        Width::One(alone)
    }
}

#[cfg(target_arch = "x86_64")]
fn found() -> Vec<Isa> {
    let avx2 = std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma");
    let avx512 = avx2 && std::is_x86_feature_detected!("avx512f");
    let some = [(true, IsaKind::Portable), (avx2, IsaKind::Avx2), (avx512, IsaKind::Avx512)];
    some.into_iter().filter(|(has, _)| *has).map(|(_, kind)| Isa(kind)).collect()
}

#[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
fn found() -> Vec<Isa> {
    vec![Isa::PORTABLE, Isa(IsaKind::Neon)]
}

#[cfg(not(any(target_arch = "x86_64", all(target_arch = "aarch64", target_feature = "neon"))))]
fn found() -> Vec<Isa> {
    vec![Isa::PORTABLE]
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn in_avx2<K: Kernel, T: Lanes>(kernel: K) -> K::Output {
    kernel.run::<T>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx2,fma")]
fn in_avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<crate::avx512::Avx512>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_those_of_the_sets() {
        for isa in Isa::all() {
            assert!(Isa::WORDS.contains(&isa.word()));
            assert_eq!(Isa::named(isa.word()), Some(*isa));
        }
        assert_eq!(Isa::named("sse"), None);
    }
}
