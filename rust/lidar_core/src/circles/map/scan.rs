//! Input of the map from one scan: circles and other shapes, checked and transformed to the world.

#![allow(non_snake_case)] // textbook letters

use super::body::hull::Hull;
use super::body::look::Look;
use super::body::measurement::{BodyMeasurement, Legs};
use super::body::outline::{OutlineEstimate, OutlineMeasurement};
use super::circle_measurement::CircleMeasurement;
use super::line::LineMeasurement;
use super::parameters::MAX_ELEMENTS;
use super::place::matrix_of;
use super::view::earlier::Earlier;
use super::view::level_pose::LevelPose;
use super::view::viewpoint::Viewpoint;
use super::view::visibility::{ScanWithLimits, SortedView};
use crate::Error;
use crate::circles::fit::circle::{Circle, CircleEstimate};
use crate::circles::shape::{ShapeEstimate, ShapeKind};
use crate::geometry::transform::Transform;
use nalgebra::{Matrix2, SMatrix};
use serde::{Deserialize, Serialize};

/// Relative error of a covariance that may make it asymmetric or not positive.
const ROUNDING: f64 = 1e-9;

/// Longest time between a scan's stamp and one of its circles [s].
const MAX_DELAY: f64 = 10.0;

/// Covariance of a pose: of the translation [m] and of the angles alpha, beta, gamma of
/// `R = Rz(gamma) Ry(beta) Rx(alpha)` [rad].
pub type PoseCovariance = [[f64; 6]; 6];

/// Circles of one scan in the level frame: origin at the sensor, z up, x in the direction of the
/// sensor's x axis as seen from above.
#[derive(Clone, Copy, Debug)]
pub struct CircleScan<'a> {
    /// Time of the scan [ns].
    pub stamp_ns: i64,
    /// Index of the sensor: scans of several sensors may have the same stamp.
    pub sensor: u32,
    /// Pose of the sensor.
    pub world_from_lidar: &'a Transform,
    /// Covariance of the pose; None for an exact pose.
    pub pose_covariance: Option<&'a PoseCovariance>,
    /// Circles found in the scan.
    pub estimates: &'a [CircleEstimate],
    /// Time of each measurement after the stamp, -10 to 10 [s]; None: all at the stamp. The filter
    /// of the paper takes all at the stamp.
    pub delays: Option<&'a [f64]>,
    /// Outlines of those `estimates` that only represent another shape; empty if there are none.
    /// The filter of the paper ignores them.
    pub outlines: &'a [Option<OutlineEstimate>],
    /// End points of the rays of each of `estimates`, x and y in the world [m]; None if only the
    /// estimates are used to find motion. The filter of the paper ignores them.
    pub points: Option<&'a [Vec<[f64; 2]>]>,
    /// For each of `estimates`, whether a nearer object hides a side of it; None: no side is
    /// hidden. The filter of the paper ignores it.
    pub covered: Option<&'a [bool]>,
    /// Lines found in the scan. The filter of the paper ignores them.
    pub lines: &'a [ShapeEstimate],
    /// The scan itself; None: all elements should have been measured.
    pub view: Option<ScanWithLimits<'a>>,
}

/// Measured objects of one kind in the world, each with its element.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct MeasuredObjects<M> {
    pub(super) measurements: Vec<M>,
    /// ID of the element of each object, after the scan was processed; None without an element.
    pub(super) elements: Vec<Option<i64>>,
}

impl<M> MeasuredObjects<M> {
    fn new(measurements: Vec<M>) -> Self {
        Self { elements: vec![None; measurements.len()], measurements }
    }
}

/// A scan in the form in which the map stores it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct KeptScan {
    pub(super) from: Viewpoint,
    pub(super) bodies: MeasuredObjects<BodyMeasurement>,
    pub(super) lines: MeasuredObjects<LineMeasurement>,
}

impl KeptScan {
    /// True if the parts of a restored state agree.
    pub(super) fn is_sound(&self) -> bool {
        self.bodies.measurements.len() == self.bodies.elements.len()
            && self.lines.measurements.len() == self.lines.elements.len()
            && self.from.view.as_ref().is_none_or(SortedView::is_sound)
    }

    /// Place the objects of a scan in the world.
    ///
    /// # Errors
    /// [`Error::Value`] for a pose or an object that cannot be used, [`Error::Limit`] for too many.
    pub(super) fn new(scan: &CircleScan<'_>) -> Result<Self, Error> {
        // Longer than other functions: one expression per field of a measurement.
        let pose = check(scan)?;
        let R_pose =
            scan.pose_covariance.map(|rows| SMatrix::from_fn(|row, column| rows[row][column]));
        let look = scan.view.and_then(|view| view.scan.spacing()).map(|one| Look::new(&pose, one));
        let place = |(index, estimate): (usize, &CircleEstimate)| {
            let delay = scan.delays.map_or(0.0, |delays| delays[index]);
            let in_world = |estimate: &CircleEstimate| CircleMeasurement {
                delay,
                ..pose.place_circle(estimate, scan.world_from_lidar, R_pose)
            };
            let outline = scan.outlines.get(index).copied().flatten();
            let placed = outline.and_then(|outline| {
                let placed = pose.place_outline(&outline, scan.world_from_lidar, R_pose)?;
                Some(OutlineMeasurement { delay, ..placed })
            });
            // The kind of an object of which one face is seen stays open; its circle is used all
            // the same.
            let is_face = outline.is_some_and(|outline| outline.shape.kind == ShapeKind::Line);
            let round = outline.and_then(|outline| outline.round);
            BodyMeasurement {
                circle: in_world(estimate),
                round: round.as_ref().map(in_world),
                outline: placed,
                is_face,
                time_ns: scan.stamp_ns + libm::round(delay * 1e9) as i64,
                sight: pose.sight(estimate.circle.center),
                look,
                hull: None,
                trace: None,
                legs: Legs::None,
            }
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
            bodies: MeasuredObjects::new(bodies),
            lines: MeasuredObjects::new(lines.flatten().collect()),
        })
    }

    /// Compute the extent of the points of objects, and which points are where earlier scans saw a
    /// surface. Returns true if the scanner moved although its pose stayed the same.
    pub(super) fn compare(&mut self, scan: &CircleScan<'_>, earlier: &Earlier) -> bool {
        let Some(points) = scan.points else { return false };
        let before = earlier.before(&self.from);
        for (number, (body, points)) in self.bodies.measurements.iter_mut().zip(points).enumerate()
        {
            let is_covered = scan.covered.is_some_and(|covered| covered[number]);
            body.hull = Hull::of(points, is_covered);
            body.trace = before.trace(points);
        }
        before.has_stuck_pose()
    }

    /// Key for the order of scans: stamp [ns] and index of the sensor.
    pub(super) fn key(&self) -> (i64, u32) {
        self.from.key()
    }

    /// Elements of all objects of the scan.
    pub(super) fn elements(&self) -> impl Iterator<Item = &Option<i64>> {
        self.bodies.elements.iter().chain(&self.lines.elements)
    }

    pub(super) fn elements_mut(&mut self) -> impl Iterator<Item = &mut Option<i64>> {
        self.bodies.elements.iter_mut().chain(&mut self.lines.elements)
    }

    /// Elements of all circles, and of the lines that have one.
    pub(super) fn found(&self) -> ScanElements {
        let circles = self.bodies.elements.iter().flatten().copied().collect();
        ScanElements { circles, lines: self.lines.elements.clone() }
    }
}

/// IDs of the elements to which the objects of a scan belong.
#[derive(Clone, Debug, Default)]
pub(super) struct ScanElements {
    pub(super) circles: Vec<i64>,
    pub(super) lines: Vec<Option<i64>>,
}

/// Check a scan and return its level pose.
///
/// # Errors
/// Errors of [`KeptScan::new`].
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
        // Poses often come from elsewhere and may be exactly known in some directions: zero
        // eigenvalues, and rounding below, are accepted.
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
    let (expected, got) = (scan.estimates.len(), scan.points.map(<[_]>::len));
    if let Some(got) = got.filter(|&got| got != expected) {
        return Err(Error::Length { name: "points", expected, got });
    }
    if let Some(got) = scan.covered.map(<[_]>::len).filter(|&got| got != expected) {
        return Err(Error::Length { name: "covered", expected, got });
    }
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
        // Stricter than for poses: an estimate without variance would be believed without limit.
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
        let is_round = outline.round.is_none_or(|round| check_estimates(&[round]).is_ok());
        is_round && (is_known || shape.kind == ShapeKind::Line)
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

/// True if a matrix is symmetric and no eigenvalue is below `-slack` times its trace; without slack
/// all must be positive.
fn is_covariance<const N: usize>(C: &SMatrix<f64, N, N>, slack: f64) -> bool {
    let trace = C.trace();
    let asymmetry = (C - C.transpose()).abs().max();
    // A factorisation instead of eigenvalues: with the slack added, it succeeds only if none of
    // them is below minus the slack.
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
