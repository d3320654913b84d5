//! Parameters of the segmentation.

use super::corners::CornerParameters;

/// Smallest angle between a ray and a surface of one object, 10 degrees [rad]: with a smaller angle
/// the adaptive bound would join objects behind one another.
pub const INCIDENCE: f64 = std::f64::consts::PI / 18.0;

/// Nearest and farthest surface that the scanner of the paper measures [m].
pub(in crate::circles) const RANGE_LIMITS: [f64; 2] = [0.1, 10.0];

/// Largest distances of an object from the near and from the far range limit at which the limit may
/// cut it [m].
pub const CUT_MARGINS: [f64; 2] = [0.15, 1.2];

/// Bound on the distance of neighbours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// Adaptive breakpoint detector: the largest distance of neighbours on a surface that rays hit
    /// at an angle of at least `incidence` [rad], plus `slack` [m].
    Adaptive {
        /// Smallest angle between a ray and a surface [rad].
        incidence: f64,
        /// Addition for the noise of the ranges [m].
        slack: f64,
    },
    /// Constant distance [m].
    Fixed(f64),
}

/// Difference of the ranges of neighbours on one surface that noise may cause, in standard
/// deviations.
const SLACK: f64 = 3.0;

impl Bound {
    /// The bound for ranges of a standard deviation [m], which the slack covers at least.
    pub(in crate::circles) fn for_noise(self, range_std: f64) -> Self {
        match self {
            Self::Adaptive { incidence, slack } => {
                Self::Adaptive { incidence, slack: slack.max(SLACK * range_std) }
            }
            Self::Fixed(_) => self,
        }
    }
}

/// Parameters of the segmentation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentParameters {
    /// Largest distance between the ends of neighbouring rays of one segment.
    pub bound: Bound,
    /// Largest number of rays without return between neighbours in polar space.
    pub max_gap: usize,
    /// Largest distance [m] between the ends of two parts of one surface, partly hidden by a nearer
    /// object, at which both parts are one segment. 0: parts are never merged.
    pub merge_distance: f64,
    /// Largest root mean square distance of merged parts from one circle or line [m].
    pub merge_deviation: f64,
    /// Rules for the split of surfaces at corners.
    pub corner: CornerParameters,
    /// Least number of rays of a segment.
    pub min_points: usize,
    /// Least share of all rays of the scan that a segment has.
    pub min_fraction: f64,
    /// Smallest and largest range that is measured [m].
    pub range_limits: [f64; 2],
    /// Distance of an outermost ray from a range limit, within which the object may continue unseen
    /// beyond the limit [m].
    pub cut_margins: [f64; 2],
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
