//! Ranges that the rays of the last seconds have reached, by direction.

use crate::geometry::transform::{minus, norm};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::LazyLock;

/// Number of cells along an edge of each of the six faces of a cube of directions: about one degree
/// per cell.
const EDGE: usize = 90;
/// Number of cells of a face.
const FACE: usize = EDGE * EDGE;
/// Number of cells of all faces.
const CELLS: usize = 6 * FACE;
/// Side of a cell on a face at distance 1.
const SIDE: f64 = 2.0 / EDGE as f64;
/// Time for which scans are kept [s]; `MOST`: largest number of kept scans. Not all scans of a fast
/// sensor are kept.
const KEPT: f64 = 1.2;
/// Largest number of kept scans.
const MOST: usize = 12;
/// Age below which scans may show the target itself [s].
const FRESH: f64 = 0.3;
/// Time that the kept scans must cover before any place is known to be clear [s].
const LEAST: f64 = 0.8;
/// Distance behind a place from which on a return does not contradict that the place is clear [m].
const BEHIND: f64 = 1.0;
/// A clear place has nothing within this distance to its side [m]; the second constant limits the
/// number of cells that are checked on each side.
const ASIDE: f64 = 0.5;
/// Largest number of cells that are checked on each side of a place.
const MOST_SIDES: f64 = 4.0;
/// Elevation below which targets may stand on the ground [rad], unless rays pass below them: see
/// [`BELOW`].
const LEVEL: f64 = 0.035;
/// Angle below a target at which rays must be cast and pass beyond it, if it is low [rad].
const BELOW: f64 = 0.07;
/// Step in which ranges are stored [m]. 0 stands for no return.
const STEP: f64 = 0.01;

/// Solid angles of the cells of a face [sr].
static SOLID_ANGLES: LazyLock<Vec<f64>> = LazyLock::new(|| {
    let middle = |index: usize| (index as f64 + 0.5) * SIDE - 1.0;
    let angle = |cell: usize| {
        let (u, v) = (middle(cell / EDGE), middle(cell % EDGE));
        SIDE * SIDE / libm::pow(1.0 + u * u + v * v, 1.5)
    };
    (0..FACE).map(angle).collect()
});

/// Cell of a direction. It need not be a unit vector.
#[inline]
fn cell_of(direction: [f64; 3]) -> usize {
    let (axis, [u, v]) = on_face(direction);
    let along = |place: f64| (((place + 1.0) / SIDE) as usize).min(EDGE - 1); // NaN gives 0
    let face = 2 * axis + usize::from(direction[axis] < 0.0);
    face * FACE + along(u) * EDGE + along(v)
}

/// The cell of a direction and its neighbours: on each side as many as cover `ASIDE` at the end of
/// the vector.
fn cells_beside(direction: [f64; 3]) -> impl Iterator<Item = usize> {
    let (axis, [u, v]) = on_face(direction);
    let depth = direction[axis].abs();
    let sides = (ASIDE / (depth * SIDE)).ceil().clamp(1.0, MOST_SIDES) as i32;
    let steps = move || (-sides..=sides).map(|step| f64::from(step) * SIDE);
    steps().flat_map(move |along| {
        steps().map(move |across| {
            let mut moved = direction;
            moved[(axis + 1) % 3] = depth * (u + along);
            moved[(axis + 2) % 3] = depth * (v + across);
            cell_of(moved)
        })
    })
}

/// The axis of the face of a direction, and the place on the face.
#[inline]
fn on_face(direction: [f64; 3]) -> (usize, [f64; 2]) {
    let mut axis = 0;
    for other in 1..3 {
        if direction[other].abs() > direction[axis].abs() {
            axis = other;
        }
    }
    let depth = direction[axis].abs();
    (axis, [direction[(axis + 1) % 3] / depth, direction[(axis + 2) % 3] / depth])
}

/// Ranges that the rays of one scan have reached, by direction.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SeenScan {
    origin: [f64; 3],
    /// Range of the nearest return in every cell of direction, in steps. 0 without a return.
    nearest: Vec<u16>,
}

impl SeenScan {
    /// A scan from `origin` [m], without returns at first.
    pub(super) fn new(origin: [f64; 3]) -> Self {
        Self { origin, nearest: vec![0; CELLS] }
    }

    /// Add a return [m].
    #[inline]
    pub(super) fn add(&mut self, place: [f64; 3]) {
        let span = minus(place, self.origin);
        let steps = (norm(span) / STEP).clamp(1.0, f64::from(u16::MAX)) as u16;
        let nearest = &mut self.nearest[cell_of(span)];
        if *nearest == 0 || steps < *nearest {
            *nearest = steps;
        }
    }

    /// Solid angle of the cells with returns [sr].
    pub(super) fn solid_angle(&self) -> f64 {
        let cells = self.nearest.iter().enumerate().filter(|(_, nearest)| **nearest > 0);
        cells.map(|(cell, _)| SOLID_ANGLES[cell % FACE]).sum()
    }

    /// Whether nothing has returned from a place, from beside it, or from in front of it.
    pub(super) fn is_clear(&self, place: [f64; 3]) -> bool {
        let span = minus(place, self.origin);
        !cells_beside(span).any(|cell| self.ends_before(cell, norm(span)))
    }

    /// Whether rays pass below a place, by 4 degrees. None if no rays return there.
    fn passes_below(&self, place: [f64; 3]) -> Option<bool> {
        let span = minus(place, self.origin);
        let level = libm::hypot(span[0], span[1]);
        let lower = [span[0], span[1], span[2] - BELOW * level];
        let is_seen = cells_beside(lower).any(|cell| self.nearest[cell] > 0);
        is_seen.then(|| !cells_beside(lower).any(|cell| self.ends_before(cell, norm(span))))
    }

    fn ends_before(&self, cell: usize, range: f64) -> bool {
        let nearest = self.nearest[cell];
        nearest > 0 && f64::from(nearest) * STEP < range + BEHIND
    }

    fn is_possible(&self) -> bool {
        self.nearest.len() == CELLS && self.origin.iter().all(|value| value.is_finite())
    }
}

/// Ranges of the scans of the last seconds.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct SeenRanges {
    scans: VecDeque<(i64, SeenScan)>,
    newest: Option<SeenScan>,
}

impl SeenRanges {
    /// Add a scan.
    pub(super) fn push(&mut self, stamp_ns: i64, scan: SeenScan) {
        let since = |old_ns: i64| super::seconds(old_ns, stamp_ns);
        while self.scans.front().is_some_and(|(old_ns, _)| since(*old_ns) > KEPT) {
            self.scans.pop_front();
        }
        let apart = 0.99 * KEPT / MOST as f64;
        if self.scans.back().is_none_or(|(old_ns, _)| since(*old_ns) >= apart) {
            if self.scans.len() > MOST {
                self.scans.pop_front();
            }
            self.scans.push_back((stamp_ns, scan.clone()));
        }
        self.newest = Some(scan);
    }

    /// Whether earlier scans have seen past a place, and also below it if it is low.
    pub(super) fn was_clear(&self, place: [f64; 3], stamp_ns: i64) -> bool {
        let since = |old_ns: i64| super::seconds(old_ns, stamp_ns);
        let is_known = self.scans.front().is_some_and(|(old_ns, _)| since(*old_ns) >= LEAST);
        let earlier = || self.scans.iter().filter(|(old_ns, _)| since(*old_ns) > FRESH);
        is_known
            && earlier().all(|(_, scan)| scan.is_clear(place))
            && (self.is_high(place) || {
                let mut below =
                    earlier().filter_map(|(_, scan)| scan.passes_below(place)).peekable();
                below.peek().is_some() && below.all(|passes| passes)
            })
    }

    /// Whether a place is above the level of the sensor.
    fn is_high(&self, place: [f64; 3]) -> bool {
        self.scans.back().is_some_and(|(_, scan)| {
            let span = minus(place, scan.origin);
            span[2] > LEVEL * libm::hypot(span[0], span[1])
        })
    }

    /// Whether the newest scan has seen past a place.
    pub(super) fn is_clear_in_last(&self, place: [f64; 3]) -> bool {
        self.newest.as_ref().is_some_and(|scan| scan.is_clear(place))
    }

    /// True if scans can have left this state. Checks a saved state.
    pub(super) fn is_possible(&self) -> bool {
        self.scans.len() <= MOST + 1
            && self.scans.iter().all(|(_, scan)| scan.is_possible())
            && self.newest.as_ref().is_none_or(SeenScan::is_possible)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eleven scans, ten per second, with returns from the same places.
    fn seen(places: &[[f64; 3]]) -> SeenRanges {
        let mut seen = SeenRanges::default();
        for scan in 0..11 {
            let mut ranges = SeenScan::new([0.0; 3]);
            places.iter().for_each(|&place| ranges.add(place));
            seen.push(scan * 100_000_000, ranges);
        }
        seen
    }

    #[test]
    fn cells_cover_the_sphere_once() {
        let whole: f64 = 6.0 * SOLID_ANGLES.iter().sum::<f64>();
        assert!((whole / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3, "{whole}");
        for direction in [[1.0, 0.999, 0.2], [-3.0, 2.9, -2.95], [0.1, -0.05, 7.0]] {
            let mut around: Vec<usize> = cells_beside(direction.map(|part| 50.0 * part)).collect();
            assert!(around.contains(&cell_of(direction)));
            around.sort_unstable();
            around.dedup();
            assert!(around.len() >= 6, "{around:?}"); // some less at the corners of the cube
        }
    }

    #[test]
    fn a_place_is_clear_before_what_is_behind_it_and_nowhere_else() {
        let now = 1_100_000_000;
        let target = [30.0, 0.0, 8.0];
        assert!(seen(&[]).was_clear(target, now));
        assert!(seen(&[[60.0, 0.0, 16.0]]).was_clear(target, now));
        for blocks in [[30.0, 0.0, 8.0], [15.0, 0.0, 4.0], [30.0, 0.3, 8.0], [30.5, 0.0, 8.1]] {
            assert!(!seen(&[blocks]).was_clear(target, now), "{blocks:?}");
        }
        assert!(seen(&[[30.0, 2.5, 8.0]]).was_clear(target, now));
        // Nothing is known of what no scan, or only young ones, have seen.
        assert!(!SeenRanges::default().was_clear(target, now));
        assert!(!seen(&[]).was_clear(target, 300_000_000));
    }

    #[test]
    fn rays_pass_below_what_is_low_or_it_may_stand() {
        let now = 1_100_000_000;
        let target = [30.0, 0.0, -0.5];
        let below = |range: f64, up: f64| [range, 0.0, (up - BELOW) * range];
        assert!(!seen(&[]).was_clear(target, now)); // none are cast there
        assert!(!seen(&[below(20.0, -0.5 / 30.0)]).was_clear(target, now));
        assert!(seen(&[below(60.0, -0.5 / 30.0)]).was_clear(target, now));
    }
}
