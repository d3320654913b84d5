//! Result of the detector for one scan.

use super::background::burn_in::Gate;
use super::detect::detection::Detection;
use super::integrate::classified_scan::IntegrateStats;
use super::track::Track;

/// Source of the rays without return of a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SkySource {
    /// Rays without return are unknown, or not known yet: open sky stays unknown in the map.
    #[default]
    Unknown,
    /// The caller gave the rays without return.
    Given,
    /// Rays without return were found from the returns of a sensor with rows.
    Pattern,
    /// Rays without return were found from the density of the returns.
    Density,
}

impl SkySource {
    /// One word for people and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Given => "given",
            Self::Pattern => "pattern",
            Self::Density => "density",
        }
    }
}

/// Milliseconds spent per stage. Several threads cast rays while clusters are sought and judged:
/// `integrate` is what is left of the map update then.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timing {
    /// Transform, deskew, masks.
    pub prepare: f64,
    /// Clustering.
    pub cluster: f64,
    /// Classification.
    pub classify: f64,
    /// Map update.
    pub integrate: f64,
    /// Removal of separate voxels.
    pub separate: f64,
    /// Tracking.
    pub track: f64,
}

/// Result of one scan; positions in the world frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Time of the scan [ns].
    pub stamp_ns: i64,
    /// Class of every point of the input.
    pub point_class: Vec<u8>,
    /// Flying objects in this scan.
    pub detections: Vec<Detection>,
    /// Known teammates that were seen: id and measured position.
    pub teammates: Vec<(i64, Detection)>,
    /// Confirmed tracks at the time of the scan.
    pub tracks: Vec<Track>,
    /// True if detections are reported.
    pub gate: Gate,
    /// Source of the rays without return.
    pub sky: SkySource,
    /// Share of the rays that go into the sky.
    pub sky_share: f64,
    /// Rays without return that were found and not given.
    pub sky_rays: usize,
    /// Share of the sensor's rays that end on the robot itself; rays without return count, as far as
    /// they are in the scan or known from the search for the sky.
    pub own_body: f64,
    /// Rows of the points on the robot itself, ascending.
    pub own_rows: Vec<u32>,
    /// True if turns have shown that what was found is the robot itself.
    pub own_body_is_decided: bool,
    /// Counts of the map's update; None if the scan was held.
    pub integrated: Option<IntegrateStats>,
    /// Time per stage.
    pub timing: Timing,
}

/// A known flying object that is not to be reported.
#[derive(Clone, Copy, Debug)]
pub struct Teammate {
    /// Identifier of the teammate.
    pub id: i64,
    /// Position that the teammate reports, world frame [m].
    pub position: [f64; 3],
    /// Detections this near are taken for it [m].
    pub radius: f64,
}
