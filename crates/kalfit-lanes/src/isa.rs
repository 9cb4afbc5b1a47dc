//! Choice of the registers that a kernel runs with.
//!
//! # Why the `unsafe` here is sound
//!
//! A function compiled for instructions that the machine lacks must not be called. Only [`Isa::all`] makes an [`Isa`]
//! other than the portable one, after a check of the machine, and only an [`Isa`] other than the portable one makes an
//! [`Alone`] with fused products. So each call below uses instructions that the machine has.
//!
//! # Why there are three types
//!
//! A kernel is compiled for each kind of number that it may run with. Most kernels run only in lanes ([`Isa`]) or only
//! on one number at a time ([`Alone`]), and are compiled for one of the two; a kernel that runs with a [`Width`] is
//! compiled for both.
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "calls of functions for instructions found at run time")
)]

use std::sync::OnceLock;

use crate::{Four, Lanes};

/// Work that is written once for all kinds of numbers. `run` must be `#[inline(always)]`.
pub trait Kernel {
    /// Result of the work.
    type Output;

    /// Does the work with numbers of type `T`.
    fn run<T: Lanes>(self) -> Self::Output;
}

/// The instruction set fixed for this process by `Isa::fix`.
static FIXED: OnceLock<Isa> = OnceLock::new();

/// The environment variable [`Isa::VARIABLE`] names an instruction set that this machine does not have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownInstructions {
    /// Value of the variable.
    pub word: String,
}

impl std::error::Error for UnknownInstructions {}

impl std::fmt::Display for UnknownInstructions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let here: Vec<&str> = Isa::all().iter().map(|isa| isa.word()).collect();
        let here = here.join("`, `");
        write!(f, "{}: found `{}`, expected one of `{here}` on this machine", Isa::VARIABLE, self.word)
    }
}

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
    /// The instruction set of every machine: four numbers at a time in a plain array, which the compiler may or may not
    /// put into registers.
    pub const PORTABLE: Isa = Isa(IsaKind::Portable);

    /// The instruction set of this process: the one fixed by [`Isa::fix`], else the one that the environment variable
    /// [`Isa::VARIABLE`] names, else the widest that the machine has. A variable that names no instruction set of this
    /// machine counts as absent; the beginning of a fit refuses such a variable by [`Isa::chosen`].
    pub fn best() -> Isa {
        static DEFAULT: OnceLock<Isa> = OnceLock::new();
        FIXED.get().copied().unwrap_or_else(|| *DEFAULT.get_or_init(|| Isa::chosen().unwrap_or_else(|_| Isa::widest())))
    }

    /// The environment variable that names the instruction set of a process, by one of [`Isa::WORDS`].
    pub const VARIABLE: &'static str = "KALFIT_INSTRUCTIONS";

    /// The instruction set of [`Isa::best`].
    ///
    /// # Errors
    /// The environment variable [`Isa::VARIABLE`] names an instruction set that this machine does not have.
    pub fn chosen() -> Result<Isa, UnknownInstructions> {
        if let Some(fixed) = FIXED.get() {
            return Ok(*fixed);
        }
        match std::env::var(Isa::VARIABLE) {
            Ok(word) if !word.is_empty() => Isa::named(&word).ok_or(UnknownInstructions { word }),
            _ => Ok(Isa::widest()),
        }
    }

    fn widest() -> Isa {
        Isa::all().last().copied().unwrap_or(Isa::PORTABLE)
    }

    /// Makes [`Isa::best`] return this instruction set from now on, so that different machines give the same bits.
    ///
    /// # Errors
    /// The error is the instruction set fixed before, where that differs from this one.
    pub fn fix(self) -> Result<(), Isa> {
        let fixed = *FIXED.get_or_init(|| self);
        if fixed == self { Ok(()) } else { Err(fixed) }
    }

    /// The words of all instruction sets, including instruction sets that this machine lacks.
    pub const WORDS: [&'static str; 4] = ["portable", "neon", "avx2", "avx512"];

    /// The instruction set whose [`Isa::word`] is `word`; `None` if this machine has no such instruction set.
    pub fn named(word: &str) -> Option<Isa> {
        Isa::all().iter().copied().find(|isa| isa.word() == word)
    }

    /// Arithmetic on one number at a time. Results have the same bits as in a lane of this instruction set, except that
    /// reciprocals may differ by a rounding or two.
    pub fn alone(self) -> Alone {
        Alone { fused: self != Isa::PORTABLE }
    }

    /// The word for this instruction set, one of [`Isa::WORDS`].
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

    /// All instruction sets that this machine has, the widest one last.
    pub fn all() -> &'static [Isa] {
        static ALL: OnceLock<Vec<Isa>> = OnceLock::new();
        ALL.get_or_init(detected)
    }

    /// Number of lanes: how many numbers are worked on at once.
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

    /// Name of the instruction set, with the number of lanes in words.
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

    /// Runs a kernel on several numbers in lanes.
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            IsaKind::Portable => kernel.run::<Four>(),
            #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
            IsaKind::Neon => kernel.run::<crate::neon::Neon>(),
            // SAFETY: `detected` made this value, so the machine has AVX2 and FMA.
            #[cfg(target_arch = "x86_64")]
            IsaKind::Avx2 => unsafe { in_avx2::<K, crate::avx2::Avx2>(kernel) },
            // SAFETY: `detected` made this value, so the machine has AVX-512F, AVX2 and FMA.
            #[cfg(target_arch = "x86_64")]
            IsaKind::Avx512 => unsafe { in_avx512(kernel) },
        }
    }
}

/// Arithmetic on one number at a time, with fused products or without.
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
            // SAFETY: `Isa::alone` made this value from an `Isa` that `detected` made; every such `Isa` but the
            // portable one has AVX2 and FMA.
            #[cfg(target_arch = "x86_64")]
            true => unsafe { in_avx2::<K, crate::fused::Fused>(kernel) },
            _ => kernel.run::<f64>(),
        }
    }
}

/// Arithmetic in lanes or on one number at a time, for work of which only the size decides between the two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// As many numbers as the registers hold.
    Lanes(Isa),
    /// One number at a time.
    One(Alone),
}

impl Width {
    /// Number of lanes: how many numbers are worked on at once.
    pub fn lanes(self) -> usize {
        match self {
            Width::Lanes(isa) => isa.lanes(),
            Width::One(_) => 1,
        }
    }

    /// Runs a kernel with this width.
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
fn detected() -> Vec<Isa> {
    let avx2 = std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma");
    let avx512 = avx2 && std::is_x86_feature_detected!("avx512f");
    let candidates = [(true, IsaKind::Portable), (avx2, IsaKind::Avx2), (avx512, IsaKind::Avx512)];
    candidates.into_iter().filter(|(has, _)| *has).map(|(_, kind)| Isa(kind)).collect()
}

#[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
fn detected() -> Vec<Isa> {
    vec![Isa::PORTABLE, Isa(IsaKind::Neon)]
}

#[cfg(not(any(target_arch = "x86_64", all(target_arch = "aarch64", target_feature = "neon"))))]
fn detected() -> Vec<Isa> {
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
