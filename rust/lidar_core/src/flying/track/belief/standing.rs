//! Objects in free space during the burn-in: a target that hovers, or a hanging object.
//!
//! Before it moves, both look alike, so its kind is unknown. Its points are background from the
//! burn-in on. After it has left, a new track follows it.

use super::super::detections::Detections;
use super::super::measurement::CloudScan;
use super::super::motion::{position_block, seconds};
use super::super::state::PointTrack;
use super::super::visibility::occupancy::Visibility;
use super::super::{ExpectedTarget, Track};
use crate::estimation::kalman::Gaussian;
use crate::tracking::kind::{KINDS, KindBelief, TrackKind};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};

/// Points this far outside the box around it may be its own: it never quite stands still [m].
const MARGIN: f64 = 0.15;
/// It is gone if rays have passed through its place, and met nothing there, for so long [s].
const GONE: f64 = 0.25;
/// Shares of the kinds of what stands in free air, in the order of `TrackKind::ALL`: most things are
/// not decided before they move.
const SHARES: [f64; KINDS] = [0.6, 0.2, 0.0, 0.2, 0.0];
/// Mean time for which a target hovers [s]: what stands for much longer hangs there.
const HOVERS: f64 = 60.0;
/// Probability that something is there: it was seen in most scans of the burn-in.
const EXISTENCE: f64 = 0.99;
/// Standard deviations of its speed [m/s] and acceleration [m/s^2].
const STILL: [f64; 2] = [0.05, 0.05];
/// A track that began this near to its place [m], besides its size, may be it.
const REACH: f64 = 0.5;
/// A detection this far from its place [m], and two standard deviations, shows that it has moved: what hangs
/// there does not.
const LEFT: f64 = 0.25;
/// In the first scans in which it moves it goes at most this far [m]: after that, nothing of the map is near it.
const STARTS: f64 = 0.5;
/// Larger things show new sides without moving, as do those of which parts this near to each other are known [m] ...
const SMALL: f64 = 1.0;
/// ... and the map does not hold all of a thing from the beginning [s].
const SETTLED: f64 = 0.3;
/// It is still there if a point at its place is this near to what the map holds [m]: where rays have passed
/// through its place, what is there now is not what stood there.
const HELD: f64 = 0.5;

/// Something that stands in free space.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(in crate::flying::track) struct UnmovedTarget {
    pub(in crate::flying::track) id: i64,
    position: Vector3<f64>,
    covariance: Matrix3<f64>,
    extent: [f64; 3],
    born_ns: i64,
    seen_ns: i64,
    /// False if the newest scan has no point at its place.
    is_there: bool,
    /// Since when all scans have shown that nothing is there.
    empty_ns: Option<i64>,
}

impl UnmovedTarget {
    /// The detection `index` of a set.
    pub(in crate::flying::track) fn new(
        id: i64,
        detections: &Detections<'_>,
        index: usize,
    ) -> Self {
        let of_detection = |all: &[[[f64; 3]; 3]]| Matrix3::from_fn(|r, c| all[index][r][c]);
        Self {
            id,
            position: detections.positions[index].into(),
            covariance: detections.covariance.map_or_else(Matrix3::identity, of_detection),
            extent: detections.extent.map_or([0.0; 3], |extent| extent[index]),
            born_ns: detections.stamp_ns,
            seen_ns: detections.stamp_ns,
            is_there: true,
            empty_ns: None,
        }
    }

    /// Radius of the ball around its place that holds all of it [m].
    fn radius(&self) -> f64 {
        0.5 * Vector3::from(self.extent).norm() + MARGIN
    }

    /// Where it is looked for if it moves.
    fn expected(&self) -> ExpectedTarget {
        ExpectedTarget {
            position: self.position.into(),
            velocity: [0.0; 3],
            half: self.extent.map(|side| 0.5 * side + STARTS),
            size: self.extent,
            has_stood: true,
        }
    }

    /// As a track at `stamp_ns`, reported if `is_recent` says so of the time when it was seen.
    pub(in crate::flying::track) fn track(
        &self,
        stamp_ns: i64,
        is_recent: impl Fn(i64) -> bool,
    ) -> Track {
        let mut mean = SVector::<f64, 9>::zeros();
        mean.fixed_rows_mut::<3>(0).copy_from(&self.position);
        let mut covariance = SMatrix::<f64, 9, 9>::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.covariance);
        for (axis, std) in [(3, STILL[0]), (6, STILL[1])] {
            (axis..axis + 3).for_each(|row| covariance[(row, row)] = std * std);
        }
        let kinds = self.kinds(stamp_ns);
        Track {
            id: self.id,
            stamp_ns,
            state: Gaussian { mean, covariance },
            extent: self.extent,
            n_detections: 1,
            age: seconds(self.born_ns, stamp_ns),
            seen_ns: self.seen_ns,
            confirmed: true,
            reported: is_recent(self.seen_ns),
            existence: EXISTENCE,
            kind: kinds.kind(),
            kind_probability: kinds.probabilities(),
        }
    }

    /// The longer it stands, the less probable it is a target that hovers.
    fn kinds(&self, stamp_ns: i64) -> KindBelief {
        let hovers = libm::exp(-seconds(self.born_ns, stamp_ns).max(0.0) / HOVERS);
        let mut likelihood = [hovers; KINDS];
        likelihood[usize::from(u8::from(TrackKind::Static))] = 1.0;
        KindBelief::prior(SHARES).weighed(likelihood)
    }

    /// Whether a track is this one, which has left its place.
    fn is_now(&self, track: &PointTrack) -> bool {
        let away = (track.born_at - self.position).norm();
        !self.is_there && track.born_ns >= self.born_ns && away <= self.radius() + REACH
    }

    /// Whether a track is surely away from its place.
    fn is_away(&self, track: &PointTrack) -> bool {
        let covariance = self.covariance + position_block(&track.estimate.covariance);
        let std = (covariance.trace() / 3.0).max(0.0).sqrt();
        (track.position() - self.position).norm() >= LEFT + 2.0 * std
    }
}

/// What stands and may move at `stamp_ns`: near its own place, which the map takes for structure.
pub(in crate::flying::track) fn expected_at(
    standing: &[UnmovedTarget],
    stamp_ns: i64,
) -> impl Iterator<Item = ExpectedTarget> {
    let may_move = move |target: &&UnmovedTarget| {
        let is_part_of = |other: &UnmovedTarget| {
            other.id != target.id && (other.position - target.position).norm() <= SMALL
        };
        seconds(target.born_ns, stamp_ns) >= SETTLED
            && target.extent.iter().all(|&side| side <= SMALL)
            && !standing.iter().any(is_part_of)
    };
    standing.iter().filter(may_move).map(UnmovedTarget::expected)
}

/// Look for what stands in a scan. What has gone is removed; the numbers of these.
pub(in crate::flying::track) fn look(
    standing: &mut Vec<UnmovedTarget>,
    scan: &CloudScan<'_>,
) -> Vec<i64> {
    for target in standing.iter_mut() {
        let holds = |point: &[f32; 3]| {
            let place = point.map(f64::from);
            (Vector3::from(place) - target.position).norm() <= target.radius()
                && scan.occupied.any_within(place, HELD)
        };
        target.is_there = scan.points.iter().any(holds);
        if target.is_there {
            target.seen_ns = scan.stamp_ns;
        }
        // Where nothing could be seen, it may still be there.
        let expected =
            |view: &dyn Visibility| view.expected(target.position.into(), target.radius());
        let is_empty = !target.is_there && scan.visibility.is_some_and(expected);
        target.empty_ns = is_empty.then(|| target.empty_ns.unwrap_or(scan.stamp_ns));
    }
    let is_gone = |target: &UnmovedTarget| {
        target.empty_ns.is_some_and(|since| seconds(since, scan.stamp_ns) >= GONE)
    };
    let gone = standing.iter().filter(|target| is_gone(target)).map(|target| target.id).collect();
    standing.retain(|target| !is_gone(target));
    gone
}

/// Confirm the tracks that follow what stood from the moment on at which it has surely left its place, as
/// far as that makes their targets as probable as `report`: it existed before. Their numbers are added to
/// `confirmed`.
pub(in crate::flying::track) fn follow(
    standing: &[UnmovedTarget],
    tracks: &mut [PointTrack],
    report: f64,
    confirmed: &mut Vec<i64>,
) {
    for track in tracks.iter_mut().filter(|track| !track.confirmed) {
        if standing.iter().any(|target| target.is_now(track) && target.is_away(track)) {
            track.belief.exists(EXISTENCE);
            track.confirmed = track.existence() >= report;
            track.was_confirmed |= track.confirmed;
            confirmed.extend(track.confirmed.then_some(track.id));
        }
    }
}

/// Give the numbers of what stood, and has left, to the tracks that follow it since. Pairs of the
/// number that stays and the one that goes.
pub(in crate::flying::track) fn hand_over(
    standing: &mut Vec<UnmovedTarget>,
    tracks: &mut [PointTrack],
    confirmed: &mut [i64],
) -> Vec<[i64; 2]> {
    let mut merged = Vec::new();
    for number in confirmed.iter_mut() {
        let Some(track) = tracks.iter_mut().find(|track| track.id == *number) else { continue };
        let Some(place) = standing.iter().position(|target| target.is_now(track)) else { continue };
        let target = standing.remove(place);
        merged.push([target.id, track.id]);
        (track.id, *number) = (target.id, target.id);
        track.born_ns = target.born_ns;
    }
    merged
}
