//! What the pipeline says about one sweep.

use super::fit::circle::CircleEstimate;
use super::map::{MapElement, MapShape, MapStats, PoseCovariance};
use super::preprocess::projection::LevelScan;
use super::segment::segments::Segments;
use super::shape::ShapeEstimate;
use crate::geometry::transform::Transform;

/// A sweep ready for its circles to be estimated.
#[derive(Clone, Debug)]
pub struct PreparedSweep {
    /// The scan in the level frame, limited to the volume.
    pub level: LevelScan,
    /// Its objects.
    pub segments: Segments,
    pub(super) world_from_lidar: Transform,
    pub(super) world_from_level: Transform,
    pub(super) pose_covariance: Option<PoseCovariance>,
    pub(super) stamp_ns: i64,
    pub(super) scanner: String,
    /// Place of the scanner, once `integrate` has taken the sweep.
    pub(super) number: usize,
    /// Time of every segment after the stamp [s]; None if all rays share the stamp.
    pub(super) delays: Option<Vec<f64>>,
    /// Horizontal reach of the scanner [m].
    pub(super) range_limits: [f64; 2],
    pub(super) timing: Timing,
}

/// Standard deviations above the nearest range within which a hit may have neighbours below it.
const NEAR: f64 = 10.0;

impl PreparedSweep {
    /// When every segment was measured [ns].
    pub(super) fn times_ns(&self) -> Vec<i64> {
        let time = |&delay: &f64| self.stamp_ns + libm::round(delay * 1e9) as i64;
        match &self.delays {
            Some(delays) => delays.iter().map(time).collect(),
            None => vec![self.stamp_ns; self.segments.len()],
        }
    }

    /// Whether rays beside the hits of a segment may have met it nearer than the scanner measures,
    /// with ranges of deviation `std`: the hits that are left lie too far away in the mean.
    pub(super) fn is_too_near(&self, number: usize, std: f64) -> bool {
        let ranges = &self.level.scan.ranges;
        let is_unknown = |ray: usize| ranges.get(ray).is_some_and(|range| range.is_nan());
        self.segments.rays_of(number).iter().map(|&ray| ray as usize).any(|ray| {
            ranges[ray] < self.range_limits[0] + NEAR * std
                && (is_unknown(ray.wrapping_sub(1)) || is_unknown(ray + 1))
        })
    }

    /// Where the rays of a segment ended, from above [m].
    pub(super) fn points_world(&self, number: usize) -> Vec<[f64; 2]> {
        let rays = self.segments.rays_of(number).iter();
        let points = rays.filter_map(|&ray| self.level.scan.point(ray as usize));
        points
            .map(|[x, y]| {
                let [x, y, _] = self.world_from_level.apply([x, y, 0.0]);
                [x, y]
            })
            .collect()
    }
}

/// Milliseconds spent per stage.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timing {
    /// Range limitation and projection.
    pub prepare: f64,
    /// Segmentation.
    pub segment: f64,
    /// Estimation of circles.
    pub fit: f64,
    /// The map.
    pub map: f64,
}

/// What a sweep showed and did.
#[derive(Clone, Debug)]
pub struct CircleFrame {
    /// The scan in the level frame.
    pub level: LevelScan,
    /// Its objects.
    pub segments: Segments,
    /// One circle per segment, level frame.
    pub circles: Vec<CircleEstimate>,
    /// The same in the world.
    pub circles_world: Vec<CircleEstimate>,
    /// When each circle was measured: the mean time of the rays of its segment [ns].
    pub times_ns: Vec<i64>,
    /// One shape per segment, level frame; empty where shapes are not told apart.
    pub shapes: Vec<ShapeEstimate>,
    /// Element of the map of every segment; None for what is not taken into it: it has another
    /// shape, or the hits do not lie on the circle.
    pub elements: Vec<Option<i64>>,
    /// Whether every segment is an object that was left out of the map since a part of it may be
    /// nearer than the scanner measures.
    pub too_near: Vec<bool>,
    /// Line of the map of every segment; None for what is no line, or too short to be a new one.
    pub lines: Vec<Option<i64>>,
    /// What the map did with them.
    pub stats: MapStats,
    /// Elements of the map at the time of the sweep.
    pub map: Vec<MapElement>,
    /// Its elements that are no circles.
    pub map_shapes: Vec<MapShape>,
    /// Time per stage.
    pub timing: Timing,
}
