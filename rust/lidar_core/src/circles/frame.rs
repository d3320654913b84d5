//! Results of the pipeline for one sweep.

use super::fit::circle::CircleEstimate;
use super::map::{MapElement, MapShape, MapStats, PoseCovariance};
use super::preprocess::misses::{Misses, NEAR, NoReturn};
use super::preprocess::projection::LevelScan;
use super::segment::segments::{Segments, Side};
use super::shape::ShapeEstimate;
use crate::geometry::transform::Transform;

/// A sweep prepared for the estimation of circles.
#[derive(Clone, Debug)]
pub struct PreparedSweep {
    /// The scan in the level frame, limited to the volume.
    pub level: LevelScan,
    /// Segments of the scan.
    pub segments: Segments,
    pub(super) world_from_lidar: Transform,
    pub(super) world_from_level: Transform,
    pub(super) pose_covariance: Option<PoseCovariance>,
    pub(super) stamp_ns: i64,
    pub(super) scanner: String,
    /// Index of the scanner in the pipeline; it is set when `integrate` has processed the sweep.
    pub(super) number: usize,
    /// Time of every segment after the stamp [s]; None if all rays share the stamp.
    pub(super) delays: Option<Vec<f64>>,
    /// Smallest and largest horizontal range of the scanner [m].
    pub(super) range_limits: [f64; 2],
    /// Standard deviation of the ranges of this scanner [m].
    pub(super) range_std: f64,
    /// How the ranges of this scanner mark rays without return, learnt up to this sweep.
    pub(super) misses: Misses,
    /// Pose of the sensor in the world at the stamp, as the caller gave it.
    pub(super) given: Transform,
    pub(super) timing: CircleTiming,
}

impl PreparedSweep {
    /// Measurement time of every segment [ns].
    pub(super) fn times_ns(&self) -> Vec<i64> {
        let time = |&delay: &f64| self.stamp_ns + libm::round(delay * 1e9) as i64;
        match &self.delays {
            Some(delays) => delays.iter().map(time).collect(),
            None => vec![self.stamp_ns; self.segments.len()],
        }
    }

    /// True if a part of segment `number` may be nearer than the smallest measurable range: a hit
    /// is close to this limit, and a ray beside it has no known range. The other hits are then too
    /// far away on average. `std`: standard deviation of a range [m].
    pub(super) fn is_too_near(&self, number: usize, std: f64) -> bool {
        let ranges = &self.level.scan.ranges;
        let is_unknown = |ray: usize| ranges.get(ray).is_some_and(|range| range.is_nan());
        self.segments.rays_of(number).iter().map(|&ray| ray as usize).any(|ray| {
            ranges[ray] < self.range_limits[0] + NEAR * std
                && (is_unknown(ray.wrapping_sub(1)) || is_unknown(ray + 1))
        })
    }

    /// True if a nearer object hides a side of segment `number`.
    pub(super) fn is_covered(&self, number: usize) -> bool {
        self.segments.sides[number].contains(&Side::Occluded)
    }

    /// End points (x, y) of the rays of segment `number`, in the world [m].
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
pub struct CircleTiming {
    /// Time of range limitation and projection [ms].
    pub prepare: f64,
    /// Time of the segmentation [ms].
    pub segment: f64,
    /// Time of the estimation of circles [ms].
    pub fit: f64,
    /// Time of the update of the map [ms].
    pub map: f64,
}

/// Result of the pipeline for one sweep.
#[derive(Clone, Debug)]
pub struct CircleFrame {
    /// The scan in the level frame.
    pub level: LevelScan,
    /// Segments of the scan.
    pub segments: Segments,
    /// One circle per segment, level frame.
    pub circles: Vec<CircleEstimate>,
    /// One circle per segment, in the world.
    pub circles_world: Vec<CircleEstimate>,
    /// Measurement time of each circle: the mean time of the rays of its segment [ns].
    pub times_ns: Vec<i64>,
    /// One shape per segment, level frame; empty if shapes are not distinguished.
    pub shapes: Vec<ShapeEstimate>,
    /// ID of the map element of every segment; None for a segment that is not used in the map,
    /// because it has another shape or its hits do not lie on the circle.
    pub elements: Vec<Option<i64>>,
    /// For every segment, true if it is an object that was left out of the map because a part of it
    /// may be nearer than the smallest measurable range.
    pub too_near: Vec<bool>,
    /// ID of the line in the map for every segment; None for other shapes, and for segments that
    /// are too short for a new line.
    pub lines: Vec<Option<i64>>,
    /// Changes of the map by this sweep, as IDs of elements.
    pub stats: MapStats,
    /// Elements of the map at the time of the sweep.
    pub map: Vec<MapElement>,
    /// Map elements with other shapes than circles, at the time of the sweep.
    pub map_shapes: Vec<MapShape>,
    /// Standard deviation of the scanner's ranges, once it is estimated [m].
    pub range_std: Option<f64>,
    /// Value with which the scanner marks rays without return.
    pub no_return: NoReturn,
    /// Delay of the poses relative to the scans [s]; None before it is known.
    pub pose_offset: Option<f64>,
    /// Time per stage [ms].
    pub timing: CircleTiming,
}
