//! Earlier scans, and what they met where something is now.
//!
//! Source: the idea of Wang, Thorpe & Thrun, "Online simultaneous localization and mapping with
//! detection and tracking of moving objects", ICRA 2003: what moves is where space was free.

use super::viewpoint::Viewpoint;
use super::visibility::Met;
use crate::circles::map::seconds;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Ages of the scans that are asked [s]: in the shortest, what walks leaves its own place.
const AGES: [f64; 4] = [0.4, 0.8, 1.2, 1.6];
/// Shares of an age by which a scan may be younger, and time by which it may be older [s].
const SLACK: (f64, f64) = (0.1, 0.6);
/// Least time between scans that are kept [s].
const APART: f64 = 0.1;
/// Distance of a point from a surface that was met there [m]: noise, and points between rays.
const MARGIN: f64 = 0.12;
/// Most points of one object that are looked up.
const MOST_POINTS: usize = 40;
/// Least share of the answers that must tell something.
const LEAST_KNOWN: f64 = 0.5;

/// Share of the points of an object at which earlier scans met a surface, among those at which they
/// met a surface or free space.
pub(in crate::circles::map) type Trace = f64;

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

    /// Trace of an object with these points in the world; None if earlier scans tell too little.
    pub(in crate::circles::map) fn trace(
        &self,
        points: &[[f64; 2]],
        stamp_ns: i64,
    ) -> Option<Trace> {
        let every = points.len().div_ceil(MOST_POINTS).max(1);
        let mut asked: Vec<i64> = Vec::new();
        let (mut there, mut free, mut total) = (0, 0, 0);
        for age in AGES {
            let is_of_age = |one: &&Viewpoint| {
                let found = seconds(one.stamp_ns, stamp_ns);
                found >= age * (1.0 - SLACK.0) && found < age + SLACK.1
            };
            let Some(from) = self.views.iter().rev().find(is_of_age) else { continue };
            let Some(view) = from.view.as_ref().filter(|_| !asked.contains(&from.stamp_ns)) else {
                continue;
            };
            asked.push(from.stamp_ns);
            for &point in points.iter().step_by(every) {
                total += 1;
                match view.met(from.pose.level(point, 0.0).center, MARGIN) {
                    Met::Surface => there += 1,
                    Met::Free => free += 1,
                    Met::Unknown => {}
                }
            }
        }
        let known = there + free;
        let is_known = known > 0 && f64::from(known) >= LEAST_KNOWN * f64::from(total);
        is_known.then(|| f64::from(there) / f64::from(known))
    }

    /// Keep a viewpoint with a view, and forget what is too old.
    pub(in crate::circles::map) fn keep(&mut self, from: &Viewpoint) {
        if from.view.is_none() {
            return;
        }
        let newest = self.views.back().map(|one| seconds(one.stamp_ns, from.stamp_ns));
        if newest.is_some_and(|apart| apart < APART) {
            return; // also a late scan: its view is not needed
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
        assert_eq!(earlier.trace(&[[4.0, 0.0]], 0), None);
        for scan in 0..20 {
            earlier.keep(&from(scan * 100_000_000)?);
        }
        let at = |range: f64, bearing: f64| {
            [1.0 + range * libm::cos(bearing), range * libm::sin(bearing)]
        };
        let ask = |points: &[[f64; 2]]| earlier.trace(points, 2_000_000_000);
        assert_eq!(ask(&[at(3.0, -0.2), at(3.05, -0.3)]), Some(1.0));
        assert_eq!(ask(&[at(2.0, -0.2), at(5.0, 0.3)]), Some(0.0));
        assert_eq!(ask(&[at(5.0, -0.2)]), None); // hidden behind the nearer surface
        assert_eq!(ask(&[at(5.0, 2.0)]), None); // out of view
        Ok(())
    }
}
