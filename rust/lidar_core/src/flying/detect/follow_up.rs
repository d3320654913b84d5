//! Detections to the tracker, and back: what its tracks follow flies.

use super::detections::Found;
use super::visibility::ScanView;
use crate::Error;
use crate::flying::classify::classified::Judged;
use crate::flying::detector::FlyingObjectDetector;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::{FLYING, UNKNOWN};
use crate::flying::scan::prepared::Prepared;
use crate::flying::track::{Detections, PointCloudTracker};
use crate::geometry::transform::{minus, norm};
use std::borrow::Cow;

/// Feed the tracker; rows of points that confirmed tracks follow.
pub(crate) fn track(
    tracker: &mut PointCloudTracker,
    map: &VoxelMap,
    view: &ScanView<'_>,
    scan: &Prepared,
    found: &Found,
    stamp_ns: i64,
) -> Result<Vec<u32>, Error> {
    let mut points = Cow::from(&scan.points);
    for &row in &found.hidden {
        points.to_mut()[row as usize] = [f32::NAN; 3]; // no track follows a teammate
    }
    let delays = scan.delays.as_deref();
    let seen = tracker.new_point_cloud(&points, delays, map, Some(view), stamp_ns)?;
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
    tracker.new_detections(&detections, map)?;
    let followed = seen.corrected.into_iter().zip(seen.rows);
    Ok(followed.filter(|&(id, _)| tracker.is_confirmed(id)).map(|(_, row)| row).collect())
}

impl FlyingObjectDetector {
    /// Add the unknown clusters that confirmed tracks follow, given a row of each: what flew into
    /// a place of which little is known still flies.
    pub(crate) fn add_followed(
        &self,
        judged: &mut Judged,
        found: &mut Found,
        rows: &[u32],
        view: &ScanView<'_>,
        scan: &Prepared,
    ) {
        let p = &self.parameters.classify;
        let mut followed = Vec::new();
        for &row in rows.iter().filter(|_| p.follow_tracks) {
            let Ok(index) = usize::try_from(judged.labels()[row as usize]) else { continue };
            let cluster = judged.clusters.get(index);
            let distance = norm(minus(cluster.centroid, scan.pose.translation));
            let is_target = judged.verdicts[index].class == UNKNOWN
                && cluster.members.len() >= p.min_points
                && p.max_distance.is_none_or(|far| distance <= far)
                && p.max_extent.is_none_or(|extent| cluster.diagonal() <= extent);
            if is_target {
                judged.verdicts[index].class = FLYING;
                followed.push(index);
            }
        }
        if followed.is_empty() {
            return;
        }
        followed.sort_unstable();
        let verdicts = followed.iter().map(|&index| (index, &judged.verdicts[index]));
        let more = self.detections(view, scan, &judged.clusters, verdicts);
        found.detections.extend(more.detections);
        judged.tell_classes(scan);
    }
}
