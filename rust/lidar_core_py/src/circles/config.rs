//! The fields of the configuration models of `circles` that the core reads, by name.

use crate::arrays;
use lidar_core::Error;
use lidar_core::circles::fit::{FitMethod, FitParameters};
use lidar_core::circles::parameters::ScannerParameters;
use lidar_core::circles::segment::corners::CornerParameters;
use lidar_core::circles::segment::parameters::{Bound, INCIDENCE, SegmentParameters};
use lidar_core::circles::selection::ShapeParameters;
use pyo3::prelude::*;

#[derive(FromPyObject)]
pub(crate) struct ScannerConfig {
    angle_min: f64,
    angle_increment: f64,
    n_beams: usize,
    range_min: f64,
    range_max: f64,
}

impl ScannerConfig {
    pub(crate) fn parameters(&self) -> ScannerParameters {
        ScannerParameters {
            angle_min: self.angle_min,
            angle_increment: self.angle_increment,
            n_beams: self.n_beams,
            range_limits: [self.range_min, self.range_max],
        }
    }
}

#[derive(FromPyObject)]
pub(crate) struct SegmentConfig {
    bound: String,
    slack: f64,
    distance: f64,
    max_gap: usize,
    merge_distance: f64,
    corner_depth: f64,
    min_points: usize,
    min_fraction: f64,
}

impl SegmentConfig {
    pub(crate) fn parameters(&self, scanner: &ScannerConfig) -> Result<SegmentParameters, Error> {
        let adaptive = Bound::Adaptive { incidence: INCIDENCE, slack: self.slack };
        let bounds = [("adaptive", adaptive), ("fixed", Bound::Fixed(self.distance))];
        Ok(SegmentParameters {
            bound: arrays::choice("bound", &self.bound, &bounds)?,
            max_gap: self.max_gap,
            merge_distance: self.merge_distance,
            corner: CornerParameters { depth: self.corner_depth, ..CornerParameters::default() },
            min_points: self.min_points,
            min_fraction: self.min_fraction,
            range_limits: [scanner.range_min, scanner.range_max],
            ..SegmentParameters::default()
        })
    }
}

#[derive(FromPyObject)]
pub(crate) struct FitConfig {
    method: String,
    range_std: f64,
    beam_half_width: f64,
    min_radius: f64,
    max_radius: f64,
    usual_radius: f64,
}

impl FitConfig {
    pub(crate) fn parameters(&self, scanner: &ScannerConfig) -> Result<FitParameters, Error> {
        let methods = [
            ("ml", FitMethod::Expected),
            ("mode", FitMethod::MostLikely),
            ("taubin", FitMethod::Taubin),
            ("pratt", FitMethod::Pratt),
            ("kasa", FitMethod::Kasa),
        ];
        Ok(FitParameters {
            method: arrays::choice("method", &self.method, &methods)?,
            range_std: self.range_std,
            beam_half_width: self.beam_half_width,
            radius: [self.min_radius, self.max_radius],
            usual_radius: self.usual_radius,
            range_limits: [scanner.range_min, scanner.range_max],
        })
    }
}

#[derive(FromPyObject)]
pub(crate) struct ShapeConfig {
    enabled: bool,
    max_size: f64,
}

impl ShapeConfig {
    pub(crate) fn parameters(&self) -> Option<ShapeParameters> {
        self.enabled
            .then_some(ShapeParameters { max_size: self.max_size, ..ShapeParameters::default() })
    }
}
