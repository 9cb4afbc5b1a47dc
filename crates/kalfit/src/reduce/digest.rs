//! A 128-bit digest of numbers: SipHash-1-3 with fixed keys (Aumasson, Bernstein 2012), the same on every machine and release.

/// The state of the hash.
#[derive(Debug, Clone)]
pub(crate) struct Digest {
    v: [u64; 4],
    words: u64,
}

impl Digest {
    pub(crate) fn new() -> Digest {
        let (k0, k1) = (0x6b61_6c66_6974_2d31u64, 0x6465_7369_676e_2d31u64);
        let v = [
            k0 ^ 0x736f_6d65_7073_6575,
            k1 ^ 0x646f_7261_6e64_6f6d ^ 0xee,
            k0 ^ 0x6c79_6765_6e65_7261,
            k1 ^ 0x7465_6462_7974_6573,
        ];
        Digest { v, words: 0 }
    }

    #[inline]
    pub(crate) fn word(&mut self, word: u64) {
        self.v[3] ^= word;
        self.round();
        self.v[0] ^= word;
        self.words += 1;
    }

    pub(crate) fn count(&mut self, count: usize) {
        self.word(count as u64);
    }

    pub(crate) fn numbers(&mut self, numbers: &[f64]) {
        self.count(numbers.len());
        for x in numbers {
            self.word(x.to_bits());
        }
    }

    pub(crate) fn wide(&mut self, digest: u128) {
        self.word(digest as u64);
        self.word((digest >> 64) as u64);
    }

    pub(crate) fn finish(mut self) -> u128 {
        let words = self.words;
        self.word(words << 56);
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
