//! Objects that stand in free space during the burn-in: targets that hover, or hanging objects.
//!
//! Both look alike until they move, so their kind is unknown. Their points are background from the
//! burn-in on. When such a target leaves, a new track follows it.

use super::super::detections::Detections;
use super::super::measurement::CloudScan;
use super::super::motion::{position_block, seconds};
use super::super::state::PointTrack;
use super::super::visibility::occupancy::Visibility;
use super::super::{ExpectedTarget, Track};
use super::stood::StoodPlaces;
use crate::estimation::kalman::Gaussian;
use crate::tracking::kind::{KINDS, KindBelief, TrackKind};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};

/// Points this far outside the box around an object may still be its own, since it never stands
/// quite still [m].
const MARGIN: f64 = 0.15;
/// The object is gone if rays have passed through its place for this time [s] without a hit.
const GONE: f64 = 0.25;
/// Prior probabilities of the kinds of an object that stands in free air, in the order of
/// `TrackKind::ALL`. For most such objects the kind remains undecided until they move.
const SHARES: [f64; KINDS] = [0.6, 0.2, 0.0, 0.2, 0.0];
/// Mean time for which a target hovers [s]. An object that stands for much longer probably hangs
/// there.
const HOVERS: f64 = 60.0;
/// Probability that the object exists: it was seen in most scans of the burn-in.
const EXISTENCE: f64 = 0.99;
/// Standard deviations of the object's speed [m/s] and acceleration [m/s^2].
const STILL: [f64; 2] = [0.05, 0.05];
/// A track may follow the object if it began within this distance of its place [m], in addition to
/// the object's radius.
const REACH: f64 = 0.5;
/// A track this far from the object's place [m], plus two standard deviations, shows that the
/// object has moved. A hanging object does not.
const LEFT: f64 = 0.25;
/// Largest distance that the object moves in its first scans of motion [m]. After that, no occupied
/// voxel is near it.
const STARTS: f64 = 0.5;
/// Largest side of an object that is expected to move, and smallest distance to other such objects
/// [m]. Larger objects, and those of several parts, show new sides without moving.
const SMALL: f64 = 1.0;
/// Time after the burn-in from which on an object is expected to move [s]. Before that, the map
/// does not hold all of it.
const SETTLED: f64 = 0.3;
/// The object is still there if a point at its place is within this distance of an occupied voxel
/// [m]. If rays have passed through its place, what is there now is not the same object.
const HELD: f64 = 0.5;

/// An object that stands in free space since the burn-in.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(in crate::flying::track) struct UnmovedTarget {
    pub(in crate::flying::track) id: i64,
    position: Vector3<f64>,
    covariance: Matrix3<f64>,
    extent: [f64; 3],
    born_ns: i64,
    seen_ns: i64,
    /// Whether the newest scan has a point of the object at its place.
    is_there: bool,
    /// Time since when all scans have shown that nothing is there [ns]. None: it is there, or its
    /// place is hidden.
    empty_ns: Option<i64>,
}

impl UnmovedTarget {
    /// The object of detection `index` of a set, with the track ID `id`.
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

    /// Radius of the ball around its place that contains all of it [m].
    fn radius(&self) -> f64 {
        0.5 * Vector3::from(self.extent).norm() + MARGIN
    }

    /// The region in which it is expected if it begins to move.
    fn expected(&self) -> ExpectedTarget {
        ExpectedTarget {
            position: self.position.into(),
            velocity: [0.0; 3],
            half: self.extent.map(|side| 0.5 * side + STARTS),
            size: self.extent,
            has_stood: true,
        }
    }

    /// The object as a track at `stamp_ns`. It is reported if `is_recent` is true for the time when
    /// it was last seen [ns].
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

    /// Probabilities of its kinds. The longer it stands, the less probable is a target that hovers.
    fn kinds(&self, stamp_ns: i64) -> KindBelief {
        let hovers = libm::exp(-seconds(self.born_ns, stamp_ns).max(0.0) / HOVERS);
        let mut likelihood = [hovers; KINDS];
        likelihood[usize::from(u8::from(TrackKind::Static))] = 1.0;
        KindBelief::prior(SHARES).weighed(likelihood)
    }

    /// Whether `track` follows this object, which has left its place.
    fn is_now(&self, track: &PointTrack) -> bool {
        let away = (track.born_at - self.position).norm();
        !self.is_there && track.born_ns >= self.born_ns && away <= self.radius() + REACH
    }

    /// Give the ID of this object, which has left its place, to the track that follows it. Returns the ID that stays
    /// and the ID that ends.
    fn give_to(&self, track: &mut PointTrack) -> [i64; 2] {
        let ended = std::mem::replace(&mut track.id, self.id);
        track.born_ns = self.born_ns;
        // Where rays pass a thing that hangs, the map loses it, and it is detected where it has been all the time.
        track.stood = StoodPlaces::of_object(self.position.into(), track.stood.is_beside());
        if !self.is_away(track) && !track.has_speed() {
            track.belief.stood_so_far();
        }
        [self.id, ended]
    }

    /// Whether all scans have shown for `GONE` that nothing is at its place any more.
    fn is_gone(&self, stamp_ns: i64) -> bool {
        self.empty_ns.is_some_and(|since| seconds(since, stamp_ns) >= GONE)
    }

    /// Whether `track` is certainly away from the object's place.
    fn is_away(&self, track: &PointTrack) -> bool {
        let covariance = self.covariance + position_block(&track.estimate.covariance);
        let std = (covariance.trace() / 3.0).max(0.0).sqrt();
        (track.position() - self.position).norm() >= LEFT + 2.0 * std
    }
}

/// The objects that may begin to move at `stamp_ns`. Each is expected near its own place, which is
/// occupied in the map.
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

/// Search for the objects in a scan.
pub(in crate::flying::track) fn look(standing: &mut [UnmovedTarget], scan: &CloudScan<'_>) {
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
}

/// Remove the objects that are gone at `stamp_ns`, and give their IDs to the confirmed tracks that follow them. An
/// object waits for a track that may follow it and is not confirmed yet. Returns the IDs of objects that no track
/// follows, and pairs of the ID that stays and the ID that ends.
pub(in crate::flying::track) fn remove_gone(
    standing: &mut Vec<UnmovedTarget>,
    tracks: &mut [PointTrack],
    stamp_ns: i64,
) -> (Vec<i64>, Vec<[i64; 2]>) {
    let (mut removed, mut merged) = (Vec::new(), Vec::new());
    standing.retain(|target| {
        if !target.is_gone(stamp_ns) {
            return true;
        }
        let follower = tracks.iter_mut().filter(|track| target.is_now(track));
        match follower.max_by_key(|track| track.confirmed) {
            Some(track) if track.confirmed => merged.push(target.give_to(track)),
            Some(_) => return true,
            None => removed.push(target.id),
        }
        false
    });
    (removed, merged)
}

/// Confirm the tracks that follow an object which has certainly left its place, if their
/// probability of existence reaches `report`: the object was known before. Adds the IDs of these
/// tracks to `confirmed`.
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

/// Give the ID of an object that has left its place to the confirmed track that follows it. Returns
/// pairs of the ID that stays and the ID that ends.
pub(in crate::flying::track) fn hand_over(
    standing: &mut Vec<UnmovedTarget>,
    tracks: &mut [PointTrack],
    confirmed: &mut [i64],
) -> Vec<[i64; 2]> {
    let mut merged = Vec::new();
    for number in confirmed.iter_mut() {
        let Some(track) = tracks.iter_mut().find(|track| track.id == *number) else { continue };
        let Some(place) = standing.iter().position(|target| target.is_now(track)) else { continue };
        merged.push(standing.remove(place).give_to(track));
        *number = track.id;
    }
    merged
}
