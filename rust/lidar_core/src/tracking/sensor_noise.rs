//! Noise of a sensor, estimated from its innovations; the configured noise is the prior.

use serde::{Deserialize, Serialize};

/// Fisher information of the prior. Each measurement adds at most 1/2, so a few measurements
/// outweigh the prior.
const PRIOR: f64 = 2.0;
/// Largest squared ratio of an innovation to its standard deviation that is used: a larger one
/// counts as three standard deviations.
const MOST_SQUARED: f64 = 9.0;
/// Largest logarithm of the variance's factor: a standard deviation is at most 8 times as large or
/// as small as configured.
const WIDEST: f64 = 4.158_883_083_359_672;
/// Fisher information from which on the noise counts as known.
const KNOWN: f64 = 8.0;
/// Steps of Newton's method for one measurement.
const STEPS: usize = 4;

/// Estimated variance of one measured value, as a factor on the configured variance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseFactor {
    /// Natural logarithm of the factor.
    log: f64,
    /// Fisher information about the logarithm of the factor.
    information: f64,
}

/// Statistics of the innovations of one measured value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InnovationStatistics {
    /// Measured minus expected, squared.
    pub squared: f64,
    /// Variance of the innovation that does not come from the sensor: that of the prediction.
    pub predicted: f64,
    /// Configured variance of the sensor.
    pub configured: f64,
}

impl Default for NoiseFactor {
    fn default() -> Self {
        Self { log: 0.0, information: PRIOR }
    }
}

impl NoiseFactor {
    /// Estimated variance over the configured one.
    #[must_use]
    pub fn factor(&self) -> f64 {
        libm::exp(self.log)
    }

    /// True if the measurements determine the standard deviation to about a tenth, beyond the
    /// prior.
    #[must_use]
    pub fn is_known(&self) -> bool {
        self.information > KNOWN
    }

    /// Add an innovation. `memory`: number of measurements after which the weight of a measurement
    /// is 1/e.
    ///
    /// The result is the posterior mode of the logarithm of the factor. The innovation is normal,
    /// with the sum of both variances and bounded influence of outliers. The prior decays towards
    /// the configured variance.
    ///
    /// # Source
    /// Mehra, "On the identification of variances and adaptive Kalman filtering", 1970; bounded
    /// influence: Huber, "Robust estimation of a location parameter", 1964.
    pub fn learn(&mut self, surprise: &InnovationStatistics, memory: f64) {
        let InnovationStatistics { squared, predicted, configured } = *surprise;
        let kept = 1.0 - 1.0 / memory;
        let information = kept * self.information + (1.0 - kept) * PRIOR;
        let center = kept * self.information * self.log / information;
        let (mut log, mut share) = (center, 0.0);
        for _ in 0..STEPS {
            let noise = configured * libm::exp(log);
            let variance = noise + predicted.max(0.0);
            // What part of the innovation's variance the noise makes: a prediction that is less
            // certain than the sensor says little about it.
            share = noise / variance;
            let excess = (squared / variance).min(MOST_SQUARED) - 1.0;
            let slope = 0.5 * share * excess - information * (log - center);
            let step = slope / (information + 0.5 * share * share);
            log = (log + step.clamp(-1.0, 1.0)).clamp(-WIDEST, WIDEST);
        }
        (self.log, self.information) = (log, information + 0.5 * share * share);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MEMORY: f64 = 200.0;

    /// Squares of normal errors of deviation `std`, spread evenly over their distribution.
    fn squares(count: u32, std: f64) -> impl Iterator<Item = f64> {
        (0..count).map(move |k| {
            // two uniform numbers of a sequence of low discrepancy, by Box and Muller
            let [u, v] =
                [0.754_877_666, 0.569_840_290].map(|step| (0.5 + step * f64::from(k)) % 1.0);
            let z = libm::sqrt(-2.0 * libm::log(u)) * libm::cos(std::f64::consts::TAU * v);
            (std * z) * (std * z)
        })
    }

    fn learned(squared: impl Iterator<Item = f64>, predicted: f64, configured: f64) -> NoiseFactor {
        let mut noise = NoiseFactor::default();
        squared.for_each(|squared| {
            noise.learn(&InnovationStatistics { squared, predicted, configured }, MEMORY);
        });
        noise
    }

    #[test]
    fn the_variance_is_found_wherever_it_starts() {
        for told in [0.2, 0.5, 1.0, 2.0, 5.0] {
            // the true deviation is 1, and the prediction adds a variance of 0.5
            let found = learned(squares(400, libm::sqrt(1.5)), 0.5, told * told);
            let std = libm::sqrt(found.factor()) * told;
            assert!((std - 1.0).abs() < 0.15, "told {told}: {std}");
            assert!(found.is_known());
        }
    }

    #[test]
    fn a_vague_prediction_says_nothing() {
        let found = learned(squares(400, 100.0), 1e4, 1.0);
        assert!((found.factor() - 1.0).abs() < 0.5, "{}", found.factor());
        assert!(!found.is_known());
    }

    #[test]
    fn outliers_have_little_influence_and_the_factor_is_bounded() {
        let mixed = squares(400, 1.0).enumerate().map(|(k, s)| if k % 50 == 7 { 1e6 } else { s });
        let found = learned(mixed, 0.0, 1.0);
        assert!(found.factor() < 1.5, "{}", found.factor());
        for (squared, bound) in [(1e12, 64.0), (0.0, 1.0 / 64.0)] {
            let found = learned(std::iter::repeat_n(squared, 5_000), 0.0, 1.0);
            assert!((found.factor() / bound - 1.0).abs() < 1e-9, "{}", found.factor());
        }
    }
}
