//! Random numbers by counter: each depends only on the seed and on its counter, not on the order of
//! the calls.

/// Purpose of a random number. It is a part of the counter, so that purposes never share numbers.
#[derive(Clone, Copy, Debug)]
#[repr(u32)]
pub enum Purpose {
    /// Range noise and dropout of one ray.
    Ray = 1,
    /// Steps of a random motion.
    Motion = 2,
    /// Particles that one ray may hit.
    Air = 3,
    /// A circle and its disturbances.
    Circle = 4,
    /// Range noise of the rays that hit a circle.
    CircleNoise = 5,
    /// Reflection of one ray at the surfaces that it hits.
    Surface = 6,
}

/// Four random words for a counter.
///
/// # Source
/// Salmon et al., "Parallel Random Numbers: As Easy as 1, 2, 3", SC 2011: Philox 4x32, 10 rounds.
#[must_use]
pub fn words(seed: u64, mut counter: [u32; 4]) -> [u32; 4] {
    let mut key = [seed as u32, (seed >> 32) as u32];
    for round in 0..10 {
        if round > 0 {
            key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
        }
        let first = u64::from(counter[0]) * 0xD251_1F53;
        let second = u64::from(counter[2]) * 0xCD9E_8D57;
        counter = [
            (second >> 32) as u32 ^ counter[1] ^ key[0],
            second as u32,
            (first >> 32) as u32 ^ counter[3] ^ key[1],
            first as u32,
        ];
    }
    counter
}

/// Counter of the `index`-th use in stream `stream` of `purpose`.
#[must_use]
pub fn place(purpose: Purpose, stream: u64, index: u32) -> [u32; 4] {
    [index, stream as u32, (stream >> 32) as u32, purpose as u32]
}

/// Uniform in (0, 1), both ends excluded.
#[must_use]
pub fn uniform(word: u32) -> f64 {
    (f64::from(word) + 0.5) / 4_294_967_296.0
}

/// Standard normal from two words (Box & Muller 1958); |value| < 6.8.
#[must_use]
pub fn normal(first: u32, second: u32) -> f64 {
    let radius = (-2.0 * libm::log(uniform(first))).sqrt();
    radius * libm::cos(2.0 * std::f64::consts::PI * uniform(second))
}

/// Consecutive random numbers of one stream.
#[derive(Clone, Debug)]
pub struct Stream {
    seed: u64,
    purpose: Purpose,
    stream: u64,
    index: u32,
}

impl Stream {
    /// Stream `stream` of `purpose`.
    #[must_use]
    pub fn new(seed: u64, purpose: Purpose, stream: u64) -> Self {
        Self { seed, purpose, stream, index: 0 }
    }

    /// Four numbers, each uniform in (0, 1).
    pub fn uniforms(&mut self) -> [f64; 4] {
        let drawn = words(self.seed, place(self.purpose, self.stream, self.index));
        self.index = self.index.wrapping_add(1);
        drawn.map(uniform)
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> [f64; 3] {
        let [height, turn, ..] = self.uniforms();
        let z = 2.0 * height - 1.0;
        let radius = (1.0 - z * z).sqrt();
        let azimuth = 2.0 * std::f64::consts::PI * turn;
        [radius * libm::cos(azimuth), radius * libm::sin(azimuth), z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers published with the authors' Random123 library (kat_vectors).
    #[test]
    fn philox_gives_the_published_words() {
        assert_eq!(words(0, [0; 4]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(
            words(u64::MAX, [u32::MAX; 4]),
            [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]
        );
        assert_eq!(
            words(0x299f_31d0_a409_3822, [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344]),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    #[test]
    fn normals_have_mean_zero_and_variance_one() {
        let count = 200_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for index in 0..count {
            let drawn = words(7, place(Purpose::Ray, 3, index));
            let value = normal(drawn[0], drawn[1]);
            sum += value;
            squares += value * value;
        }
        let count = f64::from(count);
        assert!((sum / count).abs() < 4.0 / count.sqrt()); // 4 standard errors
        assert!((squares / count - 1.0).abs() < 4.0 * (2.0 / count).sqrt());
    }
}
