//! Results that threads share: each is computed once, however many threads request it at the same time.

use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// A store of values by key, bounded in bytes. A full store adds no entries; returned values do not depend on how full
/// the store is.
#[derive(Debug)]
pub(crate) struct SharedStore<K, V> {
    shards: Vec<Mutex<StoreShard<K, V>>>,
    bytes: AtomicUsize,
    limit: usize,
    /// Bytes beyond which only keys that are requested a second time are stored.
    first_use_bytes: usize,
}

#[derive(Debug)]
struct StoreShard<K, V> {
    entries: HashMap<u128, Arc<StoreEntry<K, V>>, DigestHasher>,
    /// Upper halves of digests that were requested once.
    requested: HashSet<u64, DigestHasher>,
    /// Upper halves of digests that were passed to [`SharedStore::is_new`].
    seen: HashSet<u64, DigestHasher>,
}

impl<K, V> Default for StoreShard<K, V> {
    fn default() -> StoreShard<K, V> {
        StoreShard { entries: HashMap::default(), requested: HashSet::default(), seen: HashSet::default() }
    }
}

/// A hasher for digests, which are mixed already.
type DigestHasher = BuildHasherDefault<UpperHalf>;

/// The upper half of a digest: the lower half selects the shard.
#[derive(Debug, Default)]
struct UpperHalf(u64);

impl Hasher for UpperHalf {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.0 = self.0.rotate_left(8) ^ u64::from(byte));
    }

    fn write_u128(&mut self, digest: u128) {
        self.0 = upper_half(digest);
    }

    fn write_u64(&mut self, half: u64) {
        self.0 = half;
    }
}

/// The half that distinguishes the digests of one shard.
fn upper_half(digest: u128) -> u64 {
    (digest >> 64) as u64
}

/// Largest number of digests in each set of a shard.
const MOST_REMEMBERED: usize = 1 << 15;

impl<K, V> StoreShard<K, V> {
    /// Whether a digest was requested before; it counts as requested from now on.
    fn is_known(&mut self, digest: u128) -> bool {
        !remember(&mut self.requested, digest)
    }
}

/// Remembers a digest; true where it was new.
fn remember(requested: &mut HashSet<u64, DigestHasher>, digest: u128) -> bool {
    if requested.len() >= MOST_REMEMBERED {
        requested.clear();
    }
    requested.insert(upper_half(digest))
}

/// A key and its value.
#[derive(Debug)]
pub(crate) struct StoreEntry<K, V> {
    pub(crate) key: K,
    value: OnceLock<V>,
}

impl<K, V> StoreEntry<K, V> {
    pub(crate) fn value(&self) -> &V {
        self.value.get().expect("entries leave the store with their value")
    }
}

impl<K, V> SharedStore<K, V> {
    /// A store of all values, up to `limit` bytes.
    pub(crate) fn new(limit: usize) -> SharedStore<K, V> {
        SharedStore::with_second_use_policy(limit, limit)
    }

    /// A store that, beyond `first_use_bytes` bytes, adds only values requested a second time, so that values used once
    /// do not fill memory.
    pub(crate) fn with_second_use_policy(limit: usize, first_use_bytes: usize) -> SharedStore<K, V> {
        SharedStore {
            shards: (0..16).map(|_| Mutex::default()).collect(),
            bytes: AtomicUsize::new(0),
            limit,
            first_use_bytes,
        }
    }

    /// True at the first call with a digest, whether or not a key of that digest is stored. A shard forgets all digests
    /// when it remembers [`MOST_REMEMBERED`] digests.
    pub(crate) fn is_new(&self, digest: u128) -> bool {
        remember(&mut self.shard(digest).seen, digest)
    }

    fn shard(&self, digest: u128) -> MutexGuard<'_, StoreShard<K, V>> {
        self.shards[digest as usize % 16].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The entry of a key, computed if it is not stored. `same` compares a stored key of the same digest with the
    /// requested one; `size` returns the bytes of key plus value.
    pub(crate) fn get(
        &self,
        digest: u128,
        same: impl Fn(&K) -> bool,
        key: impl FnOnce() -> K,
        make: impl FnOnce(&K) -> V,
        size: impl FnOnce(&K, &V) -> usize,
    ) -> Arc<StoreEntry<K, V>> {
        let mut kept = false;
        let entry = {
            let mut shard = self.shard(digest);
            match shard.entries.get(&digest) {
                Some(entry) if same(&entry.key) => entry.clone(),
                found => {
                    let entry = Arc::new(StoreEntry { key: key(), value: OnceLock::new() });
                    let bytes = self.bytes.load(Ordering::Relaxed);
                    kept = found.is_none()
                        && bytes < self.limit
                        && (bytes < self.first_use_bytes || shard.is_known(digest));
                    if kept {
                        shard.entries.insert(digest, entry.clone());
                    }
                    entry
                }
            }
        };
        entry.value.get_or_init(|| {
            let value = make(&entry.key);
            if kept {
                self.bytes.fetch_add(size(&entry.key, &value), Ordering::Relaxed);
            }
            value
        });
        entry
    }
}
