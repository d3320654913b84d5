//! Result of the detector for one scan.

use super::detect::detection::Detection;
use super::detect::detections::ScanDetections;
use super::integrate::classified_scan::IntegrateStats;
use super::point_class::{PointClass, replace};
use super::reporting_gate::ReportingGate;
use super::scan::prepared::Prepared;
use super::scan::sensors::OwnBody;
use super::scan::untimed::PointTimes;
use super::sky::source::SkySource;
use super::track::Track;
use crate::geometry::transform::Transform;

/// Times of the stages of one scan [ms]. With several threads, rays are cast during clustering and
/// classification, so `integrate` is the rest of the map update.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timing {
    /// Preparation: transform, deskewing, masks [ms].
    pub prepare: f64,
    /// Clustering [ms].
    pub cluster: f64,
    /// Classification [ms].
    pub classify: f64,
    /// Map update [ms].
    pub integrate: f64,
    /// Removal of separate voxels [ms].
    pub separate: f64,
    /// Tracking [ms].
    pub track: f64,
}

/// Result of the detector for one scan. Positions are in the world frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Time of the scan [ns].
    pub stamp_ns: i64,
    /// Class of every point of the input, in its order.
    pub point_class: Vec<PointClass>,
    /// Flying objects in this scan. Empty unless `gate` is open.
    pub detections: Vec<Detection>,
    /// Teammates that were seen: identifier and measured position.
    pub teammates: Vec<(i64, Detection)>,
    /// Reported tracks, predicted to the time of the scan.
    pub tracks: Vec<Track>,
    /// Whether detections are reported, or why not.
    pub gate: ReportingGate,
    /// Where the rays without return come from.
    pub sky: SkySource,
    /// Share of the sensor's rays that go into the sky.
    pub sky_share: f64,
    /// Number of rays without return that were found by the detector.
    pub sky_rays: usize,
    /// Where the times of the points come from.
    pub point_times: PointTimes,
    /// Share of the sensor's rays that end on the robot itself. Rays without return count if they
    /// are in the scan, or known from the search for the sky.
    pub own_body: f64,
    /// Indices of the points on the robot itself, ascending.
    pub own_rows: Vec<u32>,
    /// Whether turns have confirmed that the voxels of the body are the robot itself.
    pub own_body_is_decided: bool,
    /// Counts of the map update. None if the scan was held.
    pub integrated: Option<IntegrateStats>,
    /// Times of the stages.
    pub timing: Timing,
}

impl Frame {
    /// A frame without objects. `class`: class of every point of `scan`.
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
            point_times: scan.point_times,
            own_body: 0.0,
            own_rows: Vec::new(),
            own_body_is_decided: false,
            integrated: None,
            timing: Timing::default(),
        }
    }

    /// Add the points on the robot itself. They were measured, so their class is unknown and not
    /// invalid.
    pub(super) fn with_own_body(mut self, own: OwnBody) -> Self {
        for &row in &own.rows {
            self.point_class[row as usize] = PointClass::Unknown;
        }
        (self.own_rows, self.own_body) = (own.rows, own.share);
        self.own_body_is_decided = own.is_decided;
        self
    }

    /// Set the class of the points of ground movers, given by their indices.
    pub(super) fn with_movers(mut self, rows: &[u32]) -> Self {
        for &row in rows.iter().filter(|_| self.gate == ReportingGate::Open) {
            self.point_class[row as usize] = PointClass::Moving;
        }
        self
    }

    /// Add the detections, if they are reported. Otherwise no point has the class flying.
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
