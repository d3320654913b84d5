//! What flies in a scan: clusters and their verdicts -> detections and teammates.

use super::center::Center;
use super::classify::Verdict;
use super::clusters::Cluster;
use super::detection::Detection;
use super::detector::FlyingObjectDetector;
use super::frame::Teammate;
use super::integrate::{BACKGROUND, FLYING};
use super::scan::Prepared;
use super::visibility::ScanView;
use crate::geometry::transform::{minus, norm};

/// Detections and teammates of a scan, in the frame of the map.
#[derive(Default)]
pub(crate) struct Found {
    pub(crate) detections: Vec<Detection>,
    pub(crate) teammates: Vec<(i64, Detection)>,
    /// Rows of points on teammates.
    pub(crate) hidden: Vec<u32>,
}

impl FlyingObjectDetector {
    /// Detections and teammates of a scan, in the frame of the map.
    pub(super) fn detections(
        &self,
        view: &ScanView<'_>,
        scan: &Prepared,
        clusters: &[Cluster<'_>],
        verdicts: &[Verdict],
    ) -> Found {
        let mut found = Found::default();
        let centers = self.centers(view, clusters, verdicts);
        for ((cluster, verdict), center) in clusters.iter().zip(verdicts).zip(centers) {
            let mate = self.teammate_at(cluster.centroid).filter(|_| verdict.class != BACKGROUND);
            if mate.is_some() {
                found.hidden.extend(cluster.members);
            }
            if verdict.class != FLYING {
                continue;
            }
            let mut detection = Detection::of(scan, cluster, verdict, self.parameters.range_std);
            if let Some(center) = center {
                detection = detection.at(&center);
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

    /// For every cluster, the centre behind its points if it is a flying object and if centres
    /// are asked for.
    fn centers(
        &self,
        view: &ScanView<'_>,
        clusters: &[Cluster<'_>],
        verdicts: &[Verdict],
    ) -> Vec<Option<Center>> {
        let is_wanted = |&index: &usize| self.parameters.centers && verdicts[index].class == FLYING;
        let wanted: Vec<usize> = (0..clusters.len()).filter(is_wanted).collect();
        let rows: Vec<&[u32]> = wanted.iter().map(|&index| clusters[index].members).collect();
        let mut centers = vec![None; clusters.len()];
        for (index, center) in wanted.into_iter().zip(view.centers_of(&rows)) {
            centers[index] = Some(center);
        }
        centers
    }

    fn teammate_at(&self, position: [f64; 3]) -> Option<&Teammate> {
        let offset = |mate: &Teammate| minus(self.map_from_world.apply(mate.position), position);
        self.teammates.iter().find(|mate| norm(offset(mate)) <= mate.radius)
    }
}
