//! Tracker of several targets in point clouds: Kalman tracks, scan buffer, life cycle. Longer than other files: it
//! contains all functions that use the private state of the tracker.
//!
//! Source: Vrba, Walter & Saska, "On Onboard LiDAR-based Flying Object Detection", sec. III-F and Algorithm 2.
//! Extensions: see [`TrackerParameters`].

mod association;
mod belief;
mod buffer;
mod candidates;
mod cluster_assignment;
mod detections;
mod full_state;
mod lifecycle;
mod manoeuvre;
mod measurement;
mod motion;
mod output;
mod parameters;
mod split;
mod state;
mod update;
mod visibility;

#[cfg(test)]
mod tests;

pub use belief::kinds::TargetShape;
pub use detections::Detections;
pub(crate) use full_state::{SavedTracker, TrackerState};
pub(crate) use output::{ExpectedTarget, FoundTarget};
pub use output::{Stats, Track};
pub use parameters::{
    Ageing, Association, Confirmation, Hiding, MAX_TRACKS, MAX_WINDOW, MeasurementForm, Merging,
    Motion, NoiseForm, Radius, RadiusForm, TrackerParameters,
};
pub use visibility::occupancy::{ENOUGH_RAYS, Occupancy, OccupiedPoints, Visibility};
pub use visibility::view::CloudView;

use crate::Error;
use crate::geometry::lattice::wide;
use crate::tracking::kind::{KINDS, KindBelief, TrackKind};
use crate::util::budget::{check_memory, check_points};
use belief::existence::{FalseBirths, Sight};
use belief::standing::{self, UnmovedTarget};
use belief::stood::EarlierReturns;
use belief::visits::{Visits, renamed};
use buffer::Buffer;
use lifecycle::SetOfDetections;
use measurement::CloudScan;
use motion::seconds;
use nalgebra::Vector3;
use state::PointTrack;
use update::Updater;

/// Longest time without a measurement for which the detector still expects a target [s].
const EXPECTED: f64 = 0.5;
/// The target is expected within this number of standard deviations of its predicted position, but at most `FARTHEST`
/// metres from its box.
const EXPECTED_STDS: f64 = 2.5;
const FARTHEST: f64 = 0.5;
/// Returns within this distance of the box of a track may belong to it [m].
const OF_TRACK: f64 = 0.5;
/// Memory that a point of a cloud may need in addition to its copy [bytes].
const ROOM_OF_POINT: usize = 64;

/// Tracker of several targets in point clouds. Detections may arrive late.
///
/// All positions are in one local world frame, near enough to its origin for `f32` points.
pub struct PointCloudTracker {
    updater: Updater,
    buffer: Buffer,
    keeps_points: bool,
    tracks: Vec<PointTrack>,
    /// Objects that stood in free space at the end of the burn-in.
    standing: Vec<UnmovedTarget>,
    next_id: i64,
    births: FalseBirths,
    visits: Visits,
    earlier: EarlierReturns,
}

impl PointCloudTracker {
    /// A tracker without tracks that computes on `threads` threads.
    ///
    /// # Errors
    /// [`Error::Parameter`] for values that cannot work.
    pub fn new(parameters: TrackerParameters, threads: usize) -> Result<Self, Error> {
        Ok(Self {
            updater: Updater::new(parameters, threads)?,
            buffer: Buffer::new(parameters.buffer_size),
            keeps_points: true,
            tracks: Vec::new(),
            standing: Vec::new(),
            next_id: 0,
            births: FalseBirths::default(),
            visits: Visits::default(),
            earlier: EarlierReturns::default(),
        })
    }

    /// Predict every track to `stamp_ns` and correct it with its cluster among `points` [m].
    ///
    /// Points that are not finite are ignored. Tracks that a detection has made newer than the cloud wait for the
    /// next cloud. `delays`: time of every point after the stamp [s], for scans that take time.
    ///
    /// # Errors
    /// [`Error::Time`] for a stamp that was processed, or older than a full buffer;
    /// [`Error::Limit`] for too many points. The tracker is unchanged then.
    ///
    /// # Source
    /// Vrba et al., Algorithm 2, lines 8-18.
    pub fn new_point_cloud(
        &mut self,
        points: &[[f32; 3]],
        delays: Option<&[f32]>,
        occupied: &dyn Occupancy,
        visibility: Option<&dyn Visibility>,
        stamp_ns: i64,
    ) -> Result<Stats, Error> {
        check_points(points.len())?;
        check_memory("a point cloud", points.len(), ROOM_OF_POINT)?;
        let mut stats = Stats { late: self.buffer.is_late(stamp_ns)?, ..Stats::default() };
        let cloud = self.buffer.copy(points, delays, stamp_ns, self.keeps_points)?;
        if !stats.late {
            let mut tracks = self.tracks.clone(); // an error must not leave half of them updated
            let scan = CloudScan { points, delays, stamp_ns, occupied, visibility };
            let outcome = self.updater.update(&mut tracks, &scan)?;
            (stats.corrected, stats.rows) = (outcome.corrected, outcome.rows);
            stats.rejected = outcome.rejected;
            let (mut births, parameters) = (self.births, self.parameters());
            stats.removed =
                lifecycle::remove_uncertain(&mut tracks, &mut births, parameters, stamp_ns);
            stats.merged = self.merge(&mut tracks);
            standing::look(&mut self.standing, &scan);
            let (gone, followed) = standing::remove_gone(&mut self.standing, &mut tracks, stamp_ns);
            tracks.sort_by_key(|track| track.id);
            stats.removed.extend(gone);
            stats.merged.extend(followed);
            self.visits.rename(&stats.merged);
            (self.tracks, self.births) = (tracks, births);
        }
        self.buffer.push(cloud);
        Ok(stats)
    }

    /// Process a set of detections. It may be empty, and may be older than the clouds.
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Value`] for an entry that cannot be used, [`Error::Limit`] above
    /// [`MAX_TRACKS`]. The tracker is unchanged then.
    ///
    /// # Source
    /// Vrba et al., Algorithm 2, lines 19-32.
    pub fn new_detections(
        &mut self,
        detections: &Detections<'_>,
        occupied: &dyn Occupancy,
    ) -> Result<Stats, Error> {
        // Longer than other functions: the stages of a set of detections on copies, so that an
        // error changes nothing.
        let fresh = detections.hypotheses(self.parameters())?;
        let stamp_ns = detections.stamp_ns;
        let hypotheses = self.updater.replay(fresh, stamp_ns, &self.buffer, occupied)?;
        let (mut tracks, mut next_id) = (self.tracks.clone(), self.next_id);
        let known = tracks.len();
        let matches = self.updater.join(&mut tracks, hypotheses, self.buffer.newest_ns())?;
        if tracks.len() > MAX_TRACKS {
            return Err(detections::too_many(tracks.len()));
        }
        let mut births = self.births;
        births.count_set();
        let around = births.expected(state::without_target(&tracks[..known]));
        let (visits, earlier) = (&self.visits, &self.earlier);
        let fed = &matches.fed;
        let set = SetOfDetections { stamp_ns, fed, known, around, visits, earlier, occupied };
        let born = lifecycle::number(&mut tracks, &mut next_id);
        let mut confirmed = lifecycle::confirm(&mut tracks, &set, self.parameters());
        let fed: Vec<i64> = matches.fed.iter().map(|&(index, _)| tracks[index].id).collect();
        if let Confirmation::Existence { report } = self.parameters().confirmation {
            standing::follow(&self.standing, &mut tracks, report, &mut confirmed);
        }
        let mut merged = lifecycle::explain(&mut tracks, &born, &mut confirmed);
        merged.extend(standing::hand_over(&mut self.standing, &mut tracks, &mut confirmed));
        tracks.sort_by_key(|track| track.id);
        let removed = lifecycle::remove_unconfirmed(&mut tracks, &mut births, self.parameters());
        merged.extend(self.merge(&mut tracks));
        self.visits.rename(&merged);
        if let Confirmation::Existence { .. } = self.parameters().confirmation {
            let shown = fed.into_iter().chain(born.iter().copied());
            let shown = shown.map(|id| renamed(id, &merged)).collect();
            lifecycle::remember(&mut self.visits, &tracks, &shown, stamp_ns);
        }
        let rejected = matches.rejected;
        let stats = Stats { born, confirmed, removed, merged, rejected, ..Stats::default() };
        (self.tracks, self.next_id, self.births) = (tracks, next_id, births);
        Ok(stats)
    }

    /// Every track, also unconfirmed ones, predicted to `stamp_ns`, in the order of their IDs. The tracker does not
    /// change.
    #[must_use]
    pub fn tracks_at(&self, stamp_ns: i64) -> Vec<Track> {
        let TrackerParameters { motion, measurement, .. } = self.parameters();
        let state = |track: &PointTrack| match measurement {
            MeasurementForm::Center => track.told_at(stamp_ns, motion),
            MeasurementForm::Paper | MeasurementForm::Cluster => track.at(stamp_ns, motion),
        };
        let moving = self
            .tracks
            .iter()
            .map(|track| Track {
                id: track.id,
                stamp_ns,
                state: state(track),
                extent: track.extent,
                n_detections: track.n_detections,
                age: seconds(track.born_ns, stamp_ns),
                seen_ns: track.seen_ns,
                confirmed: track.confirmed,
                reported: track.confirmed && self.is_recent(track.seen_ns),
                existence: self.existence(track, stamp_ns),
                kind: TrackKind::Flying,
                kind_probability: [f64::NAN; KINDS],
            })
            .zip(&self.tracks)
            .map(|(known, track)| match self.kinds(track) {
                Some(kinds) => {
                    let (kind, kind_probability) = (kinds.kind(), kinds.probabilities());
                    Track { kind, kind_probability, ..known }
                }
                None => known,
            });
        let is_recent = |seen_ns| self.is_recent(seen_ns);
        let standing = self.standing.iter().map(|target| target.track(stamp_ns, is_recent));
        let mut all: Vec<Track> = moving.chain(standing).collect();
        all.sort_by_key(|track| track.id);
        if matches!(self.parameters().confirmation, Confirmation::Existence { .. }) {
            output::leave_out_doubles(&mut all);
        }
        all
    }

    /// Store objects that stand in free space, to notice if they move: detections at the end of the burn-in, whose
    /// points are background from then on.
    pub(crate) fn watch(&mut self, found: &Detections<'_>) {
        for index in 0..found.positions.len() {
            self.standing.push(UnmovedTarget::new(self.next_id, found, index));
            self.next_id += 1;
        }
    }

    /// Store the positions [m] of returns that belong neither to the background nor to a flying object. Returns on a
    /// confirmed track of kind Flying belong to this track and are left out.
    pub(crate) fn remember(&mut self, stamp_ns: i64, places: impl Iterator<Item = [f32; 3]>) {
        if !matches!(self.parameters().confirmation, Confirmation::Existence { .. }) {
            return;
        }
        let flies = |track: &&PointTrack| {
            track.confirmed && track.belief.kinds().kind() == TrackKind::Flying
        };
        let of_track = |track: &PointTrack| {
            let half = 0.5 * Vector3::from(track.extent).norm();
            (track.position(), half + OF_TRACK)
        };
        let own: Vec<_> = self.tracks.iter().filter(flies).map(of_track).collect();
        let is_free = |place: &[f32; 3]| {
            let place = Vector3::from(wide(*place));
            own.iter().all(|(center, reach)| (place - center).norm() > *reach)
        };
        self.earlier.add(stamp_ns, places.filter(is_free));
    }

    /// Whether to keep the points of the next clouds. They are needed if detections arrive later than a newer cloud.
    pub(crate) fn keep_points(&mut self, keeps_points: bool) {
        self.keeps_points = keeps_points;
    }

    /// The first time at or after `stamp_ns` [ns] for which the buffer holds no cloud.
    pub(crate) fn free_stamp(&self, mut stamp_ns: i64) -> i64 {
        while self.buffer.has(stamp_ns) && stamp_ns < i64::MAX {
            stamp_ns += 1;
        }
        stamp_ns
    }

    /// Check that there is room for this number of new tracks.
    ///
    /// # Errors
    /// [`Error::Limit`] if the tracker could then have more than [`MAX_TRACKS`] tracks.
    pub(crate) fn check_room(&self, count: usize) -> Result<(), Error> {
        let count = self.tracks.len() + self.standing.len() + count;
        if count > MAX_TRACKS { Err(detections::too_many(count)) } else { Ok(()) }
    }

    /// Whether a track with the ID `id` exists and is confirmed.
    pub(crate) fn is_confirmed(&self, id: i64) -> bool {
        self.tracks.iter().any(|track| track.id == id && track.confirmed)
    }

    /// Kind of the target of track `id`. None if there is no such track, or if tracks are confirmed by counts.
    pub(crate) fn kind_of(&self, id: i64) -> Option<TrackKind> {
        let track = self.tracks.iter().find(|track| track.id == id)?;
        self.kinds(track).map(|kinds| kinds.kind())
    }

    /// Predicted positions at `stamp_ns` of targets that are expected: of confirmed tracks of kind Flying that were
    /// seen lately, and of objects that have stood since the burn-in and may move.
    pub(crate) fn expected_at(&self, stamp_ns: i64) -> Vec<ExpectedTarget> {
        let is_known = |track: &&PointTrack| {
            let kind = self.kinds(track).map(|kinds| kinds.kind());
            track.confirmed
                && kind == Some(TrackKind::Flying)
                && seconds(track.seen_ns, stamp_ns) <= EXPECTED
        };
        let model = &self.parameters().motion;
        let target = |track: &PointTrack| {
            let state = track.at(stamp_ns, model);
            let (mean, covariance) = (state.mean, state.covariance);
            let size = track.size;
            ExpectedTarget {
                position: [mean[0], mean[1], mean[2]],
                velocity: [mean[3], mean[4], mean[5]],
                half: [0, 1, 2].map(|axis| {
                    let std = covariance[(axis, axis)].max(0.0).sqrt();
                    0.5 * size[axis] + (EXPECTED_STDS * std).min(FARTHEST)
                }),
                size,
                has_stood: false,
            }
        };
        let standing = standing::expected_at(&self.standing, stamp_ns);
        self.tracks.iter().filter(is_known).map(target).chain(standing).collect()
    }

    /// Start confirmed tracks of targets that were found in several scans together, up to the largest number of tracks.
    pub(crate) fn adopt(&mut self, found: &[FoundTarget], stamp_ns: i64) {
        for target in found.iter().take(MAX_TRACKS.saturating_sub(self.tracks.len())) {
            let mut track = PointTrack::of_found(target, stamp_ns, &self.updater.parameters);
            track.id = self.next_id;
            self.next_id += 1;
            self.tracks.push(track);
        }
    }

    /// Positions of all confirmed tracks [m].
    pub(crate) fn confirmed_places(&self) -> Vec<[f64; 3]> {
        self.tracks
            .iter()
            .filter(|track| track.confirmed)
            .map(|track| track.position().into())
            .collect()
    }

    /// Note that the cluster of track `id` in the newest cloud is in free space but has too few points for a detection.
    /// It counts as evidence with the next set of detections.
    pub(crate) fn hint(&mut self, id: i64) {
        for track in self.tracks.iter_mut().filter(|track| track.id == id) {
            track.sight = Sight::Few;
        }
    }

    /// Check that a cloud with this stamp would be accepted.
    ///
    /// # Errors
    /// [`Error::Time`] as [`PointCloudTracker::new_point_cloud`].
    pub fn check_stamp(&self, stamp_ns: i64) -> Result<(), Error> {
        self.buffer.is_late(stamp_ns).map(drop)
    }

    /// Positions of tracks [m], also unconfirmed ones, that are more than `distance` [m] from their
    /// first detection, and of confirmed ones of kind Flying that certainly have a speed (on a
    /// small circle a target never gets far). Each with half the diagonal of its box [m].
    #[must_use]
    pub fn moved_by(&self, distance: f64) -> Vec<([f64; 3], f64)> {
        let flies = |track: &PointTrack| {
            let kind = self.kinds(track).map(|kinds| kinds.kind());
            track.confirmed && kind == Some(TrackKind::Flying) && track.has_speed()
        };
        let moved = |track: &&PointTrack| {
            (track.position() - track.born_at).norm() > distance || flies(track)
        };
        let half = |track: &PointTrack| 0.5 * Vector3::from(track.extent).norm();
        let all = self.tracks.iter().filter(moved);
        all.map(|track| (track.position().into(), half(track))).collect()
    }

    /// Remove the tracks within `distance` [m] of an occupied voxel.
    pub fn drop_near(&mut self, occupied: &dyn Occupancy, distance: f64) {
        self.tracks.retain(|track| !occupied.any_within(track.position().into(), distance));
    }

    /// Remove all tracks and clouds. The IDs of later tracks continue.
    pub fn reset(&mut self) {
        self.tracks.clear();
        self.standing.clear();
        self.buffer.clear();
        self.births = FalseBirths::default();
        self.visits.clear();
        self.earlier.clear();
    }

    /// Parameters of the tracker.
    #[must_use]
    pub fn parameters(&self) -> &TrackerParameters {
        &self.updater.parameters
    }

    fn existence(&self, track: &PointTrack, stamp_ns: i64) -> f64 {
        match self.parameters().confirmation {
            Confirmation::Counts { .. } => f64::NAN,
            Confirmation::Existence { .. } => track.existence_at(stamp_ns),
        }
    }

    /// Probabilities of the kinds of a track's target. None if tracks are confirmed by counts.
    fn kinds(&self, track: &PointTrack) -> Option<KindBelief> {
        match self.parameters().confirmation {
            Confirmation::Counts { .. } => None,
            Confirmation::Existence { .. } => Some(track.belief.kinds()),
        }
    }

    fn is_recent(&self, seen_ns: i64) -> bool {
        match (self.parameters().ageing, self.buffer.newest_ns()) {
            (Ageing::Visible { report_coast, .. }, Some(newest_ns)) => {
                seconds(seen_ns, newest_ns) <= report_coast
            }
            _ => true,
        }
    }

    fn merge(&self, tracks: &mut Vec<PointTrack>) -> Vec<[i64; 2]> {
        self.parameters()
            .merging
            .map_or_else(Vec::new, |merging| lifecycle::merge(tracks, &merging))
    }
}
