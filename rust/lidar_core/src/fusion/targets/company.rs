//! Way of a track lately: whether it stands, and whether it goes along with an older one ahead or
//! astern, as parts of one long object do.

use super::many_parameters::ManyParameters;
use super::tracks::Tracks;
use crate::tracking::near::{NearIndex, Rectangle};
use serde::{Deserialize, Serialize};

/// Times between two places that are kept [ns].
const STEP_NS: i64 = 1_000_000_000;
/// How far back the mean speed looks that says whether a track stands, and how long the track must
/// be known [ns].
const STANDING_NS: [i64; 2] = [15_000_000_000, 5_000_000_000];
/// The same for the velocity of tracks that go along with one another.
const ALONG_NS: [i64; 2] = [5_000_000_000, 2_000_000_000];
/// Largest distance of parts of one object along its way and across it, over the distance within
/// which no track starts: objects are long rather than wide, and what goes abreast is another one.
const PART: [f64; 2] = [1.5, 0.6];
/// Largest difference of the velocities of parts [m/s].
const SLIP: f64 = 3.0;
/// Speed below which an object has no direction [m/s].
const SLOWEST: f64 = 0.3;
/// Scans for which a track has to go along before it counts as a part.
const PATIENCE: u32 = 5;

/// Where a track was, and with whom.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct RecentPath {
    /// Times [ns] and places [m], oldest first.
    places: Vec<(i64, [f64; 2])>,
    /// Scans of late in which the track went along with an older one.
    together: u32,
    is_part: bool,
    is_standing: bool,
}

impl RecentPath {
    /// True for tracks that are not reported: parts, and those that stand.
    pub(super) fn is_left_out(&self) -> bool {
        self.is_part || self.is_standing
    }

    fn pass(&mut self, stamp_ns: i64, place: [f64; 2]) {
        if self.places.last().is_none_or(|(last, _)| stamp_ns.saturating_sub(*last) >= STEP_NS) {
            self.places.push((stamp_ns, place));
        }
        let oldest = stamp_ns.saturating_sub(STANDING_NS[0]);
        self.places.retain(|(stamp, _)| *stamp >= oldest);
    }

    /// Mean velocity over the last `span` [ns] until now; None if less than `least` is known.
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

/// A reported track at one time.
struct Fellow {
    row: usize,
    place: [f64; 2],
    velocity: Option<[f64; 2]>,
}

impl Tracks {
    /// Say of every confirmed track whether it stands, and whether it is part of another one.
    pub(super) fn keep_company(&mut self, parameters: &ManyParameters, stamp_ns: i64) {
        let (slowest, distance) = (parameters.report_speed, parameters.birth_distance);
        if slowest <= 0.0 && distance <= 0.0 {
            return;
        }
        let mut fellows = Vec::new();
        for (row, track) in self.all.iter_mut().enumerate().filter(|(_, track)| track.confirmed) {
            let Some(output) = track.filter.output_at(stamp_ns) else { continue };
            let place = [output.mean[0], output.mean[1]];
            if !place.iter().all(|value| value.is_finite()) {
                continue;
            }
            track.way.pass(stamp_ns, place);
            let mean = track.way.velocity(stamp_ns, place, STANDING_NS);
            track.way.is_standing = mean.is_some_and(|v| libm::hypot(v[0], v[1]) < slowest);
            if !track.way.is_standing {
                let velocity = track.way.velocity(stamp_ns, place, ALONG_NS);
                fellows.push(Fellow { row, place, velocity });
            }
        }
        if distance > 0.0 {
            self.find_parts(&mut fellows, distance);
        }
    }

    /// Mark those that go along with a track that has more measurements.
    fn find_parts(&mut self, fellows: &mut [Fellow], distance: f64) {
        fellows.sort_by_key(|one| {
            let track = &self.all[one.row];
            (std::cmp::Reverse(track.hits), track.born_ns, track.id)
        });
        let index = NearIndex::new(fellows.iter().map(|one| one.place).zip(0..).collect());
        let mut leads = vec![false; fellows.len()];
        let mut near = Vec::new();
        let reach = libm::hypot(PART[0], PART[1]) * distance;
        for (number, one) in fellows.iter().enumerate() {
            near.clear();
            index.collect(&Rectangle::around(one.place, [reach; 2]), &mut near);
            let is_along =
                near.iter().any(|other| leads[*other] && fellows[*other].has(one, distance));
            let way = &mut self.all[one.row].way;
            way.together = match is_along {
                true => (way.together + 1).min(2 * PATIENCE),
                false => way.together.saturating_sub(1),
            };
            way.is_part = is_along && way.together > PATIENCE;
            leads[number] = !is_along;
        }
    }
}

impl Fellow {
    /// True if `other` may be a part of the same object.
    fn has(&self, other: &Self, distance: f64) -> bool {
        let (Some(own), Some(its)) = (self.velocity, other.velocity) else { return false };
        let speed = libm::hypot(own[0], own[1]);
        if speed < SLOWEST || libm::hypot(own[0] - its[0], own[1] - its[1]) > SLIP {
            return false;
        }
        let [dx, dy] = [other.place[0] - self.place[0], other.place[1] - self.place[1]];
        let along = (dx * own[0] + dy * own[1]) / speed;
        let across = (dx * own[1] - dy * own[0]) / speed;
        along.abs() <= PART[0] * distance && across.abs() <= PART[1] * distance
    }
}
