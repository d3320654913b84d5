//! The whole state of the tracker.

use super::PointCloudTracker;
use super::belief::existence::FalseBirths;
use super::belief::standing::UnmovedTarget;
use super::belief::visits::Visits;
use super::buffer::Cloud;
use super::parameters::{MAX_TRACKS, TrackerParameters};
use super::state::PointTrack;
use crate::Error;
use crate::util::full_state::{impossible, next_number, opened, sealed};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

const KIND: &str = "tracker";

/// State of a tracker as bytes are written from it.
#[derive(Serialize)]
pub(crate) struct TrackerState<'a> {
    clouds: &'a VecDeque<Cloud>,
    keeps_points: bool,
    tracks: &'a [PointTrack],
    standing: &'a [UnmovedTarget],
    next_id: i64,
    births: FalseBirths,
    visits: &'a Visits,
}

/// [`TrackerState`] as it is read back.
#[derive(Deserialize)]
pub(crate) struct SavedTracker {
    clouds: VecDeque<Cloud>,
    keeps_points: bool,
    tracks: Vec<PointTrack>,
    standing: Vec<UnmovedTarget>,
    next_id: i64,
    births: FalseBirths,
    visits: Visits,
}

impl PointCloudTracker {
    /// The whole state as bytes.
    ///
    /// # Errors
    /// [`Error::Limit`] if the bytes do not fit into memory.
    pub fn to_state(&self) -> Result<Vec<u8>, Error> {
        sealed(KIND, self.parameters(), &self.state())
    }

    /// Tracker from a saved state; it continues with the same bits as the saved one.
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
        let (clouds, keeps_points) = (buffer.clouds(), *keeps_points);
        let (next_id, births) = (*next_id, *births);
        TrackerState { clouds, keeps_points, tracks, standing, next_id, births, visits }
    }

    /// # Errors
    /// [`Error::Format`] for a state that no tracker has.
    pub(crate) fn restore(&mut self, saved: SavedTracker) -> Result<(), Error> {
        let SavedTracker { clouds, keeps_points, tracks, standing, next_id, births, visits } =
            saved;
        let next_id = next_number(next_id)?;
        let mut numbers = tracks.iter().map(|track| track.id);
        let mut more = standing.iter().map(|target| target.id);
        let is_numbered = |id: i64| (0..next_id).contains(&id);
        let count = tracks.len().saturating_add(standing.len());
        if count > MAX_TRACKS || !numbers.all(is_numbered) || !more.all(is_numbered) {
            return Err(impossible("tracks that were never numbered"));
        }
        let is_made = |track: &PointTrack| {
            track.made_of.len() <= 2 && track.made_of.iter().all(|&id| is_numbered(id))
        };
        if !visits.is_possible(next_id) || !tracks.iter().all(is_made) {
            return Err(impossible("detections of tracks that were never numbered"));
        }
        if !tracks.iter().all(PointTrack::is_possible) {
            return Err(impossible("tracks without a finite estimate"));
        }
        self.buffer.restore(clouds)?;
        (self.keeps_points, self.births, self.visits) = (keeps_points, births, visits);
        (self.tracks, self.standing, self.next_id) = (tracks, standing, next_id);
        Ok(())
    }
}
