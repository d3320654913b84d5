//! Birth to removal: numbers, confirmation, merging, deletion.

use super::measurement::Evidence;
use super::motion::{self, position_block};
use super::pairs::AlongX;
use super::parameters::{Ageing, Confirmation, Merging, TrackerParameters};
use super::state::{PointTrack, UNNUMBERED, seconds};
use nalgebra::Vector3;

/// Detections that seem to fly which one that seems joined to a surface outweighs.
const JOINED_WEIGHT: u32 = 4;

/// Remove tracks that have become too uncertain; their numbers.
///
/// # Source
/// Vrba et al., Algorithm 2, lines 15-17.
pub(super) fn remove_uncertain(
    tracks: &mut Vec<PointTrack>,
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
    remove(tracks, lost)
}

/// Enter a set of detections into the history of all tracks: `fed` names those it held, `born`
/// is the place of the first new one. Returns the numbers of those that are confirmed by it.
pub(super) fn confirm(
    tracks: &mut [PointTrack],
    fed: &[(usize, Evidence)],
    born: usize,
    parameters: &TrackerParameters,
) -> Vec<i64> {
    let mut confirmed = Vec::new();
    for track in &mut tracks[..born] {
        track.history <<= 1;
        track.hints = track.hints << 1 | u64::from(std::mem::take(&mut track.hinted));
        track.sure <<= 1;
        track.joined <<= 1;
    }
    for &(index, evidence) in fed {
        let track = &mut tracks[index];
        track.history |= 1;
        track.sure |= u64::from(evidence.is_sure);
        track.joined |= u64::from(evidence.is_joined);
    }
    for track in tracks.iter_mut().filter(|track| !track.confirmed) {
        if is_certain(track, &parameters.confirmation) {
            track.confirmed = true;
            confirmed.push(track.id);
        }
    }
    confirmed
}

/// True if enough sets of detections support a track.
fn is_certain(track: &PointTrack, confirmation: &Confirmation) -> bool {
    let enough = |sets: u64, hits: u32, window: u32| last(sets, window).count_ones() >= hits;
    let Confirmation { hits, window, weak_evidence } = *confirmation;
    let Some(weak_evidence) = weak_evidence else { return enough(track.history, hits, window) };
    if track.stray_points > track.own_points {
        return false; // it is one of many returns that come and go
    }
    if may_be_joined(track) {
        return false; // it is probably a part of a surface
    }
    let spread = position_block(&track.estimate.covariance).trace() / 3.0;
    let reach = weak_evidence.distance + 2.0 * spread.max(0.0).sqrt();
    let is_far_from = |place: Vector3<f64>| (track.position() - place).norm() > reach;
    let counted = match track.left && is_far_from(track.born_at) {
        true if is_far_from(track.found_at) => track.history | track.hints,
        true => track.history,
        false => track.sure,
    };
    enough(counted, hits, window) || enough(track.history, weak_evidence.hits, weak_evidence.window)
}

/// True if a track is more likely a part of a surface than a target: one in thirty detections of
/// targets seems joined to a surface, half of those of parts do. So one of them outweighs four others.
fn may_be_joined(track: &PointTrack) -> bool {
    let joined = track.joined.count_ones();
    JOINED_WEIGHT * joined > (track.history & !track.joined).count_ones()
}

/// Remove tracks that were never confirmed and that no recent detection held; their numbers.
pub(super) fn remove_unconfirmed(
    tracks: &mut Vec<PointTrack>,
    parameters: &TrackerParameters,
) -> Vec<i64> {
    remove(tracks, |track| !track.confirmed && recent(track, parameters) == 0)
}

/// Number the tracks that have none; the numbers.
pub(super) fn number(tracks: &mut [PointTrack], next_id: &mut i64) -> Vec<i64> {
    let mut born = Vec::new();
    for track in tracks.iter_mut().filter(|track| track.id == UNNUMBERED) {
        track.id = *next_id;
        *next_id += 1;
        born.push(track.id);
    }
    born
}

/// Merge tracks of one target; pairs of the number that stays and the one that goes.
///
/// The elder keeps its number, a confirmed track before any other; the state is that of the one
/// seen last.
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
    tracks.iter().enumerate().any(|(one, track)| {
        let x = track.position().x;
        let mut near = sorted.near(x, x, merging.distance);
        near.any(|other| one < other && is_twin(track, &tracks[other], merging))
    })
}

fn united(kept: PointTrack, dropped: PointTrack) -> PointTrack {
    let n_detections = kept.n_detections.max(dropped.n_detections);
    let history = kept.history | dropped.history;
    let (sure, hints) = (kept.sure | dropped.sure, kept.hints | dropped.hints);
    let joined = kept.joined | dropped.joined;
    let (id, born_ns, confirmed) = (kept.id, kept.born_ns, kept.confirmed);
    let state = if dropped.seen_ns > kept.seen_ns { dropped } else { kept };
    PointTrack { id, born_ns, confirmed, n_detections, history, sure, hints, joined, ..state }
}

fn is_twin(one: &PointTrack, other: &PointTrack, merging: &Merging) -> bool {
    one.stamp_ns == other.stamp_ns
        && (one.position() - other.position()).norm() <= merging.distance
        && (one.velocity() - other.velocity()).norm() <= merging.speed
}

fn recent(track: &PointTrack, parameters: &TrackerParameters) -> u64 {
    last(track.history | track.hints, parameters.confirmation.window)
}

/// The newest `window` of the sets of detections.
fn last(sets: u64, window: u32) -> u64 {
    sets & (u64::MAX >> (u64::BITS - window))
}

fn remove(tracks: &mut Vec<PointTrack>, gone: impl Fn(&PointTrack) -> bool) -> Vec<i64> {
    let removed = tracks.iter().filter(|track| gone(track)).map(|track| track.id).collect();
    tracks.retain(|track| !gone(track));
    removed
}
