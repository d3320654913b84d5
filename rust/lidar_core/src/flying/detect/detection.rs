//! Detections from flying clusters, with covariance and confidence.

use super::center::{Center, Coherence};
use crate::flying::analysis::PoseSpread;
use crate::flying::classify::classifier::Classification;
use crate::flying::classify::clusters::Cluster;
use crate::flying::scan::prepared::Prepared;
use crate::flying::track::TargetShape;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{Transform, minus, norm};
use serde::{Deserialize, Serialize};

/// A flying object in one scan. Positions are in the frame of the map; in results of the detector,
/// they are in the world frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// Estimated centre of the object, or the centroid of its points (eq. 19) [m].
    pub position: [f64; 3],
    /// Covariance of the position [m^2].
    pub covariance: [[f64; 3]; 3],
    /// Radius of the sphere around it [m].
    pub radius: f64,
    /// Radius if the rays beside the object were as close to each other as its points [m].
    pub least_radius: f64,
    /// Sides of the bounding box of its points [m].
    pub extent: [f64; 3],
    /// Mean time of its points after the stamp of the scan [s].
    pub delay: f64,
    /// Number of its points in the scan.
    pub n_points: usize,
    /// Confidence, 0 to 1: the share of free voxels among those around it that rays can see. It is
    /// lower for few points, and 0 if only a track shows that the object flies.
    pub confidence: f64,
    /// Whether a hole in the scan connects it with a surface, of which it may be a part.
    pub is_joined: bool,
    /// Whether it has more returns of surfaces around it than returns of its own. Determined only
    /// if the sky is estimated from the scans.
    pub is_among_surfaces: bool,
    /// Fill: share of the rays inside the ellipse around its points that hit. NaN if unknown.
    pub filled_share: f64,
    /// Hits next to hits beyond chance: many on a body, none in dust. Zero if unknown.
    pub coherence: Coherence,
    /// Whether rays pass below it. None if unknown.
    pub is_free_below: Option<bool>,
    /// Whether it has moved above space that was never observed, or an object in front of it hides
    /// the space below it. It may then stand on another object.
    pub is_over_unseen: bool,
    /// Whether it ends at the edge of a nearer object past which the moving sensor looks. It may
    /// then be a part of an object behind that edge.
    pub is_uncovered: bool,
}

/// A known flying object that is not to be reported as a detection.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Teammate {
    /// Identifier of the teammate.
    pub id: i64,
    /// Position that the teammate reports [m, world].
    pub position: [f64; 3],
    /// Detections within this distance of the position are taken for the teammate [m].
    pub radius: f64,
}

/// Smallest variance of a position [m^2]. With it, a single point of a sensor without noise has a
/// covariance of full rank.
const LEAST_VARIANCE: f64 = 1e-6;
/// Number of points at which the confidence is half of that with very many points. A target of the
/// smallest kind gives at least this many.
const SURE_POINTS: f64 = 3.0;

impl Detection {
    /// Detection of a cluster at its centroid (eq. 19), in the frame of its points.
    ///
    /// The covariance has three parts: the spread of the points divided by their number, the range
    /// noise, and, along the line of sight, the error because only the near side is seen (half the
    /// lateral extent, with a standard deviation of a quarter of it).
    pub(crate) fn of(
        scan: &Prepared,
        cluster: &Cluster<'_>,
        classification: &Classification,
        range_std: f64,
    ) -> Self {
        let count = cluster.members.len() as f64;
        let confidence = classification.clearance * (1.0 - libm::exp2(-count / SURE_POINTS));
        Self {
            position: cluster.centroid,
            covariance: centroid_covariance(scan, cluster, range_std),
            radius: 0.5 * cluster.diagonal(),
            least_radius: 0.5 * cluster.diagonal(),
            extent: cluster.extent(),
            delay: scan.delays.as_ref().map_or(0.0, |delays| {
                cluster.members.iter().map(|&row| f64::from(delays[row as usize])).sum::<f64>()
                    / count
            }),
            n_points: cluster.members.len(),
            confidence,
            is_joined: false,
            is_among_surfaces: false,
            filled_share: f64::NAN,
            coherence: Coherence::default(),
            is_free_below: None,
            is_over_unseen: classification.is_over_unseen,
            is_uncovered: false,
        }
    }

    /// The detection, moved to an estimated centre.
    pub(crate) fn at(self, center: &Center) -> Self {
        Self {
            position: center.position.into(),
            covariance: center.covariance.into(),
            radius: center.radius,
            least_radius: center.least_radius,
            filled_share: center.filled_share,
            coherence: center.coherence,
            is_free_below: center.is_free_below,
            ..self
        }
    }

    /// Size and fill of the object. They are known from an estimated centre, which takes account of
    /// the rays that passed.
    pub(crate) fn shape(&self) -> TargetShape {
        let Self { n_points, radius, least_radius, filled_share, is_free_below, .. } = *self;
        let Self { coherence, is_over_unseen, is_uncovered, .. } = *self;
        TargetShape {
            n_points,
            radius,
            least_radius,
            filled_share,
            coherence,
            is_free_below,
            is_over_unseen,
            is_uncovered,
        }
    }

    /// The detection in another frame. `target_from_source`: pose of its present frame in that one.
    pub(crate) fn moved(&self, target_from_source: &Transform) -> Self {
        Self {
            position: target_from_source.apply(self.position),
            covariance: target_from_source.turn_covariance(&self.covariance),
            ..self.clone()
        }
    }

    /// Add the uncertainty of the sensor's pose to the covariance (eqs 41-42, for the position).
    pub(crate) fn add_pose_covariance(&mut self, spread: &PoseSpread) {
        let more = spread.at(self.position);
        for (line, more) in self.covariance.iter_mut().zip(&more) {
            for (entry, more) in line.iter_mut().zip(more) {
                *entry += more;
            }
        }
    }
}

fn centroid_covariance(scan: &Prepared, cluster: &Cluster<'_>, range_std: f64) -> [[f64; 3]; 3] {
    let (points, origin) = (&scan.points, scan.pose.translation);
    let count = cluster.members.len() as f64;
    let sight = minus(cluster.centroid, origin);
    let distance = norm(sight).max(f64::MIN_POSITIVE);
    let sight = sight.map(|value| value / distance);
    let hidden = 0.25 * cluster.diagonal();
    let mut covariance = [[0.0; 3]; 3];
    for &row in cluster.members {
        let offset = minus(wide(points[row as usize]), cluster.centroid);
        for (a, line) in covariance.iter_mut().enumerate() {
            for (b, entry) in line.iter_mut().enumerate() {
                *entry += offset[a] * offset[b] / (count * count);
            }
        }
    }
    for a in 0..3 {
        for b in 0..3 {
            covariance[a][b] += hidden * hidden * (sight[a] * sight[b]);
        }
        covariance[a][a] += (range_std * range_std).max(LEAST_VARIANCE);
    }
    covariance
}
