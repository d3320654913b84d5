//! Velocity of a measured position: a line through the last measurements, and its uncertainty.

use serde::{Deserialize, Serialize};

/// Largest number of stored measurements. Older ones have no weight: if a target changes its
/// motion, even a small weight of far measurements would have a large effect.
const KEPT: usize = 12;
/// Weight of the configured noise, as a number of measurements. The configured noise may be wrong,
/// and returns of large bodies scatter.
const TOLD: f64 = 1.0;
/// Largest correlation of successive errors that is taken into account.
const MOST_ALIKE: f64 = 0.9;

/// Slope of a line through places along one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slope {
    /// Velocity [m/s].
    pub velocity: f64,
    /// Variance of the velocity [m^2/s^2].
    pub variance: f64,
    /// Degrees of freedom of the variance.
    pub freedom: f64,
}

/// Noise of positions along one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlaceNoise {
    /// Variance of one position, for uncorrelated errors [m^2].
    pub(crate) variance: f64,
    /// Degrees of freedom of the variance.
    pub(crate) freedom: f64,
}

/// The line through the places along one axis.
struct FittedLine {
    velocity: f64,
    /// Sum of the squared differences of the times from their mean [s^2].
    spread: f64,
    noise: PlaceNoise,
}

/// A measured position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct PlaceAt {
    stamp_ns: i64,
    /// Measured place [m].
    place: [f64; 3],
    /// Configured variance of the sensor along every axis [m^2].
    told: [f64; 3],
}

/// The last places of a target.
///
/// # Source Least squares; the noise is estimated from the scatter of the positions. Errors of
/// successive measurements may be correlated, for example if a body shows one of its ends and later
/// the other one. The correlation r is estimated from the squared successive differences (von
/// Neumann, "Distribution of the ratio of the mean square successive difference to the variance",
/// 1941). The variance is then multiplied by (1 + r) / (1 - r).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlaceTrend {
    /// Places, the oldest first.
    places: Vec<PlaceAt>,
}

impl PlaceTrend {
    /// Add a place that is not older than the last one, with the configured variance of its sensor
    /// along every axis [m^2]. Returns the time since the last one [s]; zero for the first, and for
    /// a place that is not finite and is left out.
    pub fn take(&mut self, stamp_ns: i64, place: [f64; 3], told: [f64; 3]) -> f64 {
        if !place.iter().chain(&told).all(|value| value.is_finite()) {
            return 0.0;
        }
        let last = self.places.last().map_or(stamp_ns, |last| last.stamp_ns);
        if self.places.len() >= KEPT {
            self.places.remove(0);
        }
        self.places.push(PlaceAt { stamp_ns, place, told });
        stamp_ns.saturating_sub(last) as f64 * 1e-9
    }

    /// Number of stored positions.
    #[must_use]
    pub fn count(&self) -> usize {
        self.places.len()
    }

    /// Velocity along one of three axes; None for fewer than three places, or if all have the same
    /// time.
    #[must_use]
    pub fn slope(&self, axis: usize) -> Option<Slope> {
        let FittedLine { velocity, spread, noise } = self.line(axis)?;
        Some(Slope { velocity, variance: noise.variance / spread, freedom: noise.freedom })
    }

    /// Noise of the positions along one of three axes, from their scatter; as configured if there
    /// are too few positions.
    pub(crate) fn noise(&self, axis: usize) -> PlaceNoise {
        let told = PlaceNoise { variance: self.told(axis), freedom: TOLD };
        self.line(axis).map_or(told, |line| line.noise)
    }

    /// Mean of the configured variances along one axis [m^2].
    fn told(&self, axis: usize) -> f64 {
        let sum: f64 = self.places.iter().map(|one| one.told[axis]).sum();
        sum / self.places.len().max(1) as f64
    }

    /// Line through the places along one axis; None as for [`Self::slope`].
    fn line(&self, axis: usize) -> Option<FittedLine> {
        let first = self.places.first().filter(|_| self.places.len() >= 3 && axis < 3)?;
        let count = self.places.len() as f64;
        let point = |one: &PlaceAt| {
            let time = one.stamp_ns.saturating_sub(first.stamp_ns) as f64 * 1e-9;
            [time, one.place[axis] - first.place[axis]]
        };
        let points = || self.places.iter().map(point);
        let mean = [0, 1].map(|k| points().map(|point| point[k]).sum::<f64>() / count);
        let away = || points().map(|[time, place]| [time - mean[0], place - mean[1]]);
        let spread: f64 = away().map(|[time, _]| time * time).sum();
        if spread <= 0.0 {
            return None;
        }
        let velocity = away().map(|[time, place]| time * place).sum::<f64>() / spread;
        let error = |[time, place]: [f64; 2]| place - velocity * time;
        let left: f64 = away().map(|one| error(one) * error(one)).sum();
        let steps = away().zip(away().skip(1)).map(|(one, next)| error(next) - error(one));
        let steps: f64 = steps.map(|step| step * step).sum();
        let told = self.told(axis);
        let freedom = TOLD + count - 2.0;
        let all = left + TOLD * told;
        let alike = if all > 0.0 { 1.0 - (steps + 2.0 * TOLD * told) / (2.0 * all) } else { 0.0 };
        let alike = alike.clamp(0.0, MOST_ALIKE);
        let variance = all / freedom * (1.0 + alike) / (1.0 - alike);
        Some(FittedLine { velocity, spread, noise: PlaceNoise { variance, freedom } })
    }
}

impl Slope {
    /// Logarithm of the probability density of this velocity (Student's t), up to a constant, for
    /// an object whose true velocity has zero mean and this variance [m^2/s^2].
    #[must_use]
    pub fn log_density(&self, variance: f64) -> f64 {
        let all = self.variance + variance;
        let far = self.velocity * self.velocity / (self.freedom * all);
        -0.5 * ((self.freedom + 1.0) * libm::log1p(far) + libm::log(all))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of places along x, one every `step_ns`.
    fn slope(places: &[f64], step_ns: i64, told: f64) -> Option<Slope> {
        let mut trend = PlaceTrend::default();
        for (place, k) in places.iter().zip(0..) {
            trend.take(k * step_ns, [*place, 0.0, 0.0], [told; 3]);
        }
        trend.slope(0)
    }

    /// By the textbook.
    #[test]
    fn a_line_goes_through_the_places() -> Result<(), &'static str> {
        let places = [5.0, 6.1, 6.9, 8.2, 8.8, 10.1];
        let found = slope(&places, 500_000_000, 0.0).ok_or("no slope")?;
        let mean = places.iter().sum::<f64>() / 6.0;
        let time = |k: usize| 0.5 * (k as f64 - 2.5);
        let spread: f64 = (0..6).map(|k| time(k) * time(k)).sum();
        let velocity = (0..6).map(|k| time(k) * (places[k] - mean)).sum::<f64>() / spread;
        let left = |k: usize| places[k] - mean - velocity * time(k);
        let squares: f64 = (0..6).map(|k| left(k) * left(k)).sum();
        assert!((found.velocity - velocity).abs() < 1e-12);
        // Successive errors have opposite signs: nothing is added for their likeness.
        assert!((found.variance - squares / (TOLD + 4.0) / spread).abs() < 1e-12);
        assert_eq!(found.freedom, TOLD + 4.0);
        assert_eq!(slope(&places[..2], 500_000_000, 0.01), None);
        assert_eq!(slope(&places, 0, 0.01), None);
        Ok(())
    }

    #[test]
    fn where_it_is_and_what_was_long_ago_do_not_matter() -> Result<(), &'static str> {
        let place = |k: i32| 0.3 * f64::from(k) + if k % 2 == 0 { 0.1 } else { -0.1 };
        let places: Vec<f64> = (0..40).map(place).collect();
        let [long, last] =
            [&places[..], &places[40 - KEPT..]].map(|places| slope(places, 100_000_000, 0.01));
        assert_eq!(long, last);
        let far: Vec<f64> = places.iter().map(|x| x + 1e6).collect();
        let far = slope(&far, 100_000_000, 0.01).ok_or("no slope")?;
        let near = long.ok_or("no slope")?;
        assert!((far.velocity / near.velocity - 1.0).abs() < 1e-6);
        assert!((far.variance / near.variance - 1.0).abs() < 1e-3, "{near:?} {far:?}");
        Ok(())
    }

    /// A body that shows one end, and then the other, seems to move; its velocity is less certain than that of
    /// one with as large errors that change each time.
    #[test]
    fn errors_that_are_alike_count_less() -> Result<(), &'static str> {
        let ends: Vec<f64> = (0..12).map(|k| if k / 3 % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let jitter: Vec<f64> = (0..12).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let [ends, jitter] = [ends, jitter].map(|places| slope(&places, 1_000_000_000, 0.01));
        let (ends, jitter) = (ends.ok_or("no slope")?, jitter.ok_or("no slope")?);
        assert!(ends.variance > 1.5 * jitter.variance, "{ends:?} {jitter:?}");
        Ok(())
    }

    #[test]
    fn what_is_no_place_is_left_out() {
        let mut trend = PlaceTrend::default();
        assert_eq!(trend.take(5, [0.0; 3], [1.0; 3]), 0.0);
        assert_eq!(trend.take(1_000_000_005, [f64::NAN; 3], [1.0; 3]), 0.0);
        assert_eq!(trend.take(2_000_000_005, [0.0; 3], [1.0; 3]), 2.0);
        (0..99).for_each(|k| {
            trend.take(3_000_000_000 + k, [0.0; 3], [1.0; 3]);
        });
        assert_eq!(trend.count(), KEPT);
    }
}
