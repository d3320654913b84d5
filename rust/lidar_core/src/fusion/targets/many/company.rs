//! Recent path of a track. It shows whether the target is at rest, and whether it is a part of a
//! long object: it moves with another track that is ahead or astern of it.

use crate::tracking::near::{NearIndex, Rectangle};
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;

/// Time between two stored positions [ns].
const STEP_NS: i64 = 1_000_000_000;
/// Time over which the mean speed is computed that decides whether a track is at rest, and least
/// age of the track for this decision [ns].
const STANDING_NS: [i64; 2] = [15_000_000_000, 5_000_000_000];
/// Time over which the mean velocity is computed that decides which tracks move together, and least
/// age of a track for this decision [ns].
const ALONG_NS: [i64; 2] = [5_000_000_000, 2_000_000_000];
/// Largest distance between parts of one object, along its course and across it, as multiples of
/// `birth_distance`. Objects are longer than wide, and a track beside another one is another
/// object.
const PART: [f64; 2] = [1.5, 0.6];
/// Distance to the side of a track's course from which on another track may start, as a multiple of
/// `birth_distance`. It is smaller than for parts, because the motion of both tracks later shows
/// whether they are parts of one object.
const ABREAST: f64 = 0.5;
/// Half of the width of an object, as a multiple of `birth_distance`.
const HALF_WIDTH: f64 = 0.25;
/// Largest difference between the velocities of two parts of one object [m/s].
const SLIP: f64 = 3.0;
/// Speed below which the course of an object is not used [m/s].
const SLOWEST: f64 = 0.3;
/// Value of the counter `together` above which a track counts as a part [scans].
const PATIENCE: u32 = 5;

/// Recent positions of a track, and whether it is at rest or a part of another track.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct RecentPath {
    /// Times [ns] and positions [m], frame of the tracks, oldest first.
    places: Vec<(i64, [f64; 2])>,
    /// Counter of scans: one more for every scan in which the track moves with another track, one
    /// less for every other scan.
    together: u32,
    is_part: bool,
    is_standing: bool,
}

impl RecentPath {
    /// True for tracks that are not reported: parts, and tracks at rest.
    pub(super) fn is_left_out(&self) -> bool {
        self.is_part || self.is_standing
    }

    /// Store the position of the track.
    pub(super) fn pass(&mut self, stamp_ns: i64, place: [f64; 2]) {
        if self.places.last().is_none_or(|(last, _)| stamp_ns.saturating_sub(*last) >= STEP_NS) {
            self.places.push((stamp_ns, place));
        }
        let oldest = stamp_ns.saturating_sub(STANDING_NS[0]);
        self.places.retain(|(stamp, _)| *stamp >= oldest);
    }

    /// Position of the track, and its mean velocity over the last 5 s.
    pub(super) fn course(&self, stamp_ns: i64, place: [f64; 2]) -> Course {
        Course { place, velocity: self.velocity(stamp_ns, place, ALONG_NS) }
    }

    /// Mean velocity [m/s] over the last `span` [ns]; None if the stored positions cover less than
    /// `least` [ns].
    fn velocity(
        &self,
        stamp_ns: i64,
        place: [f64; 2],
        [span, least]: [i64; 2],
    ) -> Option<[f64; 2]> {
        let oldest = stamp_ns.saturating_sub(span);
        let (since, from) = self.places.iter().find(|(stamp, _)| *stamp >= oldest)?;
        let elapsed = stamp_ns.saturating_sub(*since);
        let seconds = elapsed as f64 * 1e-9;
        (elapsed >= least).then(|| [(place[0] - from[0]) / seconds, (place[1] - from[1]) / seconds])
    }
}

/// A confirmed track at one time.
pub(super) struct Fellow<'a> {
    pub(super) path: &'a mut RecentPath,
    pub(super) place: [f64; 2],
    /// Number of measurements, time of the first one [ns], ID of the track.
    pub(super) rank: (Reverse<u32>, i64, i64),
}

/// Position of a track [m] and its mean velocity [m/s]; the velocity is None if the track is too
/// young.
#[derive(Clone, Copy)]
pub(super) struct Course {
    pub(super) place: [f64; 2],
    velocity: Option<[f64; 2]>,
}

/// Decide for every confirmed track whether it is at rest (mean speed below `slowest` [m/s]), and
/// whether it is a part of a track with more measurements. `distance`: `birth_distance` [m].
pub(super) fn keep_company(mut all: Vec<Fellow<'_>>, slowest: f64, distance: f64, stamp_ns: i64) {
    for one in &mut all {
        let mean = one.path.velocity(stamp_ns, one.place, STANDING_NS);
        one.path.is_standing = mean.is_some_and(|v| libm::hypot(v[0], v[1]) < slowest);
    }
    if distance <= 0.0 {
        return;
    }
    all.retain(|one| !one.path.is_standing);
    all.sort_by_key(|one| one.rank);
    let course = |one: &Fellow<'_>| one.path.course(stamp_ns, one.place);
    let courses: Vec<Course> = all.iter().map(course).collect();
    let index = NearIndex::new(courses.iter().map(|one| one.place).zip(0..).collect());
    let mut leads = vec![false; all.len()];
    let mut near = Vec::new();
    let reach = libm::hypot(PART[0], PART[1]) * distance;
    for (number, one) in all.iter_mut().enumerate() {
        near.clear();
        index.collect(&Rectangle::around(one.place, [reach; 2]), &mut near);
        let own = courses[number];
        let is_along =
            near.iter().any(|other| leads[*other] && courses[*other].has(&own, distance));
        let path = &mut *one.path;
        path.together = if is_along {
            (path.together + 1).min(2 * PATIENCE)
        } else {
            path.together.saturating_sub(1)
        };
        path.is_part = is_along && path.together > PATIENCE;
        leads[number] = !is_along;
    }
}

/// Tracks whose objects may have given other returns as well.
pub(super) struct Bodies {
    courses: Vec<Course>,
    index: NearIndex,
}

impl Bodies {
    pub(super) fn new(courses: Vec<Course>) -> Self {
        let index = NearIndex::new(courses.iter().map(|one| one.place).zip(0..).collect());
        Self { courses, index }
    }

    /// True if `place` is within `distance` [m] of one of the tracks, and not too far to the side
    /// of its course.
    pub(super) fn hold(&self, place: [f64; 2], distance: f64) -> bool {
        let mut near = Vec::new();
        self.index.collect(&Rectangle::around(place, [distance; 2]), &mut near);
        near.iter().any(|number| {
            let own = &self.courses[*number];
            let [dx, dy] = [0, 1].map(|axis| place[axis] - own.place[axis]);
            let is_abeam = own.offset(place).is_some_and(|[_, y]| y.abs() > ABREAST * distance);
            libm::hypot(dx, dy) < distance && !is_abeam
        })
    }
}

impl Course {
    /// True if a place is too far to the side of the course to be on the object.
    pub(super) fn is_abeam(&self, place: [f64; 2], distance: f64) -> bool {
        self.offset(place).is_some_and(|[_, y]| y.abs() > HALF_WIDTH * distance)
    }

    /// Offset of a place from the track: ahead, and to the right [m]; None for a track that hardly
    /// moves.
    fn offset(&self, place: [f64; 2]) -> Option<[f64; 2]> {
        let [vx, vy] = self.velocity?;
        let speed = libm::hypot(vx, vy);
        let [dx, dy] = [0, 1].map(|axis| place[axis] - self.place[axis]);
        let ahead = (dx * vx + dy * vy) / speed;
        (speed >= SLOWEST).then(|| [ahead, (dx * vy - dy * vx) / speed])
    }

    /// True if `other` may be a part of the same object.
    fn has(&self, other: &Self, distance: f64) -> bool {
        let (Some(own), Some(its)) = (self.velocity, other.velocity) else { return false };
        if libm::hypot(own[0] - its[0], own[1] - its[1]) > SLIP {
            return false;
        }
        self.offset(other.place).is_some_and(|[along, across]| {
            along.abs() <= PART[0] * distance && across.abs() <= PART[1] * distance
        })
    }
}
