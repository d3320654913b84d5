//! Measurement models in the plane: expected measurement of a state, and its Jacobian.

#![allow(non_snake_case)] // textbook letters

use super::line_of_sight::{LineOfSight, into_sensor};
use super::measurement::{Measurement, PolarValues, Sensor};
use super::observation::{Observation, levelled};
use super::sensing::Sensing;
use super::sight::{Observer, SeenIn, SeenValues, Sights, observe_part};
use crate::fusion::models::motion::{First, PlaneMotion};
use crate::fusion::models::platform::{Platform, SensorPose};
use crate::fusion::models::turn::{direction, rotated, wrapped};
use crate::fusion::models::world::Plane;
use nalgebra::{Matrix1, Matrix2, Matrix3, Matrix4};
use nalgebra::{SMatrix, SVector, Vector1, Vector2, Vector3};

/// A measured position in the plane, compared with a state.
struct PlaceSeen<'a, const N: usize, M> {
    sight: LineOfSight<'a, N, M>,
    z: Vector2<f64>,
    R: Matrix2<f64>,
}

/// Measured range, bearing and range rate in the plane, compared with a state.
struct PolarSeen<'a, const N: usize, M> {
    sight: LineOfSight<'a, N, M>,
    z: Vector3<f64>,
    R: Matrix3<f64>,
}

/// A measured turn rate of the platform, compared with the state that is this turn rate.
struct RateSeen {
    index: usize,
    state: f64,
    z: f64,
    R: f64,
}

impl<const N: usize, M: PlaneMotion<N>> SeenValues<N, 2> for PlaceSeen<'_, N, M> {
    fn measured(&self) -> Vector2<f64> {
        self.z
    }

    fn expected(&self, s: &SVector<f64, N>) -> Vector2<f64> {
        self.sight.of(s).position
    }

    fn linear(&self) -> (Vector2<f64>, SMatrix<f64, 2, N>) {
        self.sight.place()
    }

    fn minus(&self, a: &Vector2<f64>, b: &Vector2<f64>) -> Vector2<f64> {
        a - b
    }

    fn noise(&self) -> Matrix2<f64> {
        self.sight.place_noise(self.R)
    }
}

impl<const N: usize, M: PlaneMotion<N>> SeenValues<N, 3> for PolarSeen<'_, N, M> {
    fn measured(&self) -> Vector3<f64> {
        self.z
    }

    fn expected(&self, s: &SVector<f64, N>) -> Vector3<f64> {
        self.sight.of(s).polar()
    }

    fn linear(&self) -> (Vector3<f64>, SMatrix<f64, 3, N>) {
        self.sight.polar_jacobian()
    }

    fn minus(&self, a: &Vector3<f64>, b: &Vector3<f64>) -> Vector3<f64> {
        polar_difference(a, b)
    }

    fn noise(&self) -> Matrix3<f64> {
        self.sight.polar_noise(self.R)
    }
}

impl<const N: usize> SeenValues<N, 1> for RateSeen {
    fn measured(&self) -> Vector1<f64> {
        Vector1::new(self.z)
    }

    fn expected(&self, s: &SVector<f64, N>) -> Vector1<f64> {
        Vector1::new(s[self.index])
    }

    fn linear(&self) -> (Vector1<f64>, SMatrix<f64, 1, N>) {
        let mut H = SMatrix::<f64, 1, N>::zeros();
        H[self.index] = 1.0;
        (Vector1::new(self.state), H)
    }

    fn minus(&self, a: &Vector1<f64>, b: &Vector1<f64>) -> Vector1<f64> {
        a - b
    }

    fn noise(&self) -> Matrix1<f64> {
        Matrix1::new(self.R)
    }
}

impl<const N: usize, M: PlaneMotion<N>> SeenIn<N, M> for Plane {
    #[inline]
    fn see<T: Observer<N>>(
        motion: &M,
        s: &SVector<f64, N>,
        m: &Measurement,
        sensing: &Sensing,
        platform: &Platform,
        observer: T,
    ) -> Option<T::Output> {
        // A model without this state takes the turn rate from the platform, as an input.
        if m.sensor() == Sensor::Gyro && M::PLATFORM_RATE.is_none() {
            return None;
        }
        let sensor = platform.sensor_at(m.stamp_ns());
        let sight = LineOfSight::new(motion, s, platform, sensor.as_ref());
        match sensing.observation(m, sight.range())? {
            Observation::Position { z, R } => Some(observer.observe(&PlaceSeen { sight, z, R })),
            Observation::Polar { z, R } => Some(observer.observe(&PolarSeen { sight, z, R })),
            Observation::Part { z, R, rows: (rows, count) } => {
                observe_part(&PolarSeen { sight, z, R }, &rows[..count], observer)
            }
            Observation::Rate { z, R } => {
                let index = M::PLATFORM_RATE?;
                Some(observer.observe(&RateSeen { index, state: s[index], z, R }))
            }
        }
    }
}

impl Sights for Plane {
    fn first_sight(
        m: &Measurement,
        sensing: &Sensing,
        platform: &Platform,
        with_noise: bool,
    ) -> Option<First> {
        let sensor = platform.sensor_at(m.stamp_ns());
        let mut first = first_sight(m, sensor.as_ref())?;
        if with_noise {
            first.noise = position_noise(m, sensing, sensor.as_ref());
        }
        Some(first)
    }
}

/// Difference of two polar measurements, the bearing wrapped.
#[must_use]
pub fn polar_difference(z: &Vector3<f64>, expected: &Vector3<f64>) -> Vector3<f64> {
    let y = z - expected;
    Vector3::new(y[0], wrapped(y[1]), y[2])
}

/// Covariance of the position of a LiDAR or radar measurement, in the axes of the world if the
/// sensor has a pose there; None for a measurement of no position.
fn position_noise(
    m: &Measurement,
    sensing: &Sensing,
    sensor: Option<&SensorPose>,
) -> Option<Matrix3<f64>> {
    // A range of zero asks for a position whatever the sensor measures.
    let Observation::Position { R, .. } = sensing.observation(m, 0.0)? else { return None };
    let into = sensor.map_or_else(Matrix2::identity, into_sensor);
    let R = into.transpose() * R * into;
    let off = 0.5 * (R[(0, 1)] + R[(1, 0)]); // the two products round differently
    Some(Matrix3::new(R[(0, 0)], off, 0.0, off, R[(1, 1)], 0.0, 0.0, 0.0, 0.0))
}

/// First sight of a target by a measurement, in the world if the sensor has a pose there.
fn first_sight(m: &Measurement, sensor: Option<&SensorPose>) -> Option<First> {
    let v = m.values();
    let mut first = match m.sensor() {
        Sensor::Lidar => First { position: [v[0], v[1], 0.0], ..First::default() },
        Sensor::Radar => {
            let measures = m.measures();
            if !(measures.has(PolarValues::RANGE) && measures.has(PolarValues::BEARING)) {
                return None;
            }
            let (range, bearing, rate) = if measures == PolarValues::FLAT {
                (v[0], v[1], v[2])
            } else {
                let (z, _) = levelled(m, &Matrix4::zeros())?;
                (z[0], z[1], z[2])
            };
            let [cosine, sine] = direction(bearing);
            First {
                position: [range * cosine, range * sine, 0.0],
                speed: rate,
                heading: bearing,
                ..First::default()
            }
        }
        Sensor::Gyro | Sensor::Pose | Sensor::SpacePose => return None,
    };
    if let Some(sensor) = sensor {
        let [x, y, _] = first.position;
        let [x, y] = rotated(sensor.heading, [x, y]);
        first.position = [x + sensor.position[0], y + sensor.position[1], 0.0];
        let along = direction(first.heading);
        let own = rotated([sensor.heading[0], -sensor.heading[1]], sensor.velocity);
        first.heading += libm::atan2(sensor.heading[1], sensor.heading[0]);
        if m.sensor() == Sensor::Radar && m.measures().has(PolarValues::RANGE_RATE) {
            first.speed += along[0] * own[0] + along[1] * own[1]; // over ground
        }
    }
    Some(first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::models::drone::{CtrvDrone, CtrvDroneRate};
    use crate::fusion::models::heading::Ctrv;
    use crate::fusion::models::motion::Motion;
    use crate::fusion::models::motion::tests::difference;
    use crate::fusion::models::platform::Pose;
    use nalgebra::{Vector5, Vector6};

    fn check<const N: usize, M: PlaneMotion<N>>(
        motion: &M,
        s: &SVector<f64, N>,
        platform: &Platform,
    ) {
        let sensor = platform.sensor_at(100_000_000);
        let sensor = sensor.as_ref();
        let expected = difference(s, |s| LineOfSight::new(motion, s, platform, sensor).polar());
        let sight = LineOfSight::new(motion, s, platform, sensor);
        let (_, J) = sight.polar_jacobian();
        assert!((J - expected).abs().max() < 1e-8, "{J} {expected}");
        let (_, J) = sight.place();
        let expected = difference(s, |s| LineOfSight::new(motion, s, platform, sensor).place().0);
        assert!((J - expected).abs().max() < 1e-8);
    }

    #[test]
    fn jacobians_agree_with_differences() {
        let lever = [0.3, -0.2, 0.0];
        let moving = Platform { rate: 0.8, velocity: [2.0, 1.0], lever, ..Platform::still() };
        let s = Vector5::new(4.0, -2.0, 2.0, 2.5, 0.3);
        check(&Ctrv, &s, &Platform::still());
        check(&CtrvDrone, &s, &moving);
        check(&CtrvDroneRate, &Vector6::new(4.0, -2.0, 2.0, 2.5, 0.3, 0.8), &moving);
        let (position, velocity) = ([5.0, 1.0], [1.0, -2.0]);
        let pose = Pose { stamp_ns: 0, position, yaw: 0.7, velocity, rate: 0.5, covariance: None };
        check(&Ctrv, &s, &Platform { pose: Some(pose), ..moving });
    }

    /// A pose with a covariance adds that times its Jacobian, here by differences.
    #[test]
    fn noise_of_a_pose_agrees_with_differences() {
        let covariance = Matrix3::new(0.3, 0.1, 0.02, 0.1, 0.2, -0.01, 0.02, -0.01, 0.05);
        let s = Vector5::new(4.0, -2.0, 2.0, 2.5, 0.3);
        let platform = |at: &Vector3<f64>| {
            let (position, velocity) = ([at[0], at[1]], [1.0, -2.0]);
            let covariance = Some(covariance);
            let pose = Pose { stamp_ns: 0, position, yaw: at[2], velocity, rate: 0.5, covariance };
            Platform { pose: Some(pose), lever: [0.3, -0.2, 0.0], ..Platform::still() }
        };
        let sensor = |at: &Vector3<f64>| platform(at).sensor_at(100_000_000);
        let still = Platform::still();
        let seen = |at: &Vector3<f64>| {
            let sensor = sensor(at);
            let sight = LineOfSight::new(&Ctrv, &s, &still, sensor.as_ref());
            (sight.place().0, sight.polar())
        };
        let at = Vector3::new(5.0, 1.0, 0.7);
        let (by_place, by_polar) =
            (difference(&at, |at| seen(at).0), difference(&at, |at| seen(at).1));
        let told = sensor(&at);
        let sight = LineOfSight::new(&Ctrv, &s, &still, told.as_ref());
        let place = sight.place_noise(Matrix2::identity()) - Matrix2::identity();
        assert!((place - by_place * covariance * by_place.transpose()).abs().max() < 1e-7);
        let polar = sight.polar_noise(Matrix3::identity()) - Matrix3::identity();
        assert!((polar - by_polar * covariance * by_polar.transpose()).abs().max() < 1e-7);
    }

    /// The range rate is the derivative of the range along the motion.
    #[test]
    fn range_rate_is_how_the_range_changes() {
        let lever = [0.3, -0.2, 0.0];
        let moving = Platform { rate: 0.8, velocity: [2.0, 1.0], lever, ..Platform::still() };
        let s = Vector5::new(4.0, -2.0, 2.0, 2.5, 0.3);
        let range = |dt| {
            LineOfSight::new(&CtrvDrone, &CtrvDrone.propagate(&s, dt, &moving), &moving, None)
                .range()
        };
        let rate = (range(1e-5) - range(-1e-5)) / 2e-5;
        assert!((LineOfSight::new(&CtrvDrone, &s, &moving, None).polar()[2] - rate).abs() < 1e-8);
    }

    #[test]
    fn a_first_sight_is_what_the_sensor_would_measure() -> Result<(), crate::Error> {
        let (position, velocity) = ([5.0, 1.0], [1.0, -2.0]);
        let pose = Pose { stamp_ns: 0, position, yaw: 0.7, velocity, rate: 0.0, covariance: None };
        let platform = Platform { pose: Some(pose), ..Platform::still() };
        let sensor = platform.sensor_at(0);
        let m = Measurement::new(0, Sensor::Radar, &[3.0, 0.4, 1.5], None)?;
        let first = first_sight(&m, sensor.as_ref()).unwrap_or_default();
        let [x, y, _] = first.position;
        let s = Vector5::new(x, y, first.speed, first.heading, 0.0);
        let polar = LineOfSight::new(&Ctrv, &s, &platform, sensor.as_ref()).polar();
        assert!((polar - Vector3::new(3.0, 0.4, 1.5)).abs().max() < 1e-12);
        Ok(())
    }
}
