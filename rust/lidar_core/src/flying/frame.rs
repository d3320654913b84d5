//! Result of the detector for one scan.

use super::detect::detection::Detection;
use super::detect::detections::ScanDetections;
use super::integrate::classified_scan::IntegrateStats;
use super::point_class::{PointClass, replace};
use super::reporting_gate::ReportingGate;
use super::scan::prepared::Prepared;
use super::scan::sensors::OwnBody;
use super::sky::source::SkySource;
use super::track::Track;
use crate::geometry::transform::Transform;

/// Milliseconds per stage. With several threads, rays are cast during clustering and
/// classification: `integrate` is then the rest of the map update.
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
    pub point_class: Vec<PointClass>,
    /// Flying objects in this scan.
    pub detections: Vec<Detection>,
    /// Known teammates that were seen: id and measured position.
    pub teammates: Vec<(i64, Detection)>,
    /// Confirmed tracks at the time of the scan.
    pub tracks: Vec<Track>,
    /// Whether detections are reported, or why not.
    pub gate: ReportingGate,
    /// Source of the rays without return.
    pub sky: SkySource,
    /// Share of the rays that go into the sky.
    pub sky_share: f64,
    /// Rays without return that were found and not given.
    pub sky_rays: usize,
    /// Share of the sensor's rays that end on the robot itself; rays without return count if they
    /// are in the scan or known from the search for the sky.
    pub own_body: f64,
    /// Rows of the points on the robot itself, ascending.
    pub own_rows: Vec<u32>,
    /// True if turns have confirmed that the body is the robot itself.
    pub own_body_is_decided: bool,
    /// Counts of the update of the map; None if the scan was held.
    pub integrated: Option<IntegrateStats>,
    /// Time per stage.
    pub timing: Timing,
}

impl Frame {
    /// A frame without objects; `class` is that of every row of `scan`.
    pub(super) fn of(stamp_ns: i64, scan: &Prepared, class: &[PointClass]) -> Self {
        Self {
            stamp_ns,
            point_class: class[..scan.rows].to_vec(),
            detections: Vec::new(),
            teammates: Vec::new(),
            tracks: Vec::new(),
            gate: ReportingGate::Open,
            sky: scan.sky,
            sky_share: scan.sky_share,
            sky_rays: scan.rebuilt,
            own_body: 0.0,
            own_rows: Vec::new(),
            own_body_is_decided: false,
            integrated: None,
            timing: Timing::default(),
        }
    }

    /// Take over the points on the robot itself: they were measured, so they are unknown, not invalid.
    pub(super) fn with_own_body(mut self, own: OwnBody) -> Self {
        for &row in &own.rows {
            self.point_class[row as usize] = PointClass::Unknown;
        }
        (self.own_rows, self.own_body) = (own.rows, own.share);
        self.own_body_is_decided = own.is_decided;
        self
    }

    /// Take over the rows of the points of ground movers.
    pub(super) fn with_movers(mut self, rows: &[u32]) -> Self {
        for &row in rows.iter().filter(|_| self.gate == ReportingGate::Open) {
            self.point_class[row as usize] = PointClass::Moving;
        }
        self
    }

    /// Take over the detections, if they are reported; otherwise no point flies.
    pub(super) fn with_detections(
        mut self,
        found: &ScanDetections,
        world_from_map: &Transform,
    ) -> Self {
        if self.gate != ReportingGate::Open {
            replace(&mut self.point_class, PointClass::Flying, PointClass::Unknown);
            return self;
        }
        let teammates = found.teammates.iter();
        self.detections = found.detections.iter().map(|d| d.moved(world_from_map)).collect();
        self.teammates = teammates.map(|(id, d)| (*id, d.moved(world_from_map))).collect();
        self
    }
}
