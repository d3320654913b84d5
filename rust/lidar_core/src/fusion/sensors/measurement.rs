//! Measurements of the sensors: positions; ranges, angles and range rates; turn rates; poses.

use crate::Error;
use nalgebra::{Matrix6, SMatrix};
use serde::{Deserialize, Serialize};

/// Largest number of values of one measurement.
pub const MAX_VALUES: usize = 12;
/// Largest number of values that have a covariance.
pub const MAX_NOISY: usize = 6;
/// Number of entries of the upper triangle of a covariance.
const PACKED: usize = MAX_NOISY * (MAX_NOISY + 1) / 2;

/// Sensor that a measurement comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Sensor {
    /// Position of the target: x, y, or x, y, z [m].
    Lidar,
    /// Range [m], bearing counter-clockwise from x [rad], elevation above the plane of x and y [rad], range rate [m/s],
    /// positive when the range grows; those of them that [`PolarValues`] states. Or range, bearing, range rate and the
    /// target's true speed [m/s] and heading [rad], which only reading C of the paper's model uses.
    Radar,
    /// The platform: turn rate [rad/s]; or that and the velocity of its origin in its own axes
    /// [m/s].
    Gyro,
    /// The platform in the world: x, y [m], yaw [rad]; or these and the velocity in the world
    /// [m/s] and the turn rate [rad/s].
    Pose,
    /// The platform in space: x, y, z [m], roll, pitch, yaw [rad]; or these, the velocity in the
    /// world [m/s], and the turn rates about its own axes [rad/s].
    SpacePose,
}

/// Which of range, bearing, elevation and range rate a radar or another sensor gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PolarValues {
    given: [bool; 4],
    /// Indices of the given values, followed by zeros.
    places: [u8; 4],
    count: u8,
}

impl PolarValues {
    /// Place of the range among all four values.
    pub const RANGE: usize = 0;
    /// Place of the bearing among all four values.
    pub const BEARING: usize = 1;
    /// Place of the elevation among all four values.
    pub const ELEVATION: usize = 2;
    /// Place of the range rate among all four values.
    pub const RANGE_RATE: usize = 3;
    /// Range, bearing and range rate.
    pub const FLAT: Self =
        Self { given: [true, true, false, true], places: [0, 1, 3, 0], count: 3 };
    /// Range, bearing, elevation and range rate.
    pub const ALL: Self = Self { given: [true; 4], places: [0, 1, 2, 3], count: 4 };

    /// Mask of the given values among the four.
    ///
    /// # Errors
    /// [`Error::Value`] if no value is given.
    pub fn new(given: [bool; 4]) -> Result<Self, Error> {
        let (mut places, mut count) = ([0; 4], 0);
        for place in (0..4).filter(|place| given[usize::from(*place)]) {
            places[usize::from(count)] = place;
            count += 1;
        }
        if count > 0 {
            return Ok(Self { given, places, count });
        }
        let (name, expected) = ("measures", "at least one value");
        Err(Error::Value { name, expected, index: 0, got: "none".to_owned() })
    }

    /// Number of values.
    #[must_use]
    pub fn count(self) -> usize {
        usize::from(self.count)
    }

    /// True if the value at this place is given.
    #[must_use]
    pub fn has(self, place: usize) -> bool {
        self.given[place]
    }

    /// Indices of the given values, followed by zeros.
    #[must_use]
    pub fn places(self) -> [usize; 4] {
        self.places.map(usize::from)
    }
}

/// One measurement. Its values need not be finite: a filter rejects measurements with values that are not finite, and
/// counts them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SavedMeasurement", into = "SavedMeasurement")]
pub struct Measurement {
    stamp_ns: i64,
    sensor: Sensor,
    measures: PolarValues,
    values: [f64; MAX_VALUES],
    count: usize,
    /// Upper triangle, row by row.
    covariance: Option<[f64; PACKED]>,
    seen_from: Option<[f64; 2]>,
}

/// A measurement as it is saved: stamp, sensor, what it measures, values, covariance row by row, place of the
/// radar.
type SavedMeasurement = (i64, Sensor, [bool; 4], Vec<f64>, Option<Vec<f64>>, Option<[f64; 2]>);

impl From<Measurement> for SavedMeasurement {
    fn from(m: Measurement) -> Self {
        let size = m.noisy();
        let entries = m.covariance.map(|packed| {
            let all = (0..size).flat_map(|row| (0..size).map(move |column| (row, column)));
            all.map(|(row, column)| packed[packed_at(row, column)]).collect()
        });
        (m.stamp_ns, m.sensor, m.measures.given, m.values().to_vec(), entries, m.seen_from)
    }
}

impl TryFrom<SavedMeasurement> for Measurement {
    type Error = Error;

    fn try_from(saved: SavedMeasurement) -> Result<Self, Error> {
        let (stamp_ns, sensor, measures, values, covariance, seen_from) = saved;
        let measures = PolarValues::new(measures)?;
        let made = if sensor == Sensor::Radar && values.len() == measures.count() {
            Self::polar(stamp_ns, measures, &values, covariance.as_deref())
        } else {
            Self::new(stamp_ns, sensor, &values, covariance.as_deref())
        };
        match seen_from {
            Some(place) => made?.with_seen_from(place),
            None => made,
        }
    }
}

/// Place of an entry of a covariance among those of its upper triangle.
const fn packed_at(row: usize, column: usize) -> usize {
    let (low, high) = if row < column { (row, column) } else { (column, row) };
    low * MAX_NOISY - low * (low + 1) / 2 + high
}

impl Measurement {
    /// A measurement. `covariance`: row by row; None: the covariance in the configuration of the filter applies. Three
    /// values of a radar are range, bearing and range rate; four values include the elevation.
    ///
    /// # Errors
    /// [`Error::Length`] for a number of values that the sensor does not have, [`Error::Value`] for a covariance of a
    /// measurement that uses none, or for one that is not positive definite.
    pub fn new(
        stamp_ns: i64,
        sensor: Sensor,
        values: &[f64],
        covariance: Option<&[f64]>,
    ) -> Result<Self, Error> {
        let allowed: &[usize] = match sensor {
            Sensor::Lidar => &[2, 3],
            Sensor::Radar => &[3, 4, 5],
            Sensor::Gyro => &[1, 3],
            Sensor::Pose => &[3, 6],
            Sensor::SpacePose => &[6, 12],
        };
        if !allowed.contains(&values.len()) {
            let expected = allowed[0];
            return Err(Error::Length { name: "values", expected, got: values.len() });
        }
        let is_full = sensor == Sensor::Radar && values.len() == 4;
        let measures = if is_full { PolarValues::ALL } else { PolarValues::FLAT };
        Self::checked(stamp_ns, sensor, measures, values, covariance)
    }

    /// A measurement of some of range, bearing, elevation and range rate, in this order.
    ///
    /// # Errors
    /// As of [`Self::new`].
    pub fn polar(
        stamp_ns: i64,
        measures: PolarValues,
        values: &[f64],
        covariance: Option<&[f64]>,
    ) -> Result<Self, Error> {
        let expected = measures.count();
        if values.len() != expected {
            return Err(Error::Length { name: "values", expected, got: values.len() });
        }
        Self::checked(stamp_ns, Sensor::Radar, measures, values, covariance)
    }

    fn checked(
        stamp_ns: i64,
        sensor: Sensor,
        measures: PolarValues,
        values: &[f64],
        covariance: Option<&[f64]>,
    ) -> Result<Self, Error> {
        let mut padded = [0.0; MAX_VALUES];
        padded[..values.len()].copy_from_slice(values);
        let count = values.len();
        let plain = Self {
            stamp_ns,
            sensor,
            measures,
            values: padded,
            count,
            covariance: None,
            seen_from: None,
        };
        let packed = covariance.map(|entries| packed(plain.noisy(), entries)).transpose()?;
        Ok(Self { covariance: packed, ..plain })
    }

    /// The measurement as a position that a radar reported from this place in the frame of the
    /// tracks [m]: a tracker of many targets then recognises double echoes.
    ///
    /// # Errors
    /// [`Error::Value`] for a sensor that measures no position, or a place that is not finite.
    pub fn with_seen_from(self, place: [f64; 2]) -> Result<Self, Error> {
        let is_finite = place.iter().all(|value| value.is_finite());
        if self.sensor == Sensor::Lidar && is_finite {
            return Ok(Self { seen_from: Some(place), ..self });
        }
        let expected = "a finite place, with a measured position";
        let got = format!("{place:?} with {:?}", self.sensor);
        Err(Error::Value { name: "seen_from", expected, index: 0, got })
    }

    /// Place of the radar that reported the position [m]; None for other sensors, or if unknown.
    #[must_use]
    pub fn seen_from(&self) -> Option<[f64; 2]> {
        self.seen_from
    }

    /// Time of the measurement [ns].
    #[must_use]
    pub fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }

    /// Sensor that it comes from.
    #[must_use]
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Values that a radar measures.
    #[must_use]
    pub fn measures(&self) -> PolarValues {
        self.measures
    }

    /// The values, as many as the sensor gave.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.values[..self.count]
    }

    /// True if the measurement has a covariance of its own.
    #[must_use]
    pub fn has_covariance(&self) -> bool {
        self.covariance.is_some()
    }

    /// Variance of the value at `index`; None without a covariance.
    #[must_use]
    pub fn variance(&self, index: usize) -> Option<f64> {
        self.covariance.map(|packed| packed[packed_at(index, index)])
    }

    /// Covariance of the first K values; None without one.
    pub(in crate::fusion) fn covariance<const K: usize>(&self) -> Option<SMatrix<f64, K, K>> {
        let packed = self.covariance.as_ref()?;
        Some(SMatrix::from_fn(|row, column| packed[packed_at(row, column)]))
    }

    /// The measurement with independent errors of these variances, as many as [`Self::noisy`] returns.
    pub(in crate::fusion) fn with_variances(&self, variances: &[f64]) -> Self {
        let mut packed = [0.0; PACKED];
        for (index, variance) in variances.iter().enumerate() {
            packed[packed_at(index, index)] = *variance;
        }
        Self { covariance: Some(packed), ..*self }
    }

    /// Number of values that have a covariance: the first ones.
    #[must_use]
    pub fn noisy(&self) -> usize {
        match self.sensor {
            Sensor::Lidar => self.count,
            Sensor::Radar => self.measures.count(),
            Sensor::Gyro => 1,
            Sensor::Pose => 3,
            Sensor::SpacePose => 6,
        }
    }

    /// True for a measurement of the platform's motion.
    #[must_use]
    pub fn is_of_platform(&self) -> bool {
        matches!(self.sensor, Sensor::Gyro | Sensor::Pose | Sensor::SpacePose)
    }

    /// True if the values can be used: all are finite, and a range is positive.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        let has_range = self.sensor == Sensor::Radar && self.measures.has(PolarValues::RANGE);
        self.values().iter().all(|value| value.is_finite()) && (!has_range || self.values[0] > 0.0)
    }
}

/// Upper triangle of a checked covariance of `size` values.
fn packed(size: usize, entries: &[f64]) -> Result<[f64; PACKED], Error> {
    if entries.len() != size * size {
        let name = "covariance";
        return Err(Error::Length { name, expected: size * size, got: entries.len() });
    }
    let at = |row: usize, column: usize| entries[row * size + column];
    let symmetric = |row: usize, column: usize| {
        let scale = libm::sqrt((at(row, row) * at(column, column)).abs());
        (at(row, column) - at(column, row)).abs() <= 1e-9 * scale
    };
    let mut packed = [0.0; PACKED];
    let mut filled = Matrix6::identity();
    for row in 0..size {
        for column in 0..size {
            let value = 0.5 * (at(row, column) + at(column, row));
            (packed[packed_at(row, column)], filled[(row, column)]) = (value, value);
            if !symmetric(row, column) {
                return Err(refused(row, entries));
            }
        }
    }
    // Means of entries, which may be infinite though these are not.
    if packed.iter().all(|entry| entry.is_finite()) && filled.cholesky().is_some() {
        return Ok(packed);
    }
    Err(refused(0, entries))
}

fn refused(index: usize, entries: &[f64]) -> Error {
    let expected = "a symmetric positive definite matrix";
    Error::Value { name: "covariance", expected, index, got: format!("{entries:?}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measurement_has_the_values_of_its_sensor() {
        let of = |sensor, count: usize| Measurement::new(0, sensor, &[1.0; 12][..count], None);
        for (sensor, counts) in [
            (Sensor::Lidar, vec![2, 3]),
            (Sensor::Radar, vec![3, 4, 5]),
            (Sensor::Gyro, vec![1, 3]),
            (Sensor::Pose, vec![3, 6]),
            (Sensor::SpacePose, vec![6, 12]),
        ] {
            for count in 0..=12 {
                assert_eq!(
                    of(sensor, count).is_ok(),
                    counts.contains(&count),
                    "{sensor:?} {count}"
                );
            }
        }
    }

    #[test]
    fn a_radar_measures_some_of_four_values() -> Result<(), Error> {
        assert!(PolarValues::new([false; 4]).is_err());
        let angles = PolarValues::new([false, true, true, false])?;
        assert_eq!((angles.count(), angles.places()), (2, [1, 2, 0, 0]));
        let noise = [0.4, 0.1, 0.1, 0.3];
        let m = Measurement::polar(0, angles, &[0.5, -0.1], Some(&noise))?;
        assert_eq!((m.noisy(), m.variance(1)), (2, Some(0.3)));
        assert!(m.is_usable(), "a bearing has no range that must be positive");
        assert!(Measurement::polar(0, angles, &[0.5], None).is_err());
        let saved = SavedMeasurement::from(m);
        assert_eq!(Measurement::try_from(saved)?, m);
        let all = Measurement::new(0, Sensor::Radar, &[1.0; 4], None)?;
        assert_eq!(all.measures(), PolarValues::ALL);
        Ok(())
    }

    #[test]
    fn covariances_are_checked() {
        let of = |entries: &[f64]| Measurement::new(0, Sensor::Lidar, &[1.0, 2.0], Some(entries));
        assert!(of(&[1.0, 0.5, 0.5, 1.0]).is_ok());
        for bad in
            [vec![1.0], vec![1.0, 0.5, 0.4, 1.0], vec![1.0, 2.0, 2.0, 1.0], vec![f64::NAN; 4]]
        {
            assert!(of(&bad).is_err(), "{bad:?}");
        }
        let pose = |entries: &[f64]| Measurement::new(0, Sensor::Pose, &[0.0; 6], Some(entries));
        assert!(pose(&[1.0]).is_err());
        assert!(pose(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1]).is_ok());
    }

    /// Found by `make fuzz`: the mean of two such entries is infinite, and a saved filter with it was refused.
    #[test]
    fn covariances_whose_sums_overflow_are_refused() -> Result<(), Error> {
        let of = |variance: f64| {
            let entries = [variance, 0.0, 0.0, variance];
            Measurement::new(0, Sensor::Lidar, &[1.0, 2.0], Some(&entries))
        };
        assert!(of(f64::MAX).is_err());
        let m = of(1e307)?;
        assert_eq!(Measurement::try_from(SavedMeasurement::from(m))?, m);
        Ok(())
    }

    #[test]
    fn the_place_of_a_radar_is_kept_and_checked() -> Result<(), Error> {
        let m = Measurement::new(0, Sensor::Lidar, &[1.0, 2.0], None)?;
        let seen = m.with_seen_from([3.0, 4.0])?;
        assert_eq!((m.seen_from(), seen.seen_from()), (None, Some([3.0, 4.0])));
        assert_eq!(Measurement::try_from(SavedMeasurement::from(seen))?, seen);
        assert!(m.with_seen_from([f64::NAN, 0.0]).is_err());
        let polar = Measurement::new(0, Sensor::Radar, &[1.0, 0.0, 0.0], None)?;
        assert!(polar.with_seen_from([0.0; 2]).is_err());
        Ok(())
    }

    #[test]
    fn what_is_not_finite_or_has_no_range_cannot_be_used() -> Result<(), Error> {
        assert!(!Measurement::new(0, Sensor::Lidar, &[f64::NAN, 0.0], None)?.is_usable());
        assert!(!Measurement::new(0, Sensor::Radar, &[0.0, 0.0, 0.0], None)?.is_usable());
        assert!(Measurement::new(0, Sensor::Radar, &[0.1, 0.0, 0.0], None)?.is_usable());
        Ok(())
    }
}
