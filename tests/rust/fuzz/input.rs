//! Values from bytes: plausible ones most of the time, and those that break arithmetic.

use lidar_core::Error;
use lidar_core::util::threads::pool;
use rayon::ThreadPool;
use std::sync::LazyLock;

/// A pool of one thread, which all runs share: to make one takes longer than many a run.
pub fn one_thread() -> Result<&'static ThreadPool, Error> {
    static POOL: LazyLock<Option<ThreadPool>> = LazyLock::new(|| pool(1).ok());
    let missing = || Error::Io(std::io::Error::other("no thread can be had"));
    POOL.as_ref().ok_or_else(missing)
}

/// What is left of the bytes; when nothing is left, every value is zero.
pub struct Input<'a> {
    bytes: &'a [u8],
}

impl<'a> Input<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    pub fn rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.bytes)
    }

    pub fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut taken = [0; N];
        let (head, tail) = self.bytes.split_at(N.min(self.bytes.len()));
        taken[..head.len()].copy_from_slice(head);
        self.bytes = tail;
        taken
    }

    pub fn byte(&mut self) -> u8 {
        let [byte] = self.array();
        byte
    }

    /// True for one byte in eight.
    pub fn rarely(&mut self) -> bool {
        self.byte() % 8 == 7
    }

    pub fn is_set(&mut self) -> bool {
        self.byte() % 2 == 1
    }

    pub fn below(&mut self, count: usize) -> usize {
        usize::from(self.byte()) % count.max(1)
    }

    /// An index into `count` entries, now and then the one behind them.
    pub fn index(&mut self, count: usize) -> usize {
        if self.rarely() { count } else { self.below(count) }
    }

    pub fn one_of<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.below(values.len())]
    }

    pub fn maybe<T>(&mut self, make: impl FnOnce(&mut Self) -> T) -> Option<T> {
        self.is_set().then(|| make(self))
    }

    pub fn i64(&mut self) -> i64 {
        i64::from_le_bytes(self.array())
    }

    /// Mostly steps of 10 ms forward; now and then back by some of them, or anywhere.
    pub fn stamp(&mut self, last_ns: i64) -> i64 {
        match self.byte() {
            255 => self.i64(),
            254 => last_ns,
            253 => last_ns.saturating_add(3_600_000_000_000),
            late @ 236..=252 => last_ns.wrapping_sub(i64::from(late - 235) * 10_000_000),
            steps => last_ns.saturating_add(i64::from(steps) * 10_000_000),
        }
    }

    pub fn f64(&mut self) -> f64 {
        const ODD: [f64; 16] = [
            0.0,
            -0.0,
            1.0,
            -1.0,
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::MAX,
            f64::MIN_POSITIVE,
            5e-324,
            1e300,
            1e-300,
            1e9,
            -1e9,
            2_147_483_648.0,
            1e-9,
        ];
        match self.byte() {
            kind @ 240..=255 => ODD[usize::from(kind) - 240],
            239 => f64::from_le_bytes(self.array()),
            230..=238 => f64::from(f32::from_le_bytes(self.array())),
            _ => f64::from(i16::from_le_bytes(self.array())) / 512.0,
        }
    }

    /// A value that most parameters may have.
    pub fn positive(&mut self) -> f64 {
        if self.rarely() { self.f64() } else { (1.0 + f64::from(self.byte())) / 32.0 }
    }

    /// From 0 to 1, now and then anything.
    pub fn share(&mut self) -> f64 {
        if self.rarely() { self.f64() } else { f64::from(self.byte()) / 255.0 }
    }

    pub fn f64s<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| self.f64())
    }

    pub fn f32s<const N: usize>(&mut self) -> [f32; N] {
        std::array::from_fn(|_| self.f64() as f32)
    }

    pub fn many<T>(&mut self, most: usize, mut make: impl FnMut(&mut Self) -> T) -> Vec<T> {
        let count = self.below(most + 1);
        (0..count).map(|_| make(self)).collect()
    }

    /// As long as `count`, now and then longer or shorter.
    pub fn beside<T>(&mut self, count: usize, mut make: impl FnMut(&mut Self) -> T) -> Vec<T> {
        let count = if self.byte() == 255 { self.below(8) } else { count };
        (0..count).map(|_| make(self)).collect()
    }

    /// Near the sensor most of the time, in groups as objects give them.
    pub fn points(&mut self, most: usize) -> Vec<[f32; 3]> {
        let mut last = [0.0_f32; 3];
        self.many(most, |input| {
            let step = input.byte();
            if step >= 200 {
                last = input.f32s();
            } else {
                last[usize::from(step % 3)] += (f32::from(step / 3) - 20.0) / 64.0;
            }
            last
        })
    }

    /// A pose matrix: a turn about z and a place, now and then anything.
    pub fn pose(&mut self) -> [f64; 16] {
        if self.rarely() {
            return self.f64s();
        }
        let angle = f64::from(self.byte()) / 40.0;
        let (sine, cosine) = angle.sin_cos();
        let [x, y, z] = self.f64s();
        [cosine, -sine, 0., x, sine, cosine, 0., y, 0., 0., 1., z, 0., 0., 0., 1.]
    }

    /// A symmetric matrix, positive definite most of the time.
    pub fn covariance<const N: usize>(&mut self) -> [[f64; N]; N] {
        if self.rarely() {
            return std::array::from_fn(|_| self.f64s());
        }
        let root: [f64; N] = std::array::from_fn(|_| f64::from(self.byte()) / 64.0);
        std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                let tie = if row == column { 1.0 } else { 0.5 };
                tie * root[row] * root[column]
            })
        })
    }
}
