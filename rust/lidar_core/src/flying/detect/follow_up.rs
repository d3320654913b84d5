//! Input of a scan and its detections to the tracker, and additional flying points on confirmed
//! tracks.

use super::detection::Detection;
use super::detections::{ScanDetections, ScanToDetect, detect};
use super::visibility::ScanView;
use crate::Error;
use crate::flying::classify::classifier::Classification;
use crate::flying::classify::scan_classifier::{ScanClassifier, ScanToClassify};
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::PointClass;
use crate::flying::scan::prepared::Prepared;
use crate::flying::track::{Detections, Occupancy, PointCloudTracker};
use crate::flying::track_before_detect::TrackBeforeDetect;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{minus, norm};
use crate::tracking::kind::TrackKind;
use std::borrow::Cow;

/// Rounding error by which the centroid of a cluster may be outside its bounding box [m].
const ROUNDING: f64 = 1e-3;

/// Index of one point of every cluster that a confirmed track follows (`rows`), and of those among
/// them that are on the ground.
pub(crate) struct Followed {
    pub(crate) rows: Vec<u32>,
    pub(crate) on_ground: Vec<u32>,
}

/// Evidence that clusters with too few points for a detection are in free space.
pub(crate) struct Hints<'a> {
    pub(crate) classifier: &'a ScanClassifier,
    pub(crate) before_detect: &'a TrackBeforeDetect,
}

/// Occupied space of the map, except where clusters were claimed by tracks.
struct BesideClaimed<'a> {
    map: &'a VoxelMap,
    /// Lower and upper corners of the boxes around the claimed clusters [m].
    boxes: Vec<[[f64; 3]; 2]>,
}

impl BesideClaimed<'_> {
    /// True if `place` is within `distance` [m] of a box of a claimed cluster.
    fn is_claimed(&self, place: [f64; 3], distance: f64) -> bool {
        self.boxes.iter().any(|[low, high]| {
            let away =
                |axis: usize| (low[axis] - place[axis]).max(place[axis] - high[axis]).max(0.0);
            norm([0, 1, 2].map(away)) <= distance
        })
    }
}

impl Occupancy for BesideClaimed<'_> {
    fn any_within(&self, point: [f64; 3], distance: f64) -> bool {
        !self.is_claimed(point, ROUNDING) && self.map.any_within(point, distance)
    }
}

/// Give the scan, its detections and its hints to the tracker. Returns the index of one point of
/// each cluster that a confirmed track follows.
///
/// # Errors
/// As [`PointCloudTracker::new_point_cloud`] and [`PointCloudTracker::new_detections`].
pub(crate) fn update_tracks(
    tracker: &mut PointCloudTracker,
    input: &ScanToClassify<'_>,
    hints: &Hints<'_>,
    view: &ScanView<'_>,
    found: &ScanDetections,
    stamp_ns: i64,
) -> Result<Followed, Error> {
    let Hints { classifier, before_detect } = hints;
    let (map, scan) = (&input.local.map, input.scan);
    let delays = scan.delays.as_deref();
    let claimed = classifier.claimed().iter().map(|&index| classifier.clusters().get(index));
    let beside = BesideClaimed { map, boxes: claimed.map(|one| [one.low, one.high]).collect() };
    let distance = tracker.parameters().clustering.max_distance;
    let points = points_of_targets(scan, classifier, &beside, &found.hidden, distance);
    let seen = tracker.new_point_cloud(&points, delays, &beside, Some(view), stamp_ns)?;
    for (&id, &row) in seen.corrected.iter().zip(&seen.rows) {
        let is_new_hint = !tracker.is_confirmed(id) && classifier.is_hint(input, row)?;
        if is_new_hint || before_detect.is_lone(row) {
            tracker.hint(id);
        }
    }
    give_detections(tracker, found, map, stamp_ns)?;
    let mut followed = Followed { rows: Vec::new(), on_ground: Vec::new() };
    for (id, row) in seen.corrected.into_iter().zip(seen.rows) {
        if tracker.is_confirmed(id) {
            followed.rows.push(row);
            let is_on_ground = tracker.kind_of(id) == Some(TrackKind::Ground);
            followed.on_ground.extend(is_on_ground.then_some(row));
        }
    }
    Ok(followed)
}

/// Points of a scan that tracks may follow. The other points are NaN.
fn points_of_targets<'s>(
    scan: &'s Prepared,
    classifier: &ScanClassifier,
    beside: &BesideClaimed<'_>,
    hidden: &[u32],
    distance: f64,
) -> Cow<'s, [[f32; 3]]> {
    let mut points = Cow::from(&scan.points);
    for &row in hidden {
        points.to_mut()[row as usize] = [f32::NAN; 3]; // no track follows a teammate
    }
    for (row, _) in (0..)
        .zip(classifier.class())
        .filter(|(_, class)| !beside.boxes.is_empty() && **class == PointClass::Background)
    {
        if beside.is_claimed(wide(scan.points[row]), distance) {
            points.to_mut()[row] = [f32::NAN; 3]; // structure beside a target is no part of it
        }
    }
    points
}

/// Give the detections of a scan to the tracker.
fn give_detections(
    tracker: &mut PointCloudTracker,
    found: &ScanDetections,
    map: &VoxelMap,
    stamp_ns: i64,
) -> Result<(), Error> {
    let positions: Vec<_> = found.detections.iter().map(|found| found.position).collect();
    let covariance: Vec<_> = found.detections.iter().map(|found| found.covariance).collect();
    let extent: Vec<_> = found.detections.iter().map(|found| found.extent).collect();
    let delay: Vec<_> = found.detections.iter().map(|found| found.delay).collect();
    let confidence: Vec<_> = found.detections.iter().map(|found| found.confidence).collect();
    let is_joined: Vec<_> = found.detections.iter().map(|found| found.is_joined).collect();
    let is_among_surfaces: Vec<_> =
        found.detections.iter().map(|found| found.is_among_surfaces).collect();
    let shape: Vec<_> = found.detections.iter().map(Detection::shape).collect();
    let detections = Detections {
        stamp_ns,
        is_joined: Some(&is_joined),
        is_among_surfaces: Some(&is_among_surfaces),
        shape: Some(&shape),
        delay: Some(&delay),
        confidence: Some(&confidence),
        positions: &positions,
        covariance: Some(&covariance),
        extent: Some(&extent),
    };
    tracker.new_detections(&detections, map).map(drop)
}

/// Let the tracker watch the clusters `standing`, which are in free space and have become
/// background at the end of the burn-in.
pub(crate) fn watch(
    tracker: &mut PointCloudTracker,
    input: &ScanToDetect<'_>,
    classifier: &ScanClassifier,
    standing: &[usize],
    stamp_ns: i64,
) {
    if standing.is_empty() {
        return;
    }
    let in_air = Classification::of(PointClass::Flying);
    let chosen = standing.iter().map(|&index| (index, &in_air));
    let found = detect(input, classifier.clusters(), chosen).detections;
    let positions: Vec<_> = found.iter().map(|found| found.position).collect();
    let covariance: Vec<_> = found.iter().map(|found| found.covariance).collect();
    let extent: Vec<_> = found.iter().map(|found| found.extent).collect();
    tracker.watch(&Detections {
        stamp_ns,
        positions: &positions,
        covariance: Some(&covariance),
        extent: Some(&extent),
        delay: None,
        confidence: None,
        is_joined: None,
        is_among_surfaces: None,
        shape: None,
    });
}

/// Set the class of unknown clusters that confirmed tracks follow to flying, and add them to the
/// detections: a target that flew into space of which little is known still flies. `rows`: index of
/// one point of each cluster. Clusters outside the operating volume are left out, although their
/// tracks continue for a while.
pub(crate) fn add_followed(
    input: &ScanToDetect<'_>,
    map: &VoxelMap,
    classifier: &mut ScanClassifier,
    found: &mut ScanDetections,
    rows: &[u32],
) {
    let (p, scan) = (&input.parameters.classify, input.scan);
    let mut followed = Vec::new();
    for &row in rows.iter().filter(|_| p.follow_tracks) {
        let Some(index) = classifier.cluster_of(row) else { continue };
        let cluster = classifier.clusters().get(index);
        let distance = norm(minus(cluster.centroid, scan.pose.translation));
        let is_target = classifier.classifications()[index].class == PointClass::Unknown
            && map.parameters().holds(cluster.centroid)
            && cluster.members.len() >= p.min_points
            && p.max_distance.is_none_or(|far| distance <= far)
            && p.max_extent.is_none_or(|extent| cluster.diagonal() <= extent);
        if is_target {
            classifier.make_flying(index);
            followed.push(index);
        }
    }
    if followed.is_empty() {
        return;
    }
    followed.sort_unstable();
    let classifications =
        followed.iter().map(|&index| (index, &classifier.classifications()[index]));
    let more = detect(input, classifier.clusters(), classifications);
    found.detections.extend(more.detections);
    classifier.class_rows(scan);
}
