//! Adaptation of the process noise to a target that manoeuvres more than the motion model expects.

use serde::{Deserialize, Serialize};

/// Number of dimensions of a measured position.
const DIMENSIONS: f64 = 3.0;
/// Mean of the squared Mahalanobis distance per dimension at which the process noise stays as it
/// is. For a model that fits, this mean is one. The value above one lets enlarged noise return to
/// the configured one as soon as it fits again.
const FITS: f64 = 1.2;
/// Largest value for which a single squared distance per dimension counts: the measurement may be a
/// cluster of something else.
const MOST_SURPRISE: f64 = 5.0;
/// Change of the logarithm of the factor per unit by which a measurement exceeds [`FITS`].
const GAIN: f64 = 0.2;
/// Largest factor of the standard deviations. In simulations, swarms with accelerations of up to 18
/// m/s^2 were followed worse with 3. Larger values were not tried.
const MOST: f64 = 5.0;

/// Factor of the standard deviations of one target's process noise. It is one until measurements
/// are further from their predictions than the configured noise allows.
///
/// # Source
/// Adaptive filtering by the innovations (Mehra, "Approaches to adaptive filtering", IEEE Trans.
/// Automatic Control 17(5), 1972): with the right noise, the squared Mahalanobis distances of the
/// innovations have a known mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Manoeuvre(f64);

impl Manoeuvre {
    /// Factor one: the target moves as the motion model expects.
    pub(super) const CALM: Self = Self(1.0);

    /// Factor of the standard deviations of the process noise, 1 to 5.
    pub(super) fn factor(self) -> f64 {
        self.0
    }

    /// Adapt the factor to `nis`, the squared Mahalanobis distance of a measurement from its
    /// prediction.
    pub(super) fn feel(&mut self, nis: f64) {
        let surprise = (nis / DIMENSIONS).min(MOST_SURPRISE) - FITS;
        self.0 = (self.0 * libm::exp(GAIN * surprise)).clamp(1.0, MOST);
    }

    /// Whether [`Manoeuvre::feel`] can give this value: checks a saved state.
    pub(super) fn is_possible(self) -> bool {
        (1.0..=MOST).contains(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn felt(distances: impl IntoIterator<Item = f64>) -> f64 {
        let mut manoeuvre = Manoeuvre::CALM;
        distances.into_iter().for_each(|nis| manoeuvre.feel(nis));
        assert!(manoeuvre.is_possible());
        manoeuvre.factor()
    }

    #[test]
    fn what_moves_as_expected_stays_calm() {
        assert_eq!(felt([3.0; 50]), 1.0);
        assert_eq!(felt([0.0; 50]), 1.0);
    }

    #[test]
    fn surprises_widen_the_noise_and_their_end_narrows_it() {
        let widened = felt([9.0; 5]);
        assert!(widened > 2.0, "{widened}");
        assert_eq!(felt([9.0; 500]), MOST);
        let back = felt([9.0; 5].into_iter().chain([3.0; 60]));
        assert_eq!(back, 1.0);
    }

    #[test]
    fn one_distance_alone_hardly_counts() {
        assert_eq!(felt([1e9]), felt([DIMENSIONS * MOST_SURPRISE]));
        assert!(felt([f64::INFINITY]) < 2.2);
    }

    #[test]
    fn other_numbers_are_refused() {
        for value in [0.99, MOST + 0.01, f64::NAN, f64::INFINITY] {
            assert!(!Manoeuvre(value).is_possible(), "{value}");
        }
    }
}
