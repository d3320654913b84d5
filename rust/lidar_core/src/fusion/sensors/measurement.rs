//! Measurements of the sensors: positions; range, bearing and range rate; turn rates; poses.

use crate::Error;
use nalgebra::{Matrix2, Matrix3};
use serde::{Deserialize, Serialize};

/// Most values that one measurement has.
pub const MAX_VALUES: usize = 6;

/// Sensor that a measurement comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Sensor {
    /// Position of the target: x, y [m].
    Lidar,
    /// Range [m], bearing counter-clockwise from x [rad], range rate [m/s], positive when the
    /// range grows; or these and the target's true speed [m/s] and heading [rad], which only
    /// reading C of the paper's model uses.
    Radar,
    /// The platform: turn rate [rad/s]; or that and the velocity of its origin in its own axes
    /// [m/s].
    Gyro,
    /// The platform in the world: x, y [m], yaw [rad]; or these and the velocity in the world
    /// [m/s] and the turn rate [rad/s].
    Pose,
}

impl Sensor {
    /// Number of values that have a covariance: the first ones.
    #[must_use]
    pub fn noisy(self) -> usize {
        match self {
            Self::Lidar => 2,
            Self::Radar | Self::Pose => 3,
            Self::Gyro => 1,
        }
    }
}

/// One measurement. Its values need not be finite: a filter rejects such ones and counts them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SavedMeasurement", into = "SavedMeasurement")]
pub struct Measurement {
    stamp_ns: i64,
    sensor: Sensor,
    values: [f64; MAX_VALUES],
    count: usize,
    covariance: Option<[[f64; 3]; 3]>,
}

/// A measurement as it is saved: stamp, sensor, values, covariance row by row.
type SavedMeasurement = (i64, Sensor, Vec<f64>, Option<Vec<f64>>);

impl From<Measurement> for SavedMeasurement {
    fn from(m: Measurement) -> Self {
        let size = m.noisy();
        let entries = |rows: [[f64; 3]; 3]| {
            rows[..size].iter().flat_map(|row| row[..size].to_vec()).collect()
        };
        (m.stamp_ns, m.sensor, m.values().to_vec(), m.covariance.map(entries))
    }
}

impl TryFrom<SavedMeasurement> for Measurement {
    type Error = Error;

    fn try_from((stamp_ns, sensor, values, covariance): SavedMeasurement) -> Result<Self, Error> {
        Self::new(stamp_ns, sensor, &values, covariance.as_deref())
    }
}

impl Measurement {
    /// A measurement; without `covariance`, row by row, the filter's configuration has it.
    ///
    /// # Errors
    /// [`Error::Length`] for a number of values that the sensor does not have, [`Error::Value`]
    /// for a covariance where none is used or that is not positive definite.
    pub fn new(
        stamp_ns: i64,
        sensor: Sensor,
        values: &[f64],
        covariance: Option<&[f64]>,
    ) -> Result<Self, Error> {
        let allowed: [usize; 2] = match sensor {
            Sensor::Lidar => [2, 2],
            Sensor::Radar => [3, 5],
            Sensor::Gyro => [1, 3],
            Sensor::Pose => [3, 6],
        };
        if !allowed.contains(&values.len()) {
            let expected = allowed[0];
            return Err(Error::Length { name: "values", expected, got: values.len() });
        }
        let mut padded = [0.0; MAX_VALUES];
        padded[..values.len()].copy_from_slice(values);
        let covariance = covariance.map(|entries| checked(sensor, entries)).transpose()?;
        Ok(Self { stamp_ns, sensor, values: padded, count: values.len(), covariance })
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

    /// The values, as many as the sensor gave.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.values[..self.count]
    }

    /// Covariance of the first values, as many as [`Self::noisy`] says.
    #[must_use]
    pub fn covariance(&self) -> Option<&[[f64; 3]; 3]> {
        self.covariance.as_ref()
    }

    /// The measurement with independent errors of these variances, as many as [`Self::noisy`] says.
    pub(in crate::fusion) fn with_variances(&self, variances: &[f64]) -> Self {
        let mut rows = [[0.0; 3]; 3];
        for (index, variance) in variances.iter().enumerate() {
            rows[index][index] = *variance;
        }
        Self { covariance: Some(rows), ..*self }
    }

    /// Number of values that have a covariance.
    #[must_use]
    pub fn noisy(&self) -> usize {
        self.sensor.noisy()
    }

    /// True if the values can be used: all are finite, and a range is positive.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        self.values().iter().all(|value| value.is_finite())
            && (self.sensor != Sensor::Radar || self.values[0] > 0.0)
    }

    pub(super) fn matrix2(&self) -> Option<Matrix2<f64>> {
        self.covariance.map(|rows| Matrix2::new(rows[0][0], rows[0][1], rows[1][0], rows[1][1]))
    }

    pub(super) fn matrix3(&self) -> Option<Matrix3<f64>> {
        self.covariance.map(|rows| Matrix3::from_fn(|row, column| rows[row][column]))
    }
}

fn checked(sensor: Sensor, entries: &[f64]) -> Result<[[f64; 3]; 3], Error> {
    let size = sensor.noisy();
    if entries.len() != size * size {
        let name = "covariance";
        return Err(Error::Length { name, expected: size * size, got: entries.len() });
    }
    let at = |row: usize, column: usize| entries[row * size + column];
    let symmetric = |row: usize, column: usize| {
        let scale = libm::sqrt((at(row, row) * at(column, column)).abs());
        (at(row, column) - at(column, row)).abs() <= 1e-9 * scale
    };
    let mut rows = [[0.0; 3]; 3];
    let mut filled = Matrix3::identity();
    for row in 0..size {
        for column in 0..size {
            let value = 0.5 * (at(row, column) + at(column, row));
            (rows[row][column], filled[(row, column)]) = (value, value);
            if !symmetric(row, column) {
                return Err(refused(row, entries));
            }
        }
    }
    if entries.iter().all(|entry| entry.is_finite()) && filled.cholesky().is_some() {
        return Ok(rows);
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
        let of = |sensor, count: usize| Measurement::new(0, sensor, &[1.0; 6][..count], None);
        for (sensor, counts) in [
            (Sensor::Lidar, vec![2]),
            (Sensor::Radar, vec![3, 5]),
            (Sensor::Gyro, vec![1, 3]),
            (Sensor::Pose, vec![3, 6]),
        ] {
            for count in 0..=6 {
                assert_eq!(
                    of(sensor, count).is_ok(),
                    counts.contains(&count),
                    "{sensor:?} {count}"
                );
            }
        }
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

    #[test]
    fn what_is_not_finite_or_has_no_range_cannot_be_used() -> Result<(), Error> {
        assert!(!Measurement::new(0, Sensor::Lidar, &[f64::NAN, 0.0], None)?.is_usable());
        assert!(!Measurement::new(0, Sensor::Radar, &[0.0, 0.0, 0.0], None)?.is_usable());
        assert!(Measurement::new(0, Sensor::Radar, &[0.1, 0.0, 0.0], None)?.is_usable());
        Ok(())
    }
}
