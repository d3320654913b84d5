//! Clouds of a moving spinning sensor without the times of the points.
//!
//! Such a cloud is either as it was measured, so that its structure moves with the sensor during the scan, or a driver
//! has moved its points to one time already. A cloud of more than a turn shows which of the two: its two ends see the
//! same surfaces.

use super::raw_scan::RawScan;
use super::sweep::{Sweep, wrapped};
use crate::Error;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{Transform, dot, minus, norm};
use crate::util::budget::check_points;
use libm::{asin, atan2, hypot};
use nalgebra::{Matrix3, SymmetricEigen};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Motions below this are not corrected: shift during a scan of a point at `TURN_ARM` from the sensor [m].
const LEAST_SHIFT: f64 = 0.02;
/// Distance of a point that shows a turn of the sensor [m].
const TURN_ARM: f64 = 10.0;
/// Shift from which on the two ends are compared [m]. Poses of a sensor that stands are noisy, too.
const EVIDENT_SHIFT: f64 = 0.15;
/// A time between scans of more than this many usual ones means that scans are missing.
const GAP: f64 = 1.5;
/// Smallest overlap of the ends that is compared [rad]. A smaller one may be all of one surface.
const LEAST_OVERLAP: f64 = 0.035;
/// The first end is taken so much longer, because its surfaces lie in other directions after the motion [rad].
const MARGIN: f64 = 0.35;
/// Largest number of points of the last end that are compared.
const SAMPLES: usize = 200;
/// Ranges of points that are compared [m]: nearer ones may be of the robot, farther ones are sparse.
const RANGES: [f64; 2] = [3.0, 60.0];
/// Radii within which the surface around a point is searched: the smaller one [m], and the larger one as a share of the
/// range, for sensors with few rows. The larger one is not below the smaller one.
const REACH: f64 = 0.5;
const WIDE_REACH: f64 = 0.06;
/// Smallest number of points of a surface.
const FEWEST: f64 = 6.0;
/// Points are a surface if the variance across it is at most this share of the smaller one along it, and this share of
/// the larger one along it is at most the smaller one.
const FLAT: f64 = 0.1;
const WIDE: f64 = 0.1;
/// Least roughness of a surface [m].
const ROUGHNESS: f64 = 0.02;
/// A point votes if its distances from the two surfaces differ by more than this [m], and by more than this number of
/// roughnesses, and if the smaller distance is within that number of roughnesses.
const LEAST_DIFFERENCE: f64 = 0.05;
const APART: f64 = 3.0;
const FITS: f64 = 2.0;
/// Smallest excess of votes that counts, and as a share of the compared points. Fewer are noise.
const FEWEST_VOTES: f64 = 3.0;
const VOTES_SHARE: f64 = 0.05;
/// Logarithm of odds per vote. Votes depend on one another, because many are of one surface.
const PER_VOTE: f64 = 0.35;
/// Largest evidence of one scan, and of all scans (logarithms of odds).
const MOST_PER_SCAN: f64 = 2.0;
const MOST: f64 = 10.0;
/// Evidence from which on points are moved: odds of 99 to 1. A sensor whose points are moved once has the largest
/// evidence, so that single scans do not switch.
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
        if shift_of(motion) < LEAST_SHIFT * scans {
            return None;
        }
        let is_point = |row: usize| raw.no_return.is_none_or(|flags| !flags[row]);
        let sweep = Sweep::of(raw.points, returns, is_point)?;
        let poses = poses_of(&sweep, motion, scans);
        let is_evident = shift_of(motion) >= EVIDENT_SHIFT * scans;
        let evidence =
            if is_evident { evidence_of(raw.points, is_point, &sweep, &poses) } else { 0.0 };
        let is_skewed = self.evidence + evidence > ENOUGH;
        Some(SweepMotion { sweep, poses, seconds: seconds / scans, evidence, is_skewed })
    }

    /// Learn from an accepted scan. `seconds`: time since the last scan.
    pub(super) fn learn(&mut self, evidence: f64, seconds: Option<f64>) {
        let was_enough = self.evidence > ENOUGH;
        self.evidence = (self.evidence + evidence).clamp(-MOST, MOST);
        if self.evidence > ENOUGH && !was_enough {
            self.evidence = MOST;
        }
        if let Some(seconds) = seconds.filter(|&seconds| seconds > 0.0) {
            // Steps towards the median: single gaps and late stamps hardly count.
            let step = |period: f64| match seconds / period {
                ratio if ratio > 20.0 => 1.5, // it began with an interval that is none
                ratio => ratio.clamp(0.95, 1.05),
            };
            self.period = Some(self.period.map_or(seconds, |period| period * step(period)));
        }
    }
}

/// Times of points in clouds of a spinning sensor without times, for odometry. The clouds of one sensor are given in the
/// order of their times.
#[derive(Clone, Debug, Default)]
pub struct SweepTimes {
    known: Untimed,
}

impl SweepTimes {
    /// Part of the scan that was over at every point: 0 at the first one, 1 at the last one. None if the points are not
    /// in the order of firing, or if this and earlier clouds do not show that they are as measured. `motion`: expected
    /// pose of the sensor relative to its pose one scan before.
    ///
    /// # Errors
    /// [`Error::Limit`] for too many points, [`Error::Value`] for a motion that is not finite.
    pub fn parts(
        &mut self,
        points: &[[f32; 3]],
        motion: &Transform,
    ) -> Result<Option<Vec<f64>>, Error> {
        check_points(points.len())?;
        let all = motion.rotation.iter().flatten().chain(&motion.translation);
        if let Some(index) = all.clone().position(|value| !value.is_finite()) {
            let got = format!("{motion:?}");
            return Err(Error::Value { name: "motion", expected: "finite values", index, got });
        }
        let Some(sweep) = Sweep::of(points, 1, |_| true) else { return Ok(None) };
        let poses = poses_of(&sweep, motion, 1.0);
        if shift_of(motion) >= EVIDENT_SHIFT {
            self.known.learn(evidence_of(points, |_| true, &sweep, &poses), None);
        }
        let parts: Vec<f64> = sweep.parts().collect();
        let of_points = (0..points.len()).map(|row| parts[sweep.block_of(row)]);
        Ok((self.known.evidence > ENOUGH).then(|| of_points.collect()))
    }
}

/// Shift of a point by a motion, at most [m]: at the sensor, or by its turn at `TURN_ARM`.
fn shift_of(motion: &Transform) -> f64 {
    let turned = |row: usize| norm(minus(motion.rotation[row], Transform::IDENTITY.rotation[row]));
    norm(motion.translation).max(TURN_ARM * turned(0).max(turned(1)))
}

/// Pose of the sensor at every block of a scan, relative to the middle of the scan. `motion`: from the last scan to this
/// one, over the time of `scans` scans, which follow one another without a pause.
fn poses_of(sweep: &Sweep, motion: &Transform, scans: f64) -> Vec<Transform> {
    let pose = |part: f64| Transform::IDENTITY.interpolate(motion, (part - 0.5) / scans);
    sweep.parts().map(pose).collect()
}

/// Evidence of a scan that its points have to be moved.
fn evidence_of(
    points: &[[f32; 3]],
    is_point: impl Fn(usize) -> bool,
    sweep: &Sweep,
    poses: &[Transform],
) -> f64 {
    (PER_VOTE * votes(points, is_point, sweep, poses)).clamp(-MOST_PER_SCAN, MOST_PER_SCAN)
}

/// Number of points at the last end of a scan that fit better to the surfaces of the first end with their motion, less
/// the number of those that fit better without.
fn votes(
    points: &[[f32; 3]],
    is_point: impl Fn(usize) -> bool,
    sweep: &Sweep,
    poses: &[Transform],
) -> f64 {
    let overlap = sweep.turn - TAU;
    if overlap < LEAST_OVERLAP {
        return 0.0;
    }
    let is_near = |row: usize| {
        let range = norm(wide(points[row]));
        let is_in_reach = (RANGES[0]..=RANGES[1]).contains(&range);
        is_in_reach && is_point(row)
    };
    let head = sweep.angles.partition_point(|&angle| angle < overlap + MARGIN) * sweep.block;
    let tail = sweep.angles.partition_point(|&angle| angle < TAU) * sweep.block;
    let head: Vec<usize> = (0..head.min(sweep.rows)).filter(|&row| is_near(row)).collect();
    let tail: Vec<usize> = (tail.min(sweep.rows)..sweep.rows).filter(|&row| is_near(row)).collect();
    let moved = |row: usize| poses[sweep.block_of(row)].apply(wide(points[row]));
    let as_given = FirstEnd::of(sweep, &head, |row| wide(points[row]), None);
    let with_motion = FirstEnd::of(sweep, &head, moved, Some(poses));
    let step = tail.len().div_ceil(SAMPLES).max(1);
    let vote_of = |&row: &usize| {
        let angle = sweep.angles[sweep.block_of(row)] - TAU;
        let (point, later) = (wide(points[row]), moved(row));
        let turned = wrapped(atan2(later[1], later[0]) - atan2(point[1], point[0]));
        let given = as_given.offset(point, angle)?;
        Some(vote(given, with_motion.offset(later, angle + sweep.sense * turned)?))
    };
    let votes: Vec<f64> = tail.iter().step_by(step).filter_map(vote_of).collect();
    let excess: f64 = votes.iter().sum();
    let fewest = (VOTES_SHARE * votes.len() as f64).max(FEWEST_VOTES);
    if excess.abs() >= fewest { excess } else { 0.0 }
}

/// Distance of a point from the surface around it, and the roughness of that surface [m].
#[derive(Clone, Copy)]
struct SurfaceOffset {
    distance: f64,
    roughness: f64,
}

/// 1 if a point fits better with the motion of the sensor, -1 if it fits better as given, 0 if neither is clear.
fn vote(given: SurfaceOffset, with_motion: SurfaceOffset) -> f64 {
    let difference = given.distance - with_motion.distance;
    let better = if difference > 0.0 { with_motion } else { given };
    let is_clear = difference.abs() > (APART * better.roughness).max(LEAST_DIFFERENCE)
        && better.distance <= FITS * better.roughness;
    if is_clear { difference.signum() } else { 0.0 }
}

/// Points at the first end of a scan, in the order of firing.
struct FirstEnd {
    points: Vec<[f64; 3]>,
    /// Angle of the block of every point, ascending [rad].
    angles: Vec<f64>,
    /// Largest shift of a point from the direction of its block [m].
    shift: f64,
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
        let (mut last, mut shift) = (f64::NEG_INFINITY, 0.0_f64);
        let mut angle = |&row: &usize| {
            let block = sweep.block_of(row);
            let turned = poses.map_or(0.0, |poses| {
                shift = shift.max(norm(poses[block].translation));
                atan2(poses[block].rotation[1][0], poses[block].rotation[0][0])
            });
            last = (sweep.angles[block] + sweep.sense * turned).max(last); // blocks may go back a little
            last
        };
        let angles = rows.iter().map(&mut angle).collect();
        Self { points, angles, shift }
    }

    /// SurfaceOffset of `point` from the surface around it. `angle`: its direction. None if the points near it are few or no
    /// surface, as between rows, or if its direction is not in sight.
    fn offset(&self, point: [f64; 3], angle: f64) -> Option<SurfaceOffset> {
        let end = *self.angles.last()?;
        if !(0.0..=end).contains(&angle) {
            return None;
        }
        let reach = (WIDE_REACH * norm(point)).max(REACH);
        let width = asin(((reach + self.shift) / hypot(point[0], point[1])).min(1.0));
        let from = self.angles.partition_point(|&other| other < angle - width);
        let to = self.angles.partition_point(|&other| other <= angle + width);
        let (mut close, mut around) = (NearPoints::default(), NearPoints::default());
        for &other in &self.points[from..to] {
            let apart = minus(other, point);
            let square = dot(apart, apart);
            if square <= reach * reach {
                around.add(apart);
                if square <= REACH * REACH {
                    close.add(apart);
                }
            }
        }
        close.surface().or_else(|| around.surface())
    }
}

/// Sums over points, given relative to the point whose distance is asked for.
#[derive(Default)]
struct NearPoints {
    count: f64,
    sum: [f64; 3],
    /// Sums of products of coordinates: xx, xy, xz, yy, yz, zz.
    products: [f64; 6],
}

impl NearPoints {
    fn add(&mut self, [x, y, z]: [f64; 3]) {
        self.count += 1.0;
        let products = [x * x, x * y, x * z, y * y, y * z, z * z];
        self.sum = [self.sum[0] + x, self.sum[1] + y, self.sum[2] + z];
        self.products = std::array::from_fn(|at| self.products[at] + products[at]);
    }

    /// SurfaceOffset of the origin from the plane through the points. None if they are few, or not in a plane.
    fn surface(&self) -> Option<SurfaceOffset> {
        if self.count < FEWEST {
            return None;
        }
        let mean = self.sum.map(|sum| sum / self.count);
        let [xx, xy, xz, yy, yz, zz] = self.products.map(|sum| sum / self.count);
        let [x, y, z] = mean;
        let (xy, xz, yz) = (xy - x * y, xz - x * z, yz - y * z);
        let spread = Matrix3::new(xx - x * x, xy, xz, xy, yy - y * y, yz, xz, yz, zz - z * z);
        let eigen = SymmetricEigen::new(spread);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let [across, shorter, longer] = order.map(|index| eigen.eigenvalues[index]);
        if !(across <= FLAT * shorter && shorter >= WIDE * longer) {
            return None;
        }
        let normal = eigen.eigenvectors.column(order[0]);
        let distance = dot([normal[0], normal[1], normal[2]], mean).abs();
        Some(SurfaceOffset { distance, roughness: across.max(0.0).sqrt().max(ROUGHNESS) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_has_an_offset_and_a_line_has_none() {
        let mut plane = NearPoints::default();
        let mut line = NearPoints::default();
        for at in 0..25 {
            let (x, y) = (f64::from(at % 5) * 0.1, f64::from(at / 5) * 0.1);
            plane.add([x - 0.3, y, 0.4]);
            line.add([x + 5.0 * y, 0.0, 0.4]);
        }
        let found = plane.surface().map(|surface| (surface.distance, surface.roughness));
        assert!(found.is_some_and(|(distance, _)| (distance - 0.4).abs() < 1e-9));
        assert!(found.is_some_and(|(_, roughness)| roughness == ROUGHNESS));
        assert!(line.surface().is_none() && NearPoints::default().surface().is_none());
    }

    #[test]
    fn a_point_votes_for_the_surface_that_it_lies_on() {
        let offset = |distance: f64| SurfaceOffset { distance, roughness: 0.02 };
        assert_eq!(vote(offset(0.5), offset(0.01)), 1.0);
        assert_eq!(vote(offset(0.0), offset(0.3)), -1.0);
        assert_eq!(vote(offset(0.02), offset(0.01)), 0.0, "hardly a difference");
        assert_eq!(vote(offset(0.5), offset(0.2)), 0.0, "on neither");
        let rough = SurfaceOffset { distance: 0.1, roughness: 0.2 };
        assert_eq!(vote(offset(0.5), rough), 0.0, "on leaves");
    }

    #[test]
    fn a_gap_does_not_change_the_usual_period() {
        let mut known = Untimed::default();
        for seconds in [0.1, 0.11, 0.4, 0.09, 0.1] {
            known.learn(0.0, Some(seconds));
        }
        assert!(known.period.is_some_and(|period| (period - 0.1).abs() < 0.01));
        for seconds in [0.19, 0.01, 1e-9] {
            known.learn(0.0, Some(seconds)); // late stamps
        }
        assert!(known.period.is_some_and(|period| (period - 0.1).abs() < 0.02));
        let mut after_gap = Untimed::default();
        for seconds in [0.5, 0.1, 0.1] {
            after_gap.learn(0.0, Some(seconds));
        }
        (0..60).for_each(|_| after_gap.learn(0.0, Some(0.1)));
        assert!(after_gap.period.is_some_and(|period| (period - 0.1).abs() < 0.01));
        known.learn(0.0, None);
        known.learn(1e6, Some(0.0));
        assert_eq!(known.evidence, MOST);
    }

    #[test]
    fn one_scan_does_not_switch_what_is_known() {
        let mut known = Untimed::default();
        [2.0, 2.0, 2.0].into_iter().for_each(|evidence| known.learn(evidence, None));
        assert_eq!(known.evidence, MOST);
        known.learn(-2.0, None);
        assert!(known.evidence > ENOUGH);
        [-2.0, -2.0].into_iter().for_each(|evidence| known.learn(evidence, None));
        assert!(known.evidence < ENOUGH);
    }
}
