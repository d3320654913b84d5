//! What one scan brings to the map: circles, from the level frame of its sensor into the world.

#![allow(non_snake_case)] // textbook letters

use super::body::BodyMeasurement;
use super::line::LineMeasurement;
use super::modes::Measurement;
use super::outline::OutlineMeasurement;
use super::parameters::MAX_ELEMENTS;
use super::visibility::{SortedView, View};
use crate::Error;
use crate::circles::circle::{Circle, CircleEstimate};
use crate::circles::polar::turn;
use crate::circles::shape::{ShapeEstimate, ShapeKind};
use crate::geometry::transform::Transform;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

/// Below this share of its normal that points up, a scan has no heights: it is nearly upright.
const UPRIGHT: f64 = 0.05;
/// Relative size of what a covariance may lack to be symmetric or positive.
const ROUNDING: f64 = 1e-9;

/// Longest time between a scan's stamp and one of its circles [s].
const MAX_DELAY: f64 = 10.0;

/// Covariance of a pose: of the translation [m] and of the angles alpha, beta, gamma of
/// `R = Rz(gamma) Ry(beta) Rx(alpha)` [rad].
pub type PoseCovariance = [[f64; 6]; 6];

/// Circles of one scan, in the level frame: origin at the sensor, z up, x where the sensor's x
/// points, seen from above.
#[derive(Clone, Copy, Debug)]
pub struct CircleScan<'a> {
    /// Time of the scan [ns].
    pub stamp_ns: i64,
    /// Which sensor: scans of several may have one stamp.
    pub sensor: u32,
    /// Pose of the sensor.
    pub world_from_lidar: &'a Transform,
    /// How certain it is; None: it is exact.
    pub pose_covariance: Option<&'a PoseCovariance>,
    /// Circles found.
    pub estimates: &'a [CircleEstimate],
    /// When each was measured, after the stamp, -10 to 10 [s]; None: all at the stamp. The filter of the
    /// paper takes them all at the stamp.
    pub delays: Option<&'a [f64]>,
    /// Outlines of those of `estimates` that only stand for something; empty: of none. The filter of
    /// the paper does not heed them.
    pub outlines: &'a [Option<OutlineEstimate>],
    /// Lines found. The filter of the paper knows none.
    pub lines: &'a [ShapeEstimate],
    /// The scan itself; None: all elements should have been measured.
    pub view: Option<View<'a>>,
}

/// What a circle stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutlineEstimate {
    /// An ellipse, a rectangle, or a line: one face of something unknown.
    pub shape: ShapeEstimate,
    /// It is larger than what is reported as a circle.
    pub is_large: bool,
}

/// Pose of the level frame in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LevelPose {
    origin: [f64; 2],
    cos: f64,
    sin: f64,
}

/// Where and when a scan was made, and what it can be asked.
#[derive(Clone, Debug)]
pub(super) struct Viewpoint {
    pub(super) stamp_ns: i64,
    pub(super) sensor: u32,
    pub(super) pose: LevelPose,
    pub(super) view: Option<SortedView>,
}

impl Viewpoint {
    /// Place in the order of scans.
    pub(super) fn key(&self) -> (i64, u32) {
        (self.stamp_ns, self.sensor)
    }
}

/// Objects of one kind, in the world.
#[derive(Clone, Debug)]
pub(super) struct Seen<M> {
    pub(super) measurements: Vec<M>,
    /// Element of each, once the map has taken the scan in.
    pub(super) elements: Vec<Option<i64>>,
}

impl<M> Seen<M> {
    fn new(measurements: Vec<M>) -> Self {
        Self { elements: vec![None; measurements.len()], measurements }
    }
}

/// A scan as the map keeps it.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    pub(super) from: Viewpoint,
    pub(super) bodies: Seen<BodyMeasurement>,
    pub(super) lines: Seen<LineMeasurement>,
}

impl Placed {
    /// # Errors
    /// [`Error::Value`] for a pose or an object that cannot be used, [`Error::Limit`] for too many.
    pub(super) fn new(scan: &CircleScan<'_>) -> Result<Self, Error> {
        let pose = check(scan)?;
        let R_pose =
            scan.pose_covariance.map(|rows| SMatrix::from_fn(|row, column| rows[row][column]));
        let place = |(index, estimate): (usize, &CircleEstimate)| {
            let mut measurement = pose.place(estimate);
            measurement.delay = scan.delays.map_or(0.0, |delays| delays[index]);
            if let Some(R_pose) = R_pose {
                let J = pose.by_pose(estimate.circle.center, scan.world_from_lidar);
                let common = J * R_pose * J.transpose();
                let mut block = measurement.R.fixed_view_mut::<2, 2>(0, 0);
                block += (common + common.transpose()) * 0.5;
            }
            let outline = scan.outlines.get(index).copied().flatten();
            let placed = outline.and_then(|outline| {
                let placed = pose.place_outline(&outline, scan.world_from_lidar, R_pose)?;
                Some(OutlineMeasurement { delay: measurement.delay, ..placed })
            });
            let is_face = outline.is_some_and(|outline| outline.shape.kind == ShapeKind::Line);
            BodyMeasurement { circle: measurement, outline: placed, is_face }
        };
        let bodies = scan.estimates.iter().enumerate().map(place).collect();
        let lines =
            scan.lines.iter().map(|line| pose.place_line(line, scan.world_from_lidar, R_pose));
        Ok(Self {
            from: Viewpoint {
                stamp_ns: scan.stamp_ns,
                sensor: scan.sensor,
                pose,
                view: scan.view.map(|view| view.sorted()).transpose()?,
            },
            bodies: Seen::new(bodies),
            lines: Seen::new(lines.flatten().collect()),
        })
    }

    /// Place in the order of scans.
    pub(super) fn key(&self) -> (i64, u32) {
        self.from.key()
    }

    /// Elements of everything seen.
    pub(super) fn elements(&self) -> impl Iterator<Item = &Option<i64>> {
        self.bodies.elements.iter().chain(&self.lines.elements)
    }

    pub(super) fn elements_mut(&mut self) -> impl Iterator<Item = &mut Option<i64>> {
        self.bodies.elements.iter_mut().chain(&mut self.lines.elements)
    }

    /// Element of every circle, and of every line that has one.
    pub(super) fn found(&self) -> Found {
        let circles = self.bodies.elements.iter().flatten().copied().collect();
        Found { circles, lines: self.lines.elements.clone() }
    }
}

/// Elements of what a scan showed.
#[derive(Clone, Debug, Default)]
pub(super) struct Found {
    pub(super) circles: Vec<i64>,
    pub(super) lines: Vec<Option<i64>>,
}

impl LevelPose {
    pub(super) fn of(pose: &Transform) -> Self {
        let [x, y] = [pose.rotation[0][0], pose.rotation[1][0]];
        let norm = (x * x + y * y).sqrt();
        let (cos, sin) = if norm > 0.0 { (x / norm, y / norm) } else { (1.0, 0.0) };
        Self { origin: [pose.translation[0], pose.translation[1]], cos, sin }
    }

    pub(super) fn rotation(&self) -> Matrix2<f64> {
        Matrix2::new(self.cos, -self.sin, self.sin, self.cos)
    }

    pub(super) fn origin(&self) -> [f64; 2] {
        self.origin
    }

    /// A circle of the level frame in the world: eq. 18.
    pub(super) fn place(&self, estimate: &CircleEstimate) -> Measurement {
        let Circle { center: [x, y], radius } = estimate.circle;
        let mut turn = Matrix3::identity();
        turn.fixed_view_mut::<2, 2>(0, 0).copy_from(&self.rotation());
        let R = matrix_of(estimate);
        let R = turn * R * turn.transpose();
        let offset = Vector3::new(self.origin[0], self.origin[1], 0.0);
        let z = turn * Vector3::new(x, y, radius) + offset;
        Measurement { z, R: (R + R.transpose()) * 0.5, delay: 0.0 }
    }

    /// A circle of the world in the level frame.
    pub(super) fn level(&self, center: [f64; 2], radius: f64) -> Circle {
        let [x, y] = [center[0] - self.origin[0], center[1] - self.origin[1]];
        Circle { center: [self.cos * x + self.sin * y, self.cos * y - self.sin * x], radius }
    }

    /// A point of the level frame in the world.
    fn world_point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [from_x, from_y] = self.origin;
        [from_x + self.cos * x - self.sin * y, from_y + self.sin * x + self.cos * y]
    }

    /// A line of the level frame in the world; None for another shape. A wrong pose moves its
    /// middle, and a wrong yaw turns it.
    fn place_line(
        &self,
        shape: &ShapeEstimate,
        pose: &Transform,
        R_pose: Option<SMatrix<f64, 6, 6>>,
    ) -> Option<LineMeasurement> {
        let ends = shape.ends()?;
        let [angle, _, start, end, _] = shape.parameters;
        let c = &shape.covariance;
        // From the angle and the distance to the angle and the place across the middle.
        let J = Matrix2::new(1.0, 0.0, -0.5 * (start + end), 1.0);
        let mut R = J * Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]) * J.transpose();
        let middle = [0, 1].map(|axis| 0.5 * (ends[0][axis] + ends[1][axis]));
        let yaw = libm::atan2(self.sin, self.cos);
        let normal = Vector2::new(libm::cos(angle + yaw), libm::sin(angle + yaw));
        if let Some(R_pose) = R_pose {
            let mut J = SMatrix::<f64, 2, 6>::zeros();
            J[(0, 5)] = 1.0;
            J.set_row(1, &(normal.transpose() * self.by_pose(middle, pose)));
            R += J * R_pose * J.transpose();
        }
        Some(LineMeasurement {
            middle: self.world_point(middle),
            angle: turn(angle + yaw),
            half: 0.5 * (end - start),
            R: (R + R.transpose()) * 0.5,
        })
    }

    /// An ellipse or rectangle of the level frame in the world; None for another shape.
    fn place_outline(
        &self,
        outline: &OutlineEstimate,
        pose: &Transform,
        R_pose: Option<SMatrix<f64, 6, 6>>,
    ) -> Option<OutlineMeasurement> {
        let OutlineEstimate { shape, is_large } = *outline;
        let scale = shape.kind.half_length()?;
        let [x, y, long, short, heading] = shape.parameters;
        // From centre, lengths and heading to centre, heading and half lengths.
        let mut J = SMatrix::<f64, 5, 5>::zeros();
        J.fixed_view_mut::<2, 2>(0, 0).copy_from(&self.rotation());
        (J[(2, 4)], J[(3, 2)], J[(4, 3)]) = (1.0, scale, scale);
        let C = SMatrix::<f64, 5, 5>::from_fn(|row, column| shape.covariance[row][column]);
        let mut R = J * C * J.transpose();
        if let Some(R_pose) = R_pose {
            let mut J = SMatrix::<f64, 5, 6>::zeros();
            J.fixed_view_mut::<2, 6>(0, 0).copy_from(&self.by_pose([x, y], pose));
            J[(2, 5)] = 1.0;
            R += J * R_pose * J.transpose();
        }
        let [x, y] = self.world_point([x, y]);
        let bearing = heading + libm::atan2(self.sin, self.cos);
        Some(OutlineMeasurement {
            kind: shape.kind,
            z: SVector::from([x, y, bearing, scale * long, scale * short]),
            R: (R + R.transpose()) * 0.5,
            delay: 0.0,
            is_large,
        })
    }

    /// Derivative of a centre in the world by the sensor's pose. A wrong tilt moves what lies
    /// above or below the sensor.
    fn by_pose(&self, [x, y]: [f64; 2], pose: &Transform) -> SMatrix<f64, 2, 6> {
        let r = &pose.rotation;
        let normal = [
            self.cos * r[0][2] + self.sin * r[1][2],
            self.cos * r[1][2] - self.sin * r[0][2],
            r[2][2],
        ];
        let is_upright = normal[2].abs() < UPRIGHT;
        let z = if is_upright { 0.0 } else { -(normal[0] * x + normal[1] * y) / normal[2] };
        let (sin_beta, cos_beta) = (-r[2][0], (r[0][0] * r[0][0] + r[1][0] * r[1][0]).sqrt());
        let turned = SMatrix::<f64, 2, 3>::from_columns(&[
            [sin_beta * y, -sin_beta * x - cos_beta * z].into(),
            [z, 0.0].into(),
            [-y, x].into(),
        ]);
        let mut J = SMatrix::<f64, 2, 6>::zeros();
        J[(0, 0)] = 1.0;
        J[(1, 1)] = 1.0;
        J.fixed_view_mut::<2, 3>(0, 3).copy_from(&(self.rotation() * turned));
        J
    }
}

pub(super) fn matrix_of(estimate: &CircleEstimate) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| estimate.covariance[row][column])
}

/// Check a scan; its level pose.
///
/// # Errors
/// As [`Placed::new`].
pub(super) fn check(scan: &CircleScan<'_>) -> Result<LevelPose, Error> {
    let pose = scan.world_from_lidar;
    let numbers = pose.rotation.iter().flatten().chain(&pose.translation);
    if !numbers.clone().all(|value| value.is_finite()) {
        let expected = "a finite rotation and translation";
        return Err(Error::Value {
            name: "world_from_lidar",
            expected,
            index: 0,
            got: format!("{pose:?}"),
        });
    }
    if let Some(rows) = scan.pose_covariance {
        let C = SMatrix::<f64, 6, 6>::from_fn(|row, column| rows[row][column]);
        if !is_covariance(&C, ROUNDING) {
            let expected = "a symmetric matrix without negative eigenvalues";
            return Err(Error::Value {
                name: "pose_covariance",
                expected,
                index: 0,
                got: format!("{rows:?}"),
            });
        }
    }
    check_estimates(scan.estimates)?;
    check_outlines(scan.outlines, scan.estimates.len())?;
    check_lines(scan.lines)?;
    check_delays(scan.delays, scan.estimates.len())?;
    Ok(LevelPose::of(pose))
}

fn check_delays(delays: Option<&[f64]>, expected: usize) -> Result<(), Error> {
    let Some(delays) = delays else { return Ok(()) };
    let (name, got) = ("delays", delays.len());
    if got != expected {
        return Err(Error::Length { name, expected, got });
    }
    match delays.iter().position(|delay| delay.is_nan() || delay.abs() > MAX_DELAY) {
        Some(index) => Err(Error::Value {
            name,
            expected: "-10 to 10 s",
            index,
            got: delays[index].to_string(),
        }),
        None => Ok(()),
    }
}

fn check_estimates(estimates: &[CircleEstimate]) -> Result<(), Error> {
    if estimates.len() > MAX_ELEMENTS {
        return Err(too_many(estimates.len()));
    }
    for (index, estimate) in estimates.iter().enumerate() {
        let Circle { center: [x, y], radius } = estimate.circle;
        if !(x.is_finite() && y.is_finite() && radius.is_finite() && radius > 0.0) {
            let (expected, got) =
                ("a finite centre and a radius > 0", format!("{:?}", estimate.circle));
            return Err(Error::Value { name: "circles", expected, index, got });
        }
        if !is_covariance(&matrix_of(estimate), 0.0) {
            let (expected, got) =
                ("a symmetric positive definite matrix", format!("{:?}", estimate.covariance));
            return Err(Error::Value { name: "covariance", expected, index, got });
        }
    }
    Ok(())
}

fn check_outlines(outlines: &[Option<OutlineEstimate>], expected: usize) -> Result<(), Error> {
    let (name, got) = ("outlines", outlines.len());
    if got != 0 && got != expected {
        return Err(Error::Length { name, expected, got });
    }
    let is_usable = |outline: &OutlineEstimate| {
        let shape = &outline.shape;
        let [.., long, short, _] = shape.parameters;
        let C = SMatrix::<f64, 5, 5>::from_fn(|row, column| shape.covariance[row][column]);
        let is_known = shape.kind.half_length().is_some()
            && shape.parameters.iter().all(|value| value.is_finite())
            && long.min(short) > 0.0
            && is_covariance(&C, 0.0);
        is_known || shape.kind == ShapeKind::Line
    };
    match outlines.iter().position(|one| one.is_some_and(|one| !is_usable(&one))) {
        Some(index) => Err(Error::Value {
            name,
            expected: "ellipses and rectangles with a size and a positive definite covariance",
            index,
            got: format!("{:?}", outlines[index]),
        }),
        None => Ok(()),
    }
}

fn check_lines(lines: &[ShapeEstimate]) -> Result<(), Error> {
    if lines.len() > MAX_ELEMENTS {
        return Err(too_many(lines.len()));
    }
    let is_usable = |line: &ShapeEstimate| {
        let [_, _, start, end, _] = line.parameters;
        let C = Matrix2::from_fn(|row, column| line.covariance[row][column]);
        line.parameters.iter().all(|value| value.is_finite())
            && start <= end
            && is_covariance(&C, 0.0)
    };
    match lines.iter().position(|line| line.ends().is_none() || !is_usable(line)) {
        Some(index) => Err(Error::Value {
            name: "lines",
            expected: "lines with a finite place and a positive definite covariance",
            index,
            got: format!("{:?}", lines[index]),
        }),
        None => Ok(()),
    }
}

/// Whether a matrix is symmetric and no eigenvalue is below `-slack` of its trace; without slack
/// all have to be positive.
fn is_covariance<const N: usize>(C: &SMatrix<f64, N, N>, slack: f64) -> bool {
    let trace = C.trace();
    let asymmetry = (C - C.transpose()).abs().max();
    let lifted = C + SMatrix::<f64, N, N>::identity() * (slack * trace);
    let is_zero = slack > 0.0 && C.abs().max() == 0.0;
    trace.is_finite() && asymmetry <= ROUNDING * trace && (is_zero || lifted.cholesky().is_some())
}

pub(super) fn too_many(count: usize) -> Error {
    Error::Limit {
        what: format!("a map or scan of {count} circles"),
        limit: MAX_ELEMENTS as u64,
        key: "limit the range or volume",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose([x, y, z, alpha, beta, gamma]: [f64; 6]) -> Transform {
        let (sa, ca) = (libm::sin(alpha), libm::cos(alpha));
        let (sb, cb) = (libm::sin(beta), libm::cos(beta));
        let (sc, cc) = (libm::sin(gamma), libm::cos(gamma));
        let rotation = [
            [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
            [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
            [-sb, cb * sa, cb * ca],
        ];
        Transform { rotation, translation: [x, y, z] }
    }

    /// A point of the scan's plane in the world, from above.
    fn seen(pose: &Transform, point: [f64; 2]) -> [f64; 2] {
        let [x, y, _] = pose.apply([point[0], point[1], 0.0]);
        [x, y]
    }

    #[test]
    fn the_derivative_by_the_pose_agrees_with_differences() {
        let at = [1.0, -2.0, 1.5, 0.2, -0.3, 0.7];
        let here = pose(at);
        let level = LevelPose::of(&here);
        let point = [3.0, 2.0];
        let world = seen(&here, point);
        let J = level.by_pose(level.level(world, 0.1).center, &here);
        for parameter in 0..6 {
            let moved = |by: f64| {
                let mut near = at;
                near[parameter] += by;
                seen(&pose(near), point)
            };
            let (ahead, behind) = (moved(1e-6), moved(-1e-6));
            for axis in 0..2 {
                let expected = (ahead[axis] - behind[axis]) / 2e-6;
                assert!((J[(axis, parameter)] - expected).abs() < 1e-8, "{axis} {parameter}");
            }
        }
    }

    #[test]
    fn a_circle_goes_to_the_world_and_back() {
        let level = LevelPose::of(&pose([4.0, 5.0, 0.0, 0.1, 0.2, 2.0]));
        let circle = Circle { center: [1.0, 0.5], radius: 0.3 };
        let covariance = [[2e-4, 0.0, 0.0], [0.0, 1e-4, 1e-5], [0.0, 1e-5, 1e-4]];
        let placed =
            level.place(&CircleEstimate { circle, covariance, n_hits: 9, is_fallback: false });
        let back = level.level([placed.z[0], placed.z[1]], placed.z[2]);
        assert!((back.center[0] - 1.0).abs() + (back.center[1] - 0.5).abs() < 1e-12);
        assert!((placed.R.trace() - 4e-4).abs() < 1e-12);
    }
}
