//! Clouds of a moving spinning sensor without the times of the points.
//!
//! Such a cloud is either as it was measured, so that its structure moves with the sensor during the scan, or a driver
//! has moved its points to one time already. A cloud of more than a turn shows which of the two: its two ends see the
//! same surfaces.

use super::raw_scan::RawScan;
use super::sweep::{Sweep, wrapped};
use crate::geometry::lattice::wide;
use crate::geometry::transform::{Transform, dot, minus, norm};
use libm::{asin, atan2, hypot};
use nalgebra::{Matrix3, SymmetricEigen};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Motions below this are not corrected: shift during a scan of a point at `TURN_ARM` from the sensor [m].
const LEAST_SHIFT: f64 = 0.02;
/// Distance of a point that shows a turn of the sensor [m].
const TURN_ARM: f64 = 10.0;
/// A time between scans of more than this many usual ones means that scans are missing.
const GAP: f64 = 1.5;
/// Smallest overlap of the ends that is compared [rad].
const LEAST_OVERLAP: f64 = 0.005;
/// The first end is taken so much longer, because its surfaces lie in other directions after the motion [rad].
const MARGIN: f64 = 0.35;
/// Largest number of points of the last end that are compared.
const SAMPLES: usize = 200;
/// Ranges of points that are compared [m]: nearer ones may be of the robot, farther ones are sparse.
const RANGES: [f64; 2] = [3.0, 60.0];
/// Surface of a point: this number of nearest points, of which `FEWEST` are within `REACH` [m].
const NEAREST: usize = 8;
const FEWEST: usize = 6;
const REACH: f64 = 0.5;
/// Points are a surface if the variance across it is at most this share of the smaller one along it, and this share of
/// the larger one along it is at most the smaller one.
const FLAT: f64 = 0.1;
const WIDE: f64 = 0.02;
/// A point votes if the two distances from its surface differ by more than this [m].
const LEAST_DIFFERENCE: f64 = 0.05;
/// Logarithm of odds per vote. Votes depend on one another, because many are of one surface.
const PER_VOTE: f64 = 0.35;
/// Largest evidence of one scan, and of all scans (logarithms of odds).
const MOST_PER_SCAN: f64 = 3.0;
const MOST: f64 = 10.0;
/// Evidence from which on points are moved: odds of 99 to 1.
const ENOUGH: f64 = 4.6;

/// Where the times of the points of a scan come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PointTimes {
    /// All points are taken to be of the time of the scan.
    #[default]
    None,
    /// The caller has given the times.
    Given,
    /// The times were found from the order of the points.
    Estimated,
}

impl PointTimes {
    /// The source as one word, for people and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Given => "given",
            Self::Estimated => "estimated",
        }
    }
}

/// What is known about the clouds of a sensor that have no times.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Untimed {
    /// Logarithm of the odds that the clouds are as measured, not corrected for motion.
    evidence: f64,
    /// Usual time between two scans [s].
    period: Option<f64>,
}

/// Motion of the sensor during a scan without times.
#[derive(Clone, Debug)]
pub(crate) struct SweepMotion {
    pub(crate) sweep: Sweep,
    /// Pose of the sensor at the middle of every block, relative to the middle of the scan.
    pub(crate) poses: Vec<Transform>,
    /// Duration of the scan [s].
    pub(crate) seconds: f64,
    /// Evidence of this scan that its points have to be moved.
    pub(crate) evidence: f64,
    /// Whether the points have to be moved, as far as this and earlier scans show.
    pub(crate) is_skewed: bool,
}

impl SweepMotion {
    /// Time of every block after the middle of the scan [s].
    pub(super) fn delays(&self) -> impl Iterator<Item = f32> {
        self.sweep.parts().map(|part| ((part - 0.5) * self.seconds) as f32)
    }
}

impl Untimed {
    /// Check a saved state.
    pub(super) fn is_whole(&self) -> bool {
        self.evidence.abs() <= MOST && self.period.is_none_or(|period| period > 0.0)
    }

    /// Motion during a scan that has no times. `motion`: pose of the sensor relative to its last scan. `seconds`: time
    /// since then. None if the points are not in the order of firing, or if the sensor hardly moves.
    pub(super) fn motion(
        &self,
        raw: &RawScan<'_>,
        returns: usize,
        motion: &Transform,
        seconds: f64,
    ) -> Option<SweepMotion> {
        let period = self.period.unwrap_or(seconds);
        let scans = if seconds > GAP * period { (seconds / period).round() } else { 1.0 };
        let turned = minus(motion.rotation[0], Transform::IDENTITY.rotation[0]);
        let turned = norm(turned).max(norm(minus(motion.rotation[1], [0.0, 1.0, 0.0])));
        if norm(motion.translation).max(TURN_ARM * turned) < LEAST_SHIFT * scans {
            return None;
        }
        let is_point = |row: usize| raw.no_return.is_none_or(|flags| !flags[row]);
        let sweep = Sweep::of(raw.points, returns, is_point)?;
        // Scans of a spinning sensor follow one another without a pause.
        let pose = |part: f64| Transform::IDENTITY.interpolate(motion, (part - 0.5) / scans);
        let poses: Vec<Transform> = sweep.parts().map(pose).collect();
        let evidence = (PER_VOTE * votes(raw, &sweep, &poses)).clamp(-MOST_PER_SCAN, MOST_PER_SCAN);
        let is_skewed = self.evidence + evidence > ENOUGH;
        Some(SweepMotion { sweep, poses, seconds: seconds / scans, evidence, is_skewed })
    }

    /// Learn from an accepted scan. `seconds`: time since the last scan.
    pub(super) fn learn(&mut self, evidence: f64, seconds: Option<f64>) {
        self.evidence = (self.evidence + evidence).clamp(-MOST, MOST);
        if let Some(seconds) = seconds.filter(|&seconds| seconds > 0.0) {
            let is_usual = |period: f64| seconds * GAP > period && seconds < GAP * period;
            self.period = match self.period {
                Some(period) if is_usual(period) => Some(period + 0.1 * (seconds - period)),
                Some(period) if seconds > period => Some(period), // scans are missing
                _ => Some(seconds),
            };
        }
    }
}

/// Number of points at the last end of a scan that fit better to the surfaces of the first end with their motion, less
/// the number of those that fit better without.
fn votes(raw: &RawScan<'_>, sweep: &Sweep, poses: &[Transform]) -> f64 {
    let overlap = sweep.turn - TAU;
    if overlap < LEAST_OVERLAP {
        return 0.0;
    }
    let is_near = |row: usize| {
        let range = norm(wide(raw.points[row]));
        let is_in_reach = (RANGES[0]..=RANGES[1]).contains(&range);
        is_in_reach && raw.no_return.is_none_or(|flags| !flags[row])
    };
    let head = sweep.angles.partition_point(|&angle| angle < overlap + MARGIN) * sweep.block;
    let tail = sweep.angles.partition_point(|&angle| angle < TAU) * sweep.block;
    let head: Vec<usize> = (0..head.min(sweep.rows)).filter(|&row| is_near(row)).collect();
    let tail: Vec<usize> = (tail.min(sweep.rows)..sweep.rows).filter(|&row| is_near(row)).collect();
    let moved = |row: usize| poses[sweep.block_of(row)].apply(wide(raw.points[row]));
    let as_given = FirstEnd::of(sweep, &head, |row| wide(raw.points[row]), None);
    let with_motion = FirstEnd::of(sweep, &head, moved, Some(poses));
    let mut votes = 0.0;
    let step = tail.len().div_ceil(SAMPLES).max(1);
    for &row in tail.iter().step_by(step) {
        let angle = sweep.angles[sweep.block_of(row)] - TAU;
        let point = wide(raw.points[row]);
        let given = as_given.distance(point, angle);
        let later = moved(row);
        let turned = wrapped(atan2(later[1], later[0]) - atan2(point[1], point[0]));
        let corrected = with_motion.distance(later, angle + sweep.sense * turned);
        if let (Some(given), Some(corrected)) = (given, corrected) {
            let difference = given - corrected;
            if difference.abs() > LEAST_DIFFERENCE {
                votes += difference.signum();
            }
        }
    }
    votes
}

/// Points at the first end of a scan, in the order of firing.
struct FirstEnd {
    points: Vec<[f64; 3]>,
    /// Angle of the block of every point, ascending [rad].
    angles: Vec<f64>,
    /// Largest distance across the line of sight between a point near the asked one and its block [m].
    reach: f64,
}

impl FirstEnd {
    /// `poses`: motion by which `place` moves the blocks. None if it moves none.
    fn of(
        sweep: &Sweep,
        rows: &[usize],
        place: impl Fn(usize) -> [f64; 3],
        poses: Option<&[Transform]>,
    ) -> Self {
        let points = rows.iter().map(|&row| place(row)).collect();
        let (mut last, mut way) = (f64::NEG_INFINITY, 0.0_f64);
        let mut angle = |&row: &usize| {
            let block = sweep.block_of(row);
            let turned = poses.map_or(0.0, |poses| {
                way = way.max(norm(poses[block].translation));
                atan2(poses[block].rotation[1][0], poses[block].rotation[0][0])
            });
            last = (sweep.angles[block] + sweep.sense * turned).max(last); // blocks may go back a little
            last
        };
        let angles = rows.iter().map(&mut angle).collect();
        Self { points, angles, reach: REACH + way }
    }

    /// Distance of `point` from the surface near it [m], at most `REACH`. `angle`: its direction. None if the points
    /// near it are no surface, or if its direction is not in sight.
    fn distance(&self, point: [f64; 3], angle: f64) -> Option<f64> {
        if angle < 0.0 || angle > *self.angles.last()? {
            return None;
        }
        let wide = asin((self.reach / hypot(point[0], point[1])).min(1.0));
        let from = self.angles.partition_point(|&other| other < angle - wide);
        let to = self.angles.partition_point(|&other| other <= angle + wide);
        let mut nearest: Vec<(f64, usize)> = Vec::with_capacity(NEAREST + 1);
        for index in from..to {
            let apart = minus(self.points[index], point);
            let square = dot(apart, apart);
            let limit = nearest.get(NEAREST - 1).map_or(REACH * REACH, |last| last.0);
            if square < limit {
                let place = nearest.partition_point(|other| other.0 <= square);
                nearest.insert(place, (square, index));
                nearest.truncate(NEAREST);
            }
        }
        if nearest.len() < FEWEST {
            return Some(REACH);
        }
        let near: Vec<[f64; 3]> = nearest.iter().map(|&(_, index)| self.points[index]).collect();
        plane_distance(&near, point).map(|distance| distance.min(REACH))
    }
}

/// Distance of `point` from the plane through `near` [m]. None if these points are not in a plane.
fn plane_distance(near: &[[f64; 3]], point: [f64; 3]) -> Option<f64> {
    let share = 1.0 / near.len() as f64;
    let mut center = [0.0; 3];
    for at in near {
        center = std::array::from_fn(|axis| center[axis] + share * at[axis]);
    }
    let mut spread = Matrix3::<f64>::zeros();
    for &at in near {
        let apart = minus(at, center);
        for (row, column) in (0..9).map(|index| (index / 3, index % 3)) {
            spread[(row, column)] += apart[row] * apart[column];
        }
    }
    let eigen = SymmetricEigen::new(spread);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let [across, shorter, longer] = order.map(|index| eigen.eigenvalues[index]);
    if !(across <= FLAT * shorter && shorter >= WIDE * longer && shorter > 0.0) {
        return None;
    }
    let normal = eigen.eigenvectors.column(order[0]);
    Some(dot([normal[0], normal[1], normal[2]], minus(point, center)).abs())
}
