//! One scanner of the pipeline, with the parts that all its sweeps share.

use super::fit::{FitParameters, Fitter};
use super::parameters::{PipelineParameters, ScannerParameters};
use super::pose_offset::PoseOffset;
use super::preprocess::misses::{Misses, NEAR};
use super::preprocess::polar_scan::PolarScan;
use super::preprocess::projection::{self, LevelScan};
use super::preprocess::sweep_poses::SweepPoses;
use super::range_noise::RangeNoise;
use super::raw_sweep::RawSweep;
use super::segment::segments::Segments;
use super::shape::ShapeFitter;
use crate::Error;
use crate::geometry::motion::ScanPoses;
use crate::geometry::transform::Transform;

/// One scanner: its rays, its range limits and its estimators.
pub(super) struct Scanner {
    pub(super) bearings: Vec<f64>,
    pub(super) directions: Vec<[f64; 2]>,
    pub(super) range_limits: [f64; 2],
    pub(super) fitter: Fitter,
    pub(super) shaper: ShapeFitter,
    pub(super) noise: RangeNoise,
    pub(super) misses: Misses,
    pub(super) offset: PoseOffset,
}

impl Scanner {
    /// Prepare the memory of one scanner: its bearings and fitters.
    ///
    /// # Errors
    /// [`Error::Limit`] for too many rays, [`Error::Parameter`] for values that cannot work.
    pub(super) fn new(
        scanner: &ScannerParameters,
        parameters: &PipelineParameters,
    ) -> Result<Self, Error> {
        crate::util::budget::check_points(scanner.n_beams)?;
        let bearing = |ray: usize| scanner.angle_min + scanner.angle_increment * ray as f64;
        let bearings: Vec<f64> = (0..scanner.n_beams).map(bearing).collect();
        let range_limits = scanner.range_limits;
        Ok(Self {
            directions: projection::directions(&bearings),
            bearings,
            range_limits,
            fitter: Fitter::new(FitParameters { range_limits, ..parameters.fit })?,
            shaper: ShapeFitter::new(FitParameters { range_limits, ..parameters.fit })?,
            noise: RangeNoise::new(parameters.fit.range_std),
            misses: Misses::default(),
            offset: PoseOffset::default(),
        })
    }

    /// Pose of a sweep at its stamp as given, and its poses, moved on if they are known to be late.
    ///
    /// # Errors
    /// Errors of [`ScanPoses::new`] and [`SweepPoses::new`].
    pub(super) fn sweep(&self, raw: &RawSweep<'_>) -> Result<(Transform, SweepPoses), Error> {
        let with = |poses: &[[f64; 16]]| {
            let motion = ScanPoses::new(poses, raw.pose_stamps_ns)?;
            SweepPoses::new(&motion, raw.stamp_ns, raw.ray_time_ns)
        };
        let sweep = with(raw.poses)?;
        let given = *sweep.at_stamp();
        let shifted = self.offset.shifted(raw.stamp_ns, &given, raw.poses);
        Ok((given, shifted.map_or(Ok(sweep), |poses| with(&poses))?))
    }

    /// Learn the noise of the ranges from a sweep, and fit with it.
    ///
    /// # Errors
    /// [`Error::Parameter`] never: the deviation stays positive.
    pub(super) fn listen(&mut self, scan: &PolarScan, segments: &Segments) -> Result<(), Error> {
        let mut noise = self.noise;
        noise.add(scan, segments);
        self.hear(noise)
    }

    /// Use this noise of the ranges in the fit.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a deviation that is not positive.
    pub(super) fn hear(&mut self, noise: RangeNoise) -> Result<(), Error> {
        self.fitter.set_range_std(noise.std())?;
        self.shaper.set_range_std(noise.std())?;
        self.noise = noise;
        Ok(())
    }

    /// Smallest and largest horizontal range [m]; `upright` is the smallest ratio of horizontal to
    /// full length over all rays.
    pub(super) fn horizontal_limits(&self, upright: f64) -> [f64; 2] {
        let [near, far] = self.range_limits;
        [near, (far * upright).max(2.0 * near)]
    }

    /// How the ranges of the scanner mark rays without return, learnt also from this sweep if the
    /// pipeline learns such properties.
    pub(super) fn misses_with(
        &self,
        raw: &RawSweep<'_>,
        parameters: &PipelineParameters,
    ) -> Misses {
        let mut misses = self.misses.clone();
        if parameters.learns() {
            misses.add(raw.ranges, self.range_limits);
        }
        misses
    }

    /// Scan in the level frame, limited to the volume, and the ranges before that limitation, if
    /// any. Rays without return have the meaning of `misses`.
    ///
    /// # Errors
    /// Errors of [`projection::limit_range`].
    pub(super) fn level(
        &self,
        raw: &RawSweep<'_>,
        misses: &Misses,
        sweep: &SweepPoses,
        parameters: &PipelineParameters,
    ) -> Result<(LevelScan, Option<Vec<f64>>), Error> {
        let nearest = self.range_limits[0] + NEAR * self.noise.std();
        let ranges = misses.marked(raw.ranges, self.range_limits, nearest);
        let limited = match parameters.planes.as_slice() {
            [] => None,
            planes => Some(projection::limit_range(&ranges, &self.directions, sweep, planes)?),
        };
        let scan = PolarScan { ranges, bearings: self.bearings.clone() };
        let mut level = projection::project(&scan, &self.directions, sweep, parameters.projection)?;
        let Some(limited) = limited else { return Ok((level, None)) };
        let seen = level.scan.ranges.clone();
        for (ray, &range) in limited.iter().enumerate().filter(|(_, range)| !range.is_finite()) {
            level.scan.ranges[ray] = range;
            level.heights[ray] = f64::NAN;
        }
        Ok((level, Some(seen)))
    }
}
