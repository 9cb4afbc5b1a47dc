//! A 128-bit digest of numbers, identical on every machine and release: four hash states take the words in turn and
//! mix each word in two ways; the final states go through SipHash-1-3 with fixed keys (Aumasson, Bernstein 2012).

/// Number of hash states, which take words in turn.
const STATES: usize = 4;

/// The state of a digest.
#[derive(Debug, Clone)]
pub(crate) struct Digest {
    states: [HashState; STATES],
    words: u64,
}

/// A hash state that mixes words in two ways: by 128-bit products, and by an invertible step, so that no word is ever
/// lost.
#[derive(Debug, Clone, Copy)]
struct HashState {
    wide: u64,
    whole: u64,
}

impl HashState {
    #[inline(always)]
    fn take(&mut self, word: u64) {
        let product = u128::from(self.wide ^ word) * 0x9e37_79b9_7f4a_7c15;
        self.wide = product as u64 ^ (product >> 64) as u64;
        self.whole = (self.whole ^ word).wrapping_mul(0xd6e8_feb8_6659_fd93).rotate_left(29);
    }
}

impl Digest {
    pub(crate) fn new() -> Digest {
        let state = |k: u64| HashState { wide: 0x6b61_6c66_6974_2d31 ^ k, whole: 0x6465_7369_676e_2d31 ^ k };
        Digest { states: [state(0), state(1), state(2), state(3)], words: 0 }
    }

    #[inline]
    pub(crate) fn word(&mut self, word: u64) {
        self.states[self.words as usize % STATES].take(word);
        self.words += 1;
    }

    pub(crate) fn count(&mut self, count: usize) {
        self.word(count as u64);
    }

    pub(crate) fn numbers(&mut self, numbers: &[f64]) {
        self.all(numbers, |x| x.to_bits());
    }

    pub(crate) fn words(&mut self, words: &[u64]) {
        self.all(words, |word| *word);
    }

    /// Takes the number of items, then a word for each item, the first word always in the first hash state.
    #[inline(always)]
    fn all<T>(&mut self, all: &[T], word: impl Fn(&T) -> u64) {
        self.count(all.len());
        let mut states = self.states;
        let fours = all.chunks_exact(STATES);
        let rest = fours.remainder();
        for four in fours {
            states.iter_mut().zip(four).for_each(|(state, x)| state.take(word(x)));
        }
        states.iter_mut().zip(rest).for_each(|(state, x)| state.take(word(x)));
        self.states = states;
        self.words += all.len() as u64;
    }

    pub(crate) fn wide(&mut self, digest: u128) {
        self.word(digest as u64);
        self.word((digest >> 64) as u64);
    }

    pub(crate) fn finish(self) -> u128 {
        let mut sip = Sip::new();
        self.states.iter().flat_map(|state| [state.wide, state.whole]).for_each(|word| sip.word(word));
        sip.finish(self.words)
    }
}

/// SipHash-1-3.
#[derive(Debug)]
struct Sip {
    v: [u64; 4],
}

impl Sip {
    fn new() -> Sip {
        let (k0, k1) = (0x6b61_6c66_6974_2d31u64, 0x6465_7369_676e_2d31u64);
        let v = [
            k0 ^ 0x736f_6d65_7073_6575,
            k1 ^ 0x646f_7261_6e64_6f6d ^ 0xee,
            k0 ^ 0x6c79_6765_6e65_7261,
            k1 ^ 0x7465_6462_7974_6573,
        ];
        Sip { v }
    }

    fn word(&mut self, word: u64) {
        self.v[3] ^= word;
        self.round();
        self.v[0] ^= word;
    }

    fn finish(mut self, words: u64) -> u128 {
        self.word(words);
        self.v[2] ^= 0xee;
        let low = self.squeeze();
        self.v[1] ^= 0xdd;
        let high = self.squeeze();
        (u128::from(high) << 64) | u128::from(low)
    }

    fn squeeze(&mut self) -> u64 {
        for _ in 0..3 {
            self.round();
        }
        self.v[0] ^ self.v[1] ^ self.v[2] ^ self.v[3]
    }

    #[inline(always)]
    fn round(&mut self) {
        let [a, b, c, d] = &mut self.v;
        *a = a.wrapping_add(*b);
        *b = b.rotate_left(13) ^ *a;
        *a = a.rotate_left(32);
        *c = c.wrapping_add(*d);
        *d = d.rotate_left(16) ^ *c;
        *a = a.wrapping_add(*d);
        *d = d.rotate_left(21) ^ *a;
        *c = c.wrapping_add(*b);
        *b = b.rotate_left(17) ^ *c;
        *c = c.rotate_left(32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_and_the_length_matter() {
        let digest = |words: &[u64]| {
            let mut digest = Digest::new();
            words.iter().for_each(|&word| digest.word(word));
            digest.finish()
        };
        let mut seen = std::collections::BTreeSet::from([digest(&[]), digest(&[0]), digest(&[0, 0])]);
        for bit in 0..64 {
            seen.insert(digest(&[1 << bit, 0]));
            seen.insert(digest(&[0, 1 << bit]));
        }
        assert_eq!(seen.len(), 131);
        assert!((digest(&[1]) ^ digest(&[0])).count_ones() > 40);
    }
}
