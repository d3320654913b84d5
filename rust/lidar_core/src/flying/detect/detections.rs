//! Flying objects of a scan: classified clusters become detections and teammates.

use super::center::Center;
use super::detection::{Detection, Teammate};
use super::filled::share_of_expected;
use super::hole::is_joined;
use super::near_ground::is_just_above_ground;
use super::parts::UnitedClusters;
use super::surroundings::{
    are_rays_lost_below, is_among_surfaces, is_free_below_rest, is_hidden_below,
};
use super::visibility::ScanView;
use crate::flying::classify::classifier::Classification;
use crate::flying::classify::clusters::{Cluster, Clusters};
use crate::flying::parameters::FlyingParameters;
use crate::flying::point_class::PointClass;
use crate::flying::scan::prepared::Prepared;
use crate::flying::sky::source::SkySource;
use crate::geometry::transform::{Transform, dot, minus, norm};

/// Factor of the confidence of a target with nothing but sky around it. Free space that only the
/// sky supports is less certain than free space that returns have shown.
const ONLY_SKY: f64 = 0.7;
/// Distance that a sensor must have moved across the line of sight since its last scan, to count as
/// looking past nearer objects [m]. The poses of a sensor at rest have errors of centimetres from
/// scan to scan.
const LOOKS_PAST: f64 = 0.1;

/// Inputs of the detection of flying objects in a scan.
#[derive(Clone, Copy)]
pub(crate) struct ScanToDetect<'a> {
    pub(crate) scan: &'a Prepared,
    pub(crate) view: &'a ScanView<'a>,
    pub(crate) teammates: &'a [Teammate],
    pub(crate) map_from_world: Transform,
    pub(crate) parameters: &'a FlyingParameters,
}

/// Detections and teammates in one scan, in the frame of the map.
#[derive(Default)]
pub(crate) struct ScanDetections {
    pub(crate) detections: Vec<Detection>,
    pub(crate) teammates: Vec<(i64, Detection)>,
    /// Indices of points that are on teammates.
    pub(crate) hidden: Vec<u32>,
}

/// Detections and teammates of a scan, in the frame of the map. `classifications`: indices of
/// clusters, with their classes.
pub(crate) fn detect<'c>(
    input: &ScanToDetect<'_>,
    clusters: &Clusters,
    classifications: impl Iterator<Item = (usize, &'c Classification)>,
) -> ScanDetections {
    // Longer than other functions: the steps for one cluster, which change one detection.
    let ScanToDetect { scan, view, parameters, .. } = *input;
    let mut found = ScanDetections::default();
    let longest = parameters.classify.max_extent;
    let origin = scan.pose.translation;
    let united = UnitedClusters::of(&scan.points, origin, clusters, classifications, longest);
    let mut centers = centers(input, united.iter(clusters)).into_iter();
    let is_flying = flying_rows(scan, united.iter(clusters));
    for (cluster, classification) in united.iter(clusters) {
        let mate = input
            .teammate_at(cluster.centroid)
            .filter(|_| classification.class != PointClass::Background);
        if mate.is_some() {
            found.hidden.extend(cluster.members);
        }
        if classification.class != PointClass::Flying {
            continue;
        }
        let mut detection =
            Detection::of(scan, &cluster, classification, input.parameters.range_std);
        detection.confidence *= trust(scan, &cluster);
        // What a track has led beside structure is known to be another thing.
        detection.is_joined = !is_flying.is_empty()
            && !classification.is_expected
            && is_joined(scan, &cluster, &is_flying);
        detection.is_among_surfaces =
            !is_flying.is_empty() && is_among_surfaces(scan, &cluster, &is_flying);
        if let Some(center) = centers.next() {
            detection = centered(detection, &center, scan, &cluster);
        }
        if let Some(spread) = view.spread() {
            detection.add_pose_covariance(spread);
        }
        match mate {
            Some(mate) => found.teammates.push((mate.id, detection)),
            None => found.detections.push(detection),
        }
    }
    found
}

/// The detection moved to its estimated centre. Values that need rays which the scan does not have
/// are replaced by estimates, or are unknown.
fn centered(
    detection: Detection,
    center: &Center,
    scan: &Prepared,
    cluster: &Cluster<'_>,
) -> Detection {
    let mut detection = detection.at(center);
    detection.is_uncovered = center.is_at_edge && looks_past(scan, cluster);
    if detection.is_free_below == Some(false) {
        if is_free_below_rest(scan, cluster) {
            detection.is_free_below = Some(true);
        } else if are_rays_lost_below(scan, cluster) {
            detection.is_free_below = None;
        } else if is_hidden_below(scan, cluster) {
            detection.is_over_unseen = true;
        }
    } else if detection.is_free_below.is_none() && is_just_above_ground(scan, cluster) {
        detection.is_free_below = Some(false);
    }
    // The rays into a sky that is known by its density are made up: those that passed are not known.
    if scan.sky == SkySource::Density {
        detection.filled_share = share_of_expected(scan, cluster);
    }
    detection
}

/// True if the sensor has moved across the line of sight to a cluster since its last scan, so that
/// the edges of nearer objects have moved in front of the cluster.
fn looks_past(scan: &Prepared, cluster: &Cluster<'_>) -> bool {
    let sight = minus(cluster.centroid, scan.pose.translation);
    let along = dot(scan.moved, sight) / norm(sight).max(f64::MIN_POSITIVE);
    dot(scan.moved, scan.moved) - along * along > LOOKS_PAST * LOOKS_PAST
}

/// For every flying cluster, the centre of the target behind its points. Empty if centres are not
/// asked for.
fn centers<'a>(
    input: &ScanToDetect<'_>,
    clusters: impl Iterator<Item = (Cluster<'a>, &'a Classification)>,
) -> Vec<Center> {
    let flies = |classification: &Classification| {
        input.parameters.centers && classification.class == PointClass::Flying
    };
    let flying = clusters.filter(|(_, classification)| flies(classification));
    let rows: Vec<&[u32]> = flying.map(|(cluster, _)| cluster.members).collect();
    input.view.centers_of(&rows)
}

/// For each point of a scan, whether it belongs to a flying cluster. Empty if no search for holes
/// is needed: rays without return are given, or the air is full of droplets, so that returns are
/// missing everywhere.
fn flying_rows<'a>(
    scan: &Prepared,
    clusters: impl Iterator<Item = (Cluster<'a>, &'a Classification)>,
) -> Vec<bool> {
    let observation = scan.sky_observation.as_ref();
    if observation.is_none_or(|observation| !observation.is_droplet().is_empty()) {
        return Vec::new();
    }
    let mut is_flying = vec![false; scan.points.len()];
    for (cluster, _) in
        clusters.filter(|(_, classification)| classification.class == PointClass::Flying)
    {
        cluster.members.iter().for_each(|&row| is_flying[row as usize] = true);
    }
    is_flying
}

/// Factor of the confidence, at most 1: smaller if only the sky shows that the space around the
/// target is free.
fn trust(scan: &Prepared, cluster: &Cluster<'_>) -> f64 {
    let target = minus(cluster.centroid, scan.pose.translation);
    let found = scan.sky_observation.as_ref().filter(|_| scan.rebuilt > 0);
    let share = found.map_or(0.0, |observation| observation.share_around(target));
    1.0 - (1.0 - ONLY_SKY) * share
}

impl ScanToDetect<'_> {
    fn teammate_at(&self, position: [f64; 3]) -> Option<&Teammate> {
        let offset = |mate: &Teammate| minus(self.map_from_world.apply(mate.position), position);
        self.teammates.iter().find(|mate| norm(offset(mate)) <= mate.radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_looks_past_edges_where_it_moves_across_the_line_of_sight() {
        let mut scan = Prepared::default();
        scan.points = vec![[10.0, 0.0, 0.0]; 3];
        let mut clusters = Clusters::default();
        clusters.fill(&scan.points, &[0; 3]);
        let mut looks = |moved| {
            scan.moved = moved;
            looks_past(&scan, &clusters.get(0))
        };
        assert!(looks([0.0, 0.2, 0.0]) && looks([0.5, 0.0, -0.2]));
        // The opposites: towards the cluster, the noise of poses, and a sensor that stands.
        assert!(!looks([0.5, 0.0, 0.0]) && !looks([0.0, 0.05, 0.05]) && !looks([0.0; 3]));
    }
}
