//! The robot itself in the scans of its LiDAR: returns that stay in place in the sensor's frame while the sensor
//! moves.
//!
//! Returns near the sensor are counted per voxel of the sensor's frame. A voxel that has returns wherever the sensor is
//! belongs to the robot, if it is connected with the near zone, does not continue into the distance (ground, walls
//! along the path), and is not on the ground. While the sensor moves straight on, an object that accompanies it closely
//! looks the same. So no result is final: a voxel without returns is removed again. After a turn of more than 30
//! degrees the result counts as decided. Droplets in the air do not count: in fog, they connect the robot with the
//! world.

use super::body_voxels::{GAP, VOLUME, WORDS, around, beside, center_of, has, voxel_of};
use crate::geometry::lattice::wide;
use crate::geometry::transform::{Transform, dot, minus, norm};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Returns nearer than this are placeholders of drivers for rays without return [m].
const LEAST_RANGE: f64 = 0.2;
/// Every part of the robot is connected with something within this distance of the sensor [m].
const NEAR_ZONE: f64 = 3.0;
/// Largest distance of a part of the robot from the sensor [m]. Things that extend further are no robot.
const FARTHEST: f64 = 5.5;
/// Distance [m] (`NEXT_TURN`: turn [rad]) after which the sensor counts as being at another place.
const NEXT_PLACE: f64 = 0.2;
const NEXT_TURN: f64 = 3.0 * PI / 180.0;
/// Number of places, and distance moved (`ENOUGH_WAY` [m]), that are needed before a voxel counts as part of the robot.
const ENOUGH_PLACES: u32 = 5;
const ENOUGH_WAY: f64 = 1.0;
/// Number of places between two searches for the robot.
const PLACES_PER_SEARCH: u32 = 5;
/// Turn from the first pose after which the found robot counts as decided [rad]: 30 degrees.
const DECIDING_TURN: f64 = 30.0 * PI / 180.0;
/// Share of the places with returns from which on a voxel is of the robot. Beside such a voxel, half is enough.
const HELD_SHARE: f64 = 0.6;
/// The same share for known voxels of the robot. It is smaller, since parts of the robot may be hidden.
const KEPT_SHARE: f64 = 0.2;
/// Parts within this distance of the sensor need not be rigid [m]: arms and cables of a robot, or a roof whose returns
/// are smeared by the speed of the sensor. No target comes so near.
const BESIDE_SENSOR: f64 = 1.5;
/// Smallest rigidity of a part: the mean count of a return's voxel, over returns on the part and beside it, divided by
/// the largest count. A robot is rigid. An object that flies along leaves some voxels and enters others. Voxels with
/// few returns (`RARE_SHARE`) do not count: those are droplets.
const RIGID_SHARE: f64 = 0.6;
const RARE_SHARE: f64 = 0.1;
/// Share of the voxels of a robot from an earlier run that must still have returns, if it is the same robot. After a
/// short drive the earlier result may contain parts of the world, so the share is below one half.
const SAME_SHARE: f64 = 0.3;
/// Height above the lowest returns up to which returns are on the ground [m].
const GROUND: f64 = 0.35;
/// One return in this many is assumed to be below the ground.
const LOWEST: usize = 50;
/// Fewest scans before voxels count as possible parts of the robot while the sensor has not moved. `STILL_SCANS`:
/// number at which all counts are halved.
const FIRST_SCANS: u32 = 5;
const STILL_SCANS: u32 = 50;
/// Number of places after which further places must be further apart, by the factor `RARER`, because they give little
/// new information.
const MANY_PLACES: u32 = 100;
const RARER: f64 = 5.0;

/// Voxels of the robot itself, found in the scans of one sensor, in the sensor's frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Body {
    /// For every voxel, the number of places from which it had returns.
    places: Vec<u16>,
    /// For every voxel, the number of scans with returns, from the first scan on. Empty once the sensor has moved.
    scans: Vec<u16>,
    n_places: u32,
    n_scans: u32,
    way: f64,
    last: Option<Transform>,
    first: Option<Transform>,
    is_turned: bool,
    /// Height of the ground relative to the sensor [m].
    ground: f64,
    /// Voxels of the robot, ascending. Empty while none was found.
    voxels: Vec<u32>,
    /// One bit for every voxel of the robot and its neighbours. Empty while none was found.
    mask: Vec<u64>,
    /// One bit for every voxel that may belong to the robot, before the sensor has moved far enough.
    maybe: Vec<u64>,
    /// Whether the voxels come from an earlier run, and no motion in this run has confirmed them yet.
    is_recalled: bool,
    /// Whether turns of the sensor in an earlier run have shown that the voxels are the robot.
    was_decided: bool,
    /// One bit for every voxel that the present scan has met.
    met: Vec<u64>,
    number: u32,
}

impl Default for Body {
    fn default() -> Self {
        Self {
            places: vec![0; VOLUME],
            scans: vec![0; VOLUME],
            n_places: 0,
            n_scans: 0,
            way: 0.0,
            last: None,
            first: None,
            is_turned: false,
            ground: f64::NEG_INFINITY,
            voxels: Vec::new(),
            mask: Vec::new(),
            maybe: Vec::new(),
            is_recalled: false,
            was_decided: false,
            met: vec![0; WORDS],
            number: 0,
        }
    }
}

impl Body {
    /// True if all lists have the right lengths. Checks a saved state.
    pub(crate) fn is_whole(&self) -> bool {
        let masks = [&self.mask, &self.maybe];
        self.places.len() == VOLUME
            && (self.scans.len() == VOLUME || self.scans.is_empty() && self.may_tell())
            && self.met.len() == WORDS
            && masks.iter().all(|mask| mask.is_empty() || mask.len() == WORDS)
            && self.voxels.iter().all(|&voxel| (voxel as usize) < VOLUME)
    }

    /// True if a point in the sensor's frame [m] is on the robot.
    #[inline]
    pub(crate) fn contains(&self, point: [f64; 3]) -> bool {
        !self.mask.is_empty() && voxel_of(point).is_some_and(|voxel| has(&self.mask, voxel))
    }

    /// True if a return at `point` (sensor's frame [m]) is on the robot. Placeholders of drivers are no returns.
    #[inline]
    pub(crate) fn holds(&self, point: [f64; 3]) -> bool {
        self.contains(point) && norm(point) > LEAST_RANGE
    }

    /// True if a point in the sensor's frame [m] may be on the robot, while the sensor has not moved far enough.
    #[inline]
    pub(crate) fn may_contain(&self, point: [f64; 3]) -> bool {
        !self.maybe.is_empty() && voxel_of(point).is_some_and(|voxel| has(&self.maybe, voxel))
    }

    /// True if voxels of the robot were found.
    pub(crate) fn is_found(&self) -> bool {
        !self.mask.is_empty()
    }

    /// True if voxels were found that may be the robot, while the sensor has not moved far enough.
    pub(crate) fn may_be_found(&self) -> bool {
        !self.maybe.is_empty()
    }

    /// True if turns have shown that the found voxels belong to the robot.
    pub(crate) fn is_decided(&self) -> bool {
        (self.is_turned || self.was_decided) && self.is_found()
    }

    /// Voxels of the robot, ascending, and whether turns have confirmed them. None if none was found.
    pub(crate) fn known(&self) -> Option<(&[u32], bool)> {
        self.is_found().then_some((&self.voxels, self.is_decided()))
    }

    /// Use the voxels of the cube around the sensor that an earlier run found. If this run has found the robot
    /// itself, nothing changes.
    pub(crate) fn recall(&mut self, voxels: &[u32], is_decided: bool) {
        if !self.is_found() && voxels.iter().all(|&voxel| (voxel as usize) < VOLUME) {
            self.take_voxels(voxels.to_vec());
            (self.is_recalled, self.was_decided) = (true, is_decided);
        }
    }

    fn take_voxels(&mut self, voxels: Vec<u32>) {
        self.mask = beside(&voxels);
        self.voxels = voxels;
    }

    /// Discard the voxels of an earlier run if too few of them had returns lately: the sensor is on another robot, or
    /// elsewhere on it.
    fn check_recalled(&mut self, counts: &[u16], times: u32) {
        let kept = enough(KEPT_SHARE, times).max(1);
        let met = self.voxels.iter().filter(|&&voxel| counts[voxel as usize] >= kept).count();
        if self.is_recalled && (met as f64) < SAME_SHARE * self.voxels.len() as f64 {
            self.take_voxels(Vec::new());
            (self.is_recalled, self.was_decided) = (false, false);
        }
    }

    /// Count the returns of an accepted scan. The points are in the sensor's frame [m]; `pose` is that of the sensor.
    /// `is_return`: whether the point at an index is a return of something solid.
    pub(crate) fn learn(
        &mut self,
        points: &[[f32; 3]],
        is_return: impl Fn(usize) -> bool,
        pose: &Transform,
    ) {
        let first = *self.first.get_or_insert(*pose);
        let (moved, turned) = self.last.as_ref().map_or((0.0, 0.0), |last| apart(last, pose));
        let rarer = if self.n_places < MANY_PLACES { 1.0 } else { RARER };
        let is_next =
            self.last.is_none() || moved > rarer * NEXT_PLACE || turned > rarer * NEXT_TURN;
        let is_still = !self.may_tell();
        if !(is_next || is_still) || self.n_places >= u32::from(u16::MAX) {
            return; // nothing new
        }
        self.number = self.number.wrapping_add(1);
        self.count(points, is_return, is_next, is_still);
        self.n_scans += u32::from(is_still);
        if self.n_scans >= STILL_SCANS {
            self.n_scans /= 2; // what has left is forgotten
            self.scans.iter_mut().for_each(|scans| *scans /= 2);
        }
        if is_next {
            (self.n_places, self.way, self.last) =
                (self.n_places + 1, self.way + moved, Some(*pose));
            self.is_turned |= apart(&first, pose).1 > DECIDING_TURN;
            self.see_ground(points, pose);
        }
        if self.may_tell() && is_next && self.n_places.is_multiple_of(PLACES_PER_SEARCH) {
            self.search_moved();
        } else if is_still && self.n_scans >= FIRST_SCANS && self.number.is_multiple_of(FIRST_SCANS)
        {
            self.search_still();
        } else if is_still && is_next && (2..=ENOUGH_PLACES).contains(&self.n_places) {
            self.search_first_places();
        }
    }

    /// Search for the robot in the returns from several places.
    fn search_moved(&mut self) {
        let places = std::mem::take(&mut self.places);
        self.check_recalled(&places, self.n_places);
        self.take_voxels(self.found(&places, self.n_places));
        self.places = places;
        self.is_recalled = false;
        (self.scans, self.maybe) = (Vec::new(), Vec::new());
    }

    /// Search for a possible robot in the returns from the first places, before the sensor has moved far enough.
    fn search_first_places(&mut self) {
        let places = std::mem::take(&mut self.places);
        let found = beside(&self.found(&places, self.n_places));
        self.places = places;
        if self.maybe.is_empty() {
            self.maybe = found;
        } else if !found.is_empty() {
            self.maybe.iter_mut().zip(found).for_each(|(maybe, found)| *maybe |= found);
        }
    }

    /// Search for voxels that may be of the robot, before the sensor has moved.
    fn search_still(&mut self) {
        let scans = std::mem::take(&mut self.scans);
        self.check_recalled(&scans, self.n_scans);
        self.maybe = beside(&self.found(&scans, self.n_scans));
        self.scans = scans;
    }

    /// Forget the poses so far. Those of another map cannot be compared with them.
    pub(crate) fn forget_places(&mut self) {
        (self.first, self.last) = (None, None);
        self.maybe = Vec::new();
    }

    /// True if the sensor has moved far enough to distinguish the robot from the world.
    fn may_tell(&self) -> bool {
        self.n_places >= ENOUGH_PLACES && self.way >= ENOUGH_WAY
    }

    fn count(
        &mut self,
        points: &[[f32; 3]],
        is_return: impl Fn(usize) -> bool,
        is_next: bool,
        is_still: bool,
    ) {
        self.met.fill(0);
        for (row, &point) in points.iter().enumerate() {
            let point = wide(point);
            let is_usable = norm(point) > LEAST_RANGE && is_return(row);
            let Some(voxel) = voxel_of(point).filter(|_| is_usable) else { continue };
            if has(&self.met, voxel) {
                continue;
            }
            self.met[voxel / 64] |= 1 << (voxel % 64);
            self.places[voxel] = self.places[voxel].saturating_add(u16::from(is_next));
            if is_still {
                self.scans[voxel] = self.scans[voxel].saturating_add(1);
            }
        }
    }

    /// Update the height of the ground from the lowest returns, along the vertical of the map.
    fn see_ground(&mut self, points: &[[f32; 3]], pose: &Transform) {
        let down = pose.inverse().rotate([0.0, 0.0, 1.0]);
        let finite = points.iter().filter(|point| point.iter().all(|value| value.is_finite()));
        let step = (points.len() / 4096).max(1);
        let mut heights: Vec<f64> =
            finite.step_by(step).map(|&point| dot(wide(point), down)).collect();
        let rank = heights.len() / LOWEST;
        if heights.len() > LOWEST {
            self.ground = *heights.select_nth_unstable_by(rank, f64::total_cmp).1;
        }
    }

    /// The voxels of the robot. `counts`: how often each voxel had returns, of `times`.
    fn found(&self, counts: &[u16], times: u32) -> Vec<u32> {
        let (sure, likely) = (enough(HELD_SHARE, times), enough(0.5 * HELD_SHARE, times).max(1));
        let mut state: Vec<u8> = counts
            .iter()
            .map(|&count| u8::from(count >= likely) + u8::from(count >= sure))
            .collect();
        let kept = enough(KEPT_SHARE, times).max(1);
        for (voxel, (state, &count)) in state.iter_mut().zip(counts).enumerate() {
            if count >= kept && !self.mask.is_empty() && has(&self.mask, voxel) {
                *state = 2;
            }
        }
        let up = self.last.map_or([0.0, 0.0, 1.0], |pose| pose.inverse().rotate([0.0, 0.0, 1.0]));
        let (mut found, mut part) = (Vec::new(), Vec::new());
        for first in 0..VOLUME {
            if state[first] == 2
                && let Some(nearest) = self.take_part(first, &mut state, &mut part, up)
                && (nearest <= BESIDE_SENSOR || is_rigid(&part, counts))
            {
                found.extend(part.iter().map(|&voxel| voxel as u32));
            }
        }
        found.sort_unstable();
        found
    }

    /// Gather in `part` the voxels connected with `first`. Returns their smallest distance from the sensor [m]. None
    /// if they cannot be a part of the robot.
    fn take_part(
        &self,
        first: usize,
        state: &mut [u8],
        part: &mut Vec<usize>,
        up: [f64; 3],
    ) -> Option<f64> {
        part.clear();
        part.push(first);
        state[first] = 0;
        let (mut nearest, mut farthest, mut n_ground, mut next) = (f64::INFINITY, 0.0f64, 0, 0);
        while let Some(&voxel) = part.get(next) {
            next += 1;
            let center = center_of(voxel);
            nearest = nearest.min(norm(center));
            farthest = farthest.max(norm(center));
            n_ground += usize::from(dot(center, up) < self.ground + GROUND);
            around(voxel, GAP, |beside| {
                if state[beside] > 0 {
                    state[beside] = 0;
                    part.push(beside);
                }
            });
        }
        let is_part = nearest <= NEAR_ZONE && farthest <= FARTHEST && 2 * n_ground <= part.len();
        is_part.then_some(nearest)
    }
}

/// True if the returns on a part and beside it stay in the same voxels.
fn is_rigid(part: &[usize], counts: &[u16]) -> bool {
    let voxels: Vec<u32> = part.iter().map(|&voxel| voxel as u32).collect();
    let near = beside(&voxels);
    let most = part.iter().map(|&voxel| counts[voxel]).max().unwrap_or(0);
    let held = (0..VOLUME).filter(|&voxel| has(&near, voxel)).map(|voxel| counts[voxel]);
    let (mut total, mut squares) = (0.0, 0.0);
    for count in held.filter(|&count| count >= enough(RARE_SHARE, u32::from(most))) {
        total += f64::from(count);
        squares += f64::from(count) * f64::from(count);
    }
    squares >= RIGID_SHARE * total * f64::from(most)
}

/// The smallest whole number that is at least a share of `times`.
fn enough(share: f64, times: u32) -> u16 {
    (share * f64::from(times)).ceil() as u16
}

/// Distance [m] and angle [rad] between two poses.
fn apart(one: &Transform, other: &Transform) -> (f64, f64) {
    let turn = one.inverse().after(other).rotation;
    let cosine = 0.5 * (turn[0][0] + turn[1][1] + turn[2][2] - 1.0);
    (norm(minus(one.translation, other.translation)), libm::acos(cosine.clamp(-1.0, 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A scan of a roof of 1 m by 1 m, 1.4 m behind the sensor, above a street with a wall along it.
    fn scan(pose: &Transform) -> Vec<[f32; 3]> {
        let mut points = Vec::new();
        for index in 0..400 {
            let (a, b) = ((index % 20) as f32 * 0.05, (index / 20) as f32 * 0.05);
            points.push([-1.4 - a, b - 0.5, -0.4]);
        }
        let from_map = pose.inverse();
        for index in 0..40_000 {
            let (a, b) = (f64::from(index % 200), f64::from(index / 200));
            let ground = from_map.apply([0.2 * a - 20.0, 0.2 * b - 20.0, -2.0]);
            points.push(ground.map(|value| value as f32));
        }
        for index in 0..4_000 {
            let (a, b) = (f64::from(index % 400), f64::from(index / 400));
            points.push(
                from_map.apply([0.2 * a - 20.0, 1.5, 0.2 * b - 1.0]).map(|value| value as f32),
            );
        }
        points
    }

    fn pose(x: f64, yaw: f64) -> Transform {
        let (sine, cosine) = (libm::sin(yaw), libm::cos(yaw));
        let rotation = [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]];
        Transform { rotation, translation: [x, 0.0, 0.0] }
    }

    #[test]
    fn a_roof_that_goes_along_is_the_robot_and_ground_and_walls_are_not() {
        let mut body = Body::default();
        for step in 0..12 {
            let pose = pose(0.5 * f64::from(step), 0.0);
            body.learn(&scan(&pose), |_| true, &pose);
        }
        assert!(body.contains([-1.8, 0.0, -0.4]) && !body.is_decided());
        for other in [[2.0, 1.5, 0.0], [0.0, 1.5, 0.5], [3.0, 0.0, -2.0], [-1.8, 0.0, -2.0]] {
            assert!(!body.contains(other), "{other:?}");
        }
        for step in 0..12 {
            let pose = pose(6.0, 0.06 * f64::from(step));
            body.learn(&scan(&pose), |_| true, &pose);
        }
        assert!(body.is_decided() && body.contains([-1.8, 0.0, -0.4]));
    }

    #[test]
    fn an_escort_five_metres_off_is_no_robot() {
        let mut body = Body::default();
        for step in 0..60 {
            let pose = pose(0.5 * f64::from(step), 0.02 * f64::from(step));
            let mut points = scan(&pose);
            points.extend((0..50).map(|index| [0.01 * index as f32, 5.0, 0.5]));
            body.learn(&points, |_| true, &pose);
        }
        assert!(!body.contains([0.2, 5.0, 0.5]) && body.contains([-1.8, 0.0, -0.4]));
    }

    /// The object circles with a radius of half a metre beside the sensor, nearer than parts of the robot may be.
    #[test]
    fn what_flies_along_on_a_small_circle_is_no_robot() {
        let mut body = Body::default();
        let near = |points: &mut Vec<[f32; 3]>, [x, y]: [f64; 2]| {
            points.extend((0..60).map(|index| {
                let angle = 0.05 * f64::from(index);
                let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
                [x + 0.3 * cosine, y - 0.3 * sine, 0.5].map(|value| value as f32)
            }));
        };
        for step in 0..30 {
            let pose = pose(0.5 * f64::from(step), 0.0);
            let angle = 0.35 * f64::from(step);
            let mut points = scan(&pose);
            near(&mut points, [0.4 * libm::cos(angle), 3.0 + 0.4 * libm::sin(angle)]);
            near(&mut points, [1.0, -2.5]); // a mirror on an arm
            body.learn(&points, |_| true, &pose);
        }
        let hits = (0..VOLUME).filter(|&voxel| has(&body.mask, voxel)).map(center_of);
        assert!(hits.filter(|center| center[1] > 1.5 && center[2] > 0.0).count() == 0);
        assert!(body.contains([1.0, -2.8, 0.5]) && body.contains([-1.8, 0.0, -0.4]));
    }

    #[test]
    fn what_leaves_the_robot_is_none_of_it() {
        let mut body = Body::default();
        for step in 0..60 {
            let pose = pose(0.5 * f64::from(step), 0.0);
            let mut points = scan(&pose);
            if step < 10 {
                points.extend((0..50).map(|index| [0.01 * index as f32, -1.0, 0.5]));
            }
            body.learn(&points, |_| true, &pose);
            if step == 9 {
                assert!(body.contains([0.2, -1.0, 0.5]));
            }
        }
        assert!(!body.contains([0.2, -1.0, 0.5]));
    }

    #[test]
    fn what_stood_near_and_has_left_is_no_robot_before_the_sensor_moves() {
        let mut body = Body::default();
        let still = pose(0.0, 0.0);
        let thing: Vec<[f32; 3]> = (0..50).map(|index| [1.5, 0.01 * index as f32, 0.5]).collect();
        for scan in 0..100 {
            body.learn(if scan < 60 { &thing } else { &[[4.0, 4.0, 0.5]] }, |_| true, &still);
            if scan == 59 {
                assert!(body.may_contain([1.5, 0.2, 0.5]));
            }
        }
        assert!(!body.may_contain([1.5, 0.2, 0.5]));
    }

    #[test]
    fn a_sensor_that_drives_off_at_once_knows_after_two_places_what_may_be_the_robot() {
        let mut body = Body::default();
        for step in 0..4 {
            let pose = pose(1.2 * f64::from(step), 0.0);
            body.learn(&scan(&pose), |_| true, &pose);
            assert_eq!(body.may_contain([-1.8, 0.0, -0.4]), step > 0);
            assert!(!body.is_found());
            // The opposites: the wall along the way, the ground, and what is nowhere.
            for other in [[0.0, 1.5, 0.5], [3.0, 0.0, -2.0], [1.0, 0.0, 0.5]] {
                assert!(!body.may_contain(other), "{other:?}");
            }
        }
    }

    #[test]
    fn rows_without_return_are_no_part_of_the_robot() {
        let mut body = Body::default();
        for step in 0..40 {
            let mut points = vec![[0.0f32; 3]; 20];
            points.extend([[0.1f32; 3]; 20]);
            points.extend([[1.0f32, 0.0, 0.0]; 20]);
            body.learn(&points, |row| row < 40, &pose(0.5 * f64::from(step), 0.0));
        }
        for place in [[0.0; 3], [0.1; 3], [1.0, 0.0, 0.0]] {
            assert!(!body.contains(place), "{place:?}");
        }
    }

    fn after_a_drive() -> Body {
        let mut body = Body::default();
        for step in 0..30 {
            let pose = pose(0.5 * f64::from(step), 0.05 * f64::from(step));
            body.learn(&scan(&pose), |_| true, &pose);
        }
        body
    }

    #[test]
    fn what_an_earlier_run_found_is_known_at_once_and_stays() {
        let before = after_a_drive();
        let mut body = Body::default();
        if let Some((voxels, is_decided)) = before.known() {
            body.recall(voxels, is_decided);
        }
        assert!(body.is_decided() && body.contains([-1.8, 0.0, -0.4]));
        for step in 0..60 {
            let pose = pose((0.5 * f64::from(step) - 10.0).max(0.0), 0.0); // stands, then drives
            body.learn(&scan(&pose), |_| true, &pose);
            assert!(body.is_decided() && body.contains([-1.8, 0.0, -0.4]), "{step}");
        }
    }

    #[test]
    fn a_sensor_that_sits_elsewhere_forgets_its_robot_standing_or_driving() {
        let before = after_a_drive();
        assert!(before.is_decided());
        let (voxels, is_decided) = before.known().unwrap_or_default();
        for speed in [0.0, 0.5] {
            let mut body = Body::default();
            body.recall(voxels, is_decided);
            for step in 0..FIRST_SCANS {
                let pose = pose(speed * f64::from(step), 0.0);
                let turned = scan(&pose).into_iter().map(|[x, y, z]| [-x, y, z]);
                body.learn(&turned.collect::<Vec<_>>(), |_| true, &pose);
            }
            assert!(!body.contains([-1.8, 0.0, -0.4]) && !body.is_decided(), "{speed}");
        }
    }

    #[test]
    fn before_it_moves_a_sensor_may_see_its_robot() {
        let mut body = Body::default();
        for _ in 0..8 {
            body.learn(&scan(&pose(0.0, 0.0)), |_| true, &pose(0.0, 0.0));
        }
        assert!(body.may_contain([-1.8, 0.0, -0.4]) && !body.contains([-1.8, 0.0, -0.4]));
        assert!(!body.may_contain([0.0, 1.5, 0.5]));
    }
}
