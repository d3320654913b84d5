//! The whole state of a detector between two scans.

use super::background::burn_in::BurnIn;
use super::background::pose_jump::HeldScan;
use super::background::static_points::PointsOfVoxel;
use super::detect::detection::Teammate;
use super::map::blocks::Place;
use super::map::full_state::{LocalState, SavedLocalMap};
use super::moving::ground_movers::SavedMovers;
use super::moving::static_map::{SavedStaticMapper, StaticMapperState};
use super::scan::sensors::SavedSensors;
use super::track::{SavedTracker, TrackerState};
use super::track_before_detect::SavedTrackBeforeDetect;
use serde::{Deserialize, Serialize};

/// Kind of a detector's state, as its bytes name it.
pub(super) const KIND: &str = "flying-object detector";

/// State of a detector, for writing.
#[derive(Serialize)]
pub(super) struct DetectorState<'a> {
    pub(super) local: LocalState<'a>,
    pub(super) sensors: SavedSensors,
    pub(super) teammates: &'a [Teammate],
    pub(super) scans: u32,
    pub(super) burn_in: &'a BurnIn,
    pub(super) is_reporting: bool,
    pub(super) held: &'a Option<HeldScan>,
    pub(super) static_points: Vec<(Place, PointsOfVoxel)>,
    pub(super) tracker: TrackerState<'a>,
    pub(super) movers: SavedMovers,
    pub(super) before_detect: SavedTrackBeforeDetect,
    pub(super) static_map: Option<StaticMapperState<'a>>,
}

/// [`DetectorState`], for reading.
#[derive(Deserialize)]
pub(super) struct SavedDetector {
    pub(super) local: SavedLocalMap,
    pub(super) sensors: SavedSensors,
    pub(super) teammates: Vec<Teammate>,
    pub(super) scans: u32,
    pub(super) burn_in: BurnIn,
    pub(super) is_reporting: bool,
    pub(super) held: Option<HeldScan>,
    pub(super) static_points: Vec<(Place, PointsOfVoxel)>,
    pub(super) tracker: SavedTracker,
    pub(super) movers: SavedMovers,
    pub(super) before_detect: SavedTrackBeforeDetect,
    pub(super) static_map: Option<SavedStaticMapper>,
}
