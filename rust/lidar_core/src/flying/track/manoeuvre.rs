//! How much more a target manoeuvres than the motion model expects.

use serde::{Deserialize, Serialize};

/// Dimensions of a measured position.
const DIMENSIONS: f64 = 3.0;
/// Mean of the squared Mahalanobis distance per dimension at which the noise stays as it is. It would be one for a
/// model that fits. The rest lets a widened one, which fits once more, return to what was told.
const FITS: f64 = 1.2;
/// A single distance counts as this much at most: it may be a cluster of something else.
const MOST_SURPRISE: f64 = 5.0;
/// Change of the logarithm of the factor per unit of surprise.
const GAIN: f64 = 0.2;
/// Largest factor. Simulated swarms of up to 18 m/s^2 were followed worse with 3; more was not tried.
const MOST: f64 = 5.0;

/// Factor of the standard deviations of the process noise of one target: one until its measurements lie further
/// from their predictions than these allow.
///
/// # Source
/// Adaptive filtering by the innovations (Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic
/// Control 17(5), 1972): with the right noise, their squared Mahalanobis distances have a known mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Manoeuvre(f64);

impl Manoeuvre {
    /// As calm as the motion model says.
    pub(super) const CALM: Self = Self(1.0);

    /// Factor of the standard deviations of the process noise, 1 to 5.
    pub(super) fn factor(self) -> f64 {
        self.0
    }

    /// Let the squared Mahalanobis distance of a measurement count.
    pub(super) fn feel(&mut self, nis: f64) {
        let surprise = (nis / DIMENSIONS).min(MOST_SURPRISE) - FITS;
        self.0 = (self.0 * libm::exp(GAIN * surprise)).clamp(1.0, MOST);
    }

    /// Whether it can come from [`Manoeuvre::feel`].
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
