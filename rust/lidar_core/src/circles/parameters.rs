//! Parameters of the pipeline.

use super::fit::FitParameters;
use super::map::{CircleMapParameters, ElementFilter};
use super::preprocess::projection::Projection;
use super::segment::parameters::{RANGE_LIMITS, SegmentParameters};
use super::selection::ShapeParameters;

/// Rays and range limits of a scanner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScannerParameters {
    /// Bearing of the first ray [rad].
    pub angle_min: f64,
    /// Step from ray to ray [rad].
    pub angle_increment: f64,
    /// Number of rays of one sweep.
    pub n_beams: usize,
    /// Smallest and largest range that is measured [m].
    pub range_limits: [f64; 2],
}

/// The scanner of the paper: a Hokuyo UTM-30LX, limited to 10 m.
impl Default for ScannerParameters {
    fn default() -> Self {
        Self {
            angle_min: (-135.0_f64).to_radians(),
            angle_increment: 0.25_f64.to_radians(),
            n_beams: 1081,
            range_limits: RANGE_LIMITS,
        }
    }
}

/// All parameters of the pipeline. The range limits of the parts are those of the scanner.
#[derive(Clone, Debug)]
pub struct PipelineParameters {
    /// Parameters of every scanner that is not named in `scanners`.
    pub scanner: ScannerParameters,
    /// Scanners by name.
    pub scanners: Vec<(String, ScannerParameters)>,
    /// Operating volume of all points with a x + b y + c z <= d, world frame.
    pub planes: Vec<[f64; 4]>,
    /// Projection of tilted scans.
    pub projection: Projection,
    /// Parameters of the segmentation.
    pub segment: SegmentParameters,
    /// Circle fit.
    pub fit: FitParameters,
    /// Largest root mean square distance of hits from their circle, or other shape [m].
    pub max_deviation: f64,
    /// Use of other shapes; None: all segments are treated as circles.
    pub shapes: Option<ShapeParameters>,
    /// The map.
    pub map: CircleMapParameters,
}

/// Pipeline of the best mode for the scanner of the paper.
impl Default for PipelineParameters {
    fn default() -> Self {
        Self {
            scanner: ScannerParameters::default(),
            scanners: Vec::new(),
            planes: Vec::new(),
            projection: Projection::Exact,
            segment: SegmentParameters::default(),
            fit: FitParameters::default(),
            max_deviation: 0.08,
            shapes: Some(ShapeParameters::default()),
            map: CircleMapParameters::default(),
        }
    }
}

impl PipelineParameters {
    /// Pipeline as published, except for the network that estimates circles. It is not part of
    /// this crate; its circles go into [`CirclePipeline::integrate`](super::pipeline::CirclePipeline).
    #[must_use]
    pub fn paper() -> Self {
        Self {
            projection: Projection::Paper,
            segment: SegmentParameters::paper(),
            max_deviation: 1e6,
            shapes: None,
            map: CircleMapParameters::paper(),
            ..Self::default()
        }
    }
}

impl PipelineParameters {
    /// True if properties of scanners are learnt from their scans; the stages as published do not.
    pub(super) fn learns(&self) -> bool {
        matches!(self.map.filter, ElementFilter::Independent(_)) && !self.fit.method.is_algebraic()
    }
}
