//! Hash function for small keys: fast, and the same on every platform.

use std::hash::Hasher;

/// Hasher that multiplies by the golden ratio (Fibonacci hashing). Its results are equal on every
/// platform and in every run.
#[derive(Default)]
pub(crate) struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(u64::from(byte));
        }
    }

    fn write_i64(&mut self, value: i64) {
        self.write_u64(value.cast_unsigned());
    }

    fn write_u64(&mut self, value: u64) {
        // The table takes its index from the low bits, but the product mixes best in the high ones: the
        // shift brings those down. No random seed, so that runs repeat.
        let mixed = (self.0 ^ value).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.0 = mixed ^ mixed >> 32;
    }

    fn finish(&self) -> u64 {
        self.0
    }
}
