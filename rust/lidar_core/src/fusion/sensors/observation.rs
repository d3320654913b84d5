//! Measurement models: expected measurement of a state, and its Jacobian.

#![allow(non_snake_case)] // textbook letters

use super::measurement::{Measurement, PolarValues, Sensor};
use super::sensing::Sensing;
use super::sight::{Observer, SeenIn, SeenValues, Sights, observe_part};
use crate::fusion::models::motion::{First, PlaneMotion};
use crate::fusion::models::platform::{Platform, SensorPose};
use crate::fusion::models::turn::{direction, rotated, wrapped};
use crate::fusion::models::world::Plane;
use nalgebra::{Matrix1, Matrix2, Matrix2x3, Matrix3, Matrix3x2, Matrix3x4, Matrix4};
use nalgebra::{SMatrix, SVector, Vector1, Vector2, Vector3};

/// Ranges below this have no bearing [m].
pub(super) const NEAREST: f64 = 1e-9;
/// Cosine of an elevation below which a target is above the sensor, without a bearing.
const OVERHEAD: f64 = 1e-6;

/// A measurement in the form that corrects a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Observation {
    /// Position in the frame of the sensor.
    Position {
        /// Measured [m].
        z: Vector2<f64>,
        /// Its covariance.
        R: Matrix2<f64>,
    },
    /// Range, bearing and range rate.
    Polar {
        /// Measured.
        z: Vector3<f64>,
        /// Its covariance.
        R: Matrix3<f64>,
    },
    /// Some of range, bearing and range rate.
    Part {
        /// Measured; zero what is not.
        z: Vector3<f64>,
        /// Its covariance; zero of what is not measured.
        R: Matrix3<f64>,
        /// Which of the three are measured, and how many.
        rows: ([usize; 3], usize),
    },
    /// Turn rate of the platform.
    Rate {
        /// Measured [rad/s].
        z: f64,
        /// Its variance.
        R: f64,
    },
}

/// A state relative to the sensor.
pub struct LineOfSight<'a, const N: usize, M> {
    motion: &'a M,
    state: &'a SVector<f64, N>,
    platform: &'a Platform,
    sensor: Option<&'a SensorPose>,
    /// In the frame of the sensor [m].
    position: Vector2<f64>,
}

impl<'a, const N: usize, M: PlaneMotion<N>> LineOfSight<'a, N, M> {
    /// State `s` relative to a sensor in the world, or in the sensor's own frame if there is none.
    pub fn new(
        motion: &'a M,
        state: &'a SVector<f64, N>,
        platform: &'a Platform,
        sensor: Option<&'a SensorPose>,
    ) -> Self {
        let position = Vector2::new(state[0], state[1]);
        let position = sensor.map_or(position, |sensor| {
            into_sensor(sensor) * (position - Vector2::from(sensor.position))
        });
        Self { motion, state, platform, sensor, position }
    }

    /// The same of another state.
    fn of(&self, state: &'a SVector<f64, N>) -> Self {
        Self::new(self.motion, state, self.platform, self.sensor)
    }

    /// Expected position and its Jacobian.
    #[inline]
    #[must_use]
    pub fn place(&self) -> (Vector2<f64>, SMatrix<f64, 2, N>) {
        let mut by_position = SMatrix::<f64, 2, N>::zeros();
        let back = self.sensor.map_or_else(Matrix2::identity, into_sensor);
        by_position.fixed_view_mut::<2, 2>(0, 0).copy_from(&back);
        (self.position, by_position)
    }

    /// Velocity relative to the sensor in its frame, and its Jacobian.
    #[inline]
    fn velocity(&self) -> (Vector2<f64>, SMatrix<f64, 2, N>) {
        let (velocity, by_state) = self.motion.velocity(self.state, self.platform);
        let Some(sensor) = self.sensor else { return (velocity, by_state) };
        let back = into_sensor(sensor);
        (back * (velocity - Vector2::from(sensor.velocity)), back * by_state)
    }

    /// Expected range, bearing and range rate.
    #[inline]
    #[must_use]
    pub fn polar(&self) -> Vector3<f64> {
        polar_of(self.position, self.velocity().0)
    }

    /// Expected range, bearing and range rate, and their Jacobian; the range must not be zero.
    #[inline]
    #[must_use]
    pub fn polar_jacobian(&self) -> (Vector3<f64>, SMatrix<f64, 3, N>) {
        let (p, (v, by_velocity)) = (self.position, self.velocity());
        let (mut by_position, ahead) = polar_slopes(p, v);
        if let Some(sensor) = self.sensor {
            by_position *= into_sensor(sensor);
        }
        let mut J = SMatrix::<f64, 3, N>::zeros();
        J.fixed_view_mut::<3, 2>(0, 0).copy_from(&by_position);
        for (column, by) in J.data.0.iter_mut().zip(&by_velocity.data.0) {
            column[2] += ahead[0] * by[0] + ahead[1] * by[1];
        }
        (polar_of(p, v), J)
    }

    /// Covariance of a measured position: `R` plus the contribution of the platform's pose.
    #[inline]
    #[must_use]
    pub fn place_noise(&self, R: Matrix2<f64>) -> Matrix2<f64> {
        let Some((by_pose, _, P)) = self.by_pose() else { return R };
        R + by_pose * P * by_pose.transpose()
    }

    /// Covariance of range, bearing and range rate: `R` plus the contribution of the platform's
    /// pose. The range must not be zero.
    #[inline]
    #[must_use]
    pub fn polar_noise(&self, R: Matrix3<f64>) -> Matrix3<f64> {
        let Some((position_by, velocity_by, P)) = self.by_pose() else { return R };
        let (by_position, ahead) = polar_slopes(self.position, self.velocity().0);
        let mut by_pose = by_position * position_by;
        let rate = by_pose.row(2) + Vector2::from(ahead).transpose() * velocity_by;
        by_pose.set_row(2, &rate);
        R + by_pose * P * by_pose.transpose()
    }

    /// Jacobians of position and velocity in the frame of the sensor with respect to x, y and yaw
    /// of the platform, and the covariance of these. None for an exact pose.
    #[inline]
    fn by_pose(&self) -> Option<(Matrix2x3<f64>, Matrix2x3<f64>, Matrix3<f64>)> {
        let sensor = self.sensor?;
        let covariance = sensor.covariance?;
        let (back, [lx, ly]) = (into_sensor(sensor), sensor.lever);
        let away = self.position + Vector2::new(lx, ly); // of the platform's origin
        let passing = self.velocity().0 + Vector2::new(-ly, lx) * sensor.rate;
        let mut position_by = Matrix2x3::zeros();
        position_by.fixed_view_mut::<2, 2>(0, 0).copy_from(&-back);
        position_by.set_column(2, &Vector2::new(away.y, -away.x));
        let mut velocity_by = Matrix2x3::zeros();
        velocity_by.set_column(2, &Vector2::new(passing.y, -passing.x));
        Some((position_by, velocity_by, covariance))
    }

    /// Distance from the sensor [m].
    #[must_use]
    pub fn range(&self) -> f64 {
        self.position.norm()
    }
}

/// Jacobian of range, bearing and range rate by the position, and of the range rate by the
/// velocity.
#[inline]
fn polar_slopes(p: Vector2<f64>, v: Vector2<f64>) -> (Matrix3x2<f64>, [f64; 2]) {
    let square = p.x * p.x + p.y * p.y;
    let range = libm::sqrt(square);
    let across = (p.x * v.y - p.y * v.x) / (square * range);
    let ahead = [p.x / range, p.y / range];
    // Derivative of the range rate: the velocity across the line of sight becomes velocity along it
    // as the line turns.
    let by_position = Matrix3x2::new(
        ahead[0],
        ahead[1], //
        -p.y / square,
        p.x / square, //
        -p.y * across,
        p.x * across,
    );
    (by_position, ahead)
}

/// Rotation from the world's axes into those of the sensor.
fn into_sensor(sensor: &SensorPose) -> Matrix2<f64> {
    let [c, sine] = sensor.heading;
    Matrix2::new(c, sine, -sine, c)
}

/// Range, bearing and range rate of a position and a velocity.
fn polar_of(p: Vector2<f64>, v: Vector2<f64>) -> Vector3<f64> {
    let range = libm::sqrt(p.x * p.x + p.y * p.y).max(NEAREST);
    Vector3::new(range, libm::atan2(p.y, p.x), (p.x * v.x + p.y * v.y) / range)
}

/// A position in the plane.
struct PlaceSeen<'a, const N: usize, M> {
    sight: LineOfSight<'a, N, M>,
    z: Vector2<f64>,
    R: Matrix2<f64>,
}

/// Range, bearing and range rate in the plane.
struct PolarSeen<'a, const N: usize, M> {
    sight: LineOfSight<'a, N, M>,
    z: Vector3<f64>,
    R: Matrix3<f64>,
}

/// The turn rate of the platform, which is one of the states.
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

impl Sensing {
    /// Form in which `m` corrects a state in the plane at a distance of `range` [m]; None for a
    /// measurement that tells nothing about it.
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

    /// The same of a radar that does not measure just range, bearing and range rate.
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

    /// Covariance of range, bearing, elevation and range rate; zero for what is not measured.
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

/// All four values of a radar; zero what it does not measure.
pub(super) fn all_values(m: &Measurement) -> [f64; 4] {
    let mut all = [0.0; 4];
    for (place, value) in m.measures().places().into_iter().zip(m.values()) {
        all[place] = *value;
    }
    all
}

/// Range, bearing and range rate in the plane of a radar's values, and their covariance. A target
/// and a sensor that keep their heights are assumed; None for a target above the sensor.
fn levelled(m: &Measurement, R: &Matrix4<f64>) -> Option<(Vector3<f64>, Matrix3<f64>)> {
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
            LineOfSight::new(&CtrvDrone, &CtrvDrone.moved(&s, dt, &moving), &moving, None).range()
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
