//! Life of a track from its start to its removal: IDs, confirmation, merging, removal.

use super::association::pairs::AlongX;
use super::belief::existence::{DELETED, ExpectedClutter, FalseBirths, KEPT};
use super::belief::stood::EarlierReturns;
use super::belief::visits::Visits;
use super::belief::weighing::{born, weigh};
use super::measurement::Evidence;
use super::motion::{self, seconds};
use super::parameters::{Ageing, Confirmation, Merging, TrackerParameters};
use super::state::{PointTrack, UNNUMBERED};
use super::visibility::occupancy::Occupancy;
use crate::flying::large_targets::{LARGE, PART_GAP};
use crate::tracking::kind::TrackKind;
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// Radius of the ball around a place in which occupied voxels count as beside it [m]. The centre of
/// the ball is raised by `RAISED` [m], so that ground more than the difference of the two below the
/// place does not count.
const BESIDE: f64 = 2.0;
/// Height by which the ball around a place is raised [m]: see [`BESIDE`].
const RAISED: f64 = 1.0;

/// Remove tracks that have become too uncertain, or that were not measured for too long. Returns
/// their IDs.
///
/// # Source
/// Vrba et al., Algorithm 2, lines 15-17.
pub(super) fn remove_uncertain(
    tracks: &mut Vec<PointTrack>,
    births: &mut FalseBirths,
    parameters: &TrackerParameters,
    now_ns: i64,
) -> Vec<i64> {
    let lost = |track: &PointTrack| {
        let is_uncertain = motion::radius(&track.aged, &parameters.radius) > parameters.radius.max;
        is_uncertain
            || match parameters.ageing {
                Ageing::Paper => false,
                Ageing::Visible { max_coast, .. } => seconds(track.seen_ns, now_ns) > max_coast,
            }
    };
    tracks.iter().filter(|track| lost(track)).for_each(|track| track.count_end(births));
    remove(tracks, lost)
}

/// A set of detections, and the tracks to which it was assigned.
pub(super) struct SetOfDetections<'a> {
    pub(super) stamp_ns: i64,
    /// The tracks that got a detection, as indices into the list of tracks, and the evidence of
    /// each detection.
    pub(super) fed: &'a [(usize, Evidence)],
    /// Index of the first track that this set began; all before it were known.
    pub(super) known: usize,
    /// Expected clutter around the set.
    pub(super) around: ExpectedClutter,
    /// Earlier detections that no flying target explains, and their places.
    pub(super) visits: &'a Visits,
    /// Returns of the last seconds that belong to no known object.
    pub(super) earlier: &'a EarlierReturns,
    pub(super) occupied: &'a dyn Occupancy,
}

/// True if the map has structure beside a place [m] or above it.
fn is_beside(occupied: &dyn Occupancy, place: [f64; 3]) -> bool {
    occupied.any_within([place[0], place[1], place[2] + RAISED], BESIDE)
}

/// Enter a set of detections into all tracks. Returns the IDs of the tracks that it has confirmed.
pub(super) fn confirm(
    tracks: &mut [PointTrack],
    set: &SetOfDetections<'_>,
    parameters: &TrackerParameters,
) -> Vec<i64> {
    // Longer than other functions: both ways to confirm change the same fields of a track.
    let mut evidence = vec![None; tracks.len()];
    for &(index, of_track) in set.fed {
        evidence[index] = Some(of_track);
    }
    let mut confirmed = Vec::new();
    for (index, (track, evidence)) in tracks.iter_mut().zip(evidence).enumerate() {
        let is_sure = match parameters.confirmation {
            Confirmation::Counts { hits, window } => {
                if index < set.known {
                    track.history = track.history << 1 | u64::from(evidence.is_some());
                }
                last(track.history, window).count_ones() >= hits || track.confirmed
            }
            Confirmation::Existence { report } => {
                if index < set.known {
                    let std = parameters.initial_std[2];
                    weigh(track, evidence, set.around, std, set.stamp_ns);
                } else {
                    track.belief = born(set.around, track, set.stamp_ns);
                }
                if !track.stood.is_known() {
                    let born = index >= set.known;
                    let (at, when) = if born {
                        (track.born_at, track.born_ns)
                    } else {
                        (track.position(), set.stamp_ns)
                    };
                    track.stood = set.earlier.around(at.into(), when);
                }
                if evidence.is_some() || index >= set.known {
                    let place = track.position().into();
                    let share = set.visits.share(place, track.id, track.born_ns);
                    let is_beside = track.stood.is_beside() || is_beside(set.occupied, place);
                    let hangs = !track.is_away() && is_beside;
                    track.belief.visit(share, hangs);
                    // What surely has a speed comes past. What left its start empty, or moved
                    // before its track began, had itself given the returns that were there
                    // before, unless something else stood beside it.
                    let has_left = track.belief.has_moved() && !track.stood.is_beside();
                    let flies_by = track.has_speed() || has_left;
                    track.belief.stand(if flies_by { 0.0 } else { track.stood.at(place) });
                }
                let limit = if track.confirmed { KEPT * report } else { report };
                track.existence() >= limit
            }
        };
        if is_sure && !track.confirmed {
            confirmed.push(track.id);
        }
        track.confirmed = is_sure;
        track.was_confirmed |= is_sure;
    }
    confirmed
}

/// Remove unconfirmed tracks that no recent set of detections contained, or, with confirmation by
/// existence, all tracks whose target is improbable. Returns their IDs.
pub(super) fn remove_unconfirmed(
    tracks: &mut Vec<PointTrack>,
    births: &mut FalseBirths,
    parameters: &TrackerParameters,
) -> Vec<i64> {
    match parameters.confirmation {
        Confirmation::Counts { window, .. } => {
            remove(tracks, |track| !track.confirmed && last(track.history, window) == 0)
        }
        Confirmation::Existence { .. } => {
            let is_gone = |track: &PointTrack| track.existence() < DELETED;
            tracks.iter().filter(|track| is_gone(track)).for_each(|track| track.count_end(births));
            remove(tracks, is_gone)
        }
    }
}

/// Give IDs to the tracks that have none. Returns the new IDs.
pub(super) fn number(tracks: &mut [PointTrack], next_id: &mut i64) -> Vec<i64> {
    let mut born = Vec::new();
    for track in tracks.iter_mut().filter(|track| track.id == UNNUMBERED) {
        track.id = *next_id;
        *next_id += 1;
        if track.before.is_some() {
            track.made_of.extend(born.last()); // it follows that of its second detection
        }
        born.push(track.id);
    }
    born
}

/// Remove the tracks of single detections from which a confirmed track of a fast target was made:
/// the fast target explains both detections. A track of `born` takes the ID of the oldest of them
/// that was reported. Returns pairs of the ID that stays and the ID that ends.
pub(super) fn explain(
    tracks: &mut Vec<PointTrack>,
    born: &[i64],
    confirmed: &mut Vec<i64>,
) -> Vec<[i64; 2]> {
    let is_fast = |track: &&mut PointTrack| track.confirmed && !track.made_of.is_empty();
    let fast: Vec<(i64, Vec<i64>)> = tracks
        .iter_mut()
        .filter(is_fast)
        .map(|track| (track.id, std::mem::take(&mut track.made_of)))
        .collect();
    let mut merged = Vec::new();
    for (id, made_of) in fast {
        let is_part = |track: &PointTrack| made_of.contains(&track.id) && track.n_detections == 1;
        let reported = tracks.iter().filter(|track| is_part(track) && track.was_confirmed);
        let eldest = reported.map(|track| track.id).min().filter(|_| born.contains(&id));
        let parts: Vec<i64> =
            tracks.iter().filter(|track| is_part(track)).map(|track| track.id).collect();
        tracks.retain(|track| !is_part(track));
        let number = eldest.unwrap_or(id);
        tracks.iter_mut().filter(|track| track.id == id).for_each(|track| track.id = number);
        let gone: Vec<i64> = parts.into_iter().chain([id]).filter(|&id| id != number).collect();
        confirmed.retain(|id| !gone.contains(id));
        merged.extend(gone.into_iter().map(|gone| [number, gone]));
    }
    merged
}

/// Store the places of detections that fed or started the tracks `shown`, unless their target flies
/// or moves on the ground. Stored places of a target that turns out to fly are removed. A target on
/// the ground passes once: its detections do not appear and disappear at one place.
pub(super) fn remember(
    visits: &mut Visits,
    tracks: &[PointTrack],
    shown: &BTreeSet<i64>,
    stamp_ns: i64,
) {
    for &id in shown {
        let Some(track) = tracks.iter().find(|track| track.id == id) else { continue };
        match track.belief.kinds().kind() {
            TrackKind::Flying if track.confirmed => visits.forget(id),
            TrackKind::Ground => {}
            _ => visits.add(stamp_ns, id, track.position().into()),
        }
    }
}

/// Merge tracks that follow the same target. Returns pairs of the ID that stays and the ID that
/// ends.
///
/// The older track keeps its ID, but a confirmed track has priority over an unconfirmed one. The
/// state is that of the track that was measured last; where one track follows a part of a large
/// target, it is that of the large one.
pub(super) fn merge(tracks: &mut Vec<PointTrack>, merging: &Merging) -> Vec<[i64; 2]> {
    let mut merged = Vec::new();
    let mut index = if has_twins(tracks, merging) { 0 } else { tracks.len() };
    while index < tracks.len() {
        let twin = (index + 1..tracks.len())
            .find(|&other| is_twin(&tracks[index], &tracks[other], merging));
        let Some(twin) = twin else {
            index += 1;
            continue;
        };
        let younger = tracks.remove(twin);
        let elder = &mut tracks[index];
        let (kept, dropped) = if younger.confirmed && !elder.confirmed {
            (younger, elder.clone())
        } else {
            (elder.clone(), younger)
        };
        merged.push([kept.id, dropped.id]);
        *elder = united(kept, dropped);
    }
    tracks.sort_by_key(|track| track.id);
    merged
}

/// True if any two tracks follow the same target.
fn has_twins(tracks: &[PointTrack], merging: &Merging) -> bool {
    let sorted = AlongX::of(tracks.iter().map(PointTrack::position));
    let largest = tracks.iter().map(PointTrack::longest_side).fold(0.0, f64::max);
    let reach = if largest < LARGE { 0.0 } else { PART_GAP + largest };
    tracks.iter().enumerate().any(|(one, track)| {
        let x = track.position().x;
        let mut near = sorted.near(x, x, reach.max(merging.distance));
        near.any(|other| one < other && is_twin(track, &tracks[other], merging))
    })
}

fn united(kept: PointTrack, dropped: PointTrack) -> PointTrack {
    let n_detections = kept.n_detections.max(dropped.n_detections);
    let history = kept.history | dropped.history;
    let (id, born_ns, confirmed) = (kept.id, kept.born_ns, kept.confirmed);
    let belief = kept.belief.more_probable(dropped.belief);
    let was_confirmed = kept.was_confirmed || dropped.was_confirmed;
    let is_part = kept.longest_side() < LARGE && dropped.longest_side() >= LARGE;
    let state = if dropped.seen_ns > kept.seen_ns || is_part { dropped } else { kept };
    let kept = PointTrack { id, born_ns, confirmed, was_confirmed, ..state };
    PointTrack { n_detections, history, belief, ..kept }
}

fn is_twin(one: &PointTrack, other: &PointTrack, merging: &Merging) -> bool {
    one.stamp_ns == other.stamp_ns
        && ((one.position() - other.position()).norm() <= merging.distance
            || is_part(one, other)
            || is_part(other, one))
        && (one.velocity() - other.velocity()).norm() <= merging.speed
}

/// Whether the target of `other` may be a part of the large target of `one`.
pub(super) fn is_part(one: &PointTrack, other: &PointTrack) -> bool {
    let offset = other.position() - one.position();
    let gap =
        |axis: usize| (offset[axis].abs() - 0.5 * (one.size[axis] + other.size[axis])).max(0.0);
    one.longest_side() >= LARGE
        && one.longest_side() >= other.longest_side()
        && Vector3::from_fn(|axis, _| gap(axis)).norm() <= PART_GAP
}

/// The newest `window` bits of `sets`, a history of sets of detections.
fn last(sets: u64, window: u32) -> u64 {
    sets & (u64::MAX >> (u64::BITS - window))
}

fn remove(tracks: &mut Vec<PointTrack>, gone: impl Fn(&PointTrack) -> bool) -> Vec<i64> {
    let removed = tracks.iter().filter(|track| gone(track)).map(|track| track.id).collect();
    tracks.retain(|track| !gone(track));
    removed
}
