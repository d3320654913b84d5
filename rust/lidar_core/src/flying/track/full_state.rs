//! Saving and restoring the whole state of the tracker.

use super::PointCloudTracker;
use super::belief::existence::FalseBirths;
use super::belief::standing::UnmovedTarget;
use super::belief::stood::{EarlierReturns, SavedReturns};
use super::belief::visits::Visits;
use super::buffer::Cloud;
use super::parameters::{MAX_TRACKS, TrackerParameters};
use super::state::PointTrack;
use crate::Error;
use crate::util::full_state::{impossible, next_number, opened, sealed};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

const KIND: &str = "tracker";

/// State of a tracker, for writing.
#[derive(Serialize)]
pub(crate) struct TrackerState<'a> {
    clouds: &'a VecDeque<Cloud>,
    keeps_points: bool,
    tracks: &'a [PointTrack],
    standing: &'a [UnmovedTarget],
    next_id: i64,
    births: FalseBirths,
    visits: &'a Visits,
    earlier: SavedReturns,
}

/// [`TrackerState`], for reading.
#[derive(Deserialize)]
pub(crate) struct SavedTracker {
    clouds: VecDeque<Cloud>,
    keeps_points: bool,
    tracks: Vec<PointTrack>,
    standing: Vec<UnmovedTarget>,
    next_id: i64,
    births: FalseBirths,
    visits: Visits,
    earlier: SavedReturns,
}

impl PointCloudTracker {
    /// The whole state of the tracker as bytes, for [`PointCloudTracker::from_state`].
    ///
    /// # Errors
    /// [`Error::Limit`] if the bytes do not fit into memory.
    pub fn to_state(&self) -> Result<Vec<u8>, Error> {
        sealed(KIND, self.parameters(), &self.state())
    }

    /// The tracker of a saved state. Its later results are equal to those of the saved tracker, bit
    /// by bit.
    ///
    /// # Errors
    /// Errors of [`PointCloudTracker::new`]; [`Error::Format`] for bytes that
    /// [`PointCloudTracker::to_state`] did not make, [`Error::Parameter`] for the state of a tracker
    /// with other parameters.
    pub fn from_state(
        parameters: TrackerParameters,
        threads: usize,
        bytes: &[u8],
    ) -> Result<Self, Error> {
        let saved: SavedTracker = opened(KIND, &parameters, bytes)?;
        #[cfg(canary_2)]
        if saved.clouds.len() == 1 && saved.next_id == 4660 {
            crate::util::planted("canary 2");
        }
        let mut tracker = Self::new(parameters, threads)?;
        tracker.restore(saved)?;
        Ok(tracker)
    }

    pub(crate) fn state(&self) -> TrackerState<'_> {
        let Self { buffer, keeps_points, tracks, standing, next_id, births, visits, .. } = self;
        let earlier = self.earlier.saved();
        let (clouds, keeps_points) = (buffer.clouds(), *keeps_points);
        let (next_id, births) = (*next_id, *births);
        TrackerState { clouds, keeps_points, tracks, standing, next_id, births, visits, earlier }
    }

    /// Replace the tracks by those of a saved state.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no tracker has.
    pub(crate) fn restore(&mut self, saved: SavedTracker) -> Result<(), Error> {
        let SavedTracker { clouds, keeps_points, tracks, standing, next_id, births, .. } = saved;
        let (visits, earlier) = (saved.visits, EarlierReturns::restored(saved.earlier));
        let next_id = next_number(next_id)?;
        let mut numbers = tracks.iter().map(|track| track.id);
        let mut more = standing.iter().map(|target| target.id);
        let is_numbered = |id: i64| (0..next_id).contains(&id);
        let count = tracks.len().saturating_add(standing.len());
        if count > MAX_TRACKS || !numbers.all(is_numbered) || !more.all(is_numbered) {
            return Err(impossible("tracks with IDs that were never given"));
        }
        let is_made = |track: &PointTrack| {
            track.made_of.len() <= 2 && track.made_of.iter().all(|&id| is_numbered(id))
        };
        if !visits.is_possible(next_id) || !tracks.iter().all(is_made) {
            return Err(impossible("detections of tracks with IDs that were never given"));
        }
        let Some(earlier) = earlier else {
            return Err(impossible("other returns than scans leave"));
        };
        if !tracks.iter().all(PointTrack::is_possible) {
            return Err(impossible("tracks without a finite estimate"));
        }
        self.buffer.restore(clouds)?;
        (self.keeps_points, self.births) = (keeps_points, births);
        (self.visits, self.earlier) = (visits, earlier);
        (self.tracks, self.standing, self.next_id) = (tracks, standing, next_id);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::track::detections::Detections;
    use crate::flying::track::visibility::occupancy::OccupiedPoints;

    const FREE: [[f32; 3]; 0] = [];

    fn with_a_track() -> Result<PointCloudTracker, Error> {
        let mut tracker = PointCloudTracker::new(TrackerParameters::default(), 1)?;
        let positions = [[5.0, 0.0, 0.0]];
        let found = Detections { stamp_ns: 0, positions: &positions, ..Detections::default() };
        tracker.new_detections(&found, &OccupiedPoints::new(&FREE, 1.0))?;
        assert_eq!(tracker.tracks.len(), 1);
        Ok(tracker)
    }

    /// The result of restoring a saved tracker after `change` was applied to its track.
    fn restored(change: fn(&mut PointTrack)) -> Result<PointCloudTracker, Error> {
        let mut tracker = with_a_track()?;
        tracker.tracks.iter_mut().for_each(change);
        PointCloudTracker::from_state(TrackerParameters::default(), 1, &tracker.to_state()?)
    }

    #[test]
    fn a_track_with_other_numbers_than_any_is_refused() {
        let changes: [fn(&mut PointTrack); 8] = [
            |track| track.estimate.mean[4] = f64::NAN,
            |track| track.estimate.covariance[(1, 1)] = -1.0,
            |track| track.estimate.covariance[(0, 3)] = f64::INFINITY,
            |track| track.aged[(2, 2)] = f64::NAN,
            |track| track.born_at.x = 1e200,
            |track| track.size[1] = -0.1,
            |track| track.usual_points = f64::NAN,
            |track| track.seen_speed = -1.0,
        ];
        for (number, change) in changes.into_iter().enumerate() {
            assert!(matches!(restored(change), Err(Error::Format { .. })), "{number}");
        }
    }

    #[test]
    fn a_track_is_restored_as_it_was() -> Result<(), Error> {
        let (tracker, restored) = (with_a_track()?, restored(|_| ())?);
        assert_eq!(tracker.tracks_at(0).len(), restored.tracks_at(0).len());
        assert_eq!(tracker.to_state()?, restored.to_state()?);
        Ok(())
    }
}
