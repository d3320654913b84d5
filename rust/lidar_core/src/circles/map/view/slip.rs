//! Test whether the scanner moved between two scans with equal poses.
//!
//! If the source of the poses has stopped, the poses stay the same, and all static objects seem to
//! move with the scanner. One motion then explains both scans; moving objects do not fit it.

#![allow(non_snake_case)] // textbook letters

use super::visibility::SortedView;
use nalgebra::{Matrix3, Vector3};

/// Largest number of ends of rays that are compared.
const SAMPLES: usize = 100;
/// Least number of ends of rays for a decision.
const FEWEST: usize = 30;
/// Distance from the surface of the earlier scan within which an end lies on it [m].
const ON: f64 = 0.05;
/// Share of the ends on surfaces of the earlier scan above which the scanner is at rest.
const BEFORE: f64 = 0.5;
/// Least gap between two surfaces [m].
const GAP: f64 = 0.5;
/// Numbers of surfaces that the motion must explain, each with the least share of the ends on them.
/// With more surfaces, a coincidence is less likely, so a smaller share is enough. The other ends
/// may be on people and vehicles, which move independently.
const AFTER: [(usize, f64); 2] = [(3, 0.85), (6, 0.7)];
/// One sample in this many is tested first, to save time: independently moving objects rarely pass
/// this test.
const FIRST: usize = 4;
/// Share of the first samples that a motion has to explain.
const FIRST_AFTER: f64 = 0.6;
/// Largest distance at which a surface is looked for in the first round [m].
const REACH: f64 = 0.6;
/// Number of rounds of the search.
const ROUNDS: usize = 12;
/// Factor on the search distance from round to round.
const NARROWER: f64 = 0.85;
/// Damping that keeps a motion along a single wall at zero.
const DAMPING: f64 = 1e-3;

/// Motion in the plane: a rotation about the scanner [rad], then a translation [m].
#[derive(Clone, Copy, Debug, Default)]
struct ScanSlip {
    shift: [f64; 2],
    turn: f64,
}

impl ScanSlip {
    /// Place of a point after the motion.
    fn apply(self) -> impl Fn([f64; 2]) -> [f64; 2] {
        let (sin, cos) = (libm::sin(self.turn), libm::cos(self.turn));
        move |[x, y]| [cos * x - sin * y + self.shift[0], sin * x + cos * y + self.shift[1]]
    }
}

/// True if the scanner moved from one scan to the next, both in the frame of one pose; false if no
/// motion of the scanner explains them. None if it is at rest, or if there are too few ends.
pub(super) fn has_slipped(now: &SortedView, then: &SortedView) -> Option<bool> {
    let ends: Vec<[f64; 2]> = now.pieces().iter().flatten().map(|piece| piece.end).collect();
    let every = ends.len().div_ceil(SAMPLES).max(1);
    let samples: Vec<[f64; 2]> = ends.into_iter().step_by(every).collect();
    if samples.len() < FEWEST {
        return None;
    }
    let share = |on: usize| on as f64 / samples.len() as f64;
    // Usually the scanner rests: half of the ends show it, and the others are not looked at.
    let most = (BEFORE * samples.len() as f64) as usize;
    if on_surface(&samples, then, ScanSlip::default()).nth(most).is_some() {
        return None;
    }
    let explained = |points: &[[f64; 2]]| -> Vec<[f64; 2]> {
        on_surface(points, then, between(points, then)).copied().collect()
    };
    let first: Vec<[f64; 2]> = samples.iter().copied().step_by(FIRST).collect();
    if (explained(&first).len() as f64) < FIRST_AFTER * first.len() as f64 {
        return Some(false);
    }
    let explained = explained(&samples);
    let apart = |pair: &&[[f64; 2]]| libm::hypot(pair[0][0] - pair[1][0], pair[0][1] - pair[1][1]);
    let gaps = explained.windows(2).filter(|pair| apart(pair) > GAP).count();
    let is_enough =
        |&(surfaces, least): &(usize, f64)| gaps + 1 >= surfaces && share(explained.len()) >= least;
    Some(AFTER.iter().any(is_enough))
}

/// Points that lie on a surface of a scan after a motion.
fn on_surface<'a>(
    points: &'a [[f64; 2]],
    then: &'a SortedView,
    motion: ScanSlip,
) -> impl Iterator<Item = &'a [f64; 2]> {
    let moved = motion.apply();
    points.iter().filter(move |point| then.within(moved(**point), ON).is_some())
}

/// Motion that moves points onto the surfaces of a scan: iterated least squares of their distances,
/// with a decreasing search distance.
///
/// Source: Chen & Medioni, "Object modelling by registration of multiple range images", 1992.
fn between(points: &[[f64; 2]], then: &SortedView) -> ScanSlip {
    let mut motion = ScanSlip::default();
    let mut reach = REACH;
    for _ in 0..ROUNDS {
        let (mut A, mut b) = (Matrix3::identity() * DAMPING, Vector3::zeros());
        for place in points.iter().copied().map(motion.apply()) {
            let Some((distance, [x, y])) = then.within(place, reach) else { continue };
            let normal = [x / distance.max(1e-9), y / distance.max(1e-9)];
            let J = Vector3::new(
                normal[0],
                normal[1],
                normal[1] * (place[0] - motion.shift[0]) - normal[0] * (place[1] - motion.shift[1]),
            );
            A += J * J.transpose();
            b += J * distance;
        }
        let Some(step) = A.cholesky().map(|A| A.solve(&b)) else { break };
        motion.shift = [motion.shift[0] - step[0], motion.shift[1] - step[1]];
        motion.turn -= step[2];
        reach = (reach * NARROWER).max(2.0 * ON);
    }
    motion
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::circles::map::view::visibility::ScanWithLimits;
    use crate::circles::preprocess::polar_scan::PolarScan;

    /// A room of 8 m by 6 m with round things (x, y, radius), seen from a place and under a yaw.
    fn view(at: [f64; 2], yaw: f64, things: &[[f64; 3]]) -> Result<SortedView, Error> {
        let bearings: Vec<f64> = (-180..180).map(|ray| f64::from(ray) * 0.017).collect();
        let range = |bearing: &f64| {
            let (dx, dy) = (libm::cos(bearing + yaw), libm::sin(bearing + yaw));
            let along = |side: f64, from: f64, way: f64| (side * way.signum() - from) / way;
            let mut range = along(4.0, at[0], dx).min(along(3.0, at[1], dy));
            for [x, y, radius] in things {
                let [x, y] = [x - at[0], y - at[1]];
                let (middle, aside) = (x * dx + y * dy, x * dy - y * dx);
                if middle > 0.0 && aside.abs() < *radius {
                    range = range.min(middle - (radius * radius - aside * aside).sqrt());
                }
            }
            range
        };
        let ranges = bearings.iter().map(range).collect();
        let scan = PolarScan { ranges, bearings };
        ScanWithLimits { scan: &scan, range_min: 0.1, range_max: 20.0 }.sorted()
    }

    #[test]
    fn a_scanner_that_moves_is_told_from_things_that_move() -> Result<(), Error> {
        let things = [[2.0, 1.0, 0.3], [-1.5, 2.0, 0.2], [1.0, -2.0, 0.4]];
        let then = view([0.0, 0.0], 0.0, &things)?;
        for (at, yaw) in [([0.2, 0.1], 0.0), ([0.0, 0.0], 0.08), ([-0.15, 0.1], -0.1)] {
            assert_eq!(has_slipped(&view(at, yaw, &things)?, &then), Some(true), "{at:?} {yaw}");
        }
        assert_eq!(has_slipped(&then, &then), None);
        let walked = things.map(|[x, y, radius]| [x + 0.3 * y.signum(), y, radius]);
        assert_ne!(has_slipped(&view([0.0, 0.0], 0.0, &walked)?, &then), Some(true));
        // A crowd close around the scanner, of which everybody goes elsewhere, hides the room.
        let crowd = |by: f64| -> Vec<[f64; 3]> {
            let place = |number: i32| {
                let (sin, cos) = (libm::sin(f64::from(number)), libm::cos(f64::from(number)));
                let way = libm::cos(2.3 * f64::from(number));
                [cos * (1.2 + by * way), sin * (1.2 + by * way) + by * (1.0 - way), 0.5]
            };
            (0..7).map(place).collect()
        };
        let apart = view([0.0, 0.0], 0.0, &crowd(0.25))?;
        assert_ne!(has_slipped(&apart, &view([0.0, 0.0], 0.0, &crowd(0.0))?), Some(true));
        Ok(())
    }
}
