//! Earlier scans, and the surfaces that they show at a place.
//!
//! Source: the idea of Wang, Thorpe & Thrun, "Online simultaneous localization and mapping with
//! detection and tracking of moving objects", ICRA 2003: moving objects are at places that were
//! free.

use super::piece::SurfacePiece;
use super::slip;
use super::surface::Met;
use super::viewpoint::Viewpoint;
use super::visibility::SortedView;
use crate::circles::map::seconds;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Ages of the earlier scans with which a scan is compared [s]. Even in the shortest time, a
/// walking person leaves its own place.
const AGES: [f64; 4] = [0.4, 0.8, 1.2, 1.6];
/// Largest deviations from these ages: younger by this share of the age, older by this time [s].
const SLACK: (f64, f64) = (0.1, 0.6);
/// Least time between stored scans [s].
const APART: f64 = 0.1;
/// Least and largest value of the distance up to which a point counts as lying on a surface of an
/// earlier scan [m].
const MARGIN: [f64; 2] = [0.02, 0.12];
/// Largest distance of a point that lies on an earlier surface, as a multiple of the median
/// distance, which is the noise of ranges and poses.
const USUAL: f64 = 4.0;
/// Least and largest number of points from which the median distance is determined.
const SAMPLES: [usize; 2] = [20, 100];
/// Largest distance of a point from an earlier surface that counts for the median distance [m].
const KNOWN: f64 = 0.3;
/// Largest distance behind its old place of a surface that moved away from the scanner [m].
const RECEDED: f64 = 0.3;
/// Median distance between two scans up to which their poses agree with their surfaces [m].
const OFF: f64 = 0.02;
/// Largest number of points of one object that are compared with earlier scans.
const MOST_POINTS: usize = 40;
/// Least share of the compared points for which earlier scans must have seen a surface or free
/// space.
const LEAST_KNOWN: f64 = 0.5;

/// Share of the points of an object at which earlier scans saw a surface, among the points at which
/// they saw a surface or free space.
pub(in crate::circles::map) type Trace = f64;

/// Earlier scans with which the scan `now` is compared.
pub(in crate::circles::map) struct EarlierViews<'a> {
    now: &'a Viewpoint,
    asked: Vec<Asked<'a>>,
}

/// An earlier scan, with the tolerance for points on its surfaces.
struct Asked<'a> {
    from: &'a Viewpoint,
    view: &'a SortedView,
    /// Median distance of the points of the present scan from the surfaces of this scan [m]; None
    /// if there are too few points.
    usual: Option<f64>,
    /// Largest distance of a point that lies on a surface of this scan [m].
    margin: f64,
}

impl EarlierViews<'_> {
    /// [`Trace`] of an object with these points [m] in the world; None if earlier scans saw too few
    /// of them.
    pub(in crate::circles::map) fn trace(&self, points: &[[f64; 2]]) -> Option<Trace> {
        let every = points.len().div_ceil(MOST_POINTS).max(1);
        let (mut there, mut free, mut total) = (0, 0, 0);
        for asked in &self.asked {
            for &point in points.iter().step_by(every) {
                total += 1;
                match asked.view.met(asked.from.pose.level(point, 0.0).center, asked.margin) {
                    Met::Surface => there += 1,
                    Met::Free => free += 1,
                    Met::Unknown if self.has_receded(point, asked) => free += 1,
                    Met::Unknown => {}
                }
            }
        }
        let known = there + free;
        let is_known = known > 0 && f64::from(known) >= LEAST_KNOWN * f64::from(total);
        is_known.then(|| f64::from(there) / f64::from(known))
    }

    /// True if the pose is the same as that of an earlier scan, although the scanner moved. Only
    /// the newest scan that does not fit is compared in detail, because the motion since then is
    /// the smallest.
    pub(in crate::circles::map) fn has_stuck_pose(&self) -> bool {
        let Some(now) = &self.now.view else { return false };
        let is_off = |asked: &&Asked<'_>| {
            asked.usual.is_none_or(|usual| usual > OFF) && asked.from.pose.is_same(&self.now.pose)
        };
        let slipped = |asked: &Asked<'_>| slip::has_slipped(now, asked.view);
        self.asked.iter().filter(is_off).find_map(slipped).unwrap_or(false)
    }

    /// True if a surface was just in front of this point, and rays now pass through that place: the
    /// surface moved away.
    fn has_receded(&self, point: [f64; 2], asked: &Asked<'_>) -> bool {
        let Some(view) = &self.now.view else { return false };
        let Some(old) = asked.view.before(asked.from.pose.level(point, 0.0).center) else {
            return false;
        };
        let old = asked.from.pose.world_point(old);
        libm::hypot(point[0] - old[0], point[1] - old[1]) < RECEDED
            && view.met(self.now.pose.level(old, 0.0).center, asked.margin) == Met::Free
    }
}

/// Median distance of the points of the scan `now` from the surfaces of an earlier scan [m]; None
/// if there are too few points.
///
/// Most of a scan is static, so this distance shows the noise of the ranges, and of the pose over
/// the time between both scans.
fn usual(now: &Viewpoint, then: &Viewpoint, view: &SortedView) -> Option<f64> {
    let seen = now.view.as_ref()?;
    let every = seen.len().div_ceil(SAMPLES[1]).max(1);
    let off = |piece: &Option<SurfacePiece>| {
        let end = now.pose.world_point(piece.as_ref()?.end);
        let place = then.pose.level(end, 0.0).center;
        view.distance(place).filter(|off| *off < KNOWN)
    };
    let mut distances: Vec<f64> = seen.pieces().iter().step_by(every).filter_map(off).collect();
    if distances.len() < SAMPLES[0] {
        return None;
    }
    let middle = distances.len() / 2;
    let (_, median, _) = distances.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*median)
}

/// Recent viewpoints, the oldest first.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(in crate::circles::map) struct Earlier {
    views: VecDeque<Viewpoint>,
}

impl Earlier {
    /// True if the parts of a restored state agree.
    pub(in crate::circles::map) fn is_sound(&self) -> bool {
        self.views.iter().all(|one| one.view.as_ref().is_some_and(|view| view.is_sound()))
    }

    /// Earlier scans that are compared with the viewpoint `now` to find moving objects.
    pub(in crate::circles::map) fn before<'a>(&'a self, now: &'a Viewpoint) -> EarlierViews<'a> {
        let mut asked: Vec<Asked<'a>> = Vec::new();
        for age in AGES {
            let is_of_age = |one: &&Viewpoint| {
                let found = seconds(one.stamp_ns, now.stamp_ns);
                found >= age * (1.0 - SLACK.0) && found < age + SLACK.1
            };
            let found = self.views.iter().rev().find(is_of_age);
            if let Some((one, view)) = found.and_then(|one| Some((one, one.view.as_ref()?)))
                && asked.iter().all(|known| known.from.stamp_ns != one.stamp_ns)
            {
                let [least, most] = MARGIN;
                let usual = usual(now, one, view);
                let margin = usual.map_or(most, |usual| (USUAL * usual).clamp(least, most));
                asked.push(Asked { from: one, view, usual, margin });
            }
        }
        EarlierViews { now, asked }
    }

    /// Store a viewpoint with a view, and remove viewpoints that are too old.
    pub(in crate::circles::map) fn keep(&mut self, from: &Viewpoint) {
        if from.view.is_none() {
            return;
        }
        let newest = self.views.back().map(|one| seconds(one.stamp_ns, from.stamp_ns));
        if newest.is_some_and(|apart| apart < APART) {
            // A view so soon after another shows the same. The time of a late scan is negative: it is
            // left out, too, so that the views stay in order.
            return;
        }
        let longest = AGES[AGES.len() - 1] + SLACK.1;
        self.views.push_back(from.clone());
        while self.views.front().is_some_and(|one| seconds(one.stamp_ns, from.stamp_ns) > longest) {
            self.views.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::circles::map::view::level_pose::LevelPose;
    use crate::circles::map::view::visibility::ScanWithLimits;
    use crate::circles::preprocess::polar_scan::PolarScan;
    use crate::geometry::transform::Transform;

    /// A scan of 1 rad: a surface at 3 m for bearings below zero, at 6 m above.
    fn from(stamp_ns: i64) -> Result<Viewpoint, Error> {
        let bearings: Vec<f64> = (-50..=50).map(|ray| 0.01 * f64::from(ray)).collect();
        let ranges = bearings.iter().map(|&ray| if ray < 0.0 { 3.0 } else { 6.0 }).collect();
        let scan = PolarScan { ranges, bearings };
        let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let pose = LevelPose::of(&Transform { rotation, translation: [1.0, 0.0, 0.0] });
        let view = Some(ScanWithLimits { scan: &scan, range_min: 0.1, range_max: 10.0 }.sorted()?);
        Ok(Viewpoint { stamp_ns, sensor: 0, pose, view })
    }

    #[test]
    fn a_trace_tells_old_surfaces_from_places_that_were_free() -> Result<(), Error> {
        let mut earlier = Earlier::default();
        let first = from(0)?;
        assert_eq!(earlier.before(&first).trace(&[[4.0, 0.0]]), None);
        for scan in 0..20 {
            earlier.keep(&from(scan * 100_000_000)?);
        }
        let at = |range: f64, bearing: f64| {
            [1.0 + range * libm::cos(bearing), range * libm::sin(bearing)]
        };
        let now = from(2_000_000_000)?;
        let before = earlier.before(&now);
        let ask = |points: &[[f64; 2]]| before.trace(points);
        assert_eq!(ask(&[at(3.0, -0.2), at(3.01, -0.3)]), Some(1.0));
        // Where nothing else is off by as much, it has moved.
        assert_eq!(ask(&[at(2.97, -0.2)]), Some(0.0));
        assert_eq!(ask(&[at(2.0, -0.2), at(5.0, 0.3)]), Some(0.0));
        assert_eq!(ask(&[at(5.0, -0.2)]), None); // hidden behind the nearer surface
        assert_eq!(ask(&[at(5.0, 2.0)]), None); // out of view
        Ok(())
    }
}
