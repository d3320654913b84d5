//! Measurement models in space: positions, and some of range, bearing, elevation and range rate.

#![allow(non_snake_case)] // textbook letters

use super::line_of_sight::NEAREST;
use super::measurement::{Measurement, PolarValues, Sensor};
use super::observation::all_values;
use super::sensing::Sensing;
use super::sight::{Observer, SeenIn, SeenValues, Sights, observe_part};
use crate::fusion::models::motion::{First, SpaceMotion};
use crate::fusion::models::platform::Platform;
use crate::fusion::models::space_pose::{SpaceSensorPose, crossed};
use crate::fusion::models::turn::{direction, wrapped};
use crate::fusion::models::world::Space;
use nalgebra::{Matrix3, Matrix3x6, Matrix4, Matrix4x3, Matrix6, SMatrix, SVector};
use nalgebra::{RowVector3, Vector3, Vector4};

/// A state relative to the sensor.
struct SpaceSight<'a, const N: usize, M> {
    motion: &'a M,
    state: &'a SVector<f64, N>,
    sensor: Option<&'a SpaceSensorPose>,
    /// Position of the target in the frame of the sensor [m].
    position: Vector3<f64>,
}

impl<'a, const N: usize, M: SpaceMotion<N>> SpaceSight<'a, N, M> {
    /// State `s` relative to a sensor in the world, or in the sensor's own frame if there is none.
    fn new(motion: &'a M, state: &'a SVector<f64, N>, sensor: Option<&'a SpaceSensorPose>) -> Self {
        let place = Vector3::new(state[0], state[1], state[2]);
        let position = sensor.map_or(place, |sensor| sensor.into * (place - sensor.position));
        Self { motion, state, sensor, position }
    }

    /// Velocity relative to the sensor in its frame, and its Jacobian.
    fn velocity(&self) -> (Vector3<f64>, SMatrix<f64, 3, N>) {
        let (velocity, by_state) = self.motion.velocity(self.state);
        let Some(sensor) = self.sensor else { return (velocity, by_state) };
        (sensor.into * (velocity - sensor.velocity), sensor.into * by_state)
    }

    fn polar(&self) -> Vector4<f64> {
        polar_of(&self.position, &self.velocity().0)
    }

    /// Jacobian of the position in the frame of the sensor.
    fn by_state(&self) -> SMatrix<f64, 3, N> {
        let into = self.sensor.map_or_else(Matrix3::identity, |sensor| sensor.into);
        let mut by_state = SMatrix::<f64, 3, N>::zeros();
        by_state.fixed_view_mut::<3, 3>(0, 0).copy_from(&into);
        by_state
    }

    /// Jacobians of position and velocity in the frame of the sensor with respect to x, y, z, roll,
    /// pitch and yaw of the platform, and the covariance of these. None for an exact pose.
    fn by_pose(&self) -> Option<(Matrix3x6<f64>, Matrix3x6<f64>, Matrix6<f64>)> {
        let sensor = self.sensor?;
        let covariance = sensor.covariance?;
        let away = self.position + sensor.lever; // of the platform's origin
        let passing = self.velocity().0 + sensor.rates.cross(&sensor.lever);
        let (mut position_by, mut velocity_by) = (Matrix3x6::zeros(), Matrix3x6::zeros());
        position_by.fixed_view_mut::<3, 3>(0, 0).copy_from(&-sensor.into);
        let turned = |v: &Vector3<f64>| crossed(v) * sensor.by_attitude;
        position_by.fixed_view_mut::<3, 3>(0, 3).copy_from(&turned(&away));
        velocity_by.fixed_view_mut::<3, 3>(0, 3).copy_from(&turned(&passing));
        Some((position_by, velocity_by, covariance))
    }
}

/// Range, bearing, elevation and range rate of a position and a velocity.
fn polar_of(p: &Vector3<f64>, v: &Vector3<f64>) -> Vector4<f64> {
    let flat = libm::sqrt(p.x * p.x + p.y * p.y);
    let range = libm::sqrt(p.norm_squared()).max(NEAREST);
    Vector4::new(range, libm::atan2(p.y, p.x), libm::atan2(p.z, flat), p.dot(v) / range)
}

/// Jacobian of range, bearing, elevation and range rate by the position, and of the range rate by the velocity.
fn polar_slopes(p: &Vector3<f64>, v: &Vector3<f64>) -> (Matrix4x3<f64>, RowVector3<f64>) {
    // Above the sensor a target has no bearing; the least distance keeps the Jacobian finite.
    let flat = libm::sqrt(p.x * p.x + p.y * p.y).max(NEAREST);
    let range = libm::sqrt(p.norm_squared()).max(NEAREST);
    let ahead = p / range;
    // The velocity across the line of sight becomes velocity along it as the line turns.
    let across = (v - ahead * ahead.dot(v)) / range;
    let (square, low) = (range * range, flat * flat);
    let rows = [
        ahead.transpose(),
        RowVector3::new(-p.y / low, p.x / low, 0.0),
        RowVector3::new(-p.x * p.z / (flat * square), -p.y * p.z / (flat * square), flat / square),
        across.transpose(),
    ];
    (Matrix4x3::from_rows(&rows), ahead.transpose())
}

/// A measured position in space, compared with a state.
struct SpacePlaceSeen<'a, const N: usize, M> {
    sight: SpaceSight<'a, N, M>,
    z: Vector3<f64>,
    R: Matrix3<f64>,
}

/// Measured range, bearing, elevation and range rate, compared with a state.
struct SpacePolarSeen<'a, const N: usize, M> {
    sight: SpaceSight<'a, N, M>,
    z: Vector4<f64>,
    R: Matrix4<f64>,
}

impl<const N: usize, M: SpaceMotion<N>> SeenValues<N, 3> for SpacePlaceSeen<'_, N, M> {
    fn measured(&self) -> Vector3<f64> {
        self.z
    }

    fn expected(&self, s: &SVector<f64, N>) -> Vector3<f64> {
        SpaceSight::new(self.sight.motion, s, self.sight.sensor).position
    }

    fn linear(&self) -> (Vector3<f64>, SMatrix<f64, 3, N>) {
        (self.sight.position, self.sight.by_state())
    }

    fn minus(&self, a: &Vector3<f64>, b: &Vector3<f64>) -> Vector3<f64> {
        a - b
    }

    fn noise(&self) -> Matrix3<f64> {
        let Some((by_pose, _, P)) = self.sight.by_pose() else { return self.R };
        self.R + by_pose * P * by_pose.transpose()
    }
}

impl<const N: usize, M: SpaceMotion<N>> SeenValues<N, 4> for SpacePolarSeen<'_, N, M> {
    fn measured(&self) -> Vector4<f64> {
        self.z
    }

    fn expected(&self, s: &SVector<f64, N>) -> Vector4<f64> {
        SpaceSight::new(self.sight.motion, s, self.sight.sensor).polar()
    }

    fn linear(&self) -> (Vector4<f64>, SMatrix<f64, 4, N>) {
        let (p, (v, by_velocity)) = (&self.sight.position, self.sight.velocity());
        let (by_position, ahead) = polar_slopes(p, &v);
        let mut J = by_position * self.sight.by_state();
        let rate = J.row(3) + ahead * by_velocity;
        J.set_row(3, &rate);
        (polar_of(p, &v), J)
    }

    fn minus(&self, a: &Vector4<f64>, b: &Vector4<f64>) -> Vector4<f64> {
        let y = a - b;
        Vector4::new(y[0], wrapped(y[1]), wrapped(y[2]), y[3])
    }

    fn noise(&self) -> Matrix4<f64> {
        let Some((position_by, velocity_by, P)) = self.sight.by_pose() else { return self.R };
        let (by_position, ahead) = polar_slopes(&self.sight.position, &self.sight.velocity().0);
        let mut by_pose = by_position * position_by;
        let rate = by_pose.row(3) + ahead * velocity_by;
        by_pose.set_row(3, &rate);
        self.R + by_pose * P * by_pose.transpose()
    }
}

impl<const N: usize, M: SpaceMotion<N>> SeenIn<N, M> for Space {
    fn see<T: Observer<N>>(
        motion: &M,
        s: &SVector<f64, N>,
        m: &Measurement,
        sensing: &Sensing,
        platform: &Platform,
        observer: T,
    ) -> Option<T::Output> {
        let sensor = platform.space_sensor_at(m.stamp_ns());
        let sight = SpaceSight::new(motion, s, sensor.as_ref());
        match m.sensor() {
            Sensor::Lidar => {
                let (z, R) = measured_place(m, sensing);
                let seen = SpacePlaceSeen { sight, z, R };
                if m.values().len() == 2 {
                    return observe_part(&seen, &[0, 1], observer);
                }
                Some(observer.observe(&seen))
            }
            Sensor::Radar => {
                let is_near = sight.position.norm_squared() < sensing.range_min.powi(2);
                if sensing.convert_radar || is_near {
                    let (z, R) = converted(m, sensing)?;
                    return Some(observer.observe(&SpacePlaceSeen { sight, z, R }));
                }
                let (z, R) = (Vector4::from(all_values(m)), sensing.all_radar_noise(m));
                let seen = SpacePolarSeen { sight, z, R };
                let (rows, count) = (m.measures().places(), m.measures().count());
                if count < rows.len() {
                    return observe_part(&seen, &rows[..count], observer);
                }
                Some(observer.observe(&seen))
            }
            Sensor::Gyro | Sensor::Pose | Sensor::SpacePose => None,
        }
    }
}

/// Position of a LiDAR, with its covariance; zero for a height that is not measured.
fn measured_place(m: &Measurement, sensing: &Sensing) -> (Vector3<f64>, Matrix3<f64>) {
    let (mut z, count) = (Vector3::zeros(), m.values().len());
    z.iter_mut().zip(m.values()).for_each(|(own, value)| *own = *value);
    let told = m.covariance::<3>();
    let R = told.unwrap_or_else(|| Matrix3::from_diagonal(&sensing.lidar.into()));
    if count == 3 {
        return (z, R);
    }
    let mut level = Matrix3::zeros();
    level.fixed_view_mut::<2, 2>(0, 0).copy_from(&R.fixed_view::<2, 2>(0, 0));
    (z, level)
}

/// Position of a radar's range, bearing and elevation, with its covariance; None without them.
fn converted(m: &Measurement, sensing: &Sensing) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let needed = [PolarValues::RANGE, PolarValues::BEARING, PolarValues::ELEVATION];
    if !needed.iter().all(|place| m.measures().has(*place)) {
        return None;
    }
    let [range, bearing, elevation, _] = all_values(m);
    let ([c, sine], [flat, up]) = (direction(bearing), direction(elevation));
    let towards = Vector3::new(flat * c, flat * sine, up);
    let T = Matrix3::from_columns(&[
        towards,
        Vector3::new(-flat * sine, flat * c, 0.0) * range,
        Vector3::new(-up * c, -up * sine, flat) * range,
    ]);
    let R = sensing.all_radar_noise(m).fixed_view::<3, 3>(0, 0).into_owned();
    let R = T * R * T.transpose();
    Some((towards * range, (R + R.transpose()) * 0.5))
}

impl Sights for Space {
    fn first_sight(
        m: &Measurement,
        sensing: &Sensing,
        platform: &Platform,
        with_noise: bool,
    ) -> Option<First> {
        let sensor = platform.space_sensor_at(m.stamp_ns());
        let (mut place, mut R) = match m.sensor() {
            Sensor::Lidar if m.values().len() == 3 => measured_place(m, sensing),
            Sensor::Radar => converted(m, sensing)?,
            _ => return None,
        };
        let towards = place / libm::sqrt(place.norm_squared()).max(NEAREST);
        let has_rate = m.sensor() == Sensor::Radar && m.measures().has(PolarValues::RANGE_RATE);
        let mut speed = if has_rate { all_values(m)[PolarValues::RANGE_RATE] } else { 0.0 };
        let mut ahead = towards;
        if let Some(sensor) = &sensor {
            let back = sensor.into.transpose();
            (place, R, ahead) =
                (back * place + sensor.position, back * R * sensor.into, back * towards);
            if has_rate {
                speed += ahead.dot(&sensor.velocity); // over ground
            }
        }
        Some(First {
            position: place.data.0[0],
            speed,
            heading: libm::atan2(ahead.y, ahead.x),
            elevation: libm::atan2(ahead.z, libm::hypot(ahead.x, ahead.y)),
            noise: with_noise.then(|| (R + R.transpose()) * 0.5),
            speed_variance: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::fusion::models::motion::tests::difference;
    use crate::fusion::models::space::{ClimbingCtrv, SpaceVelocity};
    use crate::fusion::models::space_pose::SpacePose;
    use nalgebra::Vector6;

    fn pose(at: &Vector6<f64>) -> SpacePose {
        SpacePose {
            stamp_ns: 0,
            position: at.fixed_rows::<3>(0).into(),
            attitude: at.fixed_rows::<3>(3).into(),
            velocity: Vector3::new(1.0, -2.0, 0.5),
            rates: Vector3::new(0.4, 0.1, -0.7),
            covariance: None,
        }
    }

    fn at() -> Vector6<f64> {
        Vector6::new(5.0, 1.0, 8.0, 0.3, -0.4, 1.9)
    }

    fn sensor(at: &Vector6<f64>) -> SpaceSensorPose {
        pose(at).sensor_at(100_000_000, [0.3, -0.2, 0.5])
    }

    fn seen<'a, const N: usize, M: SpaceMotion<N>>(
        motion: &'a M,
        s: &'a SVector<f64, N>,
        sensor: Option<&'a SpaceSensorPose>,
    ) -> (SpacePlaceSeen<'a, N, M>, SpacePolarSeen<'a, N, M>) {
        let sight = || SpaceSight::new(motion, s, sensor);
        let place = SpacePlaceSeen { sight: sight(), z: Vector3::zeros(), R: Matrix3::zeros() };
        (place, SpacePolarSeen { sight: sight(), z: Vector4::zeros(), R: Matrix4::zeros() })
    }

    fn check<const N: usize, M: SpaceMotion<N>>(motion: &M, s: &SVector<f64, N>) {
        let moving = sensor(&at());
        for sensor in [None, Some(&moving)] {
            let (place, polar) = seen(motion, s, sensor);
            let expected = difference(s, |s| place.expected(s));
            assert!((place.linear().1 - expected).abs().max() < 1e-8);
            let expected = difference(s, |s| polar.expected(s));
            assert!((polar.linear().1 - expected).abs().max() < 1e-8);
        }
    }

    #[test]
    fn jacobians_agree_with_differences() {
        check(&SpaceVelocity, &Vector6::new(4.0, -2.0, 3.0, 2.0, 2.5, 0.3));
        check(&ClimbingCtrv, &SVector::from([4.0, -2.0, 3.0, 2.0, 2.5, 0.3, -0.7]));
    }

    /// A pose with a covariance adds that times its Jacobian, here by differences.
    #[test]
    fn noise_of_a_pose_agrees_with_differences() {
        let root = Matrix6::from_fn(|row, column| 0.1 / (1.0 + (row * 3 + column) as f64));
        let covariance = root * root.transpose();
        let s = Vector6::new(4.0, -2.0, 3.0, 2.0, 2.5, 0.3);
        let told = SpaceSensorPose { covariance: Some(covariance), ..sensor(&at()) };
        let (place, polar) = seen(&SpaceVelocity, &s, Some(&told));
        let by = difference(&at(), |at| seen(&SpaceVelocity, &s, Some(&sensor(at))).0.expected(&s));
        assert!((place.noise() - by * covariance * by.transpose()).abs().max() < 1e-8);
        let by = difference(&at(), |at| seen(&SpaceVelocity, &s, Some(&sensor(at))).1.expected(&s));
        assert!((polar.noise() - by * covariance * by.transpose()).abs().max() < 1e-8);
    }

    /// The range rate is how the range changes while target and sensor move and turn.
    #[test]
    fn range_rate_is_how_the_range_changes() {
        let polar = |ns: i64| {
            let dt = (ns - 100_000_000) as f64 * 1e-9;
            let s = Vector6::new(4.0 + 2.0 * dt, -2.0 + 2.5 * dt, 3.0 + 0.3 * dt, 2.0, 2.5, 0.3);
            let sensor = pose(&at()).sensor_at(ns, [0.3, -0.2, 0.5]);
            SpaceSight::new(&SpaceVelocity, &s, Some(&sensor)).polar()
        };
        let rate = (polar(100_010_000)[0] - polar(99_990_000)[0]) / 2e-5;
        assert!((polar(100_000_000)[3] - rate).abs() < 1e-7);
    }

    #[test]
    fn a_first_sight_is_what_the_sensor_would_measure() -> Result<(), Error> {
        let in_space = Some(Box::new(pose(&at())));
        let platform = Platform { in_space, lever: [0.3, -0.2, 0.5], ..Platform::still() };
        let values = [3.0, 0.4, -0.3, 1.5];
        let m = Measurement::new(100_000_000, Sensor::Radar, &values, None)?;
        let sensing = Sensing::default();
        let first = Space::first_sight(&m, &sensing, &platform, true).unwrap_or_default();
        let ([c, sine], [flat, up]) = (direction(first.heading), direction(first.elevation));
        let v = Vector3::new(flat * c, flat * sine, up) * first.speed;
        let [x, y, z] = first.position;
        let s = Vector6::new(x, y, z, v.x, v.y, v.z);
        let sensor = platform.space_sensor_at(100_000_000);
        let polar = SpaceSight::new(&SpaceVelocity, &s, sensor.as_ref()).polar();
        assert!((polar - Vector4::from(values)).abs().max() < 1e-12);
        let told = first.noise.unwrap_or_else(Matrix3::zeros).symmetric_eigenvalues();
        let own = [0.09, 0.09 * 0.09, 0.09 * 0.09]; // of range, and 3 m times 0.03 rad
        let sum: f64 = own.iter().sum();
        assert!((told.sum() - (0.09 + 0.0081 * (1.0 + 0.3_f64.cos().powi(2)))).abs() < 1e-9 * sum);
        for part in [[true, true, false, true], [false, true, true, false]] {
            let measures = PolarValues::new(part)?;
            let m = Measurement::polar(0, measures, &values[..measures.count()], None)?;
            assert_eq!(Space::first_sight(&m, &sensing, &platform, false), None);
        }
        Ok(())
    }
}
