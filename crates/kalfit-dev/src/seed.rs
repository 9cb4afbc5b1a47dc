//! The seed of all that is drawn to measure kalfit: every run draws the same.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

pub(crate) const SEED: u64 = 1980;

/// Random numbers from the seed.
pub(crate) fn random() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(SEED)
}

/// The same for a block of series of n numbers, which has a stream of its own.
pub(crate) fn random_of_block(n: usize, block: usize) -> ChaCha8Rng {
    let mut random = random();
    random.set_stream((n as u64) << 32 | block as u64);
    random
}
