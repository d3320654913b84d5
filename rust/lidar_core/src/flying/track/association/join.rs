//! Association of detections with tracks: which detections update which tracks, and which begin new
//! tracks.

use super::super::lifecycle::is_part;
use super::super::measurement::{Evidence, Measurement};
use super::super::motion::position_matrix;
use super::super::parameters::{Association, Confirmation};
use super::super::state::PointTrack;
use super::super::update::Updater;
use super::pending::{MeasuredPlace, PendingTrack};
use crate::Error;

/// Standard deviation of the place of a lost target that may have turned, around the place where it
/// was last seen: this share of the distance that it may have flown since then.
const LOITER_SHARE: f64 = 0.5;

/// Result of the association of one set of detections with the tracks.
#[derive(Debug, Default)]
pub(in crate::flying::track) struct Matches {
    /// The tracks that got a detection, as indices into the list of tracks, in the order of the
    /// detections, each with the evidence of its detection.
    pub(in crate::flying::track) fed: Vec<(usize, Evidence)>,
    /// Number of detections that were not used because a covariance was not positive definite.
    pub(in crate::flying::track) rejected: usize,
}

impl Updater {
    /// Assign every hypothesis (a detection brought to the present) to a track, or make it a new
    /// track. `scanned_ns`: time of the newest scan [ns].
    pub(in crate::flying::track) fn join(
        &self,
        tracks: &mut Vec<PointTrack>,
        hypotheses: Vec<PointTrack>,
        scanned_ns: Option<i64>,
    ) -> Result<Matches, Error> {
        match self.parameters.association {
            Association::Paper => Ok(self.join_nearest(tracks, hypotheses)),
            Association::Global { .. } => self.join_one_to_one(tracks, hypotheses, scanned_ns),
        }
    }

    /// Associate as Algorithm 2, lines 26-30 (Vrba et al.): every hypothesis goes to the nearest
    /// track whose uncertainty radius overlaps with its own, or becomes a new track.
    fn join_nearest(&self, tracks: &mut Vec<PointTrack>, hypotheses: Vec<PointTrack>) -> Matches {
        let radius = &self.parameters.radius;
        let mut matches = Matches::default();
        for hypothesis in hypotheses {
            let distance = |track: &PointTrack| (track.position() - hypothesis.position()).norm();
            let reach = hypothesis.radius(radius);
            let nearest = (0..tracks.len())
                .filter(|&index| distance(&tracks[index]) <= tracks[index].radius(radius) + reach)
                .min_by(|&one, &other| distance(&tracks[one]).total_cmp(&distance(&tracks[other])));
            match nearest {
                Some(index) => {
                    tracks[index].n_detections = tracks[index].n_detections.saturating_add(1);
                    matches.fed.push((index, hypothesis.first));
                }
                None => tracks.push(hypothesis),
            }
        }
        matches
    }

    fn join_one_to_one(
        &self,
        tracks: &mut Vec<PointTrack>,
        hypotheses: Vec<PointTrack>,
        scanned_ns: Option<i64>,
    ) -> Result<Matches, Error> {
        let model = &self.parameters.motion;
        // All hypotheses have one time; tracks behind it are brought there.
        let Some(now_ns) = hypotheses.first().map(|hypothesis| hypothesis.stamp_ns) else {
            return Ok(Matches::default());
        };
        let waiting: Vec<PendingTrack> =
            tracks.iter().map(|track| self.waiting(track, now_ns, scanned_ns)).collect();
        // Where a hypothesis is moved to the time of a track, it may go anywhere.
        let is_ahead = waiting.iter().any(|one| one.track.stamp_ns > now_ns);
        let furthest = waiting.iter().map(PendingTrack::furthest).fold(0.0, f64::max);
        let reach = if is_ahead { f64::INFINITY } else { furthest };
        let velocity_std = self.parameters.initial_std[1];
        let places: Vec<MeasuredPlace> =
            hypotheses.iter().map(|one| MeasuredPlace::of(one, velocity_std)).collect();
        let latest = places.iter().map(|place| place.delay.abs()).fold(0.0, f64::max);
        let fastest = waiting.iter().map(|one| one.track.velocity().norm()).fold(0.0, f64::max);
        let reach = reach + latest * fastest;
        let rows = places.iter().map(|place| place.position);
        let columns = waiting.iter().map(|one| one.track.position());
        let track_of = self.assign(rows, columns, reach, |row, column| {
            let (hypothesis, waiting) = (&hypotheses[row], &waiting[column]);
            let is_behind = waiting.track.stamp_ns > now_ns;
            let reached = is_behind.then(|| hypothesis.at(waiting.track.stamp_ns, model));
            match reached {
                Some(estimate) => waiting.offset(&MeasuredPlace::at_stamp(&estimate)),
                None => waiting.offset(&places[row]),
            }
        })?;
        Ok(self.feed(tracks, &waiting, hypotheses, &track_of))
    }

    /// The track, predicted to `now_ns` [ns] for the association with detections. A confirmed track
    /// that was not found in the newest scan is lost: its search region is wider.
    fn waiting(&self, track: &PointTrack, now_ns: i64, scanned_ns: Option<i64>) -> PendingTrack {
        let is_lost = scanned_ns.is_some_and(|scanned_ns| track.seen_ns < scanned_ns);
        let mut waiting = track.clone();
        waiting.predict(track.stamp_ns.max(now_ns), &self.parameters.motion);
        match self.parameters.rejoin_acceleration {
            Some(acceleration) if track.was_confirmed && is_lost => {
                let std = self.parameters.initial_std[0];
                waiting.widen(acceleration, std);
                let strayed = std + LOITER_SHARE * waiting.distance_flown();
                let reach = self.parameters.radius.max;
                PendingTrack { track: waiting, reach, strayed: Some(strayed) }
            }
            _ => PendingTrack { track: waiting, reach: self.search_radius(track), strayed: None },
        }
    }

    /// Correct every assigned track with its hypothesis. `track_of`: index of the track of each
    /// hypothesis; hypotheses with None become new tracks.
    fn feed(
        &self,
        tracks: &mut Vec<PointTrack>,
        waiting: &[PendingTrack],
        hypotheses: Vec<PointTrack>,
        track_of: &[Option<usize>],
    ) -> Matches {
        let known = tracks.len();
        let mut matches = Matches::default();
        for (hypothesis, track) in hypotheses.into_iter().zip(track_of) {
            let Some(index) = *track else {
                if !self.is_seen_twice(&hypothesis, &tracks[..known]) {
                    let fast = self.fast_pair(&hypothesis, &tracks[..known]);
                    tracks.push(hypothesis);
                    tracks.extend(fast);
                }
                continue;
            };
            matches.fed.push((index, hypothesis.first));
            // What the track has not seen itself, it learns from the hypothesis.
            if tracks[index].seen_ns < hypothesis.born_ns {
                let turned = waiting[index].turned_to(&hypothesis, &self.parameters.motion);
                let is_turned = turned.is_some();
                tracks[index] = turned.unwrap_or_else(|| waiting[index].track.clone());
                let is_known = is_turned || self.learn(&mut tracks[index], hypothesis);
                matches.rejected += usize::from(!is_known);
            }
            let track = &mut tracks[index];
            track.n_detections = track.n_detections.saturating_add(1);
        }
        matches
    }

    /// True if the hypothesis shows the target of a known track a second time: the rays of one scan
    /// may meet a target, or a part of it, at the start of the scan and again at its end. Such a
    /// hypothesis is no further from the track than two points of one cluster may be, or it is
    /// beside the box of a large target and is a part of it.
    fn is_seen_twice(&self, hypothesis: &PointTrack, tracks: &[PointTrack]) -> bool {
        let model = &self.parameters.motion;
        let is_fresh = hypothesis.stamp_ns == hypothesis.born_ns;
        let delay = if is_fresh { hypothesis.delay } else { 0.0 };
        tracks.iter().any(|track| {
            let expected = position_matrix(delay) * track.at(hypothesis.stamp_ns, model).mean;
            let away = (hypothesis.position() - expected).norm();
            away <= self.parameters.clustering.max_distance
                || (self.parameters.merging.is_some()
                    && track.confirmed
                    && track.stamp_ns == hypothesis.stamp_ns
                    && is_part(track, hypothesis))
        })
    }

    /// A new track of this detection and an earlier single one that lies outside the gate of a new
    /// track: a target so fast that it was seen once in each of two places. None if there is no
    /// such earlier detection, or if tracks are confirmed by counts.
    fn fast_pair(&self, hypothesis: &PointTrack, tracks: &[PointTrack]) -> Option<PointTrack> {
        let Confirmation::Existence { .. } = self.parameters.confirmation else { return None };
        let pairs = tracks.iter().filter_map(|track| Some((hypothesis.way_from(track)?, track)));
        let nearest = pairs.min_by(|(one, _), (other, _)| one.length().total_cmp(&other.length()));
        nearest.map(|(way, track)| hypothesis.paired(track, &way, self.parameters.initial_std[2]))
    }

    fn learn(&self, track: &mut PointTrack, mut hypothesis: PointTrack) -> bool {
        let model = &self.parameters.motion;
        let stamp_ns = hypothesis.stamp_ns.max(track.stamp_ns);
        track.predict(stamp_ns, model);
        let is_now = hypothesis.stamp_ns == stamp_ns;
        hypothesis.predict(stamp_ns, model);
        let place = if is_now {
            MeasuredPlace::of(&hypothesis, self.parameters.initial_std[1])
        } else {
            MeasuredPlace::at_stamp(&hypothesis.estimate)
        };
        let measurement = Measurement {
            position: place.position,
            covariance: place.covariance,
            delay: place.delay,
            extent: hypothesis.extent,
            n_points: 0,
            is_cut: false,
            row: None,
        };
        track.correct(&measurement).is_ok()
    }
}
