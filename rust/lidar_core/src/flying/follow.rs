//! Detections to the tracker, and back: what its tracks follow flies.

use super::classify::Verdict;
use super::detector::{FlyingObjectDetector, Judged, point_classes};
use super::found::Found;
use super::integrate::{FLYING, UNKNOWN};
use super::scan::Prepared;
use super::track::Detections;
use super::visibility::ScanView;
use crate::Error;
use crate::geometry::transform::{minus, norm};
use std::borrow::Cow;

impl FlyingObjectDetector {
    /// Feed the tracker; rows of points that confirmed tracks follow.
    pub(super) fn track(
        &mut self,
        view: &ScanView<'_>,
        scan: &Prepared,
        found: &Found,
        stamp_ns: i64,
    ) -> Result<Vec<u32>, Error> {
        let mut points = Cow::from(&scan.points);
        for &row in &found.hidden {
            points.to_mut()[row as usize] = [f32::NAN; 3]; // no track follows a teammate
        }
        let seen = self.tracker.new_point_cloud(
            &points,
            scan.delays.as_deref(),
            &self.map,
            Some(view),
            stamp_ns,
        )?;
        let positions: Vec<_> = found.detections.iter().map(|found| found.position).collect();
        let covariance: Vec<_> = found.detections.iter().map(|found| found.covariance).collect();
        let extent: Vec<_> = found.detections.iter().map(|found| found.extent).collect();
        let delay: Vec<_> = found.detections.iter().map(|found| found.delay).collect();
        let confidence: Vec<_> = found.detections.iter().map(|found| found.confidence).collect();
        let detections = Detections {
            stamp_ns,
            delay: Some(&delay),
            confidence: Some(&confidence),
            positions: &positions,
            covariance: Some(&covariance),
            extent: Some(&extent),
        };
        self.tracker.new_detections(&detections, &self.map)?;
        let confirmed = |id: i64| self.tracker.is_confirmed(id);
        let followed = seen.corrected.into_iter().zip(seen.rows).filter(|&(id, _)| confirmed(id));
        Ok(followed.map(|(_, row)| row).collect())
    }

    /// Add the unknown clusters that confirmed tracks follow, given a row of each: what flew into
    /// a place of which little is known still flies.
    pub(super) fn add_followed(
        &self,
        judged: &mut Judged<'_>,
        found: &mut Found,
        rows: &[u32],
        view: &ScanView<'_>,
        scan: &Prepared,
    ) {
        let p = &self.parameters.classify;
        let mut verdicts = vec![Verdict::default(); judged.clusters.len()];
        for &row in rows.iter().filter(|_| p.follow_tracks) {
            let Ok(index) = usize::try_from(judged.labels[row as usize]) else { continue };
            let cluster = &judged.clusters[index];
            let distance = norm(minus(cluster.centroid, scan.pose.translation));
            let is_target = judged.verdicts[index].class == UNKNOWN
                && cluster.members.len() >= p.min_points
                && p.max_distance.is_none_or(|far| distance <= far)
                && p.max_extent.is_none_or(|extent| cluster.diagonal() <= extent);
            if is_target {
                verdicts[index].class = FLYING;
                judged.verdicts[index].class = FLYING;
            }
        }
        if verdicts.iter().all(|verdict| verdict.class != FLYING) {
            return;
        }
        found
            .detections
            .extend(self.detections(view, scan, &judged.clusters, &verdicts).detections);
        judged.class = point_classes(scan, &judged.labels, &judged.verdicts);
    }
}
