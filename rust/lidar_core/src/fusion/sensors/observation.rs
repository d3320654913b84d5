//! Forms in which measurements correct a state in the plane, and their noise.

#![allow(non_snake_case)] // textbook letters

use super::measurement::{Measurement, PolarValues, Sensor};
use super::sensing::Sensing;
use crate::fusion::models::turn::direction;
use nalgebra::{Matrix2, Matrix3, Matrix3x4, Matrix4, Vector2, Vector3};

/// Cosine of an elevation below which a target is above the sensor, without a bearing.
const OVERHEAD: f64 = 1e-6;

/// A measurement in the form that corrects a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Observation {
    /// Position in the frame of the sensor.
    Position {
        /// Measured position [m].
        z: Vector2<f64>,
        /// Covariance of the measured values.
        R: Matrix2<f64>,
    },
    /// Range, bearing and range rate.
    Polar {
        /// Measured range [m], bearing [rad] and range rate [m/s].
        z: Vector3<f64>,
        /// Covariance of the measured values.
        R: Matrix3<f64>,
    },
    /// Some of range, bearing and range rate.
    Part {
        /// Range [m], bearing [rad] and range rate [m/s]; zero for values that are not measured.
        z: Vector3<f64>,
        /// Covariance of the values; zero for values that are not measured.
        R: Matrix3<f64>,
        /// Which of the three are measured, and how many.
        rows: ([usize; 3], usize),
    },
    /// Turn rate of the platform.
    Rate {
        /// Measured turn rate [rad/s].
        z: f64,
        /// Variance of the turn rate [rad^2/s^2].
        R: f64,
    },
}

impl Sensing {
    /// Form in which `m` corrects a state in the plane at a distance of `range` [m]; None for a
    /// measurement without information about it.
    #[must_use]
    #[inline]
    pub fn observation(&self, m: &Measurement, range: f64) -> Option<Observation> {
        let v = m.values();
        match m.sensor() {
            Sensor::Lidar => {
                Some(Observation::Position { z: Vector2::new(v[0], v[1]), R: self.lidar_noise(m) })
            }
            Sensor::Radar if m.measures() != PolarValues::FLAT => self.in_parts(m, range),
            Sensor::Radar if self.convert_radar || range < self.range_min => {
                Some(converted(v, &self.radar_noise(m)))
            }
            Sensor::Radar => Some(Observation::Polar {
                z: Vector3::new(v[0], v[1], v[2]),
                R: self.radar_noise(m),
            }),
            Sensor::Gyro => Some(Observation::Rate { z: v[0], R: self.gyro_variance(m) }),
            Sensor::Pose | Sensor::SpacePose => None,
        }
    }

    /// Observation of a radar that measures other values than range, bearing and range rate.
    fn in_parts(&self, m: &Measurement, range: f64) -> Option<Observation> {
        let measures = m.measures();
        let (z, R) = levelled(m, &self.all_radar_noise(m))?;
        let given = [PolarValues::RANGE, PolarValues::BEARING, PolarValues::RANGE_RATE];
        let given = given.map(|place| measures.has(place));
        if given[0] && given[1] && (self.convert_radar || range < self.range_min) {
            return Some(converted(z.as_slice(), &R));
        }
        if given.iter().all(|given| *given) {
            return Some(Observation::Polar { z, R });
        }
        let (mut rows, mut count) = ([0; 3], 0);
        for row in (0..3).filter(|row| given[*row]) {
            (rows[count], count) = (row, count + 1);
        }
        let can_be_compared = !self.convert_radar && range >= self.range_min && count > 0;
        can_be_compared.then_some(Observation::Part { z, R, rows: (rows, count) })
    }

    /// Variances of the values of a LiDAR or radar measurement, as many as the sensor has.
    #[must_use]
    pub fn variances(&self, m: &Measurement) -> [f64; 4] {
        let places = m.measures().places();
        std::array::from_fn(|k| {
            let configured = match m.sensor() {
                _ if k >= m.noisy() => 0.0,
                Sensor::Lidar => self.lidar[k],
                Sensor::Radar => self.radar[places[k]],
                Sensor::Gyro | Sensor::Pose | Sensor::SpacePose => 0.0,
            };
            if k < m.noisy() { m.variance(k).unwrap_or(configured) } else { configured }
        })
    }

    fn lidar_noise(&self, m: &Measurement) -> Matrix2<f64> {
        let [x, y, _] = self.lidar;
        m.covariance().unwrap_or_else(|| Matrix2::from_diagonal(&Vector2::new(x, y)))
    }

    fn radar_noise(&self, m: &Measurement) -> Matrix3<f64> {
        let [range, bearing, _, rate] = self.radar;
        m.covariance().unwrap_or_else(|| Matrix3::from_diagonal(&[range, bearing, rate].into()))
    }

    /// Covariance of range, bearing, elevation and range rate; zero for values that are not
    /// measured.
    pub(super) fn all_radar_noise(&self, m: &Measurement) -> Matrix4<f64> {
        let (places, count) = (m.measures().places(), m.measures().count());
        let own = m.covariance::<4>();
        let mut R = Matrix4::zeros();
        for (row, column) in (0..count).flat_map(|row| (0..count).map(move |c| (row, c))) {
            let configured = if row == column { self.radar[places[row]] } else { 0.0 };
            let told = own.map_or(configured, |own| own[(row, column)]);
            R[(places[row], places[column])] = told;
        }
        R
    }
}

/// All four values of a radar; zero for values that it does not measure.
pub(super) fn all_values(m: &Measurement) -> [f64; 4] {
    let mut all = [0.0; 4];
    for (place, value) in m.measures().places().into_iter().zip(m.values()) {
        all[place] = *value;
    }
    all
}

/// Range, bearing and range rate in the plane of a radar's values, and their covariance. A target
/// and a sensor that keep their heights are assumed; None for a target above the sensor.
pub(super) fn levelled(m: &Measurement, R: &Matrix4<f64>) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let [range, bearing, elevation, rate] = all_values(m);
    let [c, sine] = direction(elevation);
    if c < OVERHEAD {
        return None;
    }
    let T = Matrix3x4::new(
        c,
        0.0,
        -range * sine,
        0.0, //
        0.0,
        1.0,
        0.0,
        0.0, //
        0.0,
        0.0,
        rate * sine / (c * c),
        1.0 / c,
    );
    let R = T * R * T.transpose();
    Some((Vector3::new(range * c, bearing, rate / c), (R + R.transpose()) * 0.5))
}

/// Position of a radar's range and bearing, with its covariance.
fn converted(values: &[f64], R: &Matrix3<f64>) -> Observation {
    let [cosine, sine] = direction(values[1]);
    let range = values[0];
    let T = Matrix2::new(cosine, -range * sine, sine, range * cosine);
    let R = T * R.fixed_view::<2, 2>(0, 0) * T.transpose();
    // The two products round differently on both sides of the diagonal.
    let R = (R + R.transpose()) * 0.5;
    Observation::Position { z: Vector2::new(range * cosine, range * sine), R }
}
