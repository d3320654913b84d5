//! Parameters of the circle pipeline that ship, and those of the paper.
//!
//! These are the only literals of a configuration in Rust. A test holds them against the models of
//! the Python package, which document each value.

use super::fit::{FitMethod, FitParameters};
use super::map::{
    CircleMapParameters, ElementFilter, Independent, Joint, Limits, LineRules, MotionMode,
    Standing, VisibilityTest,
};
use super::parameters::{PipelineParameters, ScannerParameters};
use super::preprocess::projection::Projection;
use super::segment::corners::CornerParameters;
use super::segment::parameters::{Bound, CUT_MARGINS, INCIDENCE, SegmentParameters};
use super::selection::ShapeParameters;

/// Nearest and farthest surface that the scanner of the paper measures [m].
const RANGE_LIMITS: [f64; 2] = [0.1, 10.0];
/// Modes of motion: density of the acceleration [m^2/s^3], weight, mean time [s].
const MODES: [MotionMode; 3] = [
    MotionMode { density: 0.1, weight: 0.4, duration: 2.0 },
    MotionMode { density: 0.5, weight: 0.599, duration: 2.0 },
    MotionMode { density: 200.0, weight: 0.001, duration: 0.1 },
];

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

/// Segmentation of the best mode.
impl Default for SegmentParameters {
    fn default() -> Self {
        Self {
            bound: Bound::Adaptive { incidence: INCIDENCE, slack: 0.09 },
            max_gap: 2,
            merge_distance: 0.5,
            merge_deviation: 0.03,
            corner: CornerParameters::default(),
            min_points: 4,
            min_fraction: 0.0,
            range_limits: RANGE_LIMITS,
            cut_margins: CUT_MARGINS,
        }
    }
}

impl SegmentParameters {
    /// Segmentation by eq. 6 as published.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            bound: Bound::Fixed(0.2),
            max_gap: 0,
            merge_distance: 0.0,
            corner: CornerParameters { depth: 0.0, ..CornerParameters::default() },
            min_points: 1,
            min_fraction: 0.003,
            ..Self::default()
        }
    }
}

/// Corner rules of the best mode.
impl Default for CornerParameters {
    fn default() -> Self {
        Self { depth: 0.15, width: 1.2 }
    }
}

/// Fit of the expected circle, the method of the best mode.
impl Default for FitParameters {
    fn default() -> Self {
        Self {
            method: FitMethod::Expected,
            range_std: 0.01,
            beam_half_width: 0.0,
            radius: [0.02, 1.0],
            usual_radius: 0.5,
            range_limits: RANGE_LIMITS,
        }
    }
}

/// Shape rules of the best mode.
impl Default for ShapeParameters {
    fn default() -> Self {
        Self { max_size: 0.5, model_std: 0.03, min_hits: 6 }
    }
}

/// One filter per element, as in the best mode.
impl Default for Independent {
    fn default() -> Self {
        Self {
            modes: MODES.to_vec(),
            standing: Standing {
                share: 0.5,
                duration: 10.0,
                moving: 5.0,
                density: 1e-4,
                start_speed: 1.0,
                hysteresis: [0.8, 0.4],
            },
            center_noise: 0.002,
            radius_density: 1e-6,
            turn_density: 0.01,
            birth_density: 1e-4,
            merge_gap: 0.15,
            report_existence: 0.9,
            limits: Limits { position: 1.0, velocity: 3.0, radius: 0.3 },
            coast: Some(5.0),
            visibility_test: VisibilityTest { margin: 0.15, min_rays: 4 },
            buffer_time: 0.25,
            lines: LineRules::default(),
        }
    }
}

/// Line rules of the best mode.
impl Default for LineRules {
    fn default() -> Self {
        Self { density: 1e-6, std: 0.01, gap: 0.5, length: 0.5, reach: 3.0, coast: Some(60.0) }
    }
}

/// Joint filter with the values of eqs 14 and 33.
impl Default for Joint {
    fn default() -> Self {
        Self { velocity_step: 0.1, max_eigenvalue: 3.0 }
    }
}

/// Map of the best mode: one filter per element.
impl Default for CircleMapParameters {
    fn default() -> Self {
        Self {
            filter: ElementFilter::Independent(Independent::default()),
            gate_probability: 0.9999,
            initial_speed: 1.5,
        }
    }
}

impl CircleMapParameters {
    /// Map with the joint filter as published.
    #[must_use]
    pub fn paper() -> Self {
        Self { filter: ElementFilter::Paper(Joint::default()), ..Self::default() }
    }
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
